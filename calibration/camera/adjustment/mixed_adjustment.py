"""Camera, poses and board with what is common to a photo and to a board as random effects of estimated size.

Corners of one photo are off together: the board bends as it is held, the camera's focus and lens mount settle, the
operator follows blur and shading. A departure of the board from its drawing is smooth. Taken as independent from point
to point both make variances too small: halves of real calibrations differed by 12 to 25 times what they stated.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from calibration.camera.adjustment.variance_components import Components, MixedModel, PhotoRows, Posterior
from calibration.camera.start_values.board_network import BoardNetwork
from heliogauge.camera.model import Camera
from heliogauge.errors import NotConvergedError
from heliogauge.geometry.rigid import skew
from heliogauge.validate import FloatArray, IntArray
from photogrammetry import ImagePoints
from photogrammetry.bundle import BundleProblem, BundleState, CameraModel, adjust, datum, statistics
from photogrammetry.bundle import state as states

#: Groups of the smooth part of the board's departure, besides stretch and shear of a print in its plane: axes and
#: degrees. With one size for all, a sheared or bent board with nothing else is less likely than a camera whose centre
#: moves from photo to photo.
_STRETCHED = "stretched"
_BOARD_GROUPS = {"in plane": ((0, 1), (2, 3, 4, 5)), "bent": ((2,), (2,)), "across": ((2,), (3, 4, 5))}
#: Degrees of the smooth error of a photo, over the board.
_PHOTO_DEGREES = {"low": (1, 2), "high": (3, 4, 5)}
#: What of the camera settles anew with each photo: the intrinsic that must be free, and places in `INTRINSIC_NAMES`.
_CAMERA_EFFECTS = {"focal": ("focal_px", [0]), "center": ("center_x_px", [2, 3])}
#: Coefficients of degree d are smaller by d to this power; settled on three real boards, see `docs`.
_BOARD_DECAY, _PHOTO_DECAY = 1.5, 1.5
#: Where nothing is known of the points' places they are free within so many units.
_UNKNOWN = 30.0
#: Steps below this many sigmas of the camera end the iteration.
_SETTLED, _MOST_STEPS = 0.1, 12
#: Sizes to begin with: board and points in pitches, photos' errors and centres in pixels, focal lengths in a share.
_EFFECTS = {
    "stretched": 3e-3,
    "in plane": 3e-3,
    "bent": 3e-3,
    "across": 3e-3,
    "low": 0.02,
    "high": 0.02,
    "focal": 1e-4,
    "center": 0.1,
}
_POINT, _NOISE = (5e-4, 5e-4, 1e-3), 2.0
#: This share of them is nothing: 0.00002 px, 1e-7 of the focal length.
_NOTHING = 1e-3


#: What is said where the steps do not end, or lead to a camera that is none.
_UNSETTLED = (
    "calibration: camera and board do not settle; the photos hardly determine them: add photos with other tilts, "
    "turned by 90 degrees and from another distance"
)


class Sizes(NamedTuple):
    """What a mixed adjustment starts from, or found: standard deviations of its groups, and their names."""

    names: tuple[str, ...]
    components: Components


@dataclass(frozen=True, eq=False)
class MixedAdjustment:
    """A calibration with random effects.

    network: What was adjusted.
    table: Its image points that were used.
    state: Camera, poses and points.
    posterior: The unknowns at the last linearisation.
    linear: That linearisation.
    sizes: Standard deviations that were found.
    """

    network: BoardNetwork
    table: ImagePoints
    state: BundleState
    posterior: Posterior
    linear: "_Linear"
    sizes: Sizes

    @cached_property
    def camera(self) -> Camera:
        """The camera with its covariance."""
        camera, columns = self.state.cameras[0], _columns(self.network.free)
        jacobian = states.d_parameters_d_intrinsics(camera)[:, columns]
        covariance = jacobian @ self.covariance_intrinsics @ jacobian.T
        return camera.with_covariance(0.5 * (covariance + covariance.T))

    @cached_property
    def covariance_intrinsics(self) -> FloatArray:
        """Covariance of the free intrinsics, sizes of effects that few photos hardly tell included, shape (k, k)."""
        return self._with_unknown_sizes[0]

    @cached_property
    def likely_sizes(self) -> Sizes:
        """Sizes of the effects as large as they may well be: with them the covariance is nearly the one stated."""
        return Sizes(self.sizes.names, replace(self.sizes.components, effects=self._with_unknown_sizes[1]))

    @cached_property
    def _with_unknown_sizes(self) -> tuple[FloatArray, FloatArray]:
        columns = np.arange(_columns(self.network.free).size)
        usual = np.array([_EFFECTS[name] for name in self.sizes.names])
        return self.posterior.with_unknown_sizes(columns, usual)

    @cached_property
    def residuals_px(self) -> FloatArray:
        """Predicted minus measured with camera and board as adjusted, the poses as they fit best, shape (m, 2) [px]."""
        table, state = self.table, self.state
        turned = np.einsum("mij,mj->mi", state.rotations[table.photo_index], state.points_m[table.target_index])
        return state.cameras[0].project(turned + state.translations_m[table.photo_index]) - table.pixels_px

    @cached_property
    def _moves(self) -> datum.Movements:
        """Movements of the board that change nothing: its frame is that of its points as a whole."""
        center = self.state.points_m.mean(axis=0)
        every = datum.similarity_movements(self.state, center)
        return every if not self.network.places_known else every.combined(np.eye(7)[:, :6])

    @cached_property
    def joint_points(self) -> FloatArray:
        """Joint covariance of the points as the drawing places them, shape (3 k, 3 k) [units of the adjustment]."""
        return self.posterior.joint_of_steps(self.linear.through)

    @cached_property
    def points_with_unknowns(self) -> FloatArray:
        """Covariance of these with the common unknowns, the free intrinsics first, shape (3 k, n)."""
        return self.posterior.crossed_with_steps(self.linear.through)

    @cached_property
    def covariance_points_m2(self) -> FloatArray:
        """Joint covariance of the points with the whole held in place, shape (3 k, 3 k) [m^2]."""
        joint = self.joint_points
        points = self._moves.points.reshape(len(joint), -1)
        basis = np.linalg.qr(points)[0]
        half = joint @ basis
        cleaned = joint - half @ basis.T - basis @ half.T + basis @ (basis.T @ half) @ basis.T
        return np.asarray(cleaned * self.linear.unit_m**2)

    @cached_property
    def covariance_poses(self) -> FloatArray:
        """Covariance of each pose with the board held in place, shape (p, 6, 6) [rad, m]."""
        points = self._moves.points.reshape(-1, self._moves.count) / self.linear.unit_m
        shares = np.linalg.pinv(points)
        joint = self.joint_points
        crossed = shares @ self.points_with_unknowns
        common = shares @ joint @ shares.T
        result = np.empty((len(self.state.rotations), 6, 6))
        for i, columns in enumerate(self.linear.pose_columns):
            moves = self._moves.poses[i]
            mixed = moves @ crossed[:, columns]
            own = self.posterior.covariance[np.ix_(columns, columns)]
            block = own - mixed - mixed.T + moves @ common @ moves.T
            result[i] = 0.5 * (block + block.T)
        return result

    @cached_property
    def intrinsic_tests(self) -> tuple[statistics.IntrinsicTest, ...]:
        """Tests of the estimated intrinsics against zero and each other."""
        columns = _columns(self.network.free)
        values = states.intrinsics_of(self.state.cameras[0])[columns].tolist()
        labels = [("camera", states.INTRINSIC_NAMES[k]) for k in columns]
        return statistics.examine_values(labels, values, self.covariance_intrinsics)

    @property
    def refine_board(self) -> bool:
        """Whether the board's shape was estimated."""
        return not self.network.places_known or _STRETCHED in self.sizes.names

    @property
    def prior_sigma_m(self) -> FloatArray:
        """How far points may be from the drawing: 0: held, infinite: nothing is known, shape (3,) [m]."""
        if not self.network.places_known:
            return np.full(3, np.inf)
        if not self.refine_board:
            return np.zeros(3)
        drawn, unit = self.network.board.points_m[self.network.seen], self.linear.unit_m
        board, group = _board_effects(drawn, self.sizes.names)
        effects = (board**2 * self.sizes.components.effects[group] ** 2).sum(axis=2).mean(axis=0)
        variance = self.sizes.components.point**2 + np.array([effects[:2].mean(), effects[:2].mean(), effects[2]])
        return np.asarray(unit * np.sqrt(variance))

    @property
    def datum(self) -> str:
        """What defines the board's frame, in words."""
        count = len(self.state.points_m)
        what = self._moves.describe()
        return f"inner constraints over {count} targets ({what})"

    @property
    def redundancy(self) -> int:
        """Residuals less unknowns without a prior."""
        return 2 * self.table.n - self.linear.n_flat


