"""Laser scans: slopes, their sigmas and what all beams share, against panels traced by data_synth."""

from pathlib import Path

import numpy as np
import pytest

from data_synth.lasers import LaserScene, write_laser_scan
from deflectometry.laser.keys import load_laser
from deflectometry.laser.pipeline.measure import LaserResult, run
from heliogauge.errors import EstimationError, InputError
from heliogauge.results.tables import read_columns_csv, write_table_csv

COLUMNS = ("direction_x", "direction_y", "direction_z", "spot_x_m", "spot_y_m")
SMALL = LaserScene(columns=25, rows=17)


def measured(folder: Path) -> LaserResult:
    return run(load_laser(folder))


def change(folder: Path, **columns: np.ndarray) -> None:
    _, table = read_columns_csv(folder / "scan.csv", (), COLUMNS)
    write_table_csv(folder / "scan.csv", table | columns)


def column(folder: Path, name: str) -> np.ndarray:
    return np.asarray(read_columns_csv(folder / "scan.csv", (), COLUMNS)[1][name])


@pytest.fixture
def drawn(tmp_path: Path) -> Path:
    write_laser_scan(tmp_path / "scan", SMALL, seed=1)
    return tmp_path / "scan"


def errors_of(result: LaserResult, scene: LaserScene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return slope errors (2, n) [rad], their random sigmas, and the common modes (k, 2, n) at the beams."""
    good = result.flags == 0
    places = result.found.points_m[:, good]
    _, slope_x, slope_y = scene.mirror.surface(*places)
    return (
        result.found.slopes[:, good] - np.stack([slope_x, slope_y]),
        result.found.sigmas[:, good],
        result.found.common.evaluate(*places),
    )


def test_exact_beams_give_exact_slopes(tmp_path: Path) -> None:
    scene = LaserScene(
        columns=25,
        rows=17,
        sigma_spot_m=1e-9,
        sigma_direction_rad=0.0,
        sigma_distance_m=1e-9,
        sigma_offset_m=1e-9,
        sigma_laser_place_m=1e-9,
        sigma_target_scale=1e-9,
        sigma_angle_scale=1e-9,
        sigma_roll_rad=1e-9,
    )
    write_laser_scan(tmp_path / "s", scene)
    error, _, _ = errors_of(measured(tmp_path / "s"), scene)
    # What a polynomial of degree 4 leaves of the height moves the place; the tilt is that of the frame, by definition.
    assert (error - error.mean(axis=1, keepdims=True)).std() < 5e-6


@pytest.mark.slow
def test_sigmas_are_the_scatter(tmp_path: Path) -> None:
    scene, totals, modes = LaserScene(columns=31, rows=21), [], []
    for seed in range(14):
        write_laser_scan(tmp_path / f"{seed}", scene, seed)
        error, sigma, common = errors_of(measured(tmp_path / f"{seed}"), scene)
        # The frame's tilt is free.
        tilt = np.zeros((2, *error.shape))
        tilt[0, 0] = tilt[1, 1] = 1e-2
        together = (np.concatenate([common, tilt]) / sigma).reshape(len(common) + 2, -1)
        white = (error / sigma).ravel()
        normal = np.eye(len(together)) + together @ together.T
        amounts = np.linalg.solve(normal, together @ white)
        totals.append((white @ white - (together @ white) @ amounts) / (white.size - 2))
        # Of each mode, what the data say of it over what they could.
        informed = 1.0 - np.diag(np.linalg.inv(normal))
        modes.append(amounts[:-2] ** 2 / informed[:-2])
    assert np.mean(totals) == pytest.approx(1.0, abs=0.03)
    assert 0.6 < np.mean(modes) < 1.5


@pytest.mark.slow
def test_a_roll_is_told_by_the_curl_it_makes(tmp_path: Path) -> None:
    """A target turned by one sigma makes slopes across that grow along the trough, which no surface has."""
    scene = LaserScene(columns=31, rows=21)
    write_laser_scan(tmp_path / "s", scene, 3)
    straight = measured(tmp_path / "s")
    turned = column(tmp_path / "s", "spot_x_m"), column(tmp_path / "s", "spot_y_m")
    change(tmp_path / "s", spot_x_m=turned[0] - 1e-3 * turned[1], spot_y_m=turned[1] + 1e-3 * turned[0])
    again = measured(tmp_path / "s")
    # One sigma more of roll is taken out again: what is left of it is below a tenth of the noise of a slope.
    off = again.found.slopes - straight.found.slopes
    assert np.sqrt(np.nanmean(off**2)) < 0.1 * np.nanmean(straight.found.sigmas)
    assert "roll (" in again.instrument
    amounts = [float(one.instrument.partition("roll (")[2].split()[0]) for one in (straight, again)]
    assert amounts[1] - amounts[0] == pytest.approx(1.0, abs=0.03)


@pytest.mark.slow
def test_a_roll_beyond_its_sigma_is_named_and_nothing_corrected(tmp_path: Path) -> None:
    scene = LaserScene(columns=31, rows=21)
    write_laser_scan(tmp_path / "s", scene, 3)
    x, y = column(tmp_path / "s", "spot_x_m"), column(tmp_path / "s", "spot_y_m")
    change(tmp_path / "s", spot_x_m=x - 2e-2 * y, spot_y_m=y + 2e-2 * x)
    result = measured(tmp_path / "s")
    assert "scan_contradicts_itself" in {one.code for one in result.doubts}
    assert result.instrument == ""


def test_a_focal_length_that_is_wrong_is_found_with_its_sigma(drawn: Path) -> None:
    text = (drawn / "measurement.toml").read_text()
    (drawn / "measurement.toml").write_text(text.replace("focal_length_m = 1.71", "focal_length_m = 1.74"))
    numbers = measured(drawn).numbers
    off = numbers["focal_length_x_m"] - measured_focal(drawn, text)
    assert abs(off) < 1e-3
    assert numbers["sigma_focal_length_x_m"] < 3e-3


def measured_focal(folder: Path, text: str) -> float:
    (folder / "measurement.toml").write_text(text)
    return float(measured(folder).numbers["focal_length_x_m"])


def test_spots_that_fit_no_neighbour_are_left_out_and_named(drawn: Path) -> None:
    x = column(drawn, "spot_x_m")
    wrong = np.flatnonzero(np.isfinite(x))[[30, 111, 200]]
    x[wrong] += 0.2
    change(drawn, spot_x_m=x)
    result = measured(drawn)
    assert set(np.flatnonzero(result.found.odd)) == set(wrong)
    assert {"spots_odd", "spots_not_seen"} == {one.code for one in result.doubts}
    folder = drawn.parent / "out"
    folder.mkdir()
    result.write_files(folder)
    reasons = read_columns_csv(folder / "beams.csv", ("reason",), ())[0]["reason"]
    assert sum("20 sigma" in one for one in reasons) == 3
    assert sum(one == "no spot was seen" for one in reasons) == np.count_nonzero(~result.scan.seen)


@pytest.mark.parametrize(
    ("name", "made", "message"),
    [
        ("spot_y_m", lambda t: -t["spot_y_m"], "spot_y_m has the other sign"),
        ("spot_y_m", lambda t: 1e3 * t["spot_y_m"], "spots are in metres|in millimetres"),
        ("spot_y_m", lambda t: t["spot_y_m"][::-1], "spot_y_m has the other sign"),
        ("direction_z", lambda t: -t["direction_z"], "run away from the mirror"),
        ("spot_x_m", lambda t: np.full(t["spot_x_m"].size, np.nan), "0 of 425 beams have a spot"),
    ],
)
def test_what_was_exchanged_is_named(drawn: Path, name: str, made: object, message: str) -> None:
    table = {one: column(drawn, one) for one in COLUMNS}
    change(drawn, **{name: made(table)})  # type: ignore[operator]
    with pytest.raises((EstimationError, InputError), match=message):
        measured(drawn)


def test_rows_out_of_order_are_refused(drawn: Path) -> None:
    order = np.random.default_rng(0).permutation(column(drawn, "spot_x_m").size)
    change(drawn, spot_x_m=column(drawn, "spot_x_m")[order], spot_y_m=column(drawn, "spot_y_m")[order])
    with pytest.raises(EstimationError, match="in the order of the scan"):
        measured(drawn)


def test_sigmas_that_are_missing_are_asked_for(drawn: Path) -> None:
    file = drawn / "measurement.toml"
    lines = [one for one in file.read_text().splitlines() if not one.startswith(("sigma_roll", "sigma_distance"))]
    file.write_text("\n".join(lines))
    doubt = {one.code: one for one in measured(drawn).doubts}["laser_sigmas_missing"]
    assert "sigma_distance_mm" in doubt.text
    assert doubt.numbers["inputs_count"] == 2
