"""A drawn trough: slopes and absorber within their predicted sigma of the truth, and what a plan says of it."""

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from data_synth.troughs.dataset import read_trough_truth, write_trough_dataset
from data_synth.troughs.presets import trough_scene
from heliogauge.flags import SampleFlag
from heliogauge.results.slope_map_file import read_slope_map, write_slope_map
from observer import Result, run
from observer.keys import load_observer
from observer.planning import plan as pipeline_plan
from observer.planning.keys import load_observer_plan


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("trough") / "scene"
    write_trough_dataset(folder, trough_scene("small"))
    return folder


@pytest.fixture(scope="module")
def result(folder: Path) -> Result:
    return run(load_observer(folder))


@pytest.fixture(scope="module")
def measured(folder, result, tmp_path_factory):
    results = tmp_path_factory.mktemp("results")
    result.write(results)
    return read_trough_truth(folder), results


@pytest.mark.slow
def test_absorber_diameter_wrong_by_a_hundredth_is_named(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "other")
    toml = tmp_path / "other" / "measurement.toml"
    toml.write_text(toml.read_text().replace("absorber_diameter_mm = 70.0", "absorber_diameter_mm = 70.7"))
    found = run(load_observer(tmp_path / "other"))
    wrong = [one for one in found.doubts if "does not fit" in one.text]
    assert [one.code for one in wrong] == ["absorber_diameter_contradicts_reflection"]
    assert abs(wrong[0].numbers["seen_m"] - 0.070) < 3 * wrong[0].numbers["sigma_seen_m"]


@pytest.mark.slow
def test_slopes_are_within_their_sigma_and_gaps_have_reasons(measured):
    truth, results = measured
    found = read_slope_map(results / "slope_map.nc")
    columns, rows = (
        np.abs(here[:, None] - there).argmin(axis=1) for here, there in ((found.x_m, truth.x_m), (found.y_m, truth.y_m))
    )
    error = found.slope_error_x - truth.slope_error_x[np.ix_(rows, columns)]
    sigma = found.sigma_slope()[0]
    known = found.valid & np.isfinite(error)
    error, sigma = error[known], sigma[known]
    # 24 photos of 0.3 megapixel; the truth has 3 mrad.
    assert (error - error.mean()).std() < 0.4e-3
    assert np.mean(np.abs(error) < 3 * sigma) > 0.97
    assert (found.flags[found.aperture & ~found.valid] != 0).all()
    ends = np.abs(found.y_m) > 1.5
    assert (found.flags[ends][found.aperture[ends] & ~found.valid[ends]] & SampleFlag.BEYOND_TUBE).any()
    summary = json.loads((results / "summary.json").read_text())
    assert summary["kind"] == "observer"


@pytest.mark.slow
def test_errors_are_not_larger_than_sigma_says_by_chi_square(measured):
    truth, results = measured
    found = read_slope_map(results / "slope_map.nc")
    columns, rows = (
        np.abs(here[:, None] - there).argmin(axis=1) for here, there in ((found.x_m, truth.x_m), (found.y_m, truth.y_m))
    )
    error = found.slope_error_x - truth.slope_error_x[np.ix_(rows, columns)]
    # Nodes 0.4 m apart: next to nothing but poses and absorber is in common to them, and that is in the common modes.
    stride_x, stride_y = (round(0.4 / (axis[1] - axis[0])) for axis in (found.x_m, found.y_m))
    chosen = np.zeros(error.shape, dtype=bool)
    chosen[stride_y // 2 :: stride_y, stride_x // 2 :: stride_x] = True
    chosen &= found.valid & np.isfinite(error)
    x, y = np.meshgrid(found.x_m, found.y_m)
    modes = found.common.evaluate(x[chosen], y[chosen])[:, 0]
    covariance = np.diag(found.sigma_random_x[chosen] ** 2) + modes.T @ modes
    count = int(chosen.sum())
    assert count > 40
    # 24 photos cannot exclude slopes along the trough, which this mirror does not have: sigma allows for them.
    assert 0.3 < error[chosen] @ np.linalg.solve(covariance, error[chosen]) / count < chi2.ppf(0.995, count) / count


@pytest.mark.slow
def test_absorber_is_within_its_sigma(measured):
    truth, results = measured
    with (results / "absorber.csv").open() as file:
        stations = [one for one in csv.DictReader(file) if one["x_a_m"] and int(one["flag"]) == 0]
    assert len(stations) >= 6
    for axis, true in (("x", truth.absorber_x_m), ("z", truth.absorber_z_m)):
        for one in stations:
            error = float(one[f"{axis}_a_m"]) - np.interp(float(one["y_m"]), truth.absorber_y_m, true)
            assert abs(error) < 4 * float(one[f"sigma_{axis}_a_m"]) + 1e-4


@pytest.mark.slow
def test_a_plan_states_what_the_measurement_then_states(folder: Path, result: Result, tmp_path: Path) -> None:
    earlier, plan = (tmp_path / name for name in ("earlier", "plan"))
    for one in (earlier, plan):
        one.mkdir()
    result.write(earlier)
    # The plan looks at the true mirror: what was measured of it is smoother.
    slope_map = result.slope_map
    x, y = np.meshgrid(slope_map.x_m, slope_map.y_m)
    true_x = trough_scene("small").world.mirror.deviation(x, y)[1]
    truth = replace(slope_map, slope_x=np.where(slope_map.valid, slope_map.design_slope_x + true_x, np.nan))
    (earlier / "slope_map.nc").unlink()
    write_slope_map(earlier / "slope_map.nc", {"": truth})
    said = (folder / "measurement.toml").read_text()
    (plan / "targets.csv").write_text((folder / "targets.csv").read_text())
    edges, bundle = result.seen.edges, result.network.solved.bundle
    pixel_m = 12.0 / 1030.0
    target_px = float(np.sqrt(np.median(bundle.problem.observations.covariance_px2[:, 0, 0])))
    edge_px = float(np.median(edges.sigma_x_m)) / pixel_m
    # Behind glass the tube's middle is less sure than an edge, and all rows of a photo have a part of it in common.
    bearings = result.seen.bearings
    tube_px = float(np.median(np.hypot(bearings.sigma_rad, bearings.shared_rad))) * 12.0 / pixel_m
    bars = "[[scale_bar]]" + said.partition("[[scale_bar]]")[2].partition("[evaluation]")[0]
    (plan / "measurement.toml").write_text(
        'kind = "observer-plan"\nname = "small"\n'
        + said[said.index("[collector]") : said.index("[images]")]
        + f"[targets]\nsigma_px = {target_px}\n{bars}\n"
        + '[[flight]]\nheight_m = 12.0\nreach_m = 2.9\nphotos = 24\n[mirror]\nlike = "../earlier"\n'
        + f"[noise]\nreflection_px = {edge_px}\nabsorber_px = {tube_px}\n"
    )
    planned = pipeline_plan.run(load_observer_plan(plan))
    sigmas = [one.sigma_slope()[0][one.valid] for one in (planned.simulated.slope_map, slope_map)]
    assert np.median(sigmas[0]) / np.median(sigmas[1]) == pytest.approx(1.0, abs=0.2)
    assert planned.simulated.slope_map.measured_share == pytest.approx(slope_map.measured_share, abs=0.06)
    places = [np.mean([np.trace(part[3:, 3:]) for part in one.covariance.poses]) for one in (planned.bundle, bundle)]
    assert np.sqrt(places[0] / places[1]) == pytest.approx(1.0, abs=0.1)
