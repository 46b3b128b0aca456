"""Where a surface lies among points before anything is fitted: candidates, the best of them, and what stays open."""

from dataclasses import dataclass
from itertools import product

import numpy as np

from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform, rotation_from_vector
from heliogauge.validate import FloatArray
from photogrammetry.surface.design import Reference
from photogrammetry.surface.fit import quick_fit

#: More points do not make a better start.
_SAMPLED = 200
#: Two fits whose RMS differ by less than this share are equally good.
_EQUAL = 1.05
_TURN_RAD = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Where to start a fit.

    design_from_world: The pose.
    open_words: What it leaves open; empty where nothing is.
    """

    design_from_world: RigidTransform
    how: str
    open_words: str = ""


def find_start(points_m: FloatArray, reference: Reference, viewer_m: FloatArray) -> Start:
    """Find where a surface lies among points.

    points_m (n, 3): Points of the surface in their own frame [m].
    viewer_m (3,): A point in front of the surface, where the cameras were; +z is on its side [m].
    Returns: The frame of the points itself where it fits as well as any other; otherwise the best of the attitudes
        along the principal curvatures, with a word on those that fit equally well.
    EstimationError: Fewer than four points, or none of the attitudes can be fitted.
    """
    if len(points_m) < 4:
        raise EstimationError(f"surface: {len(points_m)} points do not show where the surface is; 4 or more are needed")
    middle = points_m.mean(axis=0)
    sampled = points_m[:: max(1, len(points_m) // _SAMPLED)]
    own = RigidTransform.identity()
    trials = [(quick_fit(sampled, reference, start), start is own) for start in (own, *_attitudes(sampled, viewer_m))]
    # The cameras see the front: a surface with its back to them is the same distances with the wrong sign.
    facing = [(fit, kept) for fit, kept in trials if np.isfinite(fit.rms_m) and _faces(fit.pose, sampled, viewer_m)]
    if not facing:
        raise EstimationError(
            f"surface: {reference.describe()} does not fit the points in any attitude; check the design, the targets "
            "named for it, or name [[surface.reference]] targets with their design coordinates"
        )
    least = min(fit.rms_m for fit, _ in facing) * _EQUAL + 1e-9
    good = [(fit, kept) for fit, kept in facing if fit.rms_m <= least]
    own_fits = [fit for fit, kept in good if kept]
    if own_fits:
        return Start(own_fits[0].pose, "the frame of the network, moved as little as the fit needs")
    # Of equal fits the one that puts the middle of the points nearest to the origin: along a trough any place fits.
    best = min((fit for fit, _ in good), key=lambda fit: round(float(np.linalg.norm(fit.pose.apply(middle)[:2])), 6))
    others = [fit for fit, _ in good if _turn(fit.pose, best.pose) > _TURN_RAD]
    words = ""
    if others or reference.symmetries().shape[1]:
        words = (
            "which way x and y point on the surface is not determined by the points and was chosen along their "
            "principal axes; name three or more [[surface.reference]] targets with their design coordinates"
        )
    return Start(best.pose, "the points' own principal axes", words)


def _turn(one: RigidTransform, other: RigidTransform) -> float:
    cosine = 0.5 * (float(np.trace(one.rotation @ other.rotation.T)) - 1)
    return float(np.arccos(np.clip(cosine, -1, 1)))


def _faces(pose: RigidTransform, points_m: FloatArray, viewer_m: FloatArray) -> bool:
    return bool(pose.apply(viewer_m)[2] > pose.apply(points_m)[:, 2].mean())


def _attitudes(points_m: FloatArray, viewer_m: FloatArray) -> list[RigidTransform]:
    """Return poses with z towards the viewer and x along the principal curvatures, about centroid and vertex."""
    center = points_m.mean(axis=0)
    arms = points_m - center
    _, singular, axes = np.linalg.svd(arms, full_matrices=False)
    if singular[1] < 1e-6 * singular[0]:
        raise EstimationError("surface: the points are on one line; name more targets beside it")
    z = axes[2] if axes[2] @ (viewer_m - center) >= 0 else -axes[2]
    flat = np.stack([axes[0], np.cross(z, axes[0]), z])
    turns, vertex = [0.0], np.zeros(3)
    if len(points_m) >= 6:
        angle, vertex = _principal(arms @ flat.T)
        turns.append(angle)
    poses = []
    for turn, quarter, origin in product(turns, range(4), (np.zeros(3), vertex)):
        rotation = rotation_from_vector(np.array([0.0, 0.0, -turn - quarter * np.pi / 2])) @ flat
        poses.append(RigidTransform(rotation, -rotation @ (center + flat.T @ origin)))
    return poses


def _principal(local: FloatArray) -> tuple[float, FloatArray]:
    """Fit a quadratic: direction of its largest curvature [rad], and its vertex, no further than the points reach."""
    x, y, z = local.T
    columns = np.column_stack([np.ones_like(x), x, y, 0.5 * x * x, x * y, 0.5 * y * y])
    terms = np.linalg.lstsq(columns, z, rcond=None)[0]
    hessian = np.array([[terms[3], terms[4]], [terms[4], terms[5]]])
    values, vectors = np.linalg.eigh(hessian)
    strongest = vectors[:, int(np.argmax(np.abs(values)))]
    inverse = np.linalg.pinv(hessian, rcond=0.05)
    reach = float(np.abs(local[:, :2]).max())
    vertex = np.clip(-inverse @ terms[1:3], -reach, reach)
    height = float(terms[0] + terms[1:3] @ vertex + 0.5 * vertex @ hessian @ vertex)
    return float(np.arctan2(strongest[1], strongest[0])), np.append(vertex, height)
