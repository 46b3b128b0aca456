"""The absorber's reflection in one photo: where its two edges lie on the mirror, as far as geometry allows them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from heliogauge.validate import BoolArray, FloatArray, IntArray
from observer.photo_edges.edges import Edges, find_edges
from observer.photo_edges.rectify import Strip, rectified_strip
from observer.photo_edges.views import Shot
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector
from observer.trough.expectation import Expectation
from observer.trough.observation_equation import Misfit, Sights, beside_axis, misfit

#: Samples across the trough for each pixel of the photo. With one, what is interpolated between pixels is blurred by
#: where it lies among them: edges of a whole photo were up to 0.07 px elsewhere, all alike, as the first sample moved.
_SAMPLES_PER_PIXEL = 2
#: Narrower parts of the mirror show nothing [px].
_FEWEST_PX = 24
#: Near the end of the tube or a support the slope along the trough, unknown to some mrad, decides what is seen [m].
_END_MARGIN_M = 0.04
#: Edges with at least this contrast, and so many of them, show how dark the tube is.
_CLEAR_CONTRAST = 0.4
_CLEAR_EDGES = 30
#: This share of their dark sides is darker than the tube: by noise and blur.
_DARKEST_SHARE = 0.1
#: The tube's side of an edge may be brighter than the tube by this share of the step: blur, weak images in the glass.
_DARK_SHARE = 0.2
#: Profiles of edges reach so far [px], and are taken where the brightness beside the edge changes by less than this
#: share of its step.
_PROFILE_PX, _PROFILE_UNEVEN = 6, 0.05
#: Distances on both sides of an edge between which the brightness should not change any more [px].
_EVEN_PX = (4.0, 6.0)
#: An edge that is further from the nearer edge of the tube than this share of half the tube's width may be the other.
_FAR_SHARE = 0.5
#: ... with slopes up to so many times the largest: where the absorber really is was not yet known.
_BEYOND_TIMES = 1.25
#: Whether the tube is darker or brighter is clear where so much more of all steps go one way than the other.
_CLEAR_MAJORITY = 0.5
#: Where the brightness beside an edge changes, as at the rim of a cloud, the edge is found too far to one side: by so
#: many pixels for a change of the whole step in a pixel between these distances. A background that changes as far as
#: the filter reaches would take 1.7, but clouds do not. Noise makes changes of 2 %.
_BESIDE_PX, _SHIFT_PX, _NOISE_SHARE = (2.0, 3.0), 1.0, 0.02
#: What stays of an edge's error for a change of the whole step in a pixel [px].
_CLOUDED_PX = 0.6
#: Brightness has returned between two steps down where it rose by more than this share of the lesser one: half way
#: between not at all and all of what that takes again.
_RETURNED_SHARE = 0.5
#: A panel's edge or the tube in front of the mirror spoils edges nearer than this many pixels.
_SPOILT_PX = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class ReflectionEdges:
    """Edges that may be the tube's, of one or many photos.

    photo (m,): Photo of each.
    row (m,): Row of the map.
    side (m,): +1 for the tube's edge at the larger camera angle, -1 for the other: the nearer one.
    points_m (m, 3): Where on the design surface [m].
    sigma_x_m (m,): Standard deviation of the position across the trough [m].
    contrast (m,): Step of the brightness towards larger x over that of the brighter side, so that exposure does not
        matter.
    unevenness (m,): Change of the brightness some pixels beside the edge over its step; 0 where a panel's edge or
        the tube in front would make it.
    is_lesser (m,): Whether a larger step the same way stands beside it.
    """

    photo: IntArray
    row: IntArray
    side: FloatArray
    points_m: FloatArray
    sigma_x_m: FloatArray
    contrast: FloatArray
    unevenness: FloatArray
    is_lesser: BoolArray

    def chosen(self, which: npt.NDArray[np.bool_] | IntArray) -> "ReflectionEdges":
        """Return some of them."""
        return ReflectionEdges(*(getattr(self, name)[which] for name in self.__slots__))


def joined(parts: list[ReflectionEdges]) -> ReflectionEdges:
    """Return the edges of many photos in one."""
    return ReflectionEdges(*(np.concatenate([getattr(one, name) for one in parts]) for name in parts[0].__slots__))


def reflection_edges(shots: Sequence[Shot], expected: Expectation) -> list[ReflectionEdges]:
    """Find the edges of the absorber's reflection in photos.

    expected: Collector, absorber and rows.
    Returns: Of each photo the edges within the predicted window that neither a panel's edge nor the tube itself
        spoils.

    Step by step for all photos: code that has just run is in the processor's caches, where it takes half the time.
    """
    looks = _looks(shots, expected, _SAMPLES_PER_PIXEL)
    seen = [one for one in looks if one is not None]
    found, which = find_edges([one.strip for one in seen], oversampling=_SAMPLES_PER_PIXEL)
    edges = iter(_plausible(found, which, seen, expected))
    return [_nothing() if one is None else next(edges) for one in looks]


def edge_profiles(shot: Shot, expected: Expectation) -> FloatArray:
    """Return the brightness across edges of the reflection, from the darker to the brighter side.

    expected: Collector, absorber and rows.
    Returns (n, 13): Brightness at -6 to 6 pixels from each edge that is even on both sides and no lesser step [DN].

    From one sample for each pixel: third moments of edges, by which photos are told linear or sRGB, come out at up to
    0.4 in place of 0.15 where interpolation averages no noise, and far photos that are linear were taken for sRGB.
    """
    [look] = _looks([shot], expected, 1)
    place = np.arange(-_PROFILE_PX, _PROFILE_PX + 1)
    if look is None:
        return np.zeros((0, place.size))
    strip, pixel_m = look.strip, look.pixel_m
    [edges] = _plausible(*find_edges([strip]), [look], expected)
    edges = edges.chosen((edges.unevenness > 0) & (edges.unevenness < _PROFILE_UNEVEN) & ~edges.is_lesser)
    step = float(strip.x_m[1] - strip.x_m[0])
    at = (edges.points_m[:, :1] + pixel_m * place - strip.x_m[0]) / step
    inside = ((at > 0) & (at < strip.x_m.size - 1)).all(axis=1)
    at, row = at[inside], edges.row[inside]
    before = np.floor(at).astype(np.intp)
    share = at - before
    values = strip.image_dn[row[:, None], before] * (1 - share) + strip.image_dn[row[:, None], before + 1] * share
    falling = values[:, -1] < values[:, 0]
    values[falling] = values[falling, ::-1]
    return np.asarray(values, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """A photo, where its camera was, the size of a pixel on the mirror, and the part that can show the reflection."""

    number: int
    eye_m: FloatArray
    pixel_m: float
    strip: Strip


def _looks(shots: Sequence[Shot], expected: Expectation, samples_per_pixel: int) -> list[_Look | None]:
    """Resample the part of the mirror in which the reflection can be; None where there is none."""
    eyes_m, y_m, surface = [one.view.eye_m for one in shots], expected.y_m, expected.collector.surface
    looks: list[_Look | None] = []
    for shot, eye_m, window in zip(shots, eyes_m, _windows(np.reshape(eyes_m, (-1, 3)), expected), strict=True):
        camera = shot.view.camera
        pixel_m = float(np.linalg.norm(eye_m)) / max(camera.focal_x_px, camera.focal_y_px)
        step = pixel_m / samples_per_pixel
        x = np.zeros(0) if window is None else np.arange(window[0], window[1] + step, step)
        if x.size < _FEWEST_PX * samples_per_pixel:
            looks.append(None)
            continue
        rows_each = max(1, round(float(y_m[1] - y_m[0]) / pixel_m)) if y_m.size > 1 else 1
        strip = rectified_strip(shot.image, shot.view, surface, x, y_m, rows_each=rows_each)
        looks.append(_Look(shot.number, eye_m, pixel_m, strip))
    return looks


def _nothing() -> ReflectionEdges:
    none, empty = np.zeros(0, dtype=np.intp), np.zeros(0)
    return ReflectionEdges(none, none, empty, np.zeros((0, 3)), empty, empty, empty, none > 0)


def design_misfit(
    points_m: FloatArray, eyes_m: FloatArray, side: FloatArray, collector: Collector, absorber: AbsorberPath
) -> Misfit:
    """Evaluate lines of sight with the design's slopes.

    points_m, eyes_m (m, 3): Mirror points and cameras [m].
    side (m,): Sides of the tube.
    absorber: The tube's axis.
    Returns: As from `observer.trough.observation_equation.misfit`.
    """
    slope = points_m[:, 0] / (2 * collector.focal_length_m)
    sights = Sights(points_m, eyes_m, side)
    return misfit(sights, (slope, np.zeros_like(slope)), absorber, collector.absorber_diameter_m / 2)


def _windows(eyes_m: FloatArray, expected: Expectation) -> list[tuple[float, float] | None]:
    """Return the part of the aperture in which each camera can see the reflection; None where there is none."""
    collector, absorber = expected.collector, expected.absorber
    half = collector.aperture_width_m / 2
    x = np.linspace(-half, half, 201)
    slope = np.tile(x / (2 * collector.focal_length_m), len(eyes_m))
    places = np.tile(x, len(eyes_m))
    points = np.stack([places, np.repeat(np.clip(eyes_m[:, 1], -1, 1), x.size), 0.5 * places * slope], axis=1)
    lines = Sights(points, np.repeat(eyes_m, x.size, axis=0), np.zeros_like(places))
    beside = beside_axis(lines, slope, absorber, collector.absorber_diameter_m / 2)
    windows: list[tuple[float, float] | None] = []
    for near in (np.abs(beside.angle_rad) < beside.half_rad + 2 * expected.slope_error_rad).reshape(-1, x.size):
        seen = np.flatnonzero(near)
        windows.append((float(x[max(seen[0] - 1, 0)]), float(x[min(seen[-1] + 1, x.size - 1)])) if seen.size else None)
    return windows


def _plausible(found: Edges, which: IntArray, looks: Sequence[_Look], expected: Expectation) -> list[ReflectionEdges]:
    """Keep edges that can be the tube's, and say which of its two edges each is; edges of all photos in their order."""
    if not looks:
        return []
    collector, absorber = expected.collector, expected.absorber
    x, slope, radius = found.x_m, found.x_m / (2 * collector.focal_length_m), collector.absorber_diameter_m / 2
    points = np.stack([x, expected.y_m[found.row], 0.5 * x * slope], axis=1)
    eyes = np.array([one.eye_m for one in looks])[which]
    middle, half, passing, _, _ = beside_axis(Sights(points, eyes, np.zeros(x.size)), slope, absorber, radius)
    near = np.flatnonzero(np.abs(np.abs(middle) - half) < 2 * expected.slope_error_rad)
    found, which, points, middle, half = found.chosen(near), which[near], points[near], middle[near], half[near]
    free_m = np.minimum(
        _inside_panels_m(collector, points[:, 0], points[:, 1]),
        beside_receiver_m(points, eyes[near], collector, absorber),
    )
    pixel_m = np.array([one.pixel_m for one in looks])[which]
    spoilt_m = _SPOILT_PX * pixel_m
    keep = (free_m > spoilt_m) & sees_tube(passing[near], collector, spoilt_m + _END_MARGIN_M)
    judged = free_m > spoilt_m + _EVEN_PX[1] * pixel_m
    ends = np.searchsorted(which, np.arange(len(looks) + 1))
    receiver_rad = 2 * half * collector.receiver_diameter_m / collector.absorber_diameter_m
    edges = []
    for one, own in zip(looks, (slice(*pair) for pair in pairwise(ends)), strict=True):
        part = Edges(*(getattr(found, name)[own] for name in Edges.__slots__))
        free = free_m[own] > spoilt_m[own]
        either_way = bool(expected.goes_either_way(one.eye_m[None])[0])
        side = np.where(middle[own] < 0, 1.0, -1.0)
        if not either_way:
            side = sides_of_tube(part.contrast, middle[own], half[own], expected.slope_error_rad, free)
        dark = _is_tube_dark(part, side, free, either_way=either_way)
        left = np.flatnonzero(keep[own] & dark)
        lesser = _is_lesser_step(part, side, middle[own], receiver_rad[own])[left]
        uneven = np.where(judged[own], _unevenness(one, part), 0.0)
        photo = np.full(left.size, one.number, dtype=np.intp)
        kept = _beside_clouds(one, part.chosen(left))
        places = points[own][left]
        places[:, 0], places[:, 2] = kept.x_m, kept.x_m**2 / (4 * collector.focal_length_m)
        these = ReflectionEdges(
            photo, kept.row, side[left], places, kept.sigma_x_m, kept.contrast, uneven[left], lesser
        )
        if either_way:
            both = (np.abs(middle[own]) + half[own])[left] < 2 * expected.slope_error_rad
            other = these.chosen(both)
            these = joined([these, replace(other, side=-other.side)])
        edges.append(these)
    return edges


