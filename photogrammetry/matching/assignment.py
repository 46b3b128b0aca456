"""Which dot of a single photo is which listed target, when neither its pose nor any code is known."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import NamedTuple

import cv2
import numpy as np

from heliogauge.adjust.binomial_distribution import binomial_tail
from heliogauge.adjust.chi_square import chi_square_limit
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import BoolArray, FloatArray, IntArray, float_array
from photogrammetry.bundle.state import rotations_from_vectors
from photogrammetry.matching.uncoded_names import ListedTargets

#: Fewer agreeing targets say nothing: three fit any pose, a fourth often does.
_LEAST = 5
#: Triples of dots that are tried; with every second dot false one in 8 is good, so that 100 fail once in 600 000.
_TRIPLES = 100
#: Ordered triples of listed targets tried for each triple of dots.
_MOST_LISTED = 25_000
#: Poses refined for each triple of dots.
_REFINED = 10
#: Probability of refusing a dot that is right.
_SIGNIFICANCE = 1e-3
_MOST_ACCIDENTS = 0.01
#: Two rivals whose stated up direction differs by less are not distinguished by it.
_LEAST_TURN_RAD = np.deg2rad(30.0)


@dataclass(frozen=True, slots=True, eq=False)
class Sense:
    """What settles symmetric layouts, in the frame of the list.

    up (3,): Direction that points up in the photo, roughly.
    front (3,): Direction from the targets towards the side they are seen from.
    InputError: A direction of length 0.
    """

    up: FloatArray | None = None
    front: FloatArray | None = None

    def __post_init__(self) -> None:
        for name in ("up", "front"):
            value = getattr(self, name)
            if value is None:
                continue
            vector = float_array(f"sense: {name}", value, (3,))
            if not float(np.linalg.norm(vector)) > 0:
                raise InputError(f"sense: {name}: a direction is needed, not (0, 0, 0)")
            object.__setattr__(self, name, vector)


@dataclass(frozen=True, slots=True, eq=False)
class Assignment:
    """Dots of one photo with the names of listed targets.

    target_of_dot (m,): Place of each dot's target in the list, -1 for none.
    cam_from_list: The pose.
    misses (m,): How far each assigned dot is from where it should be, in sigma; NaN for others.
    accidents: Expected number of such agreements by accident, of all poses that were tried.
    """

    target_of_dot: IntArray
    cam_from_list: RigidTransform
    misses: FloatArray
    accidents: float


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """What is given, also as directions without lens: dots (m, 2); targets whose codes were read (m,), -1 for none."""

    camera: Camera
    pixels: FloatArray
    covariance: FloatArray
    ideal: FloatArray
    listed: ListedTargets
    read: IntArray

    @classmethod
    def of(
        cls,
        camera: Camera,
        pixels_px: FloatArray,
        covariance_px2: FloatArray,
        listed: ListedTargets,
        read: IntArray | None,
    ) -> "_Scene":
        pixels = float_array("pixels_px", pixels_px, (None, 2))
        covariance = float_array("covariance_px2", covariance_px2, (len(pixels), 2, 2))
        rays = camera.cast_rays(pixels)
        known = np.full(len(pixels), -1, dtype=np.intp) if read is None else np.asarray(read, dtype=np.intp)
        return cls(camera, pixels, covariance, rays[:, :2] / rays[:, 2:], listed, known)


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    pose: RigidTransform
    target_of_dot: IntArray
    misses: FloatArray
    score: float
    accidents: float


def assign_targets(
    camera: Camera,
    pixels_px: FloatArray,
    covariance_px2: FloatArray,
    listed: ListedTargets,
    *,
    sense: Sense | None = None,
    read: IntArray | None = None,
) -> Assignment:
    """Find which dots of a photo are which listed targets, and the photo's pose.

    Shapes: covariance_px2 (m, 2, 2).
    pixels_px (m, 2): The dots, false ones among them [px].
    listed: The targets with approximate coordinates; some may not be in the photo.
    sense: What settles symmetric layouts.
    read (m,): Place in the list of the target that a dot's code says it is, -1 where no code is read: up to three of
        them stand in every triple that is tried, and no pose names them otherwise.
    InputError: Lengths differ.
    EstimationError: Fewer than five targets or dots; no pose explains them; or several do: a layout that looks the
        same after a turn or in a mirror, which ``sense`` may settle.

    Triples of dots with all ordered triples of targets by the three-point solution; poses are judged by the dots near
    listed targets, the best refined with the sigmas of dots and of listed coordinates. The first triple of dots whose
    best pose is no accident ends the search; its rivals come from the same triple with other targets. The score is
    the sum of ``gate - miss^2`` over the targets that have a dot, gate the chi-square quantile of two degrees of
    freedom. A rival is a pose with other names for the dots, as many of them but one, and residuals that the sigmas
    allow.
    """
    scene = _Scene.of(camera, pixels_px, covariance_px2, listed, read)
    if min(len(scene.pixels), len(listed)) < _LEAST:
        raise EstimationError(
            f"assignment: {len(scene.pixels)} dots and {len(listed)} listed targets; {_LEAST} of both are needed"
        )
    triples = _ordered_triples(listed)
    tried, solutions = 0, list[_Solution]()
    for dots in _dot_triples(scene.ideal, np.flatnonzero(scene.read >= 0)):
        fitting = _fitting(scene, dots, triples)
        poses = _three_point_poses(scene, dots, fitting)
        tried += len(poses[0])
        solutions += _refine_best(scene, poses, tried)
        if any(one.accidents < _MOST_ACCIDENTS for one in solutions):
            break
    good = [one for one in solutions if one.accidents < _MOST_ACCIDENTS]
    if not good:
        most = max((int((one.target_of_dot >= 0).sum()) for one in solutions), default=0)
        raise EstimationError(
            f"assignment: no pose explains the dots: at most {most} of {len(listed)} listed targets agree with one of "
            f"{len(scene.pixels)} dots; are the coordinates, their sigmas and the camera right?"
        )
    best = _select(good, listed, sense or Sense())
    return Assignment(best.target_of_dot, best.pose, best.misses, best.accidents)


def assign_near(
    camera: Camera,
    pixels_px: FloatArray,
    covariance_px2: FloatArray,
    listed: ListedTargets,
    cam_from_list: RigidTransform,
    *,
    read: IntArray | None = None,
) -> Assignment | None:
    """Find which dots of a photo are which listed targets where a pose predicts them.

    Shapes: covariance_px2 (m, 2, 2).
    pixels_px (m, 2): The dots, false ones among them [px].
    cam_from_list: Pose, from codes that were read or from a prediction.
    read (m,): Place in the list of the target that a dot's code says it is, -1 where no code is read.
    Returns: Names and the pose from all of them; None where fewer than five agree.
    """
    scene = _Scene.of(camera, pixels_px, covariance_px2, listed, read)
    found = _refine(scene, cam_from_list, 1)
    return None if found is None else Assignment(found.target_of_dot, found.pose, found.misses, found.accidents)


def _fitting(scene: _Scene, dots: IntArray, triples: IntArray) -> IntArray:
    """Return the ordered triples of targets that name three dots as their codes do, shape (k, 3)."""
    said = scene.read[dots]
    if (said < 0).all():
        return triples
    each = [np.array([target]) if target >= 0 else np.arange(len(scene.listed)) for target in said.tolist()]
    all_of_them = np.stack(np.meshgrid(*each, indexing="ij"), axis=-1).reshape(-1, 3)
    rest = np.sort(all_of_them, axis=1)
    # A target whose code is read elsewhere is none of the others.
    taken = np.isin(all_of_them, scene.read[scene.read >= 0]) & (said < 0)
    apart = (rest[:, 0] < rest[:, 1]) & (rest[:, 1] < rest[:, 2]) & ~taken.any(axis=1)
    return np.asarray(_spread(scene.listed, all_of_them[apart])[:_MOST_LISTED], dtype=np.intp)


def _spread(listed: ListedTargets, triples: IntArray) -> IntArray:
    """Return the triples that are not nearly on a line."""
    sides = listed.points_m[triples]
    one, two = sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0]
    area = np.linalg.norm(np.cross(one, two), axis=1)
    longest = np.maximum((one**2).sum(axis=1), (two**2).sum(axis=1))
    return np.asarray(triples[area > 0.02 * longest], dtype=np.intp)


def _ordered_triples(listed: ListedTargets) -> IntArray:
    """Return ordered triples of targets, (k, 3), all or a fixed choice of many, none of them nearly on a line."""
    n = len(listed)
    if n * (n - 1) * (n - 2) <= 2 * _MOST_LISTED:
        triples = np.array(list(permutations(range(n), 3)), dtype=np.intp)
    else:
        rng = np.random.default_rng(0)
        triples = np.asarray(np.argsort(rng.random((2 * _MOST_LISTED, n)), axis=1)[:, :3], dtype=np.intp)
    triples = _spread(listed, triples)
    if not len(triples):
        raise EstimationError("assignment: all listed targets are on one line; that leaves the pose open")
    return triples


def _dot_triples(ideal: FloatArray, read: IntArray) -> Iterator[IntArray]:
    """Yield triples of dots, a fixed random choice without those nearly on a line.

    read (k,): Dots whose code was read; as many of them as may be are in each triple.
    """
    rng = np.random.default_rng(1)
    usable = np.nonzero(np.isfinite(ideal).all(axis=1))[0]
    if usable.size < 3:
        return
    told, rest = np.intersect1d(usable, read), np.setdiff1d(usable, read)
    drawn = []
    for number in range(4 * _TRIPLES):
        # Codes of one rim lie on a line: every second triple has another dot in it.
        own = rng.choice(told, min(told.size, 3 - number % 2), replace=False)
        if rest.size >= 3 - own.size:
            drawn.append(np.concatenate([own, rng.choice(rest, 3 - own.size, replace=False)]))
    chosen = np.array(drawn, dtype=np.intp).reshape(-1, 3)
    sides = ideal[chosen]
    one, two = sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0]
    area = np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0])
    # Not the widest: false dots lie all over the photo, targets in a part of it.
    yield from chosen[area > 0.1 * np.median(area)][:_TRIPLES] if len(chosen) else chosen


def _three_point_poses(scene: _Scene, dots: IntArray, triples: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return all poses, rotations (k, 3, 3) and shifts (k, 3), that put triples of targets on three dots."""
    image = np.ascontiguousarray(scene.ideal[dots])
    middle = scene.listed.points_m.mean(axis=0)
    places = np.ascontiguousarray((scene.listed.points_m - middle)[triples])
    eye, none = np.eye(3), np.zeros(4)
    vectors: list[FloatArray] = []
    for three in places:
        _, turns, shifts = cv2.solveP3P(three, image, eye, none, flags=cv2.SOLVEPNP_AP3P)
        vectors += [np.concatenate([turn, shift]).ravel() for turn, shift in zip(turns, shifts, strict=True)]
    poses = np.array(vectors).reshape(-1, 6)
    poses = poses[np.isfinite(poses).all(axis=1)]
    rotations = rotations_from_vectors(poses[:, :3])
    return rotations, poses[:, 3:] - rotations @ middle


