"""Correlation of rows against mirrors of a known one."""

import numpy as np
import pytest

from observer.slopes.row_likeness import likeness_along, row_likeness
from observer.slopes.row_spline import RowGrid

Y_M = np.arange(150) * 0.02
X_M = np.arange(60) * 0.02


def grid() -> RowGrid:
    joined = np.ones(59, dtype=bool)
    joined[29] = False
    return RowGrid(X_M, joined, Y_M.size)


def mirror(length_m: float, rng: np.random.Generator) -> np.ndarray:
    """Return slopes that are white across and alike over a length along the trough, each panel bent and tilted."""
    root = np.linalg.cholesky(np.exp(-np.abs(np.subtract.outer(Y_M, Y_M)) / length_m) + 1e-9 * np.eye(Y_M.size))
    bent = np.where(X_M < 0.6, 4e-3 + 2e-2 * X_M, -5e-3 - 3e-2 * X_M)
    return np.asarray(1e-3 * root @ rng.normal(0, 1, (Y_M.size, X_M.size)) + bent)


@pytest.mark.parametrize("length_m", [0.1, 0.4])
def test_the_length_over_which_slopes_are_alike_is_found(length_m: float) -> None:
    rng = np.random.default_rng(3)
    good = rng.random((Y_M.size, X_M.size)) < 0.9
    # Noise of single nodes as large as the slopes does not make rows look less alike.
    slopes = mirror(length_m, rng) + rng.normal(0, 1e-3, good.shape)
    alike = row_likeness(np.where(good, slopes, 1.0), good, grid(), Y_M)
    assert -0.02 / np.log(alike[0, 1]) == pytest.approx(length_m, rel=0.35)
    np.testing.assert_allclose(np.diagonal(alike), 1.0)
    assert np.linalg.eigvalsh(alike).min() > 0


def test_waves_along_the_trough_make_all_rows_one() -> None:
    slopes = np.broadcast_to(np.random.default_rng(4).normal(0, 1e-3, X_M.size), (Y_M.size, X_M.size))
    alike = row_likeness(slopes, np.ones(slopes.shape, dtype=bool), grid(), Y_M)
    assert alike.min() > 0.95


def test_slopes_along_are_as_probably_those_of_one_mould_as_of_a_sheet_without_direction() -> None:
    near, far = likeness_along(np.array([0.0, 0.3, 30.0]), 0.3)[0, 1:]
    assert near == pytest.approx((1 + np.exp(-1)) / 2)
    assert far == pytest.approx(0.5)


def test_rows_are_alike_where_nothing_tells() -> None:
    nothing = np.zeros((Y_M.size, X_M.size), dtype=bool)
    np.testing.assert_array_equal(row_likeness(np.full(nothing.shape, np.nan), nothing, grid(), Y_M), 1.0)
    np.testing.assert_array_equal(
        row_likeness(np.zeros((1, 60)), nothing[:1], RowGrid(X_M, grid().joined, 1), Y_M[:1]), 1.0
    )
