"""Along the trough: values of a row that its neighbours on the panel do not confirm, and values that are missing.

Each row of the map was solved alone (`observer.slopes.row_spline`). Along a column of one panel the slope error is
again an integrated random walk, whose roughness is taken from the rows' own values. It bridges what no edge of the
reflection came near to: the last centimetres beside panel edges, and islands around which the level curves of
theta_ra run.
"""

from dataclasses import dataclass

import numpy as np

from heliogauge.validate import BoolArray, FloatArray, IntArray
from observer.slopes.banded_cholesky import factorise

#: A value further than this from what its neighbours along the trough say is wrong, in standard deviations.
_REJECT_TIMES = 5.0
#: Distance at which the roughness along the trough is read: several rows, so that noise is the smaller part [m].
_ROUGHNESS_REACH_M = 0.2
#: The least roughness [rad^2 / m^3], as in `observer.slopes.joint_solution`.
_LEAST_ROUGHNESS = 1e-8
#: What a row errs alone is at least this share of its variance.
_LEAST_APART = 0.01
#: What rows further off say of a value: to either side as far as this, and so many predictions at least. Slopes of
#: panels run straight over eight rows of 20 mm; over a metre they do not, and maps of 0.2 m a row lost all values.
_REACH_BESIDE_M, _FEWEST_BESIDE = 0.16, 3
#: With so many lone values a row is not believed anywhere on that panel.
_MISLED_NODES = 3
#: Values nearer than this to what the rows beside them say are left alone, however sure all are [rad].
_CLOSE_RAD = 5e-4
#: Keeps columns without any value solvable [rad].
_LARGEST_SLOPE_RAD = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Bridged:
    """Values of all nodes from those along the trough.

    value (r, nx): Slope error [rad].
    variance (r, nx): Its variance, with that of the values it rests on [rad^2].
    contradicted (r, nx): Values that their neighbours do not confirm.
    """

    value: FloatArray
    variance: FloatArray
    contradicted: BoolArray


def bridge_rows(value: FloatArray, variance: FloatArray, good: BoolArray, panel: IntArray, step_m: float) -> Bridged:
    """Interpolate values along the columns of each panel.

    Shapes: good (r, nx).
    value, variance (r, nx): Slope error of each node and its variance [rad, rad^2].
    panel (r, nx): Panel of each node, -1 for none.
    step_m: Distance of the rows [m].

    Neighbouring values share errors (the slope along the trough, say), so their variance is not reduced by averaging:
    that of the nearest values is added to the variance of the interpolation.
    """
    rows = value.shape[0]
    joined = ((panel[1:] == panel[:-1]) & (panel[1:] >= 0)).any(axis=1)
    roughness, apart = _roughness(value, variance, good, joined, step_m)
    weight = 1 / (apart * variance)
    kept = good
    for _ in range(2):
        smooth, spread = _smooth(np.where(kept, value, 0.0), np.where(kept, weight, 0.0), joined, roughness, step_m)
        kept = good & (np.abs(value - smooth) < _REJECT_TIMES * np.sqrt(variance + spread))
    smooth, spread = _smooth(np.where(kept, value, 0.0), np.where(kept, weight, 0.0), joined, roughness, step_m)
    own, _ = _smooth(np.where(kept, variance, 0.0), np.where(kept, 1e12, 0.0), joined, 1e-6, step_m)
    base = np.maximum(own, float(np.median(variance[kept])) if kept.any() else 0.0)
    return Bridged(smooth[:rows], (spread + base)[:rows], good & ~kept)


def lone_values(
    value: FloatArray, variance: FloatArray, usable: BoolArray, panel: IntArray, step_m: float
) -> BoolArray:
    """Tell which values stand alone against those of the rows around them, sure or not.

    value, variance (r, nx): Slope error of each node and its variance [rad, rad^2].
    usable (r, nx): Which to look at, and to compare with.
    panel (r, nx): Panel of each node, -1 for none.
    step_m: Distance of the rows [m].
    Returns (r, nx): Values that most of the predictions by their neighbours contradict.

    One false edge of the reflection makes its row sure of a wrong value where the right ones of all other rows are
    not sure enough to bridge from: in a path-traced trough such a row was 11 mrad off, and so were 25 rows beside it.
    Two rows foretell a third along a straight line; the median over pairs of rows leaves a false one among them out.
    """
    rows = value.shape[0]
    known = np.where(usable, value, np.nan)

    def shifted(step: int, of: FloatArray) -> FloatArray:
        found = np.full(of.shape, np.nan)
        here, there = slice(max(-step, 0), rows - max(step, 0)), slice(max(step, 0), rows - max(-step, 0))
        same = (panel[here] == panel[there]) & (panel[here] >= 0)
        found[here] = np.where(same, of[there], np.nan)
        return found

    steps = range(1, max(min(int(_REACH_BESIDE_M / step_m + 1e-6), rows - 1), 1) + 1)
    near = {way * k: shifted(way * k, known) for k in steps for way in (-1, 1)}
    pairs = [0.5 * (near[k] + near[-k]) for k in steps]
    pairs += [2 * near[way * k] - near[2 * way * k] for k in steps if 2 * k in near for way in (-1, 1)]
    foretold, count = _median(np.stack(pairs))
    # At the end of a panel the median of four straight lines errs by 1.4 times what one row does.
    spread, _ = _median(np.stack([shifted(k, np.where(usable, variance, np.nan)) for k in near]))
    with np.errstate(invalid="ignore"):
        allowed = np.maximum(_REJECT_TIMES * np.sqrt(variance + 2 * spread), _CLOSE_RAD)
        lone = usable & (count >= _FEWEST_BESIDE) & (np.abs(value - foretold) > allowed)
    # What misleads a row at some nodes of a panel misleads it at the others, where no neighbours may show it.
    place = np.maximum(panel, 0) * rows + np.arange(rows)[:, None]
    misled = np.bincount(place[lone], minlength=int(place.max()) + 1) >= _MISLED_NODES
    return np.asarray(usable & (lone | misled[place]))


