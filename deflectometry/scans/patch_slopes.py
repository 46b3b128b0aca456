"""Slopes of a surface from patches of its points: noise, what patches lose, and the patch where both are least."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from deflectometry.shape.facet_pixels import spread_indices
from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.errors import EstimationError
from heliogauge.slopes.map import monomials
from heliogauge.validate import BoolArray, FloatArray, IntArray

#: Points of a patch, and the degree of the polynomial through them. A plane over its nearest points has least noise for
#: its size, a cubic over 25 and more loses waves only that are hardly longer than the patch.
PATCHES = ((9, 1), (25, 3), (49, 3), (81, 3), (121, 3), (169, 3), (289, 3), (441, 3), (676, 3), (1024, 3))
#: The patch that the others are compared with: the smallest of a cubic.
_REFERENCE = 1
#: A node farther from the nearest point than this many spacings was not scanned.
_REACH = 1.0
#: Nodes that are worked on at once, and nodes that show what patches lose: patches of 441 points take 60 MB.
_BLOCK, _LADDER_NODES = 1500, 1500
#: A good point is left out once in twenty scans.
_FAMILY = 0.05
#: Stray points beside each other go one after the other.
_ROUNDS = 8
#: Where so many points stand on one side only, a patch is half of one: the middle of the node is outside its points.
_FEWEST_AROUND = 12
#: Share of a unit term that keeps products invertible; below rounding of what is determined.
_RIDGE = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class PatchSlopes:
    """Slopes at nodes from patches of so many points.

    points, degree: Of the patch.
    side_m: Side of a square of as many points [m].
    slopes (2, n): dz/dx and dz/dy of the deviations; NaN where there are too few points.
    noise (2, n): Their standard deviations from the noise of the points [rad].
    noise_correlation: Variance of the sum over the nodes over the sum of their variances.
    lost_rad (2,): RMS of what the patch loses of the surface, or could lose unseen; NaN for the smallest [rad].
    """

    points: int
    degree: int
    side_m: float
    slopes: FloatArray
    noise: FloatArray
    noise_correlation: float
    lost_rad: FloatArray

    @property
    def noise_rad(self) -> FloatArray:
        """RMS of the noise in x and in y, shape (2,) [rad]."""
        return np.asarray(np.sqrt(np.nanmean(self.noise**2, axis=1)))

    @property
    def total_rad(self) -> float:
        """RMS of noise and loss together, both slopes [rad]; NaN where the loss is not known."""
        return float(np.sqrt(np.sum(self.noise_rad**2 + self.lost_rad**2)))


@dataclass(frozen=True, slots=True, eq=False)
class Deviations:
    """Deviations of points from the design along z.

    places_m (n, 2), deviation_m (n,), stretch (n,): Places, deviations, and noise along z over the noise of a
        coordinate: larger where the mirror is steep.
    spacing_m: Mean distance of neighbours [m].
    """

    places_m: FloatArray
    deviation_m: FloatArray
    stretch: FloatArray
    spacing_m: float

    def chosen(self, which: BoolArray) -> "Deviations":
        """Return some of the points."""
        return Deviations(self.places_m[which], self.deviation_m[which], self.stretch[which], self.spacing_m)


def deviations_of(places_m: FloatArray, deviation_m: FloatArray, gradient: FloatArray) -> Deviations:
    """Return the deviations of points with their spacing.

    gradient (2, n): Slopes of the design at the points.
    EstimationError: Points on a line, or at one place.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        area = float(ConvexHull(places_m).volume)
    except (QhullError, ValueError) as error:
        raise EstimationError(f"{len(places_m)} points over no area; points of a surface are needed") from error
    stretch = np.sqrt(1 + np.sum(gradient**2, axis=0))
    return Deviations(places_m, deviation_m, stretch, float(np.sqrt(area / len(places_m))))


def noise_of_points(deviations: Deviations) -> tuple[float, BoolArray]:
    """Return the noise of a coordinate [m] from what cubics over 25 points leave, and points too far from theirs (n,).

    Each point is compared with the cubic through its neighbours without it, so that one far off does not draw it.
    """
    from scipy.spatial import cKDTree

    count, degree = PATCHES[_REFERENCE]
    if len(deviations.places_m) < 2 * count:
        raise EstimationError(f"{len(deviations.places_m)} points; at least {2 * count} are needed for slopes")
    critical = NormalDist().inv_cdf(1 - _FAMILY / (2 * len(deviations.places_m)))
    kept = np.ones(len(deviations.places_m), dtype=np.bool_)
    for _ in range(_ROUNDS):
        good = deviations.chosen(kept)
        _, near = cKDTree(good.places_m).query(good.places_m, k=count)
        left = _left_beside_neighbours(good, near, degree)
        sigma = robust_scale(left)
        size = np.abs(left)
        # A stray point draws the surface of its neighbours: the one farthest off goes first.
        worst = (size > critical * max(sigma, 1e-300)) & (size >= size[near].max(axis=1))
        if not worst.any():
            break
        kept[np.flatnonzero(kept)[worst]] = False
    return sigma, ~kept


