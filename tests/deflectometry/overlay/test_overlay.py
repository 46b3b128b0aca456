"""Theoretical overlay: turns with sigma from drawn photos, and photos that do not fit what is stated."""

import csv
import json
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.stats import chi2

from data_synth.reflections import ReflectionScene, write_overlay
from deflectometry.overlay.keys import load_overlay, load_overlay_plan
from deflectometry.overlay.pipeline.measure import run
from deflectometry.overlay.pipeline.result import OverlayResult
from deflectometry.overlay.planning.plan import PlannedOverlay
from heliogauge.doubts import Severity
from heliogauge.errors import EstimationError
from heliogauge.measurement.writer import write_measurement

SMALL = ReflectionScene(columns=2, rows=2, focal_px=3500.0, width_px=300, height_px=300)
EXACT = replace(SMALL, wave_sigma_rad=0.0, noise_dn=0.7, sigma_point_px=1e-3, sigma_place_m=1e-6, tilt_sigma_rad=1e-3)


def measured(folder: Path, scene: ReflectionScene, seed: int) -> tuple[OverlayResult, np.ndarray]:
    """Return a result and its errors."""
    write_overlay(folder, scene, seed)
    result = run(load_overlay(folder))
    return result, result.turns.turns_rad - np.array(json.loads((folder / "truth.json").read_text())["turn_rad"])


@pytest.mark.slow
def test_turns_of_exact_inputs_are_exact(tmp_path: Path) -> None:
    # What is left are the rays of a pixel, of which an edge falls between two: less with more of them; then the noise.
    coarse, fine = (
        np.sqrt(np.mean(measured(tmp_path / str(count), replace(EXACT, subpixels=count), 0)[1] ** 2))
        for count in (3, 6)
    )
    assert fine < 1e-6
    assert fine < 0.4 * coarse


@pytest.mark.slow
def test_sigmas_are_the_scatter_and_as_planned(tmp_path: Path) -> None:
    total, rms, freedom = 0.0, [], 0
    every, waves, stated = [], [], []
    for seed in range(10):
        result, errors = measured(tmp_path / str(seed), replace(SMALL, subpixels=3), seed)
        flat = errors.ravel()
        every.append(flat)
        waves.append(result.turns.wave_rad)
        stated.append(np.diag(result.turns.covariance))
        total += float(flat @ np.linalg.solve(result.turns.covariance, flat))
        freedom += flat.size
        rms.append(np.mean(errors**2))
        moves = [one.moves for one in result.cantings()]
        assert all(np.isfinite(one.move_m).all() and (one.sigma_m > 0).all() for one in moves)
    low, high = chi2.ppf([0.005, 0.995], freedom) / freedom
    assert low < total / freedom < high
    assert np.sqrt(np.mean(rms)) < 1e-4
    # A plan that knows how wavy such facets are, and not how these are turned.
    content = tomllib.loads((tmp_path / "0" / "measurement.toml").read_text())
    content["plan"] = {
        "contrast_dn": SMALL.bright_dn - SMALL.dark_dn,
        "difference_of_photos_mrad": 1e3 * np.sqrt(np.mean(np.square(waves))),
    }
    (tmp_path / "plan").mkdir()
    write_measurement(tmp_path / "plan", content)
    plan = PlannedOverlay(load_overlay_plan(tmp_path / "plan"))
    promised = plan.turns(plan.scene()).covariance
    inverse = np.linalg.inv(promised)
    assert low < sum(float(one @ inverse @ one) for one in every) / freedom < high
    assert np.sqrt(np.diag(promised)) == pytest.approx(np.sqrt(np.mean(stated, axis=0)), rel=0.1)


@pytest.mark.slow
def test_a_fit_that_went_astray_is_not_used(tmp_path: Path) -> None:
    """Its source was darker than what is beside it, and the facet 13 mrad off, nine of its sigmas."""
    result, errors = measured(tmp_path / "drawn", SMALL, 105)
    flat = errors.ravel()
    assert float(flat @ np.linalg.solve(result.turns.covariance, flat)) < chi2.ppf(0.999, flat.size)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("overlay") / "drawn"
    write_overlay(folder, replace(SMALL, subpixels=2), 1)
    return folder


