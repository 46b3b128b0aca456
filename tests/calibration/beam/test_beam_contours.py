"""Contours of a beam: on the level itself, closed at the picture's edge too."""

import numpy as np
import pytest

from calibration.beam.light.beam_size import LightPicture
from calibration.beam.light.contours import beam_contours

SIGMA_PX, SMOOTHING_PX, PIXEL_M = 5.0, 0.5, 0.01


def picture(column: float) -> LightPicture:
    y, x = np.mgrid[0:60, 0:80].astype(float)
    values = 200 * np.exp(-((x - column) ** 2 + (y - 30.0) ** 2) / (2 * SIGMA_PX**2))
    inside = values > 1
    return LightPicture(
        values, inside, inside, np.zeros_like(inside), PIXEL_M * np.arange(80), -PIXEL_M * np.arange(60)
    )


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_a_line_lies_on_its_level(share: float) -> None:
    (found,) = beam_contours(picture(40.0), SMOOTHING_PX, [share])
    (line,) = found.lines_m
    radius = np.hypot(line[:, 0] / PIXEL_M - 40.0, line[:, 1] / PIXEL_M + 30.0)
    # A Gaussian that a Gaussian smooths is one of sigma^2 + smoothing^2; a chord of 1 px is 1 / 8 r inside its arc.
    expected = np.sqrt(-2 * np.log(share) * (SIGMA_PX**2 + SMOOTHING_PX**2))
    assert np.abs(radius - expected).max() < 0.05
    assert np.abs(np.mean(radius - expected)) < 0.02


def test_a_beam_at_the_edge_of_the_picture_has_a_closed_line() -> None:
    (found,) = beam_contours(picture(1.0), SMOOTHING_PX, [0.5])
    (line,) = found.lines_m
    step = np.linalg.norm(np.diff(np.concatenate([line, line[:1]]), axis=0), axis=1)
    assert step.max() < 4 * PIXEL_M
    assert line[:, 0].min() >= -PIXEL_M
