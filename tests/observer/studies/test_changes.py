"""What changed between two measurements: panels that turned are found, those that did not are not."""

from dataclasses import replace

import numpy as np
import pytest

from heliogauge.errors import InputError
from observer.product.changes import PanelState, number_changes, panel_changes

SHAPE, PANELS = (20, 40), 8
#: Four panels across, two along.
PANEL = np.repeat(np.repeat(np.arange(PANELS).reshape(2, 4), 10, axis=0), 10, axis=1)
#: Panels are bent, so that the mean over a part is another one.
BENT = np.tile(3e-3 * np.sin(np.linspace(0.0, 12.0, 40)), (20, 1))
NOISE_RAD, COMMON_RAD = 5e-4, 2e-4


def measured(rng: np.random.Generator, turns_rad: np.ndarray, hole_share: float = 0.2) -> PanelState:
    """Measure the bent panels with noise, an error that all have in common, and holes at random places."""
    common = COMMON_RAD * rng.standard_normal()
    angle = BENT + turns_rad[PANEL] + common + NOISE_RAD * rng.standard_normal(SHAPE)
    start = rng.integers(0, 10 - int(10 * hole_share) + 1, size=PANELS)
    columns = np.arange(40) % 10
    hole = (columns >= start[PANEL]) & (columns < start[PANEL] + int(10 * hole_share))
    angle = np.where(hole, np.nan, angle)
    count = (1 - hole_share) * 100
    sigma = np.full(PANELS, np.hypot(COMMON_RAD, NOISE_RAD / np.sqrt(count)))
    return PanelState(np.arange(40.0), np.arange(20.0), angle, angle + 1e-3, PANEL, sigma, sigma)


def test_the_panel_that_turned_is_named_and_by_how_much() -> None:
    rng, turns = np.random.default_rng(1), np.zeros(PANELS)
    turns[5] = 3e-3
    found = panel_changes(measured(rng, np.zeros(PANELS)), measured(rng, turns))
    assert found.panel[found.is_sure].tolist() == [6]
    assert found.theta_ra_change_rad[5] == pytest.approx(3e-3, abs=4 * found.sigma_theta_ra_change_rad[5])
    assert ((found.common_share >= 0.6 - 1e-9) & (found.common_share <= 0.8 + 1e-9)).all()


def test_holes_elsewhere_are_no_turn_and_sigma_is_the_scatter() -> None:
    """Of means over what each measured, panels of 3 mrad of bend would seem to turn with their holes."""
    rng = np.random.default_rng(2)
    runs = [panel_changes(measured(rng, np.zeros(PANELS)), measured(rng, np.zeros(PANELS))) for _ in range(300)]
    # Once in a hundred of the comparisons, each of eight panels that err together.
    assert np.mean([one.is_sure.any() for one in runs]) < 0.03
    times = np.stack([one.theta_r_change_rad / one.sigma_theta_r_change_rad for one in runs])
    assert np.sqrt(np.nanmean(times**2)) == pytest.approx(1.0, abs=0.15)


def test_a_panel_of_which_both_measured_less_than_half_has_no_change() -> None:
    rng = np.random.default_rng(3)
    first, other = (measured(rng, np.zeros(PANELS), 0.0) for _ in range(2))
    angle = np.where(PANEL == 2, np.where(np.arange(40) % 10 < 6, np.nan, other.theta_r_rad), other.theta_r_rad)
    found = panel_changes(first, replace(other, theta_r_rad=angle, theta_ra_rad=angle))
    assert np.flatnonzero(np.isnan(found.theta_r_change_rad)).tolist() == [2]
    assert not found.is_sure[2]


def test_another_grid_and_other_panels() -> None:
    rng = np.random.default_rng(4)
    first, other = (measured(rng, np.zeros(PANELS), 0.0) for _ in range(2))
    rows = replace(other, y_m=other.y_m[::2], theta_r_rad=BENT[::2] + 2e-3, theta_ra_rad=BENT[::2] + 2e-3)
    found = panel_changes(replace(first, theta_r_rad=BENT, theta_ra_rad=BENT), rows)
    np.testing.assert_allclose(found.theta_r_change_rad, 2e-3, atol=1e-12)
    fewer = replace(other, sigma_theta_r_rad=np.ones(4), sigma_theta_ra_rad=np.ones(4))
    with pytest.raises(InputError, match="8 and 4 panels"):
        panel_changes(first, fewer)


def test_numbers_change_with_the_sigma_of_both() -> None:
    first = {"intercept_ratio": 0.95, "sigma_intercept_ratio": 3e-3, "absorber_mean_x_m": None}
    other = {"intercept_ratio": 0.97, "sigma_intercept_ratio": 4e-3, "absorber_mean_x_m": 1e-3}
    (found,) = number_changes(first, other)
    assert (found.key, found.before, found.after) == ("intercept_ratio", 0.95, 0.97)
    assert found.change == pytest.approx(0.02)
    assert found.sigma_change == pytest.approx(5e-3)