def sides_of_tube(
    contrast: FloatArray, middle_rad: FloatArray, half_rad: FloatArray, slope_error_rad: float, among: BoolArray
) -> FloatArray:
    """Return which of the tube's edges each edge of its reflection is.

    contrast (m,): Step of the brightness towards larger x.
    middle_rad, half_rad (m,): By what angle the lines of sight pass beside the tube's axis with the design's
        slopes, and half its width [rad].
    slope_error_rad: Largest slope error of the mirror [rad].
    among (m,): Those that show whether the tube is darker or brighter than what is around it.
    Returns (m,): +1 for the edge at the larger camera angle, -1 for the other.

    It is the nearer one. Where the mirror's normal is turned by more than a quarter of the tube's width, 7 mrad at
    the rim of an LS-2, that is the wrong one: the brightness steps the other way there, and the edge is far from
    both.
    """
    side = np.where(middle_rad < 0, 1.0, -1.0)
    steps = contrast * side
    total = float(steps[among].sum())
    if abs(total) < _CLEAR_MAJORITY * float(np.abs(steps[among]).sum()):
        return side
    far = np.abs(middle_rad + side * half_rad) > _FAR_SHARE * half_rad
    within = np.abs(middle_rad - side * half_rad) < 2 * _BEYOND_TIMES * slope_error_rad
    other = far & within & (steps * total < 0)
    return np.where(other, -side, side)


