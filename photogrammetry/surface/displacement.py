"""The same targets on two dates: best rigid fit on the stable ones, displacement vectors, which ones moved."""

from dataclasses import dataclass

import numpy as np

from heliogauge.adjust.chi_square import chi_square_cdf, chi_square_limit
from heliogauge.errors import EstimationError
from heliogauge.geometry.alignment import align_points
from heliogauge.geometry.rigid import RigidTransform, skew
from heliogauge.validate import BoolArray, FloatArray, freeze
from photogrammetry.surface.fitted import SurfacePoints

_ROUNDS = 20


@dataclass(frozen=True, slots=True, eq=False)
class RigidFit:
    """Points of one frame fitted rigidly to the same points in another.

    b_from_a: The fit.
    difference_m (n, 3): b minus fitted a, of all points [m].
    covariance_m2 (3 n, 3 n): Joint covariance of the differences, the fit's share included [m^2].
    variance_factor: Weighted squares of the fitted points over the redundancy; NaN without redundancy.
    redundancy: Three for each fitted point, less six.
    """

    b_from_a: RigidTransform
    difference_m: FloatArray
    covariance_m2: FloatArray
    variance_factor: float
    redundancy: int


@dataclass(frozen=True, slots=True, eq=False)
class Displacements:
    """How targets moved between two dates.

    ids length n: Targets of both dates.
    now_from_before: The fit on the stable targets.
    displacement_m (n, 3): Now minus before, in the frame of now [m].
    covariance_m2 (n, 3, 3): Covariance of each displacement [m^2].
    stable (n,): Targets that the fit used.
    probability (n,): That a target at rest shows this much or more by chance.
    moved (n,): Targets that moved, at the family significance.
    variance_factor: Of the stable targets: 1 if they are at rest and the sigmas are right.
    stable_probability: That stable targets at rest disagree this much or more; NaN without redundancy.
    """

    ids: tuple[str, ...]
    now_from_before: RigidTransform
    displacement_m: FloatArray
    covariance_m2: FloatArray
    stable: BoolArray
    probability: FloatArray
    moved: BoolArray
    variance_factor: float
    stable_probability: float

    @property
    def sigma_m(self) -> FloatArray:
        """Standard deviations of the displacements, shape (n, 3) [m]."""
        return np.asarray(np.sqrt(np.maximum(np.einsum("nii->ni", self.covariance_m2), 0.0)))


def rigid_fit(points_a: SurfacePoints, points_b: SurfacePoints, fitted: BoolArray) -> RigidFit:
    """Fit points to the same points in another frame, weighted by the covariances of both.

    Shapes: fitted (n,).
    points_a, points_b: The same targets in the same order.
    Returns: The fit and the differences with their joint covariance.
    EstimationError: Fewer than three fitted points, or all on one line.

    The start has equal weights; then generalised least squares with ``R C_a R^T + C_b``. What a rigid motion does to
    the points may have no variance under an inner datum: it is given some, which does not change the estimate.
    """
    names = [name for name, one in zip(points_b.ids, fitted, strict=True) if one]
    pose = align_points(points_a.points_m[fitted], points_b.points_m[fitted], names=names).b_from_a
    rows = np.repeat(fitted, 3)
    for _ in range(20):
        turned = points_a.points_m @ pose.rotation.T
        jacobian = np.concatenate([-skew(turned), np.broadcast_to(np.eye(3), (len(turned), 3, 3))], axis=2).reshape(
            -1, 6
        )
        covariance = _turned(points_a.covariance_m2, pose.rotation) + points_b.covariance_m2
        difference = points_b.points_m - turned - pose.translation_m
        weighted = _solve_regular(covariance[np.ix_(rows, rows)], jacobian[rows])
        estimator = np.zeros((6, rows.size))
        estimator[:, rows] = np.linalg.solve(jacobian[rows].T @ weighted, weighted.T)
        step = estimator @ difference.ravel()
        pose = pose.moved(step)
        if np.abs(step[:3]).max() < 1e-14 + 1e-12 * np.abs(step[3:]).max() or np.abs(step).max() < 1e-13:
            break
    difference = points_b.points_m - pose.apply(points_a.points_m)
    remaining = np.eye(rows.size) - jacobian @ estimator
    whole = remaining @ covariance @ remaining.T
    freedom = int(rows.sum()) - 6
    own = difference[fitted].ravel()
    squares = float(own @ _solve_regular(covariance[np.ix_(rows, rows)], jacobian[rows], own))
    return RigidFit(
        pose,
        freeze(difference),
        freeze(0.5 * (whole + whole.T)),
        squares / freedom if freedom > 0 else float("nan"),
        freedom,
    )


def _turned(covariance: FloatArray, rotation: FloatArray) -> FloatArray:
    count = len(covariance) // 3
    cube = covariance.reshape(count, 3, count, 3)
    return np.asarray(np.einsum("ij,ajbk,lk->aibl", rotation, cube, rotation, optimize=True).reshape(covariance.shape))


