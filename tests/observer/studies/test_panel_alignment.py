"""TOP alignment: checked figures of the effective edges, the place of the image by reflection, moves of mounts."""

import re
from dataclasses import replace

import h5py
import numpy as np
import pytest

from data_synth.troughs.presets import ls2_panelled
from heliogauge.errors import InputError
from heliogauge.results.tables import read_table_csv
from heliogauge.slopes.map import SlopeMap, no_common_modes
from observer.files import OVERLAY, read_overlay
from observer.pipeline.headline import panel_columns
from observer.product.panel_alignment import image_edges, mount_moves, panel_tilts, target_plane_edges
from observer.product.slope_map import angle_maps
from observer.report import alignment as report
from observer.studies.align import Result, run
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import ls3
from tests.observer.report.test_report import result_folder


def test_effective_edges_of_the_checked_case():
    """f = 1.71 m, r = 0.035 m, B = 2 m; the published formula gives 0.07338 on both sides."""
    lower, upper = target_plane_edges(np.array([2.0]), 1.71, 0.035)
    assert lower[0] == pytest.approx(-0.073378, abs=1e-6)
    assert upper[0] == pytest.approx(0.069504, abs=1e-6)


@pytest.mark.parametrize("place", [-2.5, -0.4, 0.0, 1.1, 2.8])
def test_effective_edges_touch_the_tube(place):
    focal, radius = 1.71, 0.035
    point = np.array([place, place**2 / (4 * focal)])
    for edge in target_plane_edges(np.array(place), focal, radius):
        along = np.array([float(edge), focal]) - point
        to_focus = np.array([0.0, focal]) - point
        distance = abs(along[0] * to_focus[1] - along[1] * to_focus[0]) / np.linalg.norm(along)
        assert distance == pytest.approx(radius, abs=1e-12)


@pytest.mark.parametrize("eye", [(-1.6, 0.0, 40.0), (0.9, 0.0, 25.0), (2.1, 0.0, 60.0)])
def test_image_lies_where_reflected_lines_pass_the_effective_edges(eye):
    """Reflection as spec'd for TOP, by the mirror image of A about the normal BG, against the observation equation."""
    design = replace(ls3(), glass=None)
    focal, radius = design.focal_length_m, design.absorber_diameter_m / 2
    edges = image_edges(np.array(eye), np.array([0.0]), design, AbsorberPath.straight(0.0, focal, 6.0))[0, 0]
    assert np.isfinite(edges).all()
    camera = np.array([eye[0], eye[2]])
    passing = []
    for place in edges:
        point = np.array([place, place**2 / (4 * focal)])
        # G on the axis with FG = FB = R
        normal = np.array([0.0, focal + np.hypot(place, focal - point[1])]) - point
        back = camera - point
        image = 2 * (back @ normal) / (normal @ normal) * normal - back
        passing.append(place + (focal - point[1]) * image[0] / image[1])
    expected = [target_plane_edges(np.array(place), focal, radius) for place in edges]
    misses = [min(abs(x - float(edge)) for edge in pair) for x, pair in zip(passing, expected, strict=True)]
    assert max(misses) < 2e-5
    assert np.sign(passing[0]) == -np.sign(passing[1])


def tilted(collector, angles_rad):
    """A slope map whose panels are turned as a whole."""
    x_axis, y_axis = np.linspace(-2.49, 2.49, 250), np.linspace(-3.9, 3.9, 80)
    x, y = np.meshgrid(x_axis, y_axis)
    panel = collector.panel_index(x, y)
    angle = np.where(panel >= 0, angles_rad[panel], np.nan)
    design = x / (2 * collector.focal_length_m)
    zero, sigma = np.zeros(x.shape), np.full(x.shape, 1e-4)
    slope_map = SlopeMap(
        x_m=x_axis,
        y_m=y_axis,
        slope_x=np.tan(np.arctan(design) - angle),
        slope_y=np.where(panel >= 0, 0.0, np.nan),
        design_slope_x=design,
        design_slope_y=zero,
        sigma_random_x=sigma,
        sigma_random_y=sigma,
        noise_correlation=1.0,
        common=no_common_modes(),
        height_m=np.full(x.shape, np.nan),
        flags=np.zeros(x.shape, dtype=np.uint32),
        aperture=panel >= 0,
        design="d",
        frame="f",
        removed="nothing",
    )
    return slope_map, angle


def test_moves_bring_each_panel_to_zero():
    """A panel turned by theta is a plane whose normal height falls by theta per metre of arc: the moves add it back."""
    collector = ls2_panelled()
    angles = np.random.default_rng(2).normal(0, 3e-3, 20)
    slope_map, angle = tilted(collector, angles)
    tilts = panel_tilts(angle, slope_map, collector)
    assert tilts.tilt_rad == pytest.approx(angles, abs=1e-9)
    assert (tilts.sigma_rad < 1e-5).all()
    edges = collector.panel_edges_x_m
    mounts = np.array([[x, tilts.centre_y_m[0]] for x in (edges[0] + 0.2, edges[1] - 0.2)])
    panel, move, sigma = mount_moves(tilts, mounts, collector)
    assert panel.tolist() == [0, 0]
    slope = np.linspace(*mounts[:, 0], 2001) / (2 * collector.focal_length_m)
    arc = np.trapezoid(np.hypot(1, slope), slope) * 2 * collector.focal_length_m
    assert (move[1] - move[0]) / arc == pytest.approx(angles[0], rel=1e-5)
    assert (sigma > 0).all()


