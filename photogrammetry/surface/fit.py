"""Points with their joint covariance to the best fit of a surface: pose, curvature, deviations, outliers."""

from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from heliogauge.adjust.least_squares import Chart, Options, Problem, Tukey, solve, whitened
from heliogauge.adjust.robust_scale import robust_scale, robust_scale_of_rows
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform, rotation_from_vector, skew
from heliogauge.validate import BoolArray, FloatArray, freeze
from photogrammetry.surface.design import Feet, Reference, motion_words, require_feet
from photogrammetry.surface.fitted import FitChoices, FitParameters, SurfaceFit, SurfacePoints

_POSE_NAMES = ("turn x", "turn y", "turn z", "shift x", "shift y", "shift z")
#: Combinations of parameters that the points see less than this share of the best one are not determined: at 1e-7 a
#: point error of 10 um would turn the surface by more than a right angle.
_RANK = 1e-7
#: A motion is held if noise and roughness leave points free to slide by this share of their extent. A shallow bowl
#: (focal length 20 m over 4 m) slides by 0.8 m for errors of 50 um: its vertex must come from somewhere else.
_WEAK = 0.01
_ROUNDS = 12


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """Pose and surface; steps of the pose turn about the pivot, in the frame of the surface, but for what is held."""

    pose: RigidTransform
    reference: Reference
    pivot_m: FloatArray
    held: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Linear:
    """The fit at its end: minus the step of the parameters for each distance, zero for points left out, (6 + k, n)."""

    estimator: FloatArray
    shape_sigma_m: float
    variance_factor: float
    redundancy: int


def fit_surface(
    points: SurfacePoints, reference: Reference, start: RigidTransform, choices: FitChoices | None = None
) -> SurfaceFit:
    """Fit a surface to points by weighted orthogonal distances.

    points: The points in their own frame.
    reference: The surface in its frame; its curvatures are the start.
    start: ``design_from_world`` to start from; the surface's symmetries stay there.
    Returns: Pose, curvature, deviations and outliers with covariances.
    InputError: The surface has no length to estimate, or points are beyond its centre of curvature.
    EstimationError: Too few points, or points that do not determine the pose.

    Distances d along the unit normals N at the feet have the covariance ``N C N^T``, so that least squares with its
    inverse is the Gauss-Helmert adjustment of the points onto the surface (Mikhail and Ackermann 1976, ch. 9). To it
    ``s^2 I`` is added: s is the surface's own roughness, estimated from the same distances by restricted maximum
    likelihood's moment equation ``d^T W(s) d = redundancy``, and zero while errors of measurement explain them. A
    rough surface is then fitted almost with equal weights, a perfect one with those of the measurement.
    Motions in the null space of the surface's own matrix are held, and those that it hardly feels; any further rank
    defect is the points' and refused.
    Robust: Tukey's loss with equal weights first, then points are tested against sigma and s and left out, re-tested
    and taken back until the choice stands.
    """
    choices = choices or FitChoices()
    if choices.curvature and not reference.curvature_names:
        raise InputError(f"surface: {reference.describe()} has no focal length or radius that could be estimated")
    state = _started(points.points_m, reference, start)
    used = np.ones(len(points.ids), dtype=np.bool_)
    if choices.pose or choices.curvature:
        began = state
        state, near = _robust_start(points, state, choices)
        held = _weakly_held(points, state, near) if choices.pose else state.held
        if held.shape != state.held.shape:
            # The first fit slid where nothing holds it: once more from where it began.
            state, near = _robust_start(points, replace(began, held=held), choices)
        used = near if choices.robust else used
    seen = [used.copy()]
    for _ in range(_ROUNDS):
        state, linear = _fitted(points, state, used, choices)
        tests = _tests(points, state, linear, choices)
        if not choices.robust:
            break
        critical = max(3.5, NormalDist().inv_cdf(1 - choices.family_significance / (2 * used.size)))
        chosen = np.abs(tests) <= critical
        if any((chosen == one).all() for one in seen):
            break
        used = chosen
        seen.append(used.copy())
    return _assembled(points, state, linear, used, choices)


@dataclass(frozen=True, slots=True, eq=False)
class QuickFit:
    """A fit with equal weights: its pose, and the RMS distance, infinite where it failed [m]."""

    pose: RigidTransform
    rms_m: float


