"""The trough's mirror with errors: exact at any point in float64 for the truth, tabulated in float32 for the rays."""

from dataclasses import dataclass, field
from math import ceil
from typing import Any, ClassVar, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from data_synth.optics.surface_errors import SurfaceErrors
from heliogauge.errors import InputError
from heliogauge.geometry.surfaces import HeightAndSlopes
from heliogauge.validate import Float32Array, FloatArray, IntArray, float_array
from observer.trough import Collector

# Arrays of a block of rays: float32 for photos, float64 as the reference in tests.
RayArray = npt.NDArray[Any]

#: Step of the table of smooth errors: joining it by straight lines is wrong by 0.006 mrad for a ripple of 3 mrad and
#: 0.2 m, and by less for anything longer.
_TABLE_STEP_M = 4e-3
#: OpenCV addresses images by 16-bit numbers.
_LARGEST_TABLE = 32000


@dataclass(frozen=True, slots=True, eq=False)
class PanelErrors:
    """How each panel differs from the design parabola beneath it.

    tilt_x, tilt_y (n,): Slope that the panel has too much along x (turned about y) and along y (turned about x), in
        the order of `Collector.panel_index`.
    focal_length_m (n,): Focal length of each panel, about its own middle [m].
    height_m (n,): How much higher each panel's middle sits; without, at the design's height. Only a mirror that is
        shaped has heights [m].
    shift_m (n, 2): How far each panel lies off its place, in x (along the mirror's surface) and in y; without, nowhere
        off it [m].
    """

    tilt_x: FloatArray
    tilt_y: FloatArray
    focal_length_m: FloatArray
    height_m: FloatArray | None = None
    shift_m: FloatArray | None = None

    def __post_init__(self) -> None:
        if self.height_m is None:
            object.__setattr__(self, "height_m", np.zeros(np.shape(self.tilt_x)))
        if self.shift_m is not None:
            object.__setattr__(self, "shift_m", float_array("panels shift_m", self.shift_m, (len(self.tilt_x), 2)))
        for name in ("tilt_x", "tilt_y", "focal_length_m", "height_m"):
            object.__setattr__(self, name, float_array(f"panels {name}", getattr(self, name), (None,)))
        if not self.tilt_x.size == self.tilt_y.size == self.focal_length_m.size == self.heights.size:
            raise InputError("panels: tilt_x, tilt_y, focal_length_m and height_m need one value for each panel")
        if not (self.focal_length_m > 0).all():
            raise InputError("panels focal_length_m: values above zero are needed")

    @property
    def heights(self) -> FloatArray:
        """Height of each panel's middle over the design, shape (n,) [m]."""
        return np.zeros(self.tilt_x.shape) if self.height_m is None else self.height_m


@dataclass(frozen=True, slots=True, eq=False)
class SlopeGrid:
    """Slope errors on a grid, as from a file, joined by bicubic splines; they need not belong to any surface.

    x_m (n,): Ascending grid positions [m].
    y_m (m,): Ascending grid positions [m].
    slope_x, slope_y (m, n): Slope errors at the grid points.
    """

    KIND: ClassVar[str] = "slope_grid"
    x_m: FloatArray
    y_m: FloatArray
    slope_x: FloatArray
    slope_y: FloatArray
    _splines: Any = field(init=False, repr=False)

    def __post_init__(self) -> None:
        from scipy.interpolate import RectBivariateSpline

        for name in ("x_m", "y_m"):
            object.__setattr__(self, name, float_array(f"slope_grid {name}", getattr(self, name), (None,)))
            if getattr(self, name).size < 4 or np.any(np.diff(getattr(self, name)) <= 0):
                raise InputError(f"slope_grid {name}: at least 4 ascending positions are needed")
        for name in ("slope_x", "slope_y"):
            shape = (self.y_m.size, self.x_m.size)
            object.__setattr__(self, name, float_array(f"slope_grid {name}", getattr(self, name), shape))
        grids = (self.slope_x, self.slope_y)
        object.__setattr__(self, "_splines", tuple(RectBivariateSpline(self.y_m, self.x_m, grid) for grid in grids))

    def evaluate(self, x_m: FloatArray, y_m: FloatArray) -> HeightAndSlopes:
        """Return height (0: only the normal is turned) [m], slope_x and slope_y [rad] at points (x, y) [m]."""
        slope_x, slope_y = (spline.ev(y_m, x_m) for spline in self._splines)
        return HeightAndSlopes(np.zeros(np.shape(x_m)), slope_x, slope_y)


