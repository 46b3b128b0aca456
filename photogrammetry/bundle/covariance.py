"""Joint covariance of points, poses and intrinsics of a bundle adjustment, block by block, under any datum."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from heliogauge.validate import BoolArray, FloatArray, IntArray
from photogrammetry.bundle.coupling import SolvedRays
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


class _Half(NamedTuple):
    """Half of the inverse of the normal matrix times something: dense part (g, k) and targets (e, 3, k)."""

    dense: FloatArray
    targets: FloatArray


class SharedErrors(NamedTuple):
    """Independent errors that targets and poses share, one sigma each, and what each target has beside them.

    targets (k, n, 3): What each error does to the targets [m].
    photos (k, p, 6): What it does to the poses, as steps of `RigidTransform.moved` [rad, m].
    own (n, 3, 3): Covariance that is each target's alone [m^2].
    """

    targets: FloatArray
    photos: FloatArray
    own: FloatArray


class ImagePointCofactors(NamedTuple):
    """Inverse of the normal matrix as the image points of one camera see it.

    photos (f, 6 + k, 6 + k): Pose and free intrinsics of each of its photos, in their order.
    crossed (m, 3, 6 + k): Target of each image point with pose and intrinsics.
    targets (n, 3, 3): Each target.
    """

    photos: FloatArray
    crossed: FloatArray
    targets: FloatArray


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
    def _solved_rays(self) -> SolvedRays:
        """Inverse of the reduced matrix times the coupling, where each ray has its own unknowns; scaled."""
        return self._elimination.coupling.solved(self._elimination.factor)

    def _half(self, dense: FloatArray, targets: FloatArray) -> "_Half":
        """Return half of the inverse of the normal matrix times a right-hand side, shapes (g, k) and (e, 3, k)."""
        roots, coupling = self._elimination.roots, self._elimination.coupling
        own = np.swapaxes(roots, 1, 2) @ targets
        reduced = dense / self._system.dense_scale[:, None] - coupling.times(own)
        return _Half(self._elimination.factor.half(reduced), own)

    def _back(self, half: "_Half") -> tuple[FloatArray, FloatArray]:
        """Return the inverse of the normal matrix times what `_half` was given, shapes (g, k) and (e, 3, k)."""
        dense = self._elimination.factor.back(half.dense)
        targets = self._elimination.roots @ (half.targets - self._elimination.coupling.turned_times(dense))
        return dense / self._system.dense_scale[:, None], targets

    @cached_property
    def _carried(self) -> "_Carried":
        """``Q G M^T``, dense part (g, d) and targets (e, 3, d), and ``M G^T Q G M^T``, (d, d); ``M = (G^T K)^-1``."""
        layout, system = self._layout, self._system
        if not system.movements.count:
            return _Carried(np.zeros((layout.n_global, 0)), np.zeros((layout.eliminated.size, 3, 0)), np.zeros((0, 0)))
        inverse = np.linalg.inv(system.overlap)
        half = self._half(self._datum_dense, self._datum_targets)
        dense, targets = self._back(half)
        core = half.dense.T @ half.dense + np.einsum("eid,eif->df", half.targets, half.targets)
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
        solved_dense, solved = self._back(self._half(dense, targets))
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
        roots, coupling = self._elimination.roots, self._elimination.coupling
        # What image points need is at hand where pairs of rays are cheap; halves are where the whole matrix is.
        by_rays = coupling.by_pairs or "_solved_rays" in self.__dict__
        inner = coupling.inner_of(self._solved_rays) if by_rays else coupling.inner(self._elimination.factor)
        return np.asarray(roots @ (np.eye(3) + inner) @ np.swapaxes(roots, 1, 2))

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
        lost = self._elimination.factor.lost
        targets = -self._elimination.roots @ self._elimination.coupling.turned_times(lost)
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

    def image_point_cofactors(self, camera: int) -> "ImagePointCofactors":
        """Return what image points of one camera see of the inverse of the normal matrix under any datum.

        What image points and constraints see of it does not depend on the datum.
        """
        layout, rows, scale = self._layout, self._system.rows[camera], self._system.dense_scale
        columns = layout.intrinsic_columns[camera]
        photos = rows.photos[rows.starts[:-1]] if rows.photos.size else rows.photos
        intrinsics = np.broadcast_to(columns, (photos.size, columns.size))
        places = np.concatenate([6 * photos[:, None] + np.arange(6), intrinsics], axis=1)
        slots = layout.slot[rows.targets]
        crossed = np.zeros((slots.size, 3, 6 + columns.size))
        inside = np.nonzero(slots >= 0)[0]
        before = sum(int((layout.slot[one.targets] >= 0).sum()) for one in self._system.rows[:camera])
        solved, roots = self._solved_rays, self._elimination.roots[slots[inside]]
        own = (6 * rows.photos[inside][:, None] + np.arange(6))[:, None]
        crossed[inside, :, :6] = -roots @ solved.poses[before : before + inside.size] / scale[own]
        of_targets = self._elimination.roots @ solved.intrinsics[:, :, columns - 6 * layout.n_photos] / scale[columns]
        crossed[inside, :, 6:] = -of_targets[slots[inside]]
        targets = np.zeros((layout.slot.size, 3, 3))
        targets[layout.eliminated] = self._target_cofactors
        if layout.kept.size:
            targets[layout.kept] = self.dense_cofactors(layout.kept_column[layout.kept][:, None] + np.arange(3))
            kept = np.nonzero(layout.kept_column[rows.targets] >= 0)[0]
            own_photo = np.repeat(np.arange(photos.size), np.diff(rows.starts))
            at_target = layout.kept_column[rows.targets][:, None] + np.arange(3)
            # Some at once: of each block of all unknowns of an image point only a corner is wanted.
            for part in np.array_split(kept, 1 + kept.size // 4096):
                both = self.dense_cofactors(np.concatenate([at_target[part], places[own_photo[part]]], axis=1))
                crossed[part] = both[:, :3, 3:]
        return ImagePointCofactors(self.dense_cofactors(places), crossed, targets)

    def shared_errors(
        self, targets: Sequence[int] | IntArray, photos: Sequence[int] | IntArray, *, under_datum: bool
    ) -> SharedErrors:
        """Return the joint covariance of many targets and poses without forming it.

        targets, photos: Places of determined targets, none of them fixed, and of photos.
        under_datum: Under the datum of the result, where the share of the datum in what is a target's own is left out
            (a target's own sigma over the root of their number). Otherwise exact, in a frame of its own: right for
            whatever does not depend on position and rotation of the network.

        A target that is eliminated has ``roots (w - coupling^T d)`` with the error d of the dense part, of which
        ``F^T`` has the columns, and a w of its own.
        """
        factor, layout = self._elimination.factor, self._layout
        halves = factor.half(np.zeros((layout.n_global, 1))).shape[0]
        dense = factor.back(np.eye(halves))
        moved = -self._elimination.roots @ self._elimination.coupling.turned_times(dense)
        dense = dense / self._system.dense_scale[:, None]
        if under_datum:
            dense, moved = self._system.under_datum(dense, moved)
        chosen, places = np.asarray(targets, dtype=np.intp), np.asarray(photos, dtype=np.intp)
        slots, kept = layout.slot[chosen], layout.kept_column[chosen]
        result = np.zeros((chosen.size, 3, halves))
        own = np.zeros((chosen.size, 3, 3))
        inside = slots >= 0
        roots = self._elimination.roots[slots[inside]]
        result[inside] = moved[slots[inside]]
        own[inside] = roots @ np.swapaxes(roots, 1, 2)
        result[kept >= 0] = dense[kept[kept >= 0][:, None] + np.arange(3)]
        poses = dense[6 * places[:, None] + np.arange(6)]
        share = self._factors.share
        scale = np.sqrt(share)
        return SharedErrors(scale * np.moveaxis(result, 2, 0), scale * np.moveaxis(poses, 2, 0), share * own)

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
            roots = self._elimination.roots[slots[slots >= 0]]
            halves = self._elimination.factor.half(self._elimination.coupling.columns(slots[slots >= 0]))
            turned = np.swapaxes(roots, 1, 2)
            halves = -np.einsum("gei,eij->gej", halves.reshape(len(halves), len(roots), 3), turned).reshape(
                halves.shape
            )
            crossed = self._elimination.factor.back(halves)[wanted] / scale[:, None]
            raw[np.ix_(in_dense, ~in_dense)], raw[np.ix_(~in_dense, in_dense)] = crossed, crossed.T
            raw[np.ix_(~in_dense, ~in_dense)] = halves.T @ halves
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
