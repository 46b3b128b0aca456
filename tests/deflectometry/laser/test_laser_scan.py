"""Laser scans: slopes, their sigmas and what all beams share, against panels traced by data_synth."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data_synth.lasers import LaserScene, line_scene, write_laser_scan, write_line_sweep
from deflectometry.laser.keys import load_laser
from deflectometry.laser.line_sweep import Sweep, cross_lines
from deflectometry.laser.pipeline.measure import LaserResult, run
from deflectometry.laser.pipeline.scan_file import read_lines, read_scan
from deflectometry.pipeline.design_check import doubts_of_amount
from heliogauge.doubts import Severity
from heliogauge.errors import EstimationError, InputError
from heliogauge.results.tables import read_columns_csv, read_table_csv, write_table_csv
from tests.deflectometry.command import refusal

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
@pytest.mark.parametrize(("write", "scene"), [(write_laser_scan, LaserScene()), (write_line_sweep, line_scene())])
def test_sigmas_are_the_scatter(
    tmp_path: Path, write: Callable[[Path, LaserScene, int], None], scene: LaserScene
) -> None:
    scene, totals, modes = replace(scene, columns=31, rows=21), [], []
    for seed in range(14):
        write(tmp_path / f"{seed}", scene, seed)
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


def test_a_wrong_design_is_a_doubt_as_for_every_instrument(drawn: Path) -> None:
    """Of 1.80 m for 1.71 slopes are 10 mrad off; 136 mrad are a mirror turned by 90 degrees."""
    text = (drawn / "measurement.toml").read_text()
    (drawn / "measurement.toml").write_text(text.replace("focal_length_m = 1.71", "focal_length_m = 1.80"))
    doubt = {one.code: one for one in measured(drawn).doubts}["slopes_too_far_off_design"]
    assert doubt.severity is Severity.SERIOUS
    (drawn / "measurement.toml").write_text(text)
    table = {one: column(drawn, one) for one in COLUMNS}
    for kind in ("direction_{}", "spot_{}_m"):
        table[kind.format("x")], table[kind.format("y")] = -table[kind.format("y")], table[kind.format("x")]
    change(drawn, **table)
    doubt = {one.code: one for one in measured(drawn).doubts}["scan_contradicts_design"]
    assert doubt.severity is Severity.SERIOUS
    assert "x across" in doubt.text


@pytest.mark.parametrize("factor", [100.0, 1e-3])
def test_a_sigma_of_spots_that_is_not_theirs_is_a_doubt(drawn: Path, factor: float) -> None:
    file = drawn / "measurement.toml"
    file.write_text(file.read_text().replace("sigma_spot_mm = 0.5", f"sigma_spot_mm = {0.5 * factor:g}"))
    doubt = {one.code: one for one in measured(drawn).doubts}["sigma_of_spots_differs"]
    assert (doubt.numbers["scatter_ratio"] < 0.02) == (factor > 1)


def test_a_distance_in_millimetres_is_named(drawn: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = drawn / "measurement.toml"
    file.write_text(file.read_text().replace("distance_m = 3.42", "distance_m = 3420"))
    assert "distance_m is in millimetres" in refusal(drawn, capsys)


def test_another_shape_of_design_is_no_exchange_in_the_table(drawn: Path) -> None:
    """Spots in millimetres would leave 12 mrad of 102: no mirror has these."""
    file = drawn / "measurement.toml"
    file.write_text(file.read_text().replace('"trough"', '"paraboloid"'))
    assert "scan_contradicts_design" in {one.code for one in measured(drawn).doubts}


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


def test_rows_out_of_order_are_refused(drawn: Path, capsys: pytest.CaptureFixture[str]) -> None:
    order = np.random.default_rng(0).permutation(column(drawn, "spot_x_m").size)
    change(drawn, spot_x_m=column(drawn, "spot_x_m")[order], spot_y_m=column(drawn, "spot_y_m")[order])
    assert "are the rows of the table in the order of the scan?" in refusal(drawn, capsys)


def test_lines_cross_where_both_sheets_met() -> None:
    """A plane mirror square to z at distance d sends the beam (x, y, -d) back to (2 x, 2 y)."""
    places = np.linspace(-1, 1, 5)
    along = np.linspace(-1.3, 1.3, 14)
    across_normals, along_normals = ([[3, 0, x] for x in places], [[0, 3, y] for y in places])
    sweeps = [
        Sweep(
            np.array(normals) / np.linalg.norm(normals, axis=1)[:, None],
            np.repeat(np.arange(5), 14),
            np.array([(2 * x, 2 * y) if turn else (2 * y, 2 * x) for x in places for y in along]),
        )
        for normals, turn in ((across_normals, True), (along_normals, False))
    ]
    scan = cross_lines(*sweeps, 1e-4).scan
    met = -3 * scan.directions[:2] / scan.directions[2]
    assert scan.spots_m[:2] == pytest.approx(2 * met, abs=1e-12)
    # Turned by 1 mrad, each sheet moves its beams by 1 mrad across itself.
    for step, normals in zip(scan.direction_steps, (sweeps[0].normals, sweeps[1].normals), strict=True):
        own = np.repeat(normals, 5, axis=0) if normals is sweeps[0].normals else np.tile(normals, (5, 1))
        assert np.einsum("ni,in->n", own, step) == pytest.approx(1.0)
    # Halfway between two points their noise is down by a root of two.
    assert np.abs(scan.spot_steps).max(axis=(0, 1)).min() == pytest.approx(np.sqrt(0.5), abs=0.03)


def test_a_gap_in_a_line_leaves_its_other_crossings_alone() -> None:
    """Crossings beside points that were not seen are as sure as any: the line's direction there has no gap in it."""
    places, along = np.linspace(-1, 1, 5), np.linspace(-1.3, 1.3, 105)
    across = np.array([[3, 0, x] for x in places]) / np.hypot(3, places)[:, None]
    lines = np.array([(2 * x, 2 * y) for x in places for y in along])
    crossing = Sweep(across[:, [1, 0, 2]], np.repeat(np.arange(5), 105), lines[:, ::-1])
    whole = cross_lines(Sweep(across, crossing.line, lines), crossing, 1e-4).scan
    # Beams meet the lines at along = 0, which is point 52, among others.
    lines = np.where(
        (np.arange(105 * 5) % 105 >= 46)[:, None] & (np.arange(105 * 5) % 105 <= 50)[:, None], np.nan, lines
    )
    broken = cross_lines(Sweep(across, crossing.line, lines), crossing, 1e-4).scan
    assert broken.seen.all()
    assert broken.spot_steps == pytest.approx(whole.spot_steps, abs=1e-9)