def changed(drawn: Path, folder: Path, change: Callable[[dict[str, Any]], None]) -> Path:
    """Copy a measurement with other content of measurement.toml."""
    folder.mkdir()
    for file in drawn.iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    content = tomllib.loads((drawn / "measurement.toml").read_text())
    change(content)
    write_measurement(folder, content)
    return folder


def doubts(folder: Path) -> set[str]:
    return {one.code for one in run(load_overlay(folder)).doubts}


def test_sigmas_of_one_photo_are_seriously_doubted(drawn: Path, tmp_path: Path) -> None:
    """Nothing checks them: waves of the facets are in the errors, not in the sigmas, and rounding makes up none."""

    def one_photo(content: dict[str, Any]) -> None:
        content["photo"] = content["photo"][:1]

    folder = changed(drawn, tmp_path / "one", one_photo)
    lines = (folder / "points.csv").read_text().splitlines()
    (folder / "points.csv").write_text("\n".join(one for one in lines if "photo_2" not in one and "photo_3" not in one))
    result = run(load_overlay(folder))
    (doubt,) = [one for one in result.doubts if one.code == "waves_unknown"]
    assert doubt.severity is Severity.SERIOUS
    assert result.turns.wave_rad == 0.0
    truth = np.array(json.loads((drawn / "truth.json").read_text())["turn_rad"])
    errors = result.turns.canting()[0] - (truth - truth.mean(axis=0))
    assert np.sqrt(np.mean(errors**2)) > 1.5 * doubt.numbers["sigma_random_rad"]


@pytest.mark.slow
def test_a_source_of_another_size_is_named(drawn: Path, tmp_path: Path) -> None:
    """A height of 0.8 m for 0.6 m passed without a word, and turns by single edges were wrong."""
    ratios = {"width_m": 1.25, "height_m": 0.75}

    def other_size(content: dict[str, Any]) -> None:
        for key, ratio in ratios.items():
            content["source"][key] /= ratio

    result = run(load_overlay(changed(drawn, tmp_path / "other", other_size)))
    found = [one for one in result.doubts if one.code == "source_of_another_size"]
    assert len(found) == 2
    for doubt, (key, ratio) in zip(found, ratios.items(), strict=True):
        assert key in doubt.text
        assert doubt.numbers["size_ratio"] == pytest.approx(ratio, rel=0.02)
    assert "source_of_another_size" not in doubts(drawn)


def test_dark_photos_show_no_source(drawn: Path, tmp_path: Path) -> None:
    folder = changed(drawn, tmp_path / "dark", lambda content: None)
    for file in folder.glob("photo_*.png"):
        cv2.imwrite(str(file), np.full((300, 300), 12, np.uint8))
    with pytest.raises(EstimationError, match="no facet shows the source"):
        run(load_overlay(folder))


