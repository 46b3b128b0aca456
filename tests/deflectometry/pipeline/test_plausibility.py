"""Findings that make a result doubtful as a whole: each fires where its threshold says, and not before."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from deflectometry.dots.dot_source import DotSource
from deflectometry.fringes.observation import FRINGE_REMEDIES
from deflectometry.pipeline.curl_test import CurlRemedies, curl_doubt
from deflectometry.pipeline.plausibility import size_doubt
from deflectometry.pipeline.stated_inputs import StatedInput
from deflectometry.setup.dot_screen import DotScreen


@pytest.mark.parametrize(
    ("curl_per_m", "expected_per_m", "code"),
    [
        (1.4e-4, 1e-4, None),
        (1.6e-4, 1e-4, "curl_above_noise"),
        (4.0e-4, 1e-4, "slopes_of_no_surface"),
        # Four times the noise, but far below what spoils a mirror.
        (4.0e-6, 1e-6, "curl_above_noise"),
    ],
)
def test_curl_that_noise_does_not_explain_is_said(curl_per_m: float, expected_per_m: float, code: str | None) -> None:
    numbers = {"curl_rms_per_m": curl_per_m, "curl_expected_rms_per_m": expected_per_m}
    doubts = list(curl_doubt({"": numbers}, CurlRemedies.of_source(FRINGE_REMEDIES)))
    assert [doubt.code for doubt in doubts] == ([] if code is None else [code])


@pytest.mark.parametrize("curl_per_m", [1.6e-4, 4.0e-4])
def test_the_user_of_dots_is_told_what_he_can_do(curl_per_m: float) -> None:
    """Dots have neither steps nor periods nor a response."""
    row, column = np.mgrid[:9, :9].astype(np.float64)
    screen = DotScreen(np.stack([column, -row, 0.0 * row], axis=-1), (0, 0))
    source = DotSource(np.zeros((8, 8), dtype=np.float32), None, screen)
    numbers = {"curl_rms_per_m": curl_per_m, "curl_expected_rms_per_m": 1e-4}
    (doubt,) = curl_doubt({"": numbers}, CurlRemedies.of_source(source.remedies))
    assert "table" in doubt.text or "[screen] file" in doubt.text
    assert not any(word in doubt.text for word in ("period", "response", "pattern.set"))


@pytest.mark.parametrize(
    ("known_mm", "words"),
    [
        ((1.25, 0.5), "counted as known no better than the images know them (1.2 mm and 0.5 mm)"),
        ((1.25, np.inf), "counted as (1.2 mm and exact, of which the images know nothing)"),
    ],
)
def test_a_size_without_sigma_is_said_as_it_is_counted(known_mm: tuple[float, float], words: str) -> None:
    keys = ("screen.width_m", "screen.height_m")
    sizes = [
        SimpleNamespace(key=key, sigma_images=one, changes=np.ones(3)) for key, one in zip(keys, known_mm, strict=True)
    ]
    found = size_doubt(cast("list[StatedInput]", sizes), {"screen.sag"})
    assert found is not None
    assert words in found.text