def _beside_clouds(look: _Look, found: Edges) -> Edges:
    """Move edges back that a change of the brightness beside them has moved, and let their sigma grow by what stays."""
    strip, pixel_m = look.strip, look.pixel_m
    step = float(strip.x_m[1] - strip.x_m[0])
    column = (found.x_m - strip.x_m[0]) / step
    change = np.zeros(found.x_m.size)
    for way in (-1.0, 1.0):
        near, far = (_between(strip, found.row, column + way * px * pixel_m / step) for px in _BESIDE_PX)
        change += far - near
    change /= found.rise_dn
    # Of small changes next to nothing is the background's.
    shift = _SHIFT_PX * change**3 / (change**2 + _NOISE_SHARE**2)
    sigma = np.hypot(found.sigma_x_m, _CLOUDED_PX * pixel_m * change)
    return replace(found, x_m=found.x_m - pixel_m * shift, sigma_x_m=sigma)


def _between(strip: Strip, row: IntArray, column: FloatArray) -> FloatArray:
    """Return the brightness at places between columns [DN]."""
    before = np.clip(column.astype(np.intp), 0, strip.x_m.size - 2)
    share = np.clip(column - before, 0.0, 1.0)
    return np.asarray((1 - share) * strip.image_dn[row, before] + share * strip.image_dn[row, before + 1])