def quick_fit(points_m: FloatArray, reference: Reference, start: RigidTransform) -> QuickFit:
    """Fit the pose of a surface with equal weights and Tukey's loss, to compare starts.

    Shapes: points_m (n, 3).
    start: ``design_from_world``.
    Returns: Pose, and 1.48 times the median distance as the RMS that no outlier moves.
    """
    state = _started(points_m, reference, start)
    try:
        state, distances = _equally_weighted(points_m, state, FitChoices(), rounds=2)
    except EstimationError:
        return QuickFit(start, float("inf"))
    middle = robust_scale(distances)
    return QuickFit(state.pose, middle if np.isfinite(middle) else float("inf"))


def _started(points_m: FloatArray, reference: Reference, start: RigidTransform) -> _State:
    """Return the start with its pivot: where the normals meet as well as they can.

    A shallow bowl hardly feels a turn about its centre of curvature. Taken as turn and shift in a straight line the
    same motion leaves the surface with the square of the step, and the descent crawls along a bent valley: 300 steps
    did not suffice for a focal length of 20 m over 4 m.
    """
    placed = start.apply(points_m)
    center = placed.mean(axis=0)
    normals = reference.feet(placed).normals
    normals, arms = normals[np.isfinite(normals).all(axis=1)], placed[np.isfinite(normals).all(axis=1)] - center
    across = np.eye(3) - normals[:, :, None] * normals[:, None, :]
    pivot = np.linalg.lstsq(across.sum(axis=0), (across @ arms[:, :, None]).sum(axis=0)[:, 0], rcond=1e-10)[0]
    size = float(np.abs(arms).max(initial=1e-9))
    pivot = center + (pivot if np.linalg.norm(pivot) < 1e4 * size else 0.0)
    motions = reference.symmetries()
    return _State(
        start, reference, pivot, np.concatenate([motions[:3], motions[3:] + np.cross(motions[:3].T, pivot).T])
    )


def _weakly_held(points: SurfacePoints, state: _State, used: BoolArray) -> FloatArray:
    """Return what is held, with motions so little felt that points may slide by a share of their extent."""
    feet, jacobian = _rows(points.points_m[used], state, FitChoices())
    basis, _ = _free_basis(state, FitChoices())
    arms = state.pose.apply(points.points_m[used]) - state.pivot_m
    moves = np.concatenate([-skew(arms), np.broadcast_to(np.eye(3), (len(arms), 3, 3))], axis=2) @ basis
    squares = np.einsum("aik,ail->kl", moves, moves) / max(len(arms), 1)
    if len(arms) < basis.shape[1] or np.linalg.matrix_rank(squares, tol=1e-12 * np.trace(squares)) < basis.shape[1]:
        return state.held
    size = np.linalg.cholesky(squares)
    noise = np.mean(points.sigma_m[used] ** 2) + robust_scale(feet.distance_m) ** 2
    # In units of the RMS shift that a step gives the points.
    seen = np.linalg.solve(size, (jacobian @ basis).T).T
    _, singular, rows = np.linalg.svd(seen, full_matrices=True)
    full = np.zeros(basis.shape[1])
    full[: singular.size] = singular
    extent = float(np.sqrt((arms - arms.mean(axis=0)).var(axis=0).sum()))
    weak = full * _WEAK * extent < np.sqrt(noise)
    return np.concatenate([state.held, basis @ np.linalg.solve(size.T, rows[weak].T)], axis=1)


def _held_words(state: _State) -> tuple[str, ...]:
    """Say what is held, the surface's own symmetries first."""
    turns, shifts = state.held[:3], state.held[3:]
    return motion_words(np.concatenate([turns, shifts - np.cross(turns.T, state.pivot_m).T]))


def _free_basis(state: _State, choices: FitChoices) -> tuple[FloatArray, FloatArray]:
    """Return an orthonormal basis of the free steps about the pivot, (6 + k, r), and the symmetric motions, (6, s)."""
    n_curvatures = len(state.reference.curvature_names) if choices.curvature else 0
    motions = state.held if choices.pose else np.zeros((6, 0))
    blocked = np.zeros((6 + n_curvatures, 6))
    if choices.pose:
        blocked = np.zeros((6 + n_curvatures, motions.shape[1]))
        blocked[:6] = motions
    else:
        blocked[:6] = np.eye(6)
    full = np.linalg.svd(blocked, full_matrices=True)[0] if blocked.shape[1] else np.eye(6 + n_curvatures)
    return full[:, blocked.shape[1] :], motions


