"""Phase and its sigma: known answers, the Cramer-Rao bound, honesty in repeated noise and noise models."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.screen import ScreenResponse
from deflectometry.fringes.phase import estimate_noise, residual_distortion, solve_steps, wrap_phase
from deflectometry.setup.patterns import equal_steps
from deflectometry.sources.noise_model import NoiseModel
from heliogauge.errors import EstimationError, InputError
from tests.deflectometry.one_pixel import fit_phase

STEP_SETS = {
    "3 equal": equal_steps(3),
    "4 equal": equal_steps(4),
    "7 equal": equal_steps(7),
    "odd": np.radians([3.0, 61.0, 150.0, 170.0, 291.0]),
    "3 of a quarter": np.radians([0.0, 90.0, 180.0]),
}


def _sinusoid(phase: np.ndarray, steps: np.ndarray, offset: float = 110.0, modulation: float = 60.0) -> np.ndarray:
    return offset + modulation * np.cos(phase[None] - steps.reshape(-1, *[1] * phase.ndim))


@given(
    st.floats(-np.pi + 1e-6, np.pi),
    st.lists(st.floats(0, 6.2), min_size=3, max_size=9, unique_by=lambda step: round(step, 1)),
    st.floats(0.1, 1e4),
)
def test_exact_sinusoids_come_back(phase: float, steps: list[float], modulation: float) -> None:
    angles = np.array(steps)
    frames = 3 * modulation + modulation * np.cos(phase - angles)
    fit = fit_phase(frames, angles, noise=NoiseModel(1.0))
    assert abs(wrap_phase(fit.phase_rad - phase)) < 1e-6
    assert fit.modulation_dn == pytest.approx(modulation, rel=1e-6)


def test_conventional_formula_of_four_steps() -> None:
    rng = np.random.default_rng(3)
    frames = rng.uniform(0, 255, (4, 50))
    fit = fit_phase(frames, equal_steps(4), noise=NoiseModel(1.0))
    np.testing.assert_allclose(fit.phase_rad, np.arctan2(frames[1] - frames[3], frames[0] - frames[2]), atol=1e-12)
    np.testing.assert_allclose(
        fit.modulation_dn, 0.5 * np.hypot(frames[1] - frames[3], frames[0] - frames[2]), atol=1e-12
    )


@pytest.mark.parametrize("n", [3, 4, 5, 16])
def test_equal_steps_reach_the_cramer_rao_bound(n: int) -> None:
    phase = np.linspace(-3, 3, 40)
    fit = fit_phase(_sinusoid(phase, equal_steps(n)), equal_steps(n), noise=NoiseModel(1.5))
    np.testing.assert_allclose(fit.sigma_rad, np.sqrt(2 / n) * 1.5 / 60.0, rtol=1e-9)


@pytest.mark.parametrize("name", STEP_SETS)
@pytest.mark.parametrize("noise", [NoiseModel(1.0), NoiseModel(0.5, 0.04)], ids=["read", "photon"])
def test_sigma_is_honest(name: str, noise: NoiseModel) -> None:
    rng = np.random.default_rng(11)
    steps = STEP_SETS[name]
    phase = rng.uniform(-np.pi, np.pi, 40_000)
    clean = _sinusoid(phase, steps)
    fit = fit_phase(clean + np.sqrt(noise.variance(clean)) * rng.standard_normal(clean.shape), steps, noise=noise)
    ratio = wrap_phase(fit.phase_rad - phase) / fit.sigma_rad
    # Chi-square of 40 000 samples: 99 % within 2.576 sqrt(2 / 40 000) = 1.8 %.
    assert np.mean(ratio**2) == pytest.approx(1.0, abs=0.018)


def test_sigma_is_honest_for_each_phase() -> None:
    rng = np.random.default_rng(4)
    steps, noise = STEP_SETS["3 of a quarter"], NoiseModel(0.3, 0.05)
    for phase in np.linspace(-3, 3, 7):
        clean = _sinusoid(np.full(20_000, phase), steps)
        fit = fit_phase(clean + np.sqrt(noise.variance(clean)) * rng.standard_normal(clean.shape), steps, noise=noise)
        ratio = wrap_phase(fit.phase_rad - phase) / fit.sigma_rad
        assert np.mean(ratio**2) == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize("noise_dn", [0.3, 1.0])
def test_sigma_includes_quantisation(noise_dn: float) -> None:
    rng = np.random.default_rng(5)
    phase = rng.uniform(-np.pi, np.pi, 40_000)
    frames = np.rint(_sinusoid(phase, equal_steps(4)) + noise_dn * rng.standard_normal((4, phase.size))).astype(
        np.uint8
    )
    fit = fit_phase(frames, equal_steps(4))  # noise estimated from the frames
    ratio = wrap_phase(fit.phase_rad - phase) / fit.sigma_rad
    # At 0.3 DN the rounding is not yet quite independent of the signal: its variance is 3 % off.
    assert np.mean(ratio**2) == pytest.approx(1.0, abs=0.05 if noise_dn < 0.5 else 0.02)


def test_sigma_includes_the_slope_of_the_response() -> None:
    rng = np.random.default_rng(6)
    levels = np.linspace(0, 255, 60)
    response = ScreenResponse(5 + 240 * (levels / 255) ** 2.2, levels)
    phase = rng.uniform(-np.pi, np.pi, 40_000)
    shown = _sinusoid(phase, equal_steps(5), 130.0, 80.0)
    readings = np.interp(shown, levels, response.camera_dn) + 0.7 * rng.standard_normal(shown.shape)
    fit = fit_phase(readings, equal_steps(5), noise=NoiseModel(0.7), response=response)
    ratio = wrap_phase(fit.phase_rad - phase) / fit.sigma_rad
    assert np.mean(ratio**2) == pytest.approx(1.0, abs=0.03)
    assert np.ptp(fit.sigma_rad) > 0.2 * fit.sigma_rad.mean()  # it differs from phase to phase, as the slope does


def test_noise_model_is_found() -> None:
    rng = np.random.default_rng(7)
    offsets = rng.uniform(20, 200, 20_000)
    phase = rng.uniform(-np.pi, np.pi, 20_000)
    true = NoiseModel(0.8, 0.02)
    for steps in (equal_steps(4), STEP_SETS["odd"]):
        clean = offsets + 0.8 * offsets * np.cos(phase - steps[:, None])
        frames = clean + np.sqrt(true.variance(clean)) * rng.standard_normal(clean.shape)
        found = estimate_noise(frames, [solve_steps(steps)])
        assert found.gain_dn == pytest.approx(true.gain_dn, rel=0.1)
        middle = np.array(110.0)
        assert found.variance(middle) == pytest.approx(float(true.variance(middle)), rel=0.03)


def test_harmonics_are_not_noise() -> None:
    rng = np.random.default_rng(8)
    phase = rng.uniform(-np.pi, np.pi, 20_000)
    steps = equal_steps(4)
    frames = _sinusoid(phase, steps) + 6.0 * np.cos(2 * (phase - steps[:, None])) + rng.standard_normal((4, phase.size))
    assert estimate_noise(frames, [solve_steps(steps)]).sigma_read_dn == pytest.approx(1.0, abs=0.02)
    # 10 % of second harmonic leaves (1, -1, 1, -1) / 2 times itself: 0.2 of the modulation on cos 2 phi.
    assert np.abs(residual_distortion(frames, solve_steps(steps))[0]) == pytest.approx([0.2, 0, 0, 0], abs=2e-3)


def test_outliers_do_not_set_the_noise() -> None:
    rng = np.random.default_rng(9)
    frames = _sinusoid(rng.uniform(-3, 3, 10_000), equal_steps(4)) + rng.standard_normal((4, 10_000))
    frames[1, :300] += 40
    assert estimate_noise(frames, [solve_steps(equal_steps(4))]).sigma_read_dn == pytest.approx(1.0, abs=0.03)


def test_wrong_number_of_frames_and_undetermined_steps() -> None:
    with pytest.raises(InputError, match="4 steps need as many frames"):
        fit_phase(np.zeros((3, 5)), equal_steps(4), noise=NoiseModel(1.0))
    with pytest.raises(EstimationError, match="do not determine"):
        fit_phase(np.zeros((4, 5)), [0, np.pi, 0, np.pi], noise=NoiseModel(1.0))
    with pytest.raises(EstimationError, match="pixel_noise_dn"):
        fit_phase(np.zeros((3, 5)), equal_steps(3))
    with pytest.raises(InputError, match="pixel noise"):
        NoiseModel(-1.0)


def test_pixels_without_fringes_have_no_phase() -> None:
    fit = fit_phase(np.full((4, 2), 7.0), equal_steps(4), noise=NoiseModel(1.0))
    assert (fit.sigma_rad > 1e6).all()
