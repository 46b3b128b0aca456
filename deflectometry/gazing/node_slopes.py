"""From the brightness of one mirror point in several cameras to its two slopes, with what is left unknown."""

from dataclasses import dataclass, replace

import numpy as np

from deflectometry.gazing.sun_profile import SunProfile
from heliogauge.validate import BoolArray, FloatArray, IntArray

#: Values of the first search: over the whole range of slopes in which a camera sees the sun.
_SEARCH = 31
#: Values of each finer search, over 3.5 standard deviations to both sides.
_FINE, _REACH = 13, 3.5
_MOST_ROUNDS = 8
#: Nodes that are searched at once: 961 values for each camera of 128 nodes are 4 MB.
_BLOCK = 128


@dataclass(frozen=True, slots=True, eq=False)
class Brightness:
    """How bright mirror points are in each camera, and where they were looked at, in one facet's frame.

    x_m, y_m (n,): The nodes.
    design_slope_x, design_slope_y (n,): The design's slopes there.
    places_m (c, n, g, 3): Points of the mirror that each camera's pixels saw of a node: g places of equal weight.
    more_slope (c, n, g, 2): The design's slopes there minus those at the node.
    value, sigma (c, n): Light over that of the sun's middle, and its standard deviation; NaN where not measured.
    eyes_m (c, 3): The cameras' places.
    sun (3,): Unit vector to the sun.
    """

    x_m: FloatArray
    y_m: FloatArray
    design_slope_x: FloatArray
    design_slope_y: FloatArray
    places_m: FloatArray
    more_slope: FloatArray
    value: FloatArray
    sigma: FloatArray
    eyes_m: FloatArray
    sun: FloatArray

    def chosen(self, nodes: BoolArray | IntArray) -> "Brightness":
        """Return some of the nodes."""
        return Brightness(
            self.x_m[nodes],
            self.y_m[nodes],
            self.design_slope_x[nodes],
            self.design_slope_y[nodes],
            self.places_m[:, nodes],
            self.more_slope[:, nodes],
            self.value[:, nodes],
            self.sigma[:, nodes],
            self.eyes_m,
            self.sun,
        )

    def moved(self, shift_m: FloatArray) -> "Brightness":
        """Return the same with cameras elsewhere by shifts in x and y (c, 2) [m]."""
        return replace(self, eyes_m=self.eyes_m + np.pad(shift_m, ((0, 0), (0, 1))))

    def with_value(self, value: FloatArray) -> "Brightness":
        """Return the same points with other light (c, n)."""
        return replace(self, value=value)

    def of_cameras(self, cameras: IntArray) -> "Brightness":
        """Return what some of the cameras saw."""
        return Brightness(
            self.x_m,
            self.y_m,
            self.design_slope_x,
            self.design_slope_y,
            self.places_m[cameras],
            self.more_slope[cameras],
            self.value[cameras],
            self.sigma[cameras],
            self.eyes_m[cameras],
            self.sun,
        )


@dataclass(frozen=True, slots=True, eq=False)
class NodeSlopes:
    """Slopes of nodes, as mean and covariance of what the brightness leaves possible.

    slopes (n, 2): dz/dx and dz/dy.
    covariance (n, 2, 2): Of both.
    misfit (n,): Chi-square of the best slopes; its degrees of freedom are the cameras minus two.
    """

    slopes: FloatArray
    covariance: FloatArray
    misfit: FloatArray


def start_slopes(seen: Brightness) -> FloatArray:
    """Return the slopes with which each node reflects the sun's centre between the cameras, shape (n, 2)."""
    to_eye = seen.eyes_m.mean(axis=0) - seen.places_m.mean(axis=(0, 2))
    half = to_eye / np.linalg.norm(to_eye, axis=1, keepdims=True) + seen.sun
    return np.asarray(-half[:, :2] / half[:, 2:])


