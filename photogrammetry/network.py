"""Start values of a whole photo network from image points alone: photo by photo, the best-conditioned next."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from heliogauge.camera import Camera
from heliogauge.errors import EstimationError
from heliogauge.gauss_newton import Options
from heliogauge.rigid import RigidTransform
from heliogauge.robust_loss import Cauchy
from heliogauge.validate import BoolArray, FloatArray
from photogrammetry.bundle import BundleOptions, BundleProblem, CameraModel, adjust
from photogrammetry.bundle_state import BundleState
from photogrammetry.observations import ImagePoints, IntArray
from photogrammetry.relative_pose import LEAST_COMMON, RelativePose, SharedTargets, parallax_rad, relate
from photogrammetry.resection import LEAST_TARGETS, Resection, resect
from photogrammetry.triangulation import LEAST_ANGLE_RAD, intersect_lines, ray_sigma_rad

# Residuals up to so many sigma take part while the network grows.
_TOLERANCE = 5.0
# Photos between two adjustments, as a share of those oriented: one after each of 1000 photos would be 1000 adjustments.
_GROWTH = 0.3
_MOST_PAIRS = 12
# With fewer photos the focal length of a guessed camera follows the poses instead of the targets.
_PHOTOS_FOR_FOCAL = 4


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A photo or target that is not in the network.

    Parameters
    ----------
    name : str
        Photo or target.
    reason : str
        Why, with numbers and remedy.
    """

    name: str
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """Start values of the photos and targets that hang together.

    Parameters
    ----------
    observations : ImagePoints
        The image points that agree with the network, with the photos and targets that are in it.
    rows : ndarray of int
        Their places in the image points that were given.
    camera_of_photo : ndarray of int
        Camera of each photo of the network.
    state : BundleState
        Cameras, poses and targets; frame and scale are arbitrary (first photo, first distance).
    photos_left_out, targets_left_out : tuple of LeftOut
        What is not in it and why.
    suspicious : tuple of LeftOut
        Image points of photos and targets in the network that do not agree with it.
    noise : float
        Typical size of the residuals in units of the stated sigmas.
    """

    observations: ImagePoints
    rows: IntArray
    camera_of_photo: IntArray
    state: BundleState
    photos_left_out: tuple[LeftOut, ...]
    targets_left_out: tuple[LeftOut, ...]
    suspicious: tuple[LeftOut, ...]
    noise: float


@dataclass(eq=False)
class _Growth:
    """The network while it grows."""

    table: ImagePoints
    camera_of_photo: IntArray
    cameras: list[Camera]
    models: tuple[CameraModel, ...]
    noise: float
    poses: dict[int, RigidTransform] = field(default_factory=dict)
    points: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    failures: dict[int, str] = field(default_factory=dict)
    misses: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        self.points = np.full((len(self.table.targets), 3), np.nan)
        self.misses = np.zeros(self.table.n)
        order = np.argsort(self.table.photo_index, kind="stable")
        bounds = np.searchsorted(self.table.photo_index[order], np.arange(len(self.table.photos) + 1))
        self.rows_of_photo = [order[a:b] for a, b in pairwise(bounds.tolist())]

    @property
    def known(self) -> BoolArray:
        return np.asarray(np.isfinite(self.points[:, 0]))

    def camera(self, photo: int) -> Camera:
        return self.cameras[int(self.camera_of_photo[photo])]

    def covariance(self, rows: IntArray) -> FloatArray:
        return np.asarray(self.table.covariance_px2[rows] * self.noise**2)

    def copy(self) -> "_Growth":
        other = replace(self, cameras=list(self.cameras), poses=dict(self.poses), failures=dict(self.failures))
        other.points, other.misses = self.points.copy(), self.misses.copy()
        return other


