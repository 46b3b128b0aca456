"""Drawn troughs through the command line: chi-square of the slopes within its 99 % band."""

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2
from typer.testing import CliRunner

from data_synth.troughs.dataset import read_trough_truth
from heliogauge.results.slope_map_file import read_slope_map
from heliogauge.running.cli import app

#: Next to nothing but poses and absorber is in common to nodes so far apart, and that is in the common modes [m].
APART_M = 0.4


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_chi_square_of_a_drawn_trough_is_within_its_band(tmp_path: Path, seed: int) -> None:
    scene, results = tmp_path / "scene", tmp_path / "results"
    for command in (
        ["observer", "synth", str(scene), "--preset", "small", "--seed", str(seed), "--quiet"],
        ["observer", "measure", str(scene), "-o", str(results), "--no-report", "--quiet"],
    ):
        done = CliRunner().invoke(app, command)
        assert done.exit_code == 0, done.output
    truth, found = read_trough_truth(scene), read_slope_map(results / "slope_map.nc")
    columns, rows = (
        np.abs(here[:, None] - there).argmin(axis=1) for here, there in ((found.x_m, truth.x_m), (found.y_m, truth.y_m))
    )
    error = found.slope_error_x - truth.slope_error_x[np.ix_(rows, columns)]
    stride_x, stride_y = (round(APART_M / (axis[1] - axis[0])) for axis in (found.x_m, found.y_m))
    chosen = np.zeros(error.shape, dtype=bool)
    chosen[stride_y // 2 :: stride_y, stride_x // 2 :: stride_x] = True
    chosen &= found.valid & np.isfinite(error)
    x, y = np.meshgrid(found.x_m, found.y_m)
    modes = found.common.evaluate(x[chosen], y[chosen])[:, 0]
    covariance = np.diag(found.sigma_random_x[chosen] ** 2) + modes.T @ modes
    count = int(chosen.sum())
    low, high = chi2.ppf([0.005, 0.995], count) / count
    assert count > 40
    assert low < error[chosen] @ np.linalg.solve(covariance, error[chosen]) / count < high
    assert np.abs(error[found.valid] - np.nanmean(error[found.valid])).max() < 2e-3
