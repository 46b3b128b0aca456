"""How much more a centre errs than residuals that are independent would make it err, from the residuals themselves.

Moire, the pixels of a display, JPEG blocks and paper make neighbouring pixels err alike. To first order the edge's
residuals shift it outwards by some d(t) round the outline; the centre takes the first harmonic of d, and the residuals
keep none of it: size, centre and shape of the ellipse took its harmonics up to the second. What has no preferred length
on the outline has as much of the next ones. So the centre's variance is that of the third to sixth harmonic, weighted
as the fit weighs pixels; where the third exceeds those after it the power still rises towards the first.
"""

import numpy as np
import numpy.typing as npt

from heliogauge.validate import FloatArray

#: Harmonics of the outline in which residuals are looked at. On 582 targets of drawn displays (8 to 150 px, beats of 4
#: to 21 px) the third to fifth predict the centres as well as these, the third to eighth worse.
HARMONICS = (3, 4, 5, 6)
#: A target counts at most so many times the median of its photo: dust is no property of the photo.
_MOST_MEDIANS = 5.0
#: Targets with independent residuals that are taken to be there as well.
_PRIOR_TARGETS = 1.0


def edge_powers(
    influence: npt.NDArray[np.floating],
    unit: tuple[npt.NDArray[np.floating], npt.NDArray[np.floating]],
    residuals: npt.NDArray[np.floating],
    variance: npt.NDArray[np.floating],
) -> FloatArray:
    """Return the power of residuals in harmonics of n outlines, in units of that of independent ones.

    Shapes: influence (n, 2, k), unit (n, k) each, residuals (n, k), variance (n, k), result (n, 4).
    influence: What a residual shifts the centre by, in the frame in which the outline is a circle; 0 for pixels that
        are not used.
    unit: Places of the pixels in that frame, x and y.
    variance: Of independent residuals.
    """
    weight = influence[:, 0] + 1j * influence[:, 1]
    turn = unit[0] + 1j * unit[1]
    turn /= np.maximum(np.abs(turn), np.finfo(turn.real.dtype).tiny)
    usual = ((weight.real**2 + weight.imag**2) * variance).sum(axis=1)
    term = weight * residuals * turn
    found = []
    for _ in HARMONICS:
        term = term * turn
        found.append(np.abs(term.sum(axis=1)) ** 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.nan_to_num(np.stack(found, axis=1) / usual[:, None], nan=1.0), dtype=np.float64)


def variance_factor(powers: FloatArray) -> float:
    """Return by how much the variances of all centres of a photo exceed those of independent residuals, at least 1.

    powers (n, 4): Of `edge_powers`, of the photo's targets.
    """
    count = len(powers)
    if not count:
        return 1.0
    known = np.minimum(powers, _MOST_MEDIANS * np.median(powers, axis=0))
    each = known.mean(axis=0)
    # Each harmonic of one target has two freedoms, so that the logarithm of the ratio has this sigma.
    sigma = np.sqrt((1 + 1 / (len(each) - 1)) / count)
    rising = max(1.0, float(each[0] / max(each[1:].mean(), 1e-12) * np.exp(-sigma)))
    return max(1.0, (count * float(each.mean()) * rising + _PRIOR_TARGETS) / (count + _PRIOR_TARGETS))
