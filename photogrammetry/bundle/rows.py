"""Residuals of a bundle adjustment and their derivatives, component by component over all image points at once."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from heliogauge.adjust.robust_loss import Loss, Squares
from heliogauge.camera.model import Camera
from heliogauge.validate import FloatArray, IntArray
from photogrammetry.bundle.datum import free_movements, moved_as_a_whole, similarity_movements
from photogrammetry.bundle.problem import BundleProblem, CameraModel, Layout, ResidualSpace, layout_of
from photogrammetry.bundle.rays import Rays, run_starts, runs
from photogrammetry.bundle.state import (
    BundleState,
    camera_with_intrinsics,
    d_parameters_d_intrinsics,
    intrinsics_of,
    turned,
)

#: With fewer image points for each photo all photos are worked on at once, with more one after the other.
_FEW_POINTS = 64


@dataclass(frozen=True, slots=True, eq=False)
class ExtraRows:
    """Whitened residuals and derivatives of what is known besides image points, at one state.

    residuals: For each constraint, shape (r,).
    jacobians: Shape (r, k, 3) each.
    targets: Targets of each constraint, shape (k,).
    prior_residuals (q,): Residuals of the priors on intrinsics.
    prior_jacobian (q, n_intrinsics): Their derivatives by all free intrinsics.
    """

    residuals: tuple[FloatArray, ...]
    jacobians: tuple[FloatArray, ...]
    targets: tuple[IntArray, ...]
    prior_residuals: FloatArray
    prior_jacobian: FloatArray

    @property
    def all_residuals(self) -> FloatArray:
        """All of them, shape (k,)."""
        return np.concatenate([*self.residuals, self.prior_residuals])


@dataclass(frozen=True, slots=True, eq=False)
class CameraRows:
    """Whitened image residuals of one camera with their derivatives; image points run along the last axis.

    jacobian (2, 6 + k + 1 + 3, m): Columns: pose step, k free intrinsics, the residual itself, target. One array,
        so that the products of one photo are one matrix product.
    photos, targets (m,): Photo and target of each image point; photos ascend.
    starts (q + 1,): Where the image points of each photo begin.
    """

    camera: int
    jacobian: FloatArray
    photos: IntArray
    targets: IntArray
    starts: IntArray

    @property
    def n_free(self) -> int:
        """Number of free intrinsics."""
        return int(self.jacobian.shape[1]) - 10

    @property
    def has_few_points(self) -> bool:
        """Whether photos have so few image points that work photo by photo would be mostly overhead."""
        return has_few_points(self.starts)

    @property
    def residuals(self) -> FloatArray:
        """Whitened residuals, shape (2, m)."""
        return self.jacobian[:, 6 + self.n_free]

    @property
    def target_columns(self) -> FloatArray:
        """Derivatives by the target, shape (2, 3, m)."""
        return self.jacobian[:, 7 + self.n_free :]

    def scaled(self, root: FloatArray) -> "CameraRows":
        """Return the rows times roots of weights, shape (m,)."""
        return CameraRows(self.camera, self.jacobian * root, self.photos, self.targets, self.starts)


class BundleModel:
    """A problem made ready: image points sorted by camera and photo, whitening, layout of the unknowns.

    start: The start; held intrinsics and fixed targets keep its values.
    """

    def __init__(self, problem: BundleProblem, start: BundleState, loss: Loss | None = None) -> None:
        self.problem = problem
        self.layout: Layout = layout_of(problem, start)
        self.loss: Loss = loss or Squares()
        self.plain: bool = isinstance(self.loss, Squares)
        table = problem.observations
        camera = problem.camera_index[table.photo_index]
        #: Rows of the observations in the order used here.
        self.order: IntArray = np.lexsort((table.target_index, table.photo_index, camera)).astype(np.intp)
        self.photo, self.target = table.photo_index[self.order], table.target_index[self.order]
        self.pixels = table.pixels_px[self.order]
        roots = np.linalg.cholesky(table.covariance_px2[self.order])
        #: Inverse of the lower Cholesky factor of each covariance: w0 = a r0, w1 = b r0 + c r1.
        self.whitening: FloatArray = np.stack(
            [1 / roots[:, 0, 0], -roots[:, 1, 0] / (roots[:, 0, 0] * roots[:, 1, 1]), 1 / roots[:, 1, 1]]
        )
        bounds = np.searchsorted(camera[self.order], np.arange(len(problem.cameras) + 1))
        self.camera_slices = [slice(int(a), int(b)) for a, b in pairwise(bounds.tolist())]
        self.starts = [run_starts(self.photo[part]) for part in self.camera_slices]
        self._fixed = problem.target_indices(problem.fixed)
        self.constraint_targets = problem.constraint_targets
        self.prior_jacobian, self._prior_values = self._priors(start)

    def _priors(self, start: BundleState) -> tuple[FloatArray, FloatArray]:
        rows, values = [], []
        first = 6 * self.layout.n_photos
        width = sum(len(columns) for columns in self.layout.intrinsic_columns)
        for model, columns, camera in zip(
            self.problem.cameras, self.layout.intrinsic_columns, start.cameras, strict=True
        ):
            for prior in model.priors:
                row = np.zeros(width)
                row[columns[model.free.index(prior.name)] - first] = 1 / prior.sigma
                rows.append(row)
                values.append(prior.value / prior.sigma)
            if model.prior_covariance is not None and model.free:
                block = np.zeros((len(model.free), width))
                root = _inverse_root(model.prior_covariance[np.ix_(model.columns, model.columns)])
                block[:, columns - first] = root
                rows.extend(block)
                known = intrinsics_of(camera) if model.prior_values is None else model.prior_values
                values.extend(root @ known[model.columns])
        return np.array(rows).reshape(len(rows), width), np.array(values, dtype=np.float64)

    @cached_property
    def rays(self) -> Rays:
        """The image points of eliminated targets, in the order used here."""
        slots = self.layout.slot[self.target]
        which = slots >= 0
        return Rays(self.photo[which], slots[which], self.layout.n_photos, int(self.layout.eliminated.size))

    def retract(self, state: BundleState, step: FloatArray) -> BundleState:
        """Move a state by a step in the order of the layout, shape (n,)."""
        layout = self.layout
        if self.problem.constraints:
            state, step = self._moved_as_a_whole(state, step)
        poses = step[: 6 * layout.n_photos].reshape(-1, 6)
        points = state.points_m.copy()
        points[layout.eliminated] += step[layout.n_global :].reshape(-1, 3)
        points[layout.kept] += step[layout.n_global - 3 * layout.kept.size : layout.n_global].reshape(-1, 3)
        cameras = []
        for model, columns, camera in zip(self.problem.cameras, layout.intrinsic_columns, state.cameras, strict=True):
            values = intrinsics_of(camera)
            values[model.columns] += step[columns]
            cameras.append(_camera_or_same(camera, values) if model.free else camera)
        return BundleState(
            tuple(cameras), turned(state.rotations, poses[:, :3]), state.translations_m + poses[:, 3:], points
        )

    def _moved_as_a_whole(self, state: BundleState, step: FloatArray) -> tuple[BundleState, FloatArray]:
        """Take the part of a step that moves the whole network exactly; return the state and the rest of the step.

        A constraint with a large sigma may ask for a turn by 0.1 rad that image points do not see at all. As a linear
        step it would spoil them in second order, and the descent would crawl along a curved valley.
        """
        layout = self.layout
        center = state.points_m[self._fixed].mean(axis=0) if self._fixed.size else state.points_m.mean(axis=0)
        movements = free_movements(similarity_movements(state, center), (), (), self._fixed)
        both = np.concatenate([layout.kept, layout.eliminated])
        first = layout.n_global - 3 * layout.kept.size
        columns = movements.points[both].reshape(3 * both.size, movements.count)
        amounts = np.linalg.lstsq(columns, step[first:], rcond=None)[0]
        rest = step.copy()
        rest[: 6 * layout.n_photos] -= (movements.poses @ amounts).ravel()
        rest[first:] -= columns @ amounts
        moved = moved_as_a_whole(state, movements.shares @ amounts, center)
        # Fixed targets stay to the last bit.
        moved.points_m[self._fixed] = state.points_m[self._fixed]
        return moved, rest

    def values(self, state: BundleState) -> FloatArray:
        """Write a state as numbers in the order of the layout, shape (n,); rotations count as 1 rad each."""
        layout = self.layout
        poses = np.concatenate([np.ones((layout.n_photos, 3)), state.translations_m], axis=1)
        intrinsics = [
            intrinsics_of(camera)[model.columns]
            for model, camera in zip(self.problem.cameras, state.cameras, strict=True)
        ]
        points = [state.points_m[layout.kept].ravel(), state.points_m[layout.eliminated].ravel()]
        return np.concatenate([poses.ravel(), *intrinsics, *points])

    def camera_rows(self, state: BundleState) -> tuple[CameraRows, ...]:
        """Evaluate all image points."""
        return tuple(self._rows_of_camera(state, index, model) for index, model in enumerate(self.problem.cameras))

    def _rows_of_camera(self, state: BundleState, index: int, model: CameraModel) -> CameraRows:
        part, starts = self.camera_slices[index], self.starts[index]
        photos, targets = self.photo[part], self.target[part]
        camera, n_free = state.cameras[index], len(model.free)
        arms = _rotated(state.rotations, state.points_m[targets].T, photos, starts)
        points = arms + state.translations_m[photos].T
        by_place = _measured_image if model.residual is ResidualSpace.MEASURED else _corrected_image
        residual, d_point, d_parameters = by_place(camera, self.pixels[part], points.T)
        free = d_parameters_d_intrinsics(camera)[:, model.columns]
        jacobian = np.empty((2, 10 + n_free, targets.size))
        d_point = np.ascontiguousarray(np.moveaxis(d_point, 0, -1))
        # A turn w moves the camera point by w x arm: the derivative of a row d is arm x d.
        for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            jacobian[:, a] = arms[b] * d_point[:, c] - arms[c] * d_point[:, b]
        jacobian[:, 3:6] = d_point
        if n_free:
            jacobian[:, 6 : 6 + n_free] = free.T @ np.moveaxis(d_parameters, 0, -1)
        jacobian[:, 6 + n_free] = residual.T
        if has_few_points(starts):
            jacobian[:, 7 + n_free :] = np.einsum("mij,rim->rjm", state.rotations[photos], d_point)
        else:
            for photo, first, last in runs(photos, starts):
                rows = slice(first, last)
                jacobian[:, 7 + n_free :, rows] = state.rotations[photo].T @ d_point[:, :, rows]
        whitening = self.whitening[:, part]
        jacobian[1] *= whitening[2]
        if whitening[1].any():
            jacobian[1] += jacobian[0] * whitening[1]
        jacobian[0] *= whitening[0]
        return CameraRows(index, jacobian, photos, targets, starts)

    def extra_rows(self, state: BundleState) -> ExtraRows:
        """Evaluate constraints and priors."""
        both = [
            one.rows(state.points_m[index])
            for one, index in zip(self.problem.constraints, self.constraint_targets, strict=True)
        ]
        intrinsics = [
            intrinsics_of(camera)[model.columns]
            for model, camera in zip(self.problem.cameras, state.cameras, strict=True)
        ]
        prior = self.prior_jacobian @ np.concatenate(intrinsics) - self._prior_values
        return ExtraRows(
            tuple(residuals for residuals, _ in both),
            tuple(jacobian for _, jacobian in both),
            self.constraint_targets,
            prior,
            self.prior_jacobian,
        )


class _ImageRows(NamedTuple):
    """Residuals of image points [px] with derivatives by the point and the camera's parameters."""

    residuals_px: FloatArray
    d_point: FloatArray
    d_parameters: FloatArray


