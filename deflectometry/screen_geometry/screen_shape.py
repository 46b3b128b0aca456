"""Points of a screen with their joint covariance to its shape in a frame of its own, and the camera's pose to it."""

from dataclasses import dataclass

import numpy as np

from deflectometry.screen_geometry.measured_screen import MeasuredScreen
from deflectometry.setup.dot_screen import DotScreen
from deflectometry.setup.smooth_screen import SharedStep, SmoothScreen, SmoothWarp, display_terms, terms_of
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import FloatArray, IntArray

#: Degrees of the surface of each form, in the order in which they are tried.
DEGREES = {"plane": (1,), "bent": (2,), "free": (3, 4)}
#: Degree of what shared errors do to a field of dots: lenses and poses do less than 1 % beyond it.
_SHARED_DEGREE = 4
#: Chance of a sound plane to be taken for bent: below it the points contradict the simpler form.
_CONTRADICTED = 1e-3
#: Share of the mean of the points' own variances that each has at least: a point without any can be weighed.
_LEAST_OWN = 1e-6
#: Nodes per side over which the display's own frame is laid.
_FRAME_NODES = 9


@dataclass(frozen=True, slots=True, eq=False)
class ScreenPoints:
    """Points of a screen in the network's frame with their errors.

    u, v (n,): Fractions of the displayed image, or of the field of dots.
    points_m (n, 3): Where they are [m].
    shared_m (k, n, 3): What independent errors do to all of them, one sigma each [m].
    own_m2 (n, 3, 3): Covariance that is each point's alone [m^2].
    cam_from_world: Pose of the measuring camera; None without.
    pose_steps (k, 6): What the shared errors do to it.
    viewer_m (3,): A place in front of the screen [m].
    """

    u: FloatArray
    v: FloatArray
    points_m: FloatArray
    shared_m: FloatArray
    own_m2: FloatArray
    cam_from_world: RigidTransform | None
    pose_steps: FloatArray
    viewer_m: FloatArray


@dataclass(frozen=True, slots=True)
class ShapeTest:
    """How well a form describes the points.

    form: plane, bent, free.
    chi_square: Squared departures by their covariance.
    freedom: Coordinates less terms.
    probability: Of a chi-square as large, if the form is right.
    """

    form: str
    chi_square: float
    freedom: int
    probability: float


def describe_display(
    points: ScreenPoints, form: str, *, own_frame: bool
) -> tuple[MeasuredScreen, tuple[ShapeTest, ...]]:
    """Fit the surface of a display to its points, by their joint covariance.

    form: plane, bent, free, or auto for the simplest that the points do not contradict.
    own_frame: Lay the screen's own frame; otherwise keep the network's.
    Returns: The display, and the tests of the forms that were tried.
    EstimationError: Too few points for the form, or points on a line.
    """
    wanted = list(DEGREES) if form == "auto" else [form]
    fits: list[_Fit] = []
    tests = []
    for name, degree in [(one, degree) for one in wanted for degree in DEGREES[one]]:
        fit = _fit(points, name, degree)
        if fit is None:
            break
        fits.append(fit)
        tests.append(fit.test)
        if fit.test.probability > _CONTRADICTED:
            break
    if not fits:
        raise EstimationError(
            f"screen: {points.u.size} points of the display are measured; a {wanted[0]} display needs "
            f"{terms_of(DEGREES[wanted[0]][0])} that are not on a line"
        )
    fit = fits[-1]
    excess = (
        max(fit.test.chi_square / max(fit.test.freedom, 1) - 1.0, 0.0) if fit.test.probability < _CONTRADICTED else 0.0
    )
    sigma_surface = float(np.sqrt(excess * np.mean(np.einsum("nii->ni", points.own_m2))))
    reach = tuple((float(one.min()), float(one.max())) for one in (points.u, points.v))
    nodes = np.linspace(0.0, 1.0, _FRAME_NODES)
    u, v = (one.ravel() for one in np.meshgrid(nodes, nodes))
    terms = display_terms(u, v, len(fit.coefficients))
    modes = fit.modes
    poses = np.concatenate([points.pose_steps, np.zeros((len(modes) - len(points.pose_steps), 6))])
    frame = _frame(terms @ fit.coefficients, u, v, points.viewer_m) if own_frame else RigidTransform.identity()
    screen_from_world = frame.inverse()
    moved = screen_from_world.rotate(modes.reshape(-1, 3)).reshape(modes.shape)
    rigid = np.zeros((len(moved), 6))
    placed = screen_from_world.apply(terms @ fit.coefficients)
    if own_frame:
        rigid = _rigid_part(terms @ moved, placed)
    # The rigid part as coefficients: a shift, and a turn of the surface itself.
    surface = screen_from_world.rotate(fit.coefficients)
    surface[0] += screen_from_world.translation_m
    turned = np.cross(rigid[:, None, :3], surface[None])
    turned[:, 0] += rigid[:, 3:]
    shared = _compress(moved - turned, _pose_steps(poses, rigid, points.cam_from_world, frame))
    screen = SmoothScreen(surface, reach[0], reach[1], fit.test.form)
    pose = None if points.cam_from_world is None else points.cam_from_world @ frame
    return MeasuredScreen(screen, shared, pose, sigma_surface), tuple(tests)


