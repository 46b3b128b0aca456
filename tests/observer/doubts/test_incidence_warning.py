"""Slantwise views along the trough: a word where slopes along it matter and were not measured, and none elsewhere."""

from dataclasses import replace

import numpy as np
import pytest

from heliogauge.slopes.map import SlopeMap, no_common_modes
from observer.product.longitudinal import incidence_doubt
from observer.trough.collector import ls2

EYES_M = np.stack([np.linspace(-3, 3, 61), np.zeros(61), np.full(61, 15.0)], axis=1)


def mirror(half_length_m: float) -> SlopeMap:
    x, y = np.linspace(-2.4, 2.4, 25), np.linspace(-half_length_m, half_length_m, 41)
    zero = np.zeros((41, 25))
    design = np.broadcast_to(x / (2 * 1.49), zero.shape)
    return SlopeMap(
        x,
        y,
        design,
        zero * np.nan,
        design,
        zero,
        zero + 1e-4,
        zero * np.nan,
        1.0,
        no_common_modes(),
        zero * np.nan,
        zero.astype(np.uint32),
        zero == 0,
        "trough",
        "trough",
        "nothing",
    )


def test_a_long_trough_in_one_pass_is_warned_of() -> None:
    said = incidence_doubt(mirror(6.0), EYES_M, ls2(), 2e-3)
    # 15 degrees from 15 m: beyond 3.7 to 4 m from the middle.
    assert said is not None
    assert 0.335 < said.numbers["slantwise_share"] < 0.385
    assert "up to 23" in said.text


@pytest.mark.parametrize("case", ["short", "two passes"])
def test_no_word_where_it_does_not_matter(case: str) -> None:
    found = mirror(3.5 if case == "short" else 6.0)
    if case == "two passes":
        zero = np.zeros(found.shape)
        found = replace(found, slope_y=zero, sigma_random_y=zero + 1e-4)
    assert incidence_doubt(found, EYES_M, ls2(), 2e-3) is None