def build_network(
    observations: ImagePoints,
    cameras: Sequence[Camera],
    *,
    models: Sequence[CameraModel] | None = None,
    camera_of_photo: IntArray | None = None,
    start_noise_px: float | None = None,
) -> Network:
    """Find start values of poses and targets without any given.

    Parameters
    ----------
    observations : ImagePoints
        All image points, false ones among them.
    cameras : sequence of Camera
        The cameras, calibrated or guessed (`guessed_camera`).
    models : sequence of CameraModel, optional
        Intrinsics that are free; they are estimated as soon as the network bears it. Known cameras by default.
    camera_of_photo : ndarray of int, optional
        Camera of each photo; the first by default.
    start_noise_px : float, optional
        How far image points may be off at the start, lens included; by default 1 px for known cameras and 2/1000 of
        the image width for guessed ones [px].

    Returns
    -------
    Network
        Start values; photos and targets that could not be tied in are named with the reason.

    Raises
    ------
    EstimationError
        No two photos have six common targets seen from different places.

    Notes
    -----
    The pair with many common targets and a wide parallax starts (`photogrammetry.relative_pose`); where it has two
    solutions (targets in one plane), the one that a third photo agrees with better is taken. Then photos follow by
    resection, those whose position becomes most certain first; targets by intersection; an adjustment with Cauchy's
    loss after each growth by a third. Photos that fail are tried again whenever the network has grown.
    """
    index = np.zeros(len(observations.photos), np.intp) if camera_of_photo is None else np.asarray(camera_of_photo)
    chosen = tuple(models) if models else tuple(CameraModel(f"camera {i + 1}") for i in range(len(cameras)))
    mean_sigma = float(np.sqrt(np.median(np.einsum("mii->m", observations.covariance_px2)) / 2))
    guessed = any(model.free for model in chosen)
    default_px = 0.002 * cameras[0].width_px if guessed else 1.0
    noise = max(1.0, (start_noise_px or default_px) / mean_sigma)
    empty = _Growth(observations, index, list(cameras), chosen, noise)
    grown = _started(empty)
    _grow(grown)
    return _finished(grown)


def guessed_camera(width_px: int, height_px: int, *, focal_length_35mm: float | None = None) -> Camera:
    """Return a camera to start a self-calibration from.

    Parameters
    ----------
    width_px, height_px : int
        Size of the image [px].
    focal_length_35mm : float, optional
        Focal length as EXIF gives it, for a film of 36 mm x 24 mm [mm].

    Returns
    -------
    Camera
        Principal point in the middle, no distortion; a focal length of 28 mm where nothing is known.

    Examples
    --------
    >>> guessed_camera(3600, 2400, focal_length_35mm=50.0).focal_x_px
    5000.0
    """
    # The diagonal of 43.27 mm is what the equivalent focal length keeps; for 3:2 images the width gives the same.
    longest = max(width_px, height_px)
    focal_px = longest * (focal_length_35mm or 28.0) / 36.0
    return Camera(width_px, height_px, focal_px, focal_px, 0.5 * (width_px - 1), 0.5 * (height_px - 1))


def _started(empty: _Growth) -> _Growth:
    """Choose a pair and one of its solutions."""
    reasons, best = [], None
    for first, second in _pairs(empty):
        names = f"{empty.table.photos[first]} - {empty.table.photos[second]}"
        try:
            solutions = relate(_shared(empty, first, second)[0], tolerance=_TOLERANCE)
        except EstimationError as error:
            reasons.append(f"{names}: {error}")
            continue
        fine = solutions[0].inliers.mean() > 0.6 and solutions[0].angle_rad > 2 * LEAST_ANGLE_RAD
        rivals = [one for one in solutions if one.misfit < 2 * solutions[0].misfit + 1]
        trials = [_tried(empty, (first, second), one) for one in rivals[:4]]
        score, grown = min(trials, key=lambda trial: trial[0])
        if best is None or score < best[0]:
            best = (score, grown)
        if fine and score < 4.0:
            return grown
    if best is None:
        listed = "; ".join(reasons[:3]) if reasons else _why_no_pair(empty)
        raise EstimationError(f"network: no two photos start it: {listed}")
    return best[1]


def _why_no_pair(empty: _Growth) -> str:
    seen = _visibility(empty.table)
    common = (seen @ seen.T).astype(int)
    np.fill_diagonal(common, 0)
    if common.size and common.max() >= LEAST_COMMON:
        return (
            "all photos seem to be taken from one place, a rotation alone explains them; move the camera between photos"
        )
    return (
        f"no two photos have {LEAST_COMMON} common targets (the most is {int(common.max(initial=0))}); "
        "take photos that overlap or add targets"
    )


