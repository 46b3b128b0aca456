"""What views put into a page, read back without a browser."""

import base64
import gzip
import json
import re

import numpy as np
import pytest

from heliogauge.errors import InputError
from heliogauge.flags import SampleFlag
from heliogauge.slopes.map import SlopeMap, no_common_modes
from heliogauge.slopes.removal import Removal, remove
from heliogauge.slopes.statistics import statistics
from heliogauge.validate import FloatArray
from heliogauge.view.arrays import PAGE, ServedStore, reading_step
from heliogauge.view.assets import page_assets
from heliogauge.view.charts import ChartSeries, ChartView, Mark
from heliogauge.view.maps import MapLayer, MapView, slope_map_view
from heliogauge.view.photos import Photo, PhotoMarks, PhotoView
from heliogauge.view.scenes import SceneGroup, SceneView
from heliogauge.view.tables import TableColumn, TableView


def unpack(packed: dict) -> FloatArray:
    """Undo `PageStore.numbers`, as the page's script does."""
    planes = np.frombuffer(gzip.decompress(base64.b64decode(packed["data"])), np.uint8).reshape(4, -1)
    folded = np.ascontiguousarray(planes.T).view("<u4").ravel()
    differences = (folded >> 1).astype(np.int64) ^ -(folded & 1).astype(np.int64)
    values = np.cumsum(differences.reshape(packed["shape"]), axis=-1) * packed["step"]
    if "known" in packed:
        bits = np.frombuffer(gzip.decompress(base64.b64decode(packed["known"])), np.uint8)
        known = np.unpackbits(bits)[: values.size].reshape(values.shape).astype(bool)
        values = np.where(known, values, np.nan)
    return values


def spec_of(page: str) -> dict:
    return json.loads(re.search(r'<script type="application/json">(.*?)</script>', page, re.DOTALL)[1])


@pytest.fixture(scope="module")
def bumpy() -> SlopeMap:
    """A parabolic facet with tilt, wrong focus, waves, noise and a hole."""
    rng = np.random.default_rng(5)
    x_m, y_m = np.linspace(-0.6, 0.6, 61), np.linspace(-0.5, 0.5, 51)
    x, y = np.meshgrid(x_m, y_m)
    design = x / 20, y / 20
    waves = 1e-3 * np.sin(9 * x) * np.cos(7 * y)
    slope_x = design[0] * 1.02 + 8e-4 + waves + rng.normal(0, 2e-5, x.shape)
    slope_y = design[1] * 1.02 - 5e-4 + 0.5 * waves + 4e-4 * x
    hole = (x - 0.2) ** 2 + (y - 0.1) ** 2 < 0.01
    outside = np.hypot(x, y) > 0.7
    flags = np.where(hole, int(SampleFlag.OFF_SCREEN), 0) | np.where(outside, int(SampleFlag.OUTSIDE_MIRROR), 0)
    missing = hole | outside
    return SlopeMap(
        x_m=x_m,
        y_m=y_m,
        slope_x=np.where(missing, np.nan, slope_x),
        slope_y=np.where(missing, np.nan, slope_y),
        design_slope_x=design[0],
        design_slope_y=design[1],
        sigma_random_x=np.full(x.shape, 2e-5),
        sigma_random_y=np.full(x.shape, 1e-5) * (1 + x**2),
        noise_correlation=1.0,
        common=no_common_modes(),
        height_m=np.full(x.shape, np.nan),
        flags=flags.astype(np.uint32),
        aperture=~outside,
        design="paraboloid, f = 10 m",
        frame="mirror",
        removed="nothing",
    )


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e7])
def test_numbers_come_back_to_the_step(scale: float) -> None:
    rng = np.random.default_rng(1)
    values = scale * rng.standard_t(2, (40, 70))
    values[rng.random(values.shape) < 0.1] = np.nan
    step = reading_step(values)
    back = unpack(PAGE.numbers(values, step))
    assert np.array_equal(np.isnan(back), np.isnan(values))
    assert np.nanmax(np.abs(back - values)) <= 0.501 * step
    assert step < np.nanpercentile(np.abs(values), 99) / 4999


