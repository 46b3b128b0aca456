"""Whether the outline in the image agrees with the lens: straight sides show distortion, their lengths aspect."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from deflectometry.pose.outline_edges import OutlineEdges, correlation_points
from deflectometry.pose.pose_observations import DistanceObservation
from heliogauge.adjust.chi_square import chi_square_cdf
from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.camera.distortion import DistortionDirection
from heliogauge.camera.model import PARAMETER_NAMES, Camera
from heliogauge.doubts import Doubt
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import FloatArray

#: Below this probability of so large a disagreement, of either parameter, the lens is said to contradict the outline.
_MIN_PROBABILITY = 0.01 / 2
#: Profiles one pixel apart share pixels through the interpolation: so many neighbours err together at least.
_SHARED_POINTS = 1.5
#: Steps of the numerical derivatives: of pixels, and of k1.
_STEP_PX, _STEP_K1 = 0.1, 1e-4
_ROUNDS = 3


class _Found(NamedTuple):
    """Change of a parameter of the camera that fits the outline best, its sigma, and the probability of so large a one.

    The sigma has the camera's own, and the scatter of the edge points about the outline *with* the change: a misfit
    that the change explains is no noise.
    """

    change: float
    sigma: float
    probability: float


def check_lens(
    edges: OutlineEdges,
    camera: Camera,
    pose: RigidTransform,
    sigma_side_px: FloatArray,
    distances: Sequence[DistanceObservation],
) -> Iterator[Doubt]:
    """Yield what the sides of the mirror in the image say against the camera.

    pose: cam_from_mirror that fits the edge points best.
    sigma_side_px (sides,): Standard deviation of what all points of a side have in common [px].
    distances: Measured distances that agree with the image; a wrong one would accuse the lens.
    """
    outline = _Sides(edges, sigma_side_px, distances)
    bend = _estimate(outline, camera, pose, "k1", _STEP_K1)
    if bend.probability < _MIN_PROBABILITY:
        k1 = camera.distortion.k1
        other = next(one for one in DistortionDirection if one != camera.distortion.direction)
        reversed_too = abs(bend.change + 2 * k1) < 3 * bend.sigma and k1 != 0
        # What the change moves at the point of the outline that is farthest from the principal point.
        farthest_px = float(np.hypot(*(edges.image_px - [camera.center_x_px, camera.center_y_px]).T).max())
        per_k1_px = farthest_px * (farthest_px / camera.focal_x_px) ** 2
        hint = f" (about what distortion_direction = {str(other)!r} would do)" if reversed_too else ""
        yield Doubt(
            "lens_contradicts_outline",
            f"the sides of the mirror are bent in the image as by k1 = {k1 + bend.change:.3f} +- {bend.sigma:.3f}"
            f"{hint} where the camera has {k1:.3f}: check k1, k2, p1, p2 and distortion_direction of [camera]; a "
            "mirror whose sides are not straight needs the corners of its true outline in outline_m",
            {
                "distortion_missing_px": bend.change * per_k1_px,
                "sigma_distortion_px": bend.sigma * per_k1_px,
                "farthest_px": farthest_px,
            },
        )
    aspect = _estimate(outline, camera, pose, "focal_x_px", _STEP_PX)
    if aspect.probability < _MIN_PROBABILITY:
        share, sigma = aspect.change / camera.focal_x_px, aspect.sigma / camera.focal_x_px
        yield Doubt(
            "aspect_contradicts_outline",
            f"the outline in the image is {abs(share):.2%} +- {sigma:.2%} {'longer' if share > 0 else 'shorter'} along "
            "the image's x than focal_x_px, focal_y_px and outline_m allow: check these three",
            {"stretch_share": share, "sigma_stretch_share": sigma},
        )


class _Sides(NamedTuple):
    """What the pose and a parameter are adjusted to."""

    edges: OutlineEdges
    sigma_side_px: FloatArray
    distances: Sequence[DistanceObservation]


def _estimate(outline: _Sides, camera: Camera, pose: RigidTransform, name: str, step: float) -> _Found:
    """Adjust the pose and one parameter of the camera to the outline."""
    edges, sides_px, distances = outline
    number = PARAMETER_NAMES.index(name)
    one = np.eye(len(PARAMETER_NAMES))[number]
    total, variance = 0.0, np.inf
    # A focal length stays one, whatever an outline that is no outline asks for.
    reach = np.array([-0.5, 0.5]) * max(abs(float(camera.parameters[number])), 1.0)
    for _ in range(_ROUNDS):
        changed = camera.with_parameters(camera.parameters + total * one)
        # What a side has in common is counted by itself.
        series = edges.along_sides(edges.rows(changed, pose)[0])
        seen = np.isfinite(series)
        if not seen.any():
            # The adjustment has left the outline: nothing is known.
            return _Found(0.0, np.inf, 1.0)
        series -= (np.nansum(series, axis=1) / np.maximum(seen.sum(axis=1), 1))[:, None]
        scatter_px = max(robust_scale(series[seen], upper=True), edges.floor_px)
        sigma_px = scatter_px * float(np.sqrt(max(correlation_points(series), _SHARED_POINTS)))
        whitened, by_pose = edges.whitened(changed, pose, sigma_px, sides_px)
        ahead = camera.with_parameters(changed.parameters + step * one)
        by_parameter = (edges.whitened(ahead, pose, sigma_px, sides_px)[0] - whitened) / step
        matrix = np.column_stack([by_pose, by_parameter])
        for distance in distances:
            predicted, by_step = distance.predict(pose)
            matrix = np.vstack([matrix, np.append(by_step, 0.0) / distance.sigma_m])
            whitened = np.append(whitened, (predicted - distance.distance_m) / distance.sigma_m)
        # Columns in their own lengths: radians, metres and pixels are solved together.
        scale = np.linalg.norm(matrix, axis=0)
        scale[scale == 0] = 1.0
        inverse = np.linalg.pinv(matrix / scale, rcond=1e-9)
        solved = -(inverse @ whitened) / scale
        pose, total = pose.moved(solved[:6]), total + float(np.clip(solved[6], *(reach - total)))
        variance = float((inverse[6] @ inverse[6]) / scale[6] ** 2)
    sigma = float(np.sqrt(variance + camera.covariance[number, number]))
    return _Found(total, sigma, 1.0 - chi_square_cdf((total / sigma) ** 2, 1.0))
