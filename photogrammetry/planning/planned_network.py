"""What a network that is being planned will give: its covariance by the bundle adjustment itself, without any noise."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError
from heliogauge.validate import FloatArray, IntArray, positive
from photogrammetry.bundle.adjustment import BundleResult, adjust
from photogrammetry.bundle.constraints import Distance
from photogrammetry.bundle.problem import BundleProblem, CameraModel
from photogrammetry.bundle.state import BundleState
from photogrammetry.image_points import ImagePoints
from photogrammetry.planning.stations import PlannedObject, Reach, Station, seen_targets

#: A photo with fewer targets has no pose of its own.
_LEAST_IN_PHOTO = 4
#: Cells along the longer side of the image whose filling is counted.
_CELLS = 8


@dataclass(frozen=True, slots=True, eq=False)
class PlannedCamera:
    """The camera of a plan.

    camera: The camera as far as it is known.
    free: Intrinsics that the measurement will estimate.
    sigma_px: Standard deviation of an image coordinate [px].
    smallest_px: Smallest diameter of a target's image that can be measured [px].
    InputError: A sigma that is not positive.
    """

    camera: Camera
    free: tuple[str, ...]
    sigma_px: float
    smallest_px: float = 0.0

    def __post_init__(self) -> None:
        positive("plan: sigma_px", self.sigma_px, "pixels")


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """What a network will give.

    stations: The photos that see enough to be used.
    rays (n,): Photos that see each target.
    sigma_m (n, 3): Predicted standard deviations; NaN for targets that are not determined [m].
    covariance_m2 (n, 3, 3): Predicted covariances [m^2].
    alone_m (n, 3): The same if poses, camera and scale were known without error: what the rays alone give [m].
    convergence_rad (n,): Largest angle between two rays of each target [rad].
    coverage_share: Share of the image's cells in which any photo has a target.
    bundle: The adjustment; None where the photos do not hang together.
    reason: Why there is no prediction; empty where there is one.
    """

    stations: tuple[Station, ...]
    rays: IntArray
    sigma_m: FloatArray
    covariance_m2: FloatArray
    alone_m: FloatArray
    convergence_rad: FloatArray
    coverage_share: float
    bundle: BundleResult | None
    reason: str = ""

    @property
    def rms_m(self) -> float:
        """RMS of all coordinates' sigmas; infinite where one is not determined [m]."""
        rms = float(np.sqrt((self.sigma_m**2).mean()))
        return rms if np.isfinite(rms) else float("inf")

    @property
    def largest_m(self) -> float:
        """Largest sigma of a coordinate; infinite where one is not determined [m]."""
        largest = float(self.sigma_m.max())
        return largest if np.isfinite(largest) else float("inf")


def predict(
    target_object: PlannedObject,
    planned: PlannedCamera,
    stations: Sequence[Station],
    reach: Reach,
    bars: Sequence[Distance] = (),
) -> Prediction:
    """Predict what photos from stations will give.

    reach: Gives the largest incidence.
    bars: Scale bars between targets of the object.
    Returns: Sigmas under inner constraints over all targets, as the evaluation of such a measurement reports them.

    First-order covariance: the normal equations at the planned places do not depend on the noise, so none is drawn.
    """
    used, points = _image_points(target_object, planned, stations, reach)
    count = len(target_object.names)
    rays = np.bincount(points.target_index, minlength=count) if points is not None else np.zeros(count, dtype=np.intp)
    nothing = np.full((count, 3), np.nan)
    cubes = np.full((count, 3, 3), np.nan)
    if points is None or len(used) < 2:
        reason = f"{len(used)} of {len(stations)} photos see {_LEAST_IN_PHOTO} targets; two are needed"
        return Prediction(used, rays, nothing, cubes, nothing, nothing[:, 0], 0.0, None, reason)
    alone, convergence = _rays_alone(target_object, planned, used, points)
    cover = _coverage(planned.camera, points.pixels_px)
    table = points.compacted()
    kept = np.unique(points.target_index)
    names = set(table.targets)
    problem = BundleProblem(
        table, (CameraModel("camera", planned.free),), None, tuple(bar for bar in bars if names.issuperset(bar.targets))
    )
    state = BundleState.from_poses([planned.camera], [one.cam_from_world for one in used], target_object.points_m[kept])
    try:
        bundle = adjust(problem, state)
    except EstimationError as error:
        return Prediction(used, rays, nothing, cubes, alone, convergence, cover, None, str(error))
    sigma, covariance = nothing.copy(), cubes.copy()
    covariance[kept] = bundle.covariance.points
    sigma[kept] = np.where(np.isfinite(bundle.points_m), bundle.sigma_points_m, np.nan)
    reason = "; ".join(one.text for one in bundle.defects)
    unseen = [name for name, n in zip(target_object.names, rays, strict=True) if n == 0]
    if unseen and not reason:
        reason = f"{len(unseen)} targets are in no photo: {', '.join(unseen[:5])}"
    return Prediction(used, rays, sigma, covariance, alone, convergence, cover, bundle, reason)


