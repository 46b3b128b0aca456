"""The report of a trough: what is stored comes back, and the pictures say what the geometry says."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from heliogauge.flags import SampleFlag
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.images.thumbnails import make_thumbnail
from heliogauge.reporting.build import build_report
from heliogauge.results.folder import (
    PhotoPose,
    PointTable,
    Summary,
    write_cameras_json,
    write_points_csv,
    write_slope_map,
    write_summary,
    write_table_csv,
)
from heliogauge.results.slope_map_file import read_slope_map
from heliogauge.results.thumbnails import write_thumbnails
from heliogauge.slopes.map import SlopeMap, no_common_modes
from observer.files import (
    read_collector,
    read_overlay,
    read_slices,
    write_angles,
    write_collector,
    write_overlay,
    write_slices,
)
from observer.photo_edges.views import Shot, View
from observer.product.pictures import draw_overlay, empty_slices
from observer.product.slope_map import angle_maps
from observer.report import pictures as report_pictures
from observer.report.lines import absorber_view, listed
from observer.report.maps import mirror_view, panel_lines
from observer.report.results import open_trough
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector, GlassTube, ls2
from tests.without_plots import without_plots

EYE = np.array([0.6, 0.3, 15.0])


def view() -> View:
    """Return a camera above the trough that looks straight down, image x along the trough."""
    rotation = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    camera = Camera(960, 640, 1100.0, 1100.0, 479.5, 319.5)
    return View(camera, RigidTransform(rotation, -rotation @ EYE))


def mirror(collector: Collector, turned_rad: float = 0.0) -> SlopeMap:
    """Return the design's slopes with all normals turned towards +x."""
    x = np.linspace(-collector.aperture_width_m / 2, collector.aperture_width_m / 2, 121)
    y = np.linspace(-collector.length_m / 2, collector.length_m / 2, 61)
    design = np.tile(x / (2 * collector.focal_length_m), (y.size, 1))
    zero = np.zeros_like(design)
    return SlopeMap(
        x,
        y,
        np.tan(np.arctan(design) - turned_rad),
        zero,
        design,
        zero,
        zero + 1e-4,
        zero + 1e-4,
        1.0,
        no_common_modes(),
        np.full(design.shape, np.nan),
        np.zeros(design.shape, np.uint32),
        np.ones(design.shape, bool),
        design="trough",
        frame="trough",
        removed="nothing",
    )


def tube(collector: Collector, x_m: float = 0.0, z_m: float = 0.0) -> AbsorberPath:
    return AbsorberPath.straight(x_m, collector.focal_length_m + z_m, collector.length_m / 2)