def _solve_regular(covariance: FloatArray, jacobian: FloatArray, right: FloatArray | None = None) -> FloatArray:
    mean = max(float(np.trace(covariance)) / len(covariance), 1e-24)
    basis = np.linalg.qr(jacobian)[0]
    whole = covariance + mean * len(covariance) * basis @ basis.T + 1e-8 * mean * np.eye(len(covariance))
    return np.asarray(np.linalg.solve(whole, jacobian if right is None else right))


def displacements(
    before: SurfacePoints,
    now: SurfacePoints,
    *,
    stable: tuple[str, ...] = (),
    family_significance: float = 0.05,
) -> Displacements:
    """Find how targets moved between two dates.

    before, now: Targets of each date in its own frame; those of both dates count.
    stable: Targets known to be at rest; found by the test itself if not given.
    family_significance: Probability that any target at rest is reported as moved.
    Returns: Vectors, covariances and tests.
    EstimationError: Too few targets in common, or fewer than half of them agree on a common motion.

    A displacement d with covariance C is tested by ``d^T C^-1 d`` against chi-square of three degrees of freedom at
    the family significance over n (Bonferroni). Without named stable targets a robust fit comes first, then targets
    that moved leave the fit and come back until the choice stands (Caspary 1987, ch. 5).
    """
    common = [name for name in now.ids if name in set(before.ids)]
    before, now = _ordered(before, common), _ordered(now, common)
    limit = chi_square_limit(family_significance / max(len(common), 1), 3)
    if stable:
        unknown = [name for name in stable if name not in common]
        if unknown:
            raise EstimationError(f"comparison: stable targets {', '.join(unknown[:8])} are not measured on both dates")
        chosen = np.array([name in set(stable) for name in common])
        fit = rigid_fit(before, now, chosen)
        squares, freedoms = _tested(fit)
    else:
        chosen = _agreeing(before, now)
        seen = [chosen]
        for _ in range(_ROUNDS):
            fit = rigid_fit(before, now, chosen)
            squares, freedoms = _tested(fit)
            chosen = squares <= limit
            if 2 * chosen.sum() < len(common) or chosen.sum() < 3:
                raise EstimationError(
                    f"comparison: {int(chosen.sum())} of {len(common)} common targets agree on one rigid motion; name "
                    "those that are at rest (stable_targets)"
                )
            if any((chosen == one).all() for one in seen):
                break
            seen.append(chosen)
        fit = rigid_fit(before, now, chosen)
        squares, freedoms = _tested(fit)
    count = len(common)
    chance = np.array([1 - chi_square_cdf(float(s), int(f)) for s, f in zip(squares, freedoms, strict=True)])
    factor, freedom = fit.variance_factor, fit.redundancy
    blocks = fit.covariance_m2.reshape(count, 3, count, 3)[np.arange(count), :, np.arange(count)]
    return Displacements(
        tuple(common),
        fit.b_from_a,
        fit.difference_m,
        freeze(blocks),
        freeze(chosen),
        freeze(chance),
        freeze(squares > limit),
        factor,
        1 - chi_square_cdf(factor * freedom, freedom) if freedom > 0 else float("nan"),
    )


def _ordered(points: SurfacePoints, names: list[str]) -> SurfacePoints:
    place = {name: i for i, name in enumerate(points.ids)}
    index = np.array([place[name] for name in names], dtype=np.intp)
    rows = (3 * index[:, None] + np.arange(3)).ravel()
    return SurfacePoints(tuple(names), points.points_m[index], points.covariance_m2[np.ix_(rows, rows)])


def _agreeing(before: SurfacePoints, now: SurfacePoints) -> BoolArray:
    """Mark targets that agree on one motion: the best of many triples, then near its median."""
    count = len(now.ids)
    if count < 3:
        raise EstimationError(f"comparison: three common targets are needed, not {count}; are the names the same?")
    a, b = before.points_m, now.points_m
    rng = np.random.default_rng(0)
    best, best_size = np.full(count, np.inf), np.inf
    for _ in range(60):
        three = rng.choice(count, 3, replace=False)
        try:
            pose = align_points(a[three], b[three]).b_from_a
        except EstimationError:
            continue
        size = np.linalg.norm(b - pose.apply(a), axis=1)
        if float(np.median(size)) < best_size:
            best, best_size = size, float(np.median(size))
    # Half of the targets move less than the median by definition; three times it keeps all that are at rest.
    sigma = np.sqrt((before.sigma_m**2).sum(axis=1) + (now.sigma_m**2).sum(axis=1))
    return np.asarray(np.isfinite(best) & (best <= np.maximum(3 * best_size, 5 * sigma)))


def _tested(fit: RigidFit) -> tuple[FloatArray, np.ndarray]:
    """Return ``d^T C^+ d`` and the rank of C for each point."""
    count = len(fit.difference_m)
    blocks = fit.covariance_m2.reshape(count, 3, count, 3)[np.arange(count), :, np.arange(count)]
    values, vectors = np.linalg.eigh(blocks)
    largest = np.maximum(values[:, -1:], 1e-300)
    known = values > 1e-6 * largest
    parts = np.einsum("nij,ni->nj", vectors, fit.difference_m)
    squares = np.where(known, parts**2 / np.where(known, values, 1.0), 0.0).sum(axis=1)
    return np.asarray(squares), known.sum(axis=1)
