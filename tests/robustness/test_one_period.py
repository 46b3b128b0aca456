"""Archives that hold fringes of one period: relative slopes, and all of them with a known point."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest

from data_synth.fringes.dataset import DatasetOptions, write_dataset
from data_synth.fringes.knowledge import Knowledge
from data_synth.fringes.presets import FULL_CAMERA, ensemble_scene, preset_scene
from deflectometry import load_deflectometry, run
from deflectometry.fringes.point_by_pose import point_by_pose
from deflectometry.setup import make_pattern
from heliogauge.errors import EstimationError
from heliogauge.measurement.writer import write_measurement
from heliogauge.slopes.statistics import fit_quadratic


@pytest.mark.slow
def test_one_period_is_as_good_as_all_of_them_with_a_known_point(folder, tmp_path):
    """The same facet with four periods gives the point, and the curvatures to be found."""
    whole = run(load_deflectometry(folder))
    single = tmp_path / "single"
    scene = replace(preset_scene("small"), pattern=make_pattern((15.9,), (15.9,)))
    write_dataset(single, scene, DatasetOptions(0, Knowledge()))
    unplaced = run(load_deflectometry(single))
    assert "known_point_uncertain" in {doubt.code for doubt in unplaced.doubts}
    assert "reflection_contradicts_outline" not in {doubt.code for doubt in unplaced.doubts}

    row, column = 82, 134
    screen = whole.evaluation.screen_map
    display = float(screen.u[row, column]), float(screen.v[row, column])
    file = single / "measurement.toml"
    text = file.read_text()

    def measured(off: float, sigma: float):
        point = f"image_px = [{column}, {row}]\ndisplay = [{display[0] + off}, {display[1] - off}]\n"
        section = f"[pattern.known_point]\n{point}sigma_display = {sigma}\n\n[images]"
        file.write_text(text.replace("[images]", section, 1))
        return run(load_deflectometry(single))

    sure = measured(0.01, 0.01)
    assert {doubt.code for doubt in sure.doubts} >= {"orders_from_known_point"}
    fits = [fit_quadratic(one.assembled_as_measured) for one in (whole, sure)]
    sigma = np.sqrt(sum(np.diag(fit.covariance) for fit in fits))
    off = (fits[1].coefficients - fits[0].coefficients) / sigma
    assert np.abs(off[[0, 1, 4]]).max() < 4
    # A tenth of the display is one and a half periods: an error of all slopes, which sigma holds.
    relative = measured(0.1, 0.1)
    assert "known_point_uncertain" in {doubt.code for doubt in relative.doubts}
    assert "reflection_contradicts_outline" not in {doubt.code for doubt in relative.doubts}
    fit = fit_quadratic(relative.assembled_as_measured)
    off = (fit.coefficients - fits[0].coefficients) / np.sqrt(np.diag(fit.covariance))
    assert 0.01 < np.abs(off[[0, 1]]).max() < 3
    assert fit.sigma_curvature_x_per_m > 20 * fits[1].sigma_curvature_x_per_m
    # Without a point its place follows from the mirror's pose: the outline's, to less than 3 mrad.
    fit = fit_quadratic(unplaced.assembled_as_measured)
    off = (fit.coefficients - fits[0].coefficients) / np.sqrt(np.diag(fit.covariance))
    assert np.abs(off[[0, 1, 4]]).max() < 3
    assert fits[1].sigma_curvature_x_per_m < fit.sigma_curvature_x_per_m < relative.numbers["sigma_curvature_x_per_m"]


@pytest.mark.slow
def test_slopes_without_a_point_hold_where_it_is_a_period_off(folder, tmp_path):
    """The pose is stated with a turn of one period of the display: the next order is taken, and sigma holds that."""
    pose = run(load_deflectometry(folder)).evaluation.solution.cam_from_mirror
    scene, found = preset_scene("small"), {}
    for name, periods in (("whole", (0.9, 15.9)), ("single", (15.9,))):
        pattern = make_pattern(periods, periods)
        write_dataset(tmp_path / name, replace(scene, pattern=pattern), DatasetOptions(0, Knowledge()))
        content = tomllib.loads((tmp_path / name / "measurement.toml").read_text())
        content["mirror"].pop("distance")
        turn = content["screen"]["width_m"] / 15.9 / (2 * pose.translation_m[2])
        turned = pose.moved(np.array([0.0, turn, 0.0, 0.0, 0.0, 0.0]))
        content["mirror"]["pose"] = {
            "rotation_vector_rad": turned.rotation_vector_rad,
            "translation_m": pose.translation_m,
            "sigma_rotation_mrad": [1.0, 1e3 * turn, 1.0],
            "sigma_translation_mm": 1.0,
        }
        write_measurement(tmp_path / name, content)
        found[name] = run(load_deflectometry(tmp_path / name))
    display = [np.nanmean(one.evaluation.screen_map.u) for one in found.values()]
    assert abs(display[1] - display[0]) == pytest.approx(1 / 15.9, rel=0.05)
    assert "known_point_uncertain" in {doubt.code for doubt in found["single"].doubts}
    fits = [fit_quadratic(one.assembled_as_measured) for one in found.values()]
    off = (fits[1].coefficients - fits[0].coefficients) / np.sqrt(np.diag(fits[1].covariance))
    assert 0.01 < np.abs(off[[0, 1, 4]]).max() < 3


@pytest.mark.slow
def test_a_pose_that_determines_less_than_a_tenth_of_the_display_is_refused(folder):
    found = run(load_deflectometry(folder))
    located, setup = found.evaluation.located, found.setup

    def with_sigma(sigma_rad: float):
        covariance = np.diag([sigma_rad**2] * 3 + [1e-8] * 3)
        return replace(located, pose=replace(located.pose, covariance=covariance))

    whole = found.evaluation.screen_map
    point = point_by_pose(setup, located)
    column, row = point.image_px.astype(int)
    seen = np.array([whole.u[row, column], whole.v[row, column]])
    assert (np.abs(point.display - seen) < 3 * point.sigma_display).all()
    # 3 mrad of mounting give 0.016; a turn by 10 mrad moves what is seen by some 0.06 to 0.09 of the display.
    reach = point_by_pose(setup, with_sigma(1e-2)).sigma_display.max() / np.hypot(1e-2, 3e-3)
    accepted, refused = (np.sqrt((share / reach) ** 2 - 3e-3**2) for share in (0.09, 0.11))
    assert point_by_pose(setup, with_sigma(accepted)).sigma_display.max() == pytest.approx(0.09, rel=0.02)
    with pytest.raises(EstimationError, match="known_point"):
        point_by_pose(setup, with_sigma(refused))


def test_several_facets_need_more_than_a_pose(tmp_path):
    """No pixels lead from one facet to the next: refused, and with a point on one facet only that is measured."""
    scene = ensemble_scene(columns=2, rows=1, camera=FULL_CAMERA.scaled(0.25))
    write_dataset(tmp_path, replace(scene, pattern=make_pattern((15.9,), (15.9,))), DatasetOptions(0, Knowledge()))
    with pytest.raises(EstimationError, match=r"2 facets.*known_point"):
        run(load_deflectometry(tmp_path))
    file = tmp_path / "measurement.toml"
    section = "[pattern.known_point]\nimage_px = [170, 154]\ndisplay = [0.5, 0.5]\nsigma_display = 0.1\n\n[images]"
    file.write_text(file.read_text().replace("[images]", section, 1))
    dark = [doubt.text for doubt in run(load_deflectometry(tmp_path)).doubts if doubt.code == "facet_not_measured"]
    assert len(dark) == 1
    assert "known_point" in dark[0]
    assert "misses the screen" not in dark[0]