def middle_of(beside: np.ndarray, x_m: np.ndarray) -> float:
    """Return the middle of where the tube is seen along the middle row [m]."""
    line = beside[beside.shape[0] // 2]
    crossing = np.flatnonzero(np.diff(np.sign(line)))
    ends = [x_m[k] - line[k] * (x_m[k + 1] - x_m[k]) / (line[k + 1] - line[k]) for k in crossing]
    assert len(ends) == 2
    return 0.5 * (ends[1] + ends[0])


def test_outlines_are_where_the_angles_say() -> None:
    collector, turned = ls2(), 2e-3
    slope_map = mirror(collector, turned)
    shot = Shot(np.full((640, 960), 120, np.uint8), 0, view())
    nodes = draw_overlay(shot, slope_map, tube(collector), tube(collector, 3e-3, -5e-3), collector)
    x, focal = slope_map.x_m, collector.focal_length_m
    # Independent of the ray's code: Phi = 2 theta_ra -+ w on the slice of the camera (spec 1.6 and 1.10).
    z = x**2 / (4 * focal)
    phi = np.arctan2(EYE[0] - x, EYE[2] - z)
    for shift, turn, beside in (
        ((0.0, 0.0), 0.0, nodes.beside_design_rad),
        ((3e-3, -5e-3), turned, nodes.beside_measured_rad),
    ):
        to_x, to_z = shift[0] - x, focal + shift[1] - z
        theta_a = 0.5 * (np.arctan2(-x, focal - z) - np.arctan2(to_x, to_z))
        half = np.arcsin(collector.absorber_diameter_m / 2 / np.hypot(to_x, to_z))
        expected = np.abs(phi - 2 * (turn + theta_a)) - half
        np.testing.assert_allclose(beside[beside.shape[0] // 2], expected, atol=2e-7)
    # Normals turned towards +x show the tube where the camera seems to stand further towards -x.
    assert middle_of(nodes.beside_measured_rad, x) < middle_of(nodes.beside_design_rad, x) - 0.02


def test_nodes_lie_on_the_cut_out_photo(tmp_path) -> None:
    import cv2

    collector, (camera, pose) = ls2(), view()
    slope_map = mirror(collector)
    place = np.array([1.2, -0.9])
    pixel = camera.project(pose.apply(np.array([[*place, place[0] ** 2 / (4 * collector.focal_length_m)]])))[0]
    picture = np.zeros((640, 960), np.uint8)
    cv2.circle(picture, tuple(np.round(pixel * 16).astype(int).tolist()), 16 * 5, 255, -1, cv2.LINE_AA, 4)
    nodes = draw_overlay(Shot(picture, 0, View(camera, pose)), slope_map, tube(collector), tube(collector), collector)
    write_overlay(tmp_path, nodes, "dot.png")
    image, stored, name = read_overlay(tmp_path)
    assert name == "dot.png"
    rows, columns = np.nonzero(image > 128)
    nearest = np.hypot(stored["x_px"] - columns.mean(), stored["y_px"] - rows.mean())
    row, column = np.unravel_index(np.argmin(nearest), nearest.shape)
    # A node is 42 mm across and 0.13 m along.
    x_nodes, y_nodes = (
        np.linspace(-2.5, 2.5, stored["x_px"].shape[1]),
        np.linspace(-3.945, 3.945, stored["x_px"].shape[0]),
    )
    assert abs(x_nodes[column] - place[0]) < 0.03
    assert abs(y_nodes[row] - place[1]) < 0.07


def test_slices_keep_away_from_ends_supports_and_gaps() -> None:
    collector = Collector(
        5.0,
        8.0,
        1.49,
        0.07,
        GlassTube(0.115, 0.109),
        panel_edges_y_m=np.array([-4.0, -1.6, 0.0, 1.6, 4.0]),
        panel_gap_m=0.01,
        support_y_m=np.array([-4.0, 0.0, 4.0]),
    )
    rows = np.linspace(-3.99, 3.99, 400)
    chosen = empty_slices(collector, rows, 7)
    assert chosen.brightness_dn.shape == (5, 7, chosen.x_m.size)
    assert np.isin(chosen.y_m, rows).all()
    assert (np.abs(chosen.y_m) < 3.3).all()
    assert (np.abs(chosen.y_m[:, None] - [-1.6, 1.6]) > 0.06).all()
    assert (np.abs(chosen.y_m) > 0.15).all()


def test_slices_show_what_lies_on_the_mirror(tmp_path) -> None:
    collector = ls2()
    rows = np.linspace(-3.9, 3.9, 391)
    stored = empty_slices(collector, rows, 2)
    camera, pose = view()
    # Brightness rises along the image's rows, which is across the trough; the photo ends before the rim.
    ramp = np.tile(np.arange(640, dtype=np.float32)[:, None], (1, 960))
    stored.take([Shot(ramp, 1, View(camera, pose))], collector)
    assert np.isnan(stored.brightness_dn[:, 0]).all()
    points = np.stack([stored.x_m, np.full_like(stored.x_m, stored.y_m[2]), stored.x_m**2 / (4 * 1.49)], axis=1)
    pixels = camera.project(pose.apply(points))
    np.testing.assert_allclose(stored.brightness_dn[2, 1], pixels[:, 1], atol=0.02)
    write_slices(tmp_path / "s.nc", stored, np.array([[0.0, 0.0, 15.0], EYE]), ["a.png", "b.png"])
    found = read_slices(tmp_path / "s.nc")
    assert found.photos == ["a.png", "b.png"]
    np.testing.assert_allclose(found.eyes_m[1], EYE)
    assert (found.brightness[:, 0] == 0).all()
    assert (found.brightness[:, 1] > 0).all()
    level = found.brightness[2, 1].astype(float)
    np.testing.assert_allclose((level - 1) / 254, pixels[:, 1] / np.nanmax(stored.brightness_dn), atol=0.003)


def test_collector_comes_back(tmp_path) -> None:
    for collector in (ls2(), Collector(2.0, 3.0, 0.8, 0.05, support_y_m=np.array([0.5]))):
        write_collector(tmp_path / "c.json", collector)
        found = read_collector(tmp_path / "c.json")
        assert found.glass == collector.glass
        assert found.describe() == collector.describe()
        np.testing.assert_array_equal(found.panel_edges_x_m, collector.panel_edges_x_m)
        np.testing.assert_array_equal(found.support_y_m, collector.support_y_m)
    (tmp_path / "c.json").write_text('{"glass": null, "width": 3}')
    with pytest.raises(InputError, match="not the design of a trough"):
        read_collector(tmp_path / "c.json")


def test_angles_are_stored_with_their_sign(tmp_path) -> None:
    from heliogauge.results.arrays import read_arrays

    collector = ls2()
    slope_map = mirror(collector, 2e-3)
    write_angles(tmp_path / "a.nc", slope_map, angle_maps(slope_map, tube(collector, 3e-3), collector))
    found, attributes = read_arrays(tmp_path / "a.nc")
    np.testing.assert_allclose(found["theta_r"], 2e-3, atol=1e-9)
    np.testing.assert_allclose(found["theta_ra"], found["theta_r"] + found["theta_a"], atol=1e-9)
    # A tube moved towards +x is seen, at the vertex, as from a normal turned towards -x: x_a = -2 f theta_a.
    middle = found["theta_a"][30, 60]
    assert middle == pytest.approx(-0.5 * np.arctan(3e-3 / collector.focal_length_m), rel=1e-5)
    assert "towards +x" in attributes["sign"]


def result_folder(folder) -> None:
    """Write a folder of results of a perfect mirror with normals turned by 1 mrad; edges carried off their rows."""
    collector, (camera, pose) = ls2(), view()
    slope_map = mirror(collector, 1e-3)
    write_slope_map(folder / "slope_map.nc", {"": slope_map})
    write_angles(folder / "angles.nc", slope_map, angle_maps(slope_map, tube(collector), collector))
    write_collector(folder / "collector.json", collector)
    shot = Shot(np.full((640, 960), 120, np.uint8), 0, view())
    write_overlay(folder, draw_overlay(shot, slope_map, tube(collector), tube(collector), collector), "a")
    stored = empty_slices(collector, slope_map.y_m, 2)
    for k in range(2):
        stored.take([Shot(np.full((640, 960), 90, np.uint8), k, View(camera, pose))], collector)
    write_slices(folder / "absorber_reflection.nc", stored, np.array([EYE, EYE + [0.3, 0, 0]]), ["a", "b"])
    y = stored.y_m
    write_table_csv(
        folder / "absorber.csv",
        {
            "y_m": y,
            "x_a_m": np.where(np.arange(5) == 2, np.nan, 1e-3),
            "z_a_m": np.full(5, 1.491),
            "sigma_x_a_m": np.full(5, 1e-4),
            "sigma_z_a_m": np.full(5, 1e-4),
        },
    )
    targets = PointTable(("1", "2"), np.eye(2, 3), np.ones((2, 3)), np.array([2, 2]), np.zeros(2))
    write_points_csv(folder / "points.csv", targets)
    write_table_csv(
        folder / "reflection_edges.csv",
        {
            "image": ["a", "b"] * 5,
            "x_m": np.linspace(-1, 1, 10),
            "y_m": np.repeat(y, 2) + 0.01,
            "side": [1, -1] * 5,
            "sigma_x_m": np.full(10, 1e-3),
            "residual_rad": np.full(10, 1e-5),
            "fate": ["used"] * 9 + ["faint"],
        },
    )
    write_table_csv(folder / "rejected.csv", {"name": ["c"], "reason": ["too few targets"]})
    offset = 1e-3 * np.arange(-3.0, 4.0)
    write_table_csv(
        folder / "intercept.csv",
        {
            "tracking_offset_rad": offset,
            "intercept_ratio": 0.9 - 1e3 * offset**2,
            "sigma_intercept_ratio": np.full(7, 0.001),
        },
    )
    write_table_csv(
        folder / "panels.csv",
        {
            "panel": ["1"],
            "mean_theta_r_rad": [0.0015],
            "sigma_mean_theta_r_rad": [2e-4],
            "mean_theta_ra_rad": [0.0011],
            "sigma_mean_theta_ra_rad": [1e-4],
            "height_m": [""],
            "sigma_height_m": [""],
        },
    )
    (folder / "network").mkdir()
    poses = {
        name: PhotoPose(
            "camera", RigidTransform(pose.rotation, -pose.rotation @ (EYE + [k * 0.3, 0, 0])), np.eye(6), 0.1
        )
        for k, name in enumerate("ab")
    }
    write_cameras_json(folder / "network" / "cameras.json", {"camera": camera}, poses)
    nearer = {
        name: replace(one, cam_from_world=one.cam_from_world.moved([0, 0, 0, 0, 0, 3e-3]), covariance=np.eye(6) / 4)
        for name, one in poses.items()
    }
    write_cameras_json(folder / "cameras.json", {"camera": camera}, nearer)
    numbers = {
        "sdx_rad": 1e-3,
        "sigma_sdx_rad": 1e-5,
        "sdx_tilt_removed_rad": None,
        "median_sigma_slope_x_rad": 1e-4,
        "measured_share": 0.97,
        "absorber_mean_x_m": 1e-3,
        "absorber_mean_z_offset_m": 1e-3,
        "rms_theta_ra_rad": 1e-3,
        "intercept_ratio": 0.9,
        "odd_count": 3,
    }
    reasons = {"sdx_tilt_removed_rad": "a reason"}
    write_summary(folder / "summary.json", Summary("observer", "<trough>", numbers, not_determined=reasons))


def test_every_section_shows_what_it_should(tmp_path) -> None:
    from observer.report import sections as report

    result_folder(tmp_path)
    results = report.open_trough(tmp_path)
    assert report.maps(results).text.count("<img") == 3
    assert report.spread(results).text.count("<img") == 1
    assert report.absorber(results).text.count("<img") == 2
    assert report.intercept(results).text.count("<img") == 1
    assert report.photos(results).text.count("<img") == 1
    assert report.slices(results).text.count("<img") == 10
    assert report.residuals(results).text.count("<img") == 2
    assert "1.5" in report.panels(results).text
    assert "height" not in report.panels(results).text
    assert "too few targets" in report.refused(results).text
    # sqrt(3 + 2 * 15.04^2) m: a turn of 1 rad swings the camera by its distance.
    assert "21315.48 mm from the targets alone, 10659.85 mm with the reflection, which moved it by 3.00 mm" in (
        report.network(results).text
    )
    first = report.head(results).text
    assert "&lt;trough&gt;" in first
    assert first.count("<img") == 2
    assert "<td>not determined</td>" in first
    assert "a reason" in first
    words = report.overview(results).text
    assert "not determined: a reason" in words
    assert "1.000 \u00b1 0.010 mrad" in words
    assert "odd" in words
    # All edges of the row are drawn although they do not lie on it to the last digit.
    view = report_pictures.slice_view(results, 0)
    assert [one.name for one in view.series] == ["lower edge (1)", "upper edge (1)"]
    # From the top: the camera farthest along x; as wide as the slice and half a cell on each side.
    low, high = view.background.extent[2:]
    eyes = np.sort(results.slices.eyes_m[:, 0])
    assert low < eyes[0] < eyes[-1] < high
    first = results.slices.brightness[0][np.argmax(results.slices.eyes_m[:, 0])]
    assert ((view.background.image[0] != 201) == (first[: view.background.image.shape[1]] > 0)).all()


def test_maps_of_a_single_panel_are_cut_out(tmp_path) -> None:
    from observer.report import sections as report

    result_folder(tmp_path)
    whole = read_slope_map(tmp_path / "slope_map.nc")
    panel = (whole.x_m > 0) & (whole.x_m < 1.34) & np.ones(whole.shape, dtype=bool)
    write_slope_map(tmp_path / "slope_map.nc", {"": replace(whole, aperture=panel)})
    results = report.open_trough(tmp_path)
    assert results.base.slope_map.x_m[0] > 0
    assert results.base.slope_map.x_m[-1] < 1.34
    assert results.base.slope_map.aperture.all()
    assert results.angles["theta_r"].shape == results.base.slope_map.shape
    assert report.maps(results).text.count("<img") == 3


def test_a_table_joins_values_and_their_sigmas() -> None:
    text = listed({"panel": ["1"], "tilt_rad": ["0.0015"], "sigma_tilt_rad": ["0.00002"], "sigma_x_px": ["0.1"]}).text
    assert "1.500 \u00b1 0.020" in text
    assert '<th scope="col" class="number">tilt [mrad]</th>' in text
    assert "sigma x px" in text
    assert text.count("<td") == 3


def test_report_does_without_what_was_not_computed(tmp_path) -> None:
    from observer.report import sections as report

    result_folder(tmp_path)
    for name in ("intercept.csv", "panels.csv", "reflection_overlay.nc"):
        (tmp_path / name).unlink()
    results = report.open_trough(tmp_path)
    assert report.intercept(results).text == ""
    assert report.panels(results).text == ""
    assert "no photo" in report.photos(results).text


def test_the_whole_report_is_made_without_matplotlib(tmp_path) -> None:
    result_folder(tmp_path)
    with without_plots():
        page = build_report(tmp_path).read_text(encoding="utf-8")
    assert page.count("<img") > 5


def test_the_first_screen_says_what_is_missing(tmp_path) -> None:
    from observer.report import sections as report

    result_folder(tmp_path)
    whole = read_slope_map(tmp_path / "slope_map.nc")
    seen = np.broadcast_to(whole.y_m[:, None] < 0, whole.shape)
    blind = replace(whole, flags=np.where(seen, 0, np.uint32(SampleFlag.NOT_SEEN)).astype(np.uint32))
    write_slope_map(tmp_path / "slope_map.nc", {"": blind})
    text = report.head(report.open_trough(tmp_path)).text
    share = 100 * float(np.mean(~seen))
    assert f"{share:.1f} % of the mirror not measured" in text
    assert "1 of 5 stations of the absorber not measured" in text
    assert 'class="verdict incomplete"' in text
    # Nothing measured at all: the figure says why.
    none = replace(whole, flags=np.full(whole.shape, SampleFlag.NOT_SEEN, np.uint32))
    write_slope_map(tmp_path / "slope_map.nc", {"": none})
    results = report.open_trough(tmp_path)
    assert "100.0 % of the mirror not measured" in report.head(results).text
    assert "No point" in report.maps(results).text
    assert report.spread(results).text == ""


def test_the_map_of_the_mirror_has_all_that_is_known(tmp_path) -> None:
    result_folder(tmp_path)
    results = open_trough(tmp_path)
    view = mirror_view(results)
    layers = {layer.key: layer for layer in view.layers}
    assert next(iter(layers)) == "theta_r"
    assert {"theta_ra", "theta_a", "slope_error_x", "sigma_theta_r"} <= layers.keys()
    # theta_r and the slope error have opposite signs.
    assert np.nanmean(layers["theta_r"].values) > 0.9e-3
    assert np.nanmean(layers["slope_error_x"].values) < -0.9e-3
    np.testing.assert_allclose(layers["theta_r"].sigma, results.angles["sigma_theta_r"])


def test_edges_of_panels_and_supports_are_drawn_over_the_map() -> None:
    collector = Collector(
        5.0,
        8.0,
        1.49,
        0.07,
        None,
        panel_edges_x_m=np.array([-2.5, 0.5, 2.5]),
        panel_edges_y_m=np.array([-4.0, 1.6, 4.0]),
        support_y_m=np.array([-4.0, 0.0, 4.0]),
    )
    lines = [line.tolist() for line in panel_lines(collector)]
    assert lines == [[[0.5, -4.0], [0.5, 4.0]], [[-2.5, 1.6], [2.5, 1.6]], [[-2.5, 0.0], [2.5, 0.0]]]


def test_stations_without_a_value_stand_out(tmp_path) -> None:
    result_folder(tmp_path)
    series = {one.name: one for one in absorber_view(open_trough(tmp_path), "xz").series}
    across, along = (next(one for name, one in series.items() if name.startswith(axis)) for axis in ("X_a", "Z_a"))
    np.testing.assert_allclose(across.y[[0, 1, 3, 4]], 1.0)
    np.testing.assert_allclose(along.y, 1.0)
    np.testing.assert_allclose(along.sigma, 0.1)
    np.testing.assert_allclose(series["not measured (no value)"].x, across.x[2])


def test_photos_show_edges_where_the_camera_saw_them_and_why_targets_were_refused(tmp_path) -> None:
    result_folder(tmp_path)
    network = tmp_path / "network"
    write_thumbnails(network, {"a": make_thumbnail(np.full((640, 960), 90, np.uint8))})
    place = [[100.0, 200.0], [300.0, 400.0]]
    columns = {"image": ["a", "b"], "target": ["7", "8"], "x_px": [100.0, 5.0], "y_px": [200.0, 5.0]}
    write_table_csv(network / "residuals.csv", {**columns, "residual_x_px": [0.5, 0.0], "residual_y_px": [-0.25, 0.0]})
    refused = {"name": ["target 9 in a"], "reason": ["outlier <far>"], "is_outlier": [1], "image": ["a"]}
    write_table_csv(network / "rejected.csv", {**refused, "x_px": [300.0], "y_px": [400.0]})
    results = open_trough(tmp_path)
    view = report_pictures.photo_view(results)
    outlined, photo = view.photos
    assert {line.name for line in outlined.lines} == {
        "mirror and absorber as designed",
        "mirror and absorber as measured",
    }
    # Print shows still pictures alone: the outlines, and the edges and targets of one photo.
    assert "targets not used" in view.static.text
    marks = {one.name: one for one in photo.marks}
    assert photo.mark == "photo-a"
    np.testing.assert_allclose(marks["targets"].xy_px, place[:1])
    # Measured minus predicted.
    np.testing.assert_allclose(marks["targets"].residual_px, [[-0.5, 0.25]])
    np.testing.assert_allclose(marks["targets not used"].xy_px, place[1:])
    assert marks["targets not used"].labels == ["target 9 in a: outlier <far>"]
    assert "outlier <far>" not in view.page_html()
    # The edge at x, y on the mirror, by the camera's own equation: it looks straight down from EYE, turned by the pose.
    edges = results.edges
    row = int(np.flatnonzero((edges.photo == 0) & edges.used & (edges.side > 0))[0])
    x, y = edges.x_m[row], edges.y_m[row]
    below = EYE[2] + 3e-3 - x**2 / (4 * results.collector.focal_length_m)
    expected = (479.5 + 1100 * (y - EYE[1]) / below, 319.5 + 1100 * (x - EYE[0]) / below)
    np.testing.assert_allclose(marks["upper edges"].xy_px[0], expected, atol=1e-6)


def test_an_absorber_measured_alone_has_its_report(tmp_path) -> None:
    from observer.report import absorber as report

    result_folder(tmp_path)
    numbers = {"absorber_mean_x_m": 1e-3, "sigma_absorber_mean_x_m": 2e-4, "photos_count": 2}
    write_summary(tmp_path / "summary.json", Summary("observer-absorber", "a tube", numbers))
    results = report.open_absorber(tmp_path)
    first = report.head(results).text
    assert "a tube" in first
    assert "1.00 \u00b1 0.20 mm" in first
    assert "1 of 5 stations of the absorber not measured" in first
    assert first.count("<img") == 1
    assert "5 stations" in report.absorber(results).text
    assert "too few targets" in report.refused(results).text


def test_photos_are_in_the_printed_report() -> None:
    """The cell of photos carries the tag that print keeps, with its heading."""
    cells = json.loads((Path(report_pictures.__file__).parent / "report.ipynb").read_text())["cells"]
    number = next(k for k, cell in enumerate(cells) if "report.photos(" in "".join(cell["source"]))
    assert all("print" in cell["metadata"]["tags"] for cell in cells[number - 1 : number + 1])
