"""What a square of cameras will know of slopes that are expected."""

from dataclasses import dataclass

import numpy as np

from deflectometry.gazing.node_slopes import Brightness, expected, solve_nodes
from deflectometry.gazing.sun_profile import SunProfile
from heliogauge.validate import FloatArray

#: Slopes that stand for the mirror: their share of blind points is known to 3 %.
_POINTS = 250


@dataclass(frozen=True, slots=True, eq=False)
class Spacing:
    """What one spacing gives.

    side_m: Of the square. expected_error_rad: RMS error each way, a blind point's slope counted as unknown.
    sigma_rad: RMS of the points that are measured. measured_share, blind_share: Of the mirror.
    sigma_at_zero_rad: Of a point that reflects the sun's centre between the cameras.
    """

    side_m: float
    expected_error_rad: float
    sigma_rad: float
    measured_share: float
    blind_share: float
    sigma_at_zero_rad: float


def judge_spacing(
    side_m: float,
    distance_m: float,
    incidence_rad: float,
    slope_rad: float,
    noise: float,
    largest_sigma_rad: float,
    profile: SunProfile,
    *,
    with_middle: bool = False,
) -> Spacing:
    """Solve points of slopes that are expected, without noise in their light but with its sigma."""
    rng = np.random.default_rng(0)
    slopes = np.vstack([np.zeros((1, 2)), slope_rad * rng.standard_normal((_POINTS, 2))])
    square = 0.5 * side_m * np.array([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])
    places = np.vstack([square, np.zeros((1, 2))]) if with_middle else square
    # The sun on one side of the normal, the cameras on the other; x lies in the plane of incidence.
    turn = np.array([np.sin(incidence_rad), 0.0, np.cos(incidence_rad)])
    across = np.array([np.cos(incidence_rad), 0.0, -np.sin(incidence_rad)])
    eyes = distance_m * turn + places[:, :1] * across + places[:, 1:] * np.array([0.0, 1.0, 0.0])
    count, cameras = len(slopes), len(places)
    zero = np.zeros(count)
    seen = Brightness(
        zero,
        zero,
        zero,
        zero,
        np.zeros((cameras, count, 1, 3)),
        np.zeros((cameras, count, 1, 2)),
        np.zeros((cameras, count)),
        np.full((cameras, count), noise),
        eyes,
        turn * np.array([-1.0, 1.0, 1.0]),
    )
    light = expected(seen, slopes, profile)
    found = solve_nodes(seen.with_value(light), profile, np.ones(cameras))
    sigma = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
    lit = np.asarray((light > 4 * noise).any(axis=0))[1:]
    good = lit & (sigma[1:].max(axis=1) <= largest_sigma_rad)
    squares = np.where(good[:, None], sigma[1:] ** 2, slope_rad**2)
    return Spacing(
        side_m,
        float(np.sqrt(squares.mean())),
        float(np.sqrt(np.mean(sigma[1:][good] ** 2))) if good.any() else np.nan,
        float(good.mean()),
        float((lit & ~good).mean()),
        float(np.sqrt(np.mean(sigma[0] ** 2))),
    )


def sides(closest_m: float, farthest_m: float) -> FloatArray:
    """Return the sides that are compared: each a fifth longer than the one before [m]."""
    count = int(np.ceil(np.log(farthest_m / closest_m) / np.log(1.2))) + 1
    return np.geomspace(closest_m, farthest_m, count)
