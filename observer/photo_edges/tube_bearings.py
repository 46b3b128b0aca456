"""The absorber tube itself in a photo: its silhouette, and the bisector of the two lines of sight that touch it.

Across the trough the outline of a round tube is touched by two lines of sight whose bisector goes through its axis
whatever the distance; the middle between the two edges on a plane does not (0.17 mm off at 7 m and 45 degrees). With
the camera at (X_c, Z_c) the axis (X_a, Z_a) is seen under ``eta = atan2(X_a - X_c, Z_c - Z_a)`` (Owkes 2012, sections
5.3 and 6.4). A glass tube around the same axis does not change the silhouette: what passes it at a distance b from the
axis passes it at b inside as well (Bouguer). Where the absorber is 6 mm off the middle of the glass, the bisector moves
by less than 0.05 mm.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from heliogauge.geometry.surfaces import Quadric, quadric
from heliogauge.validate import BoolArray, FloatArray, IntArray
from observer.photo_edges.edges import Edges, find_edges
from observer.photo_edges.rectify import Strip, pixel_samples, rectified_strip
from observer.photo_edges.tube_profile import BEYOND_PX, Sighting, find_axis
from observer.photo_edges.views import Shot
from observer.trough.expectation import Expectation
from observer.trough.glass import turned_rad
from observer.trough.observation_equation import Sights, beside_axis

#: How far from its expected place the tube is searched [m].
SEARCH_M = 0.06
#: By what share the silhouette's width may differ from the tube's. The glass is wider by 60 %, blur of a tube of 7 px
#: changes the width by 3 %.
_WIDTH_SHARE = 0.12
#: Rows of one photo share their error of pixel grid and background: so many count as one.
ROWS_ALIKE = 3
#: Samples across the tube for each pixel.
_OVERSAMPLING = 2
#: A silhouette that lies further from those of the rows around it is another thing's: pixels, and what a tube that
#: slopes by 8 mrad moves within the rows that are compared [m].
_BESIDE_PX, _BESIDE_M = 1.5, 2e-3
#: Rows before and after that say where the tube is.
_ROWS_AROUND = 12
#: What the background, seen through the glass, does to the bisector along many rows: in ray-traced photos 0.003 px to
#: 0.01 px. As much where the tube runs along the pixels.
_SHARED_PX = 0.02
#: Where the glass shows the reflection nearer than this to the metal's edge, it pulls the edge the more the nearer: a
#: tube 3 mm beside the middle of its glass by 0.03 px where that is the limit, by 0.12 px at 1.3 times the angle.
_NEAR_PX, _NEAR_POWER = 1.35, 6
#: Of a width that is not the tube's by more than so many pixels, this share goes into the error that rows share: half
#: of it moves the bisector if one edge alone is pulled. Blur and glass together change the width by up to 0.14 px.
_WIDER_PX, PULLED_SHARE = 0.15, 0.25
#: Glass turns what passes it close to the metal by up to this: where the reflection is as near to the tube in the
#: image, it shows up beside the tube [rad].
PRISM_RAD = 0.06
#: So far beside a support it is seen in the mirror behind the tube and moves its edges: from 15 m by 90 urad, which is
#: 2.6 mm in height, up to 0.1 m beside the last support of an LS-2, by 20 urad up to 0.2 m, by nothing beyond [m].
_SUPPORT_MARGIN_M = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class Bearings:
    """Directions across the trough under which photos see the tube's axis.

    photo (m,): Photo.
    y_m (m,): Place along the trough [m].
    angle_rad (m,): eta of the module's text [rad].
    sigma_rad (m,): Standard deviation [rad].
    diameter_m (m,): How thick the tube looks at the distance where it is expected [m].
    shared_rad (m,): Error that neighbouring rows of a photo have in common, from the background and the grid of
        pixels [rad].
    pixel_m (m,): What a pixel of the photo covers at the tube; 0 where that is not known [m].
    to_reflection_rad (m,): By what angle the line of sight through the tube misses it after the mirror: the
        smaller, the nearer to the tube a prism of glass beside it shows its reflection [rad].
    """

    photo: IntArray
    y_m: FloatArray
    angle_rad: FloatArray
    sigma_rad: FloatArray
    diameter_m: FloatArray
    shared_rad: FloatArray = ()  # type: ignore[assignment]
    pixel_m: FloatArray = ()  # type: ignore[assignment]
    to_reflection_rad: FloatArray = ()  # type: ignore[assignment]

    def __post_init__(self) -> None:
        for name, usual in (("shared_rad", 0.0), ("pixel_m", 0.0), ("to_reflection_rad", np.inf)):
            if len(getattr(self, name)) == 0:
                object.__setattr__(self, name, np.full_like(self.sigma_rad, usual))

    def chosen(self, which: BoolArray | IntArray) -> "Bearings":
        """Return some of them."""
        return Bearings(*(getattr(self, name)[which] for name in self.__slots__))


def bearing(x_m: FloatArray, z_m: FloatArray, eyes_m: FloatArray) -> FloatArray:
    """Return under what angle across the trough a camera sees a point.

    Shapes: x_m, z_m (m,), eyes_m (m, 3).
    Returns (m,): Angle from straight down, positive towards +x [rad].
    """
    return np.arctan2(x_m - eyes_m[:, 0], eyes_m[:, 2] - z_m)


def tube_bearings(shots: Sequence[Shot], expected: Expectation) -> list[Bearings]:
    """Find the tube itself in photos.

    expected: Collector, where the tube should be, and rows along the trough.
    Returns: Of each photo one for each row in which both edges were found, away from known supports.

    Step by step for all photos, as `observer.photo_edges.reflection_edges.reflection_edges`.
    """
    plane = quadric([0, 0, 0, 0, 0, float(np.mean(expected.absorber.z_m))], name="plane of the focal line")
    lookouts = _lookouts(shots, expected)
    seen = [one for one in lookouts if one is not None]
    strips = [_strip(one, plane, expected) for one in seen]
    bearings = iter(_bearings(seen, strips, plane, expected))
    return [_nothing() if one is None else next(bearings) for one in lookouts]


@dataclass(frozen=True, slots=True, eq=False)
class _Lookout:
    """From where a photo sees the tube: above the plane of the focal line, from what distance, with what pixels.

    ``to_reflection_rad`` is from `_angle_to_reflection`.
    """

    shot: Shot
    eye_m: FloatArray
    height_m: float
    distance_m: float
    pixel_rad: float
    to_reflection_rad: float


def _lookouts(shots: Sequence[Shot], expected: Expectation) -> list[_Lookout | None]:
    """Return from where photos see the tube; None for those that cannot be used."""
    collector, eyes = expected.collector, np.reshape([one.view.eye_m for one in shots], (-1, 3))
    level, middle = float(np.mean(expected.absorber.z_m)), float(np.mean(expected.absorber.x_m))
    height = eyes[:, 2] - level
    # A camera beside the tube or below it sees it from the mirror's side; the plane has no use there.
    above = np.flatnonzero(height >= 5 * collector.absorber_diameter_m)
    to_reflection = np.zeros(len(shots))
    to_reflection[above] = _angle_to_reflection(eyes[above], expected)
    # Where the tube's reflection is its background edges of both cannot be distinguished.
    usable = to_reflection > (0.0 if collector.glass is None else PRISM_RAD)
    lookouts: list[_Lookout | None] = []
    for k, shot in enumerate(shots):
        if not usable[k]:
            lookouts.append(None)
            continue
        focal_px = max(shot.view.camera.focal_x_px, shot.view.camera.focal_y_px)
        distance = float(np.hypot(eyes[k, 0] - middle, height[k]))
        lookouts.append(_Lookout(shot, eyes[k], float(height[k]), distance, 1 / focal_px, float(to_reflection[k])))
    return lookouts


def _strip(seen: _Lookout, plane: Quadric, expected: Expectation) -> Strip:
    """Return the part of the plane of the focal line in which the tube can be, resampled."""
    middle, slant = float(np.mean(expected.absorber.x_m)), seen.distance_m / seen.height_m
    reach = SEARCH_M + 1.25 * expected.collector.absorber_diameter_m * slant
    pixel_m = seen.distance_m * seen.pixel_rad
    # Seen slantwise, a pixel is wider on the plane.
    step = pixel_m * slant / _OVERSAMPLING
    x = np.arange(middle - reach, middle + reach + step, step)
    y_m = expected.y_m
    rows_each = max(1, round(float(y_m[1] - y_m[0]) / pixel_m)) if y_m.size > 1 else 1
    return rectified_strip(seen.shot.image, seen.shot.view, plane, x, y_m, rows_each=rows_each)


def _bearings(
    seen: Sequence[_Lookout], strips: Sequence[Strip], plane: Quadric, expected: Expectation
) -> list[Bearings]:
    """Pair the edges that are the tube's, and say under what angle its axis is seen; those of all photos together."""
    if not seen:
        return []
    collector, radius = expected.collector, expected.collector.absorber_diameter_m / 2
    eye_x, heights, distances, pixels_rad = np.array(
        [[one.eye_m[0], one.height_m, one.distance_m, one.pixel_rad] for one in seen]
    ).T
    found, which = find_edges(strips, oversampling=_OVERSAMPLING)
    angles = np.arctan2(found.x_m - eye_x[which], heights[which])
    # Rows of all photos in one order, too far apart to be neighbours.
    lined = replace(found, row=found.row + which * (expected.y_m.size + 2 * _ROWS_AROUND))
    first, second = paired_edges(lined, angles, heights[which], radius)
    beside = (_BESIDE_PX * pixels_rad + _BESIDE_M / distances)[which[first]]
    middle = 0.5 * (angles[first] + angles[second])
    chosen = _continuous(lined.row[first], middle, _strength(found, first, second), beside)
    first, second, angle = first[chosen], second[chosen], middle[chosen]
    which, row = which[first], found.row[first]
    height, distance, y = heights[which], distances[which], expected.y_m[row]
    sigma = 0.5 * np.hypot(*(found.sigma_x_m[k] * np.cos(angles[k]) ** 2 / height for k in (first, second)))
    wide = 2 * height / np.cos(angle) * np.sin(0.5 * (angles[second] - angles[first]))
    shared, ends = np.empty(len(seen)), np.searchsorted(which, np.arange(len(seen) + 1))
    for k, one in enumerate(seen):
        own = slice(ends[k], ends[k + 1])
        angle[own], sigma[own], common, between_edges = _by_profile(one, plane, expected, row[own], angle[own])
        # As the steepest places are apart, a bare tube tells whether it is in glass that nobody stated.
        if collector.glass is not None:
            wide[own] = between_edges
        turned = 2 * turned_rad(collector, 1 + _NEAR_PX * one.distance_m * one.pixel_rad / radius)
        behind = _SHARED_PX * one.pixel_rad * max(1.0, turned / one.to_reflection_rad) ** _NEAR_POWER
        shared[k] = np.hypot(behind, common)
    # Something dark in the glass beside one edge makes the tube look wider, and moves the bisector by half of that.
    too_wide = np.abs(wide - 2 * radius) - _WIDER_PX * distance * pixels_rad[which]
    pulled = PULLED_SHARE * np.maximum(too_wide, 0) / distance
    photo = np.array([one.shot.number for one in seen], dtype=np.intp)[which]
    to_reflection = np.array([one.to_reflection_rad for one in seen])[which]
    bearings = Bearings(
        photo,
        y,
        angle,
        sigma,
        wide,
        np.hypot(shared[which], pulled),
        distance * pixels_rad[which],
        to_reflection,
    )
    kept = np.isfinite(angle) & ~beside_support(y, collector.support_y_m, collector.support_width_m)
    return [bearings.chosen(np.flatnonzero(kept & (which == k))) for k in range(len(seen))]


