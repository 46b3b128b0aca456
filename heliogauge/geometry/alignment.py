"""Put points where the same points are wanted: by a rigid motion or a similarity, refused where a turn stays open."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform, nearest_rotation
from heliogauge.validate import FloatArray

#: A turn more uncertain than this is not determined [rad]; see `align_points`.
_MOST_UNCERTAIN_RAD = 1 / 3
#: Coordinates that differ by more than this share of the set's size contradict each other: no shape explains that.
_CONTRADICTION = 0.1
#: Relative error of the curvatures: products and eigenvalues of matrices of three rows round by a few units each.
_ROUNDING = 10 * float(np.finfo(np.float64).eps)


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """The motion ``x_b = scale R x_a + t`` that brings points nearest to others.

    b_from_a: Rotation R and translation t.
    scale: New length of what was 1; 1 for a rigid motion.
    misfit_m: Standard deviation of one coordinate from what is left [m].
    sigma_turn_rad: Standard deviation of the least determined turn [rad].
    """

    b_from_a: RigidTransform
    scale: float
    misfit_m: float
    sigma_turn_rad: float


def align_points(
    points_a_m: FloatArray, points_b_m: FloatArray, *, with_scale: bool = False, names: Sequence[str] = ()
) -> Alignment:
    """Find the motion with the smallest sum of squared distances; never a mirror image.

    points_a_m, points_b_m (n, 3): The same points in both frames, equal weights [m].
    with_scale: Whether lengths may change too: a similarity (Umeyama, IEEE Trans. PAMI 13 (1991) 376).
    names: Of the points, for the message.
    EstimationError: Fewer than three points, or a turn stays open.

    A turn by the small vector phi about the middle of the points raises the sum of squares by ``phi^T H phi``, with
    ``H = scale (tr(S) I - S)``, ``S = R^T M`` and ``M = sum b a^T``. Coordinates that differ by chance with the
    standard deviation s then leave the turn about the weakest axis a standard deviation ``s / sqrt(h)``, h the
    smallest eigenvalue of H: for points near a line, the sum of their squared distances from it. The turn counts as
    open above 1/3 rad: distances from the line are then less than three standard deviations, no more than what points
    of one line would show. s follows from what the motion leaves, and rounding adds to it, so that points exactly on a
    line are refused too. The same rule finds sets that fit a mirror image so well that no turn fits best.

    s stands for noise only while it is small against the size of the set: a network whose points are uncertain by a
    tenth of its size has not been measured. More than that comes from coordinates that contradict each other
    (exchanged names, another unit). Such sets are aligned as far as they go, so that what follows can name the point
    that contradicts; `Alignment.misfit_m` has the size of the contradiction.
    """
    count = len(points_a_m)
    if count < 3:
        raise EstimationError(f"alignment: three common points are needed, not {count}{_listed(names)}")
    middle_a, middle_b = points_a_m.mean(axis=0), points_b_m.mean(axis=0)
    arms_a, arms_b = points_a_m - middle_a, points_b_m - middle_b
    covariance = arms_b.T @ arms_a
    rotation = nearest_rotation(covariance)
    symmetric = rotation.T @ covariance
    scale = float(np.trace(symmetric) / (arms_a**2).sum()) if with_scale and arms_a.any() else 1.0
    rest = arms_b - scale * arms_a @ rotation.T
    misfit = float(np.sqrt((rest**2).sum() / (3 * count - (7 if with_scale else 6))))
    curvature = scale * float(np.linalg.eigvalsh(np.trace(symmetric) * np.eye(3) - symmetric)[0])
    size = float(np.sqrt((arms_b**2).sum() / count))
    contradicts = misfit > _CONTRADICTION * size
    noise = _ROUNDING * scale * abs(float(np.trace(symmetric))) + (0.0 if contradicts else misfit**2)
    sigma_turn = float(np.sqrt(noise / curvature)) if curvature > 0 else float("inf")
    if not sigma_turn <= _MOST_UNCERTAIN_RAD:
        if contradicts and not (_on_a_line(arms_a) or _on_a_line(arms_b)):
            raise EstimationError(
                f"alignment: the {count} points{_listed(names)} contradict each other: after the best motion "
                f"coordinates differ by {misfit:.2g} m in a set of {size:.2g} m; look for a mirror image, exchanged "
                "names or another unit"
            )
        raise EstimationError(
            f"alignment: the {count} points are on one line as far as they can tell{_listed(names)}: across it they "
            f"reach {np.sqrt(max(curvature, 0.0) / count):.2g} m (RMS), after the alignment coordinates differ by "
            f"{misfit:.2g} m, and the turn about it is uncertain by {sigma_turn:.2g} rad (at most "
            f"{_MOST_UNCERTAIN_RAD:.2g}); add a point beside the line"
        )
    return Alignment(RigidTransform(rotation, middle_b - scale * rotation @ middle_a), scale, misfit, sigma_turn)


def _on_a_line(arms_m: FloatArray) -> bool:
    """Whether points about their middle lie on a line to rounding."""
    spread = np.linalg.eigvalsh(arms_m.T @ arms_m)
    return bool(spread[0] + spread[1] <= 10 * _ROUNDING * spread[2])


def _listed(names: Sequence[str]) -> str:
    if not names:
        return ""
    return f" ({', '.join(names[:8])}{f' and {len(names) - 8} more' if len(names) > 8 else ''})"
