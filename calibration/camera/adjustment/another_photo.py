"""What an adjustment says about the image points of a photo outside it, and what such a photo would add to it."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from calibration.camera.adjustment.mixed_adjustment import MixedAdjustment, photo_columns
from calibration.camera.corners.detection import BoardPoints
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import FloatArray
from photogrammetry import ImagePoints
from photogrammetry.bundle import BundleState

#: Photos that are predicted together: what is the same for all is formed once.
_AT_ONCE = 32


@dataclass(frozen=True, eq=False)
class AnotherPhoto:
    """Image points of a photo outside an adjustment, as it predicts them where the photo's pose is known.

    predicted_px (n, 2): Their places [px].
    covariance_px2 (2 n, 2 n): Of their measured places about these: camera, board, the photo's own errors, noise.
    with_intrinsics (c, 2 n): Covariance of the free intrinsics with them.
    d_pose (2 n, 6): Derivatives by the pose's steps.
    """

    predicted_px: FloatArray
    covariance_px2: FloatArray
    with_intrinsics: FloatArray
    d_pose: FloatArray

    @property
    def expected_rms_px(self) -> float:
        """RMS length of the residuals that the photo should have when its pose alone is fitted [px]."""
        basis = np.linalg.qr(self.d_pose)[0]
        left = np.trace(self.covariance_px2) - np.trace(basis.T @ self.covariance_px2 @ basis)
        return float(np.sqrt(left / len(self.predicted_px)))

    @cached_property
    def _free(self) -> FloatArray:
        """What no pose explains: an orthonormal basis, shape (2 n, 2 n - 6)."""
        return np.asarray(np.linalg.qr(self.d_pose, mode="complete")[0][:, 6:])

    @cached_property
    def _root(self) -> FloatArray:
        """Root of the covariance of that, shape (2 n - 6, 2 n - 6) [px]."""
        return np.asarray(np.linalg.cholesky(self._free.T @ self.covariance_px2 @ self._free))

    @cached_property
    def gain(self) -> FloatArray:
        """By how much the covariance of the free intrinsics shrinks if the photo is taken, shape (c, c).

        Its pose is unknown: only what no pose explains counts. Sizes of random effects are held.
        """
        return np.asarray(_gains(self.covariance_px2[None], self.with_intrinsics[None], self.d_pose[None])[0])

    def drawn_px(self, rng: np.random.Generator) -> FloatArray:
        """Draw points as they may be measured, with the pose that fits them, shape (n, 2) [px]."""
        off = self._free @ (self._root @ rng.standard_normal(len(self._root)))
        return self.predicted_px + off.reshape(-1, 2)


def predict_photo(mixed: MixedAdjustment, points: BoardPoints, pose: RigidTransform) -> AnotherPhoto:
    """Predict the image points of a photo.

    mixed: Camera and board from other photos.
    points: The photo's points; those the others do not see are left out. Their covariances count, not their places.
    pose: Its ``cam_from_board``.
    """
    return AnotherPhoto(*(part[0] for part in _predicted(mixed, points, [pose])))


def gains_of_photos(mixed: MixedAdjustment, points: BoardPoints, poses: Sequence[RigidTransform]) -> FloatArray:
    """Return `AnotherPhoto.gain` of photos of the same points from several poses, shape (p, c, c)."""
    parts = [poses[start : start + _AT_ONCE] for start in range(0, len(poses), _AT_ONCE)]
    return np.concatenate([_gains(*_predicted(mixed, points, part)[1:]) for part in parts])


def _gains(covariance_px2: FloatArray, with_intrinsics: FloatArray, d_pose: FloatArray) -> FloatArray:
    """Return by how much the intrinsics' covariance shrinks by what no pose explains, of each photo, shape (p, c, c).

    With the points' covariance S, that with the intrinsics W and the derivatives D by the pose:
    ``W S^-1 W' - W S^-1 D (D' S^-1 D)^-1 D' S^-1 W'``.
    """
    solved = np.linalg.solve(covariance_px2, np.concatenate([with_intrinsics.swapaxes(1, 2), d_pose], axis=2))
    size = with_intrinsics.shape[1]
    by_pose = d_pose.swapaxes(1, 2) @ solved
    explained = by_pose[:, :, :size].swapaxes(1, 2) @ np.linalg.solve(by_pose[:, :, size:], by_pose[:, :, :size])
    gain = with_intrinsics @ solved[:, :, :size] - explained
    return np.asarray(0.5 * (gain + gain.swapaxes(1, 2)))


class _Predicted(NamedTuple):
    """What `AnotherPhoto` holds, of several photos of the same points: the first axis is theirs."""

    predicted_px: FloatArray
    covariance_px2: FloatArray
    with_intrinsics: FloatArray
    d_pose: FloatArray


def _predicted(mixed: MixedAdjustment, points: BoardPoints, poses: Sequence[RigidTransform]) -> _Predicted:
    """Predict the image points of photos."""
    network, linear = mixed.network, mixed.linear
    _, own, place = np.intersect1d(points.index, network.seen, return_indices=True)
    names, n, n_photos = network.board.names, own.size, len(poses)
    table = ImagePoints(
        tuple(f"{points.photo} {k}" for k in range(n_photos)),
        tuple(names[i] for i in points.index[own]),
        np.repeat(np.arange(n_photos), n),
        np.tile(np.arange(n), n_photos),
        np.tile(points.pixels_px[own], (n_photos, 1)),
        np.tile(points.covariance_px2[own], (n_photos, 1, 1)),
    )
    alone = BundleState.from_poses([mixed.state.cameras[0]], poses, mixed.state.points_m[place])
    photo = photo_columns(network, table, alone, network.board.points_m[network.seen], place, linear.unit_m)
    count, size = 2 * n, photo.d_intrinsics.shape[2]
    every, d_point = np.arange(n), photo.d_point.reshape(n_photos, n, 2, 3)
    coordinates = (3 * place[:, None] + np.arange(3)).ravel()
    joint = mixed.joint_points[np.ix_(coordinates, coordinates)].reshape(n, 3, 3 * n)
    moved = (d_point @ joint).reshape(n_photos, count, n, 3)
    blocks = np.einsum("pikc,pkbc->pikb", moved, d_point, optimize=True).reshape(n_photos, n, 2, n, 2)
    median = float(np.median(mixed.sizes.components.noise))
    blocks[:, every, :, every] += photo.noise_px2.reshape(n_photos, n, 2, 2).swapaxes(0, 1) * median**2
    covariance = np.asarray(blocks.reshape(n_photos, count, count), dtype=np.float64)
    for name, columns in photo.effects:
        part = columns.reshape(n_photos, count, -1)
        sigma = mixed.sizes.components.effects[mixed.sizes.names.index(name)]
        covariance += sigma**2 * part @ part.swapaxes(1, 2)
    lens = photo.d_intrinsics.reshape(n_photos, count, size)
    of_points = mixed.points_with_unknowns[coordinates, :size].reshape(n, 3, size)
    with_points = (d_point @ of_points).reshape(n_photos, count, size)
    own_covariance = mixed.posterior.covariance[:size, :size]
    crossed = lens @ with_points.swapaxes(1, 2)
    covariance += crossed + crossed.swapaxes(1, 2) + lens @ own_covariance @ lens.swapaxes(1, 2)
    with_intrinsics = (lens @ own_covariance + with_points).swapaxes(1, 2)
    predicted = photo.predicted_px.reshape(n_photos, n, 2)
    return _Predicted(predicted, covariance, with_intrinsics, photo.d_pose.reshape(n_photos, count, 6))
