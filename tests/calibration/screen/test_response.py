"""Screen response: exact at its nodes, honest in its sigma, cheap on whole frames."""

import tracemalloc

import numpy as np
import pytest

from calibration.screen.response import GreyStep, ScreenResponse, fit_response, linearise_frames
from heliogauge.errors import EstimationError, InputError

LEVELS = np.linspace(0, 255, 18)
CAMERA = 4.0 + 230.0 * (LEVELS / 255) ** 2.2


def _steps(rng: np.random.Generator, noise: float = 1.0, pixels: int = 400) -> list[GreyStep]:
    pattern = rng.uniform(0.8, 1.2, pixels)
    pattern /= pattern.mean()
    return [
        GreyStep(level, reading * pattern + noise * rng.standard_normal(pixels))
        for level, reading in zip(LEVELS, CAMERA, strict=True)
    ]


def test_nodes_and_table() -> None:
    response = ScreenResponse(CAMERA, LEVELS)
    np.testing.assert_allclose(response.linearise(CAMERA), LEVELS, atol=1e-9)
    table = response.table(np.uint8)
    assert table.dtype == np.float32
    np.testing.assert_allclose(table, np.interp(np.arange(256), CAMERA, LEVELS), rtol=1e-6)
    assert (np.diff(table) >= 0).all()


def test_slope_is_the_derivative_and_never_zero() -> None:
    response = ScreenResponse([10.0, 20.0, 40.0], [0.0, 50.0, 70.0])
    np.testing.assert_allclose(response.slope(np.array([15.0, 30.0])), [5.0, 1.0])
    assert (response.slope(np.array([0.0, 100.0])) >= 70 / 30).all()


def test_whole_frames_without_large_temporaries() -> None:
    frames = np.random.default_rng(1).integers(0, 256, (8, 300, 400), dtype=np.uint8)
    response = ScreenResponse(CAMERA, LEVELS)
    expected = np.interp(frames, CAMERA, LEVELS)
    tracemalloc.start()
    levels = linearise_frames(frames, response)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    np.testing.assert_allclose(levels, expected, atol=1e-4)
    assert peak < 1.2 * levels.nbytes
    again = np.empty_like(levels)
    assert (
        linearise_frames(frames.transpose(0, 2, 1), response, out=np.empty((8, 400, 300), np.float32)).shape[1] == 400
    )
    assert linearise_frames(frames, response, out=again) is again
    wide = linearise_frames(frames.astype(np.uint16), response)
    np.testing.assert_array_equal(wide, levels)


def test_fit_finds_the_response_with_honest_sigma() -> None:
    rng = np.random.default_rng(2)
    ratios = []
    for _ in range(40):
        found = fit_response(_steps(rng))
        true = np.interp(found.display_level, LEVELS, CAMERA)
        ratios.append((found.camera_dn - true) / found.sigma_camera_dn)
    assert np.mean(np.concatenate(ratios) ** 2) == pytest.approx(1.0, abs=0.15)


def test_levels_that_the_camera_cannot_tell_apart_are_joined() -> None:
    rng = np.random.default_rng(3)
    found = fit_response(_steps(rng, noise=30.0))
    assert len(found.camera_dn) < len(LEVELS)
    assert (np.diff(found.camera_dn) > 0).all()
    assert (np.diff(found.display_level) > 0).all()


def test_saturated_levels_are_left_out() -> None:
    found = fit_response(_steps(np.random.default_rng(4)), saturation_dn=150.0)
    assert found.camera_dn.max() < 150.0


def test_refusals() -> None:
    rng = np.random.default_rng(5)
    steps = _steps(rng)
    with pytest.raises(InputError, match="at least 3 different"):
        fit_response(steps[:2])
    with pytest.raises(InputError, match="at least 3 different"):
        fit_response([*steps, steps[0]])
    swapped = [
        GreyStep(a.level, b.readings_dn)
        for a, b in zip(steps, [*steps[:8], steps[12], *steps[9:12], steps[8], *steps[13:]], strict=True)
    ]
    with pytest.raises(EstimationError, match="the reading falls from"):
        fit_response(swapped)
    with pytest.raises(EstimationError, match="raise the exposure"):
        fit_response([GreyStep(level, 10 + rng.standard_normal(50)) for level in LEVELS], noise_dn=1000.0)
    with pytest.raises(InputError, match="ascending"):
        ScreenResponse([1.0, 1.0], [0.0, 1.0])
    with pytest.raises(InputError, match="uint8 and uint16"):
        ScreenResponse(CAMERA, LEVELS).table(np.float32)
    with pytest.raises(InputError, match="out"):
        linearise_frames(
            np.zeros((1, 2, 3), np.uint8), ScreenResponse(CAMERA, LEVELS), out=np.zeros((1, 2, 2), np.float32)
        )
