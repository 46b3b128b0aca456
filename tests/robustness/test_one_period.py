"""Archives that hold fringes of one period: refused with what is missing, measured with a known point."""

from dataclasses import replace

import numpy as np
import pytest

from data_synth.fringes.dataset import DatasetOptions, write_dataset
from data_synth.fringes.knowledge import Knowledge
from data_synth.fringes.presets import preset_scene
from deflectometry import load_deflectometry, run
from deflectometry.setup import make_pattern
from heliogauge.errors import EstimationError
from heliogauge.slopes.statistics import fit_quadratic


@pytest.mark.slow
def test_one_period_is_as_good_as_all_of_them_with_a_known_point(folder, tmp_path):
    """The same facet with four periods gives the point, and the curvatures to be found."""
    whole = run(load_deflectometry(folder))
    single = tmp_path / "single"
    scene = replace(preset_scene("small"), pattern=make_pattern((15.9,), (15.9,)))
    write_dataset(single, scene, DatasetOptions(0, Knowledge()))
    with pytest.raises(EstimationError, match="known_point"):
        run(load_deflectometry(single))

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
