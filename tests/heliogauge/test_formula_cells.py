"""Texts of strangers in a table: no spreadsheet computes them, and they come back as they were."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliogauge.formula_cells import guarded_cell, plain_cell


@pytest.mark.parametrize(
    ("text", "cell"),
    [
        ("A;=cmd|' /C calc'!A0", "A;'=cmd|' /C calc'!A0"),
        ("A\t@SUM(1)", "A\t'@SUM(1)"),
        ("A\n=1+1", "A\n'=1+1"),
        ("\n=1+1", "'\n'=1+1"),
        ("\N{FULLWIDTH EQUALS SIGN}1+1", "'\N{FULLWIDTH EQUALS SIGN}1+1"),
        ("\N{FULLWIDTH COMMERCIAL AT}A", "'\N{FULLWIDTH COMMERCIAL AT}A"),
        ("1.5;-0.25;3", "1.5;-0.25;3"),
        ("A;B = C", "A;B = C"),
        ("-12", "-12"),
    ],
)
def test_formulas_in_a_cell_and_behind_separators_of_other_countries(text: str, cell: str) -> None:
    assert guarded_cell(text) == cell
    assert plain_cell(cell) == text


@given(st.text(alphabet="=+-@'\t\r\n;,1aA.\N{FULLWIDTH EQUALS SIGN}\N{FULLWIDTH PLUS SIGN}", max_size=12))
def test_any_text_comes_back_and_begins_no_formula(text: str) -> None:
    cell = guarded_cell(text)
    assert plain_cell(cell) == text
    for piece in re.split(r"[;\t\r\n]", cell):
        if not re.fullmatch(r"[+-]?(\d+\.?\d*|\.\d+)", piece):
            assert piece[:1] not in {*"=+-@", "\N{FULLWIDTH EQUALS SIGN}", "\N{FULLWIDTH PLUS SIGN}"}
