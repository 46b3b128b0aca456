"""The same numbers for the dots of all photos: every turn and shift of each lattice is a hypothesis with its odds."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from deflectometry.dots.found_dots import FoundDots
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.slopes.map import monomials
from heliogauge.validate import FloatArray, IntArray

#: Chance that a dot that is on one photo's lattice, and in the sight of another, is missing there.
_FALSE_DOT = 1e-3
#: How well the place of a photo's lattice in that of another one is known, in distances of dots: poses from a few
#: corners are good to a tenth of it.
_SIGMA_PLACE = 0.15
#: How far the field may stand before or behind the plane of the targets, 1 sigma and at most, in distances of dots.
_SIGMA_DEPTH, _MOST_DEPTH = 2.0, 6.0
_DEPTH_STEP = 0.1
#: Dots that say where a photo's lattice is: so many say it ten times better than one.
_FEW_DOTS = 200
#: Columns and rows that a photo must show: `_Lattice` is of third order, which fewer leave open.
_FEWEST_LINES = 4
#: Numbering with less probability is refused.
_SURE = 0.99


@dataclass(frozen=True, slots=True, eq=False)
class DotView:
    """The dots of one photo, and what it was taken with.

    dots: Numbered by the photo's own lattice, rows downwards.
    """

    photo: str
    dots: FoundDots
    camera: Camera
    cam_from_world: RigidTransform


def number_alike(views: Sequence[DotView], targets_m: FloatArray) -> tuple[IntArray, ...]:
    """Give a dot the same number in all photos: columns to the right and rows upwards as the first photo has them.

    targets_m (n, 3): Points near the surface of the field: the targets around it [m].
    Returns: Numbers (k, 2) of each photo's dots.
    EstimationError: A photo that shows another field or a few dots, or two numberings that are equally likely.

    A field of dots looks alike when it is shifted by one and moved in depth. The hypotheses are the depths of the field
    before and behind the targets' plane: for each, the lattices of all photos must be whole numbers apart; dots that
    one photo should show and does not make a hypothesis unlikely, and so does its depth.
    """
    for view in views:
        columns, rows = (len(np.unique(one)) for one in view.dots.number.T)
        if min(columns, rows) < _FEWEST_LINES:
            raise EstimationError(
                f"{view.photo}: it shows {columns} columns and {rows} rows of dots; {_FEWEST_LINES} of each are needed "
                "to tell which dot of one photo is which of another"
            )
    plane = _plane(targets_m, views)
    every, views = views, [_thinned(view) for view in views]
    first = views[0]
    spacing_m = _spacing(plane.places(first), first.dots.number)
    depths = np.arange(-_MOST_DEPTH, _MOST_DEPTH + 1e-9, _DEPTH_STEP) * spacing_m
    turns = [np.eye(2, dtype=np.intp), *(_turn(plane, first, view) for view in views[1:])]
    best: dict[tuple[int, ...], float] = {}
    sights_of = [plane.sights(view) for view in views]
    for depth in depths.tolist():
        own = _Lattice.of(sights_of[0].places(depth), first.dots.number)
        shifts, misfit = [], (depth / spacing_m / _SIGMA_DEPTH) ** 2
        for view, turn, sight in zip(views[1:], turns[1:], sights_of[1:], strict=True):
            away = np.median(own.number_at(sight.places(depth)) - view.dots.number @ turn.T, axis=0)
            whole = np.rint(away).astype(np.intp)
            misfit += float(np.sum((away - whole) ** 2)) / _SIGMA_PLACE**2
            shifts += whole.tolist()
        odds = -0.5 * misfit
        key = tuple(shifts)
        if odds > best.get(key, -np.inf):
            best[key] = odds
    keys = list(best)
    shifted = [np.array(key, dtype=np.intp).reshape(-1, 2) for key in keys]
    numbers = [
        [every[0].dots.number]
        + [one.dots.number @ turn.T + by for one, turn, by in zip(every[1:], turns[1:], each, strict=True)]
        for each in shifted
    ]
    sights = [_Sight.of(view) for view in every]
    odds_of = np.array([best[key] + _of_missing(sights, each) for key, each in zip(keys, numbers, strict=True)])
    weight = np.exp(odds_of - odds_of.max())
    weight /= weight.sum()
    if weight.max() < _SURE:
        raise EstimationError(
            f"which dot of one photo is which of another is not decided ({len(keys)} numberings, the likeliest has a "
            f"probability of {weight.max():.2f}); take photos that show the whole field with its edges"
        )
    chosen = numbers[int(np.argmax(weight))]
    upwards = np.array([1, -1])
    return tuple(np.asarray(one * upwards) for one in chosen)


def _thinned(view: DotView) -> DotView:
    """Return the same with few of its dots: what is fitted to a lattice is smooth."""
    chosen = np.linspace(0, len(view.dots.number) - 1, min(len(view.dots.number), _FEW_DOTS)).astype(np.intp)
    return replace(view, dots=view.dots.chosen(chosen))


@dataclass(frozen=True, slots=True, eq=False)
class _Sight:
    """Where a photo should show a dot of a number in its own lattice."""

    view: DotView
    lattice: "_Lattice"
    margin_px: float

    @classmethod
    def of(cls, view: DotView) -> "_Sight":
        few = _thinned(view).dots
        return cls(view, _Lattice.of(few.number.astype(np.float64), few.centers_px), 2.0 * view.dots.spacing_px)

    def count_seen(self, number: IntArray) -> int:
        """Return how many dots of these numbers of its own lattice the photo should show."""
        place = self.lattice.number_at(number.astype(np.float64))
        size = np.array([self.view.camera.width_px, self.view.camera.height_px])
        return int(np.count_nonzero(((place > self.margin_px) & (place < size - self.margin_px)).all(axis=1)))


def _of_missing(sights: Sequence[_Sight], numbers: Sequence[IntArray]) -> float:
    """Return the log of the odds of dots that a photo should show, by those around, and does not."""
    every = np.concatenate(numbers)
    low = every.min(axis=0)
    seen = np.zeros((len(numbers), *(every.max(axis=0) - low + 1)), dtype=np.bool_)
    for own, one in zip(seen, numbers, strict=True):
        own[tuple((one - low).T)] = True
    in_any = seen.any(axis=0)
    total = 0
    for sight, own, number in zip(sights, seen, numbers, strict=True):
        missing = np.argwhere(in_any & ~own) + low
        if len(missing):
            # Numbers of the photo's own lattice: a quarter turn and a shift of these.
            turned = np.column_stack([number, np.ones(len(number))])
            change = np.linalg.lstsq(turned, sight.view.dots.number, rcond=None)[0]
            total += sight.count_seen(
                np.rint(np.column_stack([missing, np.ones(len(missing))]) @ change).astype(np.intp)
            )
    return total * float(np.log(_FALSE_DOT))


@dataclass(frozen=True, slots=True, eq=False)
class _Lattice:
    """A smooth map from places to numbers, of third order: lenses and bent screens."""

    middle: FloatArray
    scale: float
    coefficients: FloatArray

    @classmethod
    def of(cls, places: FloatArray, numbers: FloatArray | IntArray) -> "_Lattice":
        middle = places.mean(axis=0)
        scale = float(np.abs(places - middle).max())
        x, y = ((places - middle) / scale).T
        terms = monomials(x, y, 3)
        found = np.linalg.lstsq(terms.T, np.asarray(numbers, dtype=np.float64), rcond=None)[0]
        return cls(middle, scale, np.asarray(found, dtype=np.float64))

    def number_at(self, places: FloatArray) -> FloatArray:
        """Return the numbers at places, shape (n, 2)."""
        x, y = ((places - self.middle) / self.scale).T
        return np.asarray(monomials(x, y, 3).T @ self.coefficients)


@dataclass(frozen=True, slots=True, eq=False)
class _Plane:
    """The plane near which targets and dots are: a point, two axes, and the normal towards the cameras."""

    middle_m: FloatArray
    axes: FloatArray

    def sights(self, view: DotView) -> "_LinesOfSight":
        """Return the lines of sight of a photo's dots, in the plane's axes."""
        world_from_cam = view.cam_from_world.inverse()
        rays = world_from_cam.rotate(view.camera.cast_rays(view.dots.centers_px))
        return _LinesOfSight(self.axes @ (world_from_cam.translation_m - self.middle_m), rays @ self.axes.T)

    def places(self, view: DotView) -> FloatArray:
        """Return where the lines of sight of a photo's dots meet the plane, shape (n, 2) [m]."""
        return self.sights(view).places(0.0)