def _refine_best(scene: _Scene, poses: tuple[FloatArray, FloatArray], tried: int) -> list[_Solution]:
    """Refine the poses that most targets find a dot with."""
    rotations, shifts = poses
    if not len(rotations):
        return []
    focal = scene.camera.focal_x_px
    noise = float(np.sqrt(np.median(np.trace(scene.covariance, axis1=1, axis2=2)) / 2)) / focal
    spread = float(np.sqrt((scene.listed.sigma_m**2).mean()))
    counts, costs = np.zeros(len(rotations)), np.zeros(len(rotations))
    for first in range(0, len(rotations), 2048):
        own = slice(first, first + 2048)
        seen = np.einsum("kij,nj->kni", rotations[own], scene.listed.points_m) + shifts[own, None]
        depth = np.where(seen[..., 2] > 0, seen[..., 2], np.nan)
        places = seen[..., :2] / depth[..., None]
        off = np.linalg.norm(places[:, :, None] - scene.ideal[None, None], axis=3)
        nearest = np.where(np.isfinite(off), off, np.inf).min(axis=2)
        # Errors of three noisy points grow outwards: twice the three sigma of one.
        reach = 6 * np.hypot(noise, spread / np.nan_to_num(depth, nan=np.inf))
        counts[own] = (nearest < reach).sum(axis=1)
        costs[own] = np.minimum(nearest / np.maximum(reach, 1e-300), 1.0).sum(axis=1)
    order = np.lexsort((costs, -counts))[:_REFINED]
    found: dict[bytes, _Solution] = {}
    for index in order[counts[order] >= _LEAST].tolist():
        one = _refine(scene, RigidTransform(rotations[index], shifts[index]), tried)
        if one is not None:
            key = one.target_of_dot.tobytes()
            if key not in found or one.score > found[key].score:
                found[key] = one
    return list(found.values())


