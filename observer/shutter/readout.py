"""How far a camera flew while it read a frame, from image points of targets that were taken row after row.

The camera's place after the middle row is ``C + s m``, s the share of the readout and m the motion over a frame. All
photos share one readout T: ``m = T v + e`` with the flight v past the photo; e is what gusts, acceleration and a turn
of the camera add, of an unknown size that all photos share. Poses, targets and intrinsics of the bundle are eliminated
from its normal equations, so that T and all m are those of the joint adjustment.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from heliogauge.adjust.solution import CovarianceScale
from heliogauge.errors import EstimationError
from heliogauge.validate import FloatArray, IntArray
from observer.photo_edges.views import after_middle, project_moving
from observer.shutter.flight import Flight
from photogrammetry.bundle import BundleResult

#: Sizes of what the flight leaves open of a photo's motion over a frame: from nothing that an image point shows to what
#: no flight does, equally probable by their logarithms [m].
_SPREADS_M = np.geomspace(1e-5, 0.3, 28)
#: Sizes that are less probable than the most probable one by this factor are left out.
_NO_WEIGHT = 1e-4


@dataclass(frozen=True, slots=True)
class Known:
    """The readout as it is stated, with its standard deviation, in the unit of what is estimated."""

    value: float
    sigma: float


@dataclass(frozen=True, slots=True, eq=False)
class RowMotions:
    """How the camera moves while it reads each photo.

    photos: Their names.
    readout: What the flight is multiplied with: the readout [s], or what is flown in it where no speed is known [m].
    sigma_readout: Its standard deviation.
    motions_m (n, 3): Motion of each photo from the first to the last row, in the frame [m].
    covariance_m2 (3 n, 3 n): Their joint covariance [m^2].
    spread_m: Size of what the flight leaves open of each motion, and axis [m].
    in_seconds: Whether the readout is a time, not the way flown in it.
    moved_poses (6 n, 3 n): Steps of all poses (`RigidTransform.moved`) for steps of the motions [rad/m, m/m].
    """

    photos: tuple[str, ...]
    readout: float
    sigma_readout: float
    motions_m: FloatArray
    covariance_m2: FloatArray
    spread_m: float
    moved_poses: FloatArray
    in_seconds: bool = False

    def pose_covariance(self, rotations: FloatArray) -> FloatArray:
        """Return what uncertain motions add to the joint covariance of the steps of all poses.

        Shapes: rotations (n, 3, 3), result (6 n, 6 n).
        rotations: Those of ``cam_from_frame``.

        Beside what they do to the adjusted poses, the camera's place is off within a frame, by nothing in the middle
        row and half a motion in the first and last one: it counts with its root mean square over the rows.
        """
        n = len(rotations)
        within = np.zeros((n, 6, n, 3))
        # A step d of a pose moves the eye by -R^T d.
        within[np.arange(n), 3:, np.arange(n)] = -rotations / np.sqrt(12)
        halves = within.reshape(6 * n, 3 * n)
        total = self.moved_poses @ self.covariance_m2 @ self.moved_poses.T + halves @ self.covariance_m2 @ halves.T
        return np.asarray(0.5 * (total + total.T))


class ReducedMotions(NamedTuple):
    """Normal equations of the motions of all photos, all else eliminated.

    photos: Names of the photos.
    matrix (3 n, 3 n): Their matrix [1/m^2].
    gradient (3 n,): Their gradient at the present motions [1/m].
    moved_poses (6 n, 3 n): Steps of all poses for steps of the motions.
    """

    photos: tuple[str, ...]
    matrix: FloatArray
    gradient: FloatArray
    moved_poses: FloatArray


def shares_of(bundle: BundleResult, motions_m: FloatArray) -> list[FloatArray]:
    """Return how long after the middle row each image point was taken, as share of the readout, camera by camera.

    motions_m (n, 3): Motion of each photo over a frame, in the frame [m].
    Returns: In the order of the bundle's rows.
    """
    state, shares = bundle.state, []
    for rows in bundle.system.rows:
        rotations = state.rotations[rows.photos]
        points = np.einsum("mij,mj->mi", rotations, state.points_m[rows.targets]) + state.translations_m[rows.photos]
        moved = np.einsum("mij,mj->mi", rotations, motions_m[rows.photos])
        camera = state.cameras[rows.camera]
        shares.append(after_middle(camera, project_moving(camera, points, moved)))
    return shares


def reduce_to_motions(bundle: BundleResult, motions_m: FloatArray, along: FloatArray | None = None) -> ReducedMotions:
    """Eliminate poses, targets and intrinsics from the normal equations.

    bundle: Adjusted to image points as a camera at rest in the middle row would have taken them.
    motions_m (n, 3): The motions for which that was done, in the frame [m].
    along (3 n, k): Combinations of the motions that take their place; None: each by itself.
    EstimationError: What is eliminated is not determined.
    """
    from scipy.sparse import csr_matrix, vstack

    state, layout, extra = bundle.state, bundle.system.layout, bundle.system.extra
    n_photos, first = layout.n_photos, layout.n_global - 3 * layout.kept.size
    place = np.full(layout.slot.size, -1, dtype=np.intp)
    free = np.flatnonzero((layout.slot >= 0) | (layout.kept_column >= 0))
    place[free] = first + 3 * np.arange(free.size)
    width = first + 3 * free.size
    designs, motions, residuals = [], [], []
    for rows, share in zip(bundle.system.rows, shares_of(bundle, motions_m), strict=True):
        count = rows.photos.size
        columns = np.empty((count, 9 + rows.n_free), dtype=np.intp)
        columns[:, :6] = 6 * rows.photos[:, None] + np.arange(6)
        columns[:, 6 : 6 + rows.n_free] = layout.intrinsic_columns[rows.camera]
        columns[:, 6 + rows.n_free :] = place[rows.targets][:, None] + np.arange(3)
        values = np.concatenate([rows.jacobian[:, : 6 + rows.n_free], rows.target_columns], axis=1)
        # Fixed targets are no unknowns.
        values[:, 6 + rows.n_free :] *= place[rows.targets] >= 0
        designs += [_sparse(values[k], np.maximum(columns, 0), width) for k in (0, 1)]
        by_place = np.einsum("ram,mab->rmb", rows.jacobian[:, 3:6], state.rotations[rows.photos])
        by_motion = -share[None, :, None] * by_place
        own = 3 * rows.photos[:, None] + np.arange(3)
        motions += [_sparse(by_motion[k].T, own, 3 * n_photos) for k in (0, 1)]
        residuals += [rows.residuals[0], rows.residuals[1]]
    known, known_residuals = _known_rows(extra, place, 6 * n_photos, width)
    design = vstack([*designs, csr_matrix(known)]).tocsr()
    moves = vstack([*motions, csr_matrix((len(known), 3 * n_photos))]).tocsr()
    residual = np.concatenate([*residuals, known_residuals])
    if along is not None:
        moves = csr_matrix(moves @ along)
    coupling = (design.T @ moves).toarray()
    try:
        back = _solved((design.T @ design).tocsr(), np.column_stack([coupling, design.T @ residual]), n_photos)
    except np.linalg.LinAlgError as error:
        raise EstimationError("rolling shutter: poses and targets are not determined without it") from error
    matrix = (moves.T @ moves).toarray() - coupling.T @ back[:, :-1]
    gradient = moves.T @ residual - coupling.T @ back[:, -1]
    size = bundle.variance_factor if bundle.options.covariance_scale is CovarianceScale.POSTERIOR else 1.0
    steps = -back[: 6 * n_photos, :-1]
    return ReducedMotions(bundle.problem.observations.photos, 0.5 * (matrix + matrix.T) / size, gradient / size, steps)


def _solved(normal: Any, right: FloatArray, n_photos: int) -> FloatArray:
    """Solve normal equations whose first unknowns are poses, each of which meets no other pose.

    normal (n, n): Sparse matrix.
    right (n, k): Right sides.
    numpy.linalg.LinAlgError: The unknowns are not determined.

    The poses of 400 photos are 2400 unknowns: eliminated photo by photo, what is left are the targets.
    """
    scale = np.sqrt(normal.diagonal())
    scale[scale == 0] = 1.0
    right, first = right / scale[:, None], 6 * n_photos
    own = np.arange(first).reshape(n_photos, 6)
    row, column = (np.broadcast_to(own[one], (n_photos, 6, 6)) for one in ((..., None), (slice(None), None)))
    poses = np.asarray(normal[row.ravel(), column.ravel()]).reshape(n_photos, 6, 6)
    poses = poses / scale[own][:, :, None] / scale[own][:, None]
    # Poses to others, and their right sides.
    beside = normal[:first, first:].toarray() / scale[:first, None] / scale[first:]
    both = np.concatenate([beside, right[:first]], axis=1)
    np.linalg.cholesky(poses)
    of_poses = np.linalg.solve(poses, both.reshape(n_photos, 6, -1)).reshape(both.shape)
    others = beside.shape[1]
    rest = normal[first:, first:].toarray() / scale[first:, None] / scale[first:] - beside.T @ of_poses[:, :others]
    found = np.empty_like(right)
    np.linalg.cholesky(rest)
    found[first:] = np.linalg.solve(rest, right[first:] - beside.T @ of_poses[:, others:])
    found[:first] = of_poses[:, others:] - of_poses[:, :others] @ found[first:]
    return np.asarray(found / scale[:, None])


def steady_readout(bundle: BundleResult, flight: Flight) -> tuple[float, float]:
    """Return the readout, and its sigma, if every camera moved just as its path says.

    bundle: Adjusted to image points as they were taken.
    EstimationError: Poses and targets are not determined.

    One unknown in place of three for each photo: a fraction of the work.
    """
    along = flight.velocity.reshape(-1, 1)
    reduced = reduce_to_motions(bundle, np.zeros_like(flight.velocity), along)
    precision = max(float(reduced.matrix[0, 0]), 1e-300)
    return float(-reduced.gradient[0]) / precision, precision**-0.5


def _known_rows(extra: Any, place: IntArray, intrinsics: int, width: int) -> tuple[FloatArray, FloatArray]:
    """Return rows and residuals of constraints and priors, shapes (k, width) and (k,)."""
    known, first = np.zeros((extra.all_residuals.size, width)), 0
    for residuals, jacobian, targets in zip(extra.residuals, extra.jacobians, extra.targets, strict=True):
        rows = slice(first, first + len(residuals))
        for number, column in enumerate(place[targets].tolist()):
            if column >= 0:
                known[rows, column : column + 3] += jacobian[:, number]
        first += len(residuals)
    known[first:, intrinsics : intrinsics + extra.prior_jacobian.shape[1]] = extra.prior_jacobian
    return known, extra.all_residuals


def _sparse(values: FloatArray, columns: IntArray, width: int) -> Any:
    """Return rows, values (k, m) in columns (m, k), as a sparse matrix."""
    from scipy.sparse import csr_matrix

    count, each = columns.shape
    return csr_matrix((values.T.ravel(), columns.ravel(), each * np.arange(count + 1)), shape=(count, width))


def estimate_motions(
    reduced: ReducedMotions, motions_m: FloatArray, flight: Flight, known: Known | None = None
) -> RowMotions:
    """Estimate readout and motions together.

    motions_m (n, 3): The motions at which the normal equations hold, in the frame [m].
    flight: How the camera flew past each photo.
    known: The readout as stated; None: unknown.
    EstimationError: The normal equations determine nothing, as in a network that does not fit at all.
    """
    relative = np.repeat(flight.doubt / np.median(flight.doubt), 3)
    right = reduced.matrix @ motions_m.ravel() - reduced.gradient
    tries = [
        _Conditional(reduced.matrix, right, flight.velocity.ravel(), spread * relative, known) for spread in _SPREADS_M
    ]
    logs = np.array([one.log_evidence for one in tries])
    weights = np.exp(logs - logs.max())
    weights[weights < _NO_WEIGHT] = 0.0
    weights /= weights.sum()
    chosen = [(weight, one) for weight, one in zip(weights.tolist(), tries, strict=True) if weight > 0]
    both = sum((weight * one.mean for weight, one in chosen), np.zeros(1 + right.size))
    covariance = np.zeros((both.size, both.size))
    for weight, one in chosen:
        off = one.mean - both
        covariance += weight * (one.covariance() + np.outer(off, off))
    return RowMotions(
        reduced.photos,
        float(both[0]),
        float(np.sqrt(covariance[0, 0])),
        both[1:].reshape(-1, 3),
        covariance[1:, 1:],
        float(np.exp(weights @ np.log(_SPREADS_M))),
        reduced.moved_poses,
    )


class _Conditional:
    """Readout and motions where the size of what the flight leaves open is known."""

    def __init__(
        self, matrix: FloatArray, right: FloatArray, flight: FloatArray, spread_m: FloatArray, known: Known | None
    ) -> None:
        from scipy.linalg import cho_factor, cho_solve

        weight = 1 / np.square(spread_m)
        whole = np.empty((right.size + 1, right.size + 1))
        whole[1:, 1:] = matrix
        whole[1:, 1:][np.diag_indices(right.size)] += weight
        whole[0, 1:] = whole[1:, 0] = -weight * flight
        whole[0, 0] = flight @ (weight * flight)
        both = np.concatenate([[0.0], right])
        if known is not None:
            whole[0, 0] += known.sigma**-2
            both[0] += known.value * known.sigma**-2
        self._scale = np.sqrt(np.diag(whole))
        try:
            self._factor = cho_factor(whole / self._scale[:, None] / self._scale, lower=True)
        except np.linalg.LinAlgError as error:
            raise EstimationError("the motions over the photos' rows are not determined by their targets") from error
        self.mean: FloatArray = cho_solve(self._factor, both / self._scale) / self._scale
        half_log = float(np.log(np.diag(self._factor[0])).sum() + np.log(self._scale).sum())
        self.log_evidence = float(0.5 * both @ self.mean - half_log + 0.5 * np.log(weight).sum())

    def covariance(self) -> FloatArray:
        """Return the joint covariance of readout and motions."""
        from scipy.linalg import cho_solve

        return np.asarray(cho_solve(self._factor, np.eye(self._scale.size)) / self._scale[:, None] / self._scale)
