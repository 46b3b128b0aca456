"""The border of heliostats: what is wrong is reported row by row, what is wrong with a column in one message."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.heliostat.files.sources import open_source
from calibration.heliostat.files.store_paint import parse_calibrations, parse_properties
from calibration.heliostat.keys import load_heliostat
from calibration.heliostat.observations.observed import Observed, observed
from calibration.heliostat.observations.residuals import evaluate
from calibration.heliostat.observations.rows import parse_rows
from calibration.heliostat.pipeline.measure import Options
from calibration.heliostat.pipeline.measure import run as measure
from calibration.heliostat.pipeline.nominal_design import nominal_design
from heliogauge.errors import InputError
from heliogauge.measurement.writer import dump_toml
from heliogauge.results.tables import read_table_csv, write_table_csv
from tests.calibration.heliostat_folders import CONTENT, SIGMA_M, TARGET, properties, write_field, write_paint

Table = dict[str, list[str]]


def see(folder: Path) -> Observed:
    """Read the first heliostat of a folder up to its observations."""
    measurement = load_heliostat(folder)
    source = open_source(measurement)
    (task,) = source.tasks(source.names[:1])
    if task.header:
        rows = parse_rows(task.header, {int(number): text for number, text in task.records})
    else:
        rows = parse_calibrations(task.records, task.times, label="UTIS", origin=source.plant.origin)
    design = nominal_design(task, source.plant, measurement.model.kinematics)
    return observed(rows, design, source.plant, (), 1e-3 * measurement.model.evaluation.spot_sigma_mm)


@pytest.fixture
def changed(tmp_path: Path) -> Callable[[Callable[[Table], Any]], Path]:
    """Write a measurement of one heliostat whose table of observations was changed by a function."""

    def write(change: Callable[[Table], Any]) -> Path:
        write_field(tmp_path, observations=12)
        table = read_table_csv(tmp_path / "observations.csv")
        change(table)
        write_table_csv(tmp_path / "observations.csv", table)
        return tmp_path

    return write


def put(table: Table, column: str, row: int, value: str) -> None:
    table[column][row] = value


def scale(table: Table, factor: float, *columns: str) -> None:
    for column in columns:
        table[column] = [repr(float(cell) * factor) for cell in table[column]]


def repeat(table: Table, row: int) -> None:
    for column in table.values():
        column.append(column[row])


def with_suns(table: Table, form: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]) -> None:
    """Add the sun's angles, changed by a function."""
    from heliogauge.geometry.sun import sun_angles, utc_times
    from tests.calibration.heliostat_folders import SITE

    azimuth, elevation = form(*(np.rad2deg(one) for one in sun_angles(utc_times(table["time_utc"]), SITE)))
    table["sun_azimuth_deg"] = [repr(float(one)) for one in azimuth]
    table["sun_elevation_deg"] = [repr(float(one)) for one in elevation]


