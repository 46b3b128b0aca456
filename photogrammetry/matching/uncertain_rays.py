"""Points from rays whose poses and lens are uncertain together: prediction, adjustment, chi-square."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform, skew
from heliogauge.validate import FloatArray, IntArray, float_array
from photogrammetry.bundle.adjustment import BundleResult
from photogrammetry.bundle.state import d_parameters_d_intrinsics


@dataclass(frozen=True, slots=True, eq=False)
class Dots:
    """Dots without a code in the photos of a network, one row each.

    photo_index (m,): Photo of each dot.
    pixels_px (m, 2): Centres; (0, 0) is the centre of the top-left pixel [px].
    covariance_px2 (m, 2, 2): Their covariances [px^2].
    ellipses_px2 (m, 2, 2): Shapes of their ellipses [px^2].
    InputError: Lengths differ, or a value is not finite.
    """

    photo_index: IntArray
    pixels_px: FloatArray
    covariance_px2: FloatArray
    ellipses_px2: FloatArray

    def __post_init__(self) -> None:
        count = len(np.asarray(self.photo_index))
        index = np.array(self.photo_index, dtype=np.intp)
        if index.shape != (count,) or (index < 0).any():
            raise InputError(f"dots: photo_index: {count} places of photos are needed")
        index.setflags(write=False)
        object.__setattr__(self, "photo_index", index)
        object.__setattr__(self, "pixels_px", float_array("dots: pixels_px", self.pixels_px, (count, 2)))
        for name in ("covariance_px2", "ellipses_px2"):
            object.__setattr__(self, name, float_array(f"dots: {name}", getattr(self, name), (count, 2, 2)))

    def __len__(self) -> int:
        return int(self.photo_index.size)


@dataclass(frozen=True, slots=True, eq=False)
class KnownViews:
    """Cameras and poses of a network, and how well they are known together.

    cameras: The physical cameras.
    camera_of_photo (p,): Camera of each photo.
    poses length p: ``cam_from_world``.
    covariance (6 p + k, 6 p + k): Joint covariance of the steps of `RigidTransform.moved` of all photos, then of
        the free intrinsics [rad, m].
    d_parameters (10, k): For each camera, the derivative of its parameters by all free intrinsics.
    middle_m (3,): Middle of the known targets [m].
    reach_m: Distance of the farthest known target from it [m].
    """

    cameras: tuple[Camera, ...]
    camera_of_photo: IntArray
    poses: tuple[RigidTransform, ...]
    covariance: FloatArray
    d_parameters: tuple[FloatArray, ...]
    middle_m: FloatArray
    reach_m: float

    def camera(self, photo: int) -> Camera:
        """Return the camera of a photo."""
        return self.cameras[int(self.camera_of_photo[photo])]

    def columns(self, photos: Sequence[int]) -> IntArray:
        """Return the places of some poses, in order, and of all intrinsics in the joint covariance."""
        first = 6 * len(self.poses)
        poses = [6 * photo + np.arange(6) for photo in photos]
        return np.concatenate([*poses, np.arange(first, len(self.covariance))]).astype(np.intp)


def known_views(bundle: BundleResult) -> KnownViews:
    """Take cameras, poses and their joint covariance from an adjusted network."""
    count, known = len(bundle.state.rotations), bundle.problem.observations.n_rays > 0
    covariance = bundle.covariance.joint(photos=np.arange(count), intrinsics=True)
    free = [model.columns for model in bundle.problem.cameras]
    total, first, derivatives = sum(columns.size for columns in free), 0, []
    for columns, camera in zip(free, bundle.state.cameras, strict=True):
        own = np.zeros((10, total))
        own[:, first : first + columns.size] = d_parameters_d_intrinsics(camera)[:, columns]
        first += columns.size
        derivatives.append(own)
    points = bundle.state.points_m[known]
    middle = points.mean(axis=0)
    return KnownViews(
        bundle.state.cameras,
        bundle.problem.camera_index,
        bundle.cam_from_world,
        covariance,
        tuple(derivatives),
        middle,
        float(np.linalg.norm(points - middle, axis=1).max()),
    )


def widened(dots: Dots, views: KnownViews) -> Dots:
    """Widen covariances by the largest eccentricity: ``a^2 sin t cos t / f`` with t the tilt is at most a^2 / (2 f)."""
    focal = np.array([camera.focal_x_px for camera in views.cameras])[views.camera_of_photo][dots.photo_index]
    largest = np.linalg.eigvalsh(dots.ellipses_px2)[:, 1] if len(dots) else np.zeros(0)
    extra = (0.5 * largest / focal) ** 2
    return Dots(
        dots.photo_index,
        dots.pixels_px,
        dots.covariance_px2 + extra[:, None, None] * np.eye(2),
        dots.ellipses_px2,
    )


@dataclass(frozen=True, slots=True, eq=False)
class PointFit:
    """Points from rays of the same photos: (h, 3), (h, 3, 3), chi-squares (h,), residuals in sigma (h, n)."""

    points_m: FloatArray
    covariance_m2: FloatArray
    chi_square: FloatArray
    misses: FloatArray


class Linearised(NamedTuple):
    """Images (h, 2 n), derivatives by the point (h, 2 n, 3) and by poses of the photos and intrinsics."""

    pixels: FloatArray
    d_point: FloatArray
    d_views: FloatArray


class Lines(NamedTuple):
    """Origins (n, 3), directions (n, 3) in the world, and angular sigma (n,) of dots, that of the pose included."""

    origins: FloatArray
    directions: FloatArray
    sigma_rad: FloatArray


class UncertainRays:
    """Rays of dots through views that are known with a joint covariance.

    views: Cameras, poses, covariance.
    """

    def __init__(self, dots: Dots, views: KnownViews) -> None:
        self.dots, self.views = dots, views
        self.lines = _cast_lines(dots, views)

    def crossing(self, pairs: IntArray) -> FloatArray:
        """Points half way between the rays of pairs, (h, 3)."""
        origins, directions, _ = self.lines
        across = np.eye(3) - directions[pairs][..., :, None] * directions[pairs][..., None, :]
        right = np.einsum("hnij,hnj->hi", across, origins[pairs])
        return np.asarray(np.linalg.solve(across.sum(axis=1), right[..., None])[..., 0])

    def predicted(self, photo: int, rows: IntArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Images in another photo of points from two rays, (h, 2), with their covariance, poses included, (h, 2, 2)."""
        first, second = (int(self.dots.photo_index[rows[0, k]]) for k in (0, 1))
        _, a, b = self.linear((first, second), points)
        pixels, ahead, own = self.linear((photo,), points)
        covariance = self.noise(rows)
        weights = np.linalg.inv(covariance)
        normal = np.swapaxes(a, 1, 2) @ weights @ a
        gain = np.linalg.solve(normal, np.swapaxes(a, 1, 2) @ weights)
        carried = ahead @ gain
        k = len(self.views.covariance) - 6 * len(self.views.poses)
        full = np.zeros((len(points), 2, 18 + k))
        full[:, :, :12] = -carried @ b[:, :, :12]
        full[:, :, 12:18] = own[:, :, :6]
        full[:, :, 18:] = own[:, :, 6:] - carried @ b[:, :, 12:]
        columns = self.views.columns((first, second, photo))
        joint = self.views.covariance[np.ix_(columns, columns)]
        result = carried @ covariance @ np.swapaxes(carried, 1, 2) + full @ joint @ np.swapaxes(full, 1, 2)
        return pixels, result

    def across_line(self, first: int, second: int, rows: IntArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return unit normals of epipolar lines in the second photo, (h, 2), and the variance across them, (h,)."""
        _, a, b = self.linear((first, second), points)
        # What no movement of the point explains: the null space of A^T, one direction of four.
        null = np.linalg.svd(a)[0][:, :, 3]
        scale = np.linalg.norm(null[:, 2:], axis=1, keepdims=True)
        null = null / np.maximum(scale, 1e-6)
        columns = self.views.columns((first, second))
        joint = self.views.covariance[np.ix_(columns, columns)]
        along = np.einsum("hr,hrc->hc", null, b)
        variance = np.einsum("hr,hrs,hs->h", null, self.noise(rows), null)
        return null[:, 2:], variance + np.einsum("hc,cd,hd->h", along, joint, along)

    def linear(self, photos: Sequence[int], points: FloatArray) -> Linearised:
        """Project points into photos, with derivatives."""
        n, k = len(photos), len(self.views.covariance) - 6 * len(self.views.poses)
        pixels, a = np.empty((len(points), 2 * n)), np.empty((len(points), 2 * n, 3))
        b = np.zeros((len(points), 2 * n, 6 * n + k))
        index = np.asarray(photos, dtype=np.intp)
        # One call for all photos of a camera: of a single point in forty photos the calls would be all the time.
        for camera in np.unique(self.views.camera_of_photo[index]).tolist():
            own = np.nonzero(self.views.camera_of_photo[index] == camera)[0]
            rotations = np.stack([self.views.poses[photo].rotation for photo in index[own]])
            shifts = np.stack([self.views.poses[photo].translation_m for photo in index[own]])
            turned = np.einsum("nij,hj->hni", rotations, points)
            seen, d_point, d_lens = self.views.cameras[camera].project_with_jacobians(turned + shifts)
            d_lens = d_lens @ self.views.d_parameters[camera]
            d_turn = -d_point @ skew(turned)
            for place, photo in enumerate(own.tolist()):
                rows = slice(2 * photo, 2 * photo + 2)
                pixels[:, rows], a[:, rows] = seen[:, place], d_point[:, place] @ rotations[place]
                b[:, rows, 6 * photo : 6 * photo + 3] = d_turn[:, place]
                b[:, rows, 6 * photo + 3 : 6 * photo + 6] = d_point[:, place]
                b[:, rows, 6 * n :] = d_lens[:, place]
        return Linearised(pixels, a, b)

    def noise(self, rows: IntArray) -> FloatArray:
        """Covariance of the dots alone, (h, 2 n, 2 n)."""
        h, n = rows.shape
        noise = np.zeros((h, 2 * n, 2 * n))
        for place in range(n):
            own = slice(2 * place, 2 * place + 2)
            noise[:, own, own] = self.dots.covariance_px2[rows[:, place]]
        return noise

    def fitted(self, photos: Sequence[int], rows: IntArray, points: FloatArray) -> PointFit:
        """Adjust points from rays of the same photos with the joint covariance of dots, poses and intrinsics."""
        columns = self.views.columns(photos)
        joint = self.views.covariance[np.ix_(columns, columns)]
        observed = self.dots.pixels_px[rows].reshape(len(rows), -1)
        alone = self.noise(rows)
        points = points.copy()
        # From where two rays pass each other one step leaves nothing; the second one gives the residuals.
        for turn in range(2):
            pixels, a, b = self.linear(photos, points)
            whole = alone + b @ joint @ np.swapaxes(b, 1, 2)
            residuals = observed - pixels
            lost = ~np.isfinite(residuals).all(axis=1)
            residuals[lost], a[lost], whole[lost] = 1e6, 1.0, np.eye(whole.shape[1])
            weighted = np.linalg.solve(whole, np.concatenate([a, residuals[:, :, None]], axis=2))
            normal = np.swapaxes(a, 1, 2) @ weighted[:, :, :3]
            # A share of 1e-12 keeps parallel rays solvable; their depth is out of reach and refused.
            normal += 1e-12 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
            right = np.einsum("hri,hr->hi", a, weighted[:, :, 3])
            step = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
            if turn == 0:
                points = points + step
        left = np.einsum("hr,hr->h", residuals, weighted[:, :, 3]) - np.einsum("hi,hi->h", right, step)
        off = (residuals - np.einsum("hri,hi->hr", a, step)).reshape(len(rows), -1, 2)
        blocks = np.stack([whole[:, 2 * i : 2 * i + 2, 2 * i : 2 * i + 2] for i in range(off.shape[1])], axis=1)
        misses = np.einsum("hni,hni->hn", off, np.linalg.solve(blocks, off[..., None])[..., 0])
        left[lost] = np.inf
        return PointFit(points, np.asarray(np.linalg.inv(normal), dtype=np.float64), left, misses)


def _cast_lines(dots: Dots, views: KnownViews) -> Lines:
    count = len(dots)
    origins, directions, sigma = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count)
    for photo, pose in enumerate(views.poses):
        own = dots.photo_index == photo
        back, camera = pose.inverse(), views.camera(photo)
        origins[own] = back.translation_m
        directions[own] = back.rotate(camera.cast_rays(dots.pixels_px[own]))
        variance = 0.5 * np.trace(dots.covariance_px2[own], axis1=1, axis2=2) / camera.focal_x_px**2
        block = views.covariance[6 * photo : 6 * photo + 6, 6 * photo : 6 * photo + 6]
        distance = float(np.linalg.norm(back.translation_m - views.middle_m))
        angular = np.trace(block[:3, :3]) + np.trace(block[3:, 3:]) / distance**2
        sigma[own] = np.sqrt(variance + angular)
    return Lines(origins, directions, sigma)