def test_normal_turned_to_plus_x_is_raised_there():
    """By 2 mrad at 0.5 m from the middle: 1 mm towards the absorber."""
    collector = replace(ls2_panelled(), panel_edges_x_m=np.array([-2.5, -0.6, 0.6, 2.5]))
    slope_map, angle = tilted(collector, np.full(15, 2e-3))
    _, move, _ = mount_moves(panel_tilts(angle, slope_map, collector), np.array([[0.5, 0.0], [-0.5, 0.0]]), collector)
    assert move == pytest.approx([1e-3, -1e-3], rel=0.01)


def test_panel_of_which_little_is_measured_gets_no_prescription():
    collector = ls2_panelled()
    slope_map, angle = tilted(collector, np.zeros(20))
    angle = angle.copy()
    angle[:, slope_map.x_m > 2.0] = np.nan
    angle[slope_map.y_m > 0.0] = np.nan
    tilts = panel_tilts(angle, slope_map, collector)
    assert np.isnan(tilts.tilt_rad[-1])
    assert tilts.measured_share[-1] == 0
    assert np.isfinite(tilts.tilt_rad[0])


def test_mount_in_millimetres_is_refused():
    collector = ls2_panelled()
    tilts = panel_tilts(*tilted(collector, np.zeros(20))[::-1], collector)
    with pytest.raises(InputError, match=r"beside the mirror .* in metres"):
        mount_moves(tilts, np.array([[1200.0, 300.0]]), collector)


def test_panels_have_the_numbers_of_the_measurements_report(tmp_path):
    """The panel whose mounts are to be moved is the one that the measurement's panels.csv and report call so."""
    collector = ls2_panelled()
    slope_map, angle = tilted(collector, np.where(np.arange(20) == 6, 4e-3, 0.0))
    tilts = panel_tilts(angle, slope_map, collector)
    absorber = AbsorberPath.straight(0.0, collector.focal_length_m, collector.length_m)
    measured = panel_columns(slope_map, angle_maps(slope_map, absorber, collector), collector)
    worst = int(measured["panel"][np.argmax(np.abs(measured["mean_theta_r_rad"]))])
    mounts = np.array([[tilts.centre_x_m[6], tilts.centre_y_m[6]]])
    result = Result(collector, tilts, tilts, mounts, absorber, {}, name="panel alignment")
    result.write(tmp_path)
    assert f"panel {worst}:" in result.headline()
    assert read_table_csv(tmp_path / "panels.csv", ("panel",))["panel"] == [str(number) for number in measured["panel"]]
    assert read_table_csv(tmp_path / "mounts.csv", ("panel",))["panel"] == [str(worst)]


def test_theoretical_image_lies_where_the_design_shows_the_absorber(tmp_path):
    """In the cut-out photo the lines of TOP are where lines of sight at the design's mirror touch the tube."""
    result_folder(tmp_path)
    result = run(tmp_path)
    assert result.picture is not None
    _, nodes, _ = read_overlay(tmp_path)
    places = np.stack([nodes["x_px"], nodes["y_px"]], axis=-1).reshape(-1, 2)
    # Dashed lines of the picture, back from its places to pixels of the photo.
    left, top, right, bottom = result.picture.box
    (x_left, x_right), (y_bottom, y_top) = result.picture.x_limits, result.picture.y_limits
    drawn = []
    for path in re.findall(r'<path d="([^"]+)" [^>]*stroke-dasharray="6 4"', "".join(result.picture.parts)):
        x, y = np.array(re.findall(r"[ML]([-\d.]+),([-\d.]+)", path), dtype=float).T
        across = x_left + (x - left) / (right - left) * (x_right - x_left)
        drawn.append(np.stack([across, y_top + (y - top) / (bottom - top) * (y_bottom - y_top)], axis=1))
    assert len(drawn) == 2
    beside = nodes["beside_design"].ravel()
    for line in drawn:
        nearest = [int(np.argmin(np.hypot(*(places - point).T))) for point in line[2:-2]]
        # A node is 42 mm from the next, 3 mrad; the tube of the list is 1 mm beside the design's.
        assert np.abs(beside[nearest]).max() < 3e-3
    assert np.nanmax(np.abs(beside)) > 0.1
    out = tmp_path / "out"
    out.mkdir()
    result.write(out)
    found = report.open_alignment(out)
    assert report.overlay(found).text.count("<img") == 1
    assert report.moves(found).text.count("<img") == 1
    assert report.head(found).text.count("<img") == 1
    assert "panel alignment" in report.head(found).text
    view = report.head(found).picture
    row, column = (int(np.argmin(np.abs(nodes - place))) for nodes, place in ((view.y_m, 0.5), (view.x_m, 0.5)))
    tilt = read_table_csv(out / "panels.csv")["theta_ra_rad"]
    assert view.layers[0].values[row, column] == pytest.approx(float(tilt[0]))
    (out / "overlay.svg").unlink()
    assert "no photo" in report.overlay(found).text


@pytest.mark.parametrize("damage", [lambda field: field[:-1], lambda field: field.ravel()])
def test_a_damaged_overlay_is_named(tmp_path, damage):
    result_folder(tmp_path)
    with h5py.File(tmp_path / OVERLAY, "r+") as file:
        field = file["x_px"][...]
        del file["x_px"]
        file["x_px"] = damage(field)
    with pytest.raises(InputError, match="four fields on one grid"):
        run(tmp_path)
