"""Which panels are worth a turn."""

import numpy as np
import pytest

from observer.product.panel_turns import LEAST_GAIN_SHARE, TurnAdvice, is_worth, turn_advice


def test_the_limit_is_a_share_of_the_panels_own_light():
    for count in (4, 16):
        just = np.full(count, LEAST_GAIN_SHARE / count)
        assert is_worth(1.01 * just).all()
        assert not is_worth(0.99 * just).any()
    # A convention that documents state: 0.1 %.
    assert pytest.approx(1e-3) == LEAST_GAIN_SHARE


def test_each_panel_gets_one_advice():
    gain = np.array([1e-2, 1e-5, 1e-2, -1e-3, np.nan, 1e-6, -1e-6, 1e-6])
    sigma = np.array([1e-3, 1e-6, 1e-2, 1e-4, np.nan, 1e-6, 1e-4, np.nan])
    sure = np.array([True, True, False, False, False, False, False, False])
    assert turn_advice(gain, sigma, sure) == (
        TurnAdvice.TURN,
        TurnAdvice.NOT_WORTH,
        TurnAdvice.NOT_SURE,
        TurnAdvice.LOSES,
        TurnAdvice.UNKNOWN,
        # Far from sure, yet whatever it is, it is not worth a turn (1e-3 of an eighth of the light).
        TurnAdvice.NOT_WORTH,
        TurnAdvice.NOT_SURE,
        TurnAdvice.NOT_SURE,
    )