def _refine(scene: _Scene, pose: RigidTransform, tried: int) -> _Solution | None:
    """Assign, adjust the pose, assign again, with a gate that narrows to the sigmas."""
    gate = chi_square_limit(_SIGNIFICANCE, 2)
    for widening in (4.0, 2.0, 1.0, 1.0, 1.0):
        pairs, _, usable = _assign(scene, pose, widening**2 * gate)
        if len(pairs) < 4 or not usable:
            return None
        moved = _adjust_pose(scene, pose, pairs)
        if moved is None:
            return None
        pose = moved
    pairs, squares, _ = _assign(scene, pose, gate)
    if len(pairs) < _LEAST:
        return None
    target_of_dot = np.full(len(scene.pixels), -1, dtype=np.intp)
    misses = np.full(len(scene.pixels), np.nan)
    target_of_dot[pairs[:, 1]] = pairs[:, 0]
    misses[pairs[:, 1]] = np.sqrt(squares)
    return _Solution(pose, target_of_dot, misses, float((gate - squares).sum()), _accidents(scene, pose, pairs, tried))


def _accidents(scene: _Scene, pose: RigidTransform, pairs: IntArray, tried: int) -> float:
    """Return the expected number of poses, of all tried, with so many targets near dots by accident."""
    pixels, covariance, inside = _predict_images(scene, pose)
    area = np.pi * chi_square_limit(_SIGNIFICANCE, 2) * np.sqrt(np.linalg.det(covariance[inside])).mean()
    chance = min(len(scene.pixels) * float(area) / (scene.camera.width_px * scene.camera.height_px), 1.0)
    # Three targets were put on their dots.
    free, hits = max(int(inside.sum()) - 3, 1), len(pairs) - 3
    return tried * binomial_tail(hits, free, chance) if np.isfinite(pixels[inside]).all() else float("inf")