def _visibility(table: ImagePoints) -> FloatArray:
    seen = np.zeros((len(table.photos), len(table.targets)))
    seen[table.photo_index, table.target_index] = 1.0
    return seen


def _pairs(empty: _Growth) -> list[tuple[int, int]]:
    """Order pairs of photos by common targets times parallax; only pairs with a parallax above the noise."""
    seen = _visibility(empty.table)
    common = np.triu(seen @ seen.T, 1)
    first, second = np.nonzero(common >= LEAST_COMMON)
    # 300 pairs are measured, spread over all counts when there are more.
    order = np.argsort(-common[first, second], kind="stable")
    order = order[np.unique(np.linspace(0, max(order.size - 1, 0), 300).astype(int))] if order.size > 300 else order
    scored = []
    for place in order.tolist():
        shared, _ = _shared(empty, int(first[place]), int(second[place]))
        rays = shared.rays
        usable = np.isfinite(rays).all(axis=(0, 2))
        if usable.sum() < LEAST_COMMON:
            continue
        parallax = parallax_rad(rays[:, usable])
        if parallax > 3 * float(np.median(shared.sigma_rad)):
            score = float(common[first[place], second[place]]) * min(parallax, 0.2)
            scored.append((score, int(first[place]), int(second[place])))
    scored.sort(reverse=True)
    return [(a, b) for _, a, b in scored[:_MOST_PAIRS]]


def _shared(grown: _Growth, first: int, second: int) -> tuple[SharedTargets, IntArray]:
    rows_a, rows_b = grown.rows_of_photo[first], grown.rows_of_photo[second]
    targets, a, b = np.intersect1d(
        grown.table.target_index[rows_a], grown.table.target_index[rows_b], return_indices=True
    )
    rows = np.stack([rows_a[a], rows_b[b]])
    covariance = np.stack([grown.covariance(rows[0]), grown.covariance(rows[1])])
    cameras = (grown.camera(first), grown.camera(second))
    return SharedTargets(cameras, grown.table.pixels_px[rows], covariance), targets


def _tried(empty: _Growth, pair: tuple[int, int], solution: RelativePose) -> tuple[float, _Growth]:
    """Start with one solution of a pair and see how well a third photo agrees with it."""
    grown = empty.copy()
    _, targets = _shared(grown, *pair)
    grown.poses = {pair[0]: RigidTransform.identity(), pair[1]: solution.second_from_first}
    grown.points[targets[solution.inliers]] = solution.points_m[solution.inliers]
    score = solution.misfit
    added = _add_photos(grown, most=1)
    if added:
        _intersect(grown)
        _adjust(grown)
        rows = _rows_in(grown)
        score += float(np.mean(np.minimum(grown.misses[rows], _TOLERANCE) ** 2))
    return score, grown


def _rows_in(grown: _Growth) -> IntArray:
    """Rows whose photo and target are in the network."""
    oriented = np.zeros(len(grown.table.photos), dtype=np.bool_)
    oriented[list(grown.poses)] = True
    return np.nonzero(oriented[grown.table.photo_index] & grown.known[grown.table.target_index])[0]


def _grow(grown: _Growth) -> None:
    """Add photos until none can be added any more."""
    while True:
        most = max(1, int(_GROWTH * len(grown.poses)))
        added = _add_photos(grown, most=most)
        _intersect(grown)
        if added:
            _adjust(grown)
            continue
        # Once more with everything adjusted: better targets may admit photos that failed.
        _adjust(grown)
        _intersect(grown)
        if not _add_photos(grown, most=most):
            break
    _adjust(grown)


def _add_photos(grown: _Growth, *, most: int) -> int:
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
    for _, photo, one in sure[:most]:
        grown.poses[photo] = one.cam_from_world
        grown.failures.pop(photo, None)
    return len(sure[:most])


def _resected(grown: _Growth, photo: int) -> Resection:
    rows = grown.rows_of_photo[photo]
    rows = rows[grown.known[grown.table.target_index[rows]]]
    # Targets from few photos are uncertain too: twice the noise.
    return resect(
        grown.camera(photo),
        grown.points[grown.table.target_index[rows]],
        grown.table.pixels_px[rows],
        grown.covariance(rows) * 4,
        tolerance=_TOLERANCE,
    )


