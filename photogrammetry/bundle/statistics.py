"""Evidence for and against a bundle adjustment: redundancy, outliers, significance, what is not determined."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist
from weakref import WeakKeyDictionary

import numpy as np

from heliogauge.adjust.solution import CovarianceScale
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, FloatArray, IntArray
from photogrammetry.bundle.adjustment import BundleOptions, BundleResult, adjust
from photogrammetry.bundle.constraints import AXES, Coordinate
from photogrammetry.bundle.covariance import BundleCovariance, CovarianceFactors
from photogrammetry.bundle.problem import BundleProblem
from photogrammetry.bundle.rays import runs
from photogrammetry.bundle.rows import BundleModel, CameraRows
from photogrammetry.bundle.state import INTRINSIC_NAMES, BundleState, intrinsics_of

#: Below this share nothing of an error shows in the residual, and its test has no meaning.
UNCONTROLLED = 1e-6
#: So many image points of a photo for each that goes in one round: by the photo's six unknowns a point shifts another
#: one by 3 / 100 of its own error on the average of a hundred, so that all that go shift one by a thirtieth of theirs
#: at most.
_POINTS_FOR_ONE = 100
#: Offset in sigmas to which adjustments go on whose residuals only say which image points are false.
_ROUGH = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class ImagePointTests(ShortRepr):
    """Tests of the image points, in the order of the observations.

    redundancy (m, 2, 2): Share of an error of each whitened image point that shows in its residual.
    baarda (m, 2): Whitened residuals over their own sigma, standard normal if the stated sigmas are right; NaN
        where nothing controls them.
    length_squared (m,): Both components together, ``r^T R^-1 r``, chi-square with two degrees of freedom if the
        sigmas are right.
    probability (m,): Probability of a larger value for a good image point: Baarda's test for stated sigmas, Pope's
        for sigmas known up to a factor.
    """

    redundancy: FloatArray
    baarda: FloatArray
    length_squared: FloatArray
    probability: FloatArray

    def outliers(self, family_significance: float = 0.05) -> BoolArray:
        """Mark image points that are too far off.

        Shapes: result (m,).
        family_significance: Probability of marking any good image point of all.
        """
        return np.asarray(self.probability < family_significance / max(self.probability.size, 1))


def coordinates_redundancy(result: BundleResult, known: Sequence[Coordinate]) -> FloatArray:
    """Return the cofactor of the residuals of known coordinates over their sigmas, ``I - H``.

    result: An adjusted network.
    known: Some of its constraints.
    Returns (n, n): On the diagonal the share of an error that shows in the coordinate's own residual; NaN where its
        target is not determined.
    """
    targets = list(dict.fromkeys(one.target for one in known))
    cofactors = BundleCovariance(result.system, CovarianceFactors(1.0, 1.0)).joint(
        result.problem.target_indices(targets)
    )
    place = {name: number for number, name in enumerate(targets)}
    rows = np.array([3 * place[one.target] + AXES.index(one.axis) for one in known], dtype=np.intp)
    sigma_m = np.array([one.sigma_m for one in known])
    return np.asarray(np.eye(len(known)) - cofactors[np.ix_(rows, rows)] / sigma_m[:, None] / sigma_m)


def examine_image_points(result: BundleResult) -> ImagePointTests:
    """Compute redundancy numbers and outlier tests of all image points.

    result: An adjusted network.

    With H the two rows and columns of ``J Q J^T`` of an image point, its whitened residual has the covariance ``I -
    H``. Pope's version of ``T = r^T (I - H)^-1 r``: T over the sum of all squares has a beta distribution, so the
    probability is ``(1 - T / total)^((redundancy - 2) / 2)``. They are kept as long as the result.
    """
    if result not in _EXAMINED:
        _EXAMINED[result] = _examined(result)
    return _EXAMINED[result]


_EXAMINED: WeakKeyDictionary[BundleResult, ImagePointTests] = WeakKeyDictionary()


def _examined(result: BundleResult) -> ImagePointTests:
    count = result.problem.observations.n
    weight = result.system.rows
    shares = np.concatenate([_leverages(result, one) for one in weight])
    redundancy = np.empty((count, 2, 2))
    redundancy[result.rows.model.order] = np.eye(2) - shares
    residuals = result.whitened_residuals
    own = np.einsum("mii->mi", redundancy)
    baarda = residuals / np.sqrt(np.where(own > UNCONTROLLED, own, np.nan))
    squared = _length_squared(redundancy, residuals)
    probability = np.exp(-0.5 * squared)
    if result.options.covariance_scale is CovarianceScale.POSTERIOR and result.redundancy > 2:
        total = result.variance_factor * result.redundancy
        probability = np.maximum(1 - squared / total, 0.0) ** (0.5 * (result.redundancy - 2))
    return ImagePointTests(redundancy, baarda, squared, np.asarray(probability))


def _length_squared(redundancy: FloatArray, residuals: FloatArray) -> FloatArray:
    """Return ``r^T R^-1 r``, shape (m,), without the directions in which nothing controls an image point."""
    a, b, c = redundancy[:, 0, 0], redundancy[:, 0, 1], redundancy[:, 1, 1]
    x, y = residuals.T
    determinant = a * c - b * b
    # The smaller eigenvalue is at least the determinant over the trace.
    weak = np.flatnonzero(~(determinant > UNCONTROLLED * (a + c)) | (a <= 0))
    squared = np.asarray((c * x * x - 2 * b * x * y + a * y * y) / np.where(determinant > 0, determinant, 1.0))
    if weak.size:
        values, vectors = np.linalg.eigh(redundancy[weak])
        along = np.einsum("mij,mi->mj", vectors, residuals[weak])
        seen = values > UNCONTROLLED
        squared[weak] = np.where(seen, along**2 / np.where(seen, values, 1.0), 0.0).sum(axis=1)
    return squared


def _leverages(result: BundleResult, rows: CameraRows) -> FloatArray:
    """Return ``J Q J^T`` of each image point of one camera, shape (m, 2, 2)."""
    cofactors = result.covariance.image_point_cofactors(rows.camera)
    jacobian = np.ascontiguousarray(np.moveaxis(rows.jacobian, -1, 0))
    part, d_target = jacobian[:, :, : 6 + rows.n_free], jacobian[:, :, 7 + rows.n_free :]
    shares = d_target @ cofactors.crossed @ np.swapaxes(part, 1, 2)
    shares += np.swapaxes(shares, 1, 2)
    shares += d_target @ cofactors.targets[rows.targets] @ np.swapaxes(d_target, 1, 2)
    if rows.has_few_points:
        own_photo = np.repeat(np.arange(len(cofactors.photos)), np.diff(rows.starts))
        return np.asarray(shares + part @ cofactors.photos[own_photo] @ np.swapaxes(part, 1, 2))
    for own, (_, first, last) in zip(cofactors.photos, runs(rows.photos, rows.starts), strict=True):
        one = part[first:last]
        shares[first:last] += one @ own @ np.swapaxes(one, 1, 2)
    return shares


@dataclass(frozen=True, slots=True)
class Rejected:
    """An image point that was left out.

    row: Its place in the observations that were given.
    label: Target and photo.
    residual_px: Length of its residual when it was left out [px].
    reason: Why.
    is_outlier: Whether it contradicts the others; else it was left alone by those that do.
    """

    row: int
    label: str
    residual_px: float
    reason: str
    target: str
    is_outlier: bool = True


def adjust_and_reject(
    problem: BundleProblem,
    start: BundleState,
    *,
    options: BundleOptions | None = None,
    family_significance: float = 0.05,
    most_rounds: int = 20,
    suspects: BoolArray | None = None,
) -> tuple[BundleResult, tuple[Rejected, ...]]:
    """Adjust, leave out the worst image points, adjust again, until none is too far off.

    problem: What is observed and what is sought.
    family_significance: Probability of leaving out any good image point of all.
    most_rounds: Rounds after which the search ends.
    suspects (m,): Image points that take no part until the others are clean; then those that agree come in.
    rejected: What was left out, in order. In each round only the worst image point of a photo and of a target goes,
        because one bad image point makes its neighbours look bad; of photos with thousands of points a few go. Targets
        left with one ray lose that too. What turns out to agree in the end comes back. Suspects that stay out are not
        among them.
    """
    options = options or BundleOptions()
    outside = np.zeros(problem.observations.n, dtype=np.bool_) if suspects is None else suspects
    rows = np.nonzero(~outside)[0]
    rejected: dict[int, Rejected] = {}
    first = replace(problem, observations=problem.observations.subset(rows)) if outside.any() else problem
    # Which image points are false shows long before the last digits do: those are found in the end.
    rough = replace(options, descent=replace(options.descent, tolerance=max(options.descent.tolerance, _ROUGH)))
    result = adjust(first, start, options=rough)
    for _ in range(most_rounds):
        tests = examine_image_points(result)
        marked = tests.outliers(family_significance)
        if not marked.any():
            break
        gone = np.zeros(rows.size, dtype=np.bool_)
        gone[_worst_of_their_kind(result, tests.length_squared, marked)] = True
        singles = _left_alone(result, gone)
        for place in np.nonzero(gone | singles)[0].tolist():
            times = f"{np.sqrt(tests.length_squared[place]):.1f} times its sigma"
            reason = times if gone[place] else "the only ray left of its target"
            row = int(rows[place])
            rejected[row] = _rejection(result, row, place, reason, is_outlier=bool(gone[place]))
        keep = ~(gone | singles)
        rows = rows[keep]
        smaller = replace(result.problem, observations=result.problem.observations.subset(keep))
        result = adjust(smaller, result.state, options=rough)
    asked = [*rejected, *np.nonzero(outside)[0].tolist()]
    back = _innocent(problem, result, asked, family_significance)
    if back:
        rows = np.sort(np.concatenate([rows, np.array(back, dtype=np.intp)]))
        result = adjust(replace(problem, observations=problem.observations.subset(rows)), result.state, options=rough)
    final = adjust(result.problem, result.state, options=options)
    return final, tuple(one for row, one in rejected.items() if row not in back)


def _innocent(problem: BundleProblem, result: BundleResult, rows: list[int], family_significance: float) -> list[int]:
    """Choose rejected image points that agree with the network once the false ones are gone."""
    if not rows:
        return []
    table = problem.observations.subset(np.array(rows, dtype=np.intp))
    one_by_one = BundleModel(replace(problem, observations=table), result.state)
    squares = np.concatenate(
        [np.einsum("rm,rm->m", *[one.residuals] * 2) for one in one_by_one.camera_rows(result.state)]
    )
    factor = 1.0
    if result.options.covariance_scale is CovarianceScale.POSTERIOR and result.redundancy > 0:
        factor = result.variance_factor
    # The residual of a point that took no part has a larger sigma than that: what passes is surely no outlier.
    limit = -2 * np.log(family_significance / max(problem.observations.n, 1)) * factor
    determined = ~result.covariance.unknown_targets[table.target_index[one_by_one.order]]
    fine = np.isfinite(squares) & (squares <= limit) & determined
    return [rows[place] for place in one_by_one.order[fine].tolist()]


def _rejection(result: BundleResult, row: int, place: int, reason: str, *, is_outlier: bool) -> Rejected:
    length = float(np.hypot(*result.residuals_px[place]))
    table = result.problem.observations
    return Rejected(row, table.label(place), length, reason, table.targets[table.target_index[place]], is_outlier)


def _worst_of_their_kind(result: BundleResult, size: FloatArray, marked: BoolArray) -> IntArray:
    """Choose marked image points, the worst first, not two of one target, and of one photo no more than it can bear."""
    table = result.problem.observations
    photos, targets, chosen = np.maximum(table.n_targets_in_photo // _POINTS_FOR_ONE, 1), set(), []
    # A far outlier spoils all others of its surroundings: what is less than half as far off waits.
    marked = marked & (size >= 0.25 * size[marked].max())
    for row in np.nonzero(marked)[0][np.argsort(-size[marked], kind="stable")].tolist():
        photo, target = int(table.photo_index[row]), int(table.target_index[row])
        if photos[photo] > 0 and target not in targets:
            chosen.append(row)
            photos[photo] -= 1
            targets.add(target)
    return np.array(chosen, dtype=np.intp)


def _left_alone(result: BundleResult, gone: BoolArray) -> BoolArray:
    """Mark rows whose target keeps one ray only because of those that go, unless something else holds it."""
    table = result.problem.observations
    rays = np.bincount(table.target_index[~gone], minlength=len(table.targets))
    held = np.zeros(len(table.targets), dtype=np.bool_)
    names = [*result.problem.fixed, *(t for one in result.problem.constraints for t in one.targets)]
    held[result.problem.target_indices(names)] = True
    touched = np.zeros(len(table.targets), dtype=np.bool_)
    touched[table.target_index[gone]] = True
    return np.asarray(~gone & (touched & (rays == 1) & ~held)[table.target_index])


@dataclass(frozen=True, slots=True)
class IntrinsicTest:
    """One estimated intrinsic.

    value, sigma: Estimate and standard deviation, in the unit of the name.
    significance: Probability with which it differs from zero (1: certainly); NaN for focal length and principal
        point.
    rival: The other intrinsic it is correlated with most.
    """

    camera: str
    name: str
    value: float
    sigma: float
    significance: float
    rival: str
    correlation: float


def examine_intrinsics(result: BundleResult) -> tuple[IntrinsicTest, ...]:
    """Test every estimated intrinsic against zero and against the others.

    result: An adjusted network.
    Returns: In the order of cameras and `INTRINSIC_NAMES`.
    """
    labels, values = [], []
    for model, camera in zip(result.problem.cameras, result.state.cameras, strict=True):
        labels += [(model.name, name) for name in model.free]
        values += intrinsics_of(camera)[model.columns].tolist()
    return examine_values(labels, values, result.covariance.intrinsics)


def examine_values(
    labels: Sequence[tuple[str, str]], values: Sequence[float], covariance: FloatArray
) -> tuple[IntrinsicTest, ...]:
    """Test intrinsics with their covariance against zero and against each other.

    labels length k: Camera and name of each intrinsic.
    covariance (k, k): Their joint covariance.
    """
    sigmas = np.sqrt(np.diag(covariance))
    correlation = covariance / sigmas[:, None] / sigmas
    np.fill_diagonal(correlation, 0.0)
    tests = []
    for place, (camera_name, name) in enumerate(labels):
        ratio = abs(values[place]) / sigmas[place]
        against_zero = name in INTRINSIC_NAMES[4:] or name == "aspect"
        significance = 2 * NormalDist().cdf(float(ratio)) - 1 if against_zero and np.isfinite(ratio) else float("nan")
        own = np.nan_to_num(correlation[place])
        rival = int(np.argmax(np.abs(own)))
        other = "" if len(labels) < 2 else labels[rival][1]
        tests.append(
            IntrinsicTest(
                camera_name, name, values[place], float(sigmas[place]), significance, other, float(own[rival])
            )
        )
    return tuple(tests)
