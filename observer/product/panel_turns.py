"""Which panels are to be turned: whether a gain is sure, and whether it is worth the work, in words.

A gain is a share of the light that the whole trough reflects. It is worth a turn where it is at least
`LEAST_GAIN_SHARE` of the light that the panel itself reflects, so that the answer does not depend on how many panels a
trough has.
"""

from enum import StrEnum

import numpy as np

from heliogauge.validate import BoolArray, FloatArray

#: Less of a panel's own light is not worth a turn. A convention, not a result: change it to what a turn costs.
LEAST_GAIN_SHARE = 1e-3
#: A loss is sure beyond so many of its sigmas, as a gain is; a gain surely stays below what is that far above it.
_SURE = 3.0


class TurnAdvice(StrEnum):
    """What to do with a panel.

    TURN: The gain is sure and worth the work.
    NOT_WORTH: What it gains, if anything, is surely too small to matter.
    NOT_SURE: Neither a gain nor a loss is sure, and the gain may be worth the work.
    LOSES: Turned to mean angle zero the panel surely loses light.
    UNKNOWN: Too little of the panel is measured.
    """

    TURN = "turn"
    NOT_WORTH = "not worth it"
    NOT_SURE = "not sure"
    LOSES = "would lose light"
    UNKNOWN = "not known"


def is_worth(gain_ratio: FloatArray) -> BoolArray:
    """Return which panels gain enough to be worth a turn.

    gain_ratio (k,): Gain of each panel of the trough; NaN where it is not known.
    """
    with np.errstate(invalid="ignore"):
        return np.asarray(gain_ratio * gain_ratio.size >= LEAST_GAIN_SHARE)


def turn_advice(gain_ratio: FloatArray, sigma_gain_ratio: FloatArray, sure: BoolArray) -> tuple[TurnAdvice, ...]:
    """Say what to do with each panel.

    gain_ratio, sigma_gain_ratio (k,): Gain with its standard deviation; NaN where it is not known.
    sure (k,): Which gains are sure.
    """
    with np.errstate(invalid="ignore"):
        loses = gain_ratio < -_SURE * sigma_gain_ratio
        too_small = np.isfinite(sigma_gain_ratio) & ~is_worth(gain_ratio + _SURE * sigma_gain_ratio)
    kinds = [
        (np.isnan(gain_ratio), TurnAdvice.UNKNOWN),
        (sure & is_worth(gain_ratio), TurnAdvice.TURN),
        (sure, TurnAdvice.NOT_WORTH),
        (loses, TurnAdvice.LOSES),
        (too_small, TurnAdvice.NOT_WORTH),
    ]
    chosen = np.select([which for which, _ in kinds], [str(kind) for _, kind in kinds], str(TurnAdvice.NOT_SURE))
    return tuple(TurnAdvice(one) for one in chosen)
