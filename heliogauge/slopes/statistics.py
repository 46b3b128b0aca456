"""A slope map in a few numbers, each with its sigma: SDx and SDy, focal lengths, twist, canting.

Every mean and every fit weights the measured nodes equally: the grid is regular, so equal weight is equal projected
area, as spec C-03 asks. Nodes that were not measured count nowhere, and the share that was measured is always given.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from heliogauge.slopes.map import CELLS, SlopeMap
from heliogauge.slopes.normal_angles import (
    across_normal,
    angles_of_errors,
    d_angles_d_slopes,
    normal_angles,
    tangents,
)
from heliogauge.slopes.removal import (
    PATTERN_SHARES,
    MeasuredNodes,
    Patterns,
    Removal,
    RemovalFit,
    fit_removals,
    inverse_length,
    inverse_of_products,
    joined_removals,
    measured_nodes,
    reference_words,
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
    def curvature_x_per_m(self) -> float:
        """``2 A``, the change of dz/dx along x: 1 / (2 f); negative for a convex mirror [1/m]."""
        return 2 * float(self.coefficients[0])

    @property
    def curvature_y_per_m(self) -> float:
        """``2 B``, the change of dz/dy along y [1/m]."""
        return 2 * float(self.coefficients[1])

    @property
    def sigma_curvature_x_per_m(self) -> float:
        """Standard deviation of the curvature in x [1/m]."""
        return 2 * float(np.sqrt(self.covariance[0, 0]))

    @property
    def sigma_curvature_y_per_m(self) -> float:
        """Standard deviation of the curvature in y [1/m]."""
        return 2 * float(np.sqrt(self.covariance[1, 1]))

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
    ``var SD = c sum g^2 sigma^2 + sum_k (g . mode_k)^2 + (g . f w)^2``, where g is projected like the errors, w is what
    a quadratic leaves without its noise, and f the map's `fine_share`. Because e contains the noise, the random part
    overcounts by half the squared covariance of each node's angles, which is taken off; it
    matters only where SD is near the noise. The expected value of SD^2 contains ``noise_rms^2``; it is reported, not
    subtracted. Errors of the cells of a code (`heliogauge.slopes.map.CELLS`) are no noise that averages: there sigma
    contains what they add, ``SD - sqrt(SD^2 - noise_rms^2)``.

    Tilt is the mean slope error. On steep designs (slope p) a rigid rotation leaves about p^2 of itself.
    """
    return statistics_of_removals(slope_map, [removed])[0]


def statistics_of_removals(
    slope_map: SlopeMap, removals: Sequence[Removal], nodes: MeasuredNodes | None = None
) -> list[SlopeStatistics]:
    """Form `statistics` with one removal after the other, from one set of nodes.

    nodes: The map's `measured_nodes`, where they are at hand.
    EstimationError: As there.
    """
    nodes = nodes or measured_nodes(slope_map)
    patterns = Patterns.of(nodes)
    # What a quadratic leaves is what blur and a wrong scale change.
    fine = bool(slope_map.fine_share.any())
    asked = [*removals, Removal.QUADRATIC] if fine and Removal.QUADRATIC not in removals else list(removals)
    fits = fit_removals(nodes, patterns, asked)
    every = _BlockSums.zero(nodes.common.coefficients.shape[2])
    sums_of_fits = [_AngleSums.zero(nodes.common.coefficients.shape[2]) for _ in fits]
    mean = np.zeros(2)
    for part in nodes.blocks():
        block = _Block.of(nodes, patterns, part)
        angles = block.angles(block.errors)
        mean += angles.sum(axis=1)
        every.add(block)
        for fit, sums in zip(fits, sums_of_fits, strict=True):
            sums.add(block, block.angles(block.errors - fit.change(block.basis)) if fit.taken else angles)
    mean /= nodes.count
    by_waves = np.zeros(2)
    if fine:
        rough = sums_of_fits[asked.index(Removal.QUADRATIC)]
        by_waves = slope_map.fine_share * np.maximum(rough.squares - every.noise, 0.0)
    found = []
    for fit, sums in zip(fits[: len(removals)], sums_of_fits, strict=False):
        sdx, sdy = np.sqrt(sums.squares / nodes.count).tolist()
        noise_x, noise_y = np.sqrt(every.noise / nodes.count).tolist()
        sigma_x, sigma_y, sigma = (
            sums.sigma_of_rms(nodes, fit, every, by_waves, chosen) for chosen in ([0], [1], [0, 1])
        )
        found.append(
            SlopeStatistics(
                sdx_rad=sdx,
                sdy_rad=sdy,
                sd_rad=float(np.hypot(sdx, sdy)),
                mean_x_rad=float(mean[0]),
                mean_y_rad=float(mean[1]),
                sigma_sdx_rad=sigma_x,
                sigma_sdy_rad=sigma_y,
                sigma_sd_rad=sigma,
                noise_rms_x_rad=noise_x,
                noise_rms_y_rad=noise_y,
                removed=joined_removals(slope_map.removed, removal_words(fit, patterns)),
                reference=reference_words(slope_map, fit.removal),
                measured_share=slope_map.measured_share,
            )
        )
    return found