def _rows(points: FloatArray, state: _State, choices: FitChoices) -> tuple[Feet, FloatArray]:
    """Return feet, and derivatives of the distances by pose and curvature, shape (n, 6 + k)."""
    placed = state.pose.apply(points)
    feet = state.reference.feet(placed)
    jacobian = np.concatenate([np.cross(placed - state.pivot_m, feet.normals), feet.normals], axis=1)
    if choices.curvature:
        jacobian = np.concatenate([jacobian, feet.d_distance_d_curvature], axis=1)
    return feet, jacobian


def _chart(basis: FloatArray) -> Chart[_State]:
    def retract(state: _State, step: FloatArray) -> _State:
        full = basis @ step
        reference = state.reference
        if full.size > 6:
            reference = reference.with_curvatures(reference.curvatures_per_m + full[6:])
        # The origin of the points moves with the turn about the pivot.
        arm = state.pose.translation_m - state.pivot_m
        turned = rotation_from_vector(full[:3]) @ arm - arm
        pose = state.pose.moved(np.append(full[:3], turned + full[3:6]))
        return replace(state, pose=pose, reference=reference)

    def coordinates(state: _State) -> FloatArray:
        return np.zeros(basis.shape[1])

    return Chart(retract, coordinates)


def _names(count: int) -> tuple[str, ...]:
    return tuple(f"direction {k + 1}" for k in range(count))


def _robust_start(points: SurfacePoints, start: _State, choices: FitChoices) -> tuple[_State, BoolArray]:
    """Fit with equal weights and Tukey's loss, its scale from the median of the distances, and mark what is near."""
    state, distances = _equally_weighted(points.points_m, start, choices, rounds=3 if choices.robust else 1)
    middle = float(robust_scale_of_rows(distances[None])[0])
    sigmas = np.sqrt((points.sigma_m**2).sum(axis=1))
    return state, np.abs(distances) <= np.maximum(5 * middle, 5 * sigmas)


def _equally_weighted(
    points_m: FloatArray, start: _State, choices: FitChoices, *, rounds: int
) -> tuple[_State, FloatArray]:
    """Fit with equal weights, plain first (the start may be far off), then with Tukey's loss; return the distances."""
    state = start
    for k in range(rounds):
        distances = np.abs(_rows(points_m, state, choices)[0].distance_m)
        if not np.isfinite(distances).all():
            raise EstimationError("surface: points are beyond the centre of curvature of the design")
        scale = max(robust_scale(distances) if k else float(distances.max()), 1e-9)
        basis, _ = _free_basis(state, choices)

        def evaluate(here: _State, basis: FloatArray = basis, scale: float = scale) -> tuple[FloatArray, FloatArray]:
            feet, jacobian = _rows(points_m, here, choices)
            return _with_floor(feet.distance_m / scale, jacobian @ basis / scale)

        problem = Problem(_names(basis.shape[1]), evaluate, _chart(basis))
        how = Options(max_iterations=40, initial_damping=1e-4, tolerance=1e-2)
        state = solve(problem, state, loss=Tukey() if k else None, options=how).state
    return state, _rows(points_m, state, choices)[0].distance_m


