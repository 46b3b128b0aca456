"""Photos in a real browser: which mark is where, why it was refused, and which way its residual points."""

import io
from typing import Any

import numpy as np
import pytest
from PIL import Image

from heliogauge.view.photos import Photo, PhotoLines, PhotoMarks, PhotoView

USED, REFUSED, OUTLINE, ARROW = "#1baf7a", "#d62728", "#00b7ff", "#ff9f1c"


def photo(number: int, count: int = 12, image: bool = True) -> Photo:
    """A grey photo of 400 x 300 px; its first mark lies at (100 + number, 50)."""
    xy = np.stack([100.0 + number + 20 * np.arange(count), 50.0 + 15 * np.arange(count)], axis=1)
    residual = np.tile([0.5, -0.25], (count, 1))
    labels = [f"target {index}" for index in range(count)]
    refused = PhotoMarks("refused", np.array([[40.0, 250.0]]), REFUSED, ["too <b>elongated</b>"], refused=True)
    outline = PhotoLines("outline", [np.array([[20.0, 20.0], [380.0, 20.0], [380.0, 280.0]])], OUTLINE)
    grey = np.full((300, 400), 90, dtype=np.uint8) if image else None
    marks = (PhotoMarks("used", xy, USED, labels, residual), refused)
    return Photo(f"DSC_{number}", 400, 300, grey, marks, (outline,), f"note {number}", f"photo-{number}")


def view(**how: Any) -> str:
    return PhotoView("Photos of <i>all</i>", tuple(photo(number, **how) for number in range(3))).page_html()


def figure_of(page: Any) -> Any:
    figure = page.locator(".view-figure")
    figure.scroll_into_view_if_needed()
    page.locator(".view.alive").wait_for()
    figure.focus()
    return figure


def readout(page: Any) -> str:
    return page.locator(".view-readout").text_content()


def ring(page: Any) -> tuple[float, float]:
    circle = page.locator(".view-overlay circle").last
    return float(circle.get_attribute("cx")), float(circle.get_attribute("cy"))


def pixels_like(figure: Any, color: str) -> int:
    seen = np.asarray(Image.open(io.BytesIO(figure.screenshot())).convert("RGB")).astype(int)
    wanted = np.array([int(color[at : at + 2], 16) for at in (1, 3, 5)])
    return int(np.count_nonzero(np.abs(seen - wanted).max(axis=2) < 24))


def test_a_mark_says_its_name_place_and_residual(open_page: Any) -> None:
    page = open_page.body(view())
    figure = figure_of(page)
    page.keyboard.press(".")
    words = "used: target 0; column 100.00, row 50.00 px; residual 0.500, \u22120.250 px, together 0.559 px"
    assert readout(page) == words
    left, top = ring(page)
    page.keyboard.press("Escape")
    assert readout(page) == ""
    box = figure.bounding_box()
    page.mouse.move(box["x"] + left + 3, box["y"] + top - 3)
    assert readout(page) == words
    page.mouse.move(box["x"] + left + 3, box["y"] + top + 40)
    assert readout(page).startswith("column 10")


def test_a_refused_mark_says_why_and_text_stays_text(open_page: Any) -> None:
    page = open_page.body(view())
    figure_of(page)
    page.keyboard.press("r")
    assert readout(page) == "refused: too <b>elongated</b>; column 40.00, row 250.00 px"
    assert page.locator(".view-title").text_content() == "Photos of <i>all</i>"


def test_photos_by_keys_and_list(open_page: Any) -> None:
    page = open_page.body(view())
    figure_of(page)
    for key, name in (
        ("ArrowRight", "DSC_1"),
        ("ArrowRight", "DSC_2"),
        ("ArrowRight", "DSC_0"),
        ("ArrowLeft", "DSC_2"),
    ):
        page.keyboard.press(key)
        page.wait_for_function("name => document.querySelector('.view select').value.startsWith(name)", arg=name)
    page.get_by_label("Photo", exact=True).select_option(index=1)
    page.get_by_text("Photo 2 of 3. note 1").wait_for()
    page.locator(".view-figure").focus()
    page.keyboard.press(".")
    assert "column 101.00" in readout(page)


