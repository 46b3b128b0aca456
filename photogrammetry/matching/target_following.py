"""Listed targets followed from photo to photo: where each must be, so that only there it is measured.

Following gives no measurement. It finds to half a pixel or so where targets are, and the pose of the photo;
`photogrammetry.detection.photo_targets` then measures them.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform, rotation_from_vector
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, Float32Array, FloatArray, IntArray
from photogrammetry.centers.ellipse import NamedEllipses
from photogrammetry.detection.detections import Detections
from photogrammetry.start_values.resection import LEAST_TARGETS, resect

Image = npt.NDArray[np.uint8] | npt.NDArray[np.uint16] | Float32Array

#: So far the picture may move from one photo to the next [px]: 3 degrees of a drone's nod at 2400 px focal length. Some
#: targets are looked for that far, the others near to where the shift of those has them; 1 degree of a turn about the
#: line of sight moves a target at the border of a photo of 2 megapixels by 17 px.
_WIDE_PX, _SEARCH_PX = 128, 32
#: That many targets, each within that distance of where others have it, determine the pose [px].
_ENOUGH, _NEAR_PX = 6, 12
#: A flight is steady while its movement predicts the next photo this well [px].
_STEADY_PX = 8.0
#: How many targets show how the picture has moved, turned and grown, at first and if they were wrong; and how far they
#: may be from that [px].
_TELLING, _AGREEING_PX = (2, 4), 16.0
#: Radius in pixels that a dot has in the reduced pictures in which it is looked for: far away, and near by.
_COARSE_RADIUS_PX, _REDUCED_RADIUS_PX = 1.25, 2.5
#: The pattern reaches this far, in radii of the dot: it has the code ring in it, which is another on each target.
_PATTERN_RADII = 3.2
#: A target is in the photo if its ring, which ends at 3 radii, is.
_WHOLE_RADII = 3.2
#: Correlation below which a dot is not where it was looked for.
_LEAST_LIKENESS = 0.6
#: A dot farther than this from where the pose has it is another one [px].
_FAR_PX = 3.0
#: A target that was read farther than this from where the list has it is listed wrongly [px].
_LISTED_PX = 8.0
#: Following goes on while this share of the targets that should be in the photo is found.
_LEAST_SHARE = 0.6
#: Steps of a pose until it moves no image point by more than this [px].
_MOST_STEPS, _ENOUGH_PX = 8, 0.05
#: What a list of targets without their sigma is taken to be good for in the image [px].
_START_SIGMA_PX = 2.0
#: Where a target with a place known exactly is in a photo: centre and lens together [px].
_POINT_PX = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class KnownTargets(ShortRepr):
    """Targets whose three coordinates are listed.

    names length n: Their names.
    points_m (n, 3): Coordinates [m].
    sigma_m (n,): Largest standard deviation of the coordinates of each [m].
    """

    names: tuple[str, ...]
    points_m: FloatArray
    sigma_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Pattern:
    """What a target looks like.

    image: The target, its centre in the middle pixel.
    factor: By how much it is reduced.
    """

    image: Float32Array
    factor: int


@dataclass(frozen=True, slots=True, eq=False)
class Track(ShortRepr):
    """What following knows after a photo.

    pose: ``cam_from_frame`` of the photo, to a pixel or so.
    patterns: What each target looks like, much reduced and less.
    ellipses: Where targets should be, and how large.
    radius_px: Radius of the dots [px].
    motion: This pose from that of the photo before.
    steady: Whether the movement before predicted that of this photo.
    """

    pose: RigidTransform
    patterns: Mapping[str, tuple[Pattern, Pattern]]
    ellipses: NamedEllipses
    radius_px: float
    motion: RigidTransform | None = None
    steady: bool = False


def provisional_pose(found: Detections, known: KnownTargets, camera: Camera) -> RigidTransform | None:
    """Find a photo's pose from the listed coordinates as they are.

    Returns: ``cam_from_frame``; None where too few listed targets are seen or agree with each other.
    """
    place = {name: k for k, name in enumerate(known.names)}
    rows = [k for k, name in enumerate(found.names) if name in place and found.usable[k]]
    if len(rows) < LEAST_TARGETS:
        return None
    own = np.array([place[found.names[k]] for k in rows], dtype=np.intp)
    points, pixels = known.points_m[own], found.pixels_px[rows]
    per_metre = float(np.ptp(pixels, axis=0).sum()) / max(float(np.ptp(points, axis=0).sum()), 1e-9)
    own_px = per_metre * known.sigma_m[own]
    pose = _resected(camera, points, pixels, np.hypot(_START_SIGMA_PX, own_px))
    if pose is None:
        return None
    # With the sigmas of the list alone, where these are as good as they say: targets known to 20 mm do not turn it.
    return _resected(camera, points, pixels, np.hypot(_POINT_PX, own_px), least=(len(rows) + 1) // 2) or pose


def _resected(
    camera: Camera, points: FloatArray, pixels: FloatArray, sigma_px: FloatArray, least: int = LEAST_TARGETS
) -> RigidTransform | None:
    try:
        found = resect(camera, points, pixels, sigma_px[:, None, None] ** 2 * np.eye(2))
    except EstimationError:
        return None
    return found.cam_from_world if np.count_nonzero(found.inliers) >= least else None


def agrees_with_list(found: Detections, known: KnownTargets, camera: Camera, pose: RigidTransform) -> bool:
    """Return whether listed targets that were read are where the list has them, and no others are there.

    Fewer than a pose needs say nothing of the list.

    found: A photo's targets, named by their codes.
    pose: ``cam_from_frame``.
    Returns: Whether following may name targets by their places; with a wrong list only codes may.
    """
    place = {name: k for k, name in enumerate(known.names)}
    own = np.array([place.get(name, -1) for name in found.names], dtype=np.intp)
    listed = camera.project(pose.apply(known.points_m))
    off = np.linalg.norm(listed[own] - found.pixels_px, axis=1)[own >= 0]
    strange = np.linalg.norm(listed[:, None] - found.pixels_px[own < 0], axis=2)
    return off.size >= LEAST_TARGETS and bool((off < _LISTED_PX).all() and not (strange < _LISTED_PX).any())


def start_following(image: Image, found: Detections, shapes_px2: FloatArray, pose: RigidTransform) -> Track:
    """Begin with a photo whose targets were measured.

    Shapes: image (height, width), shapes_px2 (n, 2, 2).
    pose: ``cam_from_frame``.
    """
    radius = float(np.median(found.radius_px))
    half = int(np.ceil(_PATTERN_RADII * radius))
    patterns = {}
    for name, pixel in zip(found.names, found.pixels_px, strict=True):
        # The dot's centre lies in the middle of the pattern, to round-off.
        size = (2 * half + 1, 2 * half + 1)
        part, first = _cut_out(image, pixel, half + 2)
        part = np.ascontiguousarray(part, dtype=np.float32)
        sharp = cv2.getRectSubPix(part, size, (float(pixel[0] - first[0]), float(pixel[1] - first[1])))
        factors = (max(1, round(radius / wanted)) for wanted in (_COARSE_RADIUS_PX, _REDUCED_RADIUS_PX))
        coarse, fine = (Pattern(_reduce(np.asarray(sharp, dtype=np.float32), factor), factor) for factor in factors)
        patterns[name] = coarse, fine
    return Track(pose, patterns, NamedEllipses(found.names, found.pixels_px, shapes_px2), radius)


def follow(image: Image, track: Track, known: KnownTargets, camera: Camera) -> Track | None:
    """Find the next photo's pose from the patterns of its targets.

    Shapes: image (height, width).
    track: After the photo before.
    Returns: After this photo; None where it is lost: too few dots are where a common pose has them.

    Targets that are not listed give no pose: they are looked for where the picture of the listed ones has moved them.
    """
    if track.motion is not None and track.steady:
        ahead = track.motion @ track.pose
        pixels = camera.project(ahead.apply(known.points_m))
        pose = _find_pose(image, track, known, camera, ahead, pixels, thorough=True)
        if pose is not None:
            return _move_track(image, pose, track, known, camera)
    # A flight that is steady no more is looked for as widely as at first.
    pixels = camera.project(track.pose.apply(known.points_m))
    has_pattern = np.array([name in track.patterns for name in known.names])
    seen_before = np.flatnonzero(has_pattern & _well_inside(pixels, camera, _PATTERN_RADII * track.radius_px))
    if seen_before.size < LEAST_TARGETS:
        return None
    patterns = [track.patterns[known.names[k]][0] for k in seen_before]
    for telling in _TELLING:
        chosen = np.unique(np.linspace(0, seen_before.size - 1, telling).round().astype(np.intp))
        own = [patterns[k] for k in chosen]
        moved = _move_in_common(image, pixels[seen_before[chosen]], own, track.radius_px, pixels)
        pose = _find_pose(image, track, known, camera, track.pose, moved, thorough=telling == _TELLING[-1])
        if pose is not None:
            return _move_track(image, pose, track, known, camera)
    return None


def _find_pose(
    image: Image,
    track: Track,
    known: KnownTargets,
    camera: Camera,
    start: RigidTransform,
    pixels: FloatArray,
    *,
    thorough: bool,
) -> RigidTransform | None:
    """Find the pose near where targets are expected: from a few close by, or thoroughly from all a little farther away.

    start: Pose to start with.
    pixels (n, 2): Where the listed targets are expected [px].
    """
    has_pattern = np.array([name in track.patterns for name in known.names])
    margin = _PATTERN_RADII * track.radius_px + 2
    shown = np.flatnonzero(has_pattern & _well_inside(pixels, camera, margin))
    whole = np.flatnonzero(has_pattern & _well_inside(pixels, camera, margin + _NEAR_PX))
    few = whole[np.linspace(0, whole.size - 1, _ENOUGH).round().astype(np.intp)] if whole.size >= _ENOUGH else whole
    for chosen, reach, share in ((few, _NEAR_PX, 1.0), (shown, _SEARCH_PX, _LEAST_SHARE))[: 1 + thorough]:
        pose = _fit_near(image, track, known, camera, start, pixels[chosen], chosen, reach, share)
        if pose is not None:
            return pose
    return None


def _fit_near(
    image: Image,
    track: Track,
    known: KnownTargets,
    camera: Camera,
    pose: RigidTransform,
    pixels: FloatArray,
    chosen: IntArray,
    reach_px: int,
    share: float,
) -> RigidTransform | None:
    """Find the pose from some targets near where they are expected; None where less than a share is found and agrees.

    pose: To start with.
    pixels (k, 2): Where the chosen targets are expected [px].
    """
    if chosen.size < LEAST_TARGETS:
        return None
    matched = np.array(
        [
            _match(image, pixel, track.patterns[known.names[k]][1], track.radius_px, reach_px)
            for pixel, k in zip(pixels, chosen, strict=True)
        ]
    )
    points, usable = known.points_m[chosen], np.isfinite(matched[:, 0])
    for _ in range(3):
        if np.count_nonzero(usable) < max(LEAST_TARGETS, share * chosen.size):
            return None
        pose = _fit_pose(camera, points[usable], matched[usable], pose)
        off = np.linalg.norm(camera.project(pose.apply(points)) - matched, axis=1)
        agreeing = off < _FAR_PX
        if (agreeing == usable).all():
            return pose
        usable = agreeing
    return None


def _move_track(image: Image, pose: RigidTransform, track: Track, known: KnownTargets, camera: Camera) -> Track:
    """Say where all listed targets are that the photo shows whole; those that come in look like the others.

    Of others those go on that are found again.
    """
    pixels, before_px = (camera.project(one.apply(known.points_m)) for one in (pose, track.pose))
    shown = np.flatnonzero(_well_inside(pixels, camera, _WHOLE_RADII * track.radius_px))
    before = {name: k for k, name in enumerate(track.ellipses.names)}
    names = tuple(known.names[k] for k in shown)
    others = _find_others(image, track, known, before_px, pixels)
    ellipses = NamedEllipses(
        (*names, *others),
        np.concatenate([pixels[shown], np.reshape(list(others.values()), (-1, 2))]),
        track.ellipses.shapes_px2[[before.get(name, 0) for name in (*names, *others)]],
    )
    steady = False
    if track.motion is not None:
        foreseen = camera.project((track.motion @ track.pose).apply(known.points_m))
        steady = bool(np.nanmax(np.abs(foreseen - pixels), initial=0.0) < _STEADY_PX)
    return Track(pose, track.patterns, ellipses, track.radius_px, pose @ track.pose.inverse(), steady)


def _find_others(
    image: Image, track: Track, known: KnownTargets, before_px: FloatArray, after_px: FloatArray
) -> dict[str, FloatArray]:
    """Return where followed targets that are not listed are now, as far as they are found [px].

    before_px, after_px (n, 2): Where the listed ones were and are [px].
    """
    listed = set(known.names)
    places = {
        name: place
        for name, place in zip(track.ellipses.names, track.ellipses.centers_px, strict=True)
        if name not in listed
    }
    if not places:
        return {}
    seen = np.isfinite(before_px + after_px).all(axis=1)
    before, after, own = (
        xy[:, 0] + 1j * xy[:, 1] for xy in (before_px[seen], after_px[seen], np.array([*places.values()]))
    )
    shift, scale = _movement(before, after)
    moved = shift + scale * own
    found = {
        name: _match(image, place, track.patterns[name][1], track.radius_px, _NEAR_PX)
        for name, place in zip(places, np.stack([moved.real, moved.imag], axis=1), strict=True)
    }
    return {name: place for name, place in found.items() if np.isfinite(place).all()}


def _move_in_common(
    image: Image, places: FloatArray, patterns: list[Pattern], radius_px: float, pixels: FloatArray
) -> FloatArray:
    """Move pixels as some targets have moved; NaN where those do not agree.

    places (k, 2): Where these targets were [px].
    """
    both = zip(places, patterns, strict=True)
    found = np.array([_match(image, place, pattern, radius_px, _WIDE_PX) for place, pattern in both])
    seen = np.isfinite(found[:, 0])
    before, after = (values[:, 0] + 1j * values[:, 1] for values in (places, found))
    while np.count_nonzero(seen) > len(places) / 2:
        shift, scale = _movement(before[seen], after[seen])
        off = np.where(seen, np.abs(shift + scale * before - after), 0.0)
        if off.max() < _AGREEING_PX:
            moved = shift + scale * (pixels[:, 0] + 1j * pixels[:, 1])
            return np.stack([moved.real, moved.imag], axis=1)
        seen[np.argmax(off)] = False
    return np.full_like(pixels, np.nan)


def _movement(before: npt.NDArray[Any], after: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return a and b of the shift, turn and change of scale ``a + b z`` that takes pixels x + iy to others best."""
    design = np.stack([np.ones_like(before), before], axis=1)
    return np.asarray(np.linalg.lstsq(design, after, rcond=None)[0])


