"""A heliostat of spherical facets laid on a sphere, with known errors: where sights meet it and how they go on."""

from dataclasses import dataclass

import numpy as np

from heliogauge.validate import FloatArray

#: Tilts of Table 6 of the STAGE-STE deliverable 12.6: of facets 1 to 10, about both axes [mrad].
TABLE_6_MRAD = np.array(
    [
        [-2.0, -1.5, -1.0, 1.5, 2.0, 2.0, 1.5, 1.0, -1.5, -2.0],
        [2.0, 1.5, 1.0, -1.5, -2.0, -2.0, -1.5, -1.0, 1.5, 2.0],
    ]
)


@dataclass(frozen=True, slots=True, eq=False)
class DrawnHeliostat:
    """Facets in columns and rows, each a sphere with a bow and a tilt of its own.

    columns, rows, width_m, height_m, gap_m: How facets lie.
    canting_radius_m: Radius of the sphere that carries their middles; infinite: all in one plane.
    facet_radius_m: Radius of each facet.
    tilts_rad (f, 2): What each facet rises too much towards +x and +y, row by row from below.
    bows_per_m (f, 3): What each slope has beside the sphere: a x + c y in x, c x + b y in y.
    """

    columns: int
    rows: int
    width_m: float
    height_m: float
    gap_m: float
    canting_radius_m: float
    facet_radius_m: float
    tilts_rad: FloatArray
    bows_per_m: FloatArray

    @property
    def count(self) -> int:
        """Number of facets."""
        return self.columns * self.rows

    @property
    def outline_m(self) -> FloatArray:
        """Corners of each facet in its frame, shape (4, 2) [m]."""
        x, y = 0.5 * self.width_m, 0.5 * self.height_m
        return np.array([[-x, -y], [x, -y], [x, y], [-x, y]])

    def place_m(self, facet: int) -> FloatArray:
        """Return the middle of a facet in the mirror's frame, shape (3,) [m]."""
        row, column = divmod(facet, self.columns)
        x = (column - 0.5 * (self.columns - 1)) * (self.width_m + self.gap_m)
        y = (row - 0.5 * (self.rows - 1)) * (self.height_m + self.gap_m)
        if not np.isfinite(self.canting_radius_m):
            return np.array([x, y, 0.0])
        return np.array([x, y, self.canting_radius_m - np.sqrt(self.canting_radius_m**2 - x**2 - y**2)])

    def axes(self, facet: int, *, tilted: bool = True) -> FloatArray:
        """Return the axes of a facet's frame as columns in the mirror's frame, shape (3, 3)."""
        middle = self.place_m(facet)
        curved = np.isfinite(self.canting_radius_m)
        normal = np.array([0.0, 0.0, self.canting_radius_m]) - middle if curved else np.array([0.0, 0.0, 1.0])
        normal /= np.linalg.norm(normal)
        across = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
        across /= np.linalg.norm(across)
        frame = np.stack([across, np.cross(normal, across), normal], axis=1)
        if not tilted:
            return frame
        # Rising towards +x leans the normal to -x.
        leant = np.array([-self.tilts_rad[facet, 0], -self.tilts_rad[facet, 1], 1.0])
        leant /= np.linalg.norm(leant)
        x_axis = np.array([1.0, 0.0, 0.0]) - leant[0] * leant
        x_axis /= np.linalg.norm(x_axis)
        return np.asarray(frame @ np.stack([x_axis, np.cross(leant, x_axis), leant], axis=1))

    def slopes(self, facet: int, x_m: FloatArray, y_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the true slopes in the tilted frame of a facet at points of any shape."""
        a, b, c = self.bows_per_m[facet]
        deep = np.sqrt(self.facet_radius_m**2 - x_m**2 - y_m**2)
        return x_m / deep + a * x_m + c * y_m, y_m / deep + c * x_m + b * y_m

    def reflect(self, eye_m: FloatArray, sights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Follow sights from an eye to the mirror and on.

        eye_m (3,), sights (n, 3): In the mirror's frame; sights of any length.
        Returns: Directions after the mirror (n, 3), and the facet (n,), -1 beside the mirror.
        """
        after, hit = np.zeros(sights.shape), np.full(len(sights), -1)
        for facet in range(self.count):
            axes = self.axes(facet)
            origin = (eye_m - self.place_m(facet)) @ axes
            rays = sights @ axes
            along = -origin[2] / rays[:, 2]
            for _ in range(4):
                x, y = (origin[axis] + along * rays[:, axis] for axis in (0, 1))
                near = np.minimum(x**2 + y**2, 4.0 * (self.width_m**2 + self.height_m**2))
                a, b, c = self.bows_per_m[facet]
                bow = 0.5 * (a * x**2 + b * y**2) + c * x * y
                height = self.facet_radius_m - np.sqrt(self.facet_radius_m**2 - near) + bow
                along = (height - origin[2]) / rays[:, 2]
            x, y = (origin[axis] + along * rays[:, axis] for axis in (0, 1))
            own = (np.abs(x) <= 0.5 * self.width_m) & (np.abs(y) <= 0.5 * self.height_m) & (along > 0)
            slope_x, slope_y = self.slopes(facet, x[own], y[own])
            normal = np.stack([-slope_x, -slope_y, np.ones(slope_x.size)], axis=1)
            ray = rays[own]
            turned = ray - 2 * (ray * normal).sum(axis=1, keepdims=True) * normal / (normal**2).sum(
                axis=1, keepdims=True
            )
            after[own] = turned @ axes.T
            hit[own] = facet
        return after / np.maximum(np.linalg.norm(after, axis=1, keepdims=True), 1e-300), hit
