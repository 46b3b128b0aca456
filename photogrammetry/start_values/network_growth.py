"""A photo network while it grows: photos by resection, targets by intersection, adjustments in between."""

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from heliogauge.adjust.gauss_newton import Options
from heliogauge.adjust.robust_loss import Cauchy
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import BoolArray, FloatArray, IntArray
from photogrammetry.bundle.adjustment import BundleOptions, descend
from photogrammetry.bundle.evaluation import BundleRows
from photogrammetry.bundle.problem import BundleProblem, CameraModel
from photogrammetry.bundle.state import BundleState, camera_with_intrinsics, intrinsics_of
from photogrammetry.image_points import ImagePoints
from photogrammetry.start_values.resection import LEAST_TARGETS, Resection, resect
from photogrammetry.start_values.triangulation import LEAST_ANGLE_RAD, intersect_lines, ray_sigma_rad

# Residuals up to so many sigma take part while the network grows.
TOLERANCE = 5.0
# Photos between two adjustments, as a share of those oriented: one after each of 1000 photos would be 1000 adjustments.
_GROWTH = 0.3
# From so many photos on, others whose pose is nearly as certain come along: they were resected already.
_MANY_PHOTOS, _NEARLY = 8, 1.5
# With fewer photos the focal length of a guessed camera follows the poses instead of the targets.
_PHOTOS_FOR_FOCAL = 4
# Targets of a resection: its start value needs no more.
_RESECTED = 120
# From a wide-angle lens to a telephoto, in steps of 15 %, from the guess.
_FOCAL_FACTORS = 1.15 ** np.arange(-5, 11)


@dataclass(eq=False)
class Growth:
    """The network while it grows; changed in place.

    table: All image points.
    cameras: The cameras as known so far.
    models: What of them is free once the network bears it.
    noise (c,): Size of the errors of each camera in units of the stated sigmas, lens included.
    poses: ``cam_from_world`` of the oriented photos.
    points (n, 3): Targets, NaN where not known.
    failures: Why photos are not in the network yet.
    tried: Guessed cameras whose focal length was estimated from a photo of known targets.
    misses (m,): Residual of each image point in sigma, infinite where it took no part.
    """

    table: ImagePoints
    camera_of_photo: IntArray
    cameras: list[Camera]
    models: tuple[CameraModel, ...]
    noise: FloatArray
    poses: dict[int, RigidTransform] = field(default_factory=dict)
    points: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    failures: dict[int, str] = field(default_factory=dict)
    tried: set[int] = field(default_factory=set)
    misses: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        self.points = np.full((len(self.table.targets), 3), np.nan)
        self.misses = np.zeros(self.table.n)
        order = np.argsort(self.table.photo_index, kind="stable")
        bounds = np.searchsorted(self.table.photo_index[order], np.arange(len(self.table.photos) + 1))
        self.rows_of_photo = [order[a:b] for a, b in pairwise(bounds.tolist())]

    @property
    def known(self) -> BoolArray:
        """Which targets have coordinates, shape (n,)."""
        return np.asarray(np.isfinite(self.points[:, 0]))

    def camera(self, photo: int) -> Camera:
        """Return the camera of a photo."""
        return self.cameras[int(self.camera_of_photo[photo])]

    def covariance(self, rows: IntArray) -> FloatArray:
        """Return covariances widened by the present noise, shape (k, 2, 2) [px^2]."""
        return np.asarray(self.table.covariance_px2[rows] * self.noise_of(rows)[:, None, None] ** 2)

    def noise_of(self, rows: IntArray) -> FloatArray:
        """Return the noise of image points, shape (k,)."""
        return np.asarray(self.noise[self.camera_of_photo[self.table.photo_index[rows]]])

    def state(self, photos: IntArray, targets: IntArray) -> BundleState:
        """Return start values of some photos and targets."""
        poses = [self.poses[photo] for photo in photos.tolist()]
        rotations, shifts = (
            np.stack([getattr(pose, name) for pose in poses]) for name in ("rotation", "translation_m")
        )
        return BundleState(tuple(self.cameras), rotations, shifts, self.points[targets])

    def copy(self) -> "Growth":
        """Return a network that can grow on its own."""
        other = replace(self, cameras=list(self.cameras), poses=dict(self.poses), failures=dict(self.failures))
        other.points, other.misses = self.points.copy(), self.misses.copy()
        other.noise, other.tried = self.noise.copy(), set(self.tried)
        return other