def _unevenness(look: _Look, found: Edges) -> FloatArray:
    """Return by what share of its step the brightness changes some pixels beside each edge, on the worse side."""
    strip = look.strip
    step, last = float(strip.x_m[1] - strip.x_m[0]), strip.x_m.size - 1
    offsets = look.pixel_m / step * np.array([-_EVEN_PX[1], -_EVEN_PX[0], _EVEN_PX[0], _EVEN_PX[1]])
    column = np.clip(np.rint((found.x_m - strip.x_m[0]) / step + offsets[:, None]), 0, last).astype(np.intp)
    left_far, left, right, right_far = strip.image_dn.ravel()[column + found.row * strip.x_m.size]
    change = np.maximum(np.abs(left_far - left), np.abs(right_far - right))
    return np.asarray(change / np.maximum(np.abs(found.rise_dn), 1e-6), dtype=np.float64)


def _is_tube_dark(found: Edges, side: FloatArray, among: BoolArray, *, either_way: bool = False) -> BoolArray:
    """Return which edges have on one side the darkness that the tube has in this photo.

    either_way: Whether the tube's edges step either way (`Expectation.goes_either_way`).

    The coated tube is the darkest thing that a mirror shows; ground, clouds and what lies about have edges as sharp,
    but are brighter on both sides. Where most edges step the other way (a tube lit before a dark sky) all are kept.
    """
    size = np.abs(found.contrast)
    clear = among & (size > _CLEAR_CONTRAST)
    darkens = (found.contrast * side < 0) | either_way
    if np.count_nonzero(clear) < _CLEAR_EDGES or float(size[clear & darkens].sum()) < float(
        size[clear & ~darkens].sum()
    ):
        return np.ones(size.shape, dtype=bool)
    bright = np.abs(found.rise_dn) / np.maximum(size, 1e-6)
    dark = bright - np.abs(found.rise_dn)
    among_clear = dark[clear]
    place = int(_DARKEST_SHARE * (among_clear.size - 1))
    tube = float(np.partition(among_clear, place)[place])
    return np.asarray(dark - tube < _DARK_SHARE * np.maximum(bright - tube, 0.0))


