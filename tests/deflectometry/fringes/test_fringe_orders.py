"""Fringe orders: right answers, honest odds, the edges of the display, any set of periods."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deflectometry.fringes.phase import wrap_phase
from heliogauge.errors import EstimationError, InputError
from tests.deflectometry.one_pixel import unwrap_temporal


def _phases(
    fraction: np.ndarray, periods: list[float], sigmas: list[float], rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    spread = np.broadcast_to(np.array(sigmas)[:, None], (len(periods), fraction.size))
    exact = 2 * np.pi * np.array(periods)[:, None] * fraction
    return wrap_phase(exact + spread * rng.standard_normal(exact.shape)), spread


@given(st.floats(0, 1), st.permutations([0.9, 3.9, 15.9, 63.9]))
def test_exact_phases_give_the_position_in_any_order(fraction: float, periods: list[float]) -> None:
    phases = wrap_phase(2 * np.pi * np.array(periods)[:, None] * np.array([fraction]))
    found = unwrap_temporal(phases, np.full((4, 1), 1e-3), periods)
    assert found.fraction[0] == pytest.approx(fraction, abs=1e-9)
    assert found.wrong_order_probability[0] < 1e-12


def test_sigma_of_the_mean_is_honest_and_better_than_the_finest_set() -> None:
    rng = np.random.default_rng(1)
    true = rng.uniform(0, 1, 40_000)
    periods, sigmas = [0.9, 4.0, 16.0], [0.01, 0.01, 0.02]
    found = unwrap_temporal(*_phases(true, periods, sigmas, rng), periods)
    assert np.mean(((found.fraction - true) / found.sigma) ** 2) == pytest.approx(1.0, abs=0.018)
    expected = 1 / np.sqrt(sum((2 * np.pi * p / s) ** 2 for p, s in zip(periods, sigmas, strict=True)))
    np.testing.assert_allclose(found.sigma, expected, rtol=1e-9)
    assert expected < 0.9 * 0.02 / (2 * np.pi * 16.0)


@pytest.mark.parametrize("sigma", [0.15, 0.25])
def test_the_probability_of_a_wrong_order_is_calibrated(sigma: float) -> None:
    rng = np.random.default_rng(2)
    true = rng.uniform(0, 1, 100_000)
    periods = [0.9, 9.0]
    found = unwrap_temporal(*_phases(true, periods, [sigma, sigma], rng), periods)
    wrong = np.abs(found.fraction - true) > 0.5 / 9.0
    assert wrong.mean() > 1e-4  # the case is hard enough to mean something
    assert found.wrong_order_probability.sum() == pytest.approx(wrong.sum(), rel=0.15)


def test_a_ratio_too_large_for_the_noise_is_flagged_by_probability() -> None:
    rng = np.random.default_rng(3)
    true = rng.uniform(0, 1, 20_000)
    periods = [0.9, 60.0]
    found = unwrap_temporal(*_phases(true, periods, [0.1, 0.1], rng), periods)
    wrong = np.abs(found.fraction - true) > 0.5 / 60.0
    assert wrong.sum() > 100
    assert not (wrong & (found.wrong_order_probability < 1e-6)).any()
    good = unwrap_temporal(*_phases(true, periods, [1e-4, 1e-4], rng), periods)  # negative control
    assert good.wrong_order_probability.max() < 1e-6


@pytest.mark.parametrize(
    "periods", [[0.9, 3.9, 15.9], [1.0, 4.0, 16.0], [1.0, 3.9, 15.9], [1.5, 3.9, 15.9], [2.0, 8.0]]
)
def test_no_unflagged_jump_at_the_edges(periods: list[float]) -> None:
    rng = np.random.default_rng(4)
    true = np.concatenate([rng.uniform(0, 0.002, 20_000), rng.uniform(0.998, 1.0, 20_000)])
    found = unwrap_temporal(*_phases(true, periods, [0.01] * len(periods), rng), periods)
    gross = np.abs(found.fraction - true) > 0.5 / periods[-1]
    flagged = found.wrong_order_probability > 1e-6
    assert not (gross & ~flagged).any()
    if periods[0] == 0.9:
        assert not flagged.any()
        assert not gross.any()
    if periods == [1.0, 4.0, 16.0]:
        assert flagged.any()  # whole periods: next to the edge 0 and 1 cannot be told apart
    if periods == [1.0, 3.9, 15.9]:
        assert not flagged.any()  # the other sets tell them apart


@pytest.mark.parametrize("periods", [[15.0, 16.0], [7.0, 9.0, 63.0], [13.0, 15.5, 64.3]])
def test_sets_without_a_coarse_one(periods: list[float]) -> None:
    rng = np.random.default_rng(5)
    true = rng.uniform(0.01, 0.99, 3000)
    found = unwrap_temporal(*_phases(true, periods, [0.01] * len(periods), rng), periods)
    wrong = np.abs(found.fraction - true) > 0.3 / periods[-1]
    sure = found.wrong_order_probability < 1e-6
    assert sure.mean() > 0.95
    assert not (wrong & sure).any()


def test_periods_with_a_common_factor_are_never_sure() -> None:
    true = np.linspace(0.05, 0.95, 50)
    phases = wrap_phase(2 * np.pi * np.array([8.0, 16.0])[:, None] * true)
    found = unwrap_temporal(phases, np.full(phases.shape, 0.01), [8.0, 16.0])
    assert found.wrong_order_probability.min() > 0.4


def test_a_set_left_out_at_a_pixel() -> None:
    true = np.full(3, 0.6)
    periods = [0.9, 3.9, 15.9]
    phases = wrap_phase(2 * np.pi * np.array(periods)[:, None] * true)
    sigmas = np.full((3, 3), 0.01)
    phases[2, 0], sigmas[2, 0] = 1.0, np.inf  # fine set lost: coarser answer
    phases[0, 1], sigmas[0, 1] = 1.0, np.inf  # coarse set lost: order open
    sigmas[:, 2] = np.inf
    found = unwrap_temporal(phases, sigmas, periods)
    assert found.fraction[0] == pytest.approx(0.6, abs=1e-9)
    assert found.sigma[0] == pytest.approx(0.01 / (2 * np.pi * np.hypot(0.9, 3.9)))
    assert found.wrong_order_probability[1] > 0.1
    assert np.isnan(found.fraction[2])
    assert found.wrong_order_probability[2] == 1.0


def test_impossible_input() -> None:
    with pytest.raises(InputError, match="2 sets"):
        unwrap_temporal(np.zeros((3, 4)), np.ones((3, 4)), [1.0, 2.0])
    with pytest.raises(InputError, match="positive"):
        unwrap_temporal(np.zeros((1, 4)), np.ones((1, 4)), [-1.0])
    with pytest.raises(EstimationError, match="coarsest set has 500 periods"):
        unwrap_temporal(np.zeros((1, 4)), np.ones((1, 4)), [500.0])