def _measured_image(camera: Camera, pixels: FloatArray, points: FloatArray) -> _ImageRows:
    projected, d_point, d_parameters = camera.project_with_jacobians(points)
    return _ImageRows(projected - pixels, d_point, d_parameters)


def _corrected_image(camera: Camera, pixels: FloatArray, points: FloatArray) -> _ImageRows:
    """Ideal minus corrected image point, both in an image without lens and with square pixels [px].

    Its focal length is that of the rows in both directions: with the columns' own, sigma0 of DBAT's published
    calibration comes out as 0.161446 px and its aspect 0.2 % off; with one focal length every printed digit agrees.
    """
    focal, inverse = camera.focal_y_px, np.linalg.inv(camera.matrix[:2, :2])
    measured = (pixels - camera.matrix[:2, 2]) @ inverse.T
    corrected, d_measured, d_coefficients = camera.distortion.undistort_with_jacobians(measured)
    depth = np.where(points[:, 2] > 0, points[:, 2], np.nan)
    ideal = points[:, :2] / depth[:, None]
    d_point = np.zeros((len(points), 2, 3))
    d_point[:, 0, 0] = d_point[:, 1, 1] = focal / depth
    d_point[:, :, 2] = -focal * ideal / depth[:, None]
    own = np.zeros((len(points), 2, 5))
    own[:, 0, 0], own[:, 1, 1], own[:, 0, 4] = measured[:, 0], measured[:, 1], measured[:, 1]
    own[:, 0, 2] = own[:, 1, 3] = 1.0
    d_parameters = np.empty((len(points), 2, 10))
    d_parameters[:, :, :5] = focal * (d_measured @ inverse @ own)
    d_parameters[:, :, 1] += ideal - corrected
    d_parameters[:, :, 5:] = -focal * d_coefficients
    return _ImageRows(focal * (ideal - corrected), d_point, d_parameters)


