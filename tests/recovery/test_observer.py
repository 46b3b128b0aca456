"""A drawn trough through the command line: slopes and absorber within their predicted sigma of the truth."""

import csv
import json

import numpy as np
import pytest
from scipy.stats import chi2
from typer.testing import CliRunner

from data_synth.troughs.dataset import read_trough_truth
from heliogauge.flags import SampleFlag
from heliogauge.results.slope_map_file import read_slope_map
from heliogauge.running.cli import app


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    folder = tmp_path_factory.mktemp("trough")
    scene, results = folder / "scene", folder / "results"
    runner = CliRunner()
    drawn = runner.invoke(app, ["observer", "synth", str(scene), "--preset", "small", "--quiet"])
    assert drawn.exit_code == 0, drawn.output
    done = runner.invoke(app, ["observer", "measure", str(scene), "-o", str(results), "--no-report", "--quiet"])
    assert done.exit_code == 0, done.output
    return read_trough_truth(scene), results


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
