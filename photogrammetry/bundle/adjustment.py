"""Bundle adjustment: poses, points and intrinsics in one estimate, with constraints, datum and joint covariance."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from heliogauge.adjust.chi_square import VarianceFactorTests
from heliogauge.adjust.gauss_newton import Descent, Options, minimise
from heliogauge.adjust.robust_loss import Loss, Squares, loss_moments, normal_moments
from heliogauge.adjust.solution import CovarianceScale
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError, InputError, NotConvergedError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, float_array
from photogrammetry.bundle.covariance import BundleCovariance, CovarianceFactors
from photogrammetry.bundle.diagnosis import Defect, diagnose
from photogrammetry.bundle.evaluation import BundleRows, evaluate
from photogrammetry.bundle.problem import BundleProblem
from photogrammetry.bundle.rows import BundleModel
from photogrammetry.bundle.state import BundleState, d_parameters_d_intrinsics
from photogrammetry.bundle.system import SchurSystem


@dataclass(frozen=True, slots=True)
class BundleOptions:
    """How to adjust.

    loss: Loss of the image points, of the length of their whitened residuals; constraints are never weakened.
    covariance_scale: Whether the stated sigmas are believed, or only their ratios.
    descent: How to iterate. The first step is a plain Gauss-Newton step. A millionth of a sigma is far below what
        anybody can notice; 1e-8 costs one more iteration.
    """

    loss: Loss = field(default_factory=Squares)
    covariance_scale: CovarianceScale = CovarianceScale.PRIOR
    descent: Options = field(default_factory=lambda: Options(tolerance=1e-6, initial_damping=1e-4))


@dataclass(frozen=True, eq=False)
class BundleResult(ShortRepr, VarianceFactorTests):
    """An adjusted network.

    problem: What was asked.
    state: The estimate.
    datum: The datum in words, to print with every sigma.
    covariance: Joint covariance of everything, under the datum.
    options: How it was adjusted.
    converged: Whether the estimate is a minimum.
    reason: Why the iteration ended.
    iterations: Steps tried.
    rank: Number of determined directions on top of the datum.
    defect: Number of directions that nothing determines, beyond the datum's.
    redundancy: Residuals less rank.
    variance_factor: Squared residuals over redundancy, 1 if the sigmas are right; NaN without redundancy.
    rows: Residuals and derivatives at the estimate.
    system: The normal equations there.
    """

    problem: BundleProblem
    state: BundleState
    datum: str
    covariance: BundleCovariance
    options: BundleOptions
    converged: bool
    reason: str
    iterations: int
    rank: int
    defect: int
    redundancy: int
    variance_factor: float
    rows: BundleRows
    system: SchurSystem

    @property
    def sigma0(self) -> float:
        """Square root of the variance factor: residuals in units of their stated sigma."""
        return float(np.sqrt(self.variance_factor))

    @property
    def whitened_residuals(self) -> FloatArray:
        """Predicted minus observed over sigma, in the order of the observations, shape (m, 2)."""
        return self.rows.whitened_residuals

    @cached_property
    def residuals_px(self) -> FloatArray:
        """Predicted minus observed, in the order of the observations, shape (m, 2) [px]."""
        roots = np.linalg.cholesky(self.problem.observations.covariance_px2)
        return np.asarray((roots @ self.whitened_residuals[:, :, None])[:, :, 0])

    @property
    def constraint_residuals(self) -> tuple[tuple[str, FloatArray], ...]:
        """Name of each constraint with its whitened residuals (estimate minus known, over sigma)."""
        names = [one.name for one in self.problem.constraints]
        return tuple(zip(names, self.rows.extra.residuals, strict=True))

    @property
    def points_m(self) -> FloatArray:
        """Coordinates of the targets, shape (n, 3) [m]; NaN where not determined."""
        points = self.state.points_m.copy()
        points[self.covariance.unknown_targets] = np.nan
        return points

    @property
    def sigma_points_m(self) -> FloatArray:
        """Standard deviations of the coordinates, shape (n, 3) [m]."""
        # A coordinate that the datum holds has a variance of 0 to rounding, on either side.
        return np.asarray(np.sqrt(np.maximum(np.einsum("nii->ni", self.covariance.points), 0.0)))

    @cached_property
    def cameras(self) -> tuple[Camera, ...]:
        """The cameras with the covariance of their parameters."""
        joint, first, cameras = self.covariance.intrinsics, 0, []
        for model, camera in zip(self.problem.cameras, self.state.cameras, strict=True):
            own = slice(first, first + len(model.free))
            first += len(model.free)
            jacobian = d_parameters_d_intrinsics(camera)[:, model.columns]
            block = joint[own, own]
            fine = model.free and np.isfinite(block).all()
            covariance = jacobian @ block @ jacobian.T if fine else np.zeros((10, 10))
            cameras.append(camera.with_covariance(0.5 * (covariance + covariance.T)))
        return tuple(cameras)

    @property
    def cam_from_world(self) -> tuple[RigidTransform, ...]:
        """Pose of each photo."""
        return tuple(self.state.cam_from_world(i) for i in range(len(self.state.rotations)))

    @cached_property
    def defects(self) -> tuple[Defect, ...]:
        """What is not determined, by name: first targets that fail on their own; empty when all is determined."""
        return diagnose(self.problem, self.system, self.covariance)

    def require(self, what: str = "bundle adjustment") -> "BundleResult":
        """Return the result if it is usable, refuse it otherwise.

        what: What was adjusted, for the message.
        EstimationError: Not converged, or something is not determined; the message names it.
        """
        if self.defects:
            raise EstimationError(f"{what}: " + "; ".join(one.text for one in self.defects))
        if not self.converged:
            raise NotConvergedError(f"{what}: {self.reason}")
        return self


def adjust(problem: BundleProblem, start: BundleState, *, options: BundleOptions | None = None) -> BundleResult:
    """Adjust a photo network.

    problem: What is observed and what is sought.
    start: Start values of everything; `photogrammetry.start_values.build_network` finds them.
    Returns: ``converged`` is False with the reason where the iteration did not end in a minimum. Whatever is not
        determined has covariance NaN; `BundleResult.require` names it in an error.
    InputError: The start does not fit the problem.
    EstimationError: A target is behind its camera at the start, or the datum's targets do not define it.

    Minimises ``1/2 sum rho(|L^-1 r|) + 1/2 |extra|^2`` with L the Cholesky factor of each image point's covariance.
    Targets that no constraint links to another are eliminated; the reduced system of poses, intrinsics and linked
    targets is dense. Without constraints that define them, position, rotation and scale stay those of the start
    (inner constraints over the datum's targets); the covariance is that of the named datum.
    """
    options = options or BundleOptions()
    return _assemble_result(problem, descend(problem, start, options), options)


def descend(problem: BundleProblem, start: BundleState, options: BundleOptions) -> Descent[BundleState, BundleRows]:
    """Adjust as `adjust` does, without covariance: enough on the way to something else.

    InputError: The start does not fit the problem.
    EstimationError: A target is behind its camera at the start.
    """
    _check(problem, start)
    model = BundleModel(problem, start, options.loss)
    waiting = [evaluate(model, start)]
    if not np.isfinite(waiting[0].cost):
        _refuse_invisible(model, waiting[0])
    return minimise(start, _evaluator(model, waiting), model.retract, options=options.descent)


def _evaluator(model: BundleModel, waiting: list[BundleRows]) -> Callable[[BundleState], BundleRows]:
    """Return what evaluates a state. What is evaluated already is returned once and not kept.

    With 500 photos of 2000 targets that is 0.5 GB of 1.9.
    """

    def evaluator(state: BundleState) -> BundleRows:
        return waiting.pop() if waiting and state is waiting[0].state else evaluate(model, state)

    return evaluator


def _check(problem: BundleProblem, start: BundleState) -> None:
    table = problem.observations
    counts = (len(start.cameras), len(start.rotations), len(start.points_m))
    needed = (len(problem.cameras), len(table.photos), len(table.targets))
    if counts != needed:
        raise InputError(
            f"bundle: a start of {needed[0]} cameras, {needed[1]} photos and {needed[2]} targets is needed, "
            f"not of {counts[0]}, {counts[1]} and {counts[2]}"
        )
    if table.n == 0:
        raise InputError("bundle: there are no image points")
    float_array("start points_m", start.points_m, (None, 3))


def _refuse_invisible(model: BundleModel, rows: BundleRows) -> None:
    lost = np.nonzero(rows.invisible())[0]
    table = model.problem.observations
    names = "; ".join(table.label(int(model.order[i])) for i in lost[:5])
    raise EstimationError(
        f"bundle: at the start {lost.size} image points show targets behind their camera or outside its lens model "
        f"({names}); give other start values or leave them out"
    )


def _assemble_result(
    problem: BundleProblem, found: Descent[BundleState, BundleRows], options: BundleOptions
) -> BundleResult:
    rows = found.evaluation
    expected = normal_moments(options.loss, 2) if not rows.model.plain else None
    root = None if expected is None else np.full(rows.model.photo.size, np.sqrt(expected.slope))
    system = rows.final_system(root)
    rank = system.rank
    redundancy = rows.n_residuals - rank
    known = rows.extra.all_residuals
    if expected is None:
        squares, shares = float(rows.squares.sum()), None
    else:
        moments = loss_moments(options.loss, rows.lengths, 2)
        squares = 2 * rows.lengths.size * moments.influence / expected.influence
        shares = (expected.influence / expected.slope, moments)
    factor = (squares + float(known @ known)) / redundancy if redundancy > 0 else float("nan")
    prior = factor if options.covariance_scale is CovarianceScale.POSTERIOR else 1.0
    factors = CovarianceFactors(prior, prior)
    if shares is not None:
        # The spread of the influences over that of normal errors is the variance factor; never less certain than that.
        scale = prior if options.covariance_scale is CovarianceScale.POSTERIOR else max(1.0, factor)
        factors = CovarianceFactors(shares[0] * scale, prior)
    covariance = BundleCovariance(system, factors)
    defect = system.layout.n - system.movements.count - rank
    return BundleResult(
        problem=problem,
        state=found.state,
        datum=system.datum.text,
        covariance=covariance,
        options=options,
        converged=found.converged,
        reason=found.reason,
        iterations=found.iterations,
        rank=rank,
        defect=defect,
        redundancy=redundancy,
        variance_factor=factor,
        rows=rows,
        system=system,
    )
