"""What each camera sees over what it should: found with slopes and profile, and which camera contradicts the others."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations

import numpy as np

from deflectometry.gazing.mirror_points import FEWEST_CAMERAS
from deflectometry.gazing.node_slopes import (
    Brightness,
    NodeSlopes,
    d_deviation_d_slopes,
    d_expected_d_deviation,
    deviations,
    expected,
    solve_nodes,
)
from deflectometry.gazing.sun_profile import SunProfile
from deflectometry.setup.setup_steps import principal_steps
from heliogauge.errors import EstimationError
from heliogauge.validate import FloatArray, IntArray

#: Nodes of all facets together from which the gains are found: four numbers from hundreds.
_NODES = 400
_ROUNDS = 6
#: Share of a residual that the slopes must leave for it to test anything.
_TESTED = 0.05
#: A gain beyond so many of its standard deviations is not its scatter: 1 of 10^6 Gaussian ones.
_WRONG_GAIN = 5.0
#: Cameras are exchanged where that lowers chi-square of the nodes by so much that chance has no part: e^-50.
_CLEARLY = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class Gains:
    """What each camera sees over what it should, as its logarithm.

    logarithm (c,): Adjusted.
    shift_m (c, 2): By what each camera stands beside its stated place, in x and y of the mirror.
    covariance (3 c, 3 c): Of the logarithms, of all shifts in x, of all shifts in y, were the profile exactly known.
    misfit (c,): RMS of each camera's residuals over their sigmas, the share that two slopes took away restored; nodes
        that no slopes explain count less.
    profile: The sun's, adjusted with them; its steps are what stays unknown of it.
    by_profile (3 c, k): What each of its steps does to logarithms and shifts.
    """

    logarithm: FloatArray
    shift_m: FloatArray
    covariance: FloatArray
    misfit: FloatArray
    profile: SunProfile
    by_profile: FloatArray

    @property
    def sigma(self) -> FloatArray:
        """Standard deviation of the logarithms, shape (c,)."""
        variance = np.diag(self.covariance) + (self.by_profile**2).sum(axis=1)
        return np.asarray(np.sqrt(variance[: self.logarithm.size]))

    @property
    def factors(self) -> FloatArray:
        """The gains themselves, shape (c,)."""
        return np.asarray(np.exp(self.logarithm))


@dataclass(frozen=True, slots=True, eq=False)
class LeftOutCamera:
    """A camera that contradicts the others: its gain with that of the others alone, and its standard deviation."""

    number: int
    gain: float
    sigma: float


def spread_nodes(facets: Sequence[Brightness], count: int = _NODES) -> list[Brightness]:
    """Return nodes evenly over all facets, those that at least one camera sees in the sun."""
    chosen = []
    each = max(count // len(facets), 12)
    for seen in facets:
        lit = np.flatnonzero(np.nansum(seen.value > 4 * seen.sigma, axis=0) >= 2)
        if lit.size:
            chosen.append(seen.chosen(lit[np.linspace(0, lit.size - 1, min(each, lit.size)).astype(np.intp)]))
    return chosen


def fit_gains(facets: Sequence[Brightness], profile: SunProfile, prior: FloatArray, places: FloatArray) -> Gains:
    """Find gains and places of all cameras, the sun's profile and the slopes of some nodes together.

    facets: Nodes of each facet, from `spread_nodes`.
    profile: As the camera on the sun measured it.
    prior (c, c): Covariance of the logarithms before: of each camera's level, and of the reflectance.
    places (c, c): Covariance of each coordinate of the cameras' places against the mirror [m^2].
    Returns: Gains, places across the sight, and the adjusted profile.

    Two slopes leave of c brightnesses c - 2 that know gains and places: the slopes are eliminated from the normal
    equations node by node (Schur complement). All are found at once: a camera that stands 2 mm beside its stated place
    looks like one with another gain. What tells both from slopes is how steep the profile is where each camera looks;
    noise of a profile that is taken as exact makes that steepness wrong for all nodes alike, and its product with the
    profile's own residuals pulls the gains (errors in variables). So the profile's radiances are unknowns as well,
    observed by the camera on the sun with their sigmas and by all nodes.
    """
    count, unknown = len(prior), 0 if profile.steps is None else profile.steps.shape[1]
    # Exact places keep a hair of freedom, so that their covariance has an inverse.
    loose = places + 1e-12 * np.eye(count)
    inverse_prior = np.eye(3 * count + unknown)
    for first, one in ((0, prior), (count, loose), (2 * count, loose)):
        inverse_prior[first : first + count, first : first + count] = np.linalg.inv(one)
    values: FloatArray = np.zeros(3 * count + unknown)
    normal = inverse_prior
    squares, freedom = np.zeros(count), np.zeros(count)
    for _ in range(_ROUNDS):
        normal, right = inverse_prior.copy(), -inverse_prior @ values
        squares, freedom = np.zeros(count), np.zeros(count)
        gains, adjusted = np.exp(values[:count]), profile.adjusted(values[3 * count :])
        for stated in facets:
            seen = stated.moved(values[count : 3 * count].reshape(2, count).T)
            found = solve_nodes(seen, adjusted, gains)
            model, residual, weight, kept = _eliminated(seen, found, adjusted, gains)
            left = np.diagonal(kept, axis1=1, axis2=2)
            share_left = np.divide(left, weight, out=np.zeros(left.shape), where=weight > 0)
            # Where the slopes take a camera's light as it is, its residual says nothing.
            tested = share_left > _TESTED
            # Nodes that no slopes explain would draw the gains to themselves, and three of 400 the misfit of all.
            share = 1.0 / np.maximum(1.0, found.misfit / (4.0 * max(count - 2, 1)))
            counts = share[:, None] * tested
            squares += (residual**2 * weight * counts).sum(axis=0)
            freedom += (share_left * counts).sum(axis=0)
            by_place = d_light_d_place(seen, found.slopes, adjusted, gains)
            by_radiance = np.moveaxis(light_of_profile(seen, found.slopes, adjusted, gains), 0, 1)
            own = [_diagonal(one) for one in (model, by_place[..., 0], by_place[..., 1])]
            design = np.concatenate([*own, by_radiance], axis=2)
            weighted = share[:, None, None] * (kept @ design)
            normal += np.tensordot(weighted, design, axes=((0, 1), (0, 1)))
            right += np.tensordot(weighted, residual, axes=((0, 1), (0, 1)))
        step = np.linalg.solve(normal, right)
        # A twentieth of what is unknown in any direction: the next round would change nothing that matters.
        if step @ normal @ step < 0.05**2:
            break
        values = values + np.append(np.clip(step[: 3 * count], -0.5, 0.5), step[3 * count :])
    adjusted, covariance = profile.adjusted(values[3 * count :]), np.linalg.inv(normal)
    # What stays unknown of the profile takes gains and places along; the rest is theirs were it known.
    left_of_profile = principal_steps(np.asarray(covariance[3 * count :, 3 * count :], dtype=np.float64)).T
    own_normal = normal[: 3 * count, : 3 * count]
    return Gains(
        values[:count],
        values[count : 3 * count].reshape(2, count).T,
        np.asarray(np.linalg.inv(own_normal), dtype=np.float64),
        np.asarray(np.sqrt(squares / np.maximum(freedom, 1e-9))),
        adjusted if profile.steps is None else replace(adjusted, steps=profile.steps @ left_of_profile),
        np.asarray(-np.linalg.solve(own_normal, normal[: 3 * count, 3 * count :] @ left_of_profile)),
    )


def _diagonal(values: FloatArray) -> FloatArray:
    """Return diagonal matrices (n, c, c) of values (n, c)."""
    return np.asarray(values[:, :, None] * np.eye(values.shape[1]))


def light_of_profile(seen: Brightness, slopes: FloatArray, profile: SunProfile, gains: FloatArray) -> FloatArray:
    """Return what each step of the profile does to each camera's light, shape (c, n, k)."""
    off = deviations(seen, slopes)
    return np.asarray(
        gains[:, None, None] * profile.steps_at(np.hypot(off[..., 0], off[..., 1])).mean(axis=2), dtype=np.float64
    )