def rows_inside(grown: Growth) -> IntArray:
    """Rows whose photo and target are in the network."""
    oriented = np.zeros(len(grown.table.photos), dtype=np.bool_)
    oriented[list(grown.poses)] = True
    return np.nonzero(oriented[grown.table.photo_index] & grown.known[grown.table.target_index])[0]


def grow(grown: Growth) -> None:
    """Add photos until none can be added any more."""
    while len(grown.poses) < len(grown.table.photos):
        most = max(1, int(_GROWTH * len(grown.poses)))
        added = add_photos(grown, most=most)
        intersect_new(grown)
        if added:
            adjust_growth(grown)
            continue
        # Once more with everything adjusted: better targets may admit photos that failed.
        adjust_growth(grown)
        intersect_new(grown)
        if not add_photos(grown, most=most):
            break
    adjust_growth(grown)
    # Poses are good now: targets whose rays meet at a small angle are no danger to them, only uncertain themselves.
    before = np.count_nonzero(grown.known)
    intersect_new(grown, least_rad=LEAST_ANGLE_RAD)
    if np.count_nonzero(grown.known) > before:
        adjust_growth(grown)


def add_photos(grown: Growth, *, most: int) -> int:
    """Resect the photos with most known targets and keep the best-conditioned ones."""
    counts = np.bincount(
        grown.table.photo_index[grown.known[grown.table.target_index]], minlength=len(grown.table.photos)
    )
    waiting = [i for i in np.argsort(-counts, kind="stable").tolist() if i not in grown.poses]
    found: list[tuple[float, int, Resection]] = []
    for photo in waiting:
        if counts[photo] < LEAST_TARGETS:
            grown.failures[photo] = (
                f"shares {int(counts[photo])} targets with the network, {LEAST_TARGETS} are needed; "
                "add overlap or leave it out"
            )
            continue
        if len(found) >= 2 * most + 2:
            break
        try:
            one = _resected(grown, photo)
        except EstimationError as error:
            grown.failures[photo] = str(error)
            continue
        if one.rival < 1.5 and len(grown.poses) + len(found) < len(grown.table.photos):
            grown.failures[photo] = f"two poses fit equally well ({one.rival:.2f} times the misfit)"
            # Not now: with more targets known the choice becomes clear; in the end the better one is taken.
            found.append((1e6 / one.rival, photo, one))
            continue
        found.append((_looseness(grown, photo, one), photo, one))
    found.sort(key=lambda entry: entry[0])
    # Doubtful poses only when there is nothing else.
    sure = [entry for entry in found if entry[0] < 1e5] or found[:1]
    limit = _NEARLY * sure[min(most, len(sure)) - 1][0] if sure and len(grown.poses) >= _MANY_PHOTOS else 0.0
    taken = [entry for place, entry in enumerate(sure) if place < most or entry[0] <= limit]
    for _, photo, one in taken:
        grown.poses[photo] = one.cam_from_world
        grown.failures.pop(photo, None)
    return len(taken)


def _known_rows(grown: Growth, photo: int) -> IntArray:
    """Rows of a photo whose targets have coordinates."""
    rows = grown.rows_of_photo[photo]
    return rows[grown.known[grown.table.target_index[rows]]]


