"""What errors cost over a year: sunlight by the place of the sun, traced from the mirror to an aperture.

Rays are drawn once and used for every sun and every error, so that differences between errors are not lost in the
noise of the drawing; several drawings give the sigma of what is left of it. No shading and no blocking.
"""

from dataclasses import dataclass, replace

import numpy as np

from heliogauge.errors import EstimationError, InputError
from heliogauge.sunlight.sun_shapes import SunShape
from heliogauge.validate import FloatArray, float_array, positive

#: Rays of one drawing, and drawings.
_RAYS, _DRAWINGS = 1024, 4
#: Cells of the sun's declination and hour angle into which a year is gathered.
_CELLS = (8, 16)


@dataclass(frozen=True, slots=True, eq=False)
class Aperture:
    """What the light is to meet: a flat opening.

    center_m (3,): East, north, up [m].
    normal (3,): Where it looks.
    width_m, height_m: Of a rectangle, or of an ellipse [m].
    is_round: Which of both.
    """

    center_m: FloatArray
    normal: FloatArray
    width_m: float
    height_m: float
    is_round: bool = False

    def __post_init__(self) -> None:
        for name in ("center_m", "normal"):
            object.__setattr__(self, name, float_array(name, getattr(self, name), (3,)))
        positive("width_m", self.width_m, "metres")
        positive("height_m", self.height_m, "metres")

    @property
    def axes(self) -> FloatArray:
        """Right, up and the normal, shape (3, 3)."""
        normal = self.normal / np.linalg.norm(self.normal)
        right = np.array([-normal[1], normal[0], 0.0])
        length = float(np.hypot(normal[0], normal[1]))
        right = right / length if length > 1e-9 else np.array([1.0, 0.0, 0.0])
        return np.stack([right, np.cross(normal, right), normal])

    def share_inside(self, points_m: FloatArray, beams: FloatArray) -> float:
        """Return the share of rays that meet it.

        points_m (n, 3), beams (n, 3): Where rays begin, and their directions.
        """
        axes = self.axes.T
        start, way = (points_m - self.center_m) @ axes, beams @ axes
        ahead = way[:, 2]
        along = -start[:, 2] / np.where(ahead == 0, -1e-300, ahead)
        x = 2 * (start[:, 0] + along * way[:, 0]) / self.width_m
        y = 2 * (start[:, 1] + along * way[:, 1]) / self.height_m
        inside = x**2 + y**2 <= 1 if self.is_round else (np.abs(x) <= 1) & (np.abs(y) <= 1)
        # From behind nothing enters.
        return float(np.mean(inside & (ahead < 0)))


@dataclass(frozen=True, slots=True)
class Errors:
    """Errors of a heliostat as they are measured.

    offset_rad: Systematic offset of the beam, right and up [rad].
    scatter_rad: Standard deviation of the beam about it, both directions together [rad].
    slope_rad: SD of the normals, both directions together [rad].
    canting_rad: RMS of the facets' canting, both directions together [rad].
    """

    offset_rad: tuple[float, float] = (0.0, 0.0)
    scatter_rad: float = 0.0
    slope_rad: float = 0.0
    canting_rad: float = 0.0

    def without(self, cause: str) -> "Errors":
        """Return them without one cause."""
        return self.with_size(cause, 0.0)

    def size(self, cause: str) -> float:
        """Return the size of one cause [rad]."""
        return float(np.hypot(*self.offset_rad)) if cause == "offset" else float(getattr(self, f"{cause}_rad"))

    def with_size(self, cause: str, size_rad: float) -> "Errors":
        """Return them with one cause of another size; an offset keeps its direction, and none goes to the right."""
        if cause == "scatter":
            return replace(self, scatter_rad=size_rad)
        if cause == "slope":
            return replace(self, slope_rad=size_rad)
        if cause == "canting":
            return replace(self, canting_rad=size_rad)
        length = self.size(cause)
        way = (1.0, 0.0) if length == 0 else (self.offset_rad[0] / length, self.offset_rad[1] / length)
        return replace(self, offset_rad=(size_rad * way[0], size_rad * way[1]))