def _with_floor(residuals: FloatArray, jacobian: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Add one constant residual: the descent measures its last step against the residuals, and exact points have none.

    With it a step far below the stated sigmas ends the descent even where the residuals are mere rounding.
    """
    constant = np.ones(1)
    return np.concatenate([residuals, constant]), np.concatenate([jacobian, np.zeros((1, jacobian.shape[1]))])


def _distance_covariance(points: SurfacePoints, pose: RigidTransform, normals: FloatArray) -> FloatArray:
    """Return N C N^T with the normals turned back to the frame of the points, shape (n, n)."""
    own = normals @ pose.rotation
    count = len(own)
    cube = points.covariance_m2.reshape(count, 3, count, 3)
    return np.asarray(np.einsum("aibj,ai,bj->ab", cube, own, own, optimize=True))


def _fitted(points: SurfacePoints, start: _State, used: BoolArray, choices: FitChoices) -> tuple[_State, _Linear]:
    """Fit the used points with full weights; the roughness is estimated between the steps."""
    state, chosen = start, points.chosen(used)
    for _ in range(2):
        basis, whole, _, _ = _weigh(chosen, state, choices)
        if not basis.shape[1]:
            break
        block = whole[None]

        def evaluate(
            here: _State, basis: FloatArray = basis, block: FloatArray = block
        ) -> tuple[FloatArray, FloatArray]:
            own, rows = _rows(chosen.points_m, here, choices)
            return _with_floor(*whitened(own.distance_m, rows @ basis, block))

        problem = Problem(_names(basis.shape[1]), evaluate, _chart(basis))
        found = solve(problem, state, options=Options(max_iterations=300, initial_damping=1e-6, tolerance=1e-4))
        if not found.converged:
            raise EstimationError(f"surface: the fit of {state.reference.describe()} did not converge: {found.reason}")
        state = found.state
    basis, whole, rough, factor = _weigh(chosen, state, choices)
    reduced = _rows(chosen.points_m, state, choices)[1] @ basis
    weighted = np.linalg.solve(whole, reduced)
    estimator = np.zeros((basis.shape[0], len(points.ids)))
    if basis.shape[1]:
        estimator[:, used] = basis @ np.linalg.solve(reduced.T @ weighted, weighted.T)
    return state, _Linear(estimator, rough, factor, int(used.sum()) - basis.shape[1])


class _Weights(NamedTuple):
    """The free basis, the covariance that weighs the distances, roughness [m] and variance factor."""

    basis: FloatArray
    covariance_m2: FloatArray
    roughness_m: float
    variance_factor: float


def _weigh(points: SurfacePoints, state: _State, choices: FitChoices) -> _Weights:
    basis, _ = _free_basis(state, choices)
    feet, jacobian = _rows(points.points_m, state, choices)
    require_feet(points.ids, feet)
    reduced = jacobian @ basis
    _refuse_undetermined(reduced, basis, points.ids)
    covariance = _distance_covariance(points, state.pose, feet.normals)
    rough, factor = roughness(feet.distance_m, reduced, covariance)
    whole = covariance + rough**2 * np.eye(len(covariance))
    mean = max(float(np.trace(whole)) / len(whole), 1e-18)
    # What the fit takes out may have any variance (Rao: the estimate does not change); under an inner datum a rigid
    # motion has none, and the matrix would be singular. More than the usual variance would slow the convergence.
    span = np.linalg.qr(reduced)[0]
    whole += mean * span @ span.T
    whole += 1e-8 * mean * np.eye(len(whole))
    return _Weights(basis, whole, rough, factor)


def _refuse_undetermined(reduced: FloatArray, basis: FloatArray, ids: tuple[str, ...]) -> None:
    count = basis.shape[1]
    if len(ids) < count:
        raise EstimationError(
            f"surface: {len(ids)} points are too few for {count} unknowns; name more targets of the surface"
        )
    if not count:
        return
    scale = np.maximum(np.sqrt((reduced**2).mean(axis=0)), 1e-300)
    _, singular, rows = np.linalg.svd(reduced / scale)
    if singular[-1] < _RANK * singular[0]:
        lost = basis @ (rows[-1] / scale)
        strongest = int(np.argmax(np.abs(lost[:6]) * np.array([1, 1, 1, 1e-3, 1e-3, 1e-3])))
        raise EstimationError(
            f"surface: {len(ids)} points ({', '.join(ids[:6])}, ...) do not determine the {_POSE_NAMES[strongest]} of "
            "the surface: they are on one line or too near to each other; name more targets beside them"
        )


def roughness(distance: FloatArray, reduced: FloatArray, covariance: FloatArray) -> tuple[float, float]:
    """Estimate how much of the distances errors of measurement do not explain.

    Shapes: distance (n,), covariance (n, n).
    reduced (n, r): Their derivatives by the parameters that are estimated.
    roughness_m: The surface's own RMS, 0 where errors of measurement explain everything [m].
    variance_factor: Weighted squares over redundancy with errors of measurement alone; NaN without redundancy.
    """
    count, unknowns = reduced.shape
    freedom = count - unknowns
    if freedom < 1:
        return 0.0, float("nan")
    outside = np.linalg.svd(reduced)[0][:, unknowns:] if unknowns else np.eye(count)
    values, vectors = np.linalg.eigh(outside.T @ covariance @ outside)
    values = np.maximum(values, max(1e-12 * float(values[-1]), 1e-30))
    squares = (vectors.T @ (outside.T @ distance)) ** 2
    factor = float((squares / values).sum()) / freedom
    if factor <= 1:
        return 0.0, factor
    # The sum falls with s: bisection between nothing and what unweighted squares give at most.
    low, high = 0.0, float(squares.sum()) / freedom + float(values[-1])
    for _ in range(100):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if float((squares / (values + middle)).sum()) > freedom else (low, middle)
    return float(np.sqrt(0.5 * (low + high))), factor


def _assembled(
    points: SurfacePoints, state: _State, linear: _Linear, used: BoolArray, choices: FitChoices
) -> SurfaceFit:
    """Propagate the covariance of the points into deviations, pose and points in the surface's frame."""
    feet, jacobian = _rows(points.points_m, state, choices)
    covariance = _distance_covariance(points, state.pose, feet.normals)
    remaining = np.eye(used.size) - jacobian @ linear.estimator
    measured = linear.estimator @ covariance @ linear.estimator.T
    sampled = linear.shape_sigma_m**2 * linear.estimator @ linear.estimator.T
    # From turns about the pivot to those of RigidTransform.moved, which leave the origin of the points in its place.
    world = np.eye(len(measured))
    world[3:6, :3] = -skew(state.pose.translation_m - state.pivot_m)
    reference = state.reference
    parameters = FitParameters(
        freeze(world @ (measured + sampled) @ world.T),
        freeze(world @ measured @ world.T),
        reference.curvature_names if choices.curvature else (),
        reference.curvatures_per_m,
    )
    aligned = _aligned_covariance(points, state, linear, feet)
    return SurfaceFit(
        reference=reference,
        design_from_world=state.pose,
        points=SurfacePoints(points.ids, state.pose.apply(points.points_m), aligned),
        deviation_m=freeze(np.array(feet.distance_m)),
        normals=freeze(np.array(feet.normals)),
        covariance_deviation_m2=freeze(_symmetric(remaining @ covariance @ remaining.T)),
        outliers=freeze(~used),
        tests=freeze(_tests(points, state, linear, choices)),
        shape_sigma_m=linear.shape_sigma_m,
        variance_factor=linear.variance_factor,
        redundancy=linear.redundancy,
        held=_held_words(state) if choices.pose else (),
        parameters=parameters,
    )


def _tests(points: SurfacePoints, state: _State, linear: _Linear, choices: FitChoices) -> FloatArray:
    """Return the deviations of all points over their sigma, with measurement, roughness and the fit's share in it."""
    feet, jacobian = _rows(points.points_m, state, choices)
    covariance = _distance_covariance(points, state.pose, feet.normals)
    covariance = covariance + linear.shape_sigma_m**2 * np.eye(len(covariance))
    remaining = np.eye(len(covariance)) - jacobian @ linear.estimator
    variance = np.einsum("ij,ij->i", remaining @ covariance, remaining)
    # A point that the fit passes through by necessity shows nothing of its error.
    controlled = variance > 1e-6 * np.maximum(np.diag(covariance), 1e-300)
    return np.asarray(feet.distance_m / np.sqrt(np.where(controlled, variance, np.inf)))


def _aligned_covariance(points: SurfacePoints, state: _State, linear: _Linear, feet: Feet) -> FloatArray:
    """Return the joint covariance of the points in the frame that they themselves define, shape (3 n, 3 n)."""
    arms, rotation = state.pose.apply(points.points_m) - state.pivot_m, state.pose.rotation
    count = len(arms)
    cube = points.covariance_m2.reshape(count, 3, count, 3)
    own = np.einsum("ij,ajbk,lk->aibl", rotation, cube, rotation, optimize=True).reshape(3 * count, 3 * count)
    moves = np.concatenate([-skew(arms), np.broadcast_to(np.eye(3), (count, 3, 3))], axis=2).reshape(3 * count, 6)
    along = np.einsum("aibj,bj->aib", own.reshape(count, 3, count, 3), feet.normals, optimize=True)
    mixed = along.reshape(3 * count, count) @ linear.estimator[:6].T
    core = linear.estimator[:6] @ np.einsum("ai,aib->ab", feet.normals, along) @ linear.estimator[:6].T
    lowered = mixed @ moves.T
    return _symmetric(own - lowered - lowered.T + moves @ core @ moves.T)


def _symmetric(matrix: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (matrix + matrix.T))
