"""From image points to an adjusted network: start values, eccentricity, outliers, sigmas."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from heliogauge.adjust.least_squares import Prior
from heliogauge.adjust.solution import CovarianceScale
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError, InputError
from heliogauge.validate import FloatArray, IntArray
from photogrammetry.bundle.adjustment import BundleOptions, BundleResult, adjust, descend
from photogrammetry.bundle.alignment import aligned_to_constraints, aligned_to_control, best_fit, transformed
from photogrammetry.bundle.constraints import Constraint, ControlPoint, Distance, KnownPlaces
from photogrammetry.bundle.datum import Datum, DatumKind
from photogrammetry.bundle.eccentricity import eccentricities_px, estimate_discs
from photogrammetry.bundle.problem import BundleProblem, CameraModel
from photogrammetry.bundle.state import INTRINSIC_NAMES, BundleState, intrinsics_of
from photogrammetry.bundle.statistics import Rejected, adjust_and_reject, examine_image_points
from photogrammetry.image_points import ImagePoints
from photogrammetry.networks.foreign_photos import ContradictingPhotos, contradicting_photos
from photogrammetry.start_values.network import LeftOut, Network, StartValues, build_network

#: Known lengths that differ from the network by this share, and by ten sigma, are mistakes and no measurements.
_GROSS_SHARE, _GROSS_SIGMAS = 0.2, 10.0
#: Photos, targets and intrinsics that are left out one after the other, and the share of all photos or targets that may
#: be concerned: where more are, the network as a whole is too weak.
_MOST_WEAK, _FEW_SHARE = 12, 0.25
#: Sigmas of intrinsics that the photos do not determine: what cameras and lenses have in any case.
_WEAK_PRIORS = {
    "aspect": 1e-3,
    "center_x_px": 50.0,
    "center_y_px": 50.0,
    "skew": 1e-3,
    "k1": 0.1,
    "k2": 0.1,
    "k3": 0.1,
    "p1": 1e-3,
    "p2": 1e-3,
}
#: Sigmas from residuals need this many to spare to be worth more than the stated ones.
_LEAST_REDUNDANCY = 20


@dataclass(frozen=True, slots=True, eq=False)
class Knowledge:
    """What is known besides image points.

    constraints: Scale bars, distances, coordinates, planes, weighted control points.
    fixed_m (3,): Control points without error [m].
    start: Poses and targets to start from; where nothing else defines them, position, rotation and scale are theirs.
    one_target_size: Whether all targets are equally large, whatever their size: helps the correction of
        eccentricity.
    """

    constraints: tuple[Constraint, ...]
    fixed_m: dict[str, FloatArray]
    datum: Datum
    start: StartValues = field(default_factory=StartValues)
    one_target_size: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class NetworkCameras:
    """The cameras of a network.

    cameras: To start from.
    models: What of each is free.
    camera_of: Which camera took each photo.
    InputError: Not as many models as cameras.
    """

    cameras: tuple[Camera, ...]
    models: tuple[CameraModel, ...]
    camera_of: Mapping[str, int]

    def __post_init__(self) -> None:
        if len(self.cameras) != len(self.models) or not self.cameras:
            raise InputError(f"cameras: {len(self.cameras)} cameras, but {len(self.models)} models")

    @classmethod
    def of(cls, bundle: BundleResult) -> "NetworkCameras":
        """Return the cameras of an adjusted network."""
        problem = bundle.problem
        owners = dict(zip(problem.observations.photos, problem.camera_index.tolist(), strict=True))
        return cls(bundle.state.cameras, problem.cameras, owners)

    def index(self, photos: Sequence[str]) -> IntArray:
        """Return the camera of each photo."""
        return np.array([self.camera_of[name] for name in photos], dtype=np.intp)

    def with_prior(self, camera: str, name: str, sigma: float) -> "NetworkCameras":
        """Return the same with an intrinsic of one camera held near its start.

        camera, name: Name of the camera and of the intrinsic.
        sigma: Standard deviation, in the unit of the intrinsic.
        """
        models = []
        for model, start in zip(self.models, self.cameras, strict=True):
            if model.name == camera:
                value = float(intrinsics_of(start)[INTRINSIC_NAMES.index(name)])
                model = replace(model, priors=(*model.priors, Prior(name, value, sigma)))
            models.append(model)
        return NetworkCameras(self.cameras, tuple(models), self.camera_of)

    def held_without(self, photos: Sequence[str]) -> "NetworkCameras":
        """Return the same with nothing estimated of cameras that took none of some photos."""
        used = {self.camera_of[name] for name in photos}
        models = tuple(
            one if place in used else replace(one, free=(), priors=(), prior_covariance=None, prior_values=None)
            for place, one in enumerate(self.models)
        )
        return NetworkCameras(self.cameras, models, self.camera_of)

    def problem(self, table: ImagePoints) -> BundleProblem:
        """Return the free network of image points: nothing known, inner constraints."""
        return BundleProblem(table, self.models, self.index(table.photos))


@dataclass(frozen=True, slots=True)
class SolveOptions:
    """How to solve.

    reject: Leave out image points that contradict the others.
    family_significance: Probability of leaving out any good one of all.
    rescale: Take the size of the image points' sigmas from their residuals; their ratios stay.
    """

    reject: bool = True
    family_significance: float = 0.05
    rescale: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """An adjusted network and how it came about.

    network: Start values, and what is not in it.
    bundle: The adjustment.
    rejected: Image points left out by the adjustment.
    largest_eccentricity_px: Largest correction of a centre [px].
    image_sigma_factor: By what the stated sigmas of the image points were multiplied.
    unused: Constraints whose targets are not in the network.
    weak: Photos, targets and intrinsics that are not determined: left out, or held near their start.
    doubtful: Photos that are used though more of their image points contradict the others than chance explains.
    """

    network: Network
    bundle: BundleResult
    rejected: tuple[Rejected, ...]
    largest_eccentricity_px: float
    image_sigma_factor: float
    unused: tuple[LeftOut, ...]
    weak: tuple[LeftOut, ...] = ()
    doubtful: tuple[LeftOut, ...] = ()


def solve_network(
    points: ImagePoints,
    ellipses_px2: FloatArray,
    cameras: NetworkCameras,
    knowledge: Knowledge,
    options: SolveOptions,
) -> Solved:
    """Solve a photo network without any start values.

    points: All image points, false ones among them.
    ellipses_px2 (m, 2, 2): Ellipses of the targets; NaN where there is none [px^2].
    knowledge: Scale bars, control points, constraints and datum.
    EstimationError: The photos do not hang together, or something is not determined; it is named.
    """
    network = network_of(points, cameras, knowledge)
    return solve_from(network, points, ellipses_px2, cameras, knowledge, options)


def network_of(points: ImagePoints, cameras: NetworkCameras, knowledge: Knowledge) -> Network:
    """Find start values of a photo network.

    EstimationError: The photos do not hang together.
    """
    return build_network(
        points,
        cameras.cameras,
        models=cameras.models,
        camera_of_photo=cameras.index(points.photos),
        start=knowledge.start,
    )


def solve_from(
    network: Network,
    points: ImagePoints,
    ellipses_px2: FloatArray,
    cameras: NetworkCameras,
    knowledge: Knowledge,
    options: SolveOptions,
    *,
    before: Solved | None = None,
) -> Solved:
    """Solve a photo network from start values.

    network: Start values; its rows are those of the image points.
    before: The same image points solved with other sigmas: what was rejected there waits until the others are clean.
    points: All image points, false ones among them.
    ellipses_px2 (m, 2, 2): Ellipses of the targets; NaN where there is none [px^2].
    cameras: What of the cameras is free, and whose the photos are.
    knowledge: Scale bars, control points, constraints and datum.
    EstimationError: Something is not determined, or known lengths contradict each other by more than a fifth; it is
        named.
    """
    rows = _with_suspicious(points, network)
    table = points.subset(rows).compacted()
    if (network.observations.photos, network.observations.targets) != (table.photos, table.targets):
        raise EstimationError("network: photos or targets were lost between start values and adjustment")
    suspects = ~np.isin(rows, network.rows) & options.reject
    waiting = () if before is None else before.rejected
    suspects[_waiting_rows(table, waiting)] = True
    chosen = BundleOptions(covariance_scale=CovarianceScale.POSTERIOR if options.rescale else CovarianceScale.PRIOR)
    state, shift = network.state, np.zeros((table.n, 2))
    if np.isfinite(ellipses_px2[rows]).any():
        if before is None:
            state = descend(cameras.problem(table.subset(~suspects)), state, chosen).state
        place = cameras.index(table.photos)
        discs = estimate_discs(table, ellipses_px2[rows], state, place, one_size=knowledge.one_target_size)
        shift = eccentricities_px(table, discs, state, place)
        table = replace(table, pixels_px=table.pixels_px - shift)
    rejected: tuple[Rejected, ...] = ()
    doubtful: tuple[LeftOut, ...] = ()
    network = replace(network, suspicious=network.suspicious if options.reject else ())
    if options.reject:
        # Without constraints: a wrong scale bar must not make the image points of its targets look wrong.
        alone, rejected = adjust_and_reject(
            cameras.problem(table),
            state,
            options=chosen,
            family_significance=options.family_significance,
            suspects=suspects,
        )
        if waiting:
            back = np.isin(table.pair_keys[[one.row for one in waiting]], alone.problem.observations.pair_keys)
            rejected = (*(one for one, is_back in zip(waiting, back, strict=True) if not is_back), *rejected)
        whole, table, state = table, alone.problem.observations, alone.state
        network = _without_innocent(network, table)
        foreign, doubtful = _contradicting(whole, alone, rejected, options)
        network, rejected = _without_photos(network, whole, rejected, foreign)
        keep = ~np.isin(np.array(table.photos)[table.photo_index], [one.name for one in foreign])
        table, state = _without_empty(table.subset(keep), state)
    bundle, unused, weak = _adjust_determined(table, state, cameras, knowledge, chosen)
    factor = 1.0
    if options.rescale:
        bundle, factor = _rescale(bundle)
    largest = float(np.linalg.norm(shift, axis=1).max(initial=0.0))
    return Solved(network, bundle, rejected, largest, factor, unused, weak, doubtful)


class _Adjusted(NamedTuple):
    """An adjustment in which all is determined, known values that it does not use, and what was left out for that."""

    bundle: BundleResult
    unused: tuple[LeftOut, ...]
    weak: tuple[LeftOut, ...]


def _adjust_determined(
    table: ImagePoints, state: BundleState, cameras: NetworkCameras, knowledge: Knowledge, options: BundleOptions
) -> _Adjusted:
    """Adjust with all that is known, without the few photos, targets and intrinsics that are not determined.

    EstimationError: More than a few are not, or nothing that could be left out.
    """
    weak: list[LeftOut] = []
    for _ in range(_MOST_WEAK):
        problem, unused = _problem(table, cameras, knowledge)
        placed = _place(state, table, problem, knowledge)
        _refuse_gross_lengths(problem, placed)
        bundle = adjust(problem, placed, options=options)
        defect = bundle.defects[0] if bundle.defects else None
        if defect is None:
            break
        loose = [name for name in defect.intrinsics if not name.startswith("focal_px")]
        if not defect.photos and not defect.intrinsics and len(defect.targets) <= _FEW_SHARE * len(table.targets):
            keep = ~np.isin(np.array(table.targets)[table.target_index], defect.targets)
            weak += [LeftOut(name, "left out: its rays do not determine it") for name in defect.targets]
        elif defect.photos and len(defect.photos) <= _FEW_SHARE * len(table.photos):
            photo = defect.photos[0]
            keep = np.array(table.photos)[table.photo_index] != photo
            count = int(np.count_nonzero(~keep))
            weak.append(LeftOut(photo, f"left out: its {count} image points do not determine its pose"))
        elif loose and len(loose) == len(defect.intrinsics):
            name, _, camera = loose[0].partition(" of ")
            cameras = cameras.with_prior(camera, name, _WEAK_PRIORS[name])
            held = f"the photos do not determine it: held near its start, sigma {_WEAK_PRIORS[name]:g}"
            weak.append(LeftOut(loose[0], held))
            continue
        else:
            break
        table, state = _without_empty(table.subset(keep), state)
        cameras = cameras.held_without(table.photos)
    return _Adjusted(bundle.require(), unused, tuple(weak))


def _with_suspicious(points: ImagePoints, network: Network) -> np.ndarray:
    """Return the rows of all photos and targets of the network, also those that do not agree with it."""
    photos = np.isin(np.array(points.photos)[points.photo_index], network.observations.photos)
    targets = np.isin(np.array(points.targets)[points.target_index], network.observations.targets)
    return np.nonzero(photos & targets)[0]


def _waiting_rows(table: ImagePoints, rejected: tuple[Rejected, ...]) -> IntArray:
    """Return the rows of rejected image points, without those of targets that would keep fewer than two rays."""
    rows = np.array([one.row for one in rejected], dtype=np.intp)
    rays = table.n_rays - np.bincount(table.target_index[rows], minlength=len(table.targets))
    return np.asarray(rows[rays[table.target_index[rows]] >= 2])


def _without_empty(table: ImagePoints, state: BundleState) -> tuple[ImagePoints, BundleState]:
    """Leave out photos and targets of which every image point was rejected."""
    photos, targets = np.nonzero(table.n_targets_in_photo)[0], np.nonzero(table.n_rays)[0]
    left = BundleState(state.cameras, state.rotations[photos], state.translations_m[photos], state.points_m[targets])
    return table.compacted(), left


def _without_innocent(network: Network, table: ImagePoints) -> Network:
    """Take suspicions back of image points that turned out to agree."""
    if not network.suspicious:
        return network
    names = {one.name for one in network.suspicious}
    targets = {one.target for one in network.suspicious}
    rows = np.flatnonzero(np.isin(table.target_index, [k for k, name in enumerate(table.targets) if name in targets]))
    names -= {table.label(row) for row in rows.tolist()}
    return replace(network, suspicious=tuple(one for one in network.suspicious if one.name in names))


def _contradicting(
    table: ImagePoints, alone: BundleResult, rejected: tuple[Rejected, ...], options: SolveOptions
) -> ContradictingPhotos:
    """Find photos that contradict the others as a whole.

    table: All image points.
    alone: The adjustment of those that agree.
    """
    agreeing = alone.problem.observations
    false = ~np.isin(table.pair_keys, agreeing.pair_keys)
    false[[one.row for one in rejected if not one.is_outlier]] = False
    return contradicting_photos(
        table, agreeing, alone.state.points_m, np.flatnonzero(false), significance=options.family_significance
    )


def _without_photos(
    network: Network, table: ImagePoints, rejected: tuple[Rejected, ...], photos: tuple[LeftOut, ...]
) -> tuple[Network, tuple[Rejected, ...]]:
    """Note photos that are left out in place of their image points."""
    if not photos:
        return network, rejected
    names = {one.name for one in photos}
    before = tuple(one for one in network.photos_left_out if one.name not in names)
    suspicious = tuple(one for one in network.suspicious if one.place is None or one.place.photo not in names)
    network = replace(network, photos_left_out=(*before, *photos), suspicious=suspicious)
    return network, tuple(one for one in rejected if table.photos[table.photo_index[one.row]] not in names)


def _problem(
    table: ImagePoints, cameras: NetworkCameras, knowledge: Knowledge
) -> tuple[BundleProblem, tuple[LeftOut, ...]]:
    """Keep what is known of targets in the network; name the rest."""
    seen, unused = set(table.targets), []
    constraints: list[Constraint] = []
    for one in knowledge.constraints:
        missing = [name for name in one.targets if name not in seen]
        if isinstance(one, KnownPlaces) and len(missing) < len(one.targets):
            constraints.append(one.of(seen))
        elif missing:
            # A control point has its target in its name.
            which = "" if isinstance(one, ControlPoint) else f"{', '.join(missing)} is "
            unused.append(LeftOut(one.name, f"not used: {which}not in the network"))
        else:
            constraints.append(one)
    fixed = tuple(name for name in knowledge.fixed_m if name in seen)
    unused += [
        LeftOut(f"control point {name}", "not used: not in the network")
        for name in knowledge.fixed_m
        if name not in seen
    ]
    datum = knowledge.datum
    lost = tuple(name for name in datum.targets if name not in seen)
    if lost and datum.kind is DatumKind.INNER and len(lost) < len(datum.targets):
        unused += [LeftOut(f"datum target {name}", "not used: not in the network") for name in lost]
        datum = replace(datum, targets=tuple(name for name in datum.targets if name in seen))
    free = cameras.problem(table)
    return replace(free, constraints=tuple(constraints), fixed=fixed, datum=datum), tuple(unused)


def _place(state: BundleState, table: ImagePoints, problem: BundleProblem, knowledge: Knowledge) -> BundleState:
    """Put the network where control points or constraints want it; else round its own middle."""
    if problem.fixed:
        control = {name: knowledge.fixed_m[name] for name in problem.fixed}
        return aligned_to_control(state, table.targets, control)
    control = {one.target: one.xyz_m for one in problem.constraints if isinstance(one, ControlPoint)}
    for one in problem.constraints:
        if isinstance(one, KnownPlaces):
            control.update(zip(one.targets, one.places_m, strict=True))
    if len(control) >= 3:
        return aligned_to_control(state, table.targets, control)
    chosen = problem.datum.targets or table.targets
    given = {name: knowledge.start.points_m[name] for name in chosen if name in knowledge.start.points_m}
    lengths_only = all(isinstance(one, Distance) for one in problem.constraints)
    if lengths_only and len(given) >= 3:
        # Growing moved the network a little; inner constraints refer to the start. Lengths keep their say in the scale.
        scaled = aligned_to_constraints(state, table.targets, problem.constraints)
        return best_fit(scaled, table.targets, given, with_scale=not problem.constraints)
    placed = aligned_to_constraints(state, table.targets, problem.constraints)
    if problem.datum.kind is DatumKind.PHOTOS and lengths_only:
        # The world is the first photo's camera.
        return transformed(placed, placed.cam_from_world(table.photos.index(problem.datum.photos[0])))
    return placed


def _refuse_gross_lengths(problem: BundleProblem, placed: BundleState) -> None:
    """Refuse known lengths of another unit or of other targets: no adjustment could follow them and the rest."""
    place = {name: i for i, name in enumerate(problem.observations.targets)}
    texts = []
    for one in problem.constraints:
        if not isinstance(one, Distance):
            continue
        ends = placed.points_m[[place[one.target_a], place[one.target_b]]]
        own = float(np.linalg.norm(ends[1] - ends[0]))
        if abs(own - one.distance_m) > max(_GROSS_SHARE * one.distance_m, _GROSS_SIGMAS * one.sigma_m):
            texts.append(f"{one.name} is given as {one.distance_m:.6g} m and measures {own:.6g} m")
    if texts:
        raise EstimationError(
            f"network: at the scale of all that is known, {'; '.join(texts)}: known lengths (and control points) "
            "contradict each other; check their units (metres) and targets, and that no photo is mirrored"
        )


def _rescale(bundle: BundleResult) -> tuple[BundleResult, float]:
    """Take the sigmas of the image points from their residuals; what is known otherwise keeps its own.

    One factor for all: a scale bar whose sigma is right must not pay for image points whose sigma is not.
    """
    factor = 1.0
    for _ in range(3):
        redundancy = float(np.einsum("mii->", examine_image_points(bundle).redundancy))
        if redundancy < _LEAST_REDUNDANCY:
            break
        change = float((bundle.whitened_residuals**2).sum()) / redundancy
        factor *= change
        table = bundle.problem.observations
        scaled = replace(table, covariance_px2=table.covariance_px2 * change)
        options = replace(bundle.options, covariance_scale=CovarianceScale.PRIOR)
        bundle = adjust(replace(bundle.problem, observations=scaled), bundle.state, options=options).require()
        if abs(change - 1) < 1e-3:
            break
    return bundle, float(np.sqrt(factor))