def _resected(grown: Growth, photo: int) -> Resection:
    rows = _known_rows(grown, photo)
    if rows.size > _RESECTED:
        # Of a thousand targets some determine the pose as well, in a fifth of the time; the next adjustment takes all.
        rows = np.sort(np.random.default_rng(photo).choice(rows, _RESECTED, replace=False))
    camera = int(grown.camera_of_photo[photo])
    seen_before = any(grown.camera_of_photo[other] == camera for other in grown.poses)
    if seen_before or camera in grown.tried or "focal_px" not in grown.models[camera].free:
        return _resection(grown, grown.cameras[camera], rows)
    # The first photo of a guessed camera among targets that are known: they determine its focal length too.
    trials = []
    for factor in _FOCAL_FACTORS:
        values = intrinsics_of(grown.cameras[camera])
        values[0] *= factor
        trial = camera_with_intrinsics(grown.cameras[camera], values)
        try:
            one = _resection(grown, trial, rows)
        except EstimationError:
            continue
        trials.append((float((np.minimum(one.misses, TOLERANCE) ** 2).sum()), trial, one))
    if not trials:
        return _resection(grown, grown.cameras[camera], rows)
    _, grown.cameras[camera], found = min(trials, key=lambda trial: trial[0])
    grown.tried.add(camera)
    return found


def _resection(grown: Growth, camera: Camera, rows: IntArray) -> Resection:
    # Targets from few photos are uncertain too: twice the noise.
    return resect(
        camera,
        grown.points[grown.table.target_index[rows]],
        grown.table.pixels_px[rows],
        grown.covariance(rows) * 4,
        tolerance=TOLERANCE,
    )


def _looseness(grown: Growth, photo: int, one: Resection) -> float:
    """Uncertainty of the position over the distance of the targets."""
    rows = _known_rows(grown, photo)
    distance = float(
        np.median(np.linalg.norm(one.cam_from_world.apply(grown.points[grown.table.target_index[rows]]), axis=1))
    )
    return float(np.sqrt(np.trace(one.covariance[3:, 3:]))) / distance


def intersect_new(grown: Growth, *, least_rad: float = 2 * LEAST_ANGLE_RAD) -> None:
    """Intersect all targets that are not known yet, where the angle of their rays is large enough [rad]."""
    oriented = np.zeros(len(grown.table.photos), dtype=np.bool_)
    oriented[list(grown.poses)] = True
    rows = np.nonzero(oriented[grown.table.photo_index] & ~grown.known[grown.table.target_index])[0]
    if not rows.size:
        return
    photos, directions, sigma = grown.table.photo_index[rows], np.empty((rows.size, 3)), np.empty(rows.size)
    rotations, centers = np.zeros((oriented.size, 3, 3)), np.zeros((oriented.size, 3))
    for photo, pose in grown.poses.items():
        back = pose.inverse()
        rotations[photo], centers[photo] = back.rotation, back.translation_m
    owners = grown.camera_of_photo[photos]
    for place in np.unique(owners).tolist():
        own, camera = owners == place, grown.cameras[place]
        rays = camera.cast_rays(grown.table.pixels_px[rows[own]])
        directions[own] = np.einsum("mij,mj->mi", rotations[photos[own]], rays)
        sigma[own] = ray_sigma_rad(camera, grown.covariance(rows[own]))
    origins = centers[photos]
    usable = np.isfinite(directions).all(axis=1)
    places = grown.table.target_index[rows[usable]]
    found = intersect_lines(origins[usable], directions[usable], sigma[usable], places, len(grown.points))
    agreeing = np.bincount(places[found.misses < 3 * TOLERANCE], minlength=len(grown.points))
    new = found.found & (agreeing >= 2) & (found.angle_rad > least_rad)
    grown.points[new] = found.points_m[new]


def adjust_growth(grown: Growth) -> None:
    """Adjust what is in the network with a robust loss; renew the noise, the misses and the cameras.

    grown: The network, changed in place.
    """
    for _ in range(2):
        rows = rows_inside(grown)
        rows = rows[np.isfinite(projected(grown, rows)).all(axis=1)]
        rays = np.bincount(grown.table.target_index[rows], minlength=len(grown.points))
        grown.points[grown.known & (rays < 2)] = np.nan
        rows = rows[rays[grown.table.target_index[rows]] >= 2]
        adjusted = _adjusted(grown, rows)
        misses, before = np.linalg.norm(adjusted.whitened_residuals, axis=1), grown.noise.copy()
        _renew_noise(grown, rows, misses, adjusted.redundancy)
        if (before < 1.5 * grown.noise).all():
            break


