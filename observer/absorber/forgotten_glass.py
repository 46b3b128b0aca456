"""A glass tube that the collector's data do not have: it shows itself where the tube stands near its own reflection.

Glass turns what passes close to the metal towards the side on which it passes, so that cameras near the optical axis
see the dark reflection beside the tube, and the tube as wider than from further out: by 0.25 to 0.7 px in ray-traced
photos of tubes 6 to 7 px wide. A bare tube is as wide from everywhere within 0.06 px. With the glass stated those
photos are left out (`observer.photo_edges.tube_bearings`).
"""

from dataclasses import dataclass

import numpy as np

from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.doubts import Doubt, Severity
from observer.photo_edges.tube_bearings import PRISM_RAD, Bearings
from observer.trough.collector import Collector

#: Photos that show the reflection beside the metal through glass, but not so near to it that blur alone joins both.
_NEAR_RAD = (5e-3, 0.75 * PRISM_RAD)
#: Photos in which nothing of it is beside the metal.
_FAR_RAD = 1.2 * PRISM_RAD
#: Fewest photos of each kind.
_FEWEST_NEAR, _FEWEST_FAR = 2, 3
#: So many pixels wider near the reflection, and so many sigmas.
_WIDER_PX, _TIMES_SIGMA = 0.15, 3.0


@dataclass(frozen=True, slots=True)
class Widening:
    """How much wider the tube looks near its own reflection than elsewhere.

    value_m, sigma_m: The difference and its standard deviation, from the scatter between photos [m].
    pixel_m: What a pixel covers at the tube [m].
    """

    value_m: float
    sigma_m: float
    pixel_m: float


def widening(bearings: Bearings) -> Widening | None:
    """Compare how wide the tube looks near its own reflection and elsewhere.

    Returns: None where too few photos show it near its reflection, or elsewhere.
    """
    own = [bearings.photo == k for k in np.unique(bearings.photo)]
    angle, wide = (
        np.array([np.median(values[rows]) for rows in own])
        for values in (bearings.to_reflection_rad, bearings.diameter_m)
    )
    near, far = wide[(angle > _NEAR_RAD[0]) & (angle < _NEAR_RAD[1])], wide[angle > _FAR_RAD]
    if near.size < _FEWEST_NEAR or far.size < _FEWEST_FAR:
        return None
    # Near the reflection the width follows the angle: the scatter of the others stands for both.
    scatter = robust_scale(far, centred=False)
    sigma = scatter * float(np.sqrt(np.pi / 2 * (1 / near.size + 1 / far.size)))
    return Widening(float(np.median(near) - np.median(far)), sigma, float(np.median(bearings.pixel_m)))


def glass_doubt(found: Widening | None, collector: Collector) -> Doubt | None:
    """Say whether there is glass around a tube that is stated to be bare.

    Returns: None where glass is stated, or nothing shows any.
    """
    if found is None or collector.glass is not None:
        return None
    if found.value_m <= max(_WIDER_PX * found.pixel_m, _TIMES_SIGMA * found.sigma_m, 0.0):
        return None
    return Doubt(
        "glass_not_stated",
        "collector: there seems to be glass around the absorber, and none is stated: near its own reflection the tube "
        f"looks {1e3 * found.value_m:.1f} +- {1e3 * found.sigma_m:.1f} mm wider than elsewhere, as glass that turns "
        "lines of sight makes it. State glass_outer_diameter_mm and glass_inner_diameter_mm; until then absorber and "
        "slopes may be wrong by more than their sigmas say",
        {"wider_m": found.value_m, "sigma_wider_m": found.sigma_m},
        Severity.SERIOUS,
    )