@dataclass(frozen=True, eq=False)
class _Linear:
    """Rows of all photos at a state.

    model: The mixed model.
    unit_m: Unit of points and of the board's effects [m].
    through (k, 3, n): Derivative of the points by the common unknowns, in that unit.
    pose_columns length p: Columns of each pose.
    n_flat: Unknowns without a prior.
    """

    model: MixedModel
    unit_m: float
    through: FloatArray
    pose_columns: tuple[IntArray, ...]
    n_flat: int


def adjust_mixed(
    network: BoardNetwork,
    table: ImagePoints,
    start: BundleState,
    *,
    refine_board: bool,
    sizes: Sizes | None = None,
    settled: bool = False,
) -> MixedAdjustment:
    """Adjust with random effects, their sizes estimated by restricted likelihood, linearised anew until nothing moves.

    table: Image points to use, of the network's photos and targets.
    refine_board: Estimate the board's shape; otherwise it is held as the start has it.
    sizes: Sizes to begin with.
    settled: Whether these are final.
    EstimationError: The photos do not determine camera and poses.
    NotConvergedError: Nothing settles.
    """
    groups = _group_names(network, refine_board)
    if sizes is not None:
        return _adjusted(network, table, start, sizes, refine_board=refine_board, settled=settled)
    first = _start_components(groups, network, refine_board, len(table.photos))
    found = _adjusted(network, table, start, Sizes(groups, first), refine_board=refine_board)
    own = np.array([name in _CAMERA_EFFECTS for name in groups])
    if not (own & (found.sizes.components.effects > 2 * _NOTHING * first.effects)).any():
        return found
    # The likelihood has two maxima where a bent board can be told from a camera that changes only by all photos.
    still = replace(first, effects=np.where(own, _NOTHING, 1.0) * first.effects)
    other = _adjusted(network, table, start, Sizes(groups, still), refine_board=refine_board)
    return max((found, other), key=lambda one: one.posterior.log_likelihood)