def test_extreme_values_stay_in_range() -> None:
    values = np.array([1e-9, -3e30, 3e30, np.nan])
    assert unpack(PAGE.numbers(values, 1e-12))[1:3] == pytest.approx(values[1:3], rel=1e-8)


@pytest.mark.parametrize("removal", list(Removal))
def test_removed_parts_are_those_of_python(bumpy: SlopeMap, removal: Removal) -> None:
    (removals,) = slope_map_view(bumpy, "facet").removals
    (part,) = [one for one in removals.parts if one.removal is removal]
    x, y = np.meshgrid(bumpy.x_m - removals.middle_m[0], bumpy.y_m - removals.middle_m[1])
    designs = removals.design_x - removals.design_mean[0], removals.design_y - removals.design_mean[1]
    changed = remove(bumpy, removal)
    for axis, before, after in ((0, bumpy.slope_x, changed.slope_x), (1, bumpy.slope_y, changed.slope_y)):
        taken = np.tensordot(part.coefficients[axis], np.stack([np.ones_like(x), x, y, designs[axis]]), axes=1)
        assert np.nanmax(np.abs(before - taken - after)) < 1e-15
    assert part.statistics.sdx_rad == statistics(bumpy, removed=removal).sdx_rad


def test_a_map_in_a_page_holds_values_sigmas_and_reasons(bumpy: SlopeMap) -> None:
    spec = spec_of(slope_map_view(bumpy, "facet").page_html())
    first = spec["layers"][0]
    values = unpack(spec["arrays"][first["values"]["place"]])
    sigma = unpack(spec["arrays"][first["sigma"]["place"]])
    expected = bumpy.slope_error_x
    assert np.nanmax(np.abs(values - expected)) < 1e-6
    assert sigma[25, 20] == pytest.approx(bumpy.sigma_random_x[25, 20], rel=1e-3)
    codes = np.frombuffer(gzip.decompress(base64.b64decode(spec["flags"]["data"])), np.uint8).reshape(51, 61)
    row, column = np.argwhere((bumpy.flags & int(SampleFlag.OFF_SCREEN)) != 0)[0]
    assert spec["reasons"][codes[row, column]]["words"] == ["the reflected ray misses the screen"]
    shared = {layer["values"]["place"] for layer in spec["layers"]} & {first["sigma"]["place"]}
    assert shared, "sigma of the first layer is a layer itself and packed once"


def test_a_page_of_a_large_map_is_thinned_and_a_served_one_whole() -> None:
    values = np.random.default_rng(0).normal(size=(900, 1000))
    flags = np.zeros(values.shape, dtype=np.uint32)
    layer = MapLayer("a", "A", "m", values)
    view = MapView("large", np.arange(1000.0), np.arange(900.0), (layer,), flags, np.ones(values.shape, bool))
    spec = spec_of(view.page_html())
    assert spec["arrays"][0]["shape"] == [300, 333]
    assert len(spec["x"]) == 333
    store = ServedStore("data/")
    served = spec_of(view.page_html(store))["arrays"][0]
    kept = np.frombuffer(store.contents[int(served["url"].removeprefix("data/"))][0], "<f4").reshape(served["shape"])
    assert np.array_equal(kept, values.astype(np.float32))