def _by_profile(
    seen: _Lookout, plane: Quadric, expected: Expectation, row: IntArray, angle_rad: FloatArray
) -> tuple[FloatArray, FloatArray, float, FloatArray]:
    """Return angle and sigma of the tube's axis [rad], what the photo's have in common, and how thick it looks [m].

    Standard deviations are those whose mean over a group, `ROWS_ALIKE` rows counted as one, is the group's.
    """
    collector, y_m = expected.collector, expected.y_m
    pixel_m, slant = seen.distance_m * seen.pixel_rad, seen.distance_m / seen.height_m
    if row.size == 0:
        return angle_rad, np.zeros(0), 0.0, np.zeros(0)
    middle = float(np.mean(expected.absorber.x_m))
    reach = SEARCH_M + (collector.receiver_diameter_m / 2 + (BEYOND_PX + 1) * pixel_m) * slant
    x = np.arange(middle - reach, middle + reach, pixel_m * slant)
    rows_each = max(1, round(float(y_m[1] - y_m[0]) / pixel_m))
    samples = pixel_samples(seen.shot.image, seen.shot.view, plane, x, y_m, rows_each=rows_each)
    axis = middle, float(np.mean(expected.absorber.z_m))
    eye = seen.eye_m
    sighting = Sighting(float(eye[0]), seen.height_m, seen.distance_m, pixel_m, axis, float(eye[2]), seen.shot.edges())
    found = find_axis(samples, row, y_m[row], angle_rad, sighting, collector)
    each = found.sigma_rad * np.sqrt(np.maximum(found.rows / ROWS_ALIKE, 1.0))
    return found.angle_rad, each, found.shared_rad, 2 * found.radius_m


