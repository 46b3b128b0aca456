"""Scenes in a real browser: what is where, and what the reader may ask of it."""

from typing import Any

import numpy as np
import pytest

from heliogauge.view.assets import page_assets
from heliogauge.view.scenes import SceneGroup, SceneView

# 0 and 1 lie along x, 0 and 2 along y, 0 and 3 along z; far from the origin, as in a field.
POINTS = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, 2.0]]) + [1000.0, -500.0, 100.0]


def view() -> str:
    labels = [f"target {index}, sigma <b>0.1</b> mm" for index in range(4)]
    targets = SceneGroup("targets", POINTS, ["#1b6ca8"] * 2 + ["#d62728"] * 2, labels=labels, size_px=8)
    cameras = SceneGroup("cameras", POINTS[:1] + [2.0, 1.0, 1.5], ["#1f2a36"], size_px=8)
    rays = SceneGroup("rays", np.concatenate([POINTS[:1], POINTS[:1] + 1.0]), ["#888888"], lengths=[2])
    return SceneView("A network", (targets, cameras, rays)).page_html()


def start(page: Any) -> Any:
    figure = page.locator(".view-scene")
    figure.scroll_into_view_if_needed()
    page.locator(".view.alive").wait_for()
    figure.focus()
    return figure


def readout(page: Any) -> str:
    return page.locator(".view-readout").text_content()


def settle(page: Any) -> None:
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")


def places(page: Any) -> list[tuple[float, float]]:
    """Return where the four targets are seen."""
    found = []
    page.keyboard.press("Escape")
    for _ in range(4):
        page.keyboard.press(".")
        settle(page)
        circle = page.locator(".view-overlay circle")
        found.append((float(circle.get_attribute("cx")), float(circle.get_attribute("cy"))))
    return found


def test_a_point_says_its_name_and_coordinates(open_page: Any) -> None:
    page = open_page.body(view())
    figure = start(page)
    page.keyboard.press(".")
    page.keyboard.press(".")
    settle(page)
    words = "target 1, sigma <b>0.1</b> mm; x, y, z = 1004.0000, \u2212500.0000, 100.0000 m; targets"
    assert readout(page) == words
    circle, box = page.locator(".view-overlay circle"), figure.bounding_box()
    left, top = float(circle.get_attribute("cx")), float(circle.get_attribute("cy"))
    page.keyboard.press("Escape")
    assert readout(page) == ""
    page.mouse.move(box["x"] + left + 2, box["y"] + top + 2)
    assert readout(page) == words
    page.mouse.move(box["x"] + left + 40, box["y"] + top + 90)
    assert readout(page) == ""
    page.get_by_role("button", name="targets").click()
    page.mouse.move(box["x"] + left + 2, box["y"] + top + 2)
    assert readout(page) == ""


def test_x_is_to_the_right_and_y_up_seen_from_above(open_page: Any) -> None:
    page = open_page.body(view())
    start(page)
    page.keyboard.press("1")
    (x0, y0), (x1, y1), (x2, y2), _ = places(page)
    assert x1 > x0 + 50
    assert y1 == pytest.approx(y0, abs=1)
    assert y2 < y0 - 50
    assert x2 == pytest.approx(x0, abs=1)
    page.get_by_role("button", name="Along y").click()
    page.locator(".view-scene").focus()
    (x0, y0), (x1, _), _, (x3, y3) = places(page)
    assert x1 > x0 + 50
    assert y3 < y0 - 50
    assert x3 == pytest.approx(x0, abs=1)


def test_axes_carry_metres_that_can_be_read(open_page: Any) -> None:
    page = open_page.body(view())
    start(page)
    settle(page)
    labels = page.locator(".view-overlay text")
    words = labels.all_text_contents()
    assert {"x [m]", "y [m]", "z [m]"} <= set(words)
    numbers = [float(one.replace("\u2212", "-")) for one in words if "[" not in one]
    assert len(numbers) >= 8
    assert {one for one in numbers if one > 500} <= {1000.0, 1001.0, 1002.0, 1003.0, 1004.0}
    assert {one for one in numbers if one < 0} <= {-500.0, -499.0, -498.0, -497.0}
    boxes = [labels.nth(index).bounding_box() for index in range(len(words))]
    for index, one in enumerate(boxes):
        for other in boxes[:index]:
            across = min(one["x"] + one["width"], other["x"] + other["width"]) - max(one["x"], other["x"])
            down = min(one["y"] + one["height"], other["y"] + other["height"]) - max(one["y"], other["y"])
            assert min(across, down) < 4


@pytest.mark.slow
def test_keys_and_drag_turn_and_zoom(open_page: Any) -> None:
    page = open_page.body(view())
    figure = start(page)
    first = places(page)
    page.keyboard.press("ArrowRight")
    turned = places(page)
    assert np.abs(np.subtract(turned, first)).max() > 10
    page.keyboard.press("ArrowLeft")
    assert np.abs(np.subtract(places(page), first)).max() < 0.5
    page.keyboard.press("+")
    settle(page)
    spread = np.ptp(np.array(places(page))[:, 0]) / np.ptp(np.array(first)[:, 0])
    assert spread > 1.15
    page.keyboard.press("0")
    assert np.abs(np.subtract(places(page), first)).max() < 0.5
    box = figure.bounding_box()
    page.mouse.move(box["x"] + 40, box["y"] + 40)
    page.mouse.down()
    page.mouse.move(box["x"] + 140, box["y"] + 40, steps=4)
    page.mouse.up()
    assert np.abs(np.subtract(places(page), first)).max() > 10


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_phone_shows_it_without_sideways_scrolling(open_page: Any, scheme: str) -> None:
    page = open_page.body(view(), viewport={"width": 390, "height": 844}, color_scheme=scheme, has_touch=True)
    start(page)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert all(0 < x < 390 for x, _ in places(page))


def test_without_webgl_the_still_picture_stays(chromium: Any, tmp_path: Any) -> None:
    body = view()
    path = tmp_path / "page.html"
    head = f'<meta charset="utf-8"><title>t</title>{page_assets(body)}'
    path.write_text(f'<!DOCTYPE html><html lang="en"><head>{head}</head><body>{body}</body></html>', "utf-8")
    page = chromium.new_context().new_page()
    page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    complaints: list[str] = []
    page.on("console", lambda message: complaints.append(message.text))
    page.goto(path.as_uri())
    page.wait_for_function("document.querySelector('.view-live') === null && document.querySelector('[data-library]')")
    page.wait_for_timeout(300)
    assert all(one.is_visible() for one in page.locator(".view-static img").all())
    assert page.locator(".view-static img").count() == 2
    assert any("WebGL" in one for one in complaints)
    page.context.close()
