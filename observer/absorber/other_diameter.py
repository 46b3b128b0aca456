"""A tube that is not found where it is: whether one of another diameter than stated would be."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from observer.photo_edges.tube_bearings import tube_bearings
from observer.photo_edges.views import Shot
from observer.trough.expectation import Expectation

#: The tube is found with a diameter stated within a tenth of its own: steps of a sixteenth, from half to twice.
_FACTORS = 2.0 ** np.linspace(-1.0, 1.0, 23)
#: With its own diameter it is found in so many times the rows as with a wrong one (1,800 against 140 at most), and in
#: such a share of all rows (0.48 there): what is found of a tube that cannot be seen is here and there.
_TIMES_ROWS, _LEAST_SHARE = 5, 0.25
#: Its own width scatters little (quartiles 1.5 % beside the median); where edges of other things pair up, it does.
_MOST_SPREAD = 0.05


def other_diameter_m(shots: Sequence[Shot], expected: Expectation) -> float | None:
    """Find the diameter with which photos show the tube that they do not show with the stated one.

    shots: Some of the photos.
    expected: With the stated diameter.
    Returns: How thick the tube looks; None where no other diameter is seen in many more rows [m].
    """
    collector = expected.collector

    def widths(diameter_m: float) -> np.ndarray:
        trial = replace(collector, absorber_diameter_m=diameter_m, glass=None)
        found = tube_bearings(shots, replace(expected, collector=trial))
        return np.concatenate([one.diameter_m for one in found])

    stated = widths(collector.absorber_diameter_m).size
    trials = [widths(factor * collector.absorber_diameter_m) for factor in _FACTORS]
    best = max(trials, key=len)
    if best.size <= max(_TIMES_ROWS * stated, _LEAST_SHARE * len(shots) * expected.y_m.size):
        return None
    low, middle, high = np.quantile(widths(float(np.median(best))), [0.25, 0.5, 0.75])
    return float(middle) if high - low < _MOST_SPREAD * middle else None
