"""The same trough at several orientations: what its own weight does to the absorber tube, and to the mirror."""

from dataclasses import dataclass

import numpy as np

from heliogauge.errors import EstimationError
from heliogauge.slopes.grid import difference
from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import FloatArray, float_array


@dataclass(frozen=True, slots=True, eq=False)
class SpanSags:
    """Sag of one span of the tube, measured at several orientations.

    orientation_rad (k,): Turn of the collector from zenith, by the right hand about +y [rad].
    sag_x_m, sag_z_m (k,): Sag across the trough and along its optical axis [m].
    sigma_x_m, sigma_z_m (k,): Standard deviations [m].
    """

    orientation_rad: FloatArray
    sag_x_m: FloatArray
    sag_z_m: FloatArray
    sigma_x_m: FloatArray
    sigma_z_m: FloatArray

    def __post_init__(self) -> None:
        count = np.size(self.orientation_rad)
        for name in self.__slots__:
            object.__setattr__(self, name, float_array(f"sags {name}", getattr(self, name), (count,)))


@dataclass(frozen=True, slots=True)
class WeightSag:
    """A span's sag as a part that follows gravity and one that turns with the collector.

    by_weight_m, sigma_by_weight_m: Sag under the tube's whole weight, positive downward [m].
    bend_x_m, bend_z_m: Bend that the tube keeps at every orientation [m].
    sigma_bend_x_m, sigma_bend_z_m: Standard deviations [m].
    worst_residual: Largest departure of a measured sag from the two parts, in its standard deviations.
    """

    by_weight_m: float
    sigma_by_weight_m: float
    bend_x_m: float
    bend_z_m: float
    sigma_bend_x_m: float
    sigma_bend_z_m: float
    worst_residual: float


#: Orientations that differ by less say nothing of what weight does [rad].
LEAST_TURN_RAD = np.radians(10.0)


def sag_by_weight(sags: SpanSags) -> WeightSag:
    """Separate what gravity does to a span from the bend that it has anyway.

    sags: Sags of one span at two orientations or more.
    Returns: Both parts with their uncertainty.
    EstimationError: Fewer than two orientations at least 10 degrees apart.

    At orientation t down is (sin t, -cos t) in the trough's frame, so that a tube equally stiff in all directions has
    ``sag = g (sin t, -cos t) + bend``: weighted least squares for g and the two components of the bend.
    """
    turn = sags.orientation_rad
    if turn.size < 2 or np.ptp(turn) < LEAST_TURN_RAD:
        raise EstimationError(
            f"orientation study: {turn.size} orientations within {np.degrees(np.ptp(turn) if turn.size else 0):.0f} "
            "degrees; two at least 10 degrees apart are needed to separate weight from bend"
        )
    zero, one = np.zeros(turn.size), np.ones(turn.size)
    design = np.concatenate([np.column_stack([np.sin(turn), one, zero]), np.column_stack([-np.cos(turn), zero, one])])
    sigma = np.concatenate([sags.sigma_x_m, sags.sigma_z_m])
    value = np.concatenate([sags.sag_x_m, sags.sag_z_m])
    covariance = np.linalg.inv(design.T @ (design / sigma[:, None] ** 2))
    found = covariance @ (design.T @ (value / sigma**2))
    sigmas = np.sqrt(np.diagonal(covariance))
    worst = float(np.max(np.abs(value - design @ found) / sigma))
    return WeightSag(
        float(found[0]), float(sigmas[0]), float(found[1]), float(found[2]), float(sigmas[1]), float(sigmas[2]), worst
    )


@dataclass(frozen=True, slots=True)
class MirrorChange:
    """How the mirror's slopes across differ between two orientations.

    tilt_rad: Change of the mean of theta_r: the whole mirror turned beside its targets [rad].
    rms_rad: RMS of the change without that [rad].
    noise_rad: RMS of the change that the stated sigmas let expect from noise alone [rad].
    """

    tilt_rad: float
    rms_rad: float
    noise_rad: float


def theta_r_change(first: SlopeMap, other: SlopeMap) -> FloatArray:
    """Return how theta_r changes from one orientation to another.

    first, other: Maps on the same grid.
    Returns (ny, nx): Other minus first; NaN where either has no value [rad].
    InputError: The grids differ.
    """
    change = difference(other, first)
    # theta_r = atan(design) - atan(slope), to first order in the change.
    angle = -change.slope_x / (1 + first.slope_x**2)
    return np.asarray(np.where(change.valid, angle, np.nan))


def change_sigma(first: SlopeMap, other: SlopeMap) -> FloatArray:
    """Return the standard deviation of `theta_r_change` from the noise of both maps, shape (ny, nx) [rad]."""
    return np.asarray(np.hypot(first.sigma_random_x, other.sigma_random_x) / (1 + first.slope_x**2))


def mirror_change(first: SlopeMap, other: SlopeMap) -> MirrorChange:
    """Say in numbers how the mirror differs between two orientations.

    first, other: Maps on the same grid.
    Returns: Turn of the whole, RMS of the rest, and what noise explains of it.
    InputError: The grids differ.
    EstimationError: They have no measured point in common.
    """
    change = theta_r_change(first, other)
    valid = np.isfinite(change)
    if not valid.any():
        raise EstimationError("orientation study: the slope maps have no measured point in common")
    random = change_sigma(first, other)
    tilt = float(change[valid].mean())
    return MirrorChange(tilt, float(np.std(change[valid])), float(np.sqrt(np.mean(random[valid] ** 2))))
