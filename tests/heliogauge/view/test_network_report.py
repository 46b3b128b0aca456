"""The report of a network in a browser: picture on the first screen, links to photos, phone, paper."""

import re
from pathlib import Path
from typing import Any

import pytest

from heliogauge.reporting.build import build_report
from heliogauge.reporting.page import headline_numbers
from heliogauge.reporting.style import STYLE
from tests.heliogauge.view.conftest import DESKTOP
from tests.photogrammetry.report.drawn_results import NASTY, PHOTOS, write_network


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("network")
    write_network(folder)
    return build_report(folder)


def test_verdict_numbers_and_scene_are_on_the_first_screen(open_page: Any, report: Path) -> None:
    page = open_page.file(report)
    canvas = page.wait_for_selector('[data-view="scene"] canvas', state="visible")
    for one in (page.query_selector(".verdict"), page.query_selector(".numbers"), canvas):
        box = one.bounding_box()
        assert box["y"] >= 0
        assert box["y"] + box["height"] <= DESKTOP["height"]
    assert page.query_selector("h1").text_content() == NASTY


@pytest.mark.slow
def test_a_row_of_the_table_opens_its_photo(open_page: Any, report: Path) -> None:
    playwright = pytest.importorskip("playwright.sync_api")
    page = open_page.file(report)
    page.wait_for_selector('[data-view="photo"] select')
    # A table becomes a view when it comes near; a click that falls between the two is lost.
    page.locator('[data-view="table"]').first.scroll_into_view_if_needed()
    page.wait_for_selector('[data-view="table"] input[type="search"]')
    for name in (PHOTOS[1], PHOTOS[2], PHOTOS[0]):
        page.click(f'[data-view="table"] td a[href^="#photo-"]:text-is("{name}")')
        # The page's policy forbids what `wait_for_function` does.
        shown = page.locator('[data-view="photo"] select option:checked')
        playwright.expect(shown).to_contain_text(name)


def test_nothing_is_wider_than_a_phone(open_page: Any, report: Path) -> None:
    page = open_page.file(report, viewport={"width": 390, "height": 844})
    page.wait_for_selector('[data-view="scene"] canvas', state="attached")
    page.evaluate("document.querySelectorAll('details').forEach(one => { one.open = true; })")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


def test_long_headline_numbers_wrap_on_a_phone(open_page: Any) -> None:
    rows = [
        ("Image covered", "64 % of its cells, out to 68 % of the way to its corners"),
        ("Principal point x, y", "806.002 \u00b1 0.012 px, 592.983 \u00b1 0.012 px"),
        ("SD", "0.38656 \u00b1 0.00052 mrad"),
    ]
    body = f"<style>{STYLE}</style><main>{headline_numbers(rows).text}</main>"
    page = open_page.body(body, viewport={"width": 390, "height": 844})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    # What is short stays on one line.
    assert page.query_selector_all(".numbers td")[2].bounding_box()["height"] < 30


def test_paper_takes_at_most_four_pages_and_cuts_nothing(open_page: Any, report: Path) -> None:
    page = open_page.file(report, viewport={"width": 703, "height": 1020})
    page.wait_for_selector('[data-view="scene"] canvas', state="attached")
    pages = re.findall(rb"/Type /Page\b(?!s)", page.pdf(prefer_css_page_size=True))
    assert 1 <= len(pages) <= 4
    page.emulate_media(media="print")
    wide = page.evaluate(
        "[...document.querySelectorAll('main *')].filter(one => one.getBoundingClientRect().right > 704).length"
    )
    assert wide == 0
