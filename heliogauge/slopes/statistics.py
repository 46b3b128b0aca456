"""What a slope map says in a few numbers, each with its sigma: SDx and SDy, focal lengths, twist, canting.

Every mean and every fit weights the measured nodes equally: the grid is regular, so equal weight is equal projected
area, as spec C-03 asks. Nodes that were not measured count nowhere, and the share that was measured is always given.
"""

from dataclasses import dataclass

import numpy as np

from heliogauge.slopes.grid import Derivative, curl, curvature, difference, resample
from heliogauge.slopes.map import SlopeMap
from heliogauge.slopes.removal import (
    MeasuredNodes,
    Projection,
    Removal,
    inverse_length,
    joined_removals,
    measured_nodes,
    projection_of,
    reference_words,
    removal_columns,
    removal_words,
    remove,
)
from heliogauge.validate import FloatArray, covariance_matrix, float_array, positive

__all__ = [
    "Canting",
    "Derivative",
    "QuadraticFit",
    "Removal",
    "SlopeStatistics",
    "canting",
    "curl",
    "curvature",
    "difference",
    "fit_quadratic",
    "remove",
    "resample",
    "statistics",
]


@dataclass(frozen=True, slots=True, eq=False)
class SlopeStatistics:
    """RMS slope deviations of the normal, with everything that must be said beside them.

    Parameters
    ----------
    sdx_rad, sdy_rad : float
        RMS of the slope error in x and in y [rad].
    sd_rad : float
        RMS angle between measured and reference normal [rad].
    mean_x_rad, mean_y_rad : float
        Mean slope error before anything was removed [rad].
    sigma_sdx_rad, sigma_sdy_rad, sigma_sd_rad : float
        Standard deviation of the three RMS values, from random and common errors of measurement [rad].
    noise_rms_x_rad, noise_rms_y_rad : float
        RMS that the random noise alone would show; it is contained in SDx and SDy quadratically [rad].
    removed : str
        What was taken out, in words with numbers.
    reference : str
        The surface that the deviations refer to.
    measured_share : float
        Share of the mirror's area that was measured.

    Notes
    -----
    Gouws/STE guideline section 1.2.1.2 (spec C-03). Angles of the *normal*: the beam turns by twice as much.
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

    def focus_deviation_m(self, distance_m: float) -> tuple[float, float, float]:
        """Return the RMS miss at a distance from the mirror: ``FD = 2 d SD`` in x, in y and in both.

        Parameters
        ----------
        distance_m : float
            Distance from the mirror to the target [m].

        Returns
        -------
        tuple of float
            FDx, FDy and FD [m].
        """
        reach = 2 * positive("distance_m", distance_m, "metres")
        return reach * self.sdx_rad, reach * self.sdy_rad, reach * self.sd_rad


@dataclass(frozen=True, slots=True, eq=False)
class QuadraticFit:
    """The surface ``z = A x^2 + B y^2 + C x + D y + E x y`` fitted to the measured slopes.

    Parameters
    ----------
    coefficients : ndarray, shape (5,)
        A, B [1/m], C, D and E [1/m].
    covariance : ndarray, shape (5, 5)
        Their covariance from the errors of measurement, random and common.
    residual_rms_x_rad, residual_rms_y_rad : float
        RMS slope that the quadratic leaves [rad].

    Notes
    -----
    ``dz/dx = 2 A x + C + E y`` and ``dz/dy = 2 B y + D + E x`` (spec C-32, SOFAST).
    """

    coefficients: FloatArray
    covariance: FloatArray
    residual_rms_x_rad: float
    residual_rms_y_rad: float

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

    Parameters
    ----------
    slope_rad : ndarray, shape (2,)
        Mean slope error in x and y over the measured nodes [rad].
    covariance_slope_rad2 : ndarray, shape (2, 2)
        Its covariance, random and common [rad^2].
    angle_rad : float
        Angle between the mean measured and the mean design normal [rad].
    sigma_angle_rad : float
        Standard deviation of that angle [rad].
    measured_share : float
        Share of the facet that was measured.

    Notes
    -----
    Both mean normals are taken over the same, measured nodes (spec C-04 compares with the design at the centroid): a
    hole in the map of a curved facet then does not look like a tilt.
    """

    slope_rad: FloatArray
    covariance_slope_rad2: FloatArray
    angle_rad: float
    sigma_angle_rad: float
    measured_share: float


