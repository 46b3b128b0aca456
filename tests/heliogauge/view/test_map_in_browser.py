"""Maps in a real browser: what the reader sees is what Python computed."""

import re
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest

from heliogauge.flags import FLAG_TEXTS, SampleFlag
from heliogauge.reporting.notation import number_text
from heliogauge.slopes.map import SlopeMap, no_common_modes
from heliogauge.slopes.removal import Removal, remove
from heliogauge.slopes.statistics import statistics
from heliogauge.view.maps import slope_map_view

PHONE = {"width": 390, "height": 844}
MAP = ".view[data-view='map']"


@pytest.fixture(scope="module")
def facet() -> SlopeMap:
    """A parabolic facet with tilt, wrong focus, waves and a hole; not square, so that x and y cannot be exchanged."""
    rng = np.random.default_rng(7)
    x_m, y_m = np.linspace(-0.6, 0.6, 61), np.linspace(-0.4, 0.4, 41)
    x, y = np.meshgrid(x_m, y_m)
    hole = (x - 0.3) ** 2 + (y - 0.1) ** 2 < 0.005
    waves = 4e-4 * np.sin(9 * x + 4 * y) * np.cos(7 * y)  # of no symmetry
    slope_x = x / 20 * 1.02 + 8e-4 + waves + rng.normal(0, 2e-5, x.shape)
    slope_y = y / 20 * 1.02 - 5e-4 + 0.5 * waves + 4e-4 * x
    return SlopeMap(
        x_m=x_m,
        y_m=y_m,
        slope_x=np.where(hole, np.nan, slope_x),
        slope_y=np.where(hole, np.nan, slope_y),
        design_slope_x=x / 20,
        design_slope_y=y / 20,
        sigma_random_x=2e-5 * (1 + x**2),
        sigma_random_y=np.full(x.shape, 1e-5),
        noise_correlation=1.0,
        common=no_common_modes(),
        height_m=(x**2 + y**2) / 40,
        flags=np.where(hole, int(SampleFlag.OFF_SCREEN), 0).astype(np.uint32),
        aperture=np.ones(x.shape, dtype=bool),
        design="paraboloid, f = 10 m",
        frame="mirror",
        removed="nothing",
    )


@pytest.fixture(scope="module")
def body(facet: SlopeMap) -> str:
    return slope_map_view(facet, "Facet 7").page_html()


@pytest.fixture
def open_map(open_page: Any, body: str) -> Any:
    """Open the facet and wait until it is alive."""

    def opened(**context: Any) -> Any:
        page = open_page.body(body, **context)
        page.wait_for_selector(f"{MAP}.alive")
        page.wait_for_function("document.querySelector('.view-note').textContent.length > 0")
        return page

    return opened


def pointer_at(page: Any) -> tuple[float, float]:
    box = page.locator(".view-overlay circle").last.bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def places_of(page: Any, *nodes: tuple[int, int]) -> list[tuple[float, float]]:
    """Return where nodes of the map are on the screen; from where the keyboard's pointer stands, and ten nodes on."""
    page.locator(".view-figure").first.focus()
    page.keyboard.press("ArrowRight")  # the middle of the map: column 30, row 20
    x, y = pointer_at(page)
    page.keyboard.press("Shift+ArrowRight")
    step = (pointer_at(page)[0] - x) / 10
    # Rows grow upwards in the map and downwards on the screen.
    return [(x + (column - 30) * step, y - (row - 20) * step) for column, row in nodes]


def point_at(page: Any, column: int, row: int) -> None:
    page.mouse.move(*places_of(page, (column, row))[0])


def readout(page: Any) -> str:
    return page.locator(f"{MAP} .view-readout").first.inner_text().replace("\u2212", "-")


def value_in(text: str) -> tuple[float, float]:
    value, sigma = re.search(r": (-?[\d.]+) \u00b1 ([\d.]+)", text).groups()
    return float(value), float(sigma)


@pytest.mark.parametrize(("column", "row"), [(10, 30), (50, 8), (30, 20)])
def test_value_sigma_and_place_under_the_pointer_are_pythons(
    open_map: Any, facet: SlopeMap, column: int, row: int
) -> None:
    page = open_map()
    point_at(page, column, row)
    text = readout(page)
    value, sigma = value_in(text)
    assert value == pytest.approx(1e3 * facet.slope_error_x[row, column], abs=2e-3)
    assert sigma == pytest.approx(1e3 * facet.sigma_slope()[0][row, column], rel=0.05)
    place = [float(one) for one in re.findall(r"[xy] (-?[\d.]+) m", text)]
    assert place == pytest.approx([facet.x_m[column], facet.y_m[row]], abs=1e-4)