def test_an_error_of_a_sheet_is_shared_by_its_line(tmp_path: Path) -> None:
    scene = replace(line_scene(), columns=25, rows=17, sigma_spot_m=1e-6, sigma_direction_rad=1e-4)
    write_line_sweep(tmp_path / "s", scene)
    result = measured(tmp_path / "s")
    # A tenth beyond the panel nothing comes back: 23 lines of 25 and 15 of 17 do, or nearly.
    assert result.slope_map.noise_correlation == pytest.approx(0.5 * (23 + 15), rel=0.1)


def test_lines_that_fold_are_named(tmp_path: Path) -> None:
    """From twice the focal length a trough sends all beams across back to the laser: lines lie on each other."""
    write_line_sweep(tmp_path / "s", replace(line_scene(), columns=25, rows=17, distance_of_curvature=1.0))
    doubt = {one.code: one for one in measured(tmp_path / "s").doubts}["lines_cross_twice"]
    assert doubt.numbers["twice_count"] > 0.1 * doubt.numbers["pairs_count"]


@pytest.mark.parametrize("length_m", [0.0, 2e-4, 4e-4])
def test_a_line_no_longer_than_its_noise_crosses_nothing(length_m: float) -> None:
    """Without noise even a line of 0.2 mm crosses once; of 0.1 mm of noise in each point its direction is nothing."""
    normals = np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 1.0, 0.0]])
    along = np.linspace(-0.5, 0.5, 12)
    long = Sweep(normals[0], np.zeros(12, dtype=np.intp), np.stack([np.zeros(12), along], axis=1))
    short = Sweep(normals[1], np.zeros(12, dtype=np.intp), np.stack([1.2 * length_m * along, np.zeros(12)], axis=1))
    found = cross_lines(long, short, 1e-4)
    assert found.scan.seen.tolist() == [length_m > 3e-4]
    assert found.unclear.tolist() == [length_m < 3e-4]


def test_rows_of_lines_may_stand_between_each_other_and_repeat(tmp_path: Path) -> None:
    write_line_sweep(tmp_path, replace(line_scene(), columns=25, rows=17))
    lines = read_lines(tmp_path / "lines.csv", 1e-3)
    table = read_table_csv(tmp_path / "lines.csv", ())
    seen: dict[tuple[str, str], int] = {}
    places = []
    for key in zip(table["sweep"], table["line"], strict=True):
        seen[key] = seen.get(key, -1) + 1
        places.append(seen[key])
    order = np.repeat(np.argsort(places, kind="stable"), 2)
    write_table_csv(tmp_path / "lines.csv", {name: [values[n] for n in order] for name, values in table.items()})
    mixed = read_lines(tmp_path / "lines.csv", 1e-3)
    assert mixed.scan.spots_m == pytest.approx(lines.scan.spots_m, nan_ok=True, abs=1e-12)
    assert mixed.scan.repeated > 0.4 * order.size
    assert lines.scan.repeated == 0


