"""How far along the trough the errors of a photo's edges are alike.

What displaces an edge beside its noise of pixels (the sky's brightness beside it, what glass and faces throw back, the
grid of pixels along which it runs) does so over decimetres of its curve. A row by itself errs by the whole of it, and
that is in the sigma of each edge; but what all rows have in common, poses, tube and heights of panels, is found from
many rows together, which then are not as many as they seem.
"""

from dataclasses import dataclass

import numpy as np

from heliogauge.validate import FloatArray, IntArray

#: Residuals are cut off at so many standard deviations: outliers of a curve are alike, too.
_MOST_SIGMAS = 3.0
#: Fewer pairs of edges do not determine a correlation.
_FEWEST_PAIRS = 200
#: Lengths that are tried, in all rows' extent, and how many; the correlation is read up to this share of the extent.
_LONGEST, _LENGTHS, _READ_SHARE = 1.0, 30, 0.25


@dataclass(frozen=True, slots=True)
class EdgeLikeness:
    """Errors of edges of one curve have the correlation ``share exp(-distance / length)``.

    share: Share of their variance that is alike in neighbouring rows.
    length_m: Length over which it is [m].
    """

    share: float
    length_m: float

    def correlation(self, y_m: FloatArray) -> FloatArray:
        """Return the correlation of edges of one curve in different rows, shape (r, r)."""
        apart = self.share * np.exp(-np.abs(y_m[:, None] - y_m) / self.length_m)
        np.fill_diagonal(apart, 1.0)
        return np.asarray(apart)

    def counted(self, y_m: FloatArray) -> float:
        """Return by how much larger sigmas are for what is a mean over rows than if each row were by itself."""
        return float(np.sqrt(self.correlation(y_m).sum(axis=1).mean()))


#: Edges of which each has errors of its own.
APART = EdgeLikeness(0.0, 1.0)


def edge_likeness(normalised: FloatArray, curve: IntArray, row: IntArray, y_m: FloatArray) -> EdgeLikeness:
    """Estimate how far errors of edges are alike from what is left of them.

    Shapes: normalised (m,), curve (m,), row (m,).
    normalised: What remains of each edge over its sigma.
    curve, row: Its curve and its row.
    y_m (r,): Rows [m].

    Autocovariance along the curves, to which share and length are fitted, each lag by the number of its pairs. Slopes
    of a row follow the errors of its edges by a share that is the same in the next rows, which leaves the correlation
    as it is. Where nothing is left of any edge, or that of one is unknown, nothing is said to be alike.
    """
    value = np.clip(normalised, -_MOST_SIGMAS, _MOST_SIGMAS)
    variance = float(np.mean(value**2)) if value.size else 0.0
    if row.size < _FEWEST_PAIRS or y_m.size < 3 or not 0.0 < variance < np.inf:
        return APART
    # One line for each curve; where a curve has two edges in a row one of them stands for both. Single edges are no
    # pairs.
    going_on = np.bincount(curve)[curve] > 1
    number = np.unique(curve[going_on], return_inverse=True)[1]
    table = np.full((int(number.max(initial=-1)) + 1, y_m.size), np.nan)
    table[number, row[going_on]] = value[going_on]
    known = np.isfinite(table)
    filled = np.where(known, table, 0.0)
    lags = np.arange(1, max(2, int(_READ_SHARE * y_m.size)) + 1)
    pairs, shared = np.rint(_products(known.astype(np.float64), lags)), _products(filled, lags)
    enough = pairs >= _FEWEST_PAIRS
    if not enough.any():
        return APART
    lags, pairs = lags[enough], pairs[enough]
    found = shared[enough] / pairs / variance
    step = float(y_m[1] - y_m[0])
    lengths = np.geomspace(step, _LONGEST * float(np.ptp(y_m)), _LENGTHS)
    shapes = np.exp(-lags * step / lengths[:, None])
    share = np.clip((shapes @ (pairs * found)) / (shapes**2 @ pairs), 0.0, 1.0)
    left = (pairs * (found - share[:, None] * shapes) ** 2).sum(axis=1)
    best = int(np.argmin(left))
    return EdgeLikeness(float(share[best]), float(lengths[best]))


def _products(table: FloatArray, lags: IntArray) -> FloatArray:
    """Return the sum of all products of values of one line at some distances, from spectra.

    Shapes: table (k, r), lags (n,), result (n,).
    """
    # Distances beyond the largest may fold back; a power of two takes a third of the time.
    size = 1 << int(table.shape[1] + lags.max() - 1).bit_length()
    spectra = np.fft.rfft(table, size, axis=1)
    power = sum(np.einsum("rn,rn->n", part, part) for part in (spectra.real, spectra.imag))
    return np.fft.irfft(power, size)[lags]