def _camera_or_same(camera: Camera, values: FloatArray) -> Camera:
    """Move a camera; an impossible focal length stays impossible to see anything with, and the step is refused."""
    if not np.isfinite(values).all() or values[0] <= 0 or values[1] <= -1:
        values = np.where(np.arange(10) == 0, 1e-6, intrinsics_of(camera))
    return camera_with_intrinsics(camera, values)


def _inverse_root(covariance: FloatArray) -> FloatArray:
    """Return W with ``W^T W`` the inverse of a covariance whose units differ by many powers of ten."""
    scale = np.sqrt(np.diag(covariance))
    scale[scale == 0] = 1.0
    values, vectors = np.linalg.eigh(covariance / scale[:, None] / scale)
    # A held parameter of the earlier calibration has no variance: 1e-10 of its unit keeps it where it is.
    return np.asarray((vectors / np.sqrt(np.maximum(values, 1e-10))).T / scale)


def has_few_points(starts: IntArray) -> bool:
    """Return whether runs of image points, which begin and end at these places, are short on average."""
    return bool(0 < starts[-1] < _FEW_POINTS * (starts.size - 1))


def _rotated(rotations: FloatArray, points: FloatArray, photos: IntArray, starts: IntArray) -> FloatArray:
    """Turn points, shape (3, m), each by the rotation of its photo."""
    if has_few_points(starts):
        return np.asarray(np.einsum("mij,jm->im", rotations[photos], points))
    result = np.empty_like(points)
    for photo, first, last in runs(photos, starts):
        result[:, first:last] = rotations[photo] @ points[:, first:last]
    return result