def test_a_hole_says_why_it_has_no_value(open_map: Any, facet: SlopeMap) -> None:
    page = open_map()
    point_at(page, 45, 25)
    assert "no value" in readout(page)
    assert FLAG_TEXTS[SampleFlag.OFF_SCREEN] in readout(page)


@pytest.mark.parametrize("removal", list(Removal))
def test_removal_gives_pythons_numbers_and_map(open_map: Any, facet: SlopeMap, removal: Removal) -> None:
    page = open_map()
    page.get_by_label("Remove").select_option(removal.value)
    expected = statistics(facet, removed=removal)
    shown = page.locator(".view-numbers").inner_text()
    assert number_text(expected.sdx_rad, expected.sigma_sdx_rad, "rad") in shown
    assert number_text(expected.sd_rad, expected.sigma_sd_rad, "rad") in shown
    left = 1e3 * remove(facet, removal).slope_error_x
    rms = float(np.sqrt(np.nanmean(left**2)))
    # The page's own RMS, from its nodes: three digits are shown.
    page.locator(f"{MAP} .view-note", has_text=f"RMS {rms:.3g} mrad").wait_for()


def test_layers_by_keys_and_by_name(open_map: Any, facet: SlopeMap) -> None:
    page = open_map()
    point_at(page, 15, 30)
    page.locator(".view-figure").first.focus()
    page.keyboard.press("2")
    page.wait_for_function("document.querySelector('.view-readout').textContent.includes('error in y')")
    assert value_in(readout(page))[0] == pytest.approx(1e3 * facet.slope_error_y[30, 15], abs=2e-3)
    page.get_by_label("Layer").select_option("height")
    page.wait_for_function("document.querySelector('.view-readout').textContent.includes('Height')")
    assert f"{1e3 * facet.height_m[30, 15]:.3f}" in readout(page)


def test_the_section_along_a_dragged_line_holds_the_maps_values(open_map: Any, facet: SlopeMap) -> None:
    page = open_map()
    start, end = places_of(page, (4, 30), (24, 10))
    page.get_by_role("button", name="Section").click()
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move(*end, steps=3)
    page.mouse.up()
    chart = page.locator(".view-section .view-figure")
    chart.focus()
    for _ in range(8):
        page.keyboard.press("ArrowRight")
    text = page.locator(".view-section .view-readout").inner_text().replace("\u2212", "-")
    along = float(re.search(r"section ([\d.]+)", text)[1])
    value, sigma = (float(one) for one in re.search(r"error in x (-?[\d.]+) \u00b1 ([\d.]+)", text).groups())
    nodes = round(along / 0.02 / np.sqrt(2))
    assert along > 0.1
    assert value == pytest.approx(1e3 * facet.slope_error_x[30 - nodes, 4 + nodes], abs=2e-3)
    assert sigma == pytest.approx(1e3 * facet.sigma_slope()[0][30 - nodes, 4 + nodes], rel=0.06)


def test_colour_range_by_hand_and_by_percentile(open_map: Any, facet: SlopeMap) -> None:
    page = open_map()
    page.get_by_label("Range of colours").select_option("0.9")
    high = float(page.get_by_label("Colours to").input_value())
    assert high == pytest.approx(np.nanpercentile(1e3 * np.abs(facet.slope_error_x), 90), rel=1e-3)
    assert float(page.get_by_label("Colours from").input_value()) == -high
    page.get_by_label("Colours to").fill("-5")
    page.get_by_label("Colours to").press("Enter")
    assert page.get_by_label("Colours to").get_attribute("aria-invalid") is not None
    page.get_by_label("Colours to").fill("0.3")
    page.get_by_label("Colours to").press("Enter")
    assert page.get_by_label("Range of colours").input_value() == "hand"


def test_everything_is_reached_by_tab_and_named(open_map: Any) -> None:
    page = open_map()
    seen = set()
    for _ in range(10):
        page.keyboard.press("Tab")
        seen.add(page.evaluate("document.activeElement.getAttribute('role') || document.activeElement.tagName"))
    assert {"SELECT", "BUTTON", "INPUT", "application", "SUMMARY"} <= seen
    unnamed = page.evaluate(
        "[...document.querySelectorAll('.view-live :is(select, input, button, [role=application])')].filter((one) => "
        "!(one.labels?.length || one.getAttribute('aria-label') || one.textContent.trim())).length"
    )
    assert unnamed == 0


