"""Folders of synthetic troughs: presets, errors as stated, files, truth."""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from data_synth.optics.surface_errors import HeightGrid, Polynomial, Ripple, SurfaceErrors
from data_synth.troughs.dataset import (
    TroughOptions,
    observer_content,
    read_slope_errors,
    read_trough_truth,
    truth_arrays,
    write_trough_dataset,
)
from data_synth.troughs.mirror import MirrorTable, PanelErrors, Rays, TroughMirror
from data_synth.troughs.photo import Photographer
from data_synth.troughs.presets import TROUGH_PRESETS, TroughChoice, equal_arcs, ls2_panelled, trough_scene
from data_synth.troughs.receiver import Receiver, TubeAxis
from heliogauge.errors import InputError
from heliogauge.flags import SampleFlag
from heliogauge.images.photos import read_image
from heliogauge.results.json_file import read_json
from heliogauge.results.slope_map_file import write_slope_map
from heliogauge.results.tables import read_table_csv
from heliogauge.running.cli import app
from heliogauge.slopes.map import SlopeMap, no_common_modes
from observer.trough import ls2


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("trough") / "set"
    arguments = ["observer", "synth", str(out), "--photos", "2", "--seed", "3", "--scale", "0.5", "-q"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    return out


def test_a_folder_holds_what_a_surveyor_has_and_the_truth(folder: Path) -> None:
    assert sorted(file.name for file in folder.iterdir()) == [
        "image_points_true.csv",
        "measurement.toml",
        "photo_001.png",
        "photo_002.png",
        "targets.csv",
        "truth.json",
        "truth.npz",
    ]
    content = tomllib.loads((folder / "measurement.toml").read_text(encoding="utf-8"))
    assert content["kind"] == "observer"
    assert content["collector"]["focal_length_m"] == 1.49
    assert content["collector"]["glass_index"] == 1.47
    assert content["images"] == {"photos": "photo_*.png"}
    assert content["targets"] == {
        "dictionary": "aicon-12",
        "diameter_mm": 90.0,
        "polarity": "black-on-white",
        "file": "targets.csv",
    }
    assert content["camera"]["focal_px"] == 515.0
    assert read_image(folder / "photo_001.png").shape == (320, 240)
    listed = read_table_csv(folder / "targets.csv", ("target", "x_m", "sigma_x_mm"))
    truth = read_trough_truth(folder)
    true = truth.parameters["points_m"]
    differences = np.array(
        [
            float(listed[f"{axis}_m"][k]) - true[name][number]
            for k, name in enumerate(listed["target"])
            for number, axis in enumerate("xyz")
        ]
    )
    # 36 differences of 1 mm each: chi-square within its 99.9 % band.
    assert 12 < np.sum((differences / 1e-3) ** 2) < 72
    bars = content["scale_bar"]
    for bar in bars:
        length = np.linalg.norm(np.subtract(true[bar["a"]], true[bar["b"]]))
        assert abs(bar["length_m"] - length) < 4 * 3e-3
    assert len(read_table_csv(folder / "image_points_true.csv")["target"]) == 24


def test_maps_and_absorber_of_the_truth_are_those_of_the_scene(folder: Path) -> None:
    truth = read_trough_truth(folder)
    scene = trough_scene("small", TroughChoice(3, 2))
    np.testing.assert_array_equal(truth.theta_r_rad, truth_arrays(scene)["theta_r_rad"])
    assert np.sqrt(np.nanmean(truth.theta_r_rad**2)) == pytest.approx(3e-3, rel=0.01)
    design = truth.x_m / (2 * 1.49)
    # theta_r is the angle by which the normal turns towards +x: minus the change of the slope's angle.
    expected = np.arctan(design) - np.arctan(design + truth.slope_error_x)
    np.testing.assert_allclose(truth.theta_r_rad, expected, atol=1e-15)
    np.testing.assert_array_equal(truth.absorber_z_m, 1.49)
    pose = truth.parameters["photos"]["photo_001.png"]
    assert pose["position_m"][0] < -2.5


@pytest.mark.slow
def test_the_same_seed_gives_the_same_files(folder: Path, tmp_path: Path) -> None:
    scene = trough_scene("small", TroughChoice(3, 2)).scaled(0.5)
    write_trough_dataset(tmp_path / "again", scene, TroughOptions(3))
    for file in folder.iterdir():
        if file.suffix != ".npz":
            assert (tmp_path / "again" / file.name).read_bytes() == file.read_bytes(), file.name
    other = trough_scene("small", TroughChoice(4, 2)).scaled(0.5)
    assert not np.array_equal(other.views[0].position_m, scene.views[0].position_m)


@pytest.mark.slow
def test_a_folder_of_jpeg_with_a_rolling_shutter_and_slopes_of_a_file(tmp_path: Path) -> None:
    x, y = np.linspace(-2.5, 2.5, 30), np.linspace(-1.6, 1.6, 20)
    zero, design = np.zeros((20, 30)), np.broadcast_to(x / 2.98, (20, 30))
    errors = 1e-3 * np.sin(y)[:, None] * x, np.full((20, 30), 2e-3)
    measured = SlopeMap(
        x,
        y,
        design + errors[0],
        errors[1],
        design,
        zero,
        zero,
        zero,
        1.0,
        no_common_modes(),
        zero,
        zero.astype(np.uint32),
        zero == 0,
        "trough",
        "trough",
        "nothing",
    )
    write_slope_map(tmp_path / "slopes.nc", {"mirror": measured})
    out = tmp_path / "set"
    arguments = ["observer", "synth", str(out), "--photos", "2", "--scale", "0.3", "-q", "--jpeg-quality", "95"]
    arguments += ["--rolling-shutter-ms", "20", "--slopes", str(tmp_path / "slopes.nc"), "--noise-dn", "0"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    content = tomllib.loads((out / "measurement.toml").read_text(encoding="utf-8"))
    assert content["images"] == {"photos": "photo_*.jpg"}
    photo = read_json(out / "truth.json")["photos"]["photo_002.jpg"]
    assert photo["rolling_shutter"]["readout_s"] == 0.02
    assert np.linalg.norm(photo["rolling_shutter"]["velocity_m_s"]) == pytest.approx(2.0)
    truth = read_trough_truth(out)
    np.testing.assert_allclose(truth.slope_error_x, 1e-3 * np.sin(truth.y_m)[:, None] * truth.x_m, atol=3e-6)
    np.testing.assert_allclose(truth.slope_error_y, 2e-3, atol=1e-12)


@pytest.mark.parametrize("preset", TROUGH_PRESETS)
def test_presets_are_what_they_are_called(preset: str) -> None:
    scene = trough_scene(preset, TroughChoice(1, 4))
    truth = truth_arrays(scene)
    rms = [float(np.sqrt(np.nanmean(truth[name] ** 2))) for name in ("theta_r_rad", "slope_error_y")]
    longitudinal = 1.8e-3 if preset in ("ls2-long", "ls2-two-passes") else 0.0
    # Panels of the fixture's module are turned by slopes of 4 mrad, 20 draws: within 3 sigma, in a mirror of 1.5 mrad.
    wanted, within = {"displaced": (0.0, 0.02), "fixture": (3.5e-3, 0.45)}.get(preset, (3e-3, 0.02))
    assert rms == pytest.approx([wanted, longitudinal], rel=within, abs=1e-12)
    assert len(scene.targets) == {"flight": 24, "far": 0}.get(preset, 12)
    content = observer_content(scene, ".png")
    assert ("orientation_deg" in content["collector"]) == (preset != "turning")
    x, z = scene.world.receiver.position_m(np.array([0.0, 1.97]))
    expected = {"displaced": [3e-3, 3e-3, 1.485, 1.485], "sag": [2e-3, 2.79e-3, 1.491, 1.4844]}
    expected["far"] = [2e-3, 2e-3, 1.493, 1.493]
    expected["absorber"] = [3e-3, 3e-3, 1.485, 1.481]
    np.testing.assert_allclose([*x, *z], expected.get(preset, [0, 0, 1.49, 1.49]), atol=2e-5)


def test_gaps_of_a_measured_map_get_the_nearest_slope(tmp_path: Path) -> None:
    x, y = np.linspace(-1.0, 1.0, 21), np.linspace(-0.5, 0.5, 11)
    zero, error = np.zeros((11, 21)), np.where(x < 0, 1e-3, 3e-3) * np.ones((11, 1))
    error[:, 8:13] = np.nan
    gaps = np.where(np.isnan(error), np.uint32(SampleFlag.NOT_COVERED), np.uint32(0))
    slopes = SlopeMap(
        x,
        y,
        error,
        zero * np.nan,
        zero,
        zero,
        zero + 1e-4,
        zero + 1e-4,
        1.0,
        no_common_modes(),
        zero * np.nan,
        gaps,
        np.ones(zero.shape, bool),
        design="trough",
        frame="trough",
        removed="nothing",
    )
    write_slope_map(tmp_path / "s.nc", {"": slopes})
    found = read_slope_errors(tmp_path / "s.nc")
    np.testing.assert_allclose(found.slope_x[:, :10], 1e-3, rtol=1e-6)
    np.testing.assert_allclose(found.slope_x[:, 11:], 3e-3, rtol=1e-6)
    assert not found.slope_y.any()


@pytest.mark.slow
def test_targets_on_the_ground_are_seen_and_of_unknown_place(tmp_path: Path) -> None:
    scene = trough_scene("ls2", TroughChoice(0, 3, n_ground_targets=6))
    photographer = Photographer(scene.scaled(0.25))
    assert len(photographer.points(scene.scaled(0.25).views[1]).names) == 18
    # Beside the rims, on the ground under the vertex line.
    places = np.array([sheet.world_from_sheet.translation_m for sheet in scene.sheets[12:]])
    np.testing.assert_allclose(places[:, 2], -3.2, atol=0.005)
    np.testing.assert_allclose(np.abs(places[:, 0]), 3.5, atol=0.005)
    assert sorted({round(float(y), 1) for y in places[:, 1]}) == [-4.4, 0.0, 4.4]
    small = trough_scene("small", TroughChoice(0, 2, n_ground_targets=2)).scaled(0.2)
    write_trough_dataset(tmp_path / "set", small)
    listed = read_table_csv(tmp_path / "set" / "targets.csv")
    assert listed["sigma_x_mm"] == ["1"] * 12 + [""] * 2
    assert listed["on_collector"] == ["1"] * 12 + ["0"] * 2


def test_corners_of_square_markers_are_listed() -> None:
    scene = trough_scene("small", TroughChoice(0, 2, "DICT_4X4_100"))
    listed = {target.name: target.stated_m for target in scene.targets}
    assert sorted(listed) == sorted(scene.points_m())
    assert len(listed) == 48
    differences = np.array([listed[name] - place for name, place in scene.points_m().items()])
    assert 0.5e-3 < differences.std() < 1.5e-3
    sides = [np.linalg.norm(listed[f"{k}.0"] - listed[f"{k}.1"]) for k in range(12)]
    np.testing.assert_allclose(sides, 0.27, atol=1e-12)
    targets = observer_content(scene, ".png")["targets"]
    assert targets == {"dictionary": "DICT_4X4_100", "file": "targets.csv"}


def test_dots_without_a_code_are_told_by_their_places(tmp_path: Path) -> None:
    scene = trough_scene("small", TroughChoice(0, 2, "circles")).scaled(0.2)
    write_trough_dataset(tmp_path / "set", scene)
    targets = tomllib.loads((tmp_path / "set" / "measurement.toml").read_text(encoding="utf-8"))["targets"]
    assert targets == {
        "uncoded_file": "uncoded.csv",
        "diameter_mm": 90.0,
        "polarity": "black-on-white",
        "file": "targets.csv",
    }
    rough, listed = (read_table_csv(tmp_path / "set" / name) for name in ("uncoded.csv", "targets.csv"))
    assert rough["id"] == listed["target"] == [f"dot{k}" for k in range(1, 13)]
    # Seen from the other end they must not look the same.
    y = np.sort([float(value) for value in rough["y_m"]])
    assert np.abs(y + y[::-1]).max() > 0.05


def test_photos_of_the_absorber_have_a_pattern_of_their_own() -> None:
    scene = trough_scene("small", TroughChoice(0, 2))
    views = (*scene.views, replace(scene.views[0], name="absorber_001", purpose="absorber"))
    content = observer_content(replace(scene, views=views), ".jpg")
    assert content["images"] == {"photos": "photo_*.jpg"}
    assert content["absorber"] == {"photos": "absorber_*.jpg"}


def test_gravity_pulls_the_sag_down_in_every_orientation() -> None:
    # At +90 deg the trough's +x axis points down.
    zenith, horizon = (trough_scene("sag", TroughChoice(0, 2, orientation_deg=turn)).world for turn in (0.0, 90.0))
    middle = np.array([1.9725])
    moved = np.subtract(horizon.receiver.position_m(middle), zenith.receiver.position_m(middle)).ravel()
    np.testing.assert_allclose(moved, [6e-3, 6e-3], atol=2e-5)
    np.testing.assert_allclose(horizon.surroundings.up, [-1, 0, 0], atol=1e-12)


def test_panels_tilt_and_bend_about_their_own_middle() -> None:
    design = ls2_panelled()
    focal = np.full(20, 1.49)
    focal[6] = 1.52
    tilt_x, tilt_y = np.zeros(20), np.zeros(20)
    tilt_x[6], tilt_y[9] = 2e-3, -1e-3
    mirror = TroughMirror(design, panels=PanelErrors(tilt_x, tilt_y, focal), is_shaped=True)
    middle_x = (design.panel_edges_x_m[2:4].mean(), design.panel_edges_x_m[1:3].mean())
    middle_y = design.panel_edges_y_m[1:3].mean(), design.panel_edges_y_m[2:4].mean()
    x = np.array([middle_x[0], middle_x[0] + 0.3, middle_x[1], middle_x[1], 0.0])
    y = np.array([middle_y[0], middle_y[0], middle_y[1], middle_y[1] + 0.4, 0.3])
    height, slope_x, slope_y = mirror.deviation(x, y)
    bend = 1 / 3.04 - 1 / 2.98
    np.testing.assert_allclose(slope_x[:4], [2e-3, 2e-3 + 0.3 * bend, 0, 0], atol=1e-15)
    np.testing.assert_allclose(slope_y[:4], [0, 0, -1e-3, -1e-3], atol=1e-15)
    np.testing.assert_allclose(height[:4], [0, 0.3 * 2e-3 + 0.045 * bend, 0, -4e-4], atol=1e-15)
    assert np.isnan(height[4])


def test_rays_meet_each_panel_with_its_own_errors() -> None:
    design = ls2_panelled()
    rng = np.random.default_rng(0)
    mirror = TroughMirror(design, panels=PanelErrors(*rng.normal(0, 2e-3, (2, 20)), rng.uniform(1.48, 1.5, 20)))
    table = MirrorTable(mirror, np.float64)
    x, y = rng.uniform(-2.5, 2.5, 400), rng.uniform(-3.9, 3.9, 400)
    # Aslant through these points of the design.
    across, down = np.full(400, 0.1), np.full(400, -1.0)
    rays = Rays(x - 15 * across, y, x * x / 5.96 - 15 * down, across, 0 * x, down)
    panel = table.panel(x, y)
    np.testing.assert_array_equal(panel, design.panel_index(x, y))
    on = np.flatnonzero(panel >= 0)
    assert np.unique(panel[on]).size == 20
    assert on.size < 400
    _, _, _, slope_x, slope_y = table.surface(rays.take(on), table.meet(rays)[on], panel[on])
    _, error_x, error_y = mirror.deviation(x[on], y[on])
    np.testing.assert_allclose(slope_x, x[on] / 2.98 + error_x, atol=1e-13)
    np.testing.assert_allclose(slope_y, error_y, atol=1e-13)


def test_the_shaped_mirror_is_met_where_it_is() -> None:
    design = replace(ls2(), glass=None)
    errors = SurfaceErrors((Polynomial([(0, 0, 4e-3), (1, 0, 1e-3), (2, 1, 5e-4)]), Ripple(2e-3, 0.9, 0.4)))
    mirror = TroughMirror(design, errors=errors, is_shaped=True)
    table = MirrorTable(mirror, np.float64)
    x, y = np.linspace(-2.4, 2.4, 40), np.linspace(-3.0, 3.0, 40)
    start = np.stack([x * 0.2, y * 0.1, np.full_like(x, 15.0)])
    through = np.stack([x, y, x * x / (4 * 1.49)])
    rays = Rays(*start, *(through - start))
    length = table.meet(rays)
    met = table.surface(rays, length, table.panel(*through[:2]))
    height, slope_x, slope_y = mirror.deviation(met[0], met[1])
    # The table's straight lines and 1/32 of its step.
    np.testing.assert_allclose(met[2], met[0] ** 2 / 5.96 + height, atol=5e-7)
    np.testing.assert_allclose(met[3], met[0] / 2.98 + slope_x, atol=8e-6)
    np.testing.assert_allclose(met[4], slope_y, atol=8e-6)


def test_sag_is_a_clamped_beam_between_supports() -> None:
    axis = TubeAxis.straight(1e-3, 0.0, 1e-4).sagging(np.array([-4.0, 0.0, 4.0]), 0.0, -8e-3)
    x, z = axis.offsets_m(np.array([-4.0, -2.0, 0.0, 1.0, 2.0, 4.0]))
    np.testing.assert_allclose(x, [6e-4, 8e-4, 1e-3, 1.1e-3, 1.2e-3, 1.4e-3], atol=1e-9)
    np.testing.assert_allclose(z, [0, -8e-3, 0, -8e-3 * 0.5625, -8e-3, 0], atol=2e-7)


def test_panels_of_equal_arc() -> None:
    edges = equal_arcs(ls2(), 4)
    # Arc length of z = x^2 / 4 f from 0: f (u sqrt(1 + u^2) + asinh u), u = x / 2 f.
    u = edges / 2.98
    arc = 1.49 * (u * np.sqrt(1 + u * u) + np.arcsinh(u))
    np.testing.assert_allclose(np.diff(arc), 2 * arc[-1] / 4, atol=1e-6)


def test_impossible_scenes_are_refused(tmp_path: Path) -> None:
    design = ls2_panelled()
    with pytest.raises(InputError, match="preset 'nothing': one of small"):
        trough_scene("nothing")
    with pytest.raises(InputError, match="turns from photo to photo"):
        trough_scene("turning", TroughChoice(0, 2, orientation_deg=30.0))
    with pytest.raises(InputError, match="3 errors for 20 panels"):
        TroughMirror(design, panels=PanelErrors(np.zeros(3), np.zeros(3), np.ones(3)))
    with pytest.raises(InputError, match="have no height"):
        TroughMirror(design, transverse=SurfaceErrors((Ripple(1e-3, 1.0),)), is_shaped=True)
    with pytest.raises(InputError, match="touches the glass"):
        Receiver(design, TubeAxis.straight(0.015, 0.015), TubeAxis.straight())
    with pytest.raises(InputError, match="are the units right"):
        TubeAxis.straight(3.0)
    with pytest.raises(InputError, match="jpeg_quality"):
        TroughOptions(jpeg_quality=0)
    with pytest.raises(InputError, match="there is no such file"):
        (tmp_path / "truth.json").write_text("{}", encoding="utf-8")
        read_trough_truth(tmp_path)
    heights = HeightGrid(np.linspace(-3, 3, 5), np.linspace(-4, 4, 5), np.zeros((5, 5)))
    assert TroughMirror(design, errors=SurfaceErrors((heights,)), is_shaped=True).is_shaped


def test_a_shaped_preset_has_the_heights_that_its_slopes_say_and_no_panel_stands_off() -> None:
    scene = trough_scene("ls2-long", TroughChoice(3, 2, is_shaped=True))
    mirror, design = scene.world.mirror, scene.collector
    assert mirror.is_shaped
    x, y = np.meshgrid(np.linspace(-2.45, 2.45, 120), np.linspace(-3.9, 3.9, 150))
    height, slope_x, slope_y = mirror.deviation(x, y)
    step = 1e-6
    by_x = (mirror.deviation(x + step, y)[0] - mirror.deviation(x - step, y)[0]) / (2 * step)
    by_y = (mirror.deviation(x, y + step)[0] - mirror.deviation(x, y - step)[0]) / (2 * step)
    known = np.isfinite(by_x + by_y)
    np.testing.assert_allclose(by_x[known], slope_x[known], atol=1e-9)
    np.testing.assert_allclose(by_y[known], slope_y[known], atol=1e-9)
    assert np.nanstd(height) > 3e-4
    # As asked of the preset: 3 mrad across, 1.8 mrad along.
    np.testing.assert_allclose(np.sqrt(np.nanmean(mirror.theta_r_rad(x, y) ** 2)), 3e-3, rtol=0.03)
    np.testing.assert_allclose(np.sqrt(np.nanmean(slope_y**2)), 1.8e-3, rtol=0.03)
    panel = design.panel_index(x, y)
    means = [np.nanmean(height[panel == k]) for k in range(mirror.n_panels)]
    assert np.abs(means).max() < 1e-4
    assert "evaluation" not in observer_content(scene, ".png")


def test_panels_mounted_too_high_or_low() -> None:
    usual = trough_scene("small", TroughChoice(3, 2, is_shaped=True)).world.mirror
    other = trough_scene("small", TroughChoice(3, 2, is_shaped=True, panel_height_m=2e-3)).world.mirror
    assert other.collector.panel_height_sigma_m == 2e-3
    assert usual.panels is not None
    assert other.panels is not None
    lift = other.panels.heights - usual.panels.heights
    assert 0.5e-3 < lift.std() < 4e-3
    x, y = np.array([-1.9, 0.7]), np.array([-0.8, 0.8])
    panel = other.collector.panel_index(x, y)
    np.testing.assert_allclose(other.deviation(x, y)[0] - usual.deviation(x, y)[0], lift[panel], atol=1e-9)
    with pytest.raises(InputError, match="panel heights: only a mirror that is shaped"):
        trough_scene("small", TroughChoice(3, 2, panel_height_m=2e-3))
