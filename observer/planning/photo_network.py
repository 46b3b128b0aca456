"""The photo network of a planned pass: what it will know of the cameras, from targets that are only listed."""

from dataclasses import dataclass, replace

import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, IntArray
from observer.photo_edges.views import View
from observer.planning.simulated_edges import in_image
from observer.slopes.pose_modes import Photos
from photogrammetry import ImagePoints
from photogrammetry.bundle import BundleProblem, BundleResult, BundleState, CameraModel, adjust, constraints


@dataclass(frozen=True, slots=True, eq=False)
class PlannedNetwork:
    """Targets and photos of a plan, as they are without error.

    model: What of it is estimated, with priors.
    poses: ``cam_from_frame`` of each photo that sees enough targets.
    points_m (n, 3): Their places [m].
    constraints: What is known of them.
    sigma_px: Standard deviation of an image coordinate of a target [px].
    """

    camera: Camera
    model: CameraModel
    poses: tuple[RigidTransform, ...]
    names: tuple[str, ...]
    points_m: FloatArray
    constraints: tuple[constraints.Constraint, ...]
    sigma_px: float

    @property
    def views(self) -> tuple[View, ...]:
        """Camera and pose of each photo."""
        return tuple(View(self.camera, pose) for pose in self.poses)


@dataclass(frozen=True, slots=True, eq=False)
class Believed(ShortRepr):
    """Cameras and poses as the photo network of one measurement finds them.

    views: Camera and ``cam_from_frame`` of each photo.
    covariance (6 n, 6 n): Joint covariance of the poses' steps [rad, m].
    """

    views: tuple[View, ...]
    covariance: FloatArray

    @classmethod
    def of(cls, bundle: BundleResult) -> "Believed":
        """Return cameras and poses as an adjustment found them."""
        poses = bundle.cam_from_world
        views = tuple(View(bundle.cameras[k], pose) for k, pose in zip(bundle.problem.camera_index, poses, strict=True))
        return cls(views, bundle.covariance.joint((), np.arange(len(poses))))

    @property
    def photos(self) -> Photos:
        """The poses with their covariance."""
        poses: tuple[RigidTransform, ...] = tuple(pose for _, pose in self.views)
        return Photos(poses, self.covariance)


def drawn_network(network: PlannedNetwork, rng: np.random.Generator | None) -> BundleResult:
    """Adjust the photo network, with everything that is known disturbed by its sigma.

    rng: Draws the errors of image points, coordinates, distances and the camera's prior; None for none.
    EstimationError: The network is not determined.
    """
    points = _image_points(network, rng)
    present = {points.targets[i] for i in np.unique(points.target_index)}
    held = [one for one in network.constraints if present.issuperset(one.targets)]
    known = dict(zip(network.names, network.points_m, strict=True))
    drawn = tuple(_true_to(one, known, rng) for one in held)
    table = points.compacted()
    model, camera = _drawn_camera(network, rng)
    start = BundleState.from_poses([camera], network.poses, np.array([known[name] for name in table.targets]))
    return adjust(BundleProblem(table, (model,), None, drawn), start)


def _image_points(network: PlannedNetwork, rng: np.random.Generator | None) -> ImagePoints:
    photo: list[IntArray] = []
    target: list[IntArray] = []
    pixels: list[FloatArray] = []
    for k, view in enumerate(network.views):
        seen = np.nonzero(in_image(view, network.points_m))[0]
        photo.append(np.full(seen.size, k))
        target.append(seen)
        pixels.append(network.camera.project(view.cam_from_frame.apply(network.points_m[seen])))
    places = np.concatenate(pixels)
    if rng is not None:
        places = places + network.sigma_px * rng.standard_normal(places.shape)
    covariance = np.broadcast_to(np.eye(2) * network.sigma_px**2, (len(places), 2, 2))
    names = tuple(f"photo_{k + 1:03d}" for k in range(len(network.poses)))
    return ImagePoints(names, network.names, np.concatenate(photo), np.concatenate(target), places, covariance)


def _true_to(
    one: constraints.Constraint, known: dict[str, FloatArray], rng: np.random.Generator | None
) -> constraints.Constraint:
    """Return what is known with the value that fits the planned places, plus its error."""
    error = 0.0 if rng is None else float(rng.standard_normal())
    if isinstance(one, constraints.Coordinate):
        return replace(one, value_m=one.value_m + error * one.sigma_m)
    if isinstance(one, constraints.Distance):
        true = float(np.linalg.norm(known[one.target_a] - known[one.target_b]))
        return replace(one, distance_m=true + error * one.sigma_m)
    return one


def _drawn_camera(network: PlannedNetwork, rng: np.random.Generator | None) -> tuple[CameraModel, Camera]:
    """Return the camera as its calibration has it: wrong by what the priors of its free intrinsics allow."""
    model = network.model
    if rng is None:
        return model, network.camera
    priors = tuple(replace(one, value=one.value + one.sigma * float(rng.standard_normal())) for one in model.priors)
    if model.prior_covariance is None:
        return replace(model, priors=priors), network.camera
    error = rng.multivariate_normal(np.zeros(len(model.prior_covariance)), model.prior_covariance, method="eigh")
    values = None if model.prior_values is None else model.prior_values + error
    return replace(model, priors=priors, prior_values=values), network.camera