def test_mirrored_points_are_refused(drawn: Path, tmp_path: Path) -> None:
    folder = changed(drawn, tmp_path / "mirrored", lambda content: None)
    rows = list(csv.DictReader((folder / "points.csv").read_text().splitlines()))
    for row in rows:
        row["x_px"] = str(299 - float(row["x_px"]))
    with (folder / "points.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)
    with pytest.raises(EstimationError, match=r"photo photo_1\.png.*(mirrored|points of this photo)"):
        run(load_overlay(folder))


@pytest.mark.slow
def test_mirrored_photo_is_left_out_and_named(drawn: Path, tmp_path: Path) -> None:
    folder = changed(drawn, tmp_path / "mirrored", lambda content: None)
    photo = str(folder / "photo_2.png")
    cv2.imwrite(photo, cv2.imread(photo, cv2.IMREAD_GRAYSCALE)[:, ::-1])
    found = [one for one in run(load_overlay(folder)).doubts if one.code == "light_left_out"]
    assert len(found) == 1
    assert found[0].text.startswith("photo_2.png")


@pytest.mark.slow
def test_a_facet_partly_in_shade_is_named_and_spoils_no_other(drawn: Path, tmp_path: Path) -> None:
    """It was used, and the contradiction of its photos enlarged the sigmas of all facets fivefold."""
    folder = changed(drawn, tmp_path / "shade", lambda content: None)
    photo = str(folder / "photo_2.png")
    image = cv2.imread(photo, cv2.IMREAD_GRAYSCALE)
    assert image is not None
    facet = image[150:260, 40:148]
    rows = np.flatnonzero((facet > 90).any(axis=1))
    facet[rows[rows.size // 2] :] = np.minimum(facet[rows[rows.size // 2] :], 12)
    cv2.imwrite(photo, image)
    result = run(load_overlay(folder))
    (doubt,) = [one for one in result.doubts if one.code == "light_left_out"]
    assert doubt.text.startswith("photo_2.png: the light in facet 11 is no image")
    assert result.not_used == ["photo_2.png: light that is no image of the source, or a part in shade", "", "", ""]
    assert result.turns.wave_rad < SMALL.wave_sigma_rad
    errors = result.turns.turns_rad - np.array(json.loads((drawn / "truth.json").read_text())["turn_rad"])
    flat = errors.ravel()
    assert float(flat @ np.linalg.solve(result.turns.covariance, flat)) < chi2.ppf(0.999, flat.size)


@pytest.mark.slow
def test_exchanged_facets_are_named(drawn: Path, tmp_path: Path) -> None:
    def exchange(content: dict[str, Any]) -> None:
        first, last = content["mirror"]["facet"][0], content["mirror"]["facet"][3]
        key = "rotation_vector_rad"
        first[key], last[key] = last[key], first[key]

    folder = changed(drawn, tmp_path / "exchanged", exchange)
    found = [one for one in run(load_overlay(folder)).doubts if one.code == "facets_exchanged"]
    assert found
    assert "11 and 22" in found[0].text


@pytest.mark.slow
def test_source_elsewhere_turns_all_facets_alike(tmp_path: Path) -> None:
    drawn = tmp_path / "drawn"
    write_overlay(drawn, replace(SMALL, subpixels=2, tilt_sigma_rad=0.2e-3), 1)
    assert "all_facets_alike" not in doubts(drawn)

    def shift(content: dict[str, Any]) -> None:
        content["source"]["center_m"] = [0.6, 0.0, 40.0]

    folder = changed(drawn, tmp_path / "elsewhere", shift)
    result = run(load_overlay(folder))
    (found,) = [one for one in result.doubts if one.code == "all_facets_alike"]
    assert found.numbers["source_shift_m"] == pytest.approx(0.6, abs=0.05)


@pytest.mark.slow
def test_camera_that_stood_elsewhere_is_named(drawn: Path, tmp_path: Path) -> None:
    def shift(content: dict[str, Any]) -> None:
        content["photo"][1]["place_m"][0] += 0.1

    assert "place_contradicted" in doubts(changed(drawn, tmp_path / "elsewhere", shift))


@pytest.mark.slow
def test_without_a_survey_the_heliostat_as_a_whole_is_less_sure(drawn: Path, tmp_path: Path) -> None:
    def forget(content: dict[str, Any]) -> None:
        for photo in content["photo"]:
            del photo["place_m"], photo["sigma_place_mm"]

    folder = changed(drawn, tmp_path / "unsurveyed", forget)
    result, truth = run(load_overlay(folder)), json.loads((drawn / "truth.json").read_text())["turn_rad"]
    errors = (result.turns.turns_rad - np.array(truth)).ravel()
    sigma = np.sqrt(np.diag(result.turns.covariance))
    assert sigma.min() > 2e-4
    assert errors @ np.linalg.solve(result.turns.covariance, errors) < chi2.ppf(0.999, errors.size)
    _, covariance = result.turns.canting()
    assert np.sqrt(np.diag(covariance)).max() < 1e-4