CAUSES = ("offset", "scatter", "slope", "canting")


@dataclass(frozen=True, slots=True, eq=False)
class Mirror:
    """A mirror that aims at an aperture's centre.

    position_m (3,): Its middle [m].
    width_m, height_m: Its size [m].
    facets: Parts that are canted each on its own.
    """

    position_m: FloatArray
    width_m: float
    height_m: float
    focal_length_m: float
    facets: int = 1


@dataclass(frozen=True, slots=True, eq=False)
class SunYear:
    """A year's sunlight by the place of the sun.

    suns (n, 3): Directions to the sun.
    energy (n,): Energy of the direct light on a surface that faces the sun [Wh/m^2].
    name: Where the weights come from.
    """

    suns: FloatArray
    energy: FloatArray
    name: str


def gather(suns: FloatArray, energy: FloatArray, latitude_rad: float, name: str) -> SunYear:
    """Gather many moments of a year into cells of declination and hour angle.

    suns (n, 3): Directions to the sun.
    energy (n,): Energy of each moment [Wh/m^2].
    EstimationError: No light in the whole year.
    """
    lit = (energy > 0) & (suns[:, 2] > 0)
    if not lit.any():
        raise EstimationError("year: no moment with the sun above the horizon and light")
    suns, energy = suns[lit], energy[lit]
    pole = np.array([0.0, np.cos(latitude_rad), np.sin(latitude_rad)])
    height = np.clip(suns @ pole, -0.41, 0.41)
    south = np.array([0.0, -np.sin(latitude_rad), np.cos(latitude_rad)])
    hour = np.arctan2(suns[:, 0], suns @ south)
    rows = np.minimum(((height + 0.41) / 0.82 * _CELLS[0]).astype(int), _CELLS[0] - 1)
    columns = np.minimum(((hour + np.pi) / (2 * np.pi) * _CELLS[1]).astype(int), _CELLS[1] - 1)
    cell = rows * _CELLS[1] + columns
    count = _CELLS[0] * _CELLS[1]
    weight = np.bincount(cell, weights=energy, minlength=count)
    means = np.stack([np.bincount(cell, weights=energy * suns[:, k], minlength=count) for k in range(3)], axis=1)
    used = weight > 0
    means = means[used] / np.linalg.norm(means[used], axis=1, keepdims=True)
    return SunYear(means, np.asarray(weight[used], dtype=np.float64), name)


