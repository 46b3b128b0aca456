"""Findings that make a result doubtful as a whole: each fires where its threshold says, and not before."""

import pytest

from deflectometry.pipeline.curl_test import curl_doubt


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
    assert [doubt.code for doubt in curl_doubt({"": numbers})] == ([] if code is None else [code])
