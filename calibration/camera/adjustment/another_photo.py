"""What an adjustment says about the image points of a photo outside it, and what such a photo would add to it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calibration.camera.adjustment.mixed_adjustment import MixedAdjustment, photo_columns
from calibration.camera.corners.detection import BoardPoints
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import FloatArray
from photogrammetry import ImagePoints
from photogrammetry.bundle import BundleState


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
        seen = np.linalg.solve(self._root, self._free.T @ self.with_intrinsics.T)
        return np.asarray(seen.T @ seen)

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
    network, linear = mixed.network, mixed.linear
    _, own, place = np.intersect1d(points.index, network.seen, return_indices=True)
    names = network.board.names
    table = ImagePoints(
        (points.photo,),
        tuple(names[i] for i in points.index[own]),
        np.zeros(own.size, dtype=np.intp),
        np.arange(own.size),
        points.pixels_px[own],
        points.covariance_px2[own],
    )
    alone = BundleState.from_poses([mixed.state.cameras[0]], [pose], mixed.state.points_m[place])
    photo = photo_columns(network, table, alone, network.board.points_m[network.seen], place, linear.unit_m)
    count, size = 2 * own.size, photo.d_intrinsics.shape[2]
    covariance = np.zeros((own.size, 2, own.size, 2))
    every = np.arange(own.size)
    covariance[every, :, every, :] = photo.noise_px2 * float(np.median(mixed.sizes.components.noise)) ** 2
    joint = mixed.joint_points.reshape(len(network.seen), 3, len(network.seen), 3)
    joint = joint[place][:, :, place]
    moved = np.einsum("nia,nakb->nikb", photo.d_point, joint, optimize=True)
    covariance += np.einsum("nikb,kjb->nikj", moved, photo.d_point, optimize=True)
    flat = covariance.reshape(count, count)
    for name, columns in photo.effects:
        part = columns.reshape(count, -1)
        flat += mixed.sizes.components.effects[mixed.sizes.names.index(name)] ** 2 * part @ part.T
    lens = photo.d_intrinsics.reshape(count, size)
    with_points = mixed.points_with_unknowns[:, :size].reshape(-1, 3, size)[place]
    by_points = np.einsum("nia,nac->cni", photo.d_point, with_points).reshape(size, count)
    own_covariance = mixed.posterior.covariance[:size, :size]
    crossed = lens @ by_points
    flat += crossed + crossed.T + lens @ own_covariance @ lens.T
    with_intrinsics = own_covariance @ lens.T + by_points
    return AnotherPhoto(photo.predicted_px, flat, with_intrinsics, photo.d_pose.reshape(count, 6))