class YearTrace:
    """Rays of a mirror to an aperture for all suns of a year, the same ones for all errors."""

    def __init__(self, mirror: Mirror, aperture: Aperture, sun: SunShape, year: SunYear, seed: int = 0) -> None:
        from scipy.special import ndtri
        from scipy.stats import qmc

        self._mirror, self._aperture, self._year = mirror, aperture, year
        along = aperture.center_m - mirror.position_m
        self._along = along / np.linalg.norm(along)
        level = np.cross(self._along, [0.0, 0.0, 1.0])
        length = float(np.linalg.norm(level))
        if length < 1e-6:
            raise InputError("year: the aperture stands right above the heliostat")
        self._level = level / length
        self._rise = np.cross(self._level, self._along)
        middles = year.suns + self._along
        self._normals = middles / np.linalg.norm(middles, axis=1, keepdims=True)
        #: Cosine of incidence of each sun.
        self.cosines = np.sum(year.suns * self._normals, axis=1)
        self._frames = [_frame(normal) for normal in self._normals]
        self._draws: list[tuple[FloatArray, FloatArray, FloatArray, FloatArray]] = []
        #: Where rays begin and come from, for each drawing and sun.
        self._starts: list[list[tuple[FloatArray, FloatArray]]] = []
        facets = np.random.default_rng(seed).normal(size=(mirror.facets, 2))
        # The facets' own cantings have the RMS that was measured, without a mean that tracking would have.
        if mirror.facets > 1:
            facets = facets - facets.mean(axis=0)
            facets = facets / np.sqrt((facets**2).sum(axis=1).mean())
        else:
            facets = np.zeros((1, 2))
        for drawing in range(_DRAWINGS):
            unit = qmc.Sobol(8, seed=seed + drawing).random(_RAYS)
            place = (unit[:, :2] - 0.5) * [mirror.width_m, mirror.height_m]
            table = sun.inverse_table().astype(np.float64)
            radius = np.interp(np.sqrt(unit[:, 2]) * (table.size - 1), np.arange(table.size), table)
            turn = 2 * np.pi * unit[:, 3]
            disc = radius[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
            normal = ndtri(np.clip(unit[:, 4:8], 1e-9, 1 - 1e-9)) / np.sqrt(2)
            # Facets side by side along the width, as many rows as make them nearly square.
            rows = max(1, round(np.sqrt(mirror.facets * mirror.height_m / mirror.width_m)))
            while mirror.facets % rows:
                rows -= 1
            columns = mirror.facets // rows
            index = np.minimum((unit[:, 0] * columns).astype(int), columns - 1)
            index += columns * np.minimum((unit[:, 1] * rows).astype(int), rows - 1)
            self._draws.append((place, normal[:, :2], normal[:, 2:], facets[index]))
            self._starts.append([self._start(k, place, disc) for k in range(len(year.suns))])

    def intercepts(self, errors: Errors) -> tuple[FloatArray, FloatArray]:
        """Return the share of the reflected light that meets the aperture, for each drawing and sun.

        Returns (drawings, n) and (drawings,): by sun, and over the year.
        """
        suns, drawings = range(len(self._year.suns)), range(_DRAWINGS)
        each = np.array([[self._share(k, drawing, errors) for k in suns] for drawing in drawings])
        weight = self._year.energy * self.cosines
        return each, each @ weight / weight.sum()

    def energy_per_m2(self) -> float:
        """Return the energy that the mirror is offered over the year, cosine counted [Wh/m^2]."""
        return float(self._year.energy @ self.cosines)

    def _start(self, k: int, place: FloatArray, disc: FloatArray) -> tuple[FloatArray, FloatArray]:
        sun = self._year.suns[k]
        side, over = _frame(sun)[:2]
        rays = sun + disc[:, :1] * side + disc[:, 1:] * over
        across, upward, normal = self._frames[k]
        height = (place**2).sum(axis=1) / (4 * self._mirror.focal_length_m)
        points = self._mirror.position_m + place[:, :1] * across + place[:, 1:] * upward + height[:, None] * normal
        return points, rays / np.linalg.norm(rays, axis=1, keepdims=True)

    def _share(self, k: int, drawing: int, errors: Errors) -> float:
        place, slopes, scatter, canting = self._draws[drawing]
        points, rays = self._starts[drawing][k]
        steep = place / (2 * self._mirror.focal_length_m) + errors.slope_rad * slopes + errors.canting_rad * canting
        normals = self._frames[k][2] - steep @ self._frames[k][:2]
        # 2 (s.n) n / (n.n) - s: normals need not be of length one.
        turned = 2 * np.einsum("ij,ij->i", rays, normals) / np.einsum("ij,ij->i", normals, normals)
        stray = np.array(errors.offset_rad) + errors.scatter_rad * scatter
        beams = turned[:, None] * normals - rays + stray @ np.stack([self._level, self._rise])
        return self._aperture.share_inside(points, beams)


def _frame(normal: FloatArray) -> FloatArray:
    """Return an axis level across a direction, one up across both, and the direction, shape (3, 3)."""
    across = np.array([-normal[1], normal[0], 0.0])
    size = float(np.hypot(normal[0], normal[1]))
    across = across / size if size > 1e-9 else np.array([1.0, 0.0, 0.0])
    return np.stack([across, np.cross(normal, across), normal])
