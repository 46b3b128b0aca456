"""What all views of a page share, in a real browser."""

import json
from typing import Any

import numpy as np
import pytest

from heliogauge.view.arrays import PAGE, reading_step
from heliogauge.view.charts import ChartSeries, ChartView
from heliogauge.view.tables import TableColumn, TableView


def chart() -> ChartView:
    line = ChartSeries("a", np.arange(5.0), np.arange(5.0), "#1b6ca8")
    return ChartView("A chart", "x [m]", "y [m]", (line,))


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e7])
def test_numbers_arrive_as_python_sent_them(open_page: Any, scale: float) -> None:
    values = scale * np.random.default_rng(1).standard_t(2, (30, 41))
    values[::7, 3:9] = np.nan
    step = reading_step(values)
    page = open_page.body(chart().page_html())
    packed = json.dumps(PAGE.numbers(values, step))
    back = page.evaluate(
        f"heliogauge.numbers({packed}).then((all) => Array.from(all, (one) => isNaN(one) ? null : one))"
    )
    arrived = np.array([np.nan if one is None else one for one in back]).reshape(values.shape)
    assert np.array_equal(np.isnan(arrived), np.isnan(values))
    assert np.nanmax(np.abs(arrived - values)) <= 0.501 * step


@pytest.mark.parametrize(
    ("value", "sigma", "text"),
    [(1.23456, 0.0123, "1.235 ± 0.012 mrad"), (-0.5, 0.2, "\u22120.50 ± 0.20 mrad"), (812.3, 41.0, "812 ± 41 mrad")],
)
def test_a_value_shows_the_digits_that_its_sigma_leaves(open_page: Any, value: float, sigma: float, text: str) -> None:
    page = open_page.body(chart().page_html())
    assert page.evaluate(f"heliogauge.withSigma({value}, {sigma}, 'mrad')") == text


def test_the_switch_changes_the_theme_and_the_page_remembers(open_page: Any) -> None:
    page = open_page.body("<button data-theme-switch>theme</button>" + chart().page_html(), color_scheme="light")
    paper = "getComputedStyle(document.documentElement).getPropertyValue('--paper').trim()"
    assert page.evaluate(paper) == "#ffffff"
    page.get_by_role("button", name="theme").click()
    assert page.evaluate(paper) == "#14191f"
    page.reload()
    assert page.evaluate(paper) == "#14191f"


def test_a_page_of_tables_carries_no_library(open_page: Any) -> None:
    page = open_page.body(TableView("t", (TableColumn("a", ["1"]),)).page_html())
    assert page.locator("script[data-library]").count() == 0