def _left_beside_neighbours(deviations: Deviations, near: IntArray, degree: int) -> FloatArray:
    """Return how far each point is from the polynomial through its neighbours, over what noise of 1 makes [m]."""
    left = np.zeros(len(near))
    for part in _parts(len(near)):
        rows = near[part]
        weights = _weights(deviations, rows[:, 1:], deviations.places_m[part], degree, height=True)[:, 0]
        predicted = np.einsum("nk,nk->n", weights, deviations.deviation_m[rows[:, 1:]])
        size = np.sqrt(1 + np.sum(weights**2, axis=1))
        left[part] = (deviations.deviation_m[part] - predicted) / (size * deviations.stretch[part])
    return left


def ladder(deviations: Deviations, nodes_m: FloatArray, sigma_m: float) -> list[PatchSlopes]:
    """Return slopes from patches of growing size at some thousand of the nodes, with what each size loses.

    nodes_m (n, 2): Where slopes are wanted [m].
    sigma_m: Noise of a coordinate [m].

    A patch is compared with one of half its points. What the two differ by more than their noise is lost in the large
    one; so is what could be lost without being seen: the standard deviation of that mean square is added.
    """
    nodes_m = nodes_m[spread_indices(len(nodes_m), _LADDER_NODES)]
    total = len(deviations.places_m)
    sizes = [one for one in PATCHES if one[0] <= total // 2]
    near, seen = _nearest(deviations, nodes_m, max(count for count, _ in sizes))
    found: list[PatchSlopes] = []
    kept: list[FloatArray] = []
    sure = np.zeros(2)
    for number, (count, degree) in enumerate(sizes):
        weights = _slope_weights(deviations, near[:, :count], nodes_m, seen, degree)
        one = _with_weights(deviations, near[:, :count], weights, seen, sigma_m, degree)
        if number > _REFERENCE:
            smaller = max(_REFERENCE, number - 2)
            square, error = _square_of_loss(
                one, weights, found[smaller], kept[smaller], deviations, near[:, :count], sigma_m
            )
            # What smaller patches surely lost is lost in larger ones, too.
            one = replace(one, lost_rad=np.sqrt(np.maximum(np.maximum(square, sure), 0.0) + error))
            sure = np.maximum(sure, square - error)
        found.append(one)
        kept.append(weights)
    return found


def slopes_of_patch(deviations: Deviations, nodes_m: FloatArray, sigma_m: float, patch: PatchSlopes) -> PatchSlopes:
    """Return slopes at all nodes from patches of one size, with the loss that the ladder found for it.

    patch: One of `ladder`, or of `patch_of_side`.
    """
    near, seen = _nearest(deviations, nodes_m, patch.points)
    parts, sums = [], np.zeros((2, len(deviations.places_m)))
    for part in _parts(len(nodes_m)):
        weights = _slope_weights(deviations, near[part], nodes_m[part], seen[part], patch.degree)
        parts.append(_with_weights(deviations, near[part], weights, seen[part], sigma_m, patch.degree))
        scaled = weights * deviations.stretch[near[part]][:, None]
        for axis in (0, 1):
            sums[axis] += np.bincount(near[part].ravel(), scaled[:, axis].ravel(), len(sums[axis]))
    noise = np.concatenate([one.noise for one in parts], axis=1)
    single = float(np.nansum(noise**2))
    correlation = sigma_m**2 * float(np.sum(sums**2)) / single if single > 0 else 1.0
    return replace(
        patch,
        slopes=np.concatenate([one.slopes for one in parts], axis=1),
        noise=noise,
        noise_correlation=max(correlation, 1.0),
    )


def patch_of_side(deviations: Deviations, side_m: float, found: list[PatchSlopes]) -> PatchSlopes:
    """Return the patch of a wanted side, with the loss of the next larger one of the ladder."""
    total = len(deviations.places_m)
    count = int(np.clip(round((side_m / deviations.spacing_m) ** 2), PATCHES[0][0], total // 2))
    larger = next((one for one in found if one.points >= count), found[-1])
    degree = 3 if count >= PATCHES[_REFERENCE][0] else 1
    return replace(larger, points=count, degree=degree, side_m=deviations.spacing_m * float(np.sqrt(count)))


def best_patch(found: list[PatchSlopes]) -> PatchSlopes:
    """Return the patch with the least noise and loss together; the reference where no loss is known."""
    known = [one for one in found if np.isfinite(one.total_rad)]
    reference = found[min(_REFERENCE, len(found) - 1)]
    return min(known, key=lambda one: one.total_rad, default=reference)


def _parts(count: int) -> Iterator[slice]:
    for start in range(0, count, _BLOCK):
        yield slice(start, min(start + _BLOCK, count))


def _surrounded(places_m: FloatArray, near: IntArray, nodes_m: FloatArray) -> BoolArray:
    """Return nodes that do not lie outside of their nearest points: the middle of these is within half their reach."""
    around = places_m[near] - nodes_m[:, None]
    reach = np.sqrt(np.mean(np.sum(around**2, axis=2), axis=1))
    return np.asarray(np.linalg.norm(around.mean(axis=1), axis=1) < 0.8 * reach)


def _weights(
    deviations: Deviations, near: IntArray, at_m: FloatArray, degree: int, *, height: bool = False
) -> FloatArray:
    """Return what the deviation of each point counts in height or slopes at places, shape (n, 1 or 2, k)."""
    around = deviations.places_m[near] - at_m[:, None]
    scale = np.abs(around).max(axis=(1, 2), keepdims=True)
    terms = np.moveaxis(monomials(around[..., 0] / scale[..., 0], around[..., 1] / scale[..., 0], degree), 0, 2)
    turned = np.ascontiguousarray(terms.swapaxes(1, 2))
    products = turned @ terms
    # Points in a row determine no cubic: then the noise of its terms is large, and shows it.
    products += _RIDGE * len(near[0]) * np.eye(terms.shape[2])
    inverse = np.linalg.inv(products)
    rows = inverse[:, :1] if height else inverse[:, 1:3] / scale
    return np.asarray(rows @ turned)


def _nearest(deviations: Deviations, nodes_m: FloatArray, count: int) -> tuple[IntArray, BoolArray]:
    """Return the nearest points of nodes (n, count), and which nodes lie among them (n,)."""
    from scipy.spatial import cKDTree

    distance, near = cKDTree(deviations.places_m).query(nodes_m, k=count)
    seen = distance[:, 0] < _REACH * deviations.spacing_m
    return near, np.asarray(seen & _surrounded(deviations.places_m, near[:, :_FEWEST_AROUND], nodes_m))


def _slope_weights(
    deviations: Deviations, near: IntArray, nodes_m: FloatArray, seen: BoolArray, degree: int
) -> FloatArray:
    """Return what each point counts in both slopes of each node, shape (n, 2, k) [1/m]."""
    weights = np.zeros((len(nodes_m), 2, near.shape[1]))
    for part in _parts(len(nodes_m)):
        weights[part] = _weights(deviations, near[part], nodes_m[part], degree)
    weights[~seen] = 0.0
    return weights


def _with_weights(
    deviations: Deviations, near: IntArray, weights: FloatArray, seen: BoolArray, sigma_m: float, degree: int
) -> PatchSlopes:
    slopes = np.einsum("nrk,nk->rn", weights, deviations.deviation_m[near])
    scaled = weights * deviations.stretch[near][:, None]
    noise = sigma_m * np.sqrt(np.sum(scaled**2, axis=2)).T
    slopes[:, ~seen] = noise[:, ~seen] = np.nan
    side = deviations.spacing_m * float(np.sqrt(near.shape[1]))
    return PatchSlopes(near.shape[1], degree, side, slopes, noise, 1.0, np.full(2, np.nan))


def _square_of_loss(
    one: PatchSlopes,
    weights: FloatArray,
    smaller: PatchSlopes,
    small: FloatArray,
    deviations: Deviations,
    near: IntArray,
    sigma_m: float,
) -> tuple[FloatArray, FloatArray]:
    """Return the mean square by which a patch differs from a smaller one beyond their noise, and its sigma [rad^2]."""
    # The points of the small patch are the first ones of the large one.
    change = weights.copy()
    change[..., : small.shape[2]] -= small
    change *= deviations.stretch[near][:, None]
    noise = sigma_m**2 * np.sum(change**2, axis=2).T
    known = np.isfinite(one.slopes[0])
    square = np.mean((one.slopes - smaller.slopes)[:, known] ** 2 - noise[:, known], axis=1)
    # Nodes share the points of their patches: as many are independent as patches fit beside each other.
    independent = max(len(deviations.places_m) / small.shape[2], 1.0)
    return square, np.mean(noise[:, known], axis=1) * np.sqrt(2 / independent)