class _Images(NamedTuple):
    """Images of the listed targets [px], covariance from listed sigmas and a typical dot's, and which are inside."""

    pixels_px: FloatArray
    covariance_px2: FloatArray
    inside: BoolArray


def _predict_images(scene: _Scene, pose: RigidTransform) -> _Images:
    seen = scene.camera.project_posed(scene.listed.points_m, pose)
    spread = seen.d_pixel_d_point * scene.listed.sigma_m[:, None, :]
    covariance = spread @ np.swapaxes(spread, 1, 2) + np.median(scene.covariance, axis=0)
    size = np.array([scene.camera.width_px, scene.camera.height_px])
    inside = ((seen.pixels_px > -0.5) & (seen.pixels_px < size - 0.5)).all(axis=1)
    return _Images(seen.pixels_px, covariance, np.asarray(inside))


class _Pairs(NamedTuple):
    """Pairs (target, dot), (k, 2), that are each other's nearest, squared misses, whether any target is inside."""

    pairs: IntArray
    squares: FloatArray
    usable: bool


def _assign(scene: _Scene, pose: RigidTransform, gate: float) -> _Pairs:
    pixels, covariance, inside = _predict_images(scene, pose)
    if not inside.any():
        return _Pairs(np.zeros((0, 2), dtype=np.intp), np.zeros(0), False)
    off = scene.pixels[None] - np.where(inside[:, None], pixels, 1e9)[:, None]
    covariance = np.where(inside[:, None, None], covariance, np.eye(2))
    squares = np.einsum("nmi,nij,nmj->nm", off, np.linalg.inv(covariance), off)
    # Codes name their dots, and no other dot has their names.
    told = np.flatnonzero(scene.read >= 0)
    own = squares[scene.read[told], told]
    squares[:, told] = squares[scene.read[told]] = np.inf
    squares[scene.read[told], told] = own
    nearest = np.argmin(squares, axis=1)
    mutual = np.argmin(squares, axis=0)[nearest] == np.arange(len(pixels))
    good = mutual & inside & (squares[np.arange(len(pixels)), nearest] < gate)
    own = np.nonzero(good)[0]
    return _Pairs(np.stack([own, nearest[own]], axis=1), squares[own, nearest[own]], True)