def describe_dots(points: ScreenPoints, number: IntArray, *, own_frame: bool) -> MeasuredScreen:
    """Put measured dots in the places of their numbers, with what they share as smooth errors.

    number (n, 2): Column and row of each.
    own_frame: As for `describe_display`.
    """
    frame = _frame(points.points_m, points.u, points.v, points.viewer_m) if own_frame else RigidTransform.identity()
    screen_from_world = frame.inverse()
    placed = screen_from_world.apply(points.points_m)
    moved = screen_from_world.rotate(points.shared_m.reshape(-1, 3)).reshape(points.shared_m.shape)
    rigid = _rigid_part(moved, placed) if own_frame else np.zeros((len(moved), 6))
    moved = moved - np.cross(rigid[:, None, :3], placed[None]) - rigid[:, None, 3:]
    terms = display_terms(points.u, points.v, terms_of(_SHARED_DEGREE))
    solver = np.linalg.pinv(terms)
    smooth = solver @ moved
    rest = moved - terms @ smooth
    turn = screen_from_world.rotation
    own = turn @ points.own_m2 @ turn.T
    variance = np.einsum("nii->ni", own) + np.einsum("kni,kni->ni", rest, rest)
    shared = _compress(smooth, _pose_steps(points.pose_steps, rigid, points.cam_from_world, frame))
    low, high = number.min(axis=0), number.max(axis=0)
    columns, rows = (high - low + 1).tolist()
    xyz, sigma = np.full((rows, columns, 3), np.nan), np.zeros((rows, columns, 3))
    at = high[1] - number[:, 1], number[:, 0] - low[0]
    xyz[at], sigma[at] = placed, np.sqrt(variance)
    screen = DotScreen(xyz, (int(low[0]), int(high[1])), sigma)
    pose = None if points.cam_from_world is None else points.cam_from_world @ frame
    return MeasuredScreen(screen, shared, pose)


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    coefficients: FloatArray
    modes: FloatArray
    test: ShapeTest


def _fit(points: ScreenPoints, form: str, degree: int) -> _Fit | None:
    """Fit one form by generalised least squares; None where the points do not determine it.

    modes (m, terms, 3): One sigma each of independent errors of the coefficients: those that the points share, in
    their order, then what comes of the points' own.
    """
    from scipy.stats import chi2

    count = terms_of(degree)
    terms = display_terms(points.u, points.v, count)
    if len(terms) < count or np.linalg.matrix_rank(terms, tol=1e-6 * np.sqrt(len(terms))) < count:
        return None
    design = np.asarray(np.kron(terms, np.eye(3)), dtype=np.float64)
    # All that a point between whose kind lengths are known errs by is shared with others: nothing is its own.
    # What they share (a loosely known scale: millimetres) is no measure of their own (micrometres) where there is any.
    every = np.einsum("nii->", points.own_m2) or np.sum(points.shared_m**2)
    least = _LEAST_OWN * every / len(terms)
    roots = np.linalg.inv(np.linalg.cholesky(points.own_m2 + least * np.eye(3)))
    observed = points.points_m.reshape(-1)

    def white(columns: FloatArray) -> FloatArray:
        return np.asarray((roots @ columns.reshape(len(terms), 3, -1)).reshape(columns.shape[0], -1))

    # C = D + M M^T; C^-1 = D^-1 - D^-1 M (I + M^T D^-1 M)^-1 M^T D^-1.
    whitened, shared = white(design), white(points.shared_m.reshape(len(points.shared_m), -1).T)
    right = white(observed[:, None])[:, 0]
    inner = np.linalg.inv(np.eye(shared.shape[1]) + shared.T @ shared)

    def weighed(columns: FloatArray) -> FloatArray:
        return np.asarray(columns - shared @ (inner @ (shared.T @ columns)))

    normal = whitened.T @ weighed(whitened)
    gain = np.linalg.solve(normal, weighed(whitened).T)
    solution = gain @ right
    left = right - whitened @ solution
    chi_square = float(left @ weighed(left[:, None])[:, 0])
    freedom = right.size - design.shape[1]
    by_shared = (gain @ shared).T.reshape(-1, count, 3)
    by_own = np.linalg.svd(gain, full_matrices=False)
    own = (by_own[0] * by_own[1]).T.reshape(-1, count, 3)
    probability = float(chi2.sf(chi_square, freedom)) if freedom > 0 else 1.0
    test = ShapeTest(form, chi_square, freedom, probability)
    return _Fit(solution.reshape(count, 3), np.concatenate([by_shared, own]), test)