def test_plus_and_zero_zoom_about_the_pointer(open_map: Any) -> None:
    page = open_map()
    point_at(page, 24, 16)
    before, marked = readout(page), page.locator(".view-overlay circle").last.bounding_box()
    page.keyboard.press("+")
    page.keyboard.press("+")
    page.wait_for_timeout(250)
    after = page.locator(".view-overlay circle").last.bounding_box()
    assert (after["x"], after["y"]) == pytest.approx((marked["x"], marked["y"]), abs=1.5)
    seen = page.locator(f"{MAP} .view-note", has_text="In view").inner_text()
    page.keyboard.press("0")
    page.wait_for_timeout(250)
    assert page.locator(f"{MAP} .view-note", has_text="In view").inner_text() != seen
    assert readout(page) == before


def test_flags_are_painted_when_asked(open_map: Any) -> None:
    page = open_map()
    button = page.get_by_role("button", name=FLAG_TEXTS[SampleFlag.OFF_SCREEN])
    assert button.get_attribute("aria-pressed") == "false"
    orange = """() => { const canvas = document.querySelector('.view-canvas canvas');
      const data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data; let count = 0;
      for (let at = 0; at < data.length; at += 4)
        if (data[at] === 230 && data[at + 1] === 159 && data[at + 2] === 0) count++;
      return count; }"""
    assert page.evaluate(orange) == 0
    button.click()
    page.wait_for_timeout(200)
    assert page.evaluate(orange) > 500


@pytest.mark.parametrize("dark", [False, True])
def test_a_phone_shows_it_without_scrolling_sideways(open_map: Any, dark: bool) -> None:
    page = open_map(viewport=PHONE, has_touch=True, is_mobile=True, color_scheme="dark" if dark else "light")
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    assert page.locator(".view-canvas canvas").first.bounding_box()["width"] > 300
    paper = page.evaluate("getComputedStyle(document.querySelector('.view-live')).backgroundColor")
    assert (paper == "rgb(20, 25, 31)") is dark


def test_a_tap_reads_a_value(open_map: Any) -> None:
    page = open_map(viewport=PHONE, has_touch=True, is_mobile=True)
    box = page.locator(".view-figure").first.bounding_box()
    page.touchscreen.tap(box["x"] + box["width"] * 0.4, box["y"] + box["height"] * 0.4)
    page.wait_for_function("document.querySelector('.view-readout').textContent.includes('\u00b1')")


def test_paper_gets_the_static_figures(open_map: Any) -> None:
    page = open_map()
    page.emulate_media(media="print")
    assert page.locator(".view-static").is_visible()
    assert not page.locator(".view-live").is_visible()


def test_colours_are_those_of_the_static_figures(open_map: Any) -> None:
    page = open_map()
    page.get_by_label("Colours to").fill("0.5")
    page.get_by_label("Colours to").press("Enter")
    page.get_by_label("Colours from").fill("-0.5")
    page.get_by_label("Colours from").press("Enter")
    page.wait_for_timeout(200)
    column = page.evaluate("""() => { const canvas = document.querySelector('.view-canvas canvas');
      const data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
      const at = (x, y) => Array.from(data.slice(4 * (y * canvas.width + x), 4 * (y * canvas.width + x) + 3));
      for (let x = canvas.width - 1; x > 0; x--) {
        const found = []; for (let y = 0; y < canvas.height; y++) { const one = at(x, y);
          if (Math.max(...one) - Math.min(...one) > 60) found.push(one); }
        if (found.length > 200) return found; } return []; }""")
    expected = {
        tuple(round(255 * one) for one in color[:3]) for color in mpl.colormaps["RdBu_r"](np.linspace(0, 1, 2049))
    }
    table = np.array(sorted(expected))
    assert len(column) > 200
    assert max(np.abs(table - one).sum(axis=1).min() for one in np.array(column)) <= 9