def _angle_to_reflection(eyes_m: FloatArray, expected: Expectation) -> FloatArray:
    """Return by what angle lines of sight through the tube miss it after reflection behind it, shape (n,) [rad].

    eyes_m (n, 3): Cameras above the tube [m].

    Small where the tube stands before its own reflection; infinite where there is no mirror behind it.
    """
    collector, focal = expected.collector, expected.collector.focal_length_m
    axis_x, axis_z = float(np.mean(expected.absorber.x_m)), float(np.mean(expected.absorber.z_m))
    x = np.full(len(eyes_m), axis_x)
    for _ in range(4):
        x = axis_x - (eyes_m[:, 0] - axis_x) * (axis_z - x**2 / (4 * focal)) / (eyes_m[:, 2] - axis_z)
    points = np.stack([x, 0.1 * np.clip(eyes_m[:, 1], -1, 1), x**2 / (4 * focal)], axis=1)
    lines = Sights(points, eyes_m, np.zeros(len(eyes_m)))
    beside = beside_axis(lines, x / (2 * focal), expected.absorber, collector.absorber_diameter_m / 2)
    angle = np.maximum(np.abs(beside.angle_rad) - beside.half_rad - 2 * expected.slope_error_rad, 0.0)
    return np.where(np.abs(x) > collector.aperture_width_m / 2, np.inf, angle)