def _frame(points_m: FloatArray, u: FloatArray, v: FloatArray, viewer_m: FloatArray) -> RigidTransform:
    """Return world_from_screen: origin in the middle, x along u, y against v, z towards the viewer.

    EstimationError: Left and right are exchanged as the viewer sees it.
    """
    middle = points_m.mean(axis=0)
    affine = np.linalg.lstsq(np.column_stack([np.ones(u.size), u, v]), points_m, rcond=None)[0]
    right, up = affine[1], -affine[2]
    normal = np.cross(right, up)
    normal /= np.linalg.norm(normal)
    if normal @ (viewer_m - middle) < 0:
        raise EstimationError(
            "screen: seen from the cameras its left and right are exchanged; are the photos, or the table of the "
            "pattern or display, mirrored?"
        )
    right = right / np.linalg.norm(right)
    right = right - (right @ normal) * normal
    right /= np.linalg.norm(right)
    return RigidTransform(np.stack([right, np.cross(normal, right), normal], axis=1), middle)


def _rigid_part(moved_m: FloatArray, points_m: FloatArray) -> FloatArray:
    """Return the turn and shift that movements of points contain, shape (k, 6): moved = w x point + shift + rest.

    Shapes: moved_m (k, n, 3), points_m (n, 3).
    """
    movements = np.zeros((len(points_m), 3, 6))
    for axis in range(3):
        movements[:, :, axis] = np.cross(np.eye(3)[axis], points_m)
        movements[:, axis, 3 + axis] = 1.0
    solver = np.linalg.pinv(movements.reshape(-1, 6))
    return np.asarray(moved_m.reshape(len(moved_m), -1) @ solver.T)


def _pose_steps(
    steps: FloatArray, rigid: FloatArray, cam_from_world: RigidTransform | None, world_from_screen: RigidTransform
) -> FloatArray:
    """Return the steps of cam_from_screen, shape (k, 6): those of the pose, and of the screen's frame in the world."""
    if cam_from_world is None:
        return np.zeros((len(rigid), 6))
    cam_from_screen = cam_from_world @ world_from_screen
    turn = steps[:, :3] + rigid[:, :3] @ cam_from_screen.rotation.T
    arm = cam_from_world.rotation @ world_from_screen.translation_m
    shift = steps[:, 3:] + rigid[:, 3:] @ cam_from_screen.rotation.T + np.cross(steps[:, :3], arm)
    return np.asarray(np.concatenate([turn, shift], axis=1))


def _compress(coefficients: FloatArray, poses: FloatArray) -> tuple[SharedStep, ...]:
    """Return the same joint covariance by as few independent errors as it has.

    Shapes: coefficients (k, terms, 3), poses (k, 6).
    """
    both = np.concatenate([coefficients.reshape(len(coefficients), -1), poses], axis=1)
    scale = np.sqrt((both**2).sum(axis=0))
    scale[scale == 0] = 1.0
    _, values, vectors = np.linalg.svd(both / scale, full_matrices=False)
    keep = values > 1e-6 * values[0] if values.size and values[0] > 0 else np.zeros(values.shape, dtype=np.bool_)
    steps = values[keep, None] * vectors[keep] * scale
    count = coefficients.shape[1]
    return tuple(SharedStep(one[3 * count :], SmoothWarp(one[: 3 * count].reshape(count, 3))) for one in steps)
