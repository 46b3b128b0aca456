"""Tables of observations: every row keeps its place, and what cannot be read says why."""

import numpy as np
import pytest

from calibration.heliostat.observations.rows import NUMBER_COLUMNS, ROW_FLAGS, TEXT_COLUMNS, check_header, parse_rows
from heliogauge.errors import InputError

HEADER = ("heliostat", "time_utc", "axis_1_rad", "axis_2_rad", "target", "x_m", "y_m")


def rows(*lines: str):
    return parse_rows(HEADER, dict(enumerate(lines, start=2)))


def test_numbers_texts_and_times_in_utc() -> None:
    read = rows("A1,2026-06-21T10:00:00Z,0.5,0.25,t,1e-1,", 'A1,2026-06-21 12:00:00.25+02:00, 1 ,0,"t, left",0,-0.5')
    assert read.ids == ("line 2", "line 3")
    assert read.flags == ("", "")
    np.testing.assert_array_equal(read.vector("axis_1_rad", "x_m"), [[0.5, 0.1], [1.0, 0.0]])
    np.testing.assert_array_equal(read.number("y_m"), [np.nan, -0.5])
    assert np.isnan(read.number("sigma_mm")).all()
    assert read.text("target") == ("t", "t, left")
    assert read.text("kind", "beam") == ("beam", "beam")
    assert list(read.times) == [np.datetime64("2026-06-21T10:00:00.000"), np.datetime64("2026-06-21T10:00:00.250")]


@pytest.mark.parametrize(
    ("line", "flag", "reason"),
    [
        ("A1,2026-06-21T10:00:00Z,0.5,0.25,t,0", "unreadable", "6 cells, the header has 7"),
        ("A1,2026-06-21T10:00:00Z,a,0.25,t,0,0", "unreadable", "axis_1_rad = 'a' is no number"),
        ('A1,2026-06-21T10:00:00Z,"0,5",0.25,t,0,0', "unreadable", "'0,5' is no number; the decimal sign must be"),
        ("A1,2026-06-21T10:00:00,0.5,0.25,t,0,0", "time", "has no zone; write 2026-06-21T10:00:00Z"),
        ("A1,21.6.2026 10:00,0.5,0.25,t,0,0", "time", "'21.6.2026 10:00' is no time"),
    ],
)
def test_what_cannot_be_read_keeps_its_row(line: str, flag: str, reason: str) -> None:
    read = rows("A1,2026-06-21T09:00:00Z,0.5,0.25,t,0,0", line, "A1,2026-06-21T11:00:00Z,0.5,0.25,t,0,0")
    assert read.flags == ("", flag, "")
    assert reason in read.reasons[1]
    assert flag in ROW_FLAGS
    assert len(read) == 3


def test_a_quotation_mark_that_is_never_closed_costs_its_own_row_only() -> None:
    good = "A1,2026-06-21T09:00:00Z,0.5,0.25,t,0,0"
    read = rows(good, 'A1,2026-06-21T09:00:00Z,0.5,0.25,"t,0,0', good.replace("09:", "10:"))
    assert read.flags == ("", "unreadable", "")
    assert "5 cells, the header has 7" in read.reasons[1]


def test_no_rows() -> None:
    assert len(rows()) == 0


@pytest.mark.parametrize(
    ("header", "wanted"),
    [
        (("heliostat", "time"), r"f\.csv: 'time' is not a column here; did you mean 'time_utc'"),
        (("x_m", "x_m"), r"the column 'x_m' is there 2 times"),
    ],
)
def test_headers_that_cannot_be_meant(header: tuple[str, ...], wanted: str) -> None:
    with pytest.raises(InputError, match=wanted):
        check_header(header, "f.csv", (*TEXT_COLUMNS, *NUMBER_COLUMNS))
