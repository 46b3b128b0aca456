"""Targets without a code followed from photo to photo, from marks that somebody set by hand in one of them."""

from dataclasses import dataclass, field
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.errors import EstimationError, InputError
from heliogauge.flags import SampleFlag
from heliogauge.validate import BoolArray, Float32Array, FloatArray, float_array
from photogrammetry.centers.measured_centers import measure_center
from photogrammetry.centers.target_center import TargetCenter
from photogrammetry.detection.detect import Candidate, find_candidates
from photogrammetry.detection.detections import Detections
from photogrammetry.detection.photo_targets import TargetSearch
from photogrammetry.start_values.network import LeftOut

#: The search radius on the coarse image: so many pixels.
_COARSE_RADIUS_PX = 12.0
#: Half size of a coarse template, at least: it must hold surroundings, because targets look alike [px].
_COARSE_HALF_PX = 9
#: Least number of targets that determine a common motion.
_LEAST_COMMON = 4


@dataclass(frozen=True, slots=True)
class TrackLimits:
    """How far targets may move and how much they may change from one photo to the next.

    search_radius_px: Farthest movement between two photos [px].
    least_correlation: Normalised correlation of a target and its surroundings with those in the photo before.
    most_growth: Factor by which its radius may change.
    InputError: Values that make no sense.
    """

    search_radius_px: float = 100.0
    least_correlation: float = 0.5
    most_growth: float = 1.5

    def __post_init__(self) -> None:
        if not (self.search_radius_px >= 4 and 0 < self.least_correlation < 1 and self.most_growth > 1):
            raise InputError(
                "tracking: search_radius_px >= 4, 0 < least_correlation < 1 and most_growth > 1 are needed, not "
                f"{self.search_radius_px:g}, {self.least_correlation:g} and {self.most_growth:g}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Where the targets are in the photo last seen.

    names length n: Their names.
    places_px (n, 2): Where they are or, if lost, should be [px].
    radius_px (n,): Radius of each [px].
    dark (n,): Whether each is darker than its ground.
    image_dn (h, w): The photo.
    search: Sizes, contrast, estimator.
    limits: How far they may move.
    """

    names: tuple[str, ...]
    places_px: FloatArray
    radius_px: FloatArray
    dark: BoolArray
    image_dn: npt.NDArray[np.generic]
    search: TargetSearch
    limits: TrackLimits


@dataclass(frozen=True, slots=True, eq=False)
class TrackedPhoto:
    """The targets in one photo.

    detections: Centres; lost targets have the flag NOT_SEEN and no place.
    ellipses_px2 (n, 2, 2): Their ellipses; NaN where lost [px^2].
    lost: Targets that were lost, and why.
    """

    detections: Detections
    ellipses_px2: FloatArray
    lost: tuple[LeftOut, ...]


@dataclass(slots=True)
class _Found:
    """Centres of some targets while they are collected; reasons for the others."""

    centers: dict[int, TargetCenter] = field(default_factory=dict)
    reasons: dict[int, str] = field(default_factory=dict)


def start_track(
    image_dn: npt.NDArray[np.generic],
    photo: str,
    names: tuple[str, ...],
    places_px: FloatArray,
    search: TargetSearch,
    limits: TrackLimits | None = None,
) -> tuple[Track, TrackedPhoto]:
    """Start from marks set by hand.

    Shapes: image_dn (h, w).
    places_px (n, 2): Where the marks of these names are, each within its target [px].
    search: Sizes, contrast, estimator of the centres.
    limits: How far targets may move between photos.
    InputError: A name twice, or a mark outside the photo or on no target.
    """
    places = float_array("marks", places_px, (len(names), 2))
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"marks in {photo}: {twice} is marked twice")
    height, width = image_dn.shape
    outside = ~((places > -0.5) & (places < np.array([width, height]) - 0.5)).all(axis=1)
    if outside.any():
        k = int(np.argmax(outside))
        raise InputError(
            f"marks in {photo}: {names[k]} at ({places[k, 0]:.0f}, {places[k, 1]:.0f}) is outside of "
            f"{width} x {height} px"
        )
    spots = find_candidates(image_dn, search.limits)
    found, owner = _Found(), dict[int, str]()
    for k, (name, place) in enumerate(zip(names, places, strict=True)):
        spot = _find_spot(spots, place)
        if spot is None:
            raise InputError(
                f"marks in {photo}: there is no round target under {name} at ({place[0]:.0f}, {place[1]:.0f}); are x "
                "and y in pixels from the top left, and [targets] smallest_px, largest_px and polarity right?"
            )
        if spot in owner:
            raise InputError(f"marks in {photo}: {owner[spot]} and {name} are on one target")
        owner[spot] = name
        _measure(found, k, image_dn, spots[spot], search)
    radius = np.array([spots[spot].ellipse.radius_px for spot in owner])
    dark = np.array([spots[spot].inside_dn < spots[spot].outside_dn for spot in owner])
    track = Track(names, places, radius, dark, image_dn, search, limits or TrackLimits())
    return _renew_track(track, image_dn, places, found), _collect(track, photo, found)


def follow(track: Track, image_dn: npt.NDArray[np.generic], photo: str) -> tuple[Track, TrackedPhoto]:
    """Find the targets in the next photo.

    image_dn (h, w): The next photo, of the same size [DN].
    Returns: Where they are, and the centres. Lost targets are looked for again in later photos, where the others'
        motion puts them.
    InputError: The photo has another size.

    On a coarse image each target is found with its surroundings by normalised correlation within the search radius;
    the others' common motion (an affine map, robust) replaces what contradicts it. There the nearest round spot of
    the same polarity and of about the same size is measured by the centre estimator, if no other target is as near
    and no other spot is in reach. Targets lost so far are looked for once more where the motion of those found puts
    them.
    """
    if image_dn.shape != track.image_dn.shape:
        raise InputError(
            f"{photo}: has {image_dn.shape[1]} x {image_dn.shape[0]} px, but the photo before "
            f"{track.image_dn.shape[1]} x {track.image_dn.shape[0]}; targets are followed through photos of one size"
        )
    predicted, scores, slack = _predict(track, image_dn)
    spots = find_candidates(image_dn, track.search.limits)
    found = _Found()
    claims: dict[int, list[tuple[float, int]]] = {}
    for k in range(len(track.names)):
        spot, far = _choose_spot(track, k, spots, predicted[k], slack)
        if scores[k] < track.limits.least_correlation:
            found.reasons[k] = f"its surroundings correlate by {scores[k]:.2f} only with the photo before"
        elif isinstance(spot, str):
            found.reasons[k] = spot
        else:
            claims.setdefault(spot, []).append((far, k))
    for spot, own in claims.items():
        own.sort()
        clear = len(own) == 1 or own[0][0] < 0.5 * own[1][0]
        for place, (_, k) in enumerate(own):
            if place == 0 and clear:
                _measure(found, k, image_dn, spots[spot], track.search)
            else:
                other = track.names[own[0][1] if place else own[1][1]]
                found.reasons[k] = f"it and {other} lead to the same target"
    predicted = _look_again(track, image_dn, spots, set(claims), predicted, found)
    return _renew_track(track, image_dn, predicted, found), _collect(track, photo, found)


def _look_again(
    track: Track,
    image_dn: npt.NDArray[np.generic],
    spots: tuple[Candidate, ...],
    taken: set[int],
    predicted: FloatArray,
    found: _Found,
) -> FloatArray:
    """Look for lost targets where the motion of the found ones puts them; return the better predictions."""
    own, lost = sorted(found.centers), sorted(found.reasons)
    if len(own) < _LEAST_COMMON or not lost:
        return predicted
    moved = predicted.copy()
    moved[own] = [found.centers[k].center_px for k in own]
    good = np.zeros(len(track.names), dtype=np.bool_)
    good[own] = True
    common, _ = _common_motion(track.places_px, moved, good)
    slack = 3 * float(np.sqrt(np.mean((moved - common)[own] ** 2))) + 2
    better = np.where(good[:, None], predicted, common)
    free = tuple(spot for k, spot in enumerate(spots) if k not in taken)
    for k in lost:
        spot, _ = _choose_spot(track, k, free, better[k], slack)
        if not isinstance(spot, str):
            found.reasons.pop(k)
            _measure(found, k, image_dn, free[spot], track.search)
    return better


def _find_spot(spots: tuple[Candidate, ...], place: FloatArray) -> int | None:
    """Return the spot whose ellipse holds a place, the nearest of several."""
    best: tuple[float, int] | None = None
    for k, spot in enumerate(spots):
        off = place - spot.ellipse.center_px
        inside = float(off @ np.linalg.solve(spot.ellipse.shape_px2, off))
        if inside < 1.5 and (best is None or inside < best[0]):
            best = (inside, k)
    return None if best is None else best[1]


def _measure(found: _Found, k: int, image_dn: npt.NDArray[np.generic], spot: Candidate, search: TargetSearch) -> None:
    try:
        found.centers[k] = measure_center(image_dn, spot.ellipse)
    except EstimationError as error:
        found.reasons[k] = str(error)


def _choose_spot(
    track: Track, k: int, spots: tuple[Candidate, ...], place: FloatArray, slack: float
) -> tuple[int | str, float]:
    """Return the one spot that fits a target near a place, or why there is none; and how far it is."""
    reach = slack + track.radius_px[k]
    near = []
    for index, spot in enumerate(spots):
        far = float(np.linalg.norm(spot.ellipse.center_px - place))
        growth = abs(np.log(spot.ellipse.radius_px / track.radius_px[k]))
        if (
            far < reach
            and growth < np.log(track.limits.most_growth)
            and ((spot.inside_dn < spot.outside_dn) == track.dark[k])
        ):
            near.append((far, index))
    if not near:
        return f"no round target within {reach:.0f} px of where it should be", 0.0
    near.sort()
    if len(near) > 1 and near[1][0] < 2 * near[0][0] + 2:
        return f"two targets within {near[1][0]:.0f} px of where it should be", 0.0
    return near[0][1], near[0][0]


class _Prediction(NamedTuple):
    """Where targets should be, (n, 2), correlations, (n,), and how far off the places may be [px]."""

    places_px: FloatArray
    scores: FloatArray
    slack_px: float


def _predict(track: Track, image_dn: npt.NDArray[np.generic]) -> _Prediction:
    shrink = max(track.limits.search_radius_px / _COARSE_RADIUS_PX, 1.0)
    before, now = _coarse(track.image_dn, shrink), _coarse(image_dn, shrink)
    places = (track.places_px + 0.5) / shrink - 0.5
    moved, scores = np.empty_like(places), np.empty(len(places))
    reach = int(np.ceil(track.limits.search_radius_px / shrink))
    for k, place in enumerate(places):
        half = max(_COARSE_HALF_PX, round(3 * track.radius_px[k] / shrink))
        moved[k], scores[k] = _correlate(before, now, place, (half, reach))
    slack = 2.0 * shrink
    good = scores >= track.limits.least_correlation
    if np.count_nonzero(good) >= _LEAST_COMMON:
        common, agree = _common_motion(places, moved, good)
        moved = np.where(agree[:, None], moved, common)
        # A target behind something for a moment keeps going with the others.
        scores = np.where(agree, scores, np.maximum(scores, track.limits.least_correlation))
    return _Prediction((moved + 0.5) * shrink - 0.5, scores, slack)


def _coarse(image_dn: npt.NDArray[np.generic], shrink: float) -> Float32Array:
    size = (max(round(image_dn.shape[1] / shrink), 1), max(round(image_dn.shape[0] / shrink), 1))
    return np.asarray(cv2.resize(image_dn.astype(np.float32), size, interpolation=cv2.INTER_AREA), dtype=np.float32)


def _correlate(
    before: Float32Array, now: Float32Array, place: FloatArray, sizes: tuple[int, int]
) -> tuple[FloatArray, float]:
    """Find one place again by normalised correlation of its surroundings, to a fraction of a coarse pixel."""
    half, reach = sizes
    height, width = before.shape
    x, y = (int(np.clip(round(float(v)), 0, n - 1)) for v, n in zip(place, (width, height), strict=True))
    left, top, right, bottom = max(x - half, 0), max(y - half, 0), min(x + half + 1, width), min(y + half + 1, height)
    template = before[top:bottom, left:right]
    first = max(left - reach, 0), max(top - reach, 0)
    window = now[first[1] : min(bottom + reach, height), first[0] : min(right + reach, width)]
    if template.size < 9 or float(template.std()) == 0:
        return place.copy(), 0.0
    scores = cv2.matchTemplate(window, np.ascontiguousarray(template), cv2.TM_CCOEFF_NORMED)
    _, best, _, (column, row) = cv2.minMaxLoc(scores)
    shift = np.array(
        [
            first[0] + column + _vertex(scores[row], column) - left,
            first[1] + row + _vertex(scores[:, column], row) - top,
        ]
    )
    return place + shift, float(best)


def _vertex(scores: npt.NDArray[np.generic], index: int) -> float:
    """Offset of the vertex of the parabola through a maximum and its neighbours."""
    if index in (0, len(scores) - 1):
        return 0.0
    low, middle, high = (float(scores[index + k]) for k in (-1, 0, 1))
    bend = low - 2 * middle + high
    return 0.5 * (low - high) / bend if bend < 0 else 0.0


def _common_motion(places: FloatArray, moved: FloatArray, good: BoolArray) -> tuple[FloatArray, BoolArray]:
    """Fit an affine motion to most targets; return where it puts all, and which agree with it to three coarse px."""
    design = np.column_stack([places, np.ones(len(places))])
    weights = good.astype(np.float64)
    common = places
    for _ in range(8):
        # A share of 1e-3 of a shift without turning keeps few or collinear targets solvable.
        normal = design.T @ (weights[:, None] * design) + 1e-3 * np.diag([1.0, 1.0, 0.0])
        right = design.T @ (weights[:, None] * (moved - places))
        common = places + design @ np.linalg.lstsq(normal, right, rcond=None)[0]
        off = np.linalg.norm(moved - common, axis=1)
        typical = max(float(np.median(off[good])), 0.3)
        weights = good / (1 + (off / (2 * typical)) ** 2) ** 2
    return common, np.asarray(good & (np.linalg.norm(moved - common, axis=1) < 3.0))


def _renew_track(track: Track, image_dn: npt.NDArray[np.generic], predicted: FloatArray, found: _Found) -> Track:
    """Return the track with the photo just seen."""
    places, radius = predicted.copy(), track.radius_px.copy()
    for k, center in found.centers.items():
        places[k], radius[k] = center.center_px, center.ellipse.radius_px
    return Track(track.names, places, radius, track.dark, image_dn, track.search, track.limits)


def _collect(track: Track, photo: str, found: _Found) -> TrackedPhoto:
    n = len(track.names)
    pixels, covariance, shapes = np.full((n, 2), np.nan), np.full((n, 2, 2), np.nan), np.full((n, 2, 2), np.nan)
    flags = np.full(n, int(SampleFlag.NOT_SEEN), dtype=np.uint32)
    for k, center in found.centers.items():
        pixels[k], covariance[k], shapes[k] = center.center_px, center.covariance_px2, center.ellipse.shape_px2
        flags[k] = 0
    radius = np.sqrt(np.sqrt(np.linalg.det(np.nan_to_num(shapes))))
    radius[flags != 0] = np.nan
    detections = Detections(photo, track.names, pixels, covariance, radius, flags)
    lost = tuple(
        LeftOut(f"target {track.names[k]} in {photo}", f"lost: {found.reasons[k]}") for k in sorted(found.reasons)
    )
    return TrackedPhoto(detections, shapes, lost)
