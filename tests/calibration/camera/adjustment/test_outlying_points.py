"""Image points that are left out: beyond six of the sigmas that are usual, whatever these are."""

import numpy as np
import pytest

from calibration.camera.adjustment.board_adjustment import within_usual


@pytest.mark.parametrize("sigma", [0.2, 1.0, 3.0])
def test_six_sigmas_of_what_is_usual(sigma: float) -> None:
    off = sigma * np.random.default_rng(4).standard_normal((4001, 2))
    lengths = np.sum(off**2, axis=1)
    assert within_usual(lengths).all()
    beside = np.array([5.7, 6.3]) * sigma
    kept = within_usual(np.append(lengths, beside**2))
    assert kept[:-1].all()
    assert not kept[-1]