def _adjusted(
    network: BoardNetwork,
    table: ImagePoints,
    start: BundleState,
    sizes: Sizes,
    *,
    refine_board: bool,
    settled: bool = False,
) -> MixedAdjustment:
    state, columns = start, _columns(network.free)
    groups, components = sizes
    for _ in range(_MOST_STEPS):
        linear = _linearised(network, table, state, groups, refine_board=refine_board)
        posterior = linear.model.solve(components) if settled else linear.model.settle(components)
        components = posterior.components
        state = _moved(network, state, posterior, linear)
        step, spread = posterior.values[: columns.size], posterior.covariance[: columns.size, : columns.size]
        if float(step @ np.linalg.solve(spread, step)) < _SETTLED**2 * columns.size:
            state = _with_best_poses(table, state)
            return MixedAdjustment(network, table, state, posterior, linear, Sizes(groups, components))
    raise NotConvergedError(_UNSETTLED)


def _group_names(network: BoardNetwork, refine_board: bool) -> tuple[str, ...]:
    board = (_STRETCHED, *_BOARD_GROUPS) if refine_board and network.places_known else ()
    return (*board, *_PHOTO_DEGREES, *(name for name, (needed, _) in _CAMERA_EFFECTS.items() if needed in network.free))


def _start_components(groups: tuple[str, ...], network: BoardNetwork, refine_board: bool, n_photos: int) -> Components:
    point = np.array(_POINT) if network.places_known or not refine_board else np.full(3, _UNKNOWN)
    return Components(np.array([_EFFECTS[name] for name in groups]), point, np.full(n_photos, _NOISE))


