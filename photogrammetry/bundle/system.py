"""Normal equations of a bundle adjustment, targets eliminated (Schur complement), whole blocks at a time."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from heliogauge.adjust.gauss_newton import EPSILON
from heliogauge.validate import BoolArray, FloatArray, IntArray
from photogrammetry.bundle.coupling import Coupling, couple
from photogrammetry.bundle.datum import (
    DatumConstraints,
    DatumKind,
    Movements,
    datum_constraints,
    free_movements,
    similarity_movements,
)
from photogrammetry.bundle.factor import EIGENVALUE_TOLERANCE, BlockFactor, BorderedBlocks, DenseFactor, Factor
from photogrammetry.bundle.problem import Layout
from photogrammetry.bundle.rays import runs
from photogrammetry.bundle.rows import BundleModel, CameraRows, ExtraRows
from photogrammetry.bundle.state import BundleState

# Below this the damping moves a step by less than what it is for; the undamped factors serve then.
_NO_DAMPING = 1e-3
# Determinant of a target's block over the cube of its trace above which nothing of it is lost.
_SOUND = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class NormalBlocks:
    """Normal equations before elimination.

    dense: Photos, intrinsics and kept targets.
    dense_gradient (g,): Their gradient.
    targets (e, 3, 3): Own blocks of the eliminated targets.
    target_gradient (e, 3): Their gradient.
    """

    dense: BorderedBlocks
    dense_gradient: FloatArray
    targets: FloatArray
    target_gradient: FloatArray


def normal_blocks(layout: Layout, rows: tuple[CameraRows, ...], extra: ExtraRows) -> NormalBlocks:
    """Sum up the normal equations.

    layout: Order of the unknowns.
    rows: Whitened, weighted image residuals.
    extra: Constraints and priors.
    Returns: All but the coupling of targets with the dense part.
    """
    count = layout.eliminated.size
    dense = BorderedBlocks.zeros(layout.n_photos, layout.n_global - 6 * layout.n_photos)
    gradient = np.zeros(layout.n_global)
    # Nine sums for each target: six of the symmetric block and three of the gradient.
    sums = np.zeros((9, count + 1))
    for one in rows:
        _add_dense(layout, one, dense, gradient)
        slot = layout.slot[one.targets]
        # Kept and fixed targets go to a bin of their own (slot -1 is the last) and are dropped.
        d, r = one.target_columns, one.residuals
        products = [(d[0, i], d[0, j], d[1, i], d[1, j]) for i, j in _SYMMETRIC]
        products += [(d[0, i], r[0], d[1, i], r[1]) for i in range(3)]
        places = np.where(slot < 0, count, slot)
        for row, (a, b, c, e) in zip(sums, products, strict=True):
            row += np.bincount(places, weights=a * b + c * e, minlength=count + 1)
        _add_kept(layout, one, dense, gradient)
    blocks = np.empty((count, 3, 3))
    for row, (i, j) in zip(sums, _SYMMETRIC, strict=False):
        blocks[:, i, j] = blocks[:, j, i] = row[:count]
    normal = NormalBlocks(dense, gradient, blocks, np.ascontiguousarray(sums[6:, :count].T))
    _add_extra(layout, extra, normal)
    return normal


_SYMMETRIC = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def _add_dense(layout: Layout, rows: CameraRows, dense: BorderedBlocks, gradient: FloatArray) -> None:
    """Add the products of pose and intrinsics of each photo."""
    photos, grams = _grams(rows)
    first = 6 * layout.n_photos
    dense.poses[photos] += grams[:, :6, :6]
    gradient[:first].reshape(-1, 6)[photos] += grams[:, :6, -1]
    columns = layout.intrinsic_columns[rows.camera] - first
    if columns.size:
        own = slice(int(columns[0]), int(columns[-1]) + 1)
        dense.border.reshape(-1, 6, dense.border.shape[1])[photos, :, own] += grams[:, :6, 6:-1]
        dense.corner[own, own] += grams[:, 6:-1, 6:-1].sum(axis=0)
        gradient[first + columns] += grams[:, 6:-1, -1].sum(axis=0)


def _grams(rows: CameraRows) -> tuple[IntArray, FloatArray]:
    """Return the photos and the products of pose, intrinsics and residual of each, shape (q, w, w)."""
    width = 7 + rows.n_free
    if rows.has_few_points:
        first, second = np.triu_indices(width)
        part = rows.jacobian[:, :width]
        products = part[0, first] * part[0, second] + part[1, first] * part[1, second]
        sums = np.add.reduceat(products, rows.starts[:-1], axis=1).T
        grams = np.empty((len(sums), width, width))
        grams[:, first, second] = grams[:, second, first] = sums
        return rows.photos[rows.starts[:-1]], grams
    found = [(photo, rows.jacobian[:, :width, first:last]) for photo, first, last in runs(rows.photos, rows.starts)]
    grams = np.array([part[0] @ part[0].T + part[1] @ part[1].T for _, part in found]).reshape(-1, width, width)
    return np.array([photo for photo, _ in found], dtype=np.intp), grams


def _add_kept(layout: Layout, rows: CameraRows, dense: BorderedBlocks, gradient: FloatArray) -> None:
    """Add the image points of targets that are not eliminated (two for each scale bar)."""
    column = layout.kept_column[rows.targets]
    which = np.nonzero(column >= 0)[0]
    if not which.size:
        return
    first = 6 * layout.n_photos
    d_target = rows.target_columns[:, :, which]
    own = column[which][:, None] - first + np.arange(3)
    cross = np.einsum("ram,rbm->mab", rows.jacobian[:, : 6 + rows.n_free, which], d_target)
    poses = 6 * rows.photos[which][:, None] + np.arange(6)
    np.add.at(dense.border, (poses[:, :, None], own[:, None, :]), cross[:, :6])
    intrinsics = np.broadcast_to(layout.intrinsic_columns[rows.camera] - first, (which.size, rows.n_free))
    np.add.at(dense.corner, (intrinsics[:, :, None], own[:, None, :]), cross[:, 6:])
    np.add.at(dense.corner, (own[:, :, None], intrinsics[:, None, :]), np.swapaxes(cross[:, 6:], 1, 2))
    np.add.at(dense.corner, (own[:, :, None], own[:, None, :]), np.einsum("ram,rbm->mab", d_target, d_target))
    np.add.at(gradient, first + own, np.einsum("ram,rm->ma", d_target, rows.residuals[:, which]))


def _add_extra(layout: Layout, extra: ExtraRows, normal: NormalBlocks) -> None:
    """Add constraints on targets and priors on intrinsics."""
    first = 6 * layout.n_photos
    for residuals, jacobian, targets in zip(extra.residuals, extra.jacobians, extra.targets, strict=True):
        for place, target in enumerate(targets.tolist()):
            slot = layout.slot[target]
            if slot >= 0:
                own = jacobian[:, place]
                normal.targets[slot] += own.T @ own
                normal.target_gradient[slot] += own.T @ residuals
        kept = np.nonzero(layout.kept_column[targets] >= 0)[0]
        if kept.size:
            columns = (layout.kept_column[targets[kept]][:, None] + np.arange(3)).ravel()
            own = jacobian[:, kept].reshape(len(residuals), -1)
            normal.dense.corner[np.ix_(columns - first, columns - first)] += own.T @ own
            normal.dense_gradient[columns] += own.T @ residuals
    if extra.prior_residuals.size:
        count = extra.prior_jacobian.shape[1]
        normal.dense.corner[:count, :count] += extra.prior_jacobian.T @ extra.prior_jacobian
        normal.dense_gradient[first : first + count] += extra.prior_jacobian.T @ extra.prior_residuals


@dataclass(frozen=True, eq=False)
class Elimination:
    """Normal equations with one damping: roots of the targets' blocks, factor of what is left."""

    roots: FloatArray
    lost_targets: FloatArray
    factor: Factor
    coupling: Coupling
    dense_right: FloatArray
    target_right: FloatArray