@dataclass(frozen=True, slots=True, eq=False)
class _LinesOfSight:
    """Lines of sight (n, 3) from one place (3,), in the axes of a plane through the origin."""

    start_m: FloatArray
    rays: FloatArray

    def places(self, depth_m: float) -> FloatArray:
        """Return where they meet the plane moved by a depth, shape (n, 2) [m]."""
        along = (depth_m - self.start_m[2]) / self.rays[:, 2]
        return np.asarray(self.start_m[:2] + along[:, None] * self.rays[:, :2])


def _plane(points_m: FloatArray, views: Sequence[DotView]) -> _Plane:
    """Return the plane that most of the points are near, with x to the right and y up in the first photo."""
    if len(points_m) < 3:
        raise EstimationError(f"{len(points_m)} targets around the field of dots; 3 are needed to find its plane")
    # Few points: all triples of at most 24 of them, judged by the median distance of all.
    spread = points_m[np.linspace(0, len(points_m) - 1, min(len(points_m), 24)).astype(int)]
    a, b, c = spread[np.array(list(combinations(range(len(spread)), 3)))].transpose(1, 0, 2)
    across = np.cross(b - a, c - a)
    length = np.linalg.norm(across, axis=1)
    on_line = length < 1e-3 * float(np.ptp(points_m, axis=0).max()) ** 2
    normals = across / np.where(on_line, 1.0, length)[:, None]
    heights = np.abs(normals @ points_m.T - np.einsum("ti,ti->t", normals, a)[:, None])
    medians = np.where(on_line, np.inf, np.median(heights, axis=1))
    chosen = int(np.argmin(medians))
    best, normal, through = float(medians[chosen]), normals[chosen], a[chosen]
    if not np.isfinite(best):
        raise EstimationError("the targets around the field of dots are on a line; put some beside it")
    first = views[0].cam_from_world
    if normal @ (first.inverse().translation_m - through) < 0:
        normal = -normal
    right = first.rotation[0] - (first.rotation[0] @ normal) * normal
    right /= np.linalg.norm(right)
    return _Plane(through, np.stack([right, np.cross(normal, right), normal]))


def _spacing(places_m: FloatArray, number: IntArray) -> float:
    """Return the usual distance of neighbouring dots [m]."""
    affine = np.linalg.lstsq(np.column_stack([np.ones(len(number)), number]), places_m, rcond=None)[0][1:]
    return float(np.sqrt(abs(np.linalg.det(affine))))


def _turn(plane: _Plane, first: DotView, view: DotView) -> IntArray:
    """Return the quarter turn that takes a photo's columns and rows to those of the first."""
    by = []
    for one in (first, view):
        number = np.column_stack([np.ones(len(one.dots.number)), one.dots.number])
        by.append(np.linalg.lstsq(number, plane.places(one), rcond=None)[0][1:].T)
    turn = np.linalg.solve(by[0], by[1])
    whole = np.rint(turn)
    if np.abs(turn - whole).max() > 0.3 or abs(float(np.linalg.det(whole)) - 1.0) > 1e-9:
        raise EstimationError(
            f"{view.photo}: its dots are not the field of {first.photo} (rows and columns differ); do both photos show "
            "the same wall, and is neither mirrored?"
        )
    return whole.astype(np.intp)
