"""A slope map in a few numbers, each with its sigma: SDx and SDy, focal lengths, twist, canting.

Every mean and every fit weights the measured nodes equally: the grid is regular, so equal weight is equal projected
area, as spec C-03 asks. Nodes that were not measured count nowhere, and the share that was measured is always given.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from heliogauge.slopes.map import SlopeMap
from heliogauge.slopes.normal_angles import d_angles_d_slopes, normal_angles, tangents
from heliogauge.slopes.removal import (
    Removal,
    inverse_length,
    joined_removals,
    measured_nodes,
    projection_of,
    reference_words,
    removal_columns,
    removal_words,
)
from heliogauge.validate import FloatArray, covariance_matrix, float_array, positive


class FocusDeviation(NamedTuple):
    """RMS miss of the reflected beam on a target: in x, in y, and in both [m]."""

    x_m: float
    y_m: float
    both_m: float


@dataclass(frozen=True, slots=True, eq=False)
class SlopeStatistics:
    """RMS angles between measured and reference normals, with everything that must be said beside them.

    sdx_rad, sdy_rad: RMS of the angle's components in x and in y [rad].
    sd_rad: RMS of the whole angle; its square is the sum of the squares of SDx and SDy [rad].
    mean_x_rad, mean_y_rad: Mean of the two components before anything was removed [rad].
    sigma_sdx_rad, sigma_sdy_rad, sigma_sd_rad: Standard deviation of the three RMS values, from random and common
        errors of measurement [rad].
    noise_rms_x_rad, noise_rms_y_rad: RMS that the random noise alone would show; it is contained in SDx and SDy
        quadratically [rad].
    removed: What was taken out, in words with numbers.
    reference: The surface that the deviations refer to.
    measured_share: Share of the mirror's area that was measured.

    Gouws/STE guideline section 1.2.1.2 (spec C-03), with the components of `heliogauge.slopes.normal_angles`. Angles
    of the *normal*: the beam turns by twice as much. The RMS of the slope errors themselves is larger by 1 + p^2
    where the slope is p.
    """

    sdx_rad: float
    sdy_rad: float
    sd_rad: float
    mean_x_rad: float
    mean_y_rad: float
    sigma_sdx_rad: float
    sigma_sdy_rad: float
    sigma_sd_rad: float
    noise_rms_x_rad: float
    noise_rms_y_rad: float
    removed: str
    reference: str
    measured_share: float

    def focus_deviation_m(self, distance_m: float) -> FocusDeviation:
        """Return the RMS miss at a distance from the mirror: ``FD = 2 d SD`` in x, in y and in both.

        InputError: The distance is not a positive number.
        """
        reach = 2 * positive("distance_m", distance_m, "metres")
        return FocusDeviation(reach * self.sdx_rad, reach * self.sdy_rad, reach * self.sd_rad)


@dataclass(frozen=True, slots=True, eq=False)
class QuadraticFit:
    """The surface ``z = A x^2 + B y^2 + C x + D y + E x y`` fitted to the measured slopes.

    coefficients (5,): A, B [1/m], C, D and E [1/m].
    covariance (5, 5): Their covariance from the errors of measurement, random and common.
    residual_slope_rms_x, residual_slope_rms_y: RMS of dz/dx and of dz/dy that the quadratic leaves.

    ``dz/dx = 2 A x + C + E y`` and ``dz/dy = 2 B y + D + E x`` (spec C-32, SOFAST).
    """

    coefficients: FloatArray
    covariance: FloatArray
    residual_slope_rms_x: float
    residual_slope_rms_y: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "coefficients", float_array("coefficients", self.coefficients, (5,)))
        object.__setattr__(self, "covariance", covariance_matrix("covariance", self.covariance, 5))

    @property
    def focal_length_x_m(self) -> float:
        """``1 / (4 A)`` [m]; infinite for a flat."""
        return inverse_length(4 * float(self.coefficients[0]))

    @property
    def focal_length_y_m(self) -> float:
        """``1 / (4 B)`` [m]; infinite for a flat."""
        return inverse_length(4 * float(self.coefficients[1]))

    @property
    def sigma_focal_length_x_m(self) -> float:
        """Standard deviation of the focal length in x [m]."""
        return 4 * self.focal_length_x_m**2 * float(np.sqrt(self.covariance[0, 0]))

    @property
    def sigma_focal_length_y_m(self) -> float:
        """Standard deviation of the focal length in y [m]."""
        return 4 * self.focal_length_y_m**2 * float(np.sqrt(self.covariance[1, 1]))

    @property
    def twist_per_m(self) -> float:
        """The coefficient E [1/m]."""
        return float(self.coefficients[4])


@dataclass(frozen=True, slots=True, eq=False)
class Canting:
    """How far a facet as a whole points away from its design.

    components_rad (2,): Components in x and in y of the angle from the mean design normal to the mean measured
        normal, with the signs of slope errors: positive where the facet rises too much towards +x or +y [rad].
    covariance_components_rad2 (2, 2): Their covariance, random and common [rad^2].
    sigma_angle_rad: Standard deviation of that angle [rad].
    measured_share: Share of the facet that was measured.

    Both mean normals are taken over the same, measured nodes (spec C-04 compares with the design at the centroid): a
    hole in the map of a curved facet then does not look like a tilt.
    """

    components_rad: FloatArray
    covariance_components_rad2: FloatArray
    angle_rad: float
    sigma_angle_rad: float
    measured_share: float


def statistics(slope_map: SlopeMap, *, removed: Removal = Removal.NOTHING) -> SlopeStatistics:
    """Form the RMS angles between the measured normals and those of the design, or of a best fit.

    removed: What is taken out first: NOTHING or TILT refer to the design with its design focal length, FOCUS to the
        design with its best-fit focal length, QUADRATIC to the best-fit astigmatic paraboloid.
    Returns: RMS values with sigma, noise share, reference and measured share.
    EstimationError: Too few nodes, or nodes on a line, for what is to be removed.

    Removal is of slopes, as in `remove`; the angles are those of the normals with the slopes that are left.

    Sigma is first order: with e the slope errors left, g = dSD/de and c the map's noise correlation,
    ``var SD = c sum g^2 sigma^2 + sum_k (g . mode_k)^2``, where g is projected like the errors. Because e contains
    the noise, the random part overcounts by half the squared covariance of each node's angles, which is taken off; it
    matters only where SD is near the noise. The expected value of SD^2 contains ``noise_rms^2``; it is reported, not
    subtracted.

    Tilt is the mean slope error. On steep designs (slope p) a rigid rotation leaves about p^2 of itself.
    """
    nodes = measured_nodes(slope_map)
    projection = projection_of(removal_columns(slope_map, nodes, removed))
    design = np.stack([slope_map.design_slope_x[nodes.valid], slope_map.design_slope_y[nodes.valid]])
    errors_left = projection.leave(nodes.errors)
    left = design + errors_left.reshape(2, -1)
    angles, by_slope = normal_angles(*left, *design), d_angles_d_slopes(*left)
    noise = np.einsum("ijn,jn,kjn->ikn", by_slope, nodes.variance.reshape(2, -1), by_slope)

    def sigma_of_rms(chosen: list[int]) -> float:
        """Return the sigma of the RMS of one component, or of both: with n rms^2 changing by 2 pull . d(errors)."""
        squares = float(np.sum(angles[chosen] ** 2))
        if squares == 0:
            return 0.0
        pull = projection.leave(np.einsum("in,ijn->jn", angles[chosen], by_slope[chosen]).reshape(-1))
        overcount = 0.5 * float(np.sum(noise[np.ix_(chosen, chosen)] ** 2))
        random = nodes.noise_correlation * max(float(pull**2 @ nodes.variance) - overcount, 0.0)
        common = float(np.sum((nodes.modes @ pull) ** 2))
        return float(np.sqrt((random + common) / (nodes.count * squares)))

    sdx, sdy = np.sqrt(np.mean(angles**2, axis=1)).tolist()
    mean_x, mean_y = normal_angles(*(design + nodes.errors.reshape(2, -1)), *design).mean(axis=1).tolist()
    noise_x, noise_y = (float(np.sqrt(noise[i, i].mean())) for i in (0, 1))
    return SlopeStatistics(
        sdx_rad=sdx,
        sdy_rad=sdy,
        sd_rad=float(np.hypot(sdx, sdy)),
        mean_x_rad=mean_x,
        mean_y_rad=mean_y,
        sigma_sdx_rad=sigma_of_rms([0]),
        sigma_sdy_rad=sigma_of_rms([1]),
        sigma_sd_rad=sigma_of_rms([0, 1]),
        noise_rms_x_rad=noise_x,
        noise_rms_y_rad=noise_y,
        removed=joined_removals(
            slope_map.removed, removal_words(slope_map, nodes, removed, projection.amounts(nodes.errors))
        ),
        reference=reference_words(slope_map, removed),
        measured_share=slope_map.measured_share,
    )


def fit_quadratic(slope_map: SlopeMap) -> QuadraticFit:
    """Fit a quadratic surface to the measured slopes.

    Returns: A, B, C, D, E with covariance; focal lengths and twist.
    EstimationError: Fewer than three nodes, or all on a line.

    Unweighted least squares: equal weight is equal area. The covariance is that of the errors of measurement (random
    and common) propagated through the fit; what the real surface has beyond a quadratic is in the residual RMS.
    """
    nodes = measured_nodes(slope_map)
    x0, y0 = float(nodes.x_m.mean()), float(nodes.y_m.mean())
    x, y = nodes.x_m - x0, nodes.y_m - y0
    zero, one = np.zeros(nodes.count), np.ones(nodes.count)
    pairs = ((2 * x, zero), (zero, 2 * y), (one, zero), (zero, one), (y, x))
    columns = np.stack([np.concatenate(pair) for pair in pairs])
    projection = projection_of(columns)
    slopes = np.concatenate([slope_map.slope_x[nodes.valid], slope_map.slope_y[nodes.valid]])
    centred = projection.amounts(slopes)
    # From coordinates about the mean node back to the map's own: C = C' - 2 A x0 - E y0, D = D' - 2 B y0 - E x0
    back = np.eye(5)
    back[2, [0, 4]], back[3, [1, 4]] = (-2 * x0, -y0), (-2 * y0, -x0)
    carry = (projection.inverse / projection.norms[:, None]) @ projection.columns
    modes = projection.amounts(nodes.modes)
    covariance = nodes.noise_correlation * (carry * nodes.variance) @ carry.T + modes.T @ modes
    left = projection.leave(slopes)
    return QuadraticFit(
        coefficients=back @ centred,
        covariance=_symmetric(back @ covariance @ back.T),
        residual_slope_rms_x=float(np.sqrt(np.mean(left[: nodes.count] ** 2))),
        residual_slope_rms_y=float(np.sqrt(np.mean(left[nodes.count :] ** 2))),
    )


def canting(slope_map: SlopeMap) -> Canting:
    """Compare the facet's mean normal with its design's.

    slope_map: The map of one facet, tilt not removed.
    Returns: The angle between the mean normals and its components, with sigma and covariance.
    EstimationError: Fewer than three measured nodes.
    """
    nodes = measured_nodes(slope_map)
    valid = nodes.valid
    slopes = slope_map.slope_x[valid], slope_map.slope_y[valid]
    mean_normal = _mean_normal(*slopes)
    mean_slopes = -mean_normal[:2] / mean_normal[2]
    design = _mean_normal(slope_map.design_slope_x[valid], slope_map.design_slope_y[valid])
    components = normal_angles(*mean_slopes, *(-design[:2] / design[2]))
    # A turn of one node's normal counts in the mean with its part across the mean normal.
    share = 1 / (nodes.count * np.linalg.norm(mean_normal))
    across = np.einsum("ic,kcn->ikn", share * tangents(*mean_slopes), tangents(*slopes))
    by_slope = np.einsum("ikn,kjn->ijn", across, d_angles_d_slopes(*slopes)).reshape(2, -1)
    modes = nodes.modes @ by_slope.T
    covariance = nodes.noise_correlation * (by_slope * nodes.variance) @ by_slope.T + modes.T @ modes
    angle = float(np.hypot(*components))
    direction = components / angle if angle > 0 else np.array([1.0, 0.0])
    sigma = float(np.sqrt(direction @ covariance @ direction))
    return Canting(components, covariance, angle, sigma, slope_map.measured_share)


def _mean_normal(slope_x: FloatArray, slope_y: FloatArray) -> FloatArray:
    length = np.sqrt(1 + slope_x**2 + slope_y**2)
    return np.array([-(slope_x / length).mean(), -(slope_y / length).mean(), (1 / length).mean()])


def _symmetric(matrix: FloatArray) -> FloatArray:
    return 0.5 * (matrix + matrix.T)
