"""Figures: the right values at the right place, gaps visible, limits said, nothing shown on a screen."""

import io
import subprocess
import sys
from dataclasses import replace
from urllib.parse import unquote

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from heliogauge.errors import InputError
from heliogauge.flags import SampleFlag
from heliogauge.reporting.canvas import MapStyle, clipping_words, map_figure, png_of
from heliogauge.reporting.look import MISSING, MOST_NODES, extent_of, nice_ceiling, robust_limit, thinned
from heliogauge.slopes.map import CommonModes, SlopeMap
from heliogauge.view.charts import ChartSeries, ChartView
from heliogauge.view.maps import slope_map_view
from heliogauge.view.photos import Photo, PhotoView
from heliogauge.view.scenes import SceneGroup, SceneView
from heliogauge.view.still_maps import flag_still
from tests.without_plots import without_plots

FOCAL_M = 10.0


def make_map(rows: int = 48, columns: int = 60, height_m: float = 0.8) -> SlopeMap:
    """A paraboloid with a known wave on it, a hole, and two common modes."""
    rng = np.random.default_rng(1)
    x_m, y_m = np.linspace(-0.6, 0.6, columns), np.linspace(-height_m / 2, height_m / 2, rows)
    x, y = np.meshgrid(x_m, y_m)
    flags = np.zeros(x.shape, np.uint32)
    hole = np.hypot(x - 0.2, y - 0.15) < 0.1
    flags[hole] = int(SampleFlag.SATURATED)
    aperture = np.abs(x) < 0.55
    sigma = np.full(x.shape, 2e-5)
    design = (x / (2 * FOCAL_M), y / (2 * FOCAL_M))
    wave = 4e-4 * np.sin(6 * x)
    slope_x = np.where(hole, np.nan, design[0] + wave + rng.normal(0, sigma))
    slope_y = np.where(hole, np.nan, design[1] + rng.normal(0, sigma))
    common = CommonModes(("mirror pose", "camera"), rng.normal(0, 2e-5, (2, 2, 3)), np.zeros(2), 0.6)
    height = (x**2 + y**2) / (4 * FOCAL_M) - 4e-4 / 6 * np.cos(6 * x)
    return SlopeMap(
        x_m,
        y_m,
        slope_x,
        slope_y,
        *design,
        sigma,
        sigma,
        1.0,
        common,
        height,
        flags,
        aperture,
        "paraboloid, f = 10 m",
        "facet",
        "nothing",
    )


SLOPE_MAP = make_map()


def error_map(slope_map: SlopeMap, axis: str) -> Figure:
    return slope_map_view(slope_map, "mirror").figure(f"slope_error_{axis}")


def test_where_matplotlib_is_not_installed_plots_say_so_and_stills_are_drawn() -> None:
    series = ChartSeries("one", np.arange(3.0), np.arange(3.0), "#1b6ca8")
    views = (
        slope_map_view(SLOPE_MAP, "mirror"),
        ChartView("chart", "x [m]", "y [m]", (series,)),
        SceneView("scene", (SceneGroup("points", np.eye(3), ["#1b6ca8"]),)),
        PhotoView("photos", (Photo("one", 60, 40, None),)),
    )
    with without_plots():
        for view in views:
            assert "<img" in view._repr_html_()
            with pytest.raises(InputError, match=r"pip install 'heliogauge\[plots\]'"):
                view.figure()
    for view in views:
        assert png_of(view.figure()).startswith(b"\x89PNG")


def test_figures_need_no_pyplot_xarray_or_pandas() -> None:
    program = "import sys, heliogauge.view.maps, heliogauge.reporting.canvas; print(*sys.modules)"
    modules = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.split()
    assert "matplotlib.figure" in modules
    assert not {"matplotlib.pyplot", "xarray", "pandas"} & set(modules)


def test_a_map_shows_each_value_at_its_place_in_mrad() -> None:
    values = np.full(SLOPE_MAP.shape, np.nan)
    row, column = 40, 50
    values[row, column] = 3e-3
    figure = map_figure(SLOPE_MAP, values, MapStyle("one node", "mrad", 1e3))
    axes = figure.axes[0]
    image = axes.images[0]
    # Ask the drawn image what it shows under the node's own coordinates: right, and above the middle.
    event = type("Event", (), {"inaxes": axes})()
    event.x, event.y = axes.transData.transform((SLOPE_MAP.x_m[column], SLOPE_MAP.y_m[row]))
    assert image.get_cursor_data(event) == pytest.approx(3.0)
    event.x, event.y = axes.transData.transform((SLOPE_MAP.x_m[column], -SLOPE_MAP.y_m[row]))
    assert image.get_cursor_data(event) is np.ma.masked
    assert event.y < axes.transData.transform((0, 0))[1]
    assert "seen from the front" in axes.get_xlabel()