def appraise(grown: Growth) -> None:
    """Renew noise and misses where poses and targets are good already.

    grown: The network, changed in place.
    """
    rows = rows_inside(grown)
    roots = np.linalg.inv(np.linalg.cholesky(grown.covariance(rows)))
    difference = (projected(grown, rows) - grown.table.pixels_px[rows])[..., None]
    misses = np.nan_to_num(np.linalg.norm((roots @ difference)[..., 0], axis=1), nan=np.inf)
    unknowns = 3 * int(np.count_nonzero(grown.known)) + 6 * len(grown.poses)
    _renew_noise(grown, rows, misses, 2 * rows.size - unknowns)


def _renew_noise(grown: Growth, rows: IntArray, misses: FloatArray, redundancy: int) -> None:
    """Take noise and misses from the lengths of residuals in units of the noise that was."""
    # Median of the length of two normal components: 1.18 sigma; few redundant ones make residuals too small.
    share = max(redundancy / (2 * rows.size), 0.05)
    before, cameras = grown.noise.copy(), grown.camera_of_photo[grown.table.photo_index[rows]]
    for camera in np.unique(cameras).tolist():
        typical = float(np.median(misses[cameras == camera])) / 1.18 / np.sqrt(share)
        grown.noise[camera] = max(1.0, before[camera] * min(typical, 1.0))
    grown.misses = np.full(grown.table.n, np.inf)
    grown.misses[rows] = misses * (before / grown.noise)[cameras]


def _adjusted(grown: Growth, rows: IntArray) -> BundleRows:
    """Adjust some rows and take the estimates over."""
    table = grown.table.subset(rows).compacted()
    photos, targets = places_of(grown.table.photos, table.photos), places_of(grown.table.targets, table.targets)
    scaled = replace(table, covariance_px2=grown.covariance(rows))
    models = tuple(_bearable(model, grown, index, rows.size) for index, model in enumerate(grown.models))
    problem = BundleProblem(scaled, models, grown.camera_of_photo[photos])
    options = BundleOptions(loss=Cauchy(), descent=Options(tolerance=1e-2, initial_damping=1e-4, max_iterations=30))
    result = descend(problem, grown.state(photos, targets), options)
    grown.cameras = list(result.state.cameras)
    grown.points[targets] = result.state.points_m
    for place, photo in enumerate(photos.tolist()):
        grown.poses[photo] = result.state.cam_from_world(place)
    return result.evaluation


def places_of(all_names: tuple[str, ...], names: tuple[str, ...]) -> IntArray:
    """Return the places of names among all names."""
    place = {name: i for i, name in enumerate(all_names)}
    return np.array([place[name] for name in names], dtype=np.intp)


def projected(grown: Growth, rows: IntArray) -> FloatArray:
    """Return where targets should be seen, shape (k, 2) [px]; NaN behind the camera or outside its lens model."""
    photos, pixels = grown.table.photo_index[rows], np.empty((rows.size, 2))
    rotations, shifts = np.zeros((len(grown.table.photos), 3, 3)), np.zeros((len(grown.table.photos), 3))
    for photo, pose in grown.poses.items():
        rotations[photo], shifts[photo] = pose.rotation, pose.translation_m
    points = np.einsum("mij,mj->mi", rotations[photos], grown.points[grown.table.target_index[rows]]) + shifts[photos]
    owners = grown.camera_of_photo[photos]
    for camera in np.unique(owners).tolist():
        own = owners == camera
        pixels[own] = grown.cameras[camera].project(points[own])
    return pixels


def _bearable(model: CameraModel, grown: Growth, camera: int, n_rows: int) -> CameraModel:
    """Free of a camera what the network bears: nothing, the focal length with K1, all."""
    photos = sum(1 for photo in grown.poses if grown.camera_of_photo[photo] == camera)
    if not model.free or photos < _PHOTOS_FOR_FOCAL:
        return replace(model, free=(), priors=(), prior_covariance=None)
    if photos < 2 * _PHOTOS_FOR_FOCAL or n_rows < 12 * photos:
        free = tuple(name for name in model.free if name in {"focal_px", "k1"})
        return replace(model, free=free, priors=tuple(one for one in model.priors if one.name in free))
    return model