def statistics(slope_map: SlopeMap, *, removed: Removal = Removal.NOTHING) -> SlopeStatistics:
    """Form the RMS slope deviations against the design, or against a best fit.

    Parameters
    ----------
    slope_map : SlopeMap
        The measured map.
    removed : Removal, optional
        What is taken out first: NOTHING or TILT refer to the design with its design focal length, FOCUS to the design
        with its best-fit focal length, QUADRATIC to the best-fit astigmatic paraboloid.

    Returns
    -------
    SlopeStatistics
        RMS values with sigma, noise share, reference and measured share.

    Raises
    ------
    EstimationError
        Too few nodes, or nodes on a line, for what is to be removed.

    Notes
    -----
    The angle between normals is ``atan2(|n x m|, n.m)``: arccos would lose everything below 1e-8 rad.

    Sigma is first order: with e the errors left, g = dSD/de and c the map's noise correlation,
    ``var SD = c sum g^2 sigma^2 + sum_k (g . mode_k)^2``, where g is projected like the errors. Because e contains
    the noise, the random part overcounts by ``sum sigma^4 / 2``, which is taken off; it matters only where SD is near
    the noise. The expected value of SD^2 contains ``noise_rms^2``; it is reported, not subtracted.

    Tilt is the mean slope error. On steep designs (slope p) a rigid rotation leaves about p^2 of itself.
    """
    nodes = measured_nodes(slope_map)
    projection = projection_of(removal_columns(slope_map, nodes, removed))
    left = projection.leave(nodes.errors)
    count = nodes.count
    in_x = (np.arange(2 * count) < count).astype(np.float64)
    sdx, sdy = (float(np.sqrt(np.mean(half**2))) for half in left.reshape(2, -1))
    angle, pull, metric = _normal_angles(slope_map, nodes, left)
    sd = float(np.sqrt(np.mean(angle**2)))
    amounts = projection.amounts(nodes.errors)
    return SlopeStatistics(
        sdx_rad=sdx,
        sdy_rad=sdy,
        sd_rad=sd,
        mean_x_rad=float(nodes.errors[:count].mean()),
        mean_y_rad=float(nodes.errors[count:].mean()),
        sigma_sdx_rad=_sigma_of_rms(sdx, in_x * left, in_x, nodes, projection),
        sigma_sdy_rad=_sigma_of_rms(sdy, (1 - in_x) * left, 1 - in_x, nodes, projection),
        sigma_sd_rad=_sigma_of_rms(sd, pull, metric, nodes, projection),
        noise_rms_x_rad=float(np.sqrt(nodes.variance[:count].mean())),
        noise_rms_y_rad=float(np.sqrt(nodes.variance[count:].mean())),
        removed=joined_removals(slope_map.removed, removal_words(slope_map, nodes, removed, amounts)),
        reference=reference_words(slope_map, removed),
        measured_share=slope_map.measured_share,
    )


def _sigma_of_rms(
    rms: float, pull: FloatArray, metric: FloatArray, nodes: MeasuredNodes, projection: Projection
) -> float:
    """Return the sigma of an RMS over nodes, with ``n rms^2`` changing by ``2 pull . d(errors)``.

    `metric` is how each squared error counts in n rms^2 (cross terms left out: they matter only for noise squared).
    """
    if rms == 0:
        return 0.0
    gradient = projection.leave(pull)
    doubled = float(np.sum((metric * nodes.variance) ** 2)) / 2
    random = nodes.noise_correlation * max(float(gradient**2 @ nodes.variance) - doubled, 0.0)
    common = float(np.sum((nodes.modes @ gradient) ** 2))
    return float(np.sqrt(random + common)) / (nodes.count * rms)