@pytest.mark.parametrize(("rows", "columns", "height_m"), [(48, 60, 0.8), (30, 300, 0.1), (300, 30, 12.0)])
def test_maps_keep_the_mirrors_proportions(rows: int, columns: int, height_m: float) -> None:
    slope_map = make_map(rows, columns, height_m)
    figure = error_map(slope_map, "x")
    png_of(figure)
    axes = figure.axes[0]
    box = axes.get_window_extent()
    left, right, low, high = extent_of(slope_map)
    assert box.height / box.width == pytest.approx((high - low) / (right - left), rel=1e-3)
    assert figure.get_size_inches()[1] < 6


def test_missing_mirror_is_grey_and_outside_is_white() -> None:
    figure = error_map(SLOPE_MAP, "x")
    picture = np.asarray(Image.open(io.BytesIO(png_of(figure))).convert("RGB")).astype(int)
    axes = figure.axes[0]

    def patch(x: float, y: float) -> np.ndarray:
        column, row = axes.transData.transform((x, y))
        row = picture.shape[0] - row
        return picture[int(row) - 5 : int(row) + 5, int(column) - 2 : int(column) + 3].reshape(-1, 3)

    grey = tuple(int(MISSING[i : i + 2], 16) for i in (1, 3, 5))
    in_the_hole = patch(0.2, 0.15)
    assert grey in {tuple(pixel) for pixel in in_the_hole}
    # Hatching: more than one grey.
    assert len({tuple(pixel) for pixel in in_the_hole}) > 1
    assert (patch(0.585, 0.0) == 255).all()


def test_both_directions_share_their_colours_and_zero_is_in_the_middle() -> None:
    limits = [error_map(SLOPE_MAP, axis).axes[0].images[0].get_clim() for axis in "xy"]
    assert limits[0] == limits[1]
    assert limits[0][0] == -limits[0][1]


def test_clipping_is_said() -> None:
    error = SLOPE_MAP.slope_error_x.copy()
    error[5, 5:10] = 0.1
    figure = map_figure(SLOPE_MAP, error, MapStyle("clipped", "mrad", 1e3))
    assert "beyond the colours" in figure.texts[1].get_text()
    assert "100" in figure.texts[1].get_text()
    assert clipping_words(np.array([1.0, -1.0]), 1.0, MapStyle("", "")) == ""
    assert clipping_words(np.array([np.nan]), 1.0, MapStyle("", "")) == "no value anywhere"


@pytest.mark.parametrize(
    ("value", "expected"), [(1.0, 1.0), (1.01, 1.2), (0.00099, 0.001), (9.9, 10), (0, 1), (np.nan, 1), (47, 50)]
)
def test_limits_are_round_numbers(value: float, expected: float) -> None:
    assert nice_ceiling(value) == expected


def test_a_few_bad_nodes_do_not_hide_the_map() -> None:
    values = np.concatenate([np.linspace(-1, 1, 1000), [500.0]])
    assert robust_limit(values) == 1.0


def test_large_maps_are_thinned_by_whole_nodes() -> None:
    field = np.arange(1200 * 900).reshape(1200, 900)
    small = thinned(field)
    assert max(small.shape) <= MOST_NODES
    assert np.isin(small, field).all()


def test_the_legend_of_flags_gives_reasons_and_shares() -> None:
    text = unquote(flag_still(SLOPE_MAP).text)
    hole = np.count_nonzero(SLOPE_MAP.flags) / np.count_nonzero(SLOPE_MAP.aperture)
    assert f">at least one frame saturated: {hole:.2%}<" in text
    assert "seen from the front" in text


def test_a_map_without_any_value_still_draws() -> None:
    nothing = np.full(SLOPE_MAP.shape, np.nan)
    empty = replace(SLOPE_MAP, slope_x=nothing, slope_y=nothing, height_m=nothing)
    assert "0.00% of the mirror measured" in flag_still(empty).text
    assert "no value" in map_figure(empty, nothing, MapStyle("nothing", "mrad")).texts[1].get_text()
