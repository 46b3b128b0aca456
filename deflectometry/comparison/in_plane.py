"""Where one map of a mirror stands in the plane of another: shift and turn from the fine structure of the slopes."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deflectometry.comparison.moved_map import PlaneMotion, moved_map
from heliogauge.errors import EstimationError
from heliogauge.slopes.map import SlopeMap, monomials
from heliogauge.validate import BoolArray, FloatArray

#: Polynomials of this degree are what poses, cameras and screens do to slopes; only what is finer belongs to a place.
SMOOTH_DEGREE = 3
#: Blocks of the jackknife along each side.
BLOCKS = 4
_ITERATIONS = 12
_NODES = 40_000
#: A structure of the same mirror correlates by 1 with itself, that of another mirror by 0.
SAME_CORRELATION = 0.5


class Likeness(NamedTuple):
    """How much the fine structures of two maps have in common.

    correlation: 1 for one mirror, 0 for two; the noise of both is taken out. NaN where noise hides the structure.
    structure_a_rad, structure_b_rad: RMS of the fine structure of each, noise included [rad].
    """

    correlation: float
    structure_a_rad: float
    structure_b_rad: float


#: Slopes below are those of rounding: polynomials are taken out of slopes below 1 to 1e-15.
_ROUNDING_RAD = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class FoundMotion:
    """A motion that was found, with its covariance.

    motion: From b to a.
    covariance (3, 3): Of turn [rad] and shift [m].
    likeness: Of both maps when b is moved.
    """

    motion: PlaneMotion
    covariance: FloatArray
    likeness: Likeness

    @property
    def sigmas(self) -> FloatArray:
        """Standard deviations of turn and shift, shape (3,)."""
        return np.sqrt(np.diag(self.covariance))


def quarter_turns(map_a: SlopeMap, map_b: SlopeMap) -> list[PlaneMotion]:
    """Return the motions that bring the outline of b onto that of a, one for each quarter turn.

    Frames of instruments differ by quarter turns and by where their origins are.
    """
    middles = [_middle(one) for one in (map_a, map_b)]
    found = []
    for quarter in range(4):
        bare = PlaneMotion(0.5 * np.pi * quarter, np.zeros(2))
        found.append(PlaneMotion(bare.turn_rad, middles[0] - bare.rotation @ middles[1]))
    return found


def _middle(slope_map: SlopeMap) -> FloatArray:
    rows, columns = np.nonzero(slope_map.aperture)
    if not rows.size:
        raise EstimationError("a slope map without mirror: its aperture is empty")
    return np.array(
        [
            0.5 * (slope_map.x_m[columns].min() + slope_map.x_m[columns].max()),
            0.5 * (slope_map.y_m[rows].min() + slope_map.y_m[rows].max()),
        ]
    )


def likeness(map_a: SlopeMap, map_b: SlopeMap, motion: PlaneMotion) -> Likeness:
    """Compare the fine structures of two maps, both without a polynomial of degree 3.

    motion: From the frame of b to that of a.
    """
    pair = _pair(map_a, map_b, motion)
    fine_a, fine_b = (pair.without_smooth(one) for one in (pair.slopes_a, pair.slopes_b))
    squares = [float(np.mean(one**2)) for one in (fine_a, fine_b)]
    noise = [float(np.mean(one**2)) for one in (pair.sigmas_a, pair.sigmas_b)]
    pure = [total - part for total, part in zip(squares, noise, strict=True)]
    # Below its noise a structure says nothing, nor does what rounding leaves of an even map.
    known = all(one > max(part, _ROUNDING_RAD**2) for one, part in zip(pure, noise, strict=True))
    shared = float(np.mean(fine_a * fine_b))
    correlation = shared / float(np.sqrt(pure[0] * pure[1])) if known else float("nan")
    return Likeness(correlation, *(float(np.sqrt(one)) for one in squares))


def find_motion(map_a: SlopeMap, map_b: SlopeMap, start: PlaneMotion) -> FoundMotion:
    """Find shift and turn between two maps from what is finer than poses, cameras and screens make.

    start: Where to begin: within some wavelengths of the structure.
    EstimationError: The structure does not determine them.

    Least squares of the difference of slopes, with polynomials of degree 3 free in both slopes. The covariance is that
    of a jackknife over 16 blocks: it has the correlation of what is left in it (Efron and Stein, Annals of Statistics 9
    (1981) 586).
    """
    motion = start
    step = np.full(3, np.inf)
    blocks = np.zeros((0, 3))
    reach = 0.5 * float(np.hypot(np.ptp(map_a.x_m), np.ptp(map_a.y_m)))
    for _ in range(_ITERATIONS):
        pair = _pair(map_a, map_b, motion)
        step, blocks = pair.step()
        turn = motion.turn_rad + step[0]
        motion = PlaneMotion(float(turn), motion.shift_m + step[1:])
        if np.abs(step * [reach, 1, 1]).max() < 1e-6 * reach:
            break
    else:
        if np.abs(step * [reach, 1, 1]).max() > 1e-3 * reach:
            raise EstimationError("the fine structure of the slopes does not determine shift and turn of the two maps")
    count = len(blocks)
    spread = blocks - blocks.mean(axis=0)
    covariance = (count - 1) / count * spread.T @ spread
    if not np.isfinite(covariance).all() or np.abs(motion.shift_m - start.shift_m).max() > reach:
        raise EstimationError("the fine structure of the slopes does not determine shift and turn of the two maps")
    return FoundMotion(motion, covariance, likeness(map_a, map_b, motion))


@dataclass(frozen=True, slots=True, eq=False)
class _Pair:
    """Both maps at the nodes that they share.

    places (2, n), slopes_a, slopes_b, sigmas_a, sigmas_b (2, n).
    gradients_a, gradients_b (2, 2, n): d slopes / d place [1/m].
    smooth (m, n): Polynomials.
    """

    places: FloatArray
    slopes_a: FloatArray
    slopes_b: FloatArray
    sigmas_a: FloatArray
    sigmas_b: FloatArray
    gradients_a: FloatArray
    gradients_b: FloatArray
    smooth: FloatArray

    def without_smooth(self, values: FloatArray) -> FloatArray:
        """Take the polynomials out of values (..., n)."""
        flat = values.reshape(-1, values.shape[-1])
        amounts = np.linalg.lstsq(self.smooth.T, flat.T, rcond=None)[0]
        return np.asarray((flat - amounts.T @ self.smooth).reshape(values.shape))

    def jacobian(self, slopes: FloatArray, gradients: FloatArray) -> FloatArray:
        """Return what turn and shift do to slopes (2, n) with such gradients, shape (3, 2, n)."""
        x, y = self.places
        by_turn = np.stack([gradients[k, 0] * y - gradients[k, 1] * x for k in (0, 1)])
        by_turn += np.stack([-slopes[1], slopes[0]])
        return self.without_smooth(np.stack([by_turn, -gradients[:, 0], -gradients[:, 1]]))

    def step(self) -> tuple[FloatArray, FloatArray]:
        """Return the correction of turn and shift (3,), and the same without each block of nodes (b, 3)."""
        # With x_a = R x_b + t the slopes of b at a place of a change by -gradient times the place's own motion, and
        # turn with the frame.
        x, y = self.places
        jacobian = self.jacobian(self.slopes_b, self.gradients_b)
        # Noise of the gradients would count as structure in their squares: those of a have other noise, and stand for
        # those of b on one side (instrumental variables: Durbin, Review of the International Statistical Institute 22
        # (1954) 23).
        other = self.jacobian(self.slopes_a, self.gradients_a)
        error = self.without_smooth(self.slopes_a - self.slopes_b)
        lines = [np.quantile(one, np.linspace(0, 1, BLOCKS + 1)[1:-1]) for one in self.places]
        number = np.searchsorted(lines[0], x) * BLOCKS + np.searchsorted(lines[1], y)
        products = np.stack(
            [
                np.einsum("icn,jcn->ij", other[..., number == one], jacobian[..., number == one])
                for one in range(BLOCKS**2)
            ]
        )
        moments = np.stack(
            [np.einsum("icn,cn->i", other[..., number == one], error[..., number == one]) for one in range(BLOCKS**2)]
        )
        whole = products.sum(axis=0)
        norms = np.sqrt(np.maximum(np.diag(whole), 0.0))
        if not (norms > 0).all() or np.linalg.eigvalsh((whole + whole.T) / np.outer(norms, norms))[0] < 2e-6:
            raise EstimationError("the slopes have no fine structure that determines shift and turn of the two maps")
        step = np.linalg.solve(whole, moments.sum(axis=0))
        others = np.stack(
            [np.linalg.solve(whole - products[one], moments.sum(axis=0) - moments[one]) for one in range(BLOCKS**2)]
        )
        return np.asarray(step), others


def _pair(map_a: SlopeMap, map_b: SlopeMap, motion: PlaneMotion) -> _Pair:
    moved = moved_map(map_b, motion, map_a.x_m, map_a.y_m)
    known = _both_slopes(map_a) & _both_slopes(moved)
    # Differences over two steps on each side: less noise, and no shift.
    gradients_a, gradients_b = (
        np.stack([_gradient(values, one) for values in (one.slope_x, one.slope_y)]) for one in (map_a, moved)
    )
    known &= np.isfinite(gradients_a).all(axis=(0, 1)) & np.isfinite(gradients_b).all(axis=(0, 1))
    count = int(np.count_nonzero(known))
    if count < 200:
        raise EstimationError(f"the two maps share {count} measured nodes; they are compared where both were measured")
    rows, columns = np.nonzero(known)
    chosen = np.arange(count)[:: max(1, count // _NODES)]
    rows, columns = rows[chosen], columns[chosen]
    places = np.stack([map_a.x_m[columns], map_a.y_m[rows]])
    centred = (places - places.mean(axis=1, keepdims=True)) / (0.5 * np.ptp(places, axis=1).max())

    def at(*fields: FloatArray) -> FloatArray:
        return np.stack([one[rows, columns] for one in fields])

    return _Pair(
        # The turn is about the origin of a, from where the shift counts.
        places - motion.shift_m[:, None],
        at(map_a.slope_x, map_a.slope_y),
        at(moved.slope_x, moved.slope_y),
        at(map_a.sigma_random_x, map_a.sigma_random_y),
        at(moved.sigma_random_x, moved.sigma_random_y),
        gradients_a[:, :, rows, columns],
        gradients_b[:, :, rows, columns],
        monomials(centred[0], centred[1], SMOOTH_DEGREE),
    )


def _both_slopes(slope_map: SlopeMap) -> BoolArray:
    return slope_map.valid & np.isfinite(slope_map.slope_y)


def _gradient(values: FloatArray, slope_map: SlopeMap) -> FloatArray:
    known = np.where(slope_map.valid, values, np.nan)
    found = np.full((2, *values.shape), np.nan)
    if min(values.shape) > 4:
        found[0][:, 2:-2] = (known[:, 4:] - known[:, :-4]) / (slope_map.x_m[4:] - slope_map.x_m[:-4])
        found[1][2:-2] = (known[4:] - known[:-4]) / (slope_map.y_m[4:] - slope_map.y_m[:-4])[:, None]
    return found