@pytest.mark.parametrize("again", [False, True])
def test_a_link_opens_its_photo(open_page: Any, again: bool) -> None:
    page = open_page.body(f'<a href="#photo-2">beam 2</a><div style="height: 3000px"></div>{view()}')
    page.get_by_role("link", name="beam 2").click()
    page.get_by_text("Photo 3 of 3. note 2").wait_for()
    if again:
        page.keyboard.press("ArrowRight")
        page.get_by_text("Photo 1 of 3. note 0").wait_for()
        page.get_by_role("link", name="beam 2").click()
        page.get_by_text("Photo 3 of 3. note 2").wait_for()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("layer", "color"), [("○ used", USED), ("\u00d7 refused", REFUSED), ("residuals", ARROW), ("outline", OUTLINE)]
)
def test_layers_are_switched(open_page: Any, layer: str, color: str) -> None:
    page = open_page.body(view())
    figure = figure_of(page)
    before = pixels_like(figure, color)
    page.get_by_role("button", name=layer).click()
    assert before > 10 * max(pixels_like(figure, color), 1)
    page.get_by_role("button", name=layer).click()
    assert abs(pixels_like(figure, color) - before) <= 0.1 * before


def test_a_mark_that_is_switched_off_is_not_named(open_page: Any) -> None:
    page = open_page.body(view())
    figure_of(page)
    page.get_by_role("button", name="○ used").click()
    page.locator(".view-figure").focus()
    page.keyboard.press(".")
    assert readout(page).startswith("refused")


def test_residuals_point_where_they_point_and_grow_with_the_slider(open_page: Any) -> None:
    """Measured minus predicted of (0.5, -0.25) px points right and up, for rows grow downwards."""
    one = Photo(
        "p", 400, 300, None, (PhotoMarks("used", np.array([[200.0, 150.0]]), USED, (), np.array([[0.5, -0.25]])),)
    )
    page = open_page.body(PhotoView("one", (one,)).page_html())
    figure = figure_of(page)
    page.keyboard.press(".")
    left, top = ring(page)
    page.keyboard.press("Escape")

    def reach() -> tuple[float, float]:
        seen = np.asarray(Image.open(io.BytesIO(figure.screenshot())).convert("RGB")).astype(int)
        # The bar that shows the scale lies in the lower part.
        rows, columns = np.nonzero((np.abs(seen - [255, 159, 28]).max(axis=2) < 40)[: int(top) + 60])
        return columns.max() - left, top - rows.min()

    right, up = reach()
    assert right > 5
    assert up == pytest.approx(0.5 * right, abs=4)
    words = page.locator(".view-bar output").text_content()
    page.get_by_label("Length of the residual vectors").fill("0.3")
    longer, _ = reach()
    assert longer / right == pytest.approx(10**0.3, rel=0.15)
    assert page.locator(".view-bar output").text_content() != words


@pytest.mark.slow
def test_ninety_thousand_marks_are_small_and_found(open_page: Any) -> None:
    rng = np.random.default_rng(3)
    places = rng.uniform(0, 1, (90_000, 2)) * [5999, 3999]
    marks = PhotoMarks("used", places, USED, (), rng.normal(0, 0.1, places.shape))
    body = PhotoView("many", (Photo("p", 6000, 4000, None, (marks,)),)).page_html()
    assert len(body) < 2_000_000
    page = open_page.body(body)
    figure = figure_of(page)
    assert pixels_like(figure, USED) > 10_000
    page.keyboard.press(".")
    assert f"column {places[0, 0]:.2f}, row {places[0, 1]:.2f} px" in readout(page)
    for _ in range(3):
        page.keyboard.press("+")
    assert f"column {places[0, 0]:.2f}" in readout(page)
    left, top = ring(page)
    box = figure.bounding_box()
    assert 0 < left < box["width"]
    assert 0 < top < box["height"]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_phone_shows_it_without_sideways_scrolling(open_page: Any, scheme: str) -> None:
    page = open_page.body(
        view(image=False), viewport={"width": 390, "height": 844}, color_scheme=scheme, has_touch=True
    )
    figure_of(page)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    page.locator(".view-figure").tap()
    page.get_by_role("button", name="Next photo").tap()
    page.get_by_text("Photo 2 of 3. note 1").wait_for()