def _columns(free: tuple[str, ...]) -> IntArray:
    return np.array([k for k, name in enumerate(states.INTRINSIC_NAMES) if name in free], dtype=np.intp)


def smooth_terms(places_m: FloatArray, degrees: tuple[int, ...], decay: float) -> FloatArray:
    """Return polynomials over a board, orthonormal at its points, that shrink with their degree, shape (n, t)."""
    flat = places_m[:, :2] - places_m[:, :2].mean(axis=0)
    x, y = (flat / np.abs(flat).max(axis=0)).T
    powers = [(d, x ** (d - i) * y**i) for d in range(max(degrees) + 1) for i in range(d + 1)]
    # As many as the points can hold.
    powers = powers[: len(places_m) // 2]
    basis = np.linalg.qr(np.stack([term for _, term in powers], axis=1))[0] * np.sqrt(len(places_m))
    chosen = [k for k, (d, _) in enumerate(powers) if d in degrees]
    return np.asarray(basis[:, chosen] * np.array([float(powers[k][0]) ** -decay for k in chosen]))


class PhotoColumns(NamedTuple):
    """Derivatives of image points [px], and what their noise is.

    d_intrinsics (n, 2, k), d_pose (n, 2, 6), d_point (n, 2, 3): By free intrinsics, the pose's steps, points in units.
    effects: Name and columns (n, 2, e) of each group of a photo's random effects.
    noise_px2 (n, 2, 2): Covariance of the points [px^2].
    """

    d_intrinsics: FloatArray
    d_pose: FloatArray
    d_point: FloatArray
    predicted_px: FloatArray
    effects: tuple[tuple[str, FloatArray], ...]
    noise_px2: FloatArray


def photo_columns(
    network: BoardNetwork, table: ImagePoints, state: BundleState, drawn_m: FloatArray, places: IntArray, unit_m: float
) -> PhotoColumns:
    """Differentiate image points.

    drawn_m (k, 3): Where the network's points were drawn [m].
    places (t,): Which of these the table's targets are.
    """
    camera = state.cameras[0]
    arms = np.einsum("mij,mj->mi", state.rotations[table.photo_index], state.points_m[table.target_index])
    predicted, d_place, d_parameters = camera.project_with_jacobians(arms + state.translations_m[table.photo_index])
    d_intrinsics = d_parameters @ states.d_parameters_d_intrinsics(camera)
    effects = []
    for name, degrees in _PHOTO_DEGREES.items():
        terms = smooth_terms(drawn_m, degrees, _PHOTO_DECAY)[places][table.target_index]
        effects.append((name, np.einsum("ia,nt->niat", np.eye(2), terms).reshape(table.n, 2, -1)))
    for name, (needed, chosen) in _CAMERA_EFFECTS.items():
        if needed in network.free:
            size = camera.focal_y_px if name == "focal" else 1.0
            effects.append((name, d_intrinsics[:, :, chosen] * size))
    return PhotoColumns(
        d_intrinsics[:, :, _columns(network.free)],
        np.concatenate([-d_place @ skew(arms), d_place], axis=2),
        d_place @ state.rotations[table.photo_index] * unit_m,
        predicted,
        tuple(effects),
        table.covariance_px2,
    )


def _linearised(
    network: BoardNetwork, table: ImagePoints, state: BundleState, groups: tuple[str, ...], *, refine_board: bool
) -> _Linear:
    unit, drawn = network.board.pitch_m, network.board.points_m[network.seen]
    every = photo_columns(network, table, state, drawn, np.arange(len(drawn)), unit)
    whitening = np.linalg.inv(np.linalg.cholesky(table.covariance_px2))
    misfit = np.einsum("mij,mj->mi", whitening, table.pixels_px - every.predicted_px)
    board, group = _board_effects(drawn, groups)
    n_lens = every.d_intrinsics.shape[2]
    shared = n_lens + group.size
    by_board = np.einsum("nia,nak->nik", every.d_point, board[table.target_index])
    jacobian = np.concatenate(
        [every.d_intrinsics, by_board, every.d_pose, *(columns for _, columns in every.effects)], axis=2
    )
    jacobian = whitening @ jacobian
    if not (np.isfinite(misfit).all() and np.isfinite(jacobian).all()):
        # The last step led points behind the camera, or beyond where its lens is one.
        raise NotConvergedError(_UNSETTLED)
    d_point = whitening @ every.d_point if refine_board else np.zeros((table.n, 2, 3))
    own = [np.full(6, -1), *(np.full(columns.shape[2], groups.index(name)) for name, columns in every.effects)]
    own_group = np.concatenate(own)
    rows, pose_columns = [], []
    for photo in range(len(table.photos)):
        chosen = np.nonzero(table.photo_index == photo)[0]
        first = shared + photo * own_group.size
        columns = np.concatenate([np.arange(shared), np.arange(first, first + own_group.size)])
        rows.append(PhotoRows(columns, jacobian[chosen], table.target_index[chosen], d_point[chosen], misfit[chosen]))
        pose_columns.append(np.arange(first, first + 6))
    kind = np.concatenate([np.full(n_lens, -1), group, np.tile(own_group, len(table.photos))]).astype(np.intp)
    estimated = network.places_known and refine_board
    expected = (drawn - state.points_m) / unit if estimated else np.zeros(drawn.shape)
    usual = _start_components(groups, network, refine_board, len(table.photos))
    least = Components(_NOTHING * usual.effects, _NOTHING * usual.point, _NOTHING * usual.noise)
    model = MixedModel(rows, kind, expected, points_estimated=estimated, least=least)
    through = np.zeros((len(drawn), 3, kind.size))
    through[:, :, n_lens:shared] = board
    return _Linear(model, unit, through, tuple(pose_columns), int((kind < 0).sum()))


def _board_effects(drawn_m: FloatArray, groups: tuple[str, ...]) -> tuple[FloatArray, IntArray]:
    """Return how each of the board's modes moves its points, shape (n, 3, k) [pitches], and the modes' groups."""
    if _STRETCHED not in groups:
        return np.zeros((len(drawn_m), 3, 0)), np.zeros(0, dtype=np.intp)
    # The board's own size is its unit: were it free, a vanishing board would have vanishing departures.
    flat = drawn_m[:, :2] - drawn_m[:, :2].mean(axis=0)
    x, y = (flat / np.sqrt((flat**2).sum(axis=1).mean())).T
    stretched = np.stack([np.stack([x, -y, 0 * x], axis=1), np.stack([y, x, 0 * x], axis=1)], axis=2)
    parts, kinds = [stretched], [np.full(2, groups.index(_STRETCHED))]
    for name, (axes, degrees) in _BOARD_GROUPS.items():
        terms = smooth_terms(drawn_m, degrees, _BOARD_DECAY)
        for axis in axes:
            columns = np.zeros((len(drawn_m), 3, terms.shape[1]))
            columns[:, axis] = terms
            parts.append(columns)
            kinds.append(np.full(terms.shape[1], groups.index(name)))
    return np.concatenate(parts, axis=2), np.concatenate(kinds).astype(np.intp)


def _moved(network: BoardNetwork, state: BundleState, posterior: Posterior, linear: _Linear) -> BundleState:
    """Return the state with the unknowns' steps; the board stays where its drawing is."""
    values, columns = posterior.values, _columns(network.free)
    intrinsics = states.intrinsics_of(state.cameras[0])
    intrinsics[columns] += values[: columns.size]
    focal_px, aspect = intrinsics[:2]
    if focal_px <= 0 or aspect <= -1:
        raise NotConvergedError(_UNSETTLED)
    camera = states.camera_with_intrinsics(state.cameras[0], intrinsics)
    steps = np.array([values[own] for own in linear.pose_columns])
    points = state.points_m + linear.unit_m * (posterior.steps + linear.through @ values)
    return replace(
        state,
        cameras=(camera,),
        rotations=states.turned(state.rotations, steps[:, :3]),
        translations_m=state.translations_m + steps[:, 3:],
        points_m=points,
    )


def _with_best_poses(table: ImagePoints, state: BundleState) -> BundleState:
    """Fit the poses alone: with the camera that is stated, not with what settled anew in their photo."""
    held = BundleProblem(table, (CameraModel("camera"),), fixed=table.targets)
    return adjust(held, state).state