@dataclass(frozen=True, slots=True, eq=False)
class _Block:
    """Some of the nodes: design slopes, errors and variance (2, b).

    across: `across_normal` of the design.
    turns (3, b): How the angles change with the measured slopes: each with its own, and with the other's.
    both (5 + n_terms, b): Parts of the patterns, then monomials.
    """

    design: FloatArray
    errors: FloatArray
    variance: FloatArray
    across: tuple[FloatArray, FloatArray, FloatArray]
    turns: FloatArray
    both: FloatArray

    @classmethod
    def of(cls, nodes: MeasuredNodes, patterns: Patterns, part: slice) -> "_Block":
        design, errors = nodes.design[:, part], nodes.errors[:, part]
        both = np.concatenate([patterns.basis(nodes.x_m[part], nodes.y_m[part], design), nodes.terms(part)])
        ((by_x, mixed), (_, by_y)) = d_angles_d_slopes(*(design + errors))
        turns = np.stack([by_x, mixed, by_y])
        return cls(design, errors, nodes.variance[:, part], across_normal(*design), turns, both)

    @property
    def basis(self) -> FloatArray:
        return self.both[:5]

    def angles(self, errors: FloatArray) -> FloatArray:
        """Return the angles (2, b) that slope errors make."""
        return angles_of_errors(errors[0], errors[1], self.design[0], self.design[1], self.across)


@dataclass(slots=True, eq=False)
class _BlockSums:
    """Sums over the nodes that no removal changes.

    squares_of_parts (2, 5, 5): Of the patterns' parts times each other times variance, in x and in y.
    moments_of_parts (5, n_terms): Of the patterns' parts times monomials.
    noise (2,), noise_squares (2, 2): Of the angles' random variances, and of their squared covariances.
    """

    squares_of_parts: FloatArray
    moments_of_parts: FloatArray
    noise: FloatArray
    noise_squares: FloatArray

    @classmethod
    def zero(cls, n_terms: int) -> "_BlockSums":
        return cls(np.zeros((2, 5, 5)), np.zeros((5, n_terms)), np.zeros(2), np.zeros((2, 2)))

    def add(self, block: _Block) -> None:
        (by_x, mixed, by_y), (variance_x, variance_y) = block.turns, block.variance
        for axis in (0, 1):
            self.squares_of_parts[axis] += (block.basis * block.variance[axis]) @ block.basis.T
        self.moments_of_parts += block.basis @ block.both[5:].T
        noise_x = by_x * by_x * variance_x + mixed * mixed * variance_y
        noise_y = mixed * mixed * variance_x + by_y * by_y * variance_y
        both = mixed * (by_x * variance_x + by_y * variance_y)
        shared = float(both @ both)
        self.noise += noise_x.sum(), noise_y.sum()
        self.noise_squares += [[float(noise_x @ noise_x), shared], [shared, float(noise_y @ noise_y)]]

    @property
    def squares(self) -> FloatArray:
        """Sums of patterns times patterns times variance, shape (6, 6)."""
        return np.asarray(np.einsum("kci,cij,lcj->kl", PATTERN_SHARES, self.squares_of_parts, PATTERN_SHARES))

    @property
    def moments(self) -> FloatArray:
        """Sums of patterns times monomials, shape (6, 2, n_terms)."""
        return np.tensordot(PATTERN_SHARES, self.moments_of_parts, axes=1)


