"""Sigmas of several kinds of image points in one network, each kind's size from its own residuals."""

from dataclasses import dataclass, replace

import numpy as np

from heliogauge.adjust.chi_square import chi_square_quantile
from heliogauge.adjust.gauss_newton import Options
from heliogauge.validate import FloatArray, IntArray
from photogrammetry.bundle.adjustment import BundleOptions, BundleResult, adjust
from photogrammetry.bundle.statistics import UNCONTROLLED, examine_image_points
from photogrammetry.image_points import ImagePoints
from photogrammetry.networks.solve_network import (
    Knowledge,
    NetworkCameras,
    Solved,
    SolveOptions,
    network_of,
    solve_from,
    solve_network,
)
from photogrammetry.start_values.network import Network, StartValues

#: A kind with less redundancy than this keeps its stated sigma: its factor would be known to 20 % at best.
_LEAST_REDUNDANCY = 50
_MOST_ROUNDS = 4
#: Kinds are well weighed when their factors agree to this; the sigma of a factor is 4 % with 300 to spare. To this,
#: mean and median have to give the same sigmas for kinds to be weighed before false image points are sought.
_CLOSE = 0.1
#: Offset in sigmas to which the adjustment goes on that only compares kinds.
_ROUGH = Options(tolerance=1e-3, initial_damping=1e-4)


@dataclass(frozen=True, slots=True, eq=False)
class Weighed:
    """A network whose kinds of image points were weighed against each other.

    solved: The network with the final sigmas.
    points: All image points that were given, with sigmas of the right ratios.
    factors (g,): What the stated sigmas of each kind were multiplied by.
    """

    solved: Solved
    points: ImagePoints
    factors: FloatArray


