"""A grid coarser than the pixels: its maps are means over cells, and what is judged does not depend on it."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from data_synth.fringes.dataset import DatasetOptions, write_dataset
from data_synth.fringes.knowledge import Knowledge
from data_synth.fringes.presets import preset_scene
from deflectometry import Options, load_deflectometry, run

COARSE_MM = 50.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Photos of a sound facet."""
    place = tmp_path_factory.mktemp("coarse") / "m"
    write_dataset(place, preset_scene("small"), DatasetOptions(1, Knowledge()))
    return place


@pytest.mark.slow
def test_findings_are_those_of_the_pixels_whatever_the_grid(folder: Path) -> None:
    fine, coarse = (run(load_deflectometry(folder), Options(grid_step_mm=step)) for step in (None, COARSE_MM))
    assert [one.code for one in coarse.doubts] == [one.code for one in fine.doubts]
    for name in ("curl_rms_per_m", "curl_expected_rms_per_m"):
        assert coarse.numbers[name] == fine.numbers[name]
    assert [one.sigma_images for one in coarse.inputs] == [one.sigma_images for one in fine.inputs]
    # Means over a cell of some hundred pixels are as much surer; what is common to all of them stays.
    x, y = (one.assembled.sigma_random_x for one in (coarse, fine))
    assert np.nanmedian(x) < 0.5 * np.nanmedian(y)
    common = [one.numbers["sigma_curvature_x_per_m"] for one in (coarse, fine)]
    assert common[0] == pytest.approx(common[1], rel=0.1)


@pytest.mark.slow
def test_a_wrong_setup_is_found_on_a_coarse_grid_and_its_sigmas_contain_it(folder: Path, tmp_path: Path) -> None:
    spoilt = tmp_path / "m"
    shutil.copytree(folder, spoilt)
    text = (folder / "measurement.toml").read_text()
    line = next(one for one in text.splitlines() if one.startswith("height_m = "))
    (spoilt / "measurement.toml").write_text(text.replace(line, f"height_m = {float(line.split('=')[1]) + 0.1!r}"))
    sound, wrong = (run(load_deflectometry(one), Options(grid_step_mm=COARSE_MM)) for one in (folder, spoilt))
    assert "setup_contradicts_slopes" in {one.code for one in wrong.doubts}
    off = abs(wrong.numbers["curvature_y_per_m"] - sound.numbers["curvature_y_per_m"])
    assert off < 2 * wrong.numbers["sigma_curvature_y_per_m"]
    assert off > 3 * sound.numbers["sigma_curvature_y_per_m"]