@dataclass(slots=True, eq=False)
class _AngleSums:
    """Sums over the nodes that the RMS of the angles and its sigma are made of, after one removal.

    squares (2,): Of the squared angles.
    pulls (2, 2): Of pulls times pulls times variance; a pull is how half the squared angle changes with the slopes.
    pull_parts (2, 2, 5 + n_terms): Of pulls times the patterns' parts and monomials.
    pull_variance_parts (2, 2, 5): Of pulls times variance times the patterns' parts.
    """

    squares: FloatArray
    pulls: FloatArray
    pull_parts: FloatArray
    pull_variance_parts: FloatArray

    @classmethod
    def zero(cls, n_terms: int) -> "_AngleSums":
        return cls(np.zeros(2), np.zeros((2, 2)), np.zeros((2, 2, 5 + n_terms)), np.zeros((2, 2, 5)))

    def add(self, block: _Block, angles: FloatArray) -> None:
        """Add some nodes with the angles (2, b) that a removal leaves.

        How angles change with slopes is taken at the measured slopes: those that are left differ from them by so little
        that a mirror's sigma changes by less than the product of slope and what was removed.
        """
        by_x, mixed, by_y = block.turns
        self.squares += float(angles[0] @ angles[0]), float(angles[1] @ angles[1])
        pull = np.empty((2, 2, angles.shape[1]))
        for row, (angle, along_x, along_y) in enumerate(zip(angles, (by_x, mixed), (mixed, by_y), strict=True)):
            np.multiply(angle, along_x, out=pull[row, 0])
            np.multiply(angle, along_y, out=pull[row, 1])
        weighted = pull * block.variance
        self.pulls += weighted.reshape(2, -1) @ pull.reshape(2, -1).T
        self.pull_parts += (pull.reshape(4, -1) @ block.both.T).reshape(self.pull_parts.shape)
        self.pull_variance_parts += (weighted.reshape(4, -1) @ block.basis.T).reshape(2, 2, 5)

    def sigma_of_rms(
        self, nodes: MeasuredNodes, fit: RemovalFit, every: _BlockSums, by_waves: FloatArray, chosen: list[int]
    ) -> float:
        """Return the sigma of the RMS of one component, or of both: with n rms^2 changing by 2 pull . d(errors).

        by_waves (2,): Sum of pull . d(errors) for 1 sigma of the waviness's scale.
        """
        squares = float(self.squares[chosen].sum())
        if squares == 0:
            return 0.0
        # The pull without the patterns: what they take along with the errors changes nothing that is left.
        taken = fit.taken
        pulled, weighted, moments = (
            parts[chosen].sum(axis=0)
            for parts in (self.pull_parts[..., :5], self.pull_variance_parts, self.pull_parts[..., 5:])
        )
        shares = PATTERN_SHARES[taken]
        share = fit.inverse @ np.einsum("kci,ci->k", shares, pulled)
        random = float(self.pulls[np.ix_(chosen, chosen)].sum())
        random -= 2 * float(share @ np.einsum("kci,ci->k", shares, weighted))
        random += float(share @ every.squares[np.ix_(taken, taken)] @ share)
        overcount = 0.5 * float(every.noise_squares[np.ix_(chosen, chosen)].sum())
        moments = moments - np.tensordot(share, every.moments[taken], axes=1)
        common = float(np.sum(nodes.modes_times(moments[None]) ** 2))
        # One blur and one scale for both directions.
        scale = float(by_waves[chosen].sum()) ** 2
        variance = nodes.noise_correlation * max(random - overcount, 0.0) + common + scale
        sigma = float(np.sqrt(variance / (nodes.count * squares)))
        if CELLS not in nodes.common.sources:
            return sigma
        contained = float(every.noise[chosen].sum())
        excess = (squares**0.5 - max(squares - contained, 0.0) ** 0.5) / nodes.count**0.5
        return float(np.hypot(sigma, excess))


def common_rms(slope_map: SlopeMap, nodes: MeasuredNodes | None = None) -> dict[str, tuple[float, float]]:
    """Return the RMS over the measured nodes of each common source's sigma, in x and in y [rad].

    nodes: The map's `measured_nodes`, where they are at hand.
    EstimationError: Fewer than three measured nodes.
    """
    nodes = nodes or measured_nodes(slope_map)
    common = nodes.common
    n_terms = common.coefficients.shape[2]
    products = np.zeros((n_terms, n_terms))
    for part in nodes.blocks():
        terms = nodes.terms(part)
        products += terms @ terms.T / nodes.count
    squares = np.einsum("kat,ts,kas->ka", common.coefficients, products, common.coefficients)
    found = {}
    for source in dict.fromkeys(common.sources):
        of_source = [number for number, name in enumerate(common.sources) if name == source]
        x, y = np.sqrt(np.maximum(squares[of_source].sum(axis=0), 0.0)).tolist()
        found[source] = (x, y)
    return found


