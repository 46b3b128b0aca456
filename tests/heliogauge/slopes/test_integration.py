"""Height from slopes against heights given by formulas."""

import numpy as np
import pytest

from heliogauge.errors import EstimationError
from heliogauge.slopes.integration import integrate_slopes


def surface(nx=61, ny=47):
    x, y = np.linspace(-0.6, 0.6, nx), np.linspace(-0.5, 0.4, ny)
    grid_x, grid_y = np.meshgrid(x, y)
    height = 1e-4 * np.sin(4 * grid_x) * np.cos(3 * grid_y) + 2e-3 * grid_x**2 - 1e-3 * grid_x * grid_y
    slope_x = 4e-4 * np.cos(4 * grid_x) * np.cos(3 * grid_y) + 4e-3 * grid_x - 1e-3 * grid_y
    slope_y = -3e-4 * np.sin(4 * grid_x) * np.sin(3 * grid_y) - 1e-3 * grid_x
    return height, slope_x, slope_y, (x[1] - x[0], y[1] - y[0])


def test_height_of_a_smooth_surface():
    height, slope_x, slope_y, step = surface()
    found = integrate_slopes(slope_x, slope_y, step)
    # The trapezoidal rule leaves step^2 / 12 times the change of curvature, 3.2e-3 1/m here: at most 107 nm.
    assert np.abs(found - (height - height.mean())).max() < 107e-9


def test_rule_is_exact_for_quadratic_surfaces():
    x, y = np.meshgrid(np.arange(12.0), np.arange(9.0))
    found = integrate_slopes(0.2 * x + 0.3 * y + 1.0, 0.3 * x - 0.4 * y, (1.0, 1.0))
    truth = 0.1 * x**2 + 0.3 * x * y + x - 0.2 * y**2
    assert np.allclose(found, truth - truth.mean(), atol=1e-6)


def test_gaps_and_ragged_borders_do_not_disturb():
    height, slope_x, slope_y, step = surface()
    y, x = np.mgrid[0:47, 0:61]
    gap = (np.hypot(x - 20, y - 25) < 6) | (x + y < 15) | (np.random.default_rng(1).random(x.shape) < 0.03)
    slope_x[gap] = np.nan
    found = integrate_slopes(slope_x, slope_y, step)
    assert np.isnan(found[gap]).all()
    known = np.isfinite(found)
    difference = (found - height)[known]
    assert np.ptp(difference) < 2 * 107e-9


def test_parts_that_do_not_touch_have_mean_zero_each():
    _, slope_x, slope_y, step = surface()
    slope_x[:, 30] = np.nan
    found = integrate_slopes(slope_x, slope_y, step)
    assert np.nanmean(found[:, :30]) == pytest.approx(0.0, abs=1e-15)
    assert np.nanmean(found[:, 31:]) == pytest.approx(0.0, abs=1e-15)


def test_noise_is_averaged_not_amplified():
    rng = np.random.default_rng(5)
    noise = 1e-5 * rng.normal(size=(2, 60, 60))
    found = integrate_slopes(noise[0], noise[1], (0.01, 0.01))
    # A path of n steps would leave sigma step sqrt(n) = 0.8 um; least squares stays near sigma step.
    assert found.std() < 2.5e-7


def test_lonely_nodes_are_refused():
    slopes = np.full((5, 5), np.nan)
    slopes[::2, ::2] = 1e-3
    with pytest.raises(EstimationError, match="no two neighbouring nodes"):
        integrate_slopes(slopes, slopes, (0.01, 0.01))


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(1, 9), (9, 1), (2, 2), (31, 44), (37, 53)])
def test_height_is_the_direct_solution_of_the_normal_equations(shape):
    rng = np.random.default_rng(3)
    slopes, step = rng.normal(size=(2, *shape)), (0.3, 0.7)
    slopes[:, rng.random(shape) < (0.2 if min(shape) > 2 else 0)] = np.nan
    known = np.isfinite(slopes[0])
    number = np.cumsum(known.ravel()).reshape(shape) - 1
    rows, targets = [], []
    for axis, (values, reach) in enumerate(zip(slopes, step, strict=True)):
        behind, ahead = (np.moveaxis(number, 1 - axis, 0)[part] for part in (slice(None, -1), slice(1, None)))
        along = np.moveaxis(values, 1 - axis, 0)
        target = 0.5 * reach * (along[:-1] + along[1:])
        for one, other, value in zip(behind.ravel(), ahead.ravel(), target.ravel(), strict=True):
            if np.isfinite(value):
                row = np.zeros(number.max() + 1)
                row[[one, other]] = -1, 1
                rows.append(row)
                targets.append(value)
    # The least of all solutions has mean zero in each connected part.
    truth = np.linalg.lstsq(np.array(rows), np.array(targets), rcond=None)[0]
    # Slopes within 1e-7; parts that hang on single nodes have a height that is less sure, by a factor of about ten.
    assert np.abs(integrate_slopes(*slopes, step)[known] - truth).max() < 1e-5 * truth.std()