def test_texts_from_files_stay_texts() -> None:
    evil = '</script><b onload="x">"a"'
    groups = (SceneGroup("a", np.eye(3), ["#000000"], labels=[evil] * 3),)
    marks = PhotoMarks(evil, np.zeros((1, 2)), "#ff0000", labels=[evil])
    table = TableView("t", (TableColumn(evil, [evil], links=["javascript:alert(1)"]),))
    views = (
        SceneView("a", groups, note=evil),
        PhotoView("p", (Photo(evil, 10, 10, None, (marks,)),)),
        ChartView(evil, "x", "y", (ChartSeries(evil, np.arange(2.0), np.arange(2.0), "#000000"),)),
        table,
    )
    for view in views:
        page = view.page_html()
        assert "<b onload" not in page
        assert 'href="javascript:' not in page
        assert page.count("</script>") == page.count("<script")


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(InputError, match="lines of 3 vertices for 2 points"):
        SceneGroup("a", np.zeros((2, 3)), ["#000000"], lengths=[3])
    with pytest.raises(InputError, match="different lengths"):
        TableView("t", (TableColumn("a", ["1"]), TableColumn("b", ["1", "2"])))
    with pytest.raises(InputError, match="do not fit 1 points"):
        Photo("p", 5, 5, None, (PhotoMarks("m", np.zeros((1, 2)), "#000000", labels=["a", "b"]),))
    with pytest.raises(InputError, match="nothing to show"):
        SceneView("s", ())
    with pytest.raises(InputError, match="lengths"):
        ChartView("c", "x", "y", (ChartSeries("a", np.zeros(2), np.zeros(3), "#000000"),))


def test_static_figures_show_every_view(bumpy: SlopeMap) -> None:
    lines = ChartSeries("a", np.arange(5.0), np.arange(5.0), "#1b6ca8", sigma=np.ones(5))
    pixels = np.full((40, 60), 90, dtype=np.uint8)
    marks = PhotoMarks("used", np.array([[3.0, 4.0]]), "#00ff00", residual_px=np.array([[0.1, 0.2]]))
    views = (
        slope_map_view(bumpy, "facet"),
        SceneView("s", (SceneGroup("g", np.eye(3), ["#000000"]), SceneGroup("l", np.eye(3), ["#000000"], [3]))),
        ChartView("c", "x", "y", (lines,)),
        PhotoView("p", (Photo("one", 60, 40, pixels, (marks,)),)),
    )
    for view in views:
        assert "<img " in view._repr_html_()
        assert view._repr_html_() in view.page_html()


def test_assets_are_those_of_the_views_in_the_page() -> None:
    assert page_assets("<p>no view</p>") == ""
    table = TableView("t", (TableColumn("a", ["1"]),))
    assert "tr.further" in page_assets(table.page_html())


def test_a_still_chart_of_counted_things_has_whole_ticks() -> None:
    series = ChartSeries("modules", np.array([1.0, 2.0]), np.array([30.0, 40.0]), "#1b6ca8", Mark.POINTS)
    chart = ChartView("Modules", "module", "length [m]", (series,), x_counts=True)
    below = re.findall(r'text-anchor="middle">([\d.]+)<', chart.sheet().svg())
    assert below == ["1", "2"]


def test_names_stand_beside_their_points_and_cover_neither_names_nor_points() -> None:
    x, y = np.array([5.0, 5.02, 0.0, 10.0]), np.array([5.0, 5.0, 0.0, 10.0])
    names = ("first", "second", "", "<last>")
    view = ChartView("Field", "east", "north", (ChartSeries("s", x, y, "#123456", Mark.POINTS, names=names),))
    drawn = view.sheet().svg()
    places = {
        name: (float(across), float(along))
        for across, along, name in re.findall(r'<text x="([\d.]+)" y="([\d.]+)"[^>]*middle">([^<]*)</text>', drawn)
        if name in {"first", "second", "&lt;last&gt;"}
    }
    assert set(places) == {"first", "second", "&lt;last&gt;"}
    apart = np.abs(np.subtract(places["first"], places["second"]))
    assert apart[0] > 35 or apart[1] >= 11
    assert '"names"' in view.page_html()
    with pytest.raises(InputError, match="has lengths"):
        ChartView("Field", "e", "n", (ChartSeries("s", x, y, "#123456", Mark.POINTS, names=("a",)),))