def _normal_angles(
    slope_map: SlopeMap, nodes: MeasuredNodes, left: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the angles between normals (n,), half the gradient of their squares and its metric (2n,)."""
    p, q = slope_map.design_slope_x[nodes.valid], slope_map.design_slope_y[nodes.valid]
    dp, dq = left[: nodes.count], left[nodes.count :]
    # |n x m| for n = (-p, -q, 1), m = n - (dp, dq, 0): the small differences appear as factors, never subtracted
    cross = np.sqrt(dp**2 + dq**2 + (p * dq - q * dp) ** 2)
    dot = 1 + p * (p + dp) + q * (q + dq)
    # Metric of the normals at half way: angle^2 = e^T G e to third order
    middle_p, middle_q = p + 0.5 * dp, q + 0.5 * dq
    scale = (1 + middle_p**2 + middle_q**2) ** 2
    metric_x, metric_y, mixed = (1 + middle_q**2) / scale, (1 + middle_p**2) / scale, -middle_p * middle_q / scale
    pull = np.concatenate([metric_x * dp + mixed * dq, metric_y * dq + mixed * dp])
    return np.arctan2(cross, dot), pull, np.concatenate([metric_x, metric_y])


def fit_quadratic(slope_map: SlopeMap) -> QuadraticFit:
    """Fit a quadratic surface to the measured slopes.

    Parameters
    ----------
    slope_map : SlopeMap
        The measured map.

    Returns
    -------
    QuadraticFit
        A, B, C, D, E with covariance; focal lengths and twist.

    Raises
    ------
    EstimationError
        Fewer than three nodes, or all on a line.

    Notes
    -----
    Unweighted least squares: equal weight is equal area. The covariance is that of the errors of measurement (random
    and common) carried through the fit; what the real surface has beyond a quadratic is in the residual RMS.
    """
    nodes = measured_nodes(slope_map)
    x0, y0 = float(nodes.x_m.mean()), float(nodes.y_m.mean())
    x, y = nodes.x_m - x0, nodes.y_m - y0
    zero, one = np.zeros(nodes.count), np.ones(nodes.count)
    columns = np.stack(
        [np.concatenate(pair) for pair in ((2 * x, zero), (zero, 2 * y), (one, zero), (zero, one), (y, x))]
    )
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
        residual_rms_x_rad=float(np.sqrt(np.mean(left[: nodes.count] ** 2))),
        residual_rms_y_rad=float(np.sqrt(np.mean(left[nodes.count :] ** 2))),
    )


def canting(slope_map: SlopeMap) -> Canting:
    """Compare the facet's mean normal with its design's.

    Parameters
    ----------
    slope_map : SlopeMap
        The map of one facet, tilt not removed.

    Returns
    -------
    Canting
        Mean slope error with covariance, and the angle between the mean normals.

    Raises
    ------
    EstimationError
        Fewer than three measured nodes.
    """
    nodes = measured_nodes(slope_map)
    valid = nodes.valid
    mean_slope = nodes.errors.reshape(2, -1).mean(axis=1)
    modes = nodes.modes.reshape(-1, 2, nodes.count).mean(axis=2)
    random = nodes.noise_correlation * nodes.variance.reshape(2, -1).sum(axis=1) / nodes.count**2
    covariance = np.diag(random) + modes.T @ modes
    measured = _mean_normal(slope_map.slope_x[valid], slope_map.slope_y[valid])
    design = _mean_normal(slope_map.design_slope_x[valid], slope_map.design_slope_y[valid])
    angle = float(np.arctan2(np.linalg.norm(np.cross(design, measured)), design @ measured))
    length = float(np.linalg.norm(mean_slope))
    direction = mean_slope / length if length > 0 else np.array([1.0, 0.0])
    sigma = float(np.sqrt(direction @ covariance @ direction))
    return Canting(mean_slope, covariance, angle, sigma, slope_map.measured_share)


def _mean_normal(slope_x: FloatArray, slope_y: FloatArray) -> FloatArray:
    length = np.sqrt(1 + slope_x**2 + slope_y**2)
    return np.array([-(slope_x / length).mean(), -(slope_y / length).mean(), (1 / length).mean()])


def _symmetric(matrix: FloatArray) -> FloatArray:
    return 0.5 * (matrix + matrix.T)