class SchurSystem:
    """One linearised bundle adjustment; satisfies `heliogauge.adjust.gauss_newton.LinearSystem`.

    model: Layout and order of the image points.
    rows, extra: Residuals and derivatives there.
    root (m,): Roots of the weights of the image points; all 1 if not given.
    scale_floor (n,): Smallest column scale.
    """

    def __init__(
        self,
        model: BundleModel,
        state: BundleState,
        rows: tuple[CameraRows, ...],
        extra: ExtraRows,
        *,
        root: FloatArray | None = None,
        scale_floor: FloatArray | None = None,
    ) -> None:
        self.layout: Layout = model.layout
        self.rows: tuple[CameraRows, ...] = rows
        if root is not None:
            parts = model.camera_slices
            self.rows = tuple(one.scaled(root[part]) for one, part in zip(self.rows, parts, strict=True))
        self.extra: ExtraRows = extra
        self.normal: NormalBlocks = normal_blocks(self.layout, self.rows, self.extra)
        diagonals = [self.normal.dense.diagonal, np.einsum("eii->ei", self.normal.targets).ravel()]
        norms = np.sqrt(np.concatenate(diagonals))
        scale = norms if scale_floor is None else np.maximum(norms, scale_floor)
        self.scale: FloatArray = np.where(scale > 0, scale, 1.0)
        #: Largest scale over the column's own norm; above 1 where the norm was larger earlier in the descent.
        self.largest_scale_ratio = float((scale[norms > 0] / norms[norms > 0]).max(initial=1.0))
        self.rounding: float = EPSILON * float(np.linalg.norm(self.scale * model.values(state)))
        fixed = model.problem.target_indices(model.problem.fixed)
        self._problem, self._rays = model.problem, model.rays
        #: Movements of the whole network that nothing sees.
        self.movements: Movements = free_movements(similarity_movements(state), extra.jacobians, extra.targets, fixed)

    @property
    def dense_scale(self) -> FloatArray:
        """Column scale of the dense part, shape (g,)."""
        return self.scale[: self.layout.n_global]

    @property
    def target_scale(self) -> FloatArray:
        """Column scale of the eliminated targets, shape (e, 3)."""
        return self.scale[self.layout.n_global :].reshape(-1, 3)

    @cached_property
    def dense_movements(self) -> FloatArray:
        """The free movements in the dense part, shape (g, d)."""
        layout, count = self.layout, self.movements.count
        result = np.zeros((layout.n_global, count))
        result[: 6 * layout.n_photos] = self.movements.poses.reshape(6 * layout.n_photos, count)
        if layout.kept.size:
            result[layout.n_global - 3 * layout.kept.size :] = self.movements.points[layout.kept].reshape(
                3 * layout.kept.size, count
            )
        return result

    @cached_property
    def datum(self) -> DatumConstraints:
        """The datum on targets or photos that takes the free movements away."""
        problem, table = self._problem, self._problem.observations
        seen = table.n_rays > 0
        seen[problem.target_indices(problem.fixed)] = False
        free = np.flatnonzero(seen)
        chosen = problem.target_indices(problem.datum.targets) if problem.datum.targets else free
        names = [table.targets[i] for i in chosen]
        if problem.datum.kind is DatumKind.PHOTOS:
            chosen = np.array([table.photos.index(name) for name in problem.datum.photos], dtype=np.intp)
            names = list(problem.datum.photos)
        parts = [f"{len(problem.fixed)} fixed targets"] if problem.fixed else []
        parts += [f"{len(problem.constraints)} constraints"] if problem.constraints else []
        defined = " and ".join(parts) if self.movements.count < 7 else ""
        return datum_constraints(problem.datum, self.movements, chosen, defined=defined, names=names)

    def split_datum(self) -> tuple[FloatArray, FloatArray]:
        """Return the datum's columns of the dense part, shape (g, d), and of the eliminated targets, (e, 3, d)."""
        layout, columns = self.layout, self.datum.columns
        dense = np.zeros((layout.n_global, columns.shape[2]))
        dense[: 6 * layout.n_photos] = self.datum.poses.reshape(6 * layout.n_photos, columns.shape[2])
        if layout.kept.size:
            own = columns[layout.kept].reshape(3 * layout.kept.size, columns.shape[2])
            dense[layout.n_global - 3 * layout.kept.size :] = own
        return dense, columns[layout.eliminated]

    @cached_property
    def overlap(self) -> FloatArray:
        """Datum times free movements, ``G^T K``, shape (d, d)."""
        datum, movements = self.datum, self.movements
        on_poses = np.einsum("pid,pif->df", datum.poses, movements.poses)
        return np.asarray(np.einsum("nid,nif->df", datum.columns, movements.points) + on_poses)

    def under_datum(self, dense: FloatArray, targets: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Take the movement of the whole network out of steps, shapes (g, k) and (e, 3, k): ``G^T step = 0``."""
        if not self.movements.count:
            return dense, targets
        datum_dense, datum_targets = self.split_datum()
        seen = datum_dense.T @ dense + np.einsum("eid,eik->dk", datum_targets, targets)
        amounts = np.linalg.solve(self.overlap, seen)
        moved = self.movements.points[self.layout.eliminated] @ amounts
        return dense - self.dense_movements @ amounts, targets - moved

    @property
    def rank(self) -> int:
        """Number of determined directions on top of the datum."""
        undamped = self.undamped
        lost = undamped.factor.lost.shape[1] + int(undamped.lost_targets.sum())
        return int(self.layout.n - self.movements.count - lost)

    @cached_property
    def undamped(self) -> Elimination:
        """The elimination without damping."""
        return self.eliminated(0.0)

    @cached_property
    def _undamped_step(self) -> tuple[FloatArray, float]:
        return self._solve(self.undamped, 0.0)

    @cached_property
    def decrement(self) -> float:
        """Length of the residuals that the undamped step would remove."""
        return float(np.sqrt(2 * max(self._undamped_step[1], 0.0)))

    def step(self, damping: float) -> tuple[FloatArray, float]:
        """Return the damped step and the decrease of the cost it promises."""
        if damping <= _NO_DAMPING:
            return self._undamped_step
        return self._solve(self.eliminated(damping), damping)

    def eliminated(self, damping: float) -> Elimination:
        """Eliminate the targets and factorise the rest."""
        layout = self.layout
        roots, lost = _target_roots(self.normal.targets, self.target_scale, damping)
        right = np.einsum("eji,ej->ei", roots, self.normal.target_gradient)
        dense = self.normal.dense.scaled(self.dense_scale, damping)
        # The movements are an exact null space: this gives them the eigenvalue 1 and changes nothing else.
        border = np.linalg.qr(self.dense_movements * self.dense_scale[:, None])[0]
        coupling = couple(layout, self._rays, self.rows, roots, self.dense_scale)
        dense_right = self.normal.dense_gradient / self.dense_scale - coupling.times(right[:, :, None])[:, 0]
        factor: Factor | None = self._factor_by_blocks(dense, coupling, border)
        if factor is None:
            matrix = dense.whole()
            matrix += border @ border.T
            matrix -= coupling.gram()
            factor = DenseFactor(matrix)
        return Elimination(roots, lost, factor, coupling, dense_right, right)

    def _factor_by_blocks(self, dense: BorderedBlocks, coupling: Coupling, border: FloatArray) -> BlockFactor | None:
        """Factorise without forming the matrix where what ties the photos together is little; None elsewhere."""
        count = int(self.layout.eliminated.size)
        if not BlockFactor.pays(dense.size, 3 * count + border.shape[1] + 2 * len(dense.corner)):
            return None
        try:
            return BlockFactor(dense, coupling.columns(np.arange(count)), border)
        except np.linalg.LinAlgError:
            return None

    def _solve(self, elimination: Elimination, damping: float) -> tuple[FloatArray, float]:
        """Return the step and the promised decrease ``-g.s / 2 + damping |D s|^2 / 2``."""
        dense = -elimination.factor.solve(elimination.dense_right)
        inner = elimination.coupling.turned_times(dense[:, None])[:, :, 0]
        targets = -np.einsum("eij,ej->ei", elimination.roots, elimination.target_right + inner)
        # Steps obey the datum, or the estimate would be in another one than its covariance.
        dense_step, target_step = self.under_datum((dense / self.dense_scale)[:, None], targets[:, :, None])
        step = np.concatenate([dense_step.ravel(), target_step.ravel()])
        gradient = np.concatenate([self.normal.dense_gradient, self.normal.target_gradient.ravel()])
        scaled = step * self.scale
        return step, 0.5 * (damping * float(scaled @ scaled) - float(gradient @ step))


def _target_roots(blocks: FloatArray, scale: FloatArray, damping: float) -> tuple[FloatArray, FloatArray]:
    """Return R with ``R R^T`` the (pseudo-)inverse of each block, shape (e, 3, 3), and the rank that each lacks."""
    if not len(blocks):
        return np.zeros((0, 3, 3)), np.zeros(0)
    scaled = blocks / scale[:, :, None] / scale[:, None, :] + damping * np.eye(3)
    (a, b, c), (d, e), f = scaled[:, 0].T, scaled[:, 1, 1:].T, scaled[:, 2, 2]
    # Cholesky's factor and its inverse, written out: a tenth of the time of eigenvectors.
    with np.errstate(divide="ignore", invalid="ignore"):
        l11 = np.sqrt(a)
        l21, l31 = b / l11, c / l11
        l22 = np.sqrt(d - l21 * l21)
        l32 = (e - l31 * l21) / l22
        l33 = np.sqrt(f - l31 * l31 - l32 * l32)
        determinant = (l11 * l22 * l33) ** 2
        # The smallest eigenvalue is at least determinant / largest^2, and the largest at most the trace.
        sound = determinant > _SOUND * (a + d + f) ** 3
        roots = np.zeros_like(scaled)
        roots[:, 0, 0], roots[:, 1, 1], roots[:, 2, 2] = 1 / l11, 1 / l22, 1 / l33
        roots[:, 0, 1] = -l21 / (l11 * l22)
        roots[:, 1, 2] = -l32 / (l22 * l33)
        roots[:, 0, 2] = (l21 * l32 / l22 - l31) / (l11 * l33)
    lost = np.zeros(len(scaled))
    weak = np.flatnonzero(~sound)
    if weak.size:
        values, vectors = np.linalg.eigh(scaled[weak])
        held: BoolArray = values > EIGENVALUE_TOLERANCE * np.maximum(values[:, -1:], 1e-300)
        inverse = np.where(held, 1 / np.sqrt(np.where(held, values, 1.0)), 0.0)
        roots[weak] = vectors * inverse[:, None, :]
        lost[weak] = (~held).sum(axis=1)
    return roots / scale[:, :, None], lost
