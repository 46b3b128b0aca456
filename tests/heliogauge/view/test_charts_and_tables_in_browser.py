"""Charts and tables in a real browser."""

import re
from typing import Any

import numpy as np
import pytest

from heliogauge.view.charts import ChartSeries, ChartView, Mark
from heliogauge.view.tables import TableColumn, TableView


def shown(page: Any) -> str:
    return page.locator(".view-readout").inner_text().replace("\u2212", "-")


@pytest.fixture
def open_chart(open_page: Any) -> Any:
    """Open a chart and wait until it is alive."""

    def opened(*series: ChartSeries, **options: Any) -> Any:
        page = open_page.body(ChartView("Chart", "radius [px]", "residual [mrad]", series, **options).page_html())
        page.wait_for_selector(".view.alive")
        return page

    return opened


def test_arrow_keys_read_values_with_sigma_over_gaps(open_chart: Any) -> None:
    y = np.array([1.0, np.nan, -2.5, 4.0])
    page = open_chart(ChartSeries("a", np.array([10.0, 20.0, 30.0, 40.0]), y, "#1b6ca8", sigma=np.full(4, 0.1)))
    page.locator(".view-figure").focus()
    page.keyboard.press("ArrowRight")
    assert shown(page) == "radius 10.00 px; residual 1.00 \u00b1 0.10 mrad"
    page.keyboard.press("ArrowRight")
    assert shown(page) == "radius 30.00 px; residual -2.50 \u00b1 0.10 mrad"


def test_the_pointer_reads_the_nearest_point_with_its_name(open_chart: Any) -> None:
    points = ChartSeries(
        "p", np.array([0.0, 1.0, 2.0]), np.array([0.0, 5.0, 1.0]), "#c8552b", Mark.POINTS, labels=["one", "two", "<b>3"]
    )
    page = open_chart(points)
    box = page.locator(".view-figure").bounding_box()
    page.locator(".view-figure").focus()
    for _ in range(3):
        page.keyboard.press("ArrowRight")
    dot = page.locator(".view-overlay circle").bounding_box()
    page.mouse.move(box["x"] + 3, box["y"] + 3)
    assert shown(page) == ""
    page.mouse.move(dot["x"] + 9, dot["y"] + 2)
    assert shown(page).startswith("<b>3; radius 2.000 px; residual 1.000 mrad")


def test_things_that_are_counted_have_whole_ticks(open_chart: Any) -> None:
    two = ChartSeries("modules", np.array([1.0, 2.0]), np.array([0.31, 0.47]), "#1b6ca8", Mark.POINTS)
    page = open_chart(two, x_counts=True)
    axis = "echarts.getInstanceByDom(document.querySelector('.view-figure [_echarts_instance_]'))"
    ticks = page.evaluate(f"{axis}.getModel().getComponent('xAxis').axis.scale.getTicks().map((tick) => tick.value)")
    assert [tick for tick in ticks if tick == int(tick)] == [1, 2]
    assert set(ticks) <= {0.5, 1, 2, 2.5}


def test_times_are_read_as_dates(open_chart: Any) -> None:
    """2023-05-01 12:04 and two minutes later, UTC, are told apart."""
    start = 1_682_942_640.0
    page = open_chart(
        ChartSeries("a", start + np.array([0.0, 120.0, 4e7]), np.arange(3.0), "#1b6ca8", Mark.POINTS), x_time=True
    )
    page.locator(".view-figure").focus()
    page.keyboard.press("ArrowRight")
    assert shown(page).startswith("radius 2023-05-01 12:04")
    page.keyboard.press("ArrowRight")
    assert shown(page).startswith("radius 2023-05-01 12:06")
    axis = "echarts.getInstanceByDom(document.querySelector('.view-figure [_echarts_instance_]'))"
    ticks = page.evaluate(f"{axis}.getModel().getComponent('xAxis').axis.scale.getTicks().map((tick) => tick.value)")
    assert sum(str(np.datetime64(int(tick), "ms")).endswith("-01T00:00:00.000") for tick in ticks) >= 3