def variance_factors(bundle: BundleResult, kinds: IntArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Compare the residuals of each kind of image points with its stated sigmas.

    Shapes: kinds (m,), redundancy (count,).
    bundle: An adjusted network.
    factors (count,): Squared whitened residuals over redundancy; 1 where all is right, NaN without redundancy.

    Variance components as Foerstner's iteration has them: ``v^T P v / r`` of each group (Foerstner 1979, Ein
    Verfahren zur Schaetzung von Varianz- und Kovarianzkomponenten, eq. 12); at its fixed point it is the strict
    estimate.
    """
    numbers = np.einsum("mii->m", examine_image_points(bundle).redundancy)
    squares = (bundle.whitened_residuals**2).sum(axis=1)
    redundancy = np.bincount(kinds, weights=numbers, minlength=count)
    total = np.bincount(kinds, weights=squares, minlength=count)
    return np.asarray(total / np.where(redundancy > 0, redundancy, np.nan)), np.asarray(redundancy, dtype=np.float64)


def solve_weighed(
    points: ImagePoints,
    ellipses_px2: FloatArray,
    kinds: IntArray,
    cameras: NetworkCameras,
    knowledge: Knowledge,
    options: SolveOptions,
) -> Weighed:
    """Solve a network of several kinds of image points without believing how their sigmas compare.

    points: All image points, false ones among them.
    ellipses_px2 (m, 2, 2): Ellipses of the targets; NaN where there is none [px^2].
    kinds (m,): Kind of each image point: coded targets, features of one range of size, ...
    cameras: The cameras to start from and what of them is free.
    knowledge: Scale bars, control points, constraints and datum.
    EstimationError: As `photogrammetry.networks.solve_network.solve_network`.
    """
    count = int(kinds.max(initial=0)) + 1
    factors = np.ones(count)
    start = network_of(points, cameras, knowledge)
    if count > 1:
        found = _before_rejection(start, kinds, count, cameras)
        factors, points = np.sqrt(found), _scaled(points, found[kinds])
    solved = solve_from(start, points, ellipses_px2, cameras, knowledge, options)
    for _ in range(_MOST_ROUNDS if count > 1 else 0):
        own = _kinds_of(solved, points, kinds)
        found, redundancy = variance_factors(solved.bundle, own, count)
        # The network's own factor is that of all kinds together and is found again in the end.
        change = np.where(redundancy >= _LEAST_REDUNDANCY, found, 1.0)
        if np.abs(change - 1).max() < _CLOSE:
            break
        found = change * _settled(solved.bundle, own, change) * solved.image_sigma_factor**2
        factors *= np.sqrt(found)
        points = _scaled(points, found[kinds])
        cameras = replace(cameras, cameras=solved.bundle.state.cameras)
        network = _from_result(solved)
        if network is None:
            knowledge = replace(knowledge, start=_start(solved.bundle))
            solved = solve_network(points, ellipses_px2, cameras, knowledge, options)
        else:
            solved = solve_from(network, points, ellipses_px2, cameras, knowledge, options, before=solved)
    return Weighed(solved, points, factors)


def _before_rejection(network: Network, kinds: IntArray, count: int, cameras: NetworkCameras) -> FloatArray:
    """Return what the variances of each kind have to be multiplied by, found before anything is rejected.

    kinds (m,): Of all image points.
    Returns: Shape (count,); 1 for kinds with little redundancy, and for all where one may hold many false image points.

    A kind whose stated sigmas are half of what they are would lose every fifth good image point to the search for
    outliers, and each round that weighs again would bring some of them back. Where false image points are among a kind,
    the mean of its squared residuals is larger than their median says: then none is weighed before these are gone.
    """
    bundle = adjust(cameras.problem(network.observations), network.state, options=BundleOptions(descent=_ROUGH))
    own = kinds[network.rows]
    found, redundancy = variance_factors(bundle, own, count)
    tests = examine_image_points(bundle)
    # A target of two rays controls one direction of each.
    directions = (np.linalg.eigvalsh(tests.redundancy) > UNCONTROLLED).sum(axis=1)
    share = tests.length_squared / np.array([np.nan, *(chi_square_quantile(0.5, n) for n in (1, 2))])[directions]
    enough = np.flatnonzero(redundancy >= _LEAST_REDUNDANCY)
    medians = np.array([np.nanmedian(share[own == kind]) for kind in enough])
    factors = np.ones(count)
    if (np.abs(np.sqrt(medians / found[enough]) - 1) < _CLOSE).all():
        factors[enough] = found[enough]
    return factors


def _scaled(points: ImagePoints, factors: FloatArray) -> ImagePoints:
    """Return the image points with their covariances times factors (m,)."""
    return replace(points, covariance_px2=points.covariance_px2 * factors[:, None, None])


def _settled(bundle: BundleResult, kinds: IntArray, change: FloatArray) -> FloatArray:
    """Return what the kinds' variances have to be multiplied by beyond a first change, with the same image points.

    An adjustment from its own result takes a tenth of a network's start: so that is made anew once, not for each round.
    """
    more = np.ones(change.size)
    for _ in range(_MOST_ROUNDS):
        table = bundle.problem.observations
        scaled = replace(bundle.problem, observations=_scaled(table, change[kinds]))
        bundle = adjust(scaled, bundle.state, options=bundle.options)
        found, redundancy = variance_factors(bundle, kinds, change.size)
        change = np.where(redundancy >= _LEAST_REDUNDANCY, found, 1.0)
        if not bundle.converged or np.abs(change - 1).max() < _CLOSE:
            break
        more *= change
    return more


def _kinds_of(solved: Solved, points: ImagePoints, kinds: IntArray) -> IntArray:
    """Kind of each image point that took part."""
    table = solved.bundle.problem.observations
    photos, targets = ({name: k for k, name in enumerate(names)} for names in (points.photos, points.targets))
    photo = np.array([photos[name] for name in table.photos], dtype=np.intp)[table.photo_index]
    target = np.array([targets[name] for name in table.targets], dtype=np.intp)[table.target_index]
    keys = points.pair_keys
    order = np.argsort(keys)
    place = order[np.searchsorted(keys[order], photo * len(points.targets) + target)]
    return np.asarray(kinds[place])


def _from_result(solved: Solved) -> Network | None:
    """Return the same network with the adjusted state to start from; None where some of it has been left out since."""
    table, network = solved.bundle.problem.observations, solved.network
    if (table.photos, table.targets) != (network.observations.photos, network.observations.targets):
        return None
    return replace(network, state=solved.bundle.state)


def _start(bundle: BundleResult) -> StartValues:
    table = bundle.problem.observations
    poses = dict(zip(table.photos, bundle.cam_from_world, strict=True))
    return StartValues(poses, dict(zip(table.targets, bundle.state.points_m, strict=True)))