def d_light_d_place(seen: Brightness, slopes: FloatArray, profile: SunProfile, gains: FloatArray) -> FloatArray:
    """Return how each camera's light follows its own place in x and y, shape (n, c, 2) [1/m]."""
    steep = d_expected_d_deviation(seen, slopes, profile) * gains[:, None, None]
    off, step = deviations(seen, slopes), 1e-3
    columns = []
    for axis in np.eye(2):
        change = (deviations(seen.moved(np.tile(step * axis, (len(gains), 1))), slopes) - off).mean(axis=2) / step
        columns.append((steep * change).sum(axis=2).T)
    return np.stack(columns, axis=-1)


def _eliminated(
    seen: Brightness, found: NodeSlopes, profile: SunProfile, gains: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return model (n, c), residual (n, c), weights (n, c), and what the slopes leave of the weights (n, c, c)."""
    model = (gains[:, None] * expected(seen, found.slopes, profile)).T
    weight = np.nan_to_num(1.0 / seen.sigma**2).T
    residual = np.where(weight > 0, np.nan_to_num(seen.value.T) - model, 0.0)
    design = slope_design(seen, found.slopes, profile, gains)
    weighted = weight[..., None] * design
    inner = np.einsum("nci,ncj->nij", weighted, design)
    # Where the profile is flat the slopes take nothing away; the smallest addition keeps the inverse finite.
    inner += np.eye(2) * (1e-9 * np.trace(inner, axis1=1, axis2=2)[:, None, None] + 1e-12)
    taken = np.einsum("nci,nij,ndj->ncd", weighted, np.linalg.inv(inner), weighted)
    kept = np.einsum("nc,cd->ncd", weight, np.eye(len(gains))) - taken
    return model, residual, weight, kept


def slope_design(seen: Brightness, slopes: FloatArray, profile: SunProfile, gains: FloatArray) -> FloatArray:
    """Return the derivative of each camera's light by the two slopes, shape (n, c, 2)."""
    by_deviation = d_expected_d_deviation(seen, slopes, profile) * gains[:, None, None]
    return np.asarray(np.einsum("cni,nij->ncj", by_deviation, d_deviation_d_slopes(seen, slopes)))


def contradicting_camera(found: Gains, prior: FloatArray) -> LeftOutCamera | None:
    """Return the one camera whose light contradicts that of the others, or None.

    found: Gains of all cameras together.
    prior (c, c): Covariance of their logarithms before.

    Four cameras know each other's levels much better than filters and exposures do: a cloud before the sun, a filter
    that was changed or an exposure that was not noted moves the gain of one, and the others stay where they were to be.
    """
    off = np.abs(found.logarithm) / np.sqrt(np.diag(prior))
    wrong = np.flatnonzero(off > _WRONG_GAIN)
    if wrong.size != 1 or len(prior) <= FEWEST_CAMERAS:
        return None
    number = int(wrong[0])
    gain = float(found.factors[number])
    return LeftOutCamera(number, gain, gain * float(found.sigma[number]))


def refuse_exchanged(
    names: Sequence[str], facets: Sequence[Brightness], profile: SunProfile, prior: FloatArray, places: FloatArray
) -> None:
    """Refuse images that belong to each other's cameras.

    prior (c, c): Covariance of the logarithms of their levels. places (c, c): Of each coordinate of their places [m^2].
    EstimationError: The images explain each other much better if they are exchanged; the message says which.

    Exchanged left for right and up for down at once, cameras around the middle of the receiver see what a mirror with
    slopes of the other sign would show: that no image can tell.
    """
    count = len(names)
    order = np.arange(count)
    trial = [one.chosen(np.arange(0, one.x_m.size, max(1, one.x_m.size // 12))) for one in facets]
    # Levels and places are not fitted here: they may be off by what is known of them.
    trial = [_with_sigma_of_setup(one, profile, np.diag(prior), np.diag(places)) for one in trial]
    as_given = _total_misfit(trial, profile, order)
    if as_given < 2.0 * count * sum(one.x_m.size for one in trial):
        return
    orders = (
        [np.array(one) for one in permutations(range(count))]
        if count <= 4
        else [_swapped(count, *pair) for pair in combinations(range(count), 2)]
    )
    scores = [_total_misfit(trial, profile, one) for one in orders]
    best = int(np.argmin(scores))
    if scores[best] < as_given - _CLEARLY and scores[best] < 0.25 * as_given:
        alike = [one for one, score in zip(orders, scores, strict=True) if score < 2 * scores[best] + _CLEARLY]
        # A square of cameras looks the same turned and mirrored: of orders alike those that move fewest.
        fewest = min(np.count_nonzero(one != order) for one in alike)
        words = ", or ".join(_exchange_words(names, one) for one in alike if np.count_nonzero(one != order) == fewest)
        raise EstimationError(
            f"the cameras' images are exchanged: chi-square of {sum(one.x_m.size for one in trial)} mirror points is "
            f"{as_given:.3g}, and {scores[best]:.3g} if {words}; put frames or place_m right"
        )


def _with_sigma_of_setup(
    seen: Brightness, profile: SunProfile, levels: FloatArray, places_m2: FloatArray
) -> Brightness:
    """Return points whose light is as uncertain as levels and places of the cameras make it as well."""
    even = np.ones(len(levels))
    slopes = solve_nodes(seen, profile, even).slopes
    by_place = np.moveaxis(d_light_d_place(seen, slopes, profile, even), 1, 0)
    variance = seen.sigma**2 + levels[:, None] * seen.value**2
    return replace(seen, sigma=np.sqrt(variance + places_m2[:, None] * (by_place**2).sum(axis=2)))


def _exchange_words(names: Sequence[str], order: IntArray) -> str:
    pairs = zip(range(len(names)), order.tolist(), strict=True)
    return " and ".join(f"{names[a]} shows what {names[b]} should" for a, b in pairs if a != b)


def _swapped(count: int, first: int, second: int) -> IntArray:
    order: IntArray = np.arange(count)
    order[[first, second]] = order[[second, first]]
    return order


def _total_misfit(facets: Sequence[Brightness], profile: SunProfile, order: IntArray) -> float:
    """Return chi-square of nodes whose images belong to cameras in another order."""
    total = 0.0
    for seen in facets:
        moved = replace(
            seen, places_m=seen.places_m[order], more_slope=seen.more_slope[order], eyes_m=seen.eyes_m[order]
        )
        total += float(solve_nodes(moved, profile, np.ones(len(order))).misfit.sum())
    return total
