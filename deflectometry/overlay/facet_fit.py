"""The turn of a facet from all photos: where to start, and why a photo is not used."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

import cv2
import numpy as np

from deflectometry.overlay.source_image import Source
from deflectometry.overlay.turn_fit import FARTHEST_RAD, FacetView, Seen, ViewTurn, turn_in_view
from heliogauge.geometry.surfaces import Facet
from heliogauge.validate import FloatArray

#: Turns are tried at steps of half of the source's half size, the least distance that an edge of it is off then being
#: a quarter of its size; at most so many a side.
_STEP, _MOST_STEPS = 0.5, 48
#: Of the turns tried, so many of the best valleys are followed.
_VALLEYS = 6
#: A turn that explains the light better by less than so many sigmas of the difference is not preferred: chance
#: reverses one in a hundred (one-sided).
_PREFERRED = 2.33
#: Ends that are apart by more than this share of the source's half size are not the same.
_APART = 0.1
#: What looks past the source's plane is put farther away than this.
_NOWHERE_M = 1e5
#: A source is brighter than its surround by no more than this over what a photo shows of both.
_BRIGHTEST = 1.5
#: A valley is followed down to steps of this share of the source's half size.
_FINEST = 0.03


class Unused(StrEnum):
    """Why the light of a facet in a photo is not used."""

    OUTSIDE = "too little of it in the photo"
    NO_EDGE = "no bright and dark part"
    DARKER = "bright part is no image of the source"
    EDGE_ALONG = "the edge tells no turn"
    FOREIGN = "light that is no image of the source, or a part in shade"
    CONTRADICTS = "contradicts the other photos"
    ALL_CONTRADICT = "photos contradict each other"
    AMBIGUOUS = "two turns explain the light"


@dataclass(frozen=True, slots=True, eq=False)
class FacetFit:
    """The turn of a facet as each photo shows it.

    turns: Of the photos that are used.
    unused: Why others are not, by their numbers.
    rivals_rad (2, 2): Two turns that explain the light equally well; None where a photo decides.
    """

    turns: Sequence[ViewTurn] = ()
    unused: Mapping[int, Unused] = field(default_factory=dict)
    rivals_rad: FloatArray | None = None


def fit_facet(
    facet: Facet,
    views: Sequence[FacetView],
    source: Source,
    start_rad: FloatArray | None,
    surveyed: Collection[int] = (),
) -> FacetFit:
    """Fit the turn of a facet in each photo that shows part of it bright and part of it dark.

    start_rad (2,): Where to start; None: it is searched for.
    surveyed: Numbers of the photos of which the camera's place is known: a turn that explains one explains all of them.
    """
    unused = {one.photo: Unused.NO_EDGE for one in views if not one.shows_source}
    used = [one for one in views if one.shows_source]
    together = [one for one in used if one.photo in surveyed]
    fitted: list[ViewTurn] = []
    rivals = None
    for group in filter(None, (together, *([one] for one in used if one.photo not in surveyed))):
        starts = common_turns(facet, group, source) if start_rad is None else start_rad[None]
        if len(starts) > 1:
            rivals = starts
            unused |= {one.photo: Unused.AMBIGUOUS for one in group}
            continue
        for one in group:
            found = turn_in_view(facet, one, source, starts[0]) if len(starts) else None
            # A source that is darker than what is beside it is a fit that went astray.
            if found is None or found.gain_dn <= 0:
                unused[one.photo] = Unused.DARKER
            else:
                fitted.append(found)
    return FacetFit(fitted, unused, None if fitted else rivals)


def common_turns(facet: Facet, views: Sequence[FacetView], source: Source) -> FloatArray:
    """Return the turn of a facet that explains its light in all given photos, and one that does so as well, if any.

    Turns are tried on a grid; brightness of source and surround are linear and solved for at each. The best valleys
    are followed down. Whether one end is better than another is Vuong's test (Econometrica 57 (1989) 307), by squares
    of pixels, which share waves of the facet.

    Returns: Shape (n, 2) [rad], n is 0 where no turn makes the source brighter than what is beside it.
    """
    views = [one.only(one.some()) for one in views]
    about = [Seen.of(facet, one, source, np.zeros(2)) for one in views]
    grid = _grid(about, source)
    if grid is None:
        return np.zeros((0, 2))
    ends = []
    for turn in grid.valleys(about, source):
        seen = [Seen.of(facet, one, source, turn) for one in views]
        turn, fine = grid.refined(seen, source, turn)
        ends.append((fine.explained(seen, source, turn[None, None]).item(), turn, fine.squares(seen, source, turn)))
    if not ends:
        return np.zeros((0, 2))
    ends.sort(key=lambda one: -one[0])
    _, best, squares = ends[0]
    apart_rad = _APART * min(source.half_m) / np.mean([one.reach_m for one in about])
    for _, other, of_other in ends[1:]:
        if np.linalg.norm(other - best) > apart_rad and _sigmas(of_other - squares) < _PREFERRED:
            return np.array([best, other])
    return best[None]


@dataclass(frozen=True, slots=True, eq=False)
class _Grid:
    """Shifts of what a facet sees in the source's plane, and the turns that make them.

    lines_m: Shifts along x and along y. turn_by_shift (2, 2): Of all photos together [rad/m].
    step_m (2,): Distance of two shifts. blur_m: Blur that goes with it.
    """

    lines_m: tuple[FloatArray, FloatArray]
    turn_by_shift: FloatArray
    step_m: FloatArray
    blur_m: float

    def turns(self, lines_m: tuple[FloatArray, FloatArray]) -> FloatArray:
        """Return the turns of shifts along x and along y, shape (h, w, 2) [rad]."""
        return np.stack(np.meshgrid(*lines_m), axis=-1) @ self.turn_by_shift.T

    def explained(self, seen: Sequence[Seen], source: Source, turns_rad: FloatArray) -> FloatArray:
        """Return by how much the best levels lessen squares over noise at each turn (h, w, 2), shape (h, w)."""
        found = np.zeros(turns_rad.shape[:2])
        for one in seen:
            for row, turns in enumerate(turns_rad):
                places = one.places_m[:, None] + np.einsum("ant,kt->akn", one.by_turn, turns - one.about_rad)
                light, share, gain = self._levels(one, source, places)
                less = gain * (2 * share @ light - gain * np.sum(share**2, axis=1))
                found[row] += less / one.view.noise_dn**2
        return found

    def valleys(self, seen: Sequence[Seen], source: Source) -> list[FloatArray]:
        """Return the turns that explain the light better than those beside them, the best first."""
        turns = self.turns(self.lines_m)
        explained = self.explained(seen, source, turns)
        explained[np.linalg.norm(turns, axis=2) > FARTHEST_RAD] = 0.0
        rows, columns = np.nonzero((explained > 0) & (explained >= cv2.dilate(explained, np.ones((3, 3), np.uint8))))
        order = np.argsort(-explained[rows, columns])[:_VALLEYS]
        return [turns[rows[k], columns[k]] for k in order]

    def refined(self, seen: Sequence[Seen], source: Source, turn_rad: FloatArray) -> tuple[FloatArray, "_Grid"]:
        """Return the turn at the bottom of a valley, to a share of the source's size, and the grid that is as fine."""
        fine = self
        while fine.step_m.min() > _FINEST * min(source.half_m):
            beside = turn_rad + self.turns((*(fine.step_m[:, None] * np.array([-1, 0, 1])),))
            explained = fine.explained(seen, source, beside)
            if explained.max() > explained[1, 1]:
                turn_rad = beside[np.unravel_index(np.argmax(explained), (3, 3))]
            else:
                fine = replace(fine, step_m=0.5 * fine.step_m, blur_m=0.5 * fine.blur_m)
        return turn_rad, fine

    def squares(self, seen: Sequence[Seen], source: Source, turn_rad: FloatArray) -> FloatArray:
        """Return what is left of the light at a turn, squared over noise: sums over squares of pixels of all photos."""
        found = []
        for one in seen:
            light, share, gain = self._levels(one, source, one.places(turn_rad)[:, None])
            left = (light - gain[0] * share[0]) / one.view.noise_dn
            found.append(np.bincount(one.view.squares, left**2))
        return np.concatenate(found)

    def _levels(self, one: Seen, source: Source, places_m: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return light (n,) and share of the source (k, n) less their means, and the best gain (k,).

        A gain below 0 would make the source darker than what is beside it, a large one light of what is hardly seen.
        """
        light = one.view.light_dn - one.view.light_dn.mean()
        share = source.brightness(places_m.reshape(2, -1), self.blur_m).reshape(places_m.shape[1:])
        share = share - share.mean(axis=1, keepdims=True)
        low, high = one.view.range_dn
        gain = share @ light / np.maximum(np.sum(share**2, axis=1), 1e-300)
        return light, share, np.clip(gain, 0, _BRIGHTEST * (high - low))


def _grid(seen: Sequence[Seen], source: Source) -> _Grid | None:
    """Return a grid over all turns that show some of the source in some photo; None where none does."""
    half = np.array(source.half_m)
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for one in seen:
        places = one.places_m[:, np.abs(one.places_m).max(axis=0) < _NOWHERE_M]
        if places.size:
            low, high = np.minimum(low, -half - places.max(axis=1)), np.maximum(high, half - places.min(axis=1))
    if not np.isfinite(low).all():
        return None
    counts = np.clip(np.ceil((high - low) / (_STEP * half)), 1, _MOST_STEPS).astype(int)
    step = (high - low) / counts
    x, y = (np.linspace(a, b, count + 1) for a, b, count in zip(low, high, counts, strict=True))
    by_turn = np.mean([np.median(one.by_turn, axis=1) for one in seen], axis=0)
    return _Grid((x, y), np.linalg.inv(by_turn), step, 0.5 * float(step.min()))


def _sigmas(change: FloatArray) -> float:
    """Return a sum over its standard deviation by the scatter of its terms."""
    return float(change.sum() / max(np.sqrt(np.sum(change**2)), 1e-300))
