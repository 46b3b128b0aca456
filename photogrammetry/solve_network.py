"""From image points to an adjusted network: start values, eccentricity, outliers, sigmas."""

from dataclasses import dataclass, field, replace

import numpy as np

from heliogauge.camera import Camera
from heliogauge.errors import EstimationError
from heliogauge.solution import CovarianceScale
from heliogauge.validate import FloatArray
from photogrammetry.alignment import aligned_to_constraints, aligned_to_control
from photogrammetry.bundle import BundleOptions, BundleProblem, BundleResult, BundleState, CameraModel, Datum, adjust
from photogrammetry.bundle_diagnosis import require
from photogrammetry.bundle_statistics import Rejected, adjust_and_reject, examine_image_points
from photogrammetry.constraints import Constraint, ControlPoint
from photogrammetry.eccentricity import eccentricities_px, estimate_discs
from photogrammetry.network import LeftOut, Network, StartValues, build_network
from photogrammetry.observations import ImagePoints

__all__ = ["Knowledge", "SolveOptions", "Solved", "solve_from", "solve_network"]

#: Sigmas from residuals need this many to spare to be worth more than the stated ones.
_LEAST_REDUNDANCY = 20


@dataclass(frozen=True, slots=True, eq=False)
class Knowledge:
    """What is known besides image points.

    Parameters
    ----------
    constraints : tuple of Constraint
        Scale bars, distances, coordinates, planes, weighted control points.
    fixed_m : dict of str to ndarray, shape (3,)
        Control points without error [m].
    datum : Datum
        The datum.
    start : StartValues, optional
        Poses and targets to start from; where nothing else says it, position, rotation and scale are theirs.
    """

    constraints: tuple[Constraint, ...]
    fixed_m: dict[str, FloatArray]
    datum: Datum
    start: StartValues = field(default_factory=StartValues)


@dataclass(frozen=True, slots=True)
class SolveOptions:
    """How to solve.

    Parameters
    ----------
    reject : bool
        Leave out image points that contradict the others.
    family_significance : float
        Probability of leaving out any good one of all.
    rescale : bool
        Take the size of the image points' sigmas from their residuals; their ratios stay.
    """

    reject: bool = True
    family_significance: float = 0.05
    rescale: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """An adjusted network and how it came about.

    Parameters
    ----------
    network : Network
        Start values, and what is not in it.
    bundle : BundleResult
        The adjustment.
    rejected : tuple of Rejected
        Image points left out by the adjustment.
    largest_eccentricity_px : float
        Largest correction of a centre [px].
    image_sigma_factor : float
        By what the stated sigmas of the image points were multiplied.
    unused : tuple of LeftOut
        Constraints whose targets are not in the network.
    """

    network: Network
    bundle: BundleResult
    rejected: tuple[Rejected, ...]
    largest_eccentricity_px: float
    image_sigma_factor: float
    unused: tuple[LeftOut, ...]


def solve_network(
    points: ImagePoints,
    ellipses_px2: FloatArray,
    cameras: tuple[Camera, CameraModel],
    knowledge: Knowledge,
    options: SolveOptions,
) -> Solved:
    """Solve a photo network without any start values.

    Parameters
    ----------
    points : ImagePoints
        All image points, false ones among them.
    ellipses_px2 : ndarray, shape (m, 2, 2)
        Ellipses of the targets; NaN where there is none [px^2].
    cameras : (Camera, CameraModel)
        The camera to start from and what of it is free.
    knowledge : Knowledge
        Scale bars, control points, constraints and datum.
    options : SolveOptions
        How to solve.

    Returns
    -------
    Solved
        The adjusted network.

    Raises
    ------
    EstimationError
        The photos do not hang together, or something is not determined; it is named.
    """
    camera, model = cameras
    network = build_network(points, [camera], models=[model], start=knowledge.start)
    return solve_from(network, points, ellipses_px2, model, knowledge, options)