class TestRows:
    def test_true_numbers_leave_the_noise(self, tmp_path: Path) -> None:
        truth = write_field(tmp_path, observations=60)["H1"]
        seen = see(tmp_path)
        found = evaluate(truth, truth.parameters.values, seen.observations)
        assert seen.rows.flags == ("",) * 60
        assert np.sqrt(np.mean(found.whitened**2)) == pytest.approx(1.0, abs=0.2)
        assert seen.has_sigmas

    @pytest.mark.parametrize(
        ("change", "flag", "reason"),
        [
            (lambda t: put(t, "target", 3, "nord face"), "target", "'nord face' is not known; did you mean 'north"),
            (lambda t: put(t, "x_m", 3, "nan"), "not_finite", "centre is missing"),
            (lambda t: put(t, "y_m", 3, ""), "not_finite", "centre is missing"),
            (lambda t: put(t, "axis_2_rad", 3, ""), "not_finite", "axis_1_rad or axis_2_rad is missing"),
            (lambda t: put(t, "axis_2_rad", 3, "inf"), "not_finite", "is missing or not finite"),
            (lambda t: put(t, "axis_1_rad", 3, "57.3"), "units", "axis_1_rad: degrees among radians"),
            (lambda t: put(t, "axis_2_rad", 3, "2.5"), "reading", "2.5 rad is beyond the drive's limits"),
            (lambda t: put(t, "x_m", 3, "4.5"), "off_target", "(4.50, "),
            (lambda t: put(t, "x_m", 3, "1200"), "off_target", "are these millimetres?"),
            (lambda t: put(t, "time_utc", 3, "2026-06-21T23:30:00Z"), "sun", "degrees below the horizon"),
            (lambda t: put(t, "time_utc", 3, "2026-06-21T12:30:00"), "time", "has no zone"),
            (lambda t: put(t, "time_utc", 3, ""), "time", "neither a time nor"),
            (lambda t: put(t, "sigma_mm", 3, "0"), "not_finite", "a sigma must be positive"),
            (lambda t: put(t, "sigma_mm", 3, "1e200"), "not_finite", "a sigma must be positive, from 1e-6 to 1e6"),
            (lambda t: put(t, "sigma_mm", 3, "1e-30"), "not_finite", "a sigma must be positive, from 1e-6 to 1e6"),
            (lambda t: t.update(kind=["beam"] * 3 + ["baem"] + ["beam"] * 8), "unreadable", "did you mean 'beam'"),
        ],
    )
    def test_one_wrong_cell_is_one_flagged_row(
        self, changed: Any, change: Callable[[Table], Any], flag: str, reason: str
    ) -> None:
        seen = see(changed(change))
        assert [one for one in seen.rows.flags if one] == [flag]
        assert reason in seen.rows.reasons[3]
        assert len(seen.observations) == 11
        assert 3 not in seen.observations.row

    def test_a_repeat_counts_once(self, changed: Any) -> None:
        seen = see(changed(lambda table: repeat(table, 4)))
        assert seen.rows.flags[12] == "duplicate"
        assert seen.rows.reasons[12] == "the same as line 6"
        assert len(seen.observations) == 12

    def test_a_repeat_without_a_time_counts_once(self, changed: Any) -> None:
        """Which of both has the time does not matter: the other is left out."""

        def change(table: Table) -> None:
            with_suns(table, lambda azimuth, elevation: (azimuth, elevation))
            repeat(table, 4)
            put(table, "time_utc", 4, "")

        seen = see(changed(change))
        assert [row for row, flag in enumerate(seen.rows.flags) if flag == "duplicate"] == [4]
        assert len(seen.observations) == 12

    def test_one_sun_that_contradicts_its_time(self, changed: Any) -> None:
        def change(table: Table) -> None:
            with_suns(table, lambda azimuth, elevation: (azimuth, elevation))
            put(table, "sun_azimuth_deg", 5, repr(float(table["sun_azimuth_deg"][5]) + 2))

        seen = see(changed(change))
        assert seen.rows.flags[5] == "sun"
        assert "mrad from where" in seen.rows.reasons[5]
        assert seen.sun_check_rad < 1e-6


