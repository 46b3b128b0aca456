"""Start values of a whole photo network from image points alone: photo by photo, the best-conditioned next."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, IntArray
from photogrammetry.bundle.problem import CameraModel
from photogrammetry.bundle.state import BundleState, camera_with_intrinsics, intrinsics_of
from photogrammetry.image_points import ImagePoints
from photogrammetry.start_values.network_growth import (
    TOLERANCE,
    Growth,
    add_photos,
    adjust_growth,
    appraise,
    grow,
    intersect_new,
    places_of,
    projected,
    rows_inside,
)
from photogrammetry.start_values.relative_pose import (
    LEAST_COMMON,
    RelativePose,
    SharedTargets,
    parallax_rad,
    relate,
    rival_misfit,
)
from photogrammetry.start_values.resection import LEAST_TARGETS
from photogrammetry.start_values.triangulation import LEAST_ANGLE_RAD, ray_sigma_rad

_MOST_PAIRS = 12
# Residuals that stay above this share of what a guessed lens may do say that the network never fitted.
_STUCK = 0.5
_OTHER_FOCALS = (0.4, 2.5)
# Sigmas that are stated too small by less than this are no sign of a lens that does not fit.
_FITTED = 5.0
# Targets of each photo that find its pose: all take part in the adjustment that follows.
_ENOUGH_TARGETS = 50
# A start farther off than this share of the image is not of these photos.
_FAR_START = 0.1


@dataclass(frozen=True, slots=True)
class ImagePlace:
    """A place in a photo.

    photo: Its name.
    x_px, y_px: Where; the centre of the top-left pixel is (0, 0) [px].
    """

    photo: str
    x_px: float
    y_px: float


@dataclass(frozen=True, slots=True)
class LeftOut(ShortRepr):
    """A photo or target that is not in the network.

    reason: Why, with numbers and remedy.
    target: The target of a single image point; empty for everything else.
    is_outlier: Whether it is an image point that contradicts the others.
    place: Where it was seen; None for what is not at one place of one photo.
    """

    name: str
    reason: str
    target: str = ""
    is_outlier: bool = False
    place: ImagePlace | None = None


@dataclass(frozen=True, slots=True, eq=False)
class StartValues(ShortRepr):
    """Poses and targets known about, by name; empty where nothing is.

    cam_from_world: Poses of photos.
    points_m (3,): Coordinates of targets, in the frame of the poses [m].
    """

    cam_from_world: Mapping[str, RigidTransform] = field(default_factory=dict)
    points_m: Mapping[str, FloatArray] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """Start values of the photos and targets that hang together.

    observations: The image points that agree with the network, with the photos and targets that are in it.
    rows: Their places in the image points that were given.
    camera_of_photo: Camera of each photo of the network.
    state: Cameras, poses and targets; frame and scale are arbitrary (first photo, first distance).
    photos_left_out, targets_left_out: What is not in it and why.
    suspicious: Image points of photos and targets in the network that do not agree with it.
    noise: Typical size of the residuals in units of the stated sigmas.
    """

    observations: ImagePoints
    rows: IntArray
    camera_of_photo: IntArray
    state: BundleState
    photos_left_out: tuple[LeftOut, ...]
    targets_left_out: tuple[LeftOut, ...]
    suspicious: tuple[LeftOut, ...]
    noise: float


def build_network(
    observations: ImagePoints,
    cameras: Sequence[Camera],
    *,
    models: Sequence[CameraModel] | None = None,
    camera_of_photo: IntArray | None = None,
    start: StartValues | None = None,
) -> Network:
    """Find start values of poses and targets, from those given or without any.

    observations: All image points, false ones among them.
    cameras: The cameras, calibrated or guessed (`guessed_camera`).
    models: Intrinsics that are free; they are estimated as soon as the network bears it. Known cameras by default.
    camera_of_photo: Camera of each photo; the first by default.
    start: Poses of at least two photos to go on from, instead of choosing a pair; frame and scale of the network
        are theirs. Photos and targets without start values are tied in as always.
    Returns: Start values; photos and targets that could not be tied in are named with the reason.
    EstimationError: No two photos have six common targets seen from different places.

    The pair with many common targets and a wide parallax starts (see `RelativePose`); where it has two
    solutions (targets in one plane), the one that a third photo agrees with better is taken. Then photos follow by
    resection, those whose position becomes most certain first; targets by intersection; an adjustment with Cauchy's
    loss after each growth by a third. Photos that fail are tried again whenever the network has grown.
    """
    index = np.zeros(len(observations.photos), np.intp) if camera_of_photo is None else np.asarray(camera_of_photo)
    chosen = tuple(models) if models else tuple(CameraModel(f"camera {i + 1}") for i in range(len(cameras)))
    mean_sigma = float(np.sqrt(np.median(np.einsum("mii->m", observations.covariance_px2)) / 2))
    # Lens included: image points may be off by so much before anything is adjusted.
    noise_px = [0.002 * one.width_px if model.free else 1.0 for one, model in zip(cameras, chosen, strict=True)]
    noise = np.maximum(1.0, np.array(noise_px) / mean_sigma)
    placed = start is not None and sum(name in start.cam_from_world for name in observations.photos) >= 2
    known = start if placed else None
    found = _attempt(Growth(observations, index, list(cameras), chosen, noise.copy()), known)
    guessed = any("focal_px" in model.free for model in chosen)
    if known is not None or not guessed or found.noise < max(_STUCK * noise.max(), _FITTED):
        return found
    # The residuals stayed as large as the guess of the lens allows: the guess was worse than that.
    attempts = [found]
    for factor in _OTHER_FOCALS:
        others = [
            _with_focal(one, factor if "focal_px" in m.free else 1.0) for one, m in zip(cameras, chosen, strict=True)
        ]
        try:
            attempts.append(_attempt(Growth(observations, index, others, chosen, noise.copy()), None))
        except EstimationError:
            continue
    return min(attempts, key=lambda one: (one.noise, -one.observations.n))


def _attempt(empty: Growth, start: StartValues | None) -> Network:
    sketched = _sketched(empty) if start is None else None
    if sketched is not None:
        return _finished(sketched)
    grown = _started(empty) if start is None else _resumed(empty, start)
    # A start with all photos was adjusted as a whole; only what is missing needs growth.
    if len(grown.poses) < len(grown.table.photos) or not grown.known.all():
        grow(grown)
    return _finished(grown)


def _sketched(empty: Growth) -> Growth | None:
    """Grow with the best connected targets where photos show many; None where those do not tie in all photos.

    Poses need no more: with 115 photos of 1000 targets of 10 000 each, adjustments on the way take a tenth of the time.
    The other targets are intersected; what adjusts them all comes after.
    """
    table = empty.table.subset(_best_connected(empty.table)).compacted()
    if 2 * table.n > empty.table.n or len(table.photos) < len(empty.table.photos):
        return None
    sketch = Growth(table, empty.camera_of_photo, list(empty.cameras), empty.models, empty.noise.copy())
    try:
        sketch = _started(sketch)
        grow(sketch)
    except EstimationError:
        return None
    if len(sketch.poses) < len(table.photos):
        return None
    whole = empty.copy()
    whole.cameras, whole.noise, whole.poses = list(sketch.cameras), sketch.noise.copy(), dict(sketch.poses)
    whole.points[places_of(empty.table.targets, table.targets)] = sketch.points
    intersect_new(whole, least_rad=LEAST_ANGLE_RAD)
    appraise(whole)
    return whole


def _best_connected(table: ImagePoints) -> IntArray:
    """Return the rows of targets seen by most photos, so many that every photo shows enough of them."""
    order = np.argsort(table.target_index, kind="stable")
    bounds = np.searchsorted(table.target_index[order], np.arange(len(table.targets) + 1))
    counts, chosen = np.zeros(len(table.photos), dtype=np.intp), []
    for target in np.argsort(-np.diff(bounds), kind="stable").tolist():
        rows = order[bounds[target] : bounds[target + 1]]
        if (counts[table.photo_index[rows]] < _ENOUGH_TARGETS).any():
            counts[table.photo_index[rows]] += 1
            chosen.append(rows)
    return np.sort(np.concatenate(chosen)) if chosen else np.zeros(0, dtype=np.intp)


def _with_focal(camera: Camera, factor: float) -> Camera:
    values = intrinsics_of(camera)
    values[0] *= factor
    return camera_with_intrinsics(camera, values)


def guessed_camera(width_px: int, height_px: int, *, focal_length_35mm: float | None = None) -> Camera:
    """Return a camera to start a self-calibration from.

    width_px, height_px: Size of the image [px].
    focal_length_35mm: Focal length as EXIF gives it, for a film of 36 mm x 24 mm [mm].
    Returns: Principal point in the middle, no distortion; a focal length of 28 mm where nothing is known.

    >>> guessed_camera(3600, 2400, focal_length_35mm=50.0).focal_x_px
    5000.0
    """
    # The diagonal of 43.27 mm is what the equivalent focal length keeps; for 3:2 images the width gives the same.
    longest = max(width_px, height_px)
    focal_px = longest * (focal_length_35mm or 28.0) / 36.0
    return Camera(width_px, height_px, focal_px, focal_px, 0.5 * (width_px - 1), 0.5 * (height_px - 1))


def _resumed(empty: Growth, start: StartValues) -> Growth:
    """Go on from poses and targets that are given."""
    for place, photo in enumerate(empty.table.photos):
        if photo in start.cam_from_world:
            empty.poses[place] = start.cam_from_world[photo]
    for place, target in enumerate(empty.table.targets):
        if target in start.points_m:
            empty.points[place] = start.points_m[target]
    intersect_new(empty)
    rows = rows_inside(empty)
    misses = np.linalg.norm(projected(empty, rows) - empty.table.pixels_px[rows], axis=1)
    typical = float(np.median(np.nan_to_num(misses, nan=np.inf))) if rows.size else np.inf
    if typical > _FAR_START * empty.cameras[0].width_px:
        raise EstimationError(
            f"network: most image points are {typical:.0f} px or more from where the given start has them; are its "
            "poses cam_from_world and of one model with its points, and is the camera right?"
        )
    adjust_growth(empty)
    intersect_new(empty)
    return empty


def _started(empty: Growth) -> Growth:
    """Choose a pair and one of its solutions."""
    reasons, best = [], None
    for first, second in _pairs(empty):
        names = f"{empty.table.photos[first]} - {empty.table.photos[second]}"
        try:
            solutions = relate(_shared(empty, first, second)[0], tolerance=TOLERANCE)
        except EstimationError as error:
            reasons.append(f"{names}: {error}")
            continue
        fine = solutions[0].inliers.mean() > 0.6 and solutions[0].angle_rad > 2 * LEAST_ANGLE_RAD
        rivals = [one for one in solutions if one.misfit < rival_misfit(solutions[0].misfit)]
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


def _why_no_pair(empty: Growth) -> str:
    if len(empty.table.photos) < 2:
        return f"only {empty.table.photos[0]} shows targets; take photos from two places or more"
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


def _pairs(empty: Growth) -> list[tuple[int, int]]:
    """Order pairs of photos by common targets times parallax; only pairs with a parallax above the noise."""
    seen = _visibility(empty.table)
    common = np.triu(seen @ seen.T, 1)
    first, second = np.nonzero(common >= LEAST_COMMON)
    # 300 pairs are measured, spread over all counts when there are more.
    order = np.argsort(-common[first, second], kind="stable")
    order = order[np.unique(np.linspace(0, max(order.size - 1, 0), 300).astype(int))] if order.size > 300 else order
    table, scored = empty.table, []
    rays, sigma = np.empty((table.n, 3)), np.empty(table.n)
    owners = empty.camera_of_photo[table.photo_index]
    for camera in np.unique(owners).tolist():
        own = np.nonzero(owners == camera)[0]
        rays[own] = empty.cameras[camera].cast_rays(table.pixels_px[own])
        sigma[own] = ray_sigma_rad(empty.cameras[camera], empty.covariance(own))
    for place in order.tolist():
        rows, _ = _shared_rows(empty, int(first[place]), int(second[place]))
        usable = np.isfinite(rays[rows]).all(axis=(0, 2))
        if usable.sum() < LEAST_COMMON:
            continue
        parallax = parallax_rad(rays[rows[:, usable]])
        if parallax > 3 * float(np.median(sigma[rows])):
            score = float(common[first[place], second[place]]) * min(parallax, 0.2)
            trust = _trust(empty, int(first[place]), int(second[place]))
            scored.append((trust * score, int(first[place]), int(second[place])))
    scored.sort(reverse=True)
    return [(a, b) for _, a, b in scored[:_MOST_PAIRS]]


def _trust(empty: Growth, first: int, second: int) -> float:
    """Prefer pairs of a camera that is known, then of one camera: two wrong focal lengths are worse than one."""
    cameras = {int(empty.camera_of_photo[first]), int(empty.camera_of_photo[second])}
    guesses = sum("focal_px" in empty.models[camera].free for camera in cameras)
    return float(0.2**guesses)


def _shared_rows(grown: Growth, first: int, second: int) -> tuple[IntArray, IntArray]:
    """Return the rows of what two photos both show, shape (2, n), and the targets."""
    rows_a, rows_b = grown.rows_of_photo[first], grown.rows_of_photo[second]
    targets, a, b = np.intersect1d(
        grown.table.target_index[rows_a], grown.table.target_index[rows_b], return_indices=True
    )
    return np.stack([rows_a[a], rows_b[b]]), targets


def _shared(grown: Growth, first: int, second: int) -> tuple[SharedTargets, IntArray]:
    rows, targets = _shared_rows(grown, first, second)
    covariance = np.stack([grown.covariance(rows[0]), grown.covariance(rows[1])])
    cameras = (grown.camera(first), grown.camera(second))
    return SharedTargets(cameras, grown.table.pixels_px[rows], covariance), targets


def _tried(empty: Growth, pair: tuple[int, int], solution: RelativePose) -> tuple[float, Growth]:
    """Start with one solution of a pair and see how well a third photo agrees with it."""
    grown = empty.copy()
    _, targets = _shared(grown, *pair)
    grown.poses = {pair[0]: RigidTransform.identity(), pair[1]: solution.second_from_first}
    grown.points[targets[solution.inliers]] = solution.points_m[solution.inliers]
    score = solution.misfit
    added = add_photos(grown, most=1)
    if added:
        intersect_new(grown)
        adjust_growth(grown)
        rows = rows_inside(grown)
        score += float(np.mean(np.minimum(grown.misses[rows], TOLERANCE) ** 2))
    return score, grown


def _finished(grown: Growth) -> Network:
    """Collect the network, what is left out and what does not agree."""
    table = grown.table
    rows = rows_inside(grown)
    good = rows[grown.misses[rows] <= 2 * TOLERANCE]
    # A target needs two rays, a photo four targets; one follows from the other.
    while True:
        rays = np.bincount(table.target_index[good], minlength=len(table.targets))
        own = np.bincount(table.photo_index[good], minlength=len(table.photos))
        keep = (rays[table.target_index[good]] >= 2) & (own[table.photo_index[good]] >= LEAST_TARGETS)
        if keep.all():
            break
        good = good[keep]
    kept = table.subset(good).compacted()
    photos, targets = places_of(table.photos, kept.photos), places_of(table.targets, kept.targets)
    state = grown.state(photos, targets)
    suspicious = []
    for row in np.setdiff1d(rows, good).tolist():
        if (
            table.photos[table.photo_index[row]] in kept.photos
            and table.targets[table.target_index[row]] in kept.targets
        ):
            far = grown.misses[row]
            text = f"{far:.0f} times its sigma off" if np.isfinite(far) else "cannot be seen from there"
            target = table.targets[table.target_index[row]]
            place = ImagePlace(table.photos[table.photo_index[row]], *table.pixels_px[row].tolist())
            suspicious.append(LeftOut(table.label(row), text, target, bool(np.isfinite(far)), place))
    return Network(
        kept,
        good,
        grown.camera_of_photo[photos],
        state,
        _photos_left_out(grown, set(photos.tolist())),
        _targets_left_out(grown, set(targets.tolist())),
        tuple(suspicious),
        float(grown.noise.max()),
    )


def _photos_left_out(grown: Growth, kept: set[int]) -> tuple[LeftOut, ...]:
    counts = grown.table.n_targets_in_photo
    result = []
    for photo, name in enumerate(grown.table.photos):
        if photo in kept:
            continue
        few = f"shows {int(counts[photo])} targets, {LEAST_TARGETS} are needed"
        other = grown.failures.get(photo, "too few of its image points agree with the network")
        result.append(LeftOut(name, few if counts[photo] < LEAST_TARGETS else other))
    return tuple(result)


def _targets_left_out(grown: Growth, kept: set[int]) -> tuple[LeftOut, ...]:
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