def _image_points(
    target_object: PlannedObject, planned: PlannedCamera, stations: Sequence[Station], reach: Reach
) -> tuple[tuple[Station, ...], ImagePoints | None]:
    """Return the stations that see enough, and where they see it."""
    used: list[Station] = []
    photo, target, pixels = [], [], []
    for station in stations:
        seen, places = seen_targets(target_object, planned.camera, station.cam_from_world, reach, planned.smallest_px)
        if seen.sum() < _LEAST_IN_PHOTO:
            continue
        photo.append(np.full(int(seen.sum()), len(used), dtype=np.intp))
        target.append(np.nonzero(seen)[0])
        pixels.append(places[seen])
        used.append(station)
    if not used:
        return (), None
    covariance = np.broadcast_to(np.eye(2) * planned.sigma_px**2, (sum(map(len, pixels)), 2, 2))
    names = tuple(f"photo_{i + 1:03d}" for i in range(len(used)))
    points = ImagePoints(
        names, target_object.names, np.concatenate(photo), np.concatenate(target), np.concatenate(pixels), covariance
    )
    return tuple(used), points


def _rays_alone(
    target_object: PlannedObject, planned: PlannedCamera, stations: Sequence[Station], points: ImagePoints
) -> tuple[FloatArray, FloatArray]:
    """Return the sigmas of intersection with known poses, (n, 3), and the largest angles between rays, (n,)."""
    count = len(target_object.names)
    normal = np.zeros((count, 3, 3))
    rays: list[list[FloatArray]] = [[] for _ in range(count)]
    for photo, station in enumerate(stations):
        own = points.target_index[points.photo_index == photo]
        seen = planned.camera.project_posed(target_object.points_m[own], station.cam_from_world)
        jacobian = np.asarray(seen.d_pixel_d_point) / planned.sigma_px
        normal[own] += np.swapaxes(jacobian, 1, 2) @ jacobian
        arms = station.center_m - target_object.points_m[own]
        for place, arm in zip(own.tolist(), arms / np.linalg.norm(arms, axis=1, keepdims=True), strict=True):
            rays[place].append(arm)
    sigma, angle = np.full((count, 3), np.nan), np.full(count, np.nan)
    for i, directions in enumerate(rays):
        if len(directions) < 2:
            continue
        bundle = np.array(directions)
        angle[i] = float(np.arccos(np.clip((bundle @ bundle.T).min(), -1.0, 1.0)))
        if np.linalg.cond(normal[i]) < 1e12:
            sigma[i] = np.sqrt(np.diag(np.linalg.inv(normal[i])))
    return sigma, angle


def _coverage(camera: Camera, pixels_px: FloatArray) -> float:
    longer = max(camera.width_px, camera.height_px)
    cells = [max(1, round(_CELLS * size / longer)) for size in (camera.width_px, camera.height_px)]
    limits = [(-0.5, camera.width_px - 0.5), (-0.5, camera.height_px - 0.5)]
    counts, _, _ = np.histogram2d(pixels_px[:, 0], pixels_px[:, 1], cells, limits)
    return float((counts > 0).mean())


def q_factor(prediction: Prediction, planned: PlannedCamera, target_object: PlannedObject) -> float:
    """Return q of the planning rule ``sigma = q S sigma_image / sqrt(k)``.

    prediction: What the network gives.
    Returns: q, with S the mean distance over the focal length, sigma_image in pixels, and k the mean number of rays
        over 4.

    Fraser 1984 (Network design considerations for non-topographic photogrammetry): q is 0.4 to 0.8 for convergent
    networks of four stations with k photos at each, 1.5 and more for stereo pairs. Four rays at 45 degrees from the
    normal give 0.62: 1 / sqrt(4 x 3/4) across, 1 / sqrt(4 x 1/2) along the normal.
    """
    rays = float(prediction.rays.mean())
    centers = np.array([one.center_m for one in prediction.stations])
    away = float(np.linalg.norm(target_object.points_m[:, None] - centers, axis=2).mean())
    focal = 0.5 * (planned.camera.focal_x_px + planned.camera.focal_y_px)
    return float(prediction.rms_m * np.sqrt(rays / 4) / (away / focal * planned.sigma_px))