def _looseness(grown: _Growth, photo: int, one: Resection) -> float:
    """Uncertainty of the position over the distance of the targets."""
    rows = grown.rows_of_photo[photo]
    rows = rows[grown.known[grown.table.target_index[rows]]]
    distance = float(
        np.median(np.linalg.norm(one.cam_from_world.apply(grown.points[grown.table.target_index[rows]]), axis=1))
    )
    return float(np.sqrt(np.trace(one.covariance[3:, 3:]))) / distance


def _intersect(grown: _Growth) -> None:
    """Intersect all targets that are not known yet."""
    oriented = np.zeros(len(grown.table.photos), dtype=np.bool_)
    oriented[list(grown.poses)] = True
    rows = np.nonzero(oriented[grown.table.photo_index] & ~grown.known[grown.table.target_index])[0]
    if not rows.size:
        return
    origins, directions, sigma = np.empty((rows.size, 3)), np.empty((rows.size, 3)), np.empty(rows.size)
    for photo in np.unique(grown.table.photo_index[rows]).tolist():
        own = grown.table.photo_index[rows] == photo
        back, camera = grown.poses[photo].inverse(), grown.camera(photo)
        origins[own] = back.translation_m
        directions[own] = back.rotate(camera.cast_rays(grown.table.pixels_px[rows[own]]))
        sigma[own] = ray_sigma_rad(camera, grown.covariance(rows[own]))
    usable = np.isfinite(directions).all(axis=1)
    places = grown.table.target_index[rows[usable]]
    found = intersect_lines(origins[usable], directions[usable], sigma[usable], places, len(grown.points))
    agreeing = np.bincount(places[found.misses < 3 * _TOLERANCE], minlength=len(grown.points))
    new = found.found & (agreeing >= 2) & (found.angle_rad > 2 * LEAST_ANGLE_RAD)
    grown.points[new] = found.points_m[new]


def _adjust(grown: _Growth) -> None:
    """Adjust what is in the network with a robust loss; renew the noise, the misses and what is free."""
    for _ in range(2):
        rows = _rows_in(grown)
        visible = _front(grown, rows)
        rows = rows[visible]
        rays = np.bincount(grown.table.target_index[rows], minlength=len(grown.points))
        lost = grown.known & (rays < 2)
        grown.points[lost] = np.nan
        rows = rows[rays[grown.table.target_index[rows]] >= 2]
        # A far false image point has no pull left under this loss, and half of a pull is enough to be seen.
        table = grown.table.subset(rows).compacted()
        photos = [grown.table.photos.index(name) for name in table.photos]
        place = {name: i for i, name in enumerate(grown.table.targets)}
        targets = np.array([place[name] for name in table.targets], dtype=np.intp)
        scaled = ImagePoints(
            table.photos,
            table.targets,
            table.photo_index,
            table.target_index,
            table.pixels_px,
            table.covariance_px2 * grown.noise**2,
        )
        models = tuple(_bearable(model, grown, index, rows.size) for index, model in enumerate(grown.models))
        problem = BundleProblem(scaled, models, grown.camera_of_photo[photos])
        start = BundleState(
            tuple(grown.cameras),
            np.stack([grown.poses[i].rotation for i in photos]),
            np.stack([grown.poses[i].translation_m for i in photos]),
            grown.points[targets],
        )
        options = BundleOptions(loss=Cauchy(), descent=Options(tolerance=1e-2, initial_damping=1e-4, max_iterations=30))
        result = adjust(problem, start, options=options)
        grown.cameras = list(result.state.cameras)
        grown.points[targets] = result.state.points_m
        for place_in, photo in enumerate(photos):
            grown.poses[photo] = result.state.cam_from_world(place_in)
        misses = np.linalg.norm(result.whitened_residuals, axis=1)
        # Median of the length of two normal components: 1.18 sigma; few redundant ones make residuals too small.
        share = max(result.redundancy / (2 * rows.size), 0.05)
        typical = float(np.median(misses)) / 1.18 / np.sqrt(share)
        before, grown.noise = grown.noise, max(1.0, grown.noise * min(typical, 1.0))
        grown.misses = np.full(grown.table.n, np.inf)
        grown.misses[rows] = misses * before / grown.noise
        if before < 1.5 * grown.noise:
            break