def _adjust_pose(scene: _Scene, pose: RigidTransform, pairs: IntArray) -> RigidTransform | None:
    """Adjust a pose to pairs by three steps of Gauss and Newton; None where that fails."""
    points, pixels = scene.listed.points_m[pairs[:, 0]], scene.pixels[pairs[:, 1]]
    for _ in range(3):
        seen = scene.camera.project_posed(points, pose)
        if not np.isfinite(seen.pixels_px).all():
            return None
        spread = seen.d_pixel_d_point * scene.listed.sigma_m[pairs[:, 0]][:, None, :]
        weights = np.linalg.inv(spread @ np.swapaxes(spread, 1, 2) + scene.covariance[pairs[:, 1]])
        design = seen.d_pixel_d_pose
        normal = np.einsum("nia,nij,njb->ab", design, weights, design)
        right = np.einsum("nia,nij,nj->a", design, weights, pixels - seen.pixels_px)
        try:
            step = np.linalg.solve(normal, right)
        except np.linalg.LinAlgError:
            return None
        if not np.isfinite(step).all() or float(np.linalg.norm(step[:3])) > 1.0:
            return None
        pose = pose.moved(step)
    return pose


def _select(found: Sequence[_Solution], listed: ListedTargets, sense: Sense) -> _Solution:
    """Return the best solution; refuse where another one names the dots differently and fits as well."""
    middle = listed.points_m.mean(axis=0)
    if sense.front is not None:
        front = sense.front
        found = [one for one in found if (one.pose.inverse().translation_m - middle) @ front > 0]
        if not found:
            raise EstimationError("assignment: every pose that fits sees the targets from behind the stated front")
    ranked = sorted(found, key=lambda one: -one.score)
    best = ranked[0]
    rivals = [best, *(one for one in ranked[1:] if _differ(one, best) and _acceptable(one, best))]
    if len(rivals) == 1:
        return best
    text = (
        f"assignment: {len(rivals)} ways of naming {int((best.target_of_dot >= 0).sum())} dots fit equally well "
        f"({_example(best, rivals[1], listed)}): a symmetric layout"
    )
    if sense.up is None:
        raise EstimationError(f"{text}; state which direction is up and where the front is, or add a target")
    tilts = [_tilt_rad(one.pose, sense.up) for one in rivals]
    order = np.argsort(tilts)
    if tilts[order[1]] - tilts[order[0]] < _LEAST_TURN_RAD:
        raise EstimationError(f"{text}, and the stated up direction does not distinguish them; state the front, too")
    return rivals[int(order[0])]


def _acceptable(one: _Solution, best: _Solution) -> bool:
    """Whether a solution could be true: as many targets but one, residuals as the sigmas say or hardly above the best.

    The difference of chi-squares is no criterion: where the layout is symmetric both namings have errors of the list
    of their own.
    """
    counts = [int(np.isfinite(each.misses).sum()) for each in (one, best)]
    squares = [float(np.nansum(each.misses**2)) for each in (one, best)]
    limit = chi_square_limit(_SIGNIFICANCE, max(2 * counts[0] - 6, 1))
    return counts[0] >= counts[1] - 1 and squares[0] < max(limit, 1.5 * squares[1])


def _differ(one: _Solution, other: _Solution) -> bool:
    """Whether two solutions name a dot differently; one dot more or less is no difference."""
    both = (one.target_of_dot >= 0) & (other.target_of_dot >= 0)
    return not both.any() or bool((one.target_of_dot[both] != other.target_of_dot[both]).any())


def _example(one: _Solution, other: _Solution, listed: ListedTargets) -> str:
    """Name one dot that two solutions name differently."""
    both = (one.target_of_dot >= 0) & (other.target_of_dot >= 0) & (one.target_of_dot != other.target_of_dot)
    if not both.any():
        return "of different dots"
    k = int(np.argmax(both))
    return f"one dot is {listed.names[one.target_of_dot[k]]} or {listed.names[other.target_of_dot[k]]}"


def _tilt_rad(pose: RigidTransform, up: FloatArray) -> float:
    """Angle in the image between a direction of the list and the image's up."""
    x, y, _ = pose.rotate(up)
    return float(abs(np.arctan2(x, -y)))