def test_the_wheel_scrolls_the_page_until_the_map_is_chosen(open_page: Any, body: str) -> None:
    page = open_page.body(body + '<div style="height: 3000px"></div>')
    page.wait_for_selector(f"{MAP}.alive")
    note = page.locator(f"{MAP} .view-note", has_text="In view")
    note.wait_for()
    whole = note.inner_text()
    box = page.locator(".view-canvas").bounding_box()
    page.mouse.move(box["x"] + 300, box["y"] + 200)
    page.mouse.wheel(0, 40)
    page.wait_for_function("scrollY > 0")
    page.wait_for_timeout(300)
    assert note.inner_text() == whole
    page.evaluate("scrollTo(0, 0)")
    page.mouse.click(box["x"] + 300, box["y"] + 200)
    page.mouse.wheel(0, -400)
    page.wait_for_function(
        f"![...document.querySelectorAll('.view-note')].some((one) => one.textContent === {whole!r})"
    )
    assert page.evaluate("scrollY") == 0


def test_a_drag_moves_what_is_seen(open_map: Any) -> None:
    page = open_map()
    (place,) = places_of(page, (30, 20))
    page.keyboard.press("+")
    page.keyboard.press("+")
    page.mouse.move(*place)
    before = pointer_at(page)
    page.mouse.down()
    page.mouse.move(place[0] + 40, place[1] + 25, steps=4)
    moved = pointer_at(page)
    page.mouse.up()
    assert (moved[0] - before[0], moved[1] - before[1]) == pytest.approx((40, 25), abs=12)


def test_the_picture_shows_each_value_where_it_belongs(open_map: Any, facet: SlopeMap) -> None:
    page = open_map()
    nodes = [(8, 33), (52, 33), (8, 6), (52, 6), (27, 20)]
    limit = float(page.get_by_label("Colours to").input_value())
    for (column, row), place in zip(nodes, places_of(page, *nodes), strict=True):
        color = page.evaluate(
            """([left, top]) => { const canvas = document.querySelector('.view-canvas canvas');
            const box = canvas.getBoundingClientRect(); const ratio = canvas.width / box.width;
            return Array.from(canvas.getContext('2d').getImageData(
              (left - box.left) * ratio, (top - box.top) * ratio, 1, 1).data.slice(0, 3)); }""",
            place,
        )
        value = 1e3 * facet.slope_error_x[row, column]
        expected = mpl.colormaps["RdBu_r"](0.5 + 0.5 * value / limit, bytes=True)[:3]
        assert np.abs(np.array(color) - np.array(expected, dtype=int)).max() <= 6


def test_a_finger_draws_a_section(open_map: Any) -> None:
    page = open_map(viewport=PHONE, has_touch=True, is_mobile=True)
    page.get_by_role("button", name="Section").tap()
    box = page.locator(".view-figure").first.bounding_box()
    session = page.context.new_cdp_session(page)

    def touch(kind: str, *points: tuple[float, float]) -> None:
        touches = [{"x": box["x"] + x * box["width"], "y": box["y"] + y * box["height"]} for x, y in points]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": touches})

    touch("touchStart", (0.3, 0.3))
    for share in (0.35, 0.45, 0.6):
        touch("touchMove", (share, share))
    touch("touchEnd")
    page.wait_for_selector(".view-section .view-canvas canvas")
    assert page.get_by_role("button", name="Section").get_attribute("aria-pressed") == "false"
    assert "In view" in page.locator(f"{MAP} .view-note", has_text="In view").inner_text()


def test_a_pinch_zooms(open_map: Any) -> None:
    page = open_map(viewport=PHONE, has_touch=True, is_mobile=True)
    note = page.locator(f"{MAP} .view-note", has_text="In view")
    whole = note.inner_text()
    box = page.locator(".view-figure").first.bounding_box()
    session = page.context.new_cdp_session(page)
    page.touchscreen.tap(box["x"] + box["width"] * 0.4, box["y"] + box["height"] * 0.4)

    def touch(kind: str, apart: float) -> None:
        places = [(0.45 - apart, 0.4), (0.45 + apart, 0.4)] if apart else []
        touches = [
            {"x": box["x"] + x * box["width"], "y": box["y"] + y * box["height"], "id": index}
            for index, (x, y) in enumerate(places)
        ]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": touches})

    touch("touchStart", 0.05)
    for apart in (0.08, 0.12, 0.16, 0.2):
        touch("touchMove", apart)
    touch("touchEnd", 0)
    changed = "(whole) => ![...document.querySelectorAll('.view-note')].some((one) => one.textContent === whole)"
    page.wait_for_function(changed, arg=whole)
    assert page.evaluate("visualViewport.scale") == 1