def _well_inside(pixels: FloatArray, camera: Camera, margin_px: float) -> BoolArray:
    limits = np.array([camera.width_px, camera.height_px]) - 1 - margin_px
    with np.errstate(invalid="ignore"):
        return np.asarray(((pixels > margin_px) & (pixels < limits)).all(axis=1))


def _cut_out(image: Image, pixel: FloatArray, half: int) -> tuple[Image, tuple[int, int]]:
    """Return the pixels around a place, and the column and row of the first."""
    column, row = (max(round(float(value)) - half, 0) for value in pixel)
    part = image[row : row + 2 * half + 1, column : column + 2 * half + 1]
    return part, (column, row)


def _reduce(part: Image, factor: int) -> Float32Array:
    """Average blocks, from the middle outwards: the middle pixel stays the middle of the middle block."""
    if factor == 1:
        return np.ascontiguousarray(part, dtype=np.float32)
    smoothed = cv2.boxFilter(part, cv2.CV_32F, (factor | 1, factor | 1))
    middle = [size // 2 for size in part.shape]
    return np.ascontiguousarray(smoothed[middle[0] % factor :: factor, middle[1] % factor :: factor])


def _match(image: Image, pixel: FloatArray, pattern: Pattern, radius_px: float, search_px: int) -> FloatArray:
    """Return where near a place the pattern is, to some tenths of a pixel; NaN where it is not."""
    factor, (rows, columns) = pattern.factor, pattern.image.shape
    half = search_px + int(np.ceil(_PATTERN_RADII * radius_px))
    part, first = _cut_out(image, pixel, half)
    if not part.size:
        # Outside of the photo: one of another size is among the others.
        return np.full(2, np.nan)
    reduced = _reduce(part, factor)
    if reduced.shape[0] <= rows or reduced.shape[1] <= columns:
        return np.full(2, np.nan)
    likeness = np.asarray(cv2.matchTemplate(reduced, pattern.image, cv2.TM_CCOEFF_NORMED), dtype=np.float32)
    _, best, _, (column, row) = cv2.minMaxLoc(likeness)
    if best < _LEAST_LIKENESS:
        return np.full(2, np.nan)
    found = (
        column + _find_vertex(likeness[row], column) + columns // 2,
        row + _find_vertex(likeness[:, column], row) + rows // 2,
    )
    height, width = part.shape
    return np.array(
        [first[0] + (width // 2) % factor + factor * found[0], first[1] + (height // 2) % factor + factor * found[1]]
    )


def _find_vertex(values: Float32Array, index: int) -> float:
    """Return how far from a largest value the parabola through it and its neighbours has its top."""
    if not 0 < index < len(values) - 1:
        return 0.0
    before, here, after = (float(values[index + k]) for k in (-1, 0, 1))
    bend = before - 2 * here + after
    return 0.0 if bend >= 0 else 0.5 * (before - after) / bend


def _fit_pose(camera: Camera, points_m: FloatArray, pixels_px: FloatArray, start: RigidTransform) -> RigidTransform:
    """Refine a pose by a few Gauss-Newton steps; it only places windows, so 0.05 px are enough.

    Steps are those of a camera without lens errors, which change them by some percent; residuals are exact.
    """
    rotation, shift = start.rotation, start.translation_m
    none = np.zeros(len(points_m))
    for _ in range(_MOST_STEPS):
        arms = points_m @ rotation.T
        seen = arms + shift
        residuals = (pixels_px - camera.project(seen)).T.ravel()
        if not np.isfinite(residuals).all():
            return start
        # A turn w moves a point by w x arm; a shift in depth z moves its image by -x / z of a shift in x.
        (ax, ay, az), nearness = arms.T, 1 / seen[:, 2]
        by_x, by_y = camera.focal_x_px * nearness, camera.focal_y_px * nearness
        x_by_z, y_by_z = -by_x * nearness * seen[:, 0], -by_y * nearness * seen[:, 1]
        design = np.concatenate(
            [
                [ay * x_by_z, az * by_x - ax * x_by_z, -ay * by_x, by_x, none, x_by_z],
                [ay * y_by_z - az * by_y, -ax * y_by_z, ax * by_y, none, by_y, y_by_z],
            ],
            axis=1,
        ).T
        try:
            step = np.linalg.solve(design.T @ design, design.T @ residuals)
        except np.linalg.LinAlgError:
            return start
        rotation, shift = rotation_from_vector(step[:3]) @ rotation, shift + step[3:]
        if np.abs(design @ step).max() < _ENOUGH_PX:
            break
    return RigidTransform(rotation, shift)