def beside_support(y_m: FloatArray, support_y_m: FloatArray, support_width_m: float) -> BoolArray:
    """Return which places along the tube a known support hides, or nearly so.

    Shapes: y_m (m,), support_y_m (n,).
    Returns (m,): Whether the tube is hidden there.
    """
    reach = support_width_m / 2 + _SUPPORT_MARGIN_M
    return np.asarray((np.abs(y_m[:, None] - support_y_m) < reach).any(axis=1))


def _nothing() -> Bearings:
    empty = np.zeros(0)
    return Bearings(np.zeros(0, dtype=np.intp), empty, empty, empty, empty)


def paired_edges(
    found: Edges, seen_rad: FloatArray, height_m: FloatArray | float, radius_m: float
) -> tuple[IntArray, IntArray]:
    """Return all pairs of edges of one row that are as far apart as the tube is wide and step opposite ways.

    found: Edges on the plane of the focal line.
    seen_rad (n,): Angle across the trough under which each is seen [rad].
    height_m (n,): Height of the camera above that plane [m].
    first, second (m,): The edges at the smaller and at the larger x.
    """
    if found.row.size == 0:
        return np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp)
    half = np.arcsin(np.clip(radius_m * np.cos(seen_rad) / height_m, 0, 0.5))
    # The tube's middle is further than its edge: the second round is right within a hundredth of the tolerance.
    half = np.arcsin(np.clip(radius_m * np.cos(seen_rad + half) / height_m, 0, 0.5))
    order = np.lexsort((seen_rad, found.row))
    # Rows follow each other at distances that no angle reaches.
    key = found.row * 10.0 + seen_rad
    low = np.searchsorted(key[order], key + 2 * half * (1 - _WIDTH_SHARE))
    high = np.searchsorted(key[order], key + 2 * half * (1 + _WIDTH_SHARE))
    count = high - low
    first = np.repeat(np.arange(key.size), count)
    second = order[np.repeat(low, count) + np.arange(first.size) - np.repeat(np.cumsum(count) - count, count)]
    opposite = (found.rise_dn[first] < 0) != (found.rise_dn[second] < 0)
    return np.asarray(first[opposite], dtype=np.intp), np.asarray(second[opposite], dtype=np.intp)


def _strength(found: Edges, first: IntArray, second: IntArray) -> FloatArray:
    return np.minimum(np.abs(found.rise_dn[first]), np.abs(found.rise_dn[second]))


def _continuous(row: IntArray, angle_rad: FloatArray, strength: FloatArray, beside_rad: FloatArray) -> IntArray:
    """Choose one pair for each row: the one nearest to where the strongest pairs of the rows around it lie.

    Tube, seams and reflections may look alike in one row; along many only the tube is at one place.
    """
    if row.size == 0:
        return np.zeros(0, dtype=np.intp)
    order = np.lexsort((strength, row))
    last = np.flatnonzero(np.diff(row[order], append=-1))
    strongest = order[last]
    places = np.full(int(row.max()) + 1 + 2 * _ROWS_AROUND, np.nan)
    places[row[strongest] + _ROWS_AROUND] = angle_rad[strongest]
    # The median of what there is: sorting puts rows without a pair last.
    windows = np.sort(np.lib.stride_tricks.sliding_window_view(places, 2 * _ROWS_AROUND + 1)[row[strongest]], axis=1)
    count = np.count_nonzero(np.isfinite(windows), axis=1)
    own = np.arange(count.size)
    usual = 0.5 * (windows[own, (count - 1) // 2] + windows[own, count // 2])
    beside = np.abs(angle_rad - usual[np.searchsorted(row[strongest], row)])
    order = np.lexsort((-beside, row))
    nearest = order[np.flatnonzero(np.diff(row[order], append=-1))]
    return np.asarray(nearest[(beside < beside_rad)[nearest]], dtype=np.intp)
