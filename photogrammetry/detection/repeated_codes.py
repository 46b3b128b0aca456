"""Of several targets of one photo with one code: which is the print, and which an icon or a logo that reads like it."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from heliogauge.adjust.robust_scale import SIGMA_PER_MAD
from heliogauge.validate import FloatArray
from photogrammetry.centers.ellipse import Ellipse
from photogrammetry.detection.decode import RingLimits, RingReading

#: Odds from which the less likely of two targets with one code is refused alone: 1000 to 1, as a difference of squares.
_CLEAR_ODDS = 2 * np.log(1000.0)
#: Neighbours with which size and shape are compared, and the least that say something.
_NEIGHBOURS, _FEWEST = 8, 3
#: Spread of size (its logarithm) and of shape that neighbours have in any case.
_LEAST_SPREAD = 0.05


def implausible_repeats(
    names: Sequence[str], dots: Sequence[Ellipse], readings: Sequence[RingReading], limits: RingLimits
) -> dict[int, str]:
    """Return why some of the targets with one code are not the print of that code, by their number.

    names, dots, readings: Names, outlines and rings of the targets of one photo.
    Returns: Targets whose twin is clearly more likely, by ring, size and shape; twins as likely as each other are not
        among them.
    """
    repeated = {name for name, count in Counter(names).items() if count > 1}
    if not repeated:
        return {}
    places = np.array([dot.center_px for dot in dots])
    features = np.array([_features(dot) for dot in dots])
    sure = np.array([k for k, name in enumerate(names) if name not in repeated], dtype=np.intp)
    refused: dict[int, str] = {}
    for name in sorted(repeated):
        twins = [k for k, other in enumerate(names) if other == name]
        terms = {k: _terms(k, places, features, sure, readings[k], limits) for k in twins}
        best = min(twins, key=lambda k: sum(terms[k].values()))
        for k in twins:
            worse = sum(terms[k].values()) - sum(terms[best].values())
            if k == best or worse < _CLEAR_ODDS:
                continue
            most = max(terms[k], key=terms[k].__getitem__)
            x, y = places[best].tolist()
            refused[k] = f"{most}; the one at ({x:.0f}, {y:.0f}) px is far more likely {name}"
    return refused


def _features(dot: Ellipse) -> tuple[float, float, float]:
    """Return logarithm of the size, and stretch and turn of an ellipse without its size."""
    (xx, xy), (_, yy) = dot.shape_px2
    return float(np.log(dot.radius_px)), float((xx - yy) / (xx + yy)), float(2 * xy / (xx + yy))


def _terms(
    k: int, places: FloatArray, features: FloatArray, sure: np.ndarray, reading: RingReading, limits: RingLimits
) -> dict[str, float]:
    """Return the squared deviations of a target, in standard deviations, by what they say of it."""
    terms = {"its ring is less like a print": reading.square(limits)}
    if len(sure) < _FEWEST:
        return terms
    near = sure[np.argsort(np.hypot(*(places[sure] - places[k]).T))[:_NEIGHBOURS]]
    middle = np.median(features[near], axis=0)
    spread = np.maximum(SIGMA_PER_MAD * np.median(np.abs(features[near] - middle), axis=0), _LEAST_SPREAD)
    off = (features[k] - middle) / spread
    ratio = float(np.exp(features[k, 0] - middle[0]))
    terms[f"its dot has {ratio:.2g} times the size of its neighbours'"] = float(off[0] ** 2)
    terms["its dot is stretched otherwise than its neighbours'"] = float(off[1] ** 2 + off[2] ** 2)
    return terms
