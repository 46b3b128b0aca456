"""Errors of edges that are alike along the trough: found from what is left of them, and counted once."""

import numpy as np
import pytest

from observer.slopes.edge_likeness import APART, EdgeLikeness, edge_likeness

Y = np.arange(200) * 0.02


def errors(share: float, length_m: float, curves: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draw errors of unit variance on curves through all rows; return them with their curve and row."""
    rng = np.random.default_rng(2)
    root = np.linalg.cholesky(np.exp(-np.abs(Y[:, None] - Y) / length_m))
    alike = rng.standard_normal((curves, Y.size)) @ root.T
    own = rng.standard_normal((curves, Y.size))
    curve, row = np.indices(own.shape)
    return (np.sqrt(share) * alike + np.sqrt(1 - share) * own).ravel(), curve.ravel(), row.ravel()


@pytest.mark.parametrize(("share", "length_m"), [(0.3, 0.4), (0.6, 0.2)])
def test_share_and_length_are_found(share: float, length_m: float) -> None:
    value, curve, row = errors(share, length_m, 400)
    rng = np.random.default_rng(4)
    some = rng.random(value.size) < 0.8
    found = edge_likeness(value[some], curve[some], row[some], Y)
    assert found.share == pytest.approx(share, abs=0.06)
    assert found.length_m == pytest.approx(length_m, rel=0.35)


def test_outliers_of_some_curves_do_not_make_all_alike() -> None:
    value, curve, row = errors(0.3, 0.4, 400)
    value = np.where((curve % 50 == 0) & (row > 150), 30.0, value)
    found = edge_likeness(value, curve, row, Y)
    assert found.share == pytest.approx(0.3, abs=0.1)


def test_independent_errors_are_apart() -> None:
    value, curve, row = errors(0.0, 0.4, 400)
    assert edge_likeness(value, curve, row, Y).counted(Y[::7]) == pytest.approx(1.0, abs=0.02)


def test_few_edges_do_not_tell() -> None:
    value, curve, row = errors(0.9, 0.4, 400)
    assert edge_likeness(value[:50], curve[:50], row[:50], Y) is APART


def test_edges_that_leave_nothing_or_are_unknown_do_not_tell() -> None:
    value, curve, row = errors(0.9, 0.4, 10)
    assert edge_likeness(np.zeros(value.size), curve, row, Y) is APART
    for one in (np.nan, np.inf, -np.inf):
        value[7] = one
        found = edge_likeness(value, curve, row, Y)
        assert np.isfinite(found.counted(Y))


def test_the_mean_over_rows_varies_as_often_as_is_counted() -> None:
    alike = EdgeLikeness(0.3, 0.4)
    value, _, _ = errors(alike.share, alike.length_m, 4000)
    rows = np.arange(0, Y.size, 7)
    means = value.reshape(-1, Y.size)[:, rows].mean(axis=1)
    assert means.std() * np.sqrt(rows.size) == pytest.approx(alike.counted(Y[rows]), rel=0.05)
    assert APART.counted(Y) == 1.0