def _is_lesser_step(found: Edges, side: FloatArray, middle_rad: FloatArray, reach_rad: FloatArray) -> BoolArray:
    """Return which edges are smaller than another step down, or up, of the same way to the tube.

    middle_rad, reach_rad (m,): By what angle the lines of sight pass beside the tube's axis with the design's slopes,
        and how wide the receiver is [rad].

    Brightness steps once from what is around the tube to the tube. What the glass throws back ends upon the metal, and
    the glass's own rim stands beside it: smaller steps the same way, next to that of the metal's edge. The way ends
    where brightness returns by more than half of what the next step takes, and is no longer than the receiver is wide.
    """
    if found.x_m.size == 0:
        return np.zeros(0, dtype=bool)
    rises = found.rise_dn > 0
    # Along each row, towards larger x for steps down and towards smaller x for steps up: from bright to dark.
    order = np.lexsort((np.where(rises, -found.x_m, found.x_m), rises, side, found.row))
    size, middle = np.abs(found.rise_dn)[order], middle_rad[order]
    bright = size / np.maximum(np.abs(found.contrast[order]), 1e-6)
    returned = bright[1:] - (bright - size)[:-1]
    goes_on = returned < _RETURNED_SHARE * np.minimum(size[1:], size[:-1])
    goes_on &= np.abs(np.diff(middle)) < reach_rad[order][1:]
    for kind in (rises, side, found.row):
        goes_on &= kind[order][1:] == kind[order][:-1]
    way = np.concatenate([[0], np.cumsum(~goes_on)])
    # The last of each way in this order is its largest.
    by_size = np.lexsort((size, way))
    largest = by_size[np.append(np.flatnonzero(np.diff(way)), way.size - 1)][way]
    lesser = (largest != np.arange(way.size)) & (np.abs(middle - middle[largest]) < reach_rad[order])
    found_lesser = np.empty(lesser.shape, dtype=np.bool_)
    found_lesser[order] = lesser
    return found_lesser


def is_on_panels(collector: Collector, x_m: FloatArray, y_m: FloatArray, margin_m: float) -> BoolArray:
    """Return which points lie on a panel, further than a margin from its edges.

    Shapes: x_m, y_m (m,).
    Returns (m,): Whether an edge there can be trusted.
    """
    return np.asarray(_inside_panels_m(collector, x_m, y_m) > margin_m)


def _inside_panels_m(collector: Collector, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
    """Return how far points of the aperture are from the edges of their panel, negative in the gaps [m]."""
    inside = np.full(x_m.shape, np.inf)
    for edges, place in ((collector.panel_edges_x_m, x_m), (collector.panel_edges_y_m, y_m)):
        panel = np.clip(np.searchsorted(edges, place), 1, edges.size - 1)
        inside = np.minimum(inside, np.minimum(place - edges[panel - 1], edges[panel] - place))
    return np.asarray(inside - collector.panel_gap_m / 2)


def sees_tube(passing_y_m: FloatArray, collector: Collector, margin_m: FloatArray | float) -> BoolArray:
    """Return which reflected lines pass the tube itself, neither beyond its ends nor at a support.

    Shapes: passing_y_m (m,), margin_m (m,), result (m,).
    """
    seen = np.abs(passing_y_m) < collector.length_m / 2 - margin_m
    for support in collector.support_y_m:
        seen &= np.abs(passing_y_m - support) > collector.support_width_m / 2 + margin_m
    return np.asarray(seen)


def beside_receiver_m(
    points_m: FloatArray, eyes_m: FloatArray, collector: Collector, absorber: AbsorberPath
) -> FloatArray:
    """Return how far lines of sight to mirror points pass beside the receiver, negative where it hides them [m]."""
    axis_x, axis_z = absorber.at(points_m[:, 1])
    way_x, way_z = eyes_m[:, 0] - points_m[:, 0], eyes_m[:, 2] - points_m[:, 2]
    beside = (axis_x - points_m[:, 0]) * way_z - (axis_z - points_m[:, 2]) * way_x
    return np.asarray(np.abs(beside) / np.hypot(way_x, way_z) - collector.receiver_diameter_m / 2)