class TestColumns:
    @pytest.mark.parametrize(
        ("change", "wanted"),
        [
            (lambda t: scale(t, 57.29578, "axis_1_rad", "axis_2_rad"), "are no radians; name the columns axis_1_deg"),
            (lambda t: scale(t, 57.29578, "axis_1_rad"), "let both be degrees"),
            (lambda t: t.update(axis_1_deg=t.pop("axis_1_rad"), axis_2_deg=t.pop("axis_2_rad")), "look like radians"),
            (
                lambda t: t.update(axis_1_counts=t.pop("axis_1_rad"), axis_2_counts=t.pop("axis_2_rad")),
                "give counts_per_turn",
            ),
            (lambda t: t.update(axis_1_rad=["0.5"] * 12), "axis 1 reads 0.5 in all 12 rows"),
            (lambda t: t.update(time_utc=[t["time_utc"][0]] * 12), "the sun stands at the same place in all 12 rows"),
            (lambda t: t.pop("axis_1_rad"), "the readings of both axes are needed in one unit"),
            (lambda t: t.pop("time_utc"), "where the sun was is missing"),
            (lambda t: t.update(sigma_x_mm=t.pop("sigma_mm")), "sigma_x_mm is alone"),
            (lambda t: t.update(sun_azimuth_deg=["0"] * 12), "sun_azimuth_deg is alone"),
            (lambda t: t.update(xm=t.pop("x_m")), "'xm' is not a column here; did you mean 'x_m'"),
            (lambda t: with_suns(t, lambda a, e: (180 - a, e)), "0 in the south and positive to the east"),
            (lambda t: with_suns(t, lambda a, e: (a - 180, e)), "0 in the south and positive to the west"),
            (lambda t: with_suns(t, lambda a, e: (a, 90 - e)), "it is the zenith angle"),
            (lambda t: with_suns(t, lambda a, e: (np.deg2rad(a), np.deg2rad(e))), "they look like radians"),
            (
                lambda t: (
                    with_suns(t, lambda a, e: (a, e)),
                    t.update(time_utc=[c.replace("T", " ").replace("Z", "-02:00") for c in t["time_utc"]]),
                ),
                r"a zone \+2 h from UTC",
            ),
        ],
    )
    def test_a_column_that_cannot_be_meant_is_one_message(
        self, changed: Any, change: Callable[[Table], Any], wanted: str
    ) -> None:
        with pytest.raises(InputError, match=wanted):
            see(changed(change))

    @pytest.mark.parametrize(
        ("change", "wanted"),
        [
            (lambda site: {"latitude_deg": -site["latitude_deg"]}, "that of a latitude of the other sign"),
            (lambda site: {"longitude_deg": -site["longitude_deg"]}, "that of a longitude of the other sign"),
            (
                lambda site: {"latitude_deg": site["longitude_deg"], "longitude_deg": site["latitude_deg"]},
                "that of latitude and longitude exchanged",
            ),
            (lambda site: {"longitude_deg": site["longitude_deg"] + 100, "latitude_deg": -20.0}, "none explains it"),
        ],
    )
    def test_recorded_suns_tell_the_site(self, changed: Any, change: Callable[[Any], Any], wanted: str) -> None:
        folder = changed(lambda table: with_suns(table, lambda azimuth, elevation: (azimuth, elevation)))
        content = {**CONTENT, "site": {**CONTENT["site"], **change(CONTENT["site"])}}
        (folder / "measurement.toml").write_text(dump_toml(content), encoding="utf-8")
        with pytest.raises(InputError, match=wanted):
            see(folder)

    def test_semicolons(self, tmp_path: Path) -> None:
        write_field(tmp_path, observations=12)
        file = tmp_path / "observations.csv"
        file.write_text(file.read_text(encoding="utf-8").replace(",", ";"), encoding="utf-8")
        with pytest.raises(InputError, match="separated by ';' or tabs; commas are needed"):
            see(tmp_path)

    @pytest.mark.parametrize(
        ("old", "new", "wanted"),
        [
            ("e_m", "east", r"position is missing: columns e_m, n_m, u_m"),
            ("\nH1,", "\nH1,nan,2,3\nH2,", "e_m = 'nan': a finite number is needed for its position"),
            ("\nH1,", "\nH1,,2,3\nH2,", "e_m = '': a finite number is needed for its position"),
        ],
    )
    def test_table_of_heliostats(self, tmp_path: Path, old: str, new: str, wanted: str) -> None:
        write_field(tmp_path, observations=12)
        file = tmp_path / "heliostats.csv"
        file.write_text(file.read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")
        with pytest.raises(InputError, match=wanted):
            see(tmp_path)

    def test_a_parameter_of_its_own(self, tmp_path: Path) -> None:
        write_field(tmp_path, observations=12)
        write_table_csv(
            tmp_path / "heliostats.csv",
            {"heliostat": ["H1"], "e_m": [1.0], "n_m": [80.0], "u_m": [2.0], "tilt_nort": [1e-3]},
        )
        with pytest.raises(InputError, match="did you mean tilt_north"):
            see(tmp_path)

    def test_observations_of_a_heliostat_that_is_not_listed(self, tmp_path: Path) -> None:
        write_field(tmp_path, heliostats=2, observations=12)
        file = tmp_path / "heliostats.csv"
        file.write_text("".join(file.read_text(encoding="utf-8").splitlines(keepends=True)[:2]), encoding="utf-8")
        source = open_source(load_heliostat(tmp_path))
        assert source.names == ("H1", "H2")
        assert "no row in the table of heliostats" in next(iter(source.tasks(("H2",)))).fault


class TestPaint:
    def test_true_numbers_leave_the_noise(self, tmp_path: Path) -> None:
        truth = write_paint(tmp_path / "feld ä")["AA11"]
        seen = see(tmp_path / "feld ä")
        found = evaluate(truth, truth.parameters.values, seen.observations)
        rms = 1e3 * np.sqrt(np.mean(found.beam_angle_rad**2))
        assert seen.rows.ids[0] == "1000"
        assert seen.sun_check_rad < 1e-6
        assert rms == pytest.approx(1e3 * SIGMA_M * np.sqrt(2) / 80, rel=0.2)

    def test_one_heliostat_finds_what_it_shares_above(self, tmp_path: Path) -> None:
        write_paint(tmp_path, names=("AA11", "AA12"), observations=6)
        alone, together = see(tmp_path / "AA11"), see(tmp_path)
        np.testing.assert_array_equal(alone.spots_m, together.spots_m)
        np.testing.assert_array_equal(alone.rows.times, together.rows.times)

    @pytest.mark.parametrize(
        ("text", "flag", "reason"),
        [
            ('{"motor_position": {"axis_1_m', "unreadable", "not valid JSON"),
            ("[1, 2]", "unreadable", "a JSON object is needed"),
            ('{"a":' * 100_000, "unreadable", "not valid JSON"),
            ("{}", "unreadable", "the key motor_position is missing"),
        ],
    )
    def test_a_damaged_record_is_a_flagged_row(self, tmp_path: Path, text: str, flag: str, reason: str) -> None:
        write_paint(tmp_path, observations=8)
        (tmp_path / "AA11" / "calibration" / "1003_calibration_properties.json").write_text(text, encoding="utf-8")
        seen = see(tmp_path)
        assert seen.rows.flags == ("", "", "", flag, "", "", "", "")
        assert reason in seen.rows.reasons[3]

    @pytest.mark.parametrize(
        ("change", "flag", "reason"),
        [
            (lambda r: r["focal_spot"].pop("UTIS"), "label", "no centre by UTIS; there is HeliOS"),
            (lambda r: r["motor_position"].update(axis_1_motor_position="a"), "unreadable", "a finite number"),
            (lambda r: r.update(target_name="receiver"), "target", "'receiver' is not flat"),
            (lambda r: r.update(target_name="north"), "target", "'north' is not known; did you mean 'north face'"),
            (lambda r: r["focal_spot"].update(UTIS=[137.0, 2.0, 500.0]), "unreadable", "latitude, longitude, altitude"),
            (lambda r: r["motor_position"].update(axis_2_motor_position=90000), "reading", "beyond the drive's limits"),
        ],
    )
    def test_a_record_edited_by_hand(
        self, tmp_path: Path, change: Callable[[Any], Any], flag: str, reason: str
    ) -> None:
        write_paint(tmp_path, observations=8)
        file = tmp_path / "AA11" / "calibration" / "1003_calibration_properties.json"
        content = json.loads(file.read_text(encoding="utf-8"))
        change(content)
        file.write_text(json.dumps(content), encoding="utf-8")
        seen = see(tmp_path)
        assert [one for one in seen.rows.flags if one] == [flag]
        assert reason in seen.rows.reasons[3]

    def test_no_records_at_all(self, tmp_path: Path) -> None:
        write_paint(tmp_path, observations=1)
        (tmp_path / "AA11" / "calibration" / "1000_calibration_properties.json").unlink()
        source = open_source(load_heliostat(tmp_path))
        assert "no calibration records" in next(iter(source.tasks(source.names))).fault

    def test_no_tower(self, tmp_path: Path) -> None:
        write_paint(tmp_path, observations=1)
        (tmp_path / "tower" / "tower_measurements.json").unlink()
        with pytest.raises(InputError, match="it holds the targets' corners"):
            open_source(load_heliostat(tmp_path))


def call_ideal(folder: Path, *, with_numbers: bool = True) -> None:
    """Call the actuators of a heliostat ideal, as public files do that keep the numbers of the linear ones."""
    file = folder / "AA11" / "AA11_properties.json"
    content = json.loads(file.read_text(encoding="utf-8"))
    for one in actuators(content):
        one["type_axis"] = "ideal"
        if not with_numbers:
            one.pop("increment")
    file.write_text(json.dumps(content), encoding="utf-8")


class TestIdealActuators:
    def test_counts_are_turned_into_angles_by_the_numbers_beside_the_word(self, tmp_path: Path) -> None:
        write_paint(tmp_path / "linear", observations=12)
        write_paint(tmp_path / "ideal", observations=12)
        call_ideal(tmp_path / "ideal")
        fits = [measure(load_heliostat(tmp_path / name), Options()).heliostats[0] for name in ("linear", "ideal")]
        linear, ideal = (one.fit for one in fits)
        np.testing.assert_array_equal(linear.values, ideal.values)
        assert linear.names == ideal.names

    def test_counts_without_numbers_are_refused(self, tmp_path: Path) -> None:
        write_paint(tmp_path, observations=6)
        call_ideal(tmp_path, with_numbers=False)
        with pytest.raises(InputError, match=r"motor positions are angles .* but the records hold counts"):
            see(tmp_path)

    @pytest.mark.parametrize(
        ("largest", "is_ideal", "unit"),
        [(6.0, True, "rad"), (-6.0, True, "rad"), (7.0, True, "counts"), (1.0, False, "counts")],
    )
    def test_an_angle_is_within_a_turn(self, largest: float, is_ideal: bool, unit: str) -> None:
        record = {
            "motor_position": {"axis_1_motor_position": largest, "axis_2_motor_position": 0.1},
            "target_name": TARGET.name,
            "sun_elevation": 30.0,
            "sun_azimuth": 10.0,
            "focal_spot": {"UTIS": [37.0, -6.0, 50.0]},
        }
        origin = (37.0, -6.0, 0.0)
        rows = parse_calibrations([("1", json.dumps(record))], [""], label="UTIS", origin=origin, is_ideal=is_ideal)
        assert rows.numbers[f"axis_1_{unit}"].tolist() == [largest]

    @pytest.mark.parametrize("count", [4, 12])
    def test_one_reading_beyond_a_turn_is_left_out_alone(self, tmp_path: Path, count: int) -> None:
        write_paint(tmp_path, observations=count, ideal=True)
        call_ideal(tmp_path)
        file = sorted((tmp_path / "AA11").glob("[cC]alibration/*calibration*.json"))[3]
        record = json.loads(file.read_text(encoding="utf-8"))
        record["motor_position"]["axis_2_motor_position"] = 20_000.0
        file.write_text(json.dumps(record), encoding="utf-8")
        measurement = load_heliostat(tmp_path)
        source = open_source(measurement)
        (task,) = source.tasks(source.names)
        origin = source.plant.origin
        rows = parse_calibrations(task.records, task.times, label="UTIS", origin=origin, is_ideal=True)
        assert "axis_2_rad" in rows.numbers
        kinematics = measurement.model.kinematics
        design = nominal_design(task, source.plant, kinematics, readings_are_angles=True)
        flags = observed(rows, design, source.plant, (), 1e-3).rows.flags
        assert [flag for flag in flags if flag] == ["units"]
        assert flags[3] == "units"

    @pytest.mark.parametrize("with_numbers", [True, False])
    def test_angles_are_taken_as_they_are(self, tmp_path: Path, with_numbers: bool) -> None:
        truth = write_paint(tmp_path, observations=30, ideal=True)["AA11"]
        call_ideal(tmp_path, with_numbers=with_numbers)
        found = measure(load_heliostat(tmp_path), Options()).heliostats[0].fit
        assert found.design.reading_unit == "rad"
        assert {name: found.nominal.parameters.value(name) for name in ("initial_angle_1", "tilt_1_n")} == {
            "initial_angle_1": 0.0,
            "tilt_1_n": 0.0,
        }
        for name in ("tilt_1_n", "tilt_1_u", "tilt_2_e", "tilt_2_n"):
            index = found.names.index(name)
            error = found.values[index] - truth.parameters.value(name)
            assert abs(error) < 4 * found.sigma[index]


def actuators(content: Any) -> list[dict[str, Any]]:
    return content["kinematics_properties"]["actuators"]


class TestProperties:
    """Generations of keys say the same."""

    def test_older_keys(self) -> None:
        today = properties(np.array([10.0, 70.0, 2.0]))
        older = dict(today)
        kinematics = dict(older.pop("kinematics_properties"))
        kinematics |= {"first_joint_translation_u": 0.3, "concentrator_translation_n": 0.2}
        read = parse_properties(json.dumps(older | {"kinematic_properties": kinematics}), "f")
        assert read.translations_m["joint_1"] == (0.0, 0.0, 0.3)
        assert read.translations_m["concentrator"] == (0.0, 0.2, 0.0)
        assert read.actuators == parse_properties(json.dumps(today), "f").actuators

    def test_the_oldest_table(self) -> None:
        today = properties(np.array([10.0, 70.0, 2.0]))
        wanted = parse_properties(json.dumps(today), "f").actuators
        letters = {
            "increment": "PulseRatio",
            "initial_stroke": "B",
            "offset": "C",
            "pivot_radius": "D",
            "initial_angle": "AngleK",
            "clockwise": "Reversed",
            "lowest": "MinCounts",
            "highest": "MaxCounts",
        }
        table = {f"{letters[name]}_axis_{axis}": wanted[axis - 1][name] for name in letters for axis in (1, 2)}
        old = {
            "heliostat_position": today["heliostat_position"],
            "kinematic_properties": {"Type_axis_1": "LINEAR"} | table,
        }
        assert parse_properties(json.dumps(old), "f").actuators == wanted

    def test_another_first_orientation_is_told(self) -> None:
        content = properties(np.zeros(3)) | {"initial_orientation": [0.0, 0.0, 1.0]}
        read = parse_properties(json.dumps(content), "AA31")
        assert [one.code for one in read.doubts] == ["paint_translations_left_out"]
        assert read.translations_m["concentrator"] == (0.0, 0.0, 0.0)

    @pytest.mark.parametrize(
        ("change", "wanted"),
        [
            (lambda c: c.pop("kinematics_properties"), "kinematics_properties or kinematic_properties is missing"),
            (lambda c: c.update(heliostat_position=[91.0, 2.0, 3.0]), r"latitude \[deg\], longitude \[deg\]"),
            (lambda c: c.pop("heliostat_position"), "latitude, longitude and altitude are needed"),
            (lambda c: actuators(c).pop(), "actuators: two are needed"),
            (lambda c: actuators(c)[1].pop("offset"), "actuator 2: the key 'offset' is missing"),
            (lambda c: actuators(c)[0].update(pivot_radius=-0.3), "a positive number is needed"),
            (lambda c: actuators(c)[0].update(type_axis="ideal"), "one actuator is ideal, the other linear"),
            (lambda c: actuators(c)[0].update(type_axis="worm"), "linear and ideal ones can be read"),
        ],
    )
    def test_edited_by_hand(self, change: Callable[[Any], Any], wanted: str) -> None:
        content = properties(np.zeros(3))
        change(content)
        with pytest.raises(InputError, match=wanted):
            parse_properties(json.dumps(content), "f")

    def test_truncated(self) -> None:
        with pytest.raises(InputError, match=r"f: not valid JSON .*is the file whole\?"):
            parse_properties(json.dumps(properties(np.zeros(3)))[:200], "f")


def test_presets_of_the_table_are_told_what_they_lack(tmp_path: Path) -> None:
    from heliogauge.measurement.writer import dump_toml

    write_field(tmp_path, observations=12)
    content = CONTENT | {"kinematics": {"preset": "linear-actuators"}}
    (tmp_path / "measurement.toml").write_text(dump_toml(content), encoding="utf-8")
    with pytest.raises(InputError, match="initial_angle_1 is missing; give it as a column"):
        see(tmp_path)
    assert TARGET.name in str(CONTENT)