def fit_quadratic(slope_map: SlopeMap, nodes: MeasuredNodes | None = None) -> QuadraticFit:
    """Fit a quadratic surface to the measured slopes.

    nodes: The map's `measured_nodes`, where they are at hand.
    Returns: A, B, C, D, E with covariance; focal lengths and twist.
    EstimationError: Fewer than three nodes, or all on a line.

    Unweighted least squares: equal weight is equal area. The covariance is that of the errors of measurement (random
    and common) propagated through the fit; what the real surface has beyond a quadratic is in the residual RMS.
    """
    nodes = nodes or measured_nodes(slope_map)
    x0, y0 = float(nodes.x_m.mean()), float(nodes.y_m.mean())

    def linear(part: slice) -> FloatArray:
        return np.stack([np.ones(part.stop - part.start), nodes.x_m[part] - x0, nodes.y_m[part] - y0])

    # Of 1, x and y in the slopes in x and in y for A, B, C, D and E.
    shares = np.zeros((5, 2, 3))
    shares[0, 0, 1] = shares[1, 1, 2] = 2.0
    shares[2, 0, 0] = shares[3, 1, 0] = shares[4, 0, 2] = shares[4, 1, 1] = 1.0
    squares, contained, weighted = np.zeros((3, 3)), np.zeros((2, 3)), np.zeros((2, 3, 3))
    moments = np.zeros((3, nodes.common.coefficients.shape[2]))
    for part in nodes.blocks():
        places = linear(part)
        squares += places @ places.T
        contained += (nodes.design[:, part] + nodes.errors[:, part]) @ places.T
        for axis in (0, 1):
            weighted[axis] += (places * nodes.variance[axis, part]) @ places.T
        moments += places @ nodes.terms(part).T
    inverse = inverse_of_products(np.einsum("kci,ij,lcj->kl", shares, squares, shares))
    centred = inverse @ np.einsum("kci,ci->k", shares, contained)
    modes = inverse @ nodes.modes_times(np.tensordot(shares, moments, axes=1))
    found, left = np.tensordot(centred, shares, axes=1), np.zeros(2)
    for part in nodes.blocks():
        slopes = nodes.design[:, part] + nodes.errors[:, part] - found @ linear(part)
        left += (slopes**2).sum(axis=1) / nodes.count
    scattered = np.einsum("kci,cij,lcj->kl", shares, weighted, shares)
    # From coordinates about the mean node back to the map's own: C = C' - 2 A x0 - E y0, D = D' - 2 B y0 - E x0
    back = np.eye(5)
    back[2, [0, 4]], back[3, [1, 4]] = (-2 * x0, -y0), (-2 * y0, -x0)
    covariance = nodes.noise_correlation * inverse @ scattered @ inverse + modes @ modes.T
    return QuadraticFit(
        coefficients=back @ centred,
        covariance=_symmetric(back @ covariance @ back.T),
        residual_slope_rms_x=float(np.sqrt(left[0])),
        residual_slope_rms_y=float(np.sqrt(left[1])),
    )


def canting(slope_map: SlopeMap) -> Canting:
    """Compare the facet's mean normal with its design's.

    slope_map: The map of one facet, tilt not removed.
    Returns: The angle between the mean normals and its components, with sigma and covariance.
    EstimationError: Fewer than three measured nodes.
    """
    nodes = measured_nodes(slope_map)
    slopes = nodes.design + nodes.errors
    mean_normal = _mean_normal(*slopes)
    mean_slopes = -mean_normal[:2] / mean_normal[2]
    design = _mean_normal(*nodes.design)
    components = normal_angles(*mean_slopes, *(-design[:2] / design[2]))
    # A turn of one node's normal counts in the mean with its part across the mean normal.
    share = 1 / (nodes.count * np.linalg.norm(mean_normal))
    across = np.einsum("ic,kcn->ikn", share * tangents(*mean_slopes), tangents(*slopes))
    by_slope = np.einsum("ikn,kjn->ijn", across, d_angles_d_slopes(*slopes))
    modes = nodes.modes_times(nodes.moments(slice(None), by_slope))
    flat = by_slope.reshape(2, -1)
    covariance = nodes.noise_correlation * (flat * nodes.variance.reshape(-1)) @ flat.T + modes @ modes.T
    angle = float(np.hypot(*components))
    direction = components / angle if angle > 0 else np.array([1.0, 0.0])
    sigma = float(np.sqrt(direction @ covariance @ direction))
    return Canting(components, covariance, angle, sigma, slope_map.measured_share)


def _mean_normal(slope_x: FloatArray, slope_y: FloatArray) -> FloatArray:
    length = np.sqrt(1 + slope_x**2 + slope_y**2)
    return np.array([-(slope_x / length).mean(), -(slope_y / length).mean(), (1 / length).mean()])


def _symmetric(matrix: FloatArray) -> FloatArray:
    return 0.5 * (matrix + matrix.T)