def _median(values: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return the median over the first axis without what is NaN, and how many it is of."""
    ordered = np.sort(values, axis=0)
    count = np.isfinite(values).sum(axis=0)
    both = [np.take_along_axis(ordered, np.maximum(at, 0)[None], axis=0)[0] for at in ((count - 1) // 2, count // 2)]
    return 0.5 * (both[0] + both[1]), count


def _roughness(
    value: FloatArray, variance: FloatArray, good: BoolArray, joined: BoolArray, step_m: float
) -> tuple[float, float]:
    """Return the spectral density of the second derivative along the trough [rad^2 / m^3], and what rows err alone.

    That is the share of their variance that one row does not have in common with the next ones.
    """
    lag = max(1, round(_ROUGHNESS_REACH_M / step_m))
    far, near = (_second_differences(value, variance, good, joined, reach) for reach in (lag, 1))
    if far is None or near is None:
        return 1.0, 1.0
    # Neighbouring rows share poses, the slope along the trough and the distance to the next edge: what they differ by
    # from one to the next is noise, often much less than sigma; taken for noise, sigma hides the roughness.
    apart = min(max(near[0] / near[1], _LEAST_APART), 1.0)
    excess = far[0] - apart * far[1]
    return max(1.5 * excess / (lag * step_m) ** 3, _LEAST_ROUGHNESS), apart


def _second_differences(
    value: FloatArray, variance: FloatArray, good: BoolArray, joined: BoolArray, lag: int
) -> tuple[float, float] | None:
    """Return the variance of second differences of values some rows apart, and what theirs alone would make it."""
    if value.shape[0] <= 2 * lag:
        return None
    run = np.concatenate([[0], np.cumsum(joined)])
    whole = (run[2 * lag :] - run[: -2 * lag] == 2 * lag)[:, None]
    triple = good[2 * lag :] & good[lag:-lag] & good[: -2 * lag] & whole
    if np.count_nonzero(triple) < 50:
        return None
    second = (value[2 * lag :] - 2 * value[lag:-lag] + value[: -2 * lag])[triple]
    noise = (variance[2 * lag :] + 4 * variance[lag:-lag] + variance[: -2 * lag])[triple]
    # An integrated random walk has second differences of the variance 2/3 q h^3 at the distance h.
    # Four fifths of a normal distribution lie within 1.28 sigma; wrong values are in the rest.
    return (float(np.quantile(np.abs(second), 0.8)) / 1.2816) ** 2, float(np.median(noise))


def _smooth(
    value: FloatArray, weight: FloatArray, joined: BoolArray, roughness: float, step_m: float
) -> tuple[FloatArray, FloatArray]:
    """Return the smoothing spline of each column and its variance."""
    rows, columns = value.shape
    count = rows + rows % 2
    bands = np.zeros((3, count))
    bands[0] = _LARGEST_SLOPE_RAD**-2
    stiffness = (joined[:-1] & joined[1:]) / (roughness * step_m**3)
    parts = (1.0, -2.0, 1.0)
    for first in range(3):
        for other in range(first, 3):
            bands[other - first, first : first + rows - 2] += parts[first] * parts[other] * stiffness
    whole = np.repeat(bands.T[None], columns, axis=0)
    whole[:, :rows, 0] += weight.T
    factor = factorise(whole)
    right = np.zeros((columns, count))
    right[:, :rows] = (weight * value).T
    spread = np.diagonal(factor.inverse_blocks(), axis1=2, axis2=3).reshape(columns, count)
    return factor.solve(right).T[:rows], spread.T[:rows]
