"""Joint covariance of points, poses and intrinsics of a bundle adjustment, block by block, under any datum."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from heliogauge.validate import BoolArray, FloatArray, IntArray
from photogrammetry.bundle.system import SchurSystem

# A direction of unit length with less than this of a parameter leaves the parameter held.
_UNKNOWN = 1e-6


@dataclass(frozen=True, slots=True)
class CovarianceFactors:
    """Scale of the covariance: ``share`` times the cofactor, ``prior`` for the part of constraints and priors."""

    share: float
    prior: float


class _Carried(NamedTuple):
    """``Q G M^T`` of dense part and targets, and ``M G^T Q G M^T``."""

    dense: FloatArray
    targets: FloatArray
    core: FloatArray


class BundleCovariance:
    """Joint covariance of everything that was estimated, under one datum.

    system: The normal equations at the minimum, with their datum.
    factors: Scale.

    With Q the inverse of the normal matrix plus any minimal border, K the free movements and G the datum columns, the
    covariance under the datum is ``P Q P^T``, ``P = I - K (G^T K)^-1 G^T`` (Baarda's S-transformation). Only
    ``F = S^-1/2`` times the coupling of the targets is ever formed, so all points cost one triangular solution.
    """

    def __init__(self, system: SchurSystem, factors: CovarianceFactors) -> None:
        self._system = system
        self._layout = system.layout
        self._factors = factors
        self._elimination = system.undamped
        self._target_movements: FloatArray = system.movements.points[self._layout.eliminated]
        self._datum_dense, self._datum_targets = system.split_datum()

    @cached_property
    def _halves(self) -> FloatArray:
        """Half columns of all eliminated targets, shape (g, 3 e): ``Q_pp = R R^T + half^T half``."""
        halves = np.empty(
            (self._layout.n_global - self._elimination.factor.lost.shape[1], 3 * self._layout.eliminated.size)
        )
        for block in self._system.couplings(self._elimination):
            matrix = block.matrix
            if block.rows is not None:
                matrix = np.zeros((self._layout.n_global, block.matrix.shape[1]))
                matrix[block.rows] = block.matrix
            own = -self._elimination.factor.half(matrix).reshape(len(halves), -1, 3)
            turned = np.swapaxes(self._elimination.roots[block.first : block.last], 1, 2)
            halves[:, 3 * block.first : 3 * block.last] = np.einsum("gei,eij->gej", own, turned, optimize=True).reshape(
                len(halves), -1
            )
        return halves

    def _dense_halves(self, columns: IntArray) -> FloatArray:
        """Half columns of unknowns of the dense part, shape (g, k)."""
        unit = np.zeros((self._layout.n_global, columns.size))
        unit[columns, np.arange(columns.size)] = 1 / self._system.dense_scale[columns]
        return self._elimination.factor.half(unit)

    @cached_property
    def _carried(self) -> "_Carried":
        """``Q G M^T``, dense part (g, d) and targets (e, 3, d), and ``M G^T Q G M^T``, (d, d); ``M = (G^T K)^-1``."""
        layout, system = self._layout, self._system
        count = system.movements.count
        if not count:
            return _Carried(np.zeros((layout.n_global, 0)), np.zeros((layout.eliminated.size, 3, 0)), np.zeros((0, 0)))
        inverse = np.linalg.inv(self._system.overlap)
        half = self._elimination.factor.half(self._datum_dense / system.dense_scale[:, None])
        half += self._halves @ self._datum_targets.reshape(3 * layout.eliminated.size, count)
        roots = self._elimination.roots
        own = roots @ (np.swapaxes(roots, 1, 2) @ self._datum_targets)
        targets = (self._halves.T @ half).reshape(layout.eliminated.size, 3, count) + own
        dense = self._elimination.factor.back(half) / system.dense_scale[:, None]
        core = half.T @ half + np.einsum("eid,eif->df", self._datum_targets, own)
        return _Carried(dense @ inverse.T, targets @ inverse.T, inverse @ core @ inverse.T)

    def _under_datum(self, raw: FloatArray, movements: FloatArray, carried: FloatArray) -> FloatArray:
        """Turn blocks Q, (b, k, k), of unknowns with movements K and columns ``Q G M^T``, (b, k, d), to the datum."""
        if not movements.shape[2]:
            return np.asarray(0.5 * (raw + np.swapaxes(raw, 1, 2)))
        core = self._carried.core
        mixed = movements @ np.swapaxes(carried, 1, 2)
        result = raw - mixed - np.swapaxes(mixed, 1, 2) + movements @ core @ np.swapaxes(movements, 1, 2)
        return np.asarray(0.5 * (result + np.swapaxes(result, 1, 2)))

    @cached_property
    def _held(self) -> BoolArray:
        """Unknowns of the dense part that the datum holds, shape (g,): their variance is 0 but for rounding."""
        held = np.zeros(self._layout.n_global, dtype=np.bool_)
        held[: 6 * self._layout.n_photos] = (self._system.datum.poses != 0).any(axis=2).ravel()
        return held

    @cached_property
    def _known(self) -> tuple[FloatArray, FloatArray]:
        """``P Q E^T`` for the rows E of constraints and priors: dense part (g, k) and targets (e, 3, k)."""
        extra, layout = self._system.extra, self._layout
        count = extra.all_residuals.size
        dense, targets = np.zeros((layout.n_global, count)), np.zeros((layout.eliminated.size, 3, count))
        first = 0
        for residuals, jacobian, index in zip(extra.residuals, extra.jacobians, extra.targets, strict=True):
            rows = np.arange(first, first + len(residuals))
            for place, target in enumerate(index.tolist()):
                if layout.slot[target] >= 0:
                    targets[layout.slot[target]][:, rows] += jacobian[:, place].T
                elif layout.kept_column[target] >= 0:
                    column = layout.kept_column[target]
                    dense[column : column + 3, rows] += jacobian[:, place].T
            first += len(residuals)
        dense[6 * layout.n_photos : 6 * layout.n_photos + extra.prior_jacobian.shape[1], first:] = (
            extra.prior_jacobian.T
        )
        roots = self._elimination.roots
        half = self._elimination.factor.half(dense / self._system.dense_scale[:, None])
        half += self._halves @ targets.reshape(3 * layout.eliminated.size, count)
        own = roots @ (np.swapaxes(roots, 1, 2) @ targets)
        solved = (self._halves.T @ half).reshape(layout.eliminated.size, 3, count) + own
        solved_dense = self._elimination.factor.back(half) / self._system.dense_scale[:, None]
        # Under the datum: P Q E^T = Q E^T - K (M^T G^T Q E^T).
        seen = self._carried[0].T @ dense + np.einsum("eid,eik->dk", self._carried[1], targets)
        return solved_dense - self._system.dense_movements @ seen, solved - self._target_movements @ seen

    def _scaled(self, blocks: FloatArray, known: FloatArray | None) -> FloatArray:
        """Scale cofactor blocks; constraints and priors keep their own sigma where the scale is another."""
        share, prior = self._factors.share, self._factors.prior
        if known is None or share == prior:
            return share * blocks
        return share * blocks + (prior - share) * (known @ np.swapaxes(known, 1, 2))

    @property
    def _corrects(self) -> bool:
        return self._factors.share != self._factors.prior and self._system.extra.all_residuals.size > 0

    @cached_property
    def _target_cofactors(self) -> FloatArray:
        """Cofactor of each eliminated target, shape (e, 3, 3)."""
        roots, halves = self._elimination.roots, self._halves
        raw = roots @ np.swapaxes(roots, 1, 2)
        for i in range(3):
            for j in range(i + 1):
                products = np.einsum("ge,ge->e", halves[:, i::3], halves[:, j::3])
                raw[:, i, j] += products
                if i != j:
                    raw[:, j, i] += products
        return raw

    @cached_property
    def points(self) -> FloatArray:
        """Covariance of each target, shape (n, 3, 3) [m^2]; 0 for fixed ones, NaN where not determined."""
        layout = self._layout
        result = np.zeros((layout.slot.size, 3, 3))
        raw = self._target_cofactors
        under = self._under_datum(raw, self._target_movements, self._carried[1])
        result[layout.eliminated] = self._scaled(under, self._known[1] if self._corrects else None)
        if layout.kept.size:
            columns = layout.kept_column[layout.kept][:, None] + np.arange(3)
            result[layout.kept] = self._dense_blocks(columns)
        unknown = self.unknown_targets
        result[unknown] = np.nan
        return result

    def dense_cofactors(self, columns: IntArray) -> FloatArray:
        """Blocks of the inverse of the normal matrix under any datum: (b, k) columns of the dense part to (b, k, k)."""
        scale = self._system.dense_scale[columns]
        return np.asarray(self._elimination.factor.inverse_blocks(columns) / scale[:, :, None] / scale[:, None, :])

    def _dense_blocks(self, columns: IntArray) -> FloatArray:
        """Covariance of blocks of unknowns of the dense part, columns of shape (b, k)."""
        raw = self.dense_cofactors(columns)
        under = self._under_datum(raw, self._system.dense_movements[columns], self._carried[0][columns])
        blocks = self._scaled(under, self._known[0][columns] if self._corrects else None)
        _hold(blocks, self._held[columns])
        lost = self._unknown_dense[columns]
        blocks[lost[:, :, None] | lost[:, None, :]] = np.nan
        return blocks

    @cached_property
    def poses(self) -> FloatArray:
        """Covariance of each pose, shape (p, 6, 6), for the steps of `RigidTransform.moved` [rad, m]."""
        return self._dense_blocks(np.arange(6 * self._layout.n_photos).reshape(-1, 6))

    @cached_property
    def intrinsics(self) -> FloatArray:
        """Joint covariance of the free intrinsics of all cameras, shape (k, k)."""
        columns = np.concatenate([np.zeros(0, np.intp), *self._layout.intrinsic_columns]).astype(np.intp)
        return np.asarray(self._dense_blocks(columns[None])[0])

    @cached_property
    def _unknown_dense(self) -> BoolArray:
        return np.asarray(np.abs(self.lost_movements[0]).max(axis=1, initial=0.0) > _UNKNOWN)

    @cached_property
    def lost_movements(self) -> tuple[FloatArray, FloatArray]:
        """Directions that nothing holds, under the datum: scaled dense part (g, k), targets (e, 3, k) [m]."""
        lost, layout = self._elimination.factor.lost, self._layout
        targets = np.zeros((layout.eliminated.size, 3, lost.shape[1]))
        for block in self._system.couplings(self._elimination):
            part = lost if block.rows is None else lost[block.rows]
            inner = (block.matrix.T @ part).reshape(block.last - block.first, 3, lost.shape[1])
            targets[block.first : block.last] = -self._elimination.roots[block.first : block.last] @ inner
        # A loose photo leaves the targets at rest under their datum, though not under any other.
        scale = self._system.dense_scale[:, None]
        dense, targets = self._system.under_datum(lost / scale, targets)
        return dense * scale, targets

    @cached_property
    def unknown_targets(self) -> BoolArray:
        """Targets that are not determined, shape (n,)."""
        layout = self._layout
        unknown = np.zeros(layout.slot.size, dtype=np.bool_)
        moved = np.abs(self.lost_movements[1] * self._system.target_scale[:, :, None]).max(axis=(1, 2), initial=0.0)
        unknown[layout.eliminated] = (self._elimination.lost_targets > 0) | (moved > _UNKNOWN)
        if layout.kept.size:
            unknown[layout.kept] = (
                self._unknown_dense[layout.n_global - 3 * layout.kept.size :].reshape(-1, 3).any(axis=1)
            )
        return unknown

    @cached_property
    def target_cofactors(self) -> tuple[FloatArray, FloatArray]:
        """Inverse of the normal matrix under any datum: dense part with targets (g, n, 3), targets (n, 3, 3).

        What image points and constraints see of it does not depend on the datum.
        """
        layout, factor, scale = self._layout, self._elimination.factor, self._system.dense_scale
        crossed = np.zeros((layout.n_global, layout.slot.size, 3))
        own = np.zeros((layout.slot.size, 3, 3))
        crossed[:, layout.eliminated] = (
            factor.back(self._halves).reshape(layout.n_global, layout.eliminated.size, 3) / scale[:, None, None]
        )
        own[layout.eliminated] = self._target_cofactors
        if layout.kept.size:
            columns = layout.kept_column[layout.kept][:, None] + np.arange(3)
            halves = factor.back(self._dense_halves(columns.ravel())) / scale[:, None]
            crossed[:, layout.kept] = halves.reshape(layout.n_global, *columns.shape)
            own[layout.kept] = self.dense_cofactors(columns)
        return crossed, own

    def joint(
        self, targets: Sequence[int] | IntArray = (), photos: Sequence[int] | IntArray = (), *, intrinsics: bool = False
    ) -> FloatArray:
        """Return the joint covariance of chosen targets, poses and all free intrinsics, in this order.

        targets: Places of targets, none of them fixed.
        Returns (k, k): Three rows for each target, six for each photo, then the intrinsics; NaN where not
            determined.
        """
        layout = self._layout
        chosen, places = np.asarray(targets, dtype=np.intp), np.asarray(photos, dtype=np.intp)
        slots = layout.slot[chosen]
        columns = [(6 * places[:, None] + np.arange(6)).ravel()]
        if intrinsics:
            columns += list(layout.intrinsic_columns)
        # Kept targets are unknowns of the dense part; -1 marks eliminated ones for now.
        target_columns = layout.kept_column[chosen][:, None] + np.arange(3)
        dense_columns = np.concatenate([np.zeros(0, np.intp), *columns]).astype(np.intp)
        in_dense = np.concatenate([np.repeat(slots < 0, 3), np.ones(dense_columns.size, dtype=np.bool_)])
        wanted = np.concatenate([target_columns[slots < 0].ravel(), dense_columns]).astype(np.intp)
        own = (3 * slots[slots >= 0][:, None] + np.arange(3)).ravel()

        def gathered(dense: FloatArray, inner: FloatArray) -> FloatArray:
            result = np.empty((in_dense.size, dense.shape[1]))
            result[in_dense], result[~in_dense] = (
                dense[wanted],
                inner.reshape(3 * layout.eliminated.size, dense.shape[1])[own],
            )
            return result

        raw = np.empty((in_dense.size, in_dense.size))
        scale = self._system.dense_scale[wanted]
        raw[np.ix_(in_dense, in_dense)] = self._elimination.factor.inverse(wanted) / scale[:, None] / scale
        if own.size:
            halves = self._halves[:, own]
            crossed = self._elimination.factor.back(halves)[wanted] / scale[:, None]
            raw[np.ix_(in_dense, ~in_dense)], raw[np.ix_(~in_dense, in_dense)] = crossed, crossed.T
            raw[np.ix_(~in_dense, ~in_dense)] = halves.T @ halves
            roots = self._elimination.roots[slots[slots >= 0]]
            at = np.nonzero(~in_dense)[0].reshape(-1, 3)
            raw[at[:, :, None], at[:, None, :]] += roots @ np.swapaxes(roots, 1, 2)
        movements = gathered(self._system.dense_movements, self._target_movements)
        carried = gathered(*self._carried[:2])
        under = self._under_datum(raw[None], movements[None], carried[None])
        known = gathered(*self._known)[None] if self._corrects else None
        covariance = self._scaled(under, known)[0]
        held = np.concatenate([np.zeros(3 * chosen.size, dtype=np.bool_), self._held[dense_columns]])
        _hold(covariance[None], held[None])
        lost = np.concatenate([np.repeat(self.unknown_targets[chosen], 3), self._unknown_dense[dense_columns]])
        covariance[lost, :] = np.nan
        covariance[:, lost] = np.nan
        return np.asarray(covariance)


def _hold(blocks: FloatArray, held: BoolArray) -> None:
    """Clear rows and columns of blocks, shape (b, k, k), that are held, shape (b, k), in place."""
    blocks[held] = 0.0
    np.swapaxes(blocks, 1, 2)[held] = 0.0