def deviations(seen: Brightness, slopes: FloatArray) -> FloatArray:
    """Return how far reflected sights miss the sun's centre, in two components across its direction.

    slopes (n, 2): Slopes of the nodes.
    Returns (c, n, g, 2): Sines of the angles.

    The sight from a node to a camera, v, is reflected to r = 2 (n v) n - v; its components across the sun's direction
    have the angle's sine as their length. What the sun shows there is what the camera sees (spec 003 C-47).
    """
    axis = np.eye(3)[int(np.argmin(np.abs(seen.sun)))]
    across = np.cross(seen.sun, axis)
    across /= np.linalg.norm(across)
    basis = np.stack([across, np.cross(seen.sun, across)])
    sight = seen.eyes_m[:, None, None] - seen.places_m
    sight /= np.linalg.norm(sight, axis=-1, keepdims=True)
    local = slopes[None, :, None] + seen.more_slope
    normal = np.concatenate([-local, np.ones((*local.shape[:-1], 1))], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    reflected = 2 * (normal * sight).sum(axis=-1, keepdims=True) * normal - sight
    return np.asarray(reflected @ basis.T)


def d_deviation_d_slopes(seen: Brightness, slopes: FloatArray) -> FloatArray:
    """Return the derivative of the deviations by the slopes, shape (n, 2, 2): of all cameras and places alike."""
    step = 1e-5
    single = Brightness(
        seen.x_m,
        seen.y_m,
        seen.design_slope_x,
        seen.design_slope_y,
        seen.places_m.mean(axis=(0, 2), keepdims=True),
        np.zeros((1, seen.x_m.size, 1, 2)),
        seen.value[:1],
        seen.sigma[:1],
        seen.eyes_m.mean(axis=0, keepdims=True),
        seen.sun,
    )
    columns = [
        (deviations(single, slopes + one) - deviations(single, slopes - one))[0, :, 0] / (2 * step)
        for one in step * np.eye(2)
    ]
    return np.stack(columns, axis=-1)


def expected(seen: Brightness, slopes: FloatArray, profile: SunProfile) -> FloatArray:
    """Return the light that each camera sees of each node, over that of the sun's middle, shape (c, n)."""
    off = deviations(seen, slopes)
    return np.asarray(profile.at(np.hypot(off[..., 0], off[..., 1])).mean(axis=2))


def d_expected_d_deviation(seen: Brightness, slopes: FloatArray, profile: SunProfile) -> FloatArray:
    """Return the derivative of that light by the two components of the deviation, shape (c, n, 2)."""
    off = deviations(seen, slopes)
    angle = np.hypot(off[..., 0], off[..., 1])
    steep = profile.derivative(angle) / np.maximum(angle, 1e-12)
    return np.asarray((steep[..., None] * off).mean(axis=2))


def solve_nodes(seen: Brightness, profile: SunProfile, gains: FloatArray) -> NodeSlopes:
    """Find the slopes of every node by itself.

    gains (c,): What each camera sees over what it should.
    Returns: Mean and covariance over all slopes that the brightness allows.

    Least squares on the brightness with the measured profile: what chi-square leaves possible is summed over a grid of
    slopes that is refined about it until a step is less than the standard deviation. Where the profile is flat the
    brightness says little: then chi-square is no paraboloid, its derivatives are zero, and the mean over what it
    leaves possible is still the value with the smallest error.
    """
    count = seen.x_m.size
    slopes, covariance, misfit = np.full((count, 2), np.nan), np.full((count, 2, 2), np.nan), np.full(count, np.nan)
    for first in range(0, count, _BLOCK):
        rows = np.arange(first, min(first + _BLOCK, count))
        block = seen.chosen(rows)
        slopes[rows], covariance[rows], misfit[rows] = _solve_block(block, profile, gains)
    return NodeSlopes(slopes, covariance, misfit)


def _solve_block(seen: Brightness, profile: SunProfile, gains: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    base = start_slopes(seen)
    turn = d_deviation_d_slopes(seen, base)
    farthest = np.linalg.norm(deviations(seen, base), axis=-1).max() + profile.limit_rad
    least_turn = float(np.linalg.svd(turn, compute_uv=False).min())
    half = farthest / least_turn
    line = np.linspace(-half, half, _SEARCH)
    lattice = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    steps = np.broadcast_to(lattice, (seen.x_m.size, *lattice.shape))
    chi_square = _chi_square(seen, base, turn, steps, profile, gains, coarse=True)
    # A lattice steps over a narrow minimum: so much of chi-square is due to it.
    weights = _tempered(chi_square)
    mean, spread = _moments(steps, weights)
    spread += np.eye(2) * ((line[1] - line[0]) ** 2 / 12)
    least = chi_square.min(axis=1)
    for _ in range(_MOST_ROUNDS):
        base = base + mean
        turn = d_deviation_d_slopes(seen, base)
        values, axes = np.linalg.eigh(spread)
        reach = _REACH * np.sqrt(values)
        unit = np.linspace(-1.0, 1.0, _FINE)
        lattice = np.stack(np.meshgrid(unit, unit), axis=-1).reshape(-1, 2)
        steps = np.einsum("nij,nj,kj->nki", axes, reach, lattice)
        chi_square = _chi_square(seen, base, turn, steps, profile, gains, coarse=False)
        least = chi_square.min(axis=1)
        before = np.sqrt(values)
        mean, spread = _moments(steps, _tempered(chi_square))
        now = np.sqrt(np.maximum(np.linalg.eigvalsh(spread), 0.0))
        # A step of 0.6 sigma sums a Gaussian to 1e-15: the next round would change nothing.
        if (now > 0.5 * before).all():
            break
        grid = 2 * reach / (_FINE - 1)
        spread = spread + np.einsum("nij,nj,nkj->nik", axes, grid**2 / 12, axes)
    # What flattened the probabilities is no spread of the slopes: chance makes that much misfit of one node in seven.
    return base + mean, spread / _temperature(least)[:, None, None], least


def _tempered(chi_square: FloatArray) -> FloatArray:
    """Return relative probabilities, flattened where even the best value of the lattice fits badly."""
    least = chi_square.min(axis=1, keepdims=True)
    return np.asarray(np.exp(-0.5 * (chi_square - least) / _temperature(least)))


def _temperature(least: FloatArray) -> FloatArray:
    return np.maximum(1.0, least / 4.0)


def _moments(steps: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    total = weights.sum(axis=1)
    mean = np.einsum("nk,nki->ni", weights, steps) / total[:, None]
    second = np.einsum("nk,nki,nkj->nij", weights, steps, steps) / total[:, None, None]
    return mean, second - mean[:, :, None] * mean[:, None]


def _chi_square(
    seen: Brightness,
    base: FloatArray,
    turn: FloatArray,
    steps: FloatArray,
    profile: SunProfile,
    gains: FloatArray,
    *,
    coarse: bool,
) -> FloatArray:
    """Return chi-square of slopes base + steps, shape (n, k)."""
    off = deviations(seen, base)
    if coarse:
        off = off.mean(axis=2, keepdims=True)
    moved = np.einsum("nij,nkj->nki", turn, steps)
    total = np.zeros(steps.shape[:2])
    for camera in range(len(gains)):
        known = np.isfinite(seen.value[camera])
        light = np.zeros(steps.shape[:2])
        for place in range(off.shape[2]):
            at = moved + off[camera, :, place, None]
            light += profile.at(np.sqrt(at[..., 0] ** 2 + at[..., 1] ** 2))
        light *= gains[camera] / off.shape[2]
        weight = np.where(known, 1.0 / np.where(known, seen.sigma[camera], 1.0), 0.0)
        value = np.where(known, seen.value[camera], 0.0)
        total += ((light - value[:, None]) * weight[:, None]) ** 2
    return total
