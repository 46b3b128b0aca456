"""Still pictures: marks where their values are, few bytes for many, texts that stay texts."""

import base64
import re
from urllib.parse import unquote

import cv2
import numpy as np
import pytest

from heliogauge.errors import InputError
from heliogauge.view.contours import zero_lines
from heliogauge.view.still_maps import correlation_still
from heliogauge.view.stills import LegendEntry, Sheet, _quoted, colors_of, fitted_sheet, time_ticks


def sheet() -> Sheet:
    return fitted_sheet((0.0, 10.0), (0.0, 5.0))


def test_axes_of_a_fitted_sheet_have_one_scale() -> None:
    for limits in (((0, 10), (0, 5)), ((0, 1), (30, 0)), ((-2e-3, 2e-3), (0, 1e-3))):
        one = fitted_sheet(*limits)
        left, top, right, bottom = one.box
        (x0, x1), (y0, y1) = limits
        assert (right - left) / (x1 - x0) == pytest.approx((bottom - top) / abs(y1 - y0))
        assert one.place_y(y0) == pytest.approx(bottom)
        assert one.place_x(x0) == pytest.approx(left)


def test_dots_are_at_their_values_however_they_are_drawn() -> None:
    """A few are vectors, many an image: both have the red dot at the same place."""
    one = sheet()
    one.dots([7.0], [4.0], ["#ff0000"])
    (path,) = re.findall(r'd="M([\d.]+),([\d.]+)h0"', one.svg())
    assert [float(value) for value in path] == pytest.approx(
        [float(one.place_x(7.0)), float(one.place_y(4.0))], abs=0.1
    )
    many, rng = sheet(), np.random.default_rng(1)
    x, y = rng.uniform(0, 10, 90_000), rng.uniform(0, 2, 90_000)
    many.dots([*x, 7.0], [*y, 4.0], [*colors_of(y, 0.0, 2.0, diverging=False), "#ff0000"], size_px=1.0)
    assert len(many.svg()) < 600_000
    (coded,) = re.findall(r"data:image/png;base64,([^\"]+)", many.svg())
    image = cv2.imdecode(np.frombuffer(base64.b64decode(coded), np.uint8), cv2.IMREAD_UNCHANGED)
    red = np.argwhere((image == [0, 0, 255, 255]).all(axis=-1)).mean(axis=0)
    assert red / image.shape[:2] == pytest.approx([0.2, 0.7], abs=0.005)


def test_arrows_lead_from_place_to_place() -> None:
    one = sheet()
    one.arrows([1.0], [1.0], [3.0], [2.0], "#000000")
    numbers = re.findall(r"[ML]([\d.]+),([\d.]+)", one.svg())
    ends = [[float(one.place_x(x)), float(one.place_y(y))] for x, y in ((1.0, 1.0), (4.0, 3.0))]
    assert np.array(numbers[:2], dtype=float) == pytest.approx(np.array(ends), abs=0.1)


@pytest.mark.parametrize("unit", ["mm", "mm out of plane"])
def test_the_unit_of_a_color_bar_is_within_the_sheet(unit: str) -> None:
    """ "[mm out of plane]" was cut off at the right edge of pictures in print."""
    one = sheet()
    one.color_bar(-1.0, 1.0, unit, diverging=True)
    (x,) = re.findall(rf'<text x="([0-9.]+)"[^>]*>\[{unit}\]</text>', one.svg())
    # Letters of the font are 0.56 of its size wide, as for titles.
    assert float(x) + 0.56 * 11.5 * len(f"[{unit}]") <= one.width


def test_texts_stay_texts_and_the_legend_makes_room() -> None:
    evil = '<script>alert("1")</script>'
    one = sheet()
    height = one.height
    one.title(evil, evil)
    one.legend([LegendEntry(evil, "#123456", kind) for kind in ("line", "dot", "cross", "box", "hatched", "dashed")])
    shown = one.svg() + one.html(evil).text + correlation_still([evil], np.ones((1, 1)), evil, evil).text
    assert "<script" not in shown
    assert one.height > height + 34


def test_lines_of_zero_run_through_the_grid_and_leave_out_what_is_unknown() -> None:
    y, x = np.mgrid[-1:1:41j, -1:1:51j]
    (circle,) = zero_lines(x, y, np.hypot(x, y) - 0.6)
    assert np.hypot(*circle.T) == pytest.approx(0.6, abs=1e-3)
    assert np.array_equal(circle[0], circle[-1])
    assert np.linalg.norm(np.diff(circle, axis=0), axis=1).sum() == pytest.approx(1.2 * np.pi, rel=0.01)
    (part,) = zero_lines(x, y, np.where(x > 0.1, np.nan, np.hypot(x, y) - 0.6))
    assert part[:, 0].max() < 0.1
    # Two diagonal corners are above zero: the middle says what belongs together.
    saddle = zero_lines(*np.mgrid[0:2, 0:2].astype(float)[::-1], np.array([[1.0, -2.0], [-2.0, 1.0]]))
    assert sorted(len(line) for line in saddle) == [2, 2]
    with pytest.raises(InputError):
        zero_lines(x, y[:3], x)


def test_ticks_of_time_are_round() -> None:
    start, end = (np.datetime64(text, "s").astype(float) for text in ("2022-04-11T09:00", "2024-05-02T10:00"))
    assert [words for _, words in time_ticks((start, end), 5)] == ["2022-07", "2023-01", "2023-07", "2024-01"]
    places = [place for place, _ in time_ticks((start, start + 7200.0), 5)]
    assert np.diff(places).tolist() == [1800.0] * 4
    assert time_ticks((start, start + 4 * 86_400.0), 5)[0][1] == "2022-04-12"


def test_an_address_holds_all_characters() -> None:
    every = "".join(map(chr, range(0x250))) + "% %25 <svg a='é'> 5 µm ± ☀ %%"
    address = _quoted(every)
    assert address.isascii()
    assert unquote(address) == every
    assert not set(address) & set('"#<>&\\\n')