def solve_from(
    network: Network,
    points: ImagePoints,
    ellipses_px2: FloatArray,
    model: CameraModel,
    knowledge: Knowledge,
    options: SolveOptions,
) -> Solved:
    """Solve a photo network from start values.

    Parameters
    ----------
    network : Network
        Start values; its rows are those of the image points.
    points : ImagePoints
        All image points, false ones among them.
    ellipses_px2 : ndarray, shape (m, 2, 2)
        Ellipses of the targets; NaN where there is none [px^2].
    model : CameraModel
        What of the camera is free.
    knowledge : Knowledge
        Scale bars, control points, constraints and datum.
    options : SolveOptions
        How to solve.

    Returns
    -------
    Solved
        The adjusted network.

    Raises
    ------
    EstimationError
        Something is not determined; it is named.
    """
    rows = network.rows if options.reject else _with_suspicious(points, network)
    table = points.subset(rows).compacted()
    network = network if options.reject else _complete(network, table)
    chosen = BundleOptions(covariance_scale=CovarianceScale.POSTERIOR if options.rescale else CovarianceScale.PRIOR)
    state, shift = network.state, np.zeros((table.n, 2))
    if np.isfinite(ellipses_px2[rows]).any():
        shift, state = _decentred(BundleProblem(table, (model,)), state, ellipses_px2[rows], chosen)
        table = replace(table, pixels_px=table.pixels_px - shift)
    rejected: tuple[Rejected, ...] = ()
    if options.reject:
        # Without constraints: a wrong scale bar must not make the image points of its targets look wrong.
        alone, rejected = adjust_and_reject(
            BundleProblem(table, (model,)), state, options=chosen, family_significance=options.family_significance
        )
        table, state = alone.problem.observations, alone.state
        table, state = _without_empty(table, state)
    problem, unused = _problem(table, model, knowledge)
    bundle = require(adjust(problem, _placed(state, table, problem, knowledge), options=chosen))
    factor = 1.0
    if options.rescale:
        bundle, factor = _rescaled(bundle)
    largest = float(np.linalg.norm(shift, axis=1).max(initial=0.0))
    return Solved(network, bundle, rejected, largest, factor, unused)


def _with_suspicious(points: ImagePoints, network: Network) -> np.ndarray:
    """Return the rows of all photos and targets of the network, also those that do not agree with it."""
    photos = np.isin(np.array(points.photos)[points.photo_index], network.observations.photos)
    targets = np.isin(np.array(points.targets)[points.target_index], network.observations.targets)
    return np.nonzero(photos & targets)[0]


def _without_empty(table: ImagePoints, state: BundleState) -> tuple[ImagePoints, BundleState]:
    """Leave out photos and targets of which every image point was rejected."""
    photos, targets = np.nonzero(table.n_targets_in_photo)[0], np.nonzero(table.n_rays)[0]
    left = BundleState(state.cameras, state.rotations[photos], state.translations_m[photos], state.points_m[targets])
    return table.compacted(), left


def _complete(network: Network, table: ImagePoints) -> Network:
    """Return the network without suspicions, for an adjustment that keeps every image point."""
    if (network.observations.photos, network.observations.targets) != (table.photos, table.targets):
        raise EstimationError("network: photos or targets were lost between start values and adjustment")
    return replace(network, suspicious=())


def _problem(table: ImagePoints, model: CameraModel, knowledge: Knowledge) -> tuple[BundleProblem, tuple[LeftOut, ...]]:
    """Keep what is known of targets in the network; name the rest."""
    seen, unused = set(table.targets), []
    constraints = []
    for one in knowledge.constraints:
        missing = [name for name in one.targets if name not in seen]
        if missing:
            unused.append(LeftOut(one.name, f"not used: {', '.join(missing)} is not in the network"))
        else:
            constraints.append(one)
    fixed = tuple(name for name in knowledge.fixed_m if name in seen)
    unused += [LeftOut(f"control point {name}", "not used: not in the network") for name in knowledge.fixed_m
               if name not in seen]  # fmt: skip
    return BundleProblem(table, (model,), None, tuple(constraints), fixed, knowledge.datum), tuple(unused)


def _placed(state: BundleState, table: ImagePoints, problem: BundleProblem, knowledge: Knowledge) -> BundleState:
    """Put the network where control points or constraints want it; else round its own middle."""
    if problem.fixed:
        control = {name: knowledge.fixed_m[name] for name in problem.fixed}
        return aligned_to_control(state, table.targets, control)
    control = {one.target: one.xyz_m for one in problem.constraints if isinstance(one, ControlPoint)}
    if len(control) >= 3:
        return aligned_to_control(state, table.targets, control)
    given = {name: knowledge.start.points_m[name] for name in table.targets if name in knowledge.start.points_m}
    if not problem.constraints and len(given) >= 3:
        # Growing moved the network a little; inner constraints refer to the start.
        return aligned_to_control(state, table.targets, given)
    return aligned_to_constraints(state, table.targets, problem.constraints)


def _decentred(
    problem: BundleProblem, state: BundleState, ellipses_px2: FloatArray, options: BundleOptions
) -> tuple[FloatArray, BundleState]:
    """Find by how much ellipse centres are beside the images of the targets' centres."""
    first = adjust(problem, state, options=options)
    table, cameras = problem.observations, problem.camera_index
    discs = estimate_discs(table, ellipses_px2, first.state, cameras)
    return eccentricities_px(table, discs, first.state, cameras), first.state


def _rescaled(bundle: BundleResult) -> tuple[BundleResult, float]:
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
        bundle = require(adjust(replace(bundle.problem, observations=scaled), bundle.state, options=options))
        if abs(change - 1) < 1e-3:
            break
    return bundle, float(np.sqrt(factor))
