"""Numbers of whole panels of drawn slopes of which a part is masked: errors beside their standard deviations."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from observer.product.unmeasured_part import Variogram, unmeasured_variances

PANEL = np.add.outer(4 * np.repeat(np.arange(4), 40), np.repeat(np.arange(4), 30))
X = np.tile(np.arange(30.0) - 14.5, (160, 4))


def drawn(rng: np.random.Generator) -> np.ndarray:
    """Waves, and what panels are tilted by and twisted."""
    waves = gaussian_filter(rng.standard_normal(PANEL.shape), (9, 6), mode="wrap")
    twist = np.tile((np.arange(40.0) - 19.5) / 12, 4)[:, None]
    tilt, twisted = rng.standard_normal((2, 16))
    return waves / waves.std() + 5 * tilt[PANEL] + 0.6 * twisted[PANEL] * twist


def masked(rng: np.random.Generator) -> np.ndarray:
    """Bands at both ends of the outer panels, and a patch anywhere."""
    measured = np.ones(PANEL.shape, dtype=bool)
    measured[:14] = measured[-13:] = False
    row, column = rng.integers(0, 120), rng.integers(0, 90)
    measured[row : row + 30, column : column + 25] = False
    return measured


@pytest.mark.parametrize("is_curvature", [False, True])
def test_errors_are_what_their_sigma_says(is_curvature: bool) -> None:
    rng = np.random.default_rng(4)
    ratios = []
    for _ in range(10):
        values, measured = drawn(rng), masked(rng)
        wanted, used = np.zeros((2, *PANEL.shape))
        for number in range(16):
            for weights, own in ((wanted, number == PANEL), (used, (number == PANEL) & measured)):
                beside = X[own] - X[own].mean()
                weights[own] = beside / (beside @ beside) if is_curvature else 1 / own.sum()
        variance = unmeasured_variances(values, PANEL, measured, wanted, used, 16)
        error = np.bincount(PANEL.ravel(), ((used - wanted) * values).ravel())
        whole = np.bincount(PANEL.ravel(), (~measured).ravel()) == 0
        np.testing.assert_allclose(variance[whole], 0, atol=1e-20)
        ratios.append(error[~whole] ** 2 / variance[~whole])
    # Some 100 panels; of 300 it is 0.87 for means and 0.66 for curvatures: power that is left out makes sigma larger.
    assert 0.45 < np.mean(np.concatenate(ratios)) < 1.3
    assert np.mean(np.concatenate(ratios) > 9) < 0.03


def test_variogram_by_hand() -> None:
    values, panel = np.outer(np.arange(40.0), np.ones(40)), np.zeros((40, 40), dtype=np.intp)
    gamma = Variogram.of(values, panel, np.ones((40, 40), dtype=bool)).gamma
    # Half the square of the lag along the rows; the farthest lag has 40 pairs, each but for few columns.
    lag = np.arange(-39, 40.0)
    np.testing.assert_allclose(gamma[:, 39], 0.5 * lag**2, atol=1e-9)
    half = np.ones((40, 40), dtype=bool)
    half[20:] = False
    near = Variogram.of(values, panel, half).gamma
    np.testing.assert_allclose(near[39:59, 39], 0.5 * lag[39:59] ** 2, atol=1e-9)
    # No pair is farther apart: in proportion.
    assert near[78, 39] == pytest.approx(0.5 * 19**2 * 39 / 19)


def test_variance_is_the_double_sum_over_nodes() -> None:
    rows, columns = np.arange(-8.0, 9), np.arange(-6.0, 7)
    # Of values that are alike over 1.5 nodes, which have power at all frequencies.
    gamma = 1 - np.exp(-np.add.outer(rows**2, columns**2) / (2 * 1.5**2))
    rng = np.random.default_rng(7)
    weights = [rng.standard_normal((9, 7)) for _ in range(2)] + [np.outer(np.arange(9.0), np.ones(7))]
    weights = [one - one.mean() for one in weights]
    place = np.argwhere(np.ones((9, 7), dtype=bool))
    lag = place[:, None] - place + [8, 6]
    found = Variogram(gamma).variances(weights)
    expected = [-one.ravel() @ gamma[lag[..., 0], lag[..., 1]] @ one.ravel() for one in weights]
    np.testing.assert_allclose(found, expected, rtol=1e-3)


def test_panels_without_nodes_have_no_variance() -> None:
    rng = np.random.default_rng(5)
    values, measured, panel = drawn(rng), masked(rng), np.where(PANEL < 14, PANEL, -1)
    wanted, used = np.zeros((2, *PANEL.shape))
    for number in range(14):
        wanted[panel == number] = 1 / np.count_nonzero(panel == number)
        used[(panel == number) & measured] = 1 / np.count_nonzero((panel == number) & measured)
    variance = unmeasured_variances(values, panel, measured, wanted, used, 16)
    assert variance.shape == (16,)
    assert variance[13] > 0
    np.testing.assert_array_equal(variance[14:], 0)
