"""Coupling of eliminated targets with poses and intrinsics: ray by ray, multiplied by pairs or as a matrix."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from heliogauge.validate import FloatArray, IntArray
from photogrammetry.bundle.factor import Factor
from photogrammetry.bundle.problem import Layout
from photogrammetry.bundle.rays import Rays
from photogrammetry.bundle.rows import CameraRows

#: The whole matrix is formed for so many targets at once that it takes this much, or as much as its product [bytes].
_CHUNK_BYTES = 3.2e7
#: Costs on one core with AVX-512 [s]: a pair of rays, a pair of photos, an element of the whole matrix, and an element
#: times an unknown. With 115 photos that each show a tenth of 10 000 targets pairs take a third of the time; with 400
#: targets that half of the photos show the whole matrix does.
_PAIR_S, _PHOTO_PAIR_S, _ELEMENT_S, _PRODUCT_S = 3.0e-7, 4e-6, 4e-9, 2.5e-11


class SolvedRays(NamedTuple):
    """``S^-1 A`` where each ray has its own unknowns, S the reduced matrix of the dense part.

    poses (r, 3, 6): Rows of the pose of each ray.
    intrinsics (e, 3, q): Rows of all intrinsics for each target.
    """

    poses: FloatArray
    intrinsics: FloatArray


class Coupling:
    """Coupling A of the eliminated targets with the dense part, shape (g, 3 e), in scaled coordinates.

    Each target's columns are multiplied by the inverse root of its own normal matrix. Of A only what is not zero is
    kept: the pose of each ray, and all intrinsics.

    rays: The image points of the eliminated targets.
    poses (r, 3, 6): Rows of the pose of each ray.
    intrinsics (e, 3, q): Rows of all intrinsics.
    n_global: Unknowns of the dense part: poses, intrinsics, then such that no eliminated target touches.
    """

    def __init__(self, rays: Rays, poses: FloatArray, intrinsics: FloatArray, n_global: int) -> None:
        self.rays, self._poses, self._intrinsics = rays, poses, intrinsics
        self._n_global = n_global
        first = 6 * rays.n_photos
        self._own = slice(first, first + intrinsics.shape[2])
        photo_pairs = min(rays.n_pairs, rays.n_photos * (rays.n_photos + 1) // 2)
        elements = 3.0 * n_global * rays.n_targets
        #: Whether few targets are seen by many photos, so that pairs of rays are cheaper than the whole matrix.
        self.by_pairs: bool = rays.n_pairs * _PAIR_S + photo_pairs * _PHOTO_PAIR_S < elements * (
            _ELEMENT_S + n_global * _PRODUCT_S
        )

    @property
    def _flat_intrinsics(self) -> FloatArray:
        return self._intrinsics.reshape(3 * self.rays.n_targets, self._intrinsics.shape[2])

    def times(self, right: FloatArray) -> FloatArray:
        """Return ``A b``, shape (e, 3, k) to (g, k)."""
        result = np.zeros((self._n_global, right.shape[2]))
        for photo, first, last in self.rays.runs:
            own = right[self.rays.slots[first:last]].reshape(3 * (last - first), right.shape[2])
            result[6 * photo : 6 * photo + 6] += self._poses[first:last].reshape(-1, 6).T @ own
        result[self._own] = self._flat_intrinsics.T @ right.reshape(3 * self.rays.n_targets, right.shape[2])
        return result

    def turned_times(self, left: FloatArray) -> FloatArray:
        """Return ``A^T b``, shape (g, k) to (e, 3, k)."""
        width = left.shape[1]
        result = (self._flat_intrinsics @ left[self._own]).reshape(self.rays.n_targets, 3, width)
        for photo, first, last in self.rays.runs:
            own = self._poses[first:last].reshape(-1, 6) @ left[6 * photo : 6 * photo + 6]
            result[self.rays.slots[first:last]] += own.reshape(last - first, 3, width)
        return result

    def columns(self, slots: IntArray) -> FloatArray:
        """Return the columns of some targets written out, shape (g, 3 k)."""
        place = np.full(self.rays.n_targets, -1, dtype=np.intp)
        place[slots] = np.arange(slots.size)
        which = np.nonzero(place[self.rays.slots] >= 0)[0]
        turned = np.zeros((slots.size, 3, self._n_global))
        self._write(turned, which, place[self.rays.slots[which]])
        turned[:, :, self._own] = self._intrinsics[slots]
        return turned.reshape(3 * slots.size, self._n_global).T

    def _write(self, turned: FloatArray, which: IntArray, place: IntArray) -> None:
        """Write the rows of poses of some rays into columns of targets, shape (k, 3, g)."""
        n_photos = self.rays.n_photos
        poses = turned[:, :, : 6 * n_photos].reshape(len(turned), 3, n_photos, 6)
        poses[place, :, self.rays.photos[which]] = self._poses[which]

    def _chunks(self) -> Iterator["_Chunk"]:
        """Yield the columns of some targets after the other, transposed; the array is written over by the next."""
        count = self.rays.n_targets
        size = max(_CHUNK_BYTES, 8.0 * self._n_global**2)
        at_once = min(count, max(1, int(size / (24.0 * max(self._n_global, 1)))))
        order = np.argsort(self.rays.slots, kind="stable")
        bounds = np.concatenate([[0], np.cumsum(self.rays.counts)])
        buffer = np.empty((at_once, 3, self._n_global))
        for first in range(0, count, max(at_once, 1)):
            last = min(first + at_once, count)
            which = order[bounds[first] : bounds[last]]
            turned = buffer[: last - first]
            turned[:] = 0.0
            self._write(turned, which, self.rays.slots[which] - first)
            turned[:, :, self._own] = self._intrinsics[first:last]
            yield _Chunk(first, last, which, turned.reshape(-1, self._n_global))

    def gram(self) -> FloatArray:
        """Return ``A A^T``, shape (g, g)."""
        if not self.by_pairs:
            result = np.zeros((self._n_global, self._n_global))
            for chunk in self._chunks():
                result += chunk.turned.T @ chunk.turned
            return result
        rays, pairs, flat = self.rays, self.rays.pairs, self._poses.reshape(-1, 18)
        result = np.zeros((self._n_global, self._n_global))
        for group in pairs.by_photo:
            begin, end = group[0].first, group[-1].last
            own, beside = flat[pairs.first[begin:end]].reshape(-1, 6), flat[pairs.second[begin:end]].reshape(-1, 6)
            for photo, other, first, last in group:
                part = slice(3 * (first - begin), 3 * (last - begin))
                block = own[part].T @ beside[part]
                rows, columns = slice(6 * photo, 6 * photo + 6), slice(6 * other, 6 * other + 6)
                result[rows, columns] += block
                if photo != other:
                    result[columns, rows] += block.T
        for photo, first, last in rays.runs:
            seen = self._intrinsics[rays.slots[first:last]].reshape(3 * (last - first), self._intrinsics.shape[2])
            block = self._poses[first:last].reshape(-1, 6).T @ seen
            result[6 * photo : 6 * photo + 6, self._own] = block
            result[self._own, 6 * photo : 6 * photo + 6] = block.T
        result[self._own, self._own] = self._flat_intrinsics.T @ self._flat_intrinsics
        return result

    def inner(self, factor: Factor) -> FloatArray:
        """Return ``A^T S^-1 A`` of each target with itself, shape (e, 3, 3), from the whole matrix.

        factor: Factor of S.
        """
        result = np.empty((self.rays.n_targets, 3, 3))
        for chunk in self._chunks():
            half = factor.half(chunk.turned.T)
            half = half.reshape(len(half), chunk.last - chunk.first, 3)
            for i in range(3):
                for j in range(i + 1):
                    products = np.einsum("ge,ge->e", half[:, :, i], half[:, :, j])
                    result[chunk.first : chunk.last, i, j] = result[chunk.first : chunk.last, j, i] = products
        return result

    def inner_of(self, solved: SolvedRays) -> FloatArray:
        """Return the same from ``S^-1 A`` where each ray has its own unknowns."""
        result = self._intrinsics @ np.swapaxes(solved.intrinsics, 1, 2)
        own = self._poses @ np.swapaxes(solved.poses, 1, 2)
        for _, first, last in self.rays.runs:
            result[self.rays.slots[first:last]] += own[first:last]
        return np.asarray(0.5 * (result + np.swapaxes(result, 1, 2)))

    def solved(self, factor: Factor) -> SolvedRays:
        """Return ``S^-1 A`` where each ray has its own unknowns.

        factor: Factor of S.
        """
        return self._solved_by_pairs(factor) if self.by_pairs else self._solved_whole(factor)

    def _solved_whole(self, factor: Factor) -> SolvedRays:
        rays = self.rays
        solved = SolvedRays(np.empty_like(self._poses), np.empty_like(self._intrinsics))
        for chunk in self._chunks():
            turned = factor.solve(chunk.turned.T).T.reshape(-1, 3, self._n_global)
            poses = turned[:, :, : 6 * rays.n_photos].reshape(len(turned), 3, rays.n_photos, 6)
            solved.poses[chunk.rays] = poses[rays.slots[chunk.rays] - chunk.first, :, rays.photos[chunk.rays]]
            solved.intrinsics[chunk.first : chunk.last] = turned[:, :, self._own]
        return solved

    def _solved_by_pairs(self, factor: Factor) -> SolvedRays:
        rays, pairs, flat = self.rays, self.rays.pairs, self._poses.reshape(-1, 18)
        inverse = factor.whole_inverse
        poses = np.zeros_like(flat)
        for group in pairs.by_photo:
            begin, end = group[0].first, group[-1].last
            here, there = pairs.first[begin:end], pairs.second[begin:end]
            own, beside = flat[here].reshape(-1, 6), flat[there].reshape(-1, 6)
            for photo, other, first, last in group:
                part, chosen = slice(3 * (first - begin), 3 * (last - begin)), slice(first - begin, last - begin)
                block = inverse[6 * other : 6 * other + 6, 6 * photo : 6 * photo + 6]
                poses[here[chosen]] += (beside[part] @ block).reshape(-1, 18)
                if photo != other:
                    poses[there[chosen]] += (own[part] @ block.T).reshape(-1, 18)
        solved = poses.reshape(-1, 3, 6)
        for photo, first, last in rays.runs:
            seen = self._intrinsics[rays.slots[first:last]]
            solved[first:last] += seen @ inverse[self._own, 6 * photo : 6 * photo + 6]
        return SolvedRays(solved, self.turned_times(inverse[:, self._own]))


class _Chunk(NamedTuple):
    """Columns of the targets from the first up to the last, transposed, shape (3 k, g), and their rays."""

    first: int
    last: int
    rays: IntArray
    turned: FloatArray


def couple(layout: Layout, rays: Rays, rows: tuple[CameraRows, ...], roots: FloatArray, scale: FloatArray) -> Coupling:
    """Multiply poses and intrinsics with the eliminated targets.

    rays: The image points of eliminated targets, camera by camera.
    rows: Whitened, weighted image residuals, all of them.
    roots (e, 3, 3): Inverse root of each target's own normal matrix.
    scale (g,): Column scale of the dense part.
    """
    first = 6 * layout.n_photos
    count = int(layout.eliminated.size)
    poses = np.empty((rays.slots.size, 3, 6))
    intrinsics = np.zeros((count, 3, sum(columns.size for columns in layout.intrinsic_columns)))
    begin = 0
    for one in rows:
        which = np.nonzero(layout.slot[one.targets] >= 0)[0]
        own = one.jacobian if which.size == one.targets.size else one.jacobian[:, :, which]
        part = slice(begin, begin + which.size)
        begin = part.stop
        photos, slots = rays.photos[part], rays.slots[part]
        d_target = _times_roots(own[:, 7 + one.n_free :], roots, slots)
        d_pose = own[:, :6] / scale[:first].reshape(-1, 6)[photos].T
        blocks = d_pose[0] * d_target[0, :, None] + d_pose[1] * d_target[1, :, None]
        poses[part] = np.moveaxis(blocks, -1, 0)
        for column, place in enumerate(layout.intrinsic_columns[one.camera].tolist()):
            both = (own[0, 6 + column] * d_target[0] + own[1, 6 + column] * d_target[1]) / scale[place]
            for axis in range(3):
                intrinsics[:, axis, place - first] += np.bincount(slots, weights=both[axis], minlength=count)
    return Coupling(rays, poses, intrinsics, layout.n_global)


def _times_roots(d_target: FloatArray, roots: FloatArray, slot: IntArray) -> FloatArray:
    """Multiply derivatives by targets, shape (2, 3, m), by the roots of their targets."""
    own = np.ascontiguousarray(roots.reshape(-1, 9)[slot].T).reshape(3, 3, -1)
    return np.asarray(d_target[:, 0, None] * own[0] + d_target[:, 1, None] * own[1] + d_target[:, 2, None] * own[2])