def test_rows_that_repeat_count_once(drawn: Path) -> None:
    table = {one: column(drawn, one) for one in COLUMNS}
    scan = read_scan(drawn / "scan.csv")
    change(drawn, **{name: np.tile(values, 2) for name, values in table.items()})
    again = read_scan(drawn / "scan.csv")
    assert np.array_equal(again.spots_m, scan.spots_m, equal_nan=True)
    assert (scan.repeated, again.repeated) == (0, scan.seen.size)
    (doubt,) = doubts_of_amount({"measured_share": 1.0}, again.repeated, "beam")
    assert doubt.code == "rows_repeated"


@pytest.mark.parametrize(("share", "count"), [(0.003, 1), (0.49, 1), (0.51, 0)])
def test_a_small_part_of_the_mirror_is_a_serious_doubt(share: float, count: int) -> None:
    doubts = [*doubts_of_amount({"measured_share": share}, 0, "beam")]
    assert [one.severity for one in doubts] == [Severity.SERIOUS] * count


def no_sweep(table: dict[str, list[str]]) -> dict[str, list[str]]:
    return table | {"sweep": ["across"] * len(table["sweep"])}


def shuffled_lines(table: dict[str, list[str]]) -> dict[str, list[str]]:
    """Deal the sheets to the lines of each sweep anew."""
    sheets = [tuple(table[name][n] for name in ("normal_x", "normal_y", "normal_z")) for n in range(len(table["line"]))]
    of_line = dict(zip(zip(table["sweep"], table["line"], strict=True), sheets, strict=True))
    dealt = {}
    for sweep in ("across", "along"):
        keys = [key for key in of_line if key[0] == sweep]
        order = np.random.default_rng(2).permutation(len(keys))
        dealt |= {key: of_line[keys[n]] for key, n in zip(keys, order, strict=True)}
    new = [dealt[key] for key in zip(table["sweep"], table["line"], strict=True)]
    return table | dict(zip(("normal_x", "normal_y", "normal_z"), map(list, zip(*new, strict=True)), strict=True))


def one_line(table: dict[str, list[str]]) -> dict[str, list[str]]:
    return table | {"line": ["1"] * len(table["line"])}


def unordered(table: dict[str, list[str]]) -> dict[str, list[str]]:
    order = np.random.default_rng(1).permutation(len(table["line"]))
    return {name: [values[n] for n in order] for name, values in table.items()}


def other_sign(table: dict[str, list[str]]) -> dict[str, list[str]]:
    return table | {"spot_y_m": [str(-float(one)) for one in table["spot_y_m"]]}


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (no_sweep, "two sweeps are needed"),
        (shuffled_lines, "in the order of the scan"),
        (one_line, "several normals"),
        (other_sign, "spot_y_m has the other sign"),
        (unordered, "points of a line are not in their order"),
    ],
)
def test_lines_that_are_not_those_of_the_sheets_are_refused(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    spoil: Callable[[dict[str, list[str]]], dict[str, list[str]]],
    message: str,
) -> None:
    write_line_sweep(tmp_path / "s", replace(line_scene(), columns=25, rows=17))
    write_table_csv(tmp_path / "s" / "lines.csv", spoil(read_table_csv(tmp_path / "s" / "lines.csv")))
    assert message in refusal(tmp_path / "s", capsys)


def test_sigmas_that_are_missing_are_asked_for(drawn: Path) -> None:
    file = drawn / "measurement.toml"
    lines = [one for one in file.read_text().splitlines() if not one.startswith(("sigma_roll", "sigma_distance"))]
    file.write_text("\n".join(lines))
    doubt = {one.code: one for one in measured(drawn).doubts}["laser_sigmas_missing"]
    assert "sigma_distance_mm" in doubt.text
    assert doubt.numbers["inputs_count"] == 2


def test_the_share_is_of_what_was_scanned(drawn: Path) -> None:
    """Half of the beams tell nothing of the other half of the mirror, nor do those without a spot."""
    rows = (drawn / "scan.csv").read_text().splitlines()
    (drawn / "scan.csv").write_text("\n".join(rows[: 1 + 17 * 12]) + "\n")
    result = measured(drawn)
    seen = np.count_nonzero(result.flags == 0)
    assert f"% of what {seen} of {result.flags.size} beams came back from" in result.headline()
    assert "% of the mirror" not in result.headline()


def test_a_scan_without_every_other_spot_gives_what_it_can(drawn: Path) -> None:
    """Holes beside every node leave no curl to compute; the summary says so instead of refusing to be written."""
    lines = (drawn / "scan.csv").read_text().splitlines()
    lost = [line if row % 2 else ",".join([*line.split(",")[:3], "", ""]) for row, line in enumerate(lines[1:])]
    (drawn / "scan.csv").write_text("\n".join([lines[0], *lost]) + "\n")
    summary = run(load_laser(drawn)).summarise()
    assert summary.numbers["curl_rms_per_m"] is None
    assert "all of its neighbours" in summary.not_determined["curl_rms_per_m"]