@dataclass(frozen=True, slots=True, eq=False)
class TroughMirror:
    """The reflector of a collector, with its errors.

    collector: The design.
    errors: Smooth errors over the whole aperture, in both directions.
    transverse, longitudinal: Smooth errors of which only slope_x, or only slope_y, is taken; they belong to no
        surface.
    panels: Errors of single panels.
    is_shaped: Whether the surface itself deviates as its slopes say; otherwise the normals are turned on the design
        surface.
    InputError: Not one error for each panel, or slopes without a shape where one is asked for.

    With slope errors ``e`` (true minus design dz/dx and dz/dy) the normal is ``(-(x / 2f + e_x), -e_y, 1)`` (Owkes
    2012, eq. 7.8 with tan(alpha - theta_r) = x / 2f + e_x), so ``theta_r = atan(x / 2f) - atan(x / 2f + e_x)``,
    positive where the normal is turned towards +x.
    """

    collector: Collector
    errors: SurfaceErrors = field(default_factory=SurfaceErrors)
    transverse: SurfaceErrors = field(default_factory=SurfaceErrors)
    longitudinal: SurfaceErrors = field(default_factory=SurfaceErrors)
    panels: PanelErrors | None = None
    is_shaped: bool = False

    def __post_init__(self) -> None:
        if self.panels is not None and self.panels.tilt_x.size != self.n_panels:
            raise InputError(f"panels: {self.panels.tilt_x.size} errors for {self.n_panels} panels")
        no_height = any(isinstance(term, SlopeGrid) for term in self.errors.terms)
        if self.is_shaped and (no_height or self.transverse.terms or self.longitudinal.terms):
            raise InputError(
                "mirror: slopes on a grid, or in one direction alone, have no height; leave the shape the design's"
            )

    @property
    def n_panels(self) -> int:
        """Number of panels."""
        return (len(self.collector.panel_edges_x_m) - 1) * (len(self.collector.panel_edges_y_m) - 1)

    def deviation(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> HeightAndSlopes:
        """Return what the surface has over the design, NaN in gaps and outside.

        x_m, y_m (...): Points of the aperture [m].
        Returns (...): Height (0 where only the normal is turned) [m], slope_x and slope_y [rad].
        """
        x, y = np.broadcast_arrays(np.asarray(x_m, dtype=np.float64), np.asarray(y_m, dtype=np.float64))
        height, slope_x, slope_y = self.smooth(x, y)
        panel = self.collector.panel_index(x, y)
        rows = [row[panel] for row in _panel_polynomials(self)]
        height = height + rows[0] + x * (rows[1] + rows[2] / 2 * x) + rows[3] * y
        slope_x, slope_y = slope_x + rows[1] + rows[2] * x, slope_y + rows[3]
        if not self.is_shaped:
            height = np.zeros_like(height)
        return HeightAndSlopes(*(np.where(panel < 0, np.nan, values) for values in (height, slope_x, slope_y)))

    def smooth(self, x_m: FloatArray, y_m: FloatArray) -> HeightAndSlopes:
        """Return height [m], slope_x and slope_y [rad] of all errors but those of single panels."""
        height, slope_x, slope_y = self.errors.evaluate(x_m, y_m)
        return HeightAndSlopes(
            height,
            slope_x + self.transverse.evaluate(x_m, y_m).slope_x,
            slope_y + self.longitudinal.evaluate(x_m, y_m).slope_y,
        )

    def theta_r_rad(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> FloatArray:
        """Return the transverse slope error, positive where the normal is turned towards +x, shape (...) [rad]."""
        design = np.asarray(x_m) / (2 * self.collector.focal_length_m)
        return np.asarray(np.arctan(design) - np.arctan(design + self.deviation(x_m, y_m)[1]))


def _panel_polynomials(mirror: TroughMirror) -> FloatArray:
    """Return c0, c1, c2, c3 of each panel's ``c0 + c1 x + c2 x^2 / 2 + c3 y``, shape (4, n)."""
    if mirror.panels is None:
        return np.zeros((4, mirror.n_panels))
    edges_x, edges_y = mirror.collector.panel_edges_x_m, mirror.collector.panel_edges_y_m
    middle_y, middle_x = (
        middle.ravel()
        for middle in np.meshgrid((edges_y[1:] + edges_y[:-1]) / 2, (edges_x[1:] + edges_x[:-1]) / 2, indexing="ij")
    )
    bend = 1 / (2 * mirror.panels.focal_length_m) - 1 / (2 * mirror.collector.focal_length_m)
    c1, c3 = mirror.panels.tilt_x - bend * middle_x, mirror.panels.tilt_y
    c0 = mirror.panels.heights - c1 * middle_x - bend * middle_x**2 / 2 - c3 * middle_y
    return np.stack([c0, c1, bend, c3])


def corner_points_m(mirror: TroughMirror) -> dict[str, FloatArray]:
    """Return where lines between panels, and rims, cross: the mean of the corners of the panels that meet there [m].

    Returns: By ``corner-i-j``, i counting the edges of panels in x and j those in y.
    """
    design, panels = mirror.collector, mirror.panels
    edges_x, edges_y = design.panel_edges_x_m, design.panel_edges_y_m
    columns, polynomials = len(edges_x) - 1, _panel_polynomials(mirror)
    shift = np.zeros((mirror.n_panels, 2)) if panels is None or panels.shift_m is None else panels.shift_m
    found: dict[str, list[FloatArray]] = {}
    for panel in range(mirror.n_panels):
        row, column = divmod(panel, columns)
        for i, j in ((column + a, row + b) for a in (0, 1) for b in (0, 1)):
            x, y = np.array([edges_x[i], edges_y[j]]) + shift[panel]
            z = float(x) ** 2 / (4 * design.focal_length_m)
            if mirror.is_shaped:
                c0, c1, c2, c3 = polynomials[:, panel]
                z += float(mirror.smooth(np.array([x]), np.array([y]))[0][0] + c0 + x * (c1 + c2 / 2 * x) + c3 * y)
            found.setdefault(f"corner-{i}-{j}", []).append(np.array([x, y, z]))
    return {name: np.mean(places, axis=0) for name, places in found.items()}


def _outlines(collector: Collector, shift_m: FloatArray) -> FloatArray:
    """Return where panels that lie off their places end, shape (8, n): x from, to, y from, to; then the mirror there.

    shift_m (n, 2): Of `PanelErrors`.

    Behind an inner edge the mirror goes on; what is seen between panels is a gap.
    """
    found = []
    count = len(shift_m)
    edges = (collector.panel_edges_x_m, collector.panel_edges_y_m)
    cells = np.unravel_index(np.arange(count), (len(edges[1]) - 1, len(edges[0]) - 1))[::-1]
    for axis, (own, cell) in enumerate(zip(edges, cells, strict=True)):
        inner = np.full(own.size, collector.panel_gap_m / 2)
        inner[[0, -1]] = 0.0
        found.append((own + inner)[cell] + shift_m[:, axis])
        found.append((own - inner)[cell + 1] + shift_m[:, axis])
    (first_x, last_x, first_y, last_y), (column, row) = found, cells
    outer = [
        np.where(column == 0, first_x, -np.inf),
        np.where(column == len(edges[0]) - 2, last_x, np.inf),
        np.where(row == 0, first_y, -np.inf),
        np.where(row == len(edges[1]) - 2, last_y, np.inf),
    ]
    return np.stack([*found, *outer])


class Rays(NamedTuple):
    """Rays of one block, all arrays of the same float type.

    x, y, z (n,): Points on the rays in the trough's frame [m].
    dx, dy, dz (n,): Directions, of any length.
    """

    x: RayArray
    y: RayArray
    z: RayArray
    dx: RayArray
    dy: RayArray
    dz: RayArray

    def take(self, index: IntArray) -> "Rays":
        """Return some of the rays, by ascending numbers without repetition."""
        if index.size == self.x.size:
            return self
        return Rays(*(part[index] for part in self))


class MirrorHits(NamedTuple):
    """Where rays meet panels, and the slopes there, each of shape (n,) [m]."""

    x: RayArray
    y: RayArray
    z: RayArray
    slope_x: RayArray
    slope_y: RayArray


class _Coefficients(NamedTuple):
    """``a t^2 + b t + c`` along each ray."""

    a: RayArray
    b: RayArray
    c: RayArray


class _SmoothTable(NamedTuple):
    """slope_x, slope_y and height on a fine grid, shape (ny, nx, 3); its first point [m]; points per metre."""

    values: Float32Array
    first_m: tuple[float, float]
    per_m: tuple[float, float]


class MirrorTable:
    """The mirror as rays meet it.

    dtype: Float type of the rays; float64 serves as the reference in tests.

    A point 15 m away is met within some 3e-6 m in float32, which is 5e-4 px of a camera with 6 mm a pixel there.
    """

    def __init__(self, mirror: TroughMirror, dtype: type[np.float32] | type[np.float64] = np.float32) -> None:
        self._dtype = dtype
        self._mirror = mirror
        design = mirror.collector
        self.focal_length = dtype(design.focal_length_m)
        self._four_f = dtype(4 * design.focal_length_m)
        self.half_width = dtype(design.panel_edges_x_m[-1]), dtype(design.panel_edges_x_m[0])
        self.half_length = dtype(design.panel_edges_y_m[-1]), dtype(design.panel_edges_y_m[0])
        self._inner_x = design.panel_edges_x_m[1:-1].astype(dtype)
        self._inner_y = design.panel_edges_y_m[1:-1].astype(dtype)
        self._half_gap = dtype(design.panel_gap_m / 2)
        shift = None if mirror.panels is None else mirror.panels.shift_m
        self._outlines = None if shift is None else _outlines(design, shift).astype(dtype)
        self._panels = None if mirror.panels is None else _panel_polynomials(mirror).astype(dtype)
        self._table = _smooth_table(mirror)

    def meet(self, rays: Rays) -> RayArray:
        """Return where rays leave the inside of the (endless) design parabola, in lengths of the direction.

        Returns (n,): Length, NaN where a ray does not.
        """
        a, b, c = self._quadratic(rays)
        root = np.sqrt(b * b - 4 * a * c)
        length = np.where(b > 0, -2 * c / (b + root), (root - b) / (2 * a))
        return np.asarray(np.where(length > 0, length, np.nan))

    def meets_back(self, rays: Rays, before: float = float("inf")) -> npt.NDArray[np.bool_]:
        """Return whether rays see the mirror's back.

        before: Only up to this length.
        Returns (n,): Whether they enter the parabola from outside within the aperture.
        """
        a, b, c = self._quadratic(rays)
        root = np.sqrt(b * b - 4 * a * c)
        length = 2 * c / (root - b)
        x, y = rays.x + length * rays.dx, rays.y + length * rays.dy
        return np.asarray((c > 0) & (length > 0) & (length < before) & self.within(x, y))

    def within(self, x: RayArray, y: RayArray) -> npt.NDArray[np.bool_]:
        """Return whether points lie within the aperture's outline, gaps included."""
        if self._outlines is not None:
            first_x, last_x, first_y, last_y = self._outlines[4:, self._cell(x, y)]
            return np.asarray((x > first_x) & (x < last_x) & (y > first_y) & (y < last_y))
        inside = (x < self.half_width[0]) & (x > self.half_width[1])
        inside &= (y < self.half_length[0]) & (y > self.half_length[1])
        return np.asarray(inside)

    def panel(self, x: RayArray, y: RayArray) -> npt.NDArray[np.int16]:
        """Return the panel of points within the outline, -1 in gaps."""
        row = self._cell(x, y)
        if self._outlines is not None:
            first_x, last_x, first_y, last_y = self._outlines[:4, row]
            row[(x < first_x) | (x > last_x) | (y < first_y) | (y > last_y)] = -1
        elif self._half_gap:
            for inner, place in ((self._inner_x, x), (self._inner_y, y)):
                for edge in inner:
                    row[np.abs(place - edge) < self._half_gap] = -1
        return row

    def _cell(self, x: RayArray, y: RayArray) -> npt.NDArray[np.int16]:
        """Return in which panel's place points lie, between the middles of gaps."""
        column, row = (np.zeros(x.size, dtype=np.int16) for _ in range(2))
        for edge in self._inner_x:
            column += x > edge
        for edge in self._inner_y:
            row += y > edge
        row *= np.int16(self._inner_x.size + 1)
        row += column
        return row

    def met_at(self, rays: Rays, length: RayArray) -> tuple[RayArray, RayArray]:
        """Return where rays meet the true surface of their panel, which goes on to the middle of the gaps beside it.

        length (n,): As from `meet`.
        Returns: x and y, shape (n,) each: edges of panels are at their true height, not the design's [m].
        """
        x, y = rays.x + length * rays.dx, rays.y + length * rays.dy
        near = np.isfinite(length) & (np.abs(x) < 2 * self.half_width[0]) & (np.abs(y) < 2 * self.half_length[0])
        on = np.flatnonzero(near)
        if self._mirror.is_shaped and on.size:
            met = self.surface(rays.take(on), length[on], self._cell(x[on], y[on]))
            x[on], y[on] = met.x, met.y
        return x, y

    def surface(self, rays: Rays, length: RayArray, panel: npt.NDArray[np.int16]) -> "MirrorHits":
        """Return where rays that meet panels meet them, and the slopes there.

        Shapes: length (n,), panel (n,).
        """
        x, y, z = rays.x + length * rays.dx, rays.y + length * rays.dy, rays.z + length * rays.dz
        height, slope_x, slope_y = self._slopes(x, y, panel)
        if not self._mirror.is_shaped:
            return MirrorHits(x, y, z, slope_x, slope_y)
        # Deviations are millimetres and change by milliradians: two steps leave nanometres.
        for _ in range(2):
            miss = x * x / self._four_f + height - z
            length = miss / (rays.dz - slope_x * rays.dx - slope_y * rays.dy)
            x, y, z = x + length * rays.dx, y + length * rays.dy, z + length * rays.dz
            height, slope_x, slope_y = self._slopes(x, y, panel)
        return MirrorHits(x, y, z, slope_x, slope_y)

    def _quadratic(self, rays: Rays) -> "_Coefficients":
        # Coefficients of (x^2 - 4 f z)(length), negative inside.
        half_b = rays.x * rays.dx - self._four_f / 2 * rays.dz
        return _Coefficients(rays.dx * rays.dx, 2 * half_b, rays.x * rays.x - self._four_f * rays.z)

    def _slopes(self, x: RayArray, y: RayArray, panel: npt.NDArray[np.int16]) -> HeightAndSlopes:
        slope_x: RayArray = x * (2 / self._four_f)
        slope_y: RayArray = np.zeros_like(x)
        height: RayArray = np.zeros_like(x)
        if self._table is not None:
            table = self._table
            column = ((x - table.first_m[0]) * table.per_m[0]).astype(np.float32)
            row = ((y - table.first_m[1]) * table.per_m[1]).astype(np.float32)
            edge = cv2.BORDER_REPLICATE
            both = cv2.remap(table.values, column[None], row[None], cv2.INTER_LINEAR, borderMode=edge)[0]
            slope_x, slope_y, height = slope_x + both[:, 0], both[:, 1].astype(x.dtype), both[:, 2].astype(x.dtype)
        if self._panels is not None:
            c0, c1, c2, c3 = (row[panel] for row in self._panels)
            slope_x, slope_y = slope_x + c1 + c2 * x, slope_y + c3
            if self._mirror.is_shaped:
                height = height + c0 + x * (c1 + c2 / 2 * x) + c3 * y
        return HeightAndSlopes(height, slope_x, slope_y)


def _smooth_table(mirror: TroughMirror) -> _SmoothTable | None:
    """Tabulate the smooth errors; None where there are none."""
    if not (mirror.errors.terms or mirror.transverse.terms or mirror.longitudinal.terms):
        return None
    axes = []
    for edges in (mirror.collector.panel_edges_x_m, mirror.collector.panel_edges_y_m):
        size = min(ceil((edges[-1] - edges[0]) / _TABLE_STEP_M) + 1, _LARGEST_TABLE)
        axes.append(np.linspace(edges[0], edges[-1], size))
    x, y = axes
    table = np.empty((y.size, x.size, 3), dtype=np.float32)
    for start in range(0, y.size, 64):
        across, along = np.meshgrid(x, y[start : start + 64])
        height, slope_x, slope_y = mirror.smooth(across, along)
        table[start : start + 64] = np.stack([slope_x, slope_y, height], axis=-1)
    first = float(x[0]), float(y[0])
    return _SmoothTable(table, first, (1 / float(x[1] - x[0]), 1 / float(y[1] - y[0])))
