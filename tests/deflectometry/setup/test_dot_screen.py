"""A field of dots: exact at each dot, straight in between, nothing beyond."""

import numpy as np
import pytest

from deflectometry.setup.dot_screen import DotScreen
from heliogauge.errors import InputError


def _field() -> tuple[DotScreen, np.ndarray, np.ndarray, np.ndarray]:
    column, row = (one.ravel() for one in np.meshgrid(np.arange(-3, 5), np.arange(-2, 4)))
    places = np.column_stack([0.04 * column, 0.05 * row, 1e-3 * column * row]) + 1e-4 * np.sin(column[:, None] * 7)
    return DotScreen.from_table(column.astype(float), row.astype(float), places), column, row, places


def test_dots_are_where_the_table_has_them_also_in_single_precision() -> None:
    screen, column, row, places = _field()
    assert screen.places_m(column, row) == pytest.approx(places, abs=0)
    u, v = screen.fractions(column, row)
    assert v[row == 3] == pytest.approx(0.0)
    assert screen.points_m(u, v) == pytest.approx(places, abs=1e-15)
    assert screen.points_m(u.astype(np.float32), v.astype(np.float32)) == pytest.approx(places, abs=1e-15)


def test_beyond_the_field_and_beside_a_missing_dot_there_is_nothing() -> None:
    screen, column, row, places = _field()
    assert np.isnan(screen.points_m(np.array([1.01]), np.array([0.5]))).all()
    assert not screen.has(np.array([9]), np.array([0]))[0]
    there = ~((column == 0) & (row == 0))
    gap = DotScreen.from_table(column[there].astype(float), row[there].astype(float), places[there])
    assert gap.has(column, row).sum() == there.sum()
    assert np.isfinite(gap.points_m(*gap.fractions(column[there], row[there]))).all()


@pytest.mark.parametrize(
    ("column", "row", "words"),
    [([0, 1, 1.5], [0, 0, 0], "whole"), ([0, 1, 1], [0, 0, 0], "twice"), ([0, 1, 900], [0, 900, 0], "cannot fill")],
)
def test_tables_that_are_no_field_are_refused(column: list[float], row: list[float], words: str) -> None:
    with pytest.raises(InputError, match=words):
        DotScreen.from_table(np.array(column, float), np.array(row, float), np.zeros((3, 3)))