def _front(grown: _Growth, rows: IntArray) -> BoolArray:
    """Mark rows whose target is in front of its camera and inside its lens model."""
    visible = np.zeros(rows.size, dtype=np.bool_)
    for photo in np.unique(grown.table.photo_index[rows]).tolist():
        own = grown.table.photo_index[rows] == photo
        points = grown.poses[photo].apply(grown.points[grown.table.target_index[rows[own]]])
        visible[own] = np.isfinite(grown.camera(photo).project(points)).all(axis=1)
    return visible


def _bearable(model: CameraModel, grown: _Growth, camera: int, n_rows: int) -> CameraModel:
    """Free of a camera what the network bears: nothing, the focal length with K1, all."""
    photos = sum(1 for photo in grown.poses if grown.camera_of_photo[photo] == camera)
    if not model.free or photos < _PHOTOS_FOR_FOCAL:
        return replace(model, free=(), priors=(), prior_covariance=None)
    if photos < 2 * _PHOTOS_FOR_FOCAL or n_rows < 12 * photos:
        free = tuple(name for name in model.free if name in {"focal_px", "k1"})
        return replace(model, free=free, priors=tuple(one for one in model.priors if one.name in free))
    return model


def _finished(grown: _Growth) -> Network:
    """Collect the network, what is left out and what does not agree."""
    table = grown.table
    rows = _rows_in(grown)
    good = rows[grown.misses[rows] <= 2 * _TOLERANCE]
    # A target needs two rays, a photo four targets; one follows from the other.
    while True:
        rays = np.bincount(table.target_index[good], minlength=len(table.targets))
        own = np.bincount(table.photo_index[good], minlength=len(table.photos))
        keep = (rays[table.target_index[good]] >= 2) & (own[table.photo_index[good]] >= LEAST_TARGETS)
        if keep.all():
            break
        good = good[keep]
    kept = table.subset(good).compacted()
    photos = [table.photos.index(name) for name in kept.photos]
    place = {name: i for i, name in enumerate(table.targets)}
    targets = [place[name] for name in kept.targets]
    state = BundleState(
        tuple(grown.cameras),
        np.stack([grown.poses[i].rotation for i in photos]),
        np.stack([grown.poses[i].translation_m for i in photos]),
        grown.points[targets],
    )
    suspicious = []
    for row in np.setdiff1d(rows, good).tolist():
        if (
            table.photos[table.photo_index[row]] in kept.photos
            and table.targets[table.target_index[row]] in kept.targets
        ):
            far = grown.misses[row]
            text = f"{far:.0f} times its sigma off" if np.isfinite(far) else "cannot be seen from there"
            suspicious.append(LeftOut(table.label(row), text))
    return Network(
        kept,
        good,
        grown.camera_of_photo[photos],
        state,
        _photos_left_out(grown, set(photos)),
        _targets_left_out(grown, set(targets)),
        tuple(suspicious),
        grown.noise,
    )


def _photos_left_out(grown: _Growth, kept: set[int]) -> tuple[LeftOut, ...]:
    counts = grown.table.n_targets_in_photo
    result = []
    for photo, name in enumerate(grown.table.photos):
        if photo in kept:
            continue
        few = f"shows {int(counts[photo])} targets, {LEAST_TARGETS} are needed"
        other = grown.failures.get(photo, "too few of its image points agree with the network")
        result.append(LeftOut(name, few if counts[photo] < LEAST_TARGETS else other))
    return tuple(result)


def _targets_left_out(grown: _Growth, kept: set[int]) -> tuple[LeftOut, ...]:
    table, result = grown.table, []
    oriented = np.isin(table.photo_index, list(grown.poses))
    rays = np.bincount(table.target_index[oriented], minlength=len(table.targets))
    for target, name in enumerate(table.targets):
        if target in kept:
            continue
        if rays[target] >= 2:
            reason = f"its {int(rays[target])} lines of sight do not meet in one point, or at too small an angle"
        else:
            photos = [table.photos[i] for i in table.photo_index[table.target_index == target]]
            where = f" ({photos[0]})" if len(photos) == 1 else ""
            reason = f"seen in {int(rays[target])} photos of the network{where}, 2 are needed"
        result.append(LeftOut(name, reason))
    return tuple(result)