def test_a_logarithmic_axis_keeps_small_values(open_chart: Any) -> None:
    x = np.array([1e-6, 1e-3, 1.0])
    page = open_chart(ChartSeries("a", x, x, "#1b6ca8"), x_log=True, y_log=True)
    page.locator(".view-figure").focus()
    page.keyboard.press("ArrowRight")
    assert shown(page) == "radius 1.000e-6 px; residual 1.000e-6 mrad"


def test_a_series_is_switched_off_by_its_button(open_chart: Any) -> None:
    x = np.arange(5.0)
    page = open_chart(ChartSeries("first", x, x, "#1b6ca8"), ChartSeries("second", x, 2 * x, "#c8552b"))
    button = page.get_by_role("button", name="first")
    button.click()
    assert button.get_attribute("aria-pressed") == "false"
    page.locator(".view-figure").focus()
    page.keyboard.press("ArrowRight")
    assert shown(page).startswith("second;")


@pytest.mark.parametrize("mark", list(Mark))
def test_every_mark_is_drawn_in_its_colour(open_chart: Any, mark: Mark) -> None:
    one = ChartSeries("a", np.arange(6.0), np.array([3.0, 2, 5, 4, 1, 2]), "#ff0000", mark, size_px=4, sigma=np.ones(6))
    page = open_chart(one)
    red = """() => { const canvas = document.querySelector('.view-canvas canvas');
      const data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data; let count = 0;
      for (let at = 0; at < data.length; at += 4) if (data[at] > 240 && data[at + 1] < 20 && data[at + 2] < 20) count++;
      return count; }"""
    assert page.evaluate(red) > 50


def modules(count: int) -> TableView:
    return TableView(
        "Modules",
        (
            TableColumn("module", [f"M{index}" for index in range(count)], links=["#photo-7"] * count),
            TableColumn(
                "SD [mrad]",
                ["-" if index == 2 else f"{(index * 7) % count}" for index in range(count)],
                numbers=[np.nan if index == 2 else (index * 7) % count for index in range(count)],
            ),
        ),
        row_ids=[f"module-{index}" for index in range(count)],
        most_rows=10,
    )


def cells(page: Any, column: int) -> list[str]:
    rows = page.locator("tbody tr").all()
    return [row.locator("td").nth(column).inner_text() for row in rows if row.is_visible()]


def test_a_table_sorts_by_numbers_with_missing_ones_last(open_page: Any) -> None:
    page = open_page.body(modules(30).page_html())
    head = page.get_by_role("button", name="SD [mrad]")
    head.click()
    page.get_by_role("button", name="Show all 30").click()
    up = cells(page, 1)
    assert up[-1] == "-"
    assert [int(one) for one in up[:-1]] == sorted(int(one) for one in up[:-1])
    head.focus()
    page.keyboard.press("Enter")
    assert page.locator("th[aria-sort=descending]").inner_text().startswith("SD")
    assert cells(page, 1)[-1] == "-"
    assert cells(page, 1)[0] == up[-2]


def test_a_table_filters_among_all_rows(open_page: Any) -> None:
    page = open_page.body(modules(30).page_html())
    page.wait_for_selector(".view.alive")
    assert len(cells(page, 0)) == 10
    page.get_by_role("searchbox").fill("M29")
    assert cells(page, 0) == ["M29"]


def test_a_link_to_a_hidden_row_shows_it(open_page: Any) -> None:
    page = open_page.body(modules(30).page_html() + '<a href="#module-25">there</a>')
    page.get_by_role("link", name="there").click()
    page.wait_for_function("document.activeElement.id === 'module-25'")
    assert page.locator("#module-25").is_visible()


def test_print_holds_the_first_rows_and_says_what_is_left_out(open_page: Any) -> None:
    page = open_page.body(modules(30).page_html())
    page.get_by_role("button", name="Show all 30").click()
    page.emulate_media(media="print")
    assert len(cells(page, 0)) == 10
    assert re.match("20 more rows", page.locator(".left-out").inner_text())


def test_without_script_all_rows_are_there(open_page: Any) -> None:
    page = open_page.body(modules(30).page_html(), java_script_enabled=False)
    assert page.locator("#module-29").is_visible()
