"""Exported calibrations: controllers, tables of corrections and files of PAINT give the beam that was calibrated."""

import datetime
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.heliostat.exports.controllers import controller_row
from calibration.heliostat.files.store_heliostat import read_heliostat
from calibration.heliostat.keys import load_heliostat
from calibration.heliostat.kinematic_model.aiming import aim
from calibration.heliostat.kinematic_model.kinematics import mirror_poses
from calibration.heliostat.kinematic_model.presets import (
    azimuth_elevation,
    drone_heliostat,
    linear_actuators,
    six_error,
    two_axes,
    with_drive_terms,
)
from calibration.heliostat.kinematic_model.store_design import design_content, design_from
from calibration.heliostat.pipeline.export import ExportOptions, correction_columns, run
from calibration.heliostat.pipeline.field import run_into
from calibration.heliostat.pipeline.measure import Options
from heliogauge.errors import InputError
from heliogauge.geometry.rays import reflect
from heliogauge.geometry.sun import direction_from_angles
from heliogauge.results.folder import write_table_csv
from heliogauge.results.tables import read_table_csv
from tests.calibration.heliostat_folders import ACTUATORS, TARGET, write_field, write_paint

AXES = ("azimuth", "elevation")


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of two azimuth-elevation heliostats."""
    folder = tmp_path_factory.mktemp("tables")
    write_field(folder, heliostats=2, observations=24)
    run_into(load_heliostat(folder), folder / "out", Options(thorough=False, model="5"))
    return folder / "out"


@pytest.fixture(scope="module")
def paint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of one heliostat with linear actuators."""
    folder = tmp_path_factory.mktemp("paint")
    write_paint(folder, observations=24)
    run_into(load_heliostat(folder), folder / "out", Options(thorough=False, model="4"))
    return folder / "out"


def designs() -> list[Any]:
    place = [10.0, 80.0, 2.0]
    plain = azimuth_elevation("a", place, rad_per_reading=(1e-4, -2e-4), printed_tilts=True)
    terms = with_drive_terms(azimuth_elevation("b", place), 0, ("scale", "worm2", "sag", "backlash"), worm_ratio=30.0)
    return [
        plain,
        terms,
        drone_heliostat("c", place, (0.3, 0.1)),
        six_error("d", place),
        linear_actuators("e", place, ACTUATORS),
    ]


@pytest.mark.parametrize("design", designs(), ids=lambda design: design.name)
def test_a_design_comes_back_number_for_number(design: Any) -> None:
    rng = np.random.default_rng(1)
    design = design.with_parameters(
        design.parameters.with_values(design.parameters.values * rng.uniform(0.999, 1.001, len(design.parameters)))
    )
    numbers = {
        name: {"value": value, "unit": unit}
        for name, value, unit in zip(
            design.parameters.names, design.parameters.values.tolist(), design.parameters.units, strict=True
        )
    }
    content = json.loads(json.dumps({"design": design_content(design), "parameters": numbers}))
    back = design_from(content["design"], content["parameters"], key="value")
    middle = np.where(np.isfinite(design.limits).all(axis=1), design.limits.mean(axis=1), 0.1)
    readings = middle + rng.uniform(-0.1, 0.1, (5, 2)) * np.ptp(design.limits, axis=1)
    one, other = (mirror_poses(each, each.parameters.values, readings) for each in (design, back))
    np.testing.assert_array_equal(one.rotation, other.rotation)
    np.testing.assert_array_equal(one.centre_m, other.centre_m)
    np.testing.assert_array_equal(design.limits, back.limits)


def test_a_damaged_design_is_told(paint: Path) -> None:
    content = read_heliostat(paint)
    del content["design"]["drives"]
    with pytest.raises(InputError, match="the design cannot be read"):
        design_from(content["design"], content["parameters"], key="value")


def moved(design: Any, seed: int = 5) -> Any:
    """Give every angle and term of a design a value of its own."""
    rng = np.random.default_rng(seed)
    own = design.parameters
    sizes = {"rad": 0.01, "m": 0.02, "1": 0.002, "1/m": 0.0}
    steps = [sizes[unit] * rng.uniform(-1, 1) for unit in own.units]
    return design.with_parameters(own.with_values(own.values + steps))


def with_all_terms(design: Any) -> Any:
    for drive in (0, 1):
        terms = ("scale", "worm2", "sag", "backlash")
        design = with_drive_terms(design, drive, terms, worm_ratio=30.0 + drive, sag_zero_rad=0.2)
    return design


AZIMUTH_ELEVATION = [
    azimuth_elevation("plain", [10.0, 80.0, 2.0]),
    with_all_terms(azimuth_elevation("terms", [10.0, 80.0, 2.0], rad_per_reading=(1e-4, -2e-4))),
    with_all_terms(azimuth_elevation("printed", [10.0, 80.0, 2.0], printed_tilts=True)),
    with_all_terms(drone_heliostat("drone", [10.0, 80.0, 2.0], (0.3, 0.1))),
    with_all_terms(six_error("six", [10.0, 80.0, 2.0], arm_normal_m=0.2)),
]


def turn(axis: int, angle: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return right-handed turns about x, y or z, shape (n, 3, 3), written out."""
    cosine, sine = np.cos(angle), np.sin(angle)
    matrix = np.zeros((*np.shape(angle), 3, 3))
    first, second = (axis + 1) % 3, (axis + 2) % 3
    matrix[..., axis, axis] = 1
    matrix[..., first, first] = matrix[..., second, second] = cosine
    matrix[..., first, second], matrix[..., second, first] = -sine, sine
    return matrix


class Controller:
    """A controller that knows a row of controllers.csv and the formulas of its README, and nothing else."""

    def __init__(self, table: dict[str, list[str]], row: int) -> None:
        self.row = {name: cells[row] for name, cells in table.items()}

    def __getitem__(self, name: str) -> float:
        return float(self.row[name])

    def angle(self, axis: str, reading: Any, side: float) -> Any:
        nominal = self[f"{axis}_rad_per_reading"] * reading
        base, wave = nominal + self[f"{axis}_bias_rad"], self[f"{axis}_worm_ratio"] * nominal
        return (
            base
            + self[f"{axis}_sag_rad"] * np.cos(base - self[f"{axis}_sag_zero_rad"])
            + self[f"{axis}_worm_sin_rad"] * np.sin(wave)
            + self[f"{axis}_worm_cos_rad"] * np.cos(wave)
            + self[f"{axis}_worm_sin2_rad"] * np.sin(2 * wave)
            + self[f"{axis}_worm_cos2_rad"] * np.cos(2 * wave)
            + side * self[f"{axis}_backlash_rad"] / 2
        )

    def reading(self, axis: str, angle: Any, side: float) -> Any:
        size = self[f"{axis}_rad_per_reading"]
        reading = (angle - self[f"{axis}_bias_rad"]) / size
        for _ in range(60):
            reading = reading + (angle - self.angle(axis, reading, side)) / size
        return reading

    @property
    def base(self) -> Any:
        return np.array([self[f"rm{place}"] for place in range(1, 10)]).reshape(3, 3)

    def angles(self, normals: Any) -> tuple[Any, Any]:
        e, c = self["non_orthogonality_rad"], self["canting_rad"]
        g = normals @ self.base
        elevation = np.arcsin((g[:, 2] - np.sin(c) * np.sin(e)) / (np.cos(c) * np.cos(e)))
        x = np.sin(c) * np.cos(e) - np.cos(c) * np.sin(elevation) * np.sin(e)
        y = np.cos(c) * np.cos(elevation)
        return np.arctan2(g[:, 0], g[:, 1]) - np.arctan2(x, y), elevation

    def centre(self, azimuth: Any, elevation: Any) -> Any:
        arm = np.array([self["arm_x_m"], self["arm_y_m"], self["arm_z_m"]])
        inner = turn(1, np.full_like(elevation, -self["non_orthogonality_rad"])) @ turn(0, elevation)
        return [self["e_m"], self["n_m"], self["u_m"]] + (self.base @ turn(2, -azimuth) @ inner) @ arm


class TestControllers:
    """Malan (2014), section 5.4, with the terms of the drives: evaluated from the file by an arithmetic of its own."""

    @pytest.fixture(scope="class")
    def table(self, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str]]:
        rows = [controller_row(moved(design)) for design in AZIMUTH_ELEVATION]
        file = tmp_path_factory.mktemp("controllers") / "controllers.csv"
        write_table_csv(file, {key: [row[key] for row in rows] for key in rows[0]})
        return read_table_csv(file)

    @pytest.mark.parametrize("row", range(len(AZIMUTH_ELEVATION)))
    def test_every_term_of_the_model_is_in_the_file(self, table: dict[str, list[str]], row: int) -> None:
        design, controller = moved(AZIMUTH_ELEVATION[row]), Controller(table, row)
        sizes = [controller["azimuth_rad_per_reading"], controller["elevation_rad_per_reading"]]
        readings = np.array([[1.2, 0.3], [2.6, 0.9], [-1.0, 0.05], [0.4, 1.3]]) / sizes
        for side in (-1.0, 1.0):
            poses = mirror_poses(design, design.parameters.values, readings, np.full((4, 2), side))
            wanted = [controller.angle(axis, readings[:, place], side) for place, axis in enumerate(AXES)]
            found = controller.angles(poses.normals(design))
            for one, other in zip(found, wanted, strict=True):
                apart = (one - other + np.pi) % (2 * np.pi) - np.pi
                assert np.abs(apart).max() < 1e-12
            assert np.abs(controller.centre(*wanted) - poses.centre_m).max() < 1e-12

    @pytest.mark.parametrize("row", range(len(AZIMUTH_ELEVATION)))
    def test_commands_are_those_of_the_model(self, table: dict[str, list[str]], row: int) -> None:
        design, controller = moved(AZIMUTH_ELEVATION[row]), Controller(table, row)
        suns = direction_from_angles(np.deg2rad([110.0, 150.0, 220.0]), np.deg2rad([20.0, 50.0, 35.0]))
        wanted = aim(design, design.parameters.values, suns, TARGET.center_m, approach=np.ones((3, 2)))
        for place, (axis, angle) in enumerate(zip(AXES, controller.angles(wanted.normals), strict=True)):
            turns = np.round((wanted.angles_rad[:, place] - angle) / (2 * np.pi))
            command = controller.reading(axis, angle + 2 * np.pi * turns, 1.0)
            apart = (command - wanted.readings[:, place]) * controller[f"{axis}_rad_per_reading"]
            assert np.abs(apart).max() < 1e-12

    @pytest.mark.parametrize("name", ["sag", "worm_sin", "worm_cos2", "backlash"])
    def test_a_term_that_is_dropped_is_noticed(self, table: dict[str, list[str]], name: str) -> None:
        whole, without = Controller(table, 1), Controller(table, 1)
        without.row[f"azimuth_{name}_rad"] = "0"
        reading = np.linspace(-1, 1, 9) / whole["azimuth_rad_per_reading"]
        apart = whole.angle("azimuth", reading, 1.0) - without.angle("azimuth", reading, 1.0)
        assert np.abs(apart).max() > 1e-4

    @pytest.mark.parametrize(
        ("design", "why"),
        [
            (linear_actuators("e", [10.0, 80.0, 2.0], ACTUATORS), "e: it has linear actuators"),
            (
                two_axes("f", [10.0, 80.0, 2.0], [[0, 1, 0], [1, 0, 0]], [0, 0, 1]),
                "f: its axes are not azimuth and elevation",
            ),
        ],
    )
    def test_other_chains_have_no_such_form(self, design: Any, why: str) -> None:
        with pytest.raises(InputError, match=why):
            controller_row(design)

    def test_the_file_has_a_row_for_each(self, tables: Path, tmp_path: Path) -> None:
        assert run(tables, tmp_path / "e", "controllers").names == ("README.txt", "controllers.csv", "exported.csv")
        table = read_table_csv(tmp_path / "e" / "controllers.csv")
        assert table["heliostat"] == ["H1", "H2"]
        value = read_heliostat(tables / "H2")["parameters"]["azimuth_offset"]["value"]
        assert float(table["azimuth_bias_rad"][1]) == value

    def test_what_a_mixed_field_leaves_out_is_said(self, tables: Path, paint: Path, tmp_path: Path) -> None:
        for folder in (tables / "H1", paint):
            (tmp_path / "field" / folder.name).mkdir(parents=True)
            shutil.copy(folder / "heliostat.json", tmp_path / "field" / folder.name)
        found = run(tmp_path / "field", tmp_path / "e", "controllers")
        assert [one.code for one in found.doubts] == ["export_refused"]
        table = read_table_csv(tmp_path / "e" / "exported.csv")
        assert sorted(zip(table["heliostat"], table["status"], strict=True)) == [
            ("AA11", "refused"),
            ("H1", "exported"),
        ]


class TestCorrections:
    def test_corrected_readings_hit_the_aim_point(self, paint: Path) -> None:
        content = read_heliostat(paint)
        columns = correction_columns(content, ExportOptions(datetime.date(2026, 6, 21), 30.0))
        design = design_from(content["design"], content["parameters"], key="value")
        readings = np.column_stack([columns["corrected_1_counts"], columns["corrected_2_counts"]])
        known = np.isfinite(readings).all(axis=1)
        assert known.sum() > 10
        suns = direction_from_angles(
            *(np.deg2rad(columns[f"sun_{name}_deg"][known]) for name in ("azimuth", "elevation"))
        )
        poses = mirror_poses(design, design.parameters.values, readings[known])
        beams = reflect(-suns, poses.normals(design))
        wanted = TARGET.center_m - poses.centre_m
        wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
        assert np.linalg.norm(beams - wanted, axis=1).max() < 1e-9
        assert np.abs(columns["correction_1_counts"][known]).max() > 10

    def test_times_are_those_of_the_place_in_utc(self, paint: Path) -> None:
        columns = correction_columns(read_heliostat(paint), ExportOptions(datetime.date(2026, 3, 20), 10.0))
        assert columns["time_utc"][0].startswith("2026-03-20T06:")
        assert columns["time_utc"][-1].startswith("2026-03-20T18:")
        assert np.all(np.array(columns["sun_elevation_deg"]) > 0)

    @pytest.mark.parametrize(
        ("options", "wanted"),
        [
            (ExportOptions(datetime.date(2026, 3, 20), target="roof"), "target=roof: no such target; there are"),
            (ExportOptions(step_minutes=0.0), "step_minutes=0: between"),
        ],
    )
    def test_choices_that_cannot_be(self, paint: Path, tmp_path: Path, options: ExportOptions, wanted: str) -> None:
        with pytest.raises(InputError, match=wanted):
            run(paint, tmp_path / "e", "table", options)
        assert not (tmp_path / "e").exists()


def test_no_results_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no heliostat\.json here or one folder below"):
        run(tmp_path, tmp_path / "e", "controllers")


def test_earlier_exports_are_replaced_only_when_asked(paint: Path, tmp_path: Path) -> None:
    run(paint, tmp_path / "e", "artist")
    with pytest.raises(InputError, match="force=True"):
        run(paint, tmp_path / "e", "artist")
    run(paint, tmp_path / "e", "artist", ExportOptions(force=True))


def test_a_form_that_no_heliostat_has_is_refused(paint: Path, tables: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="AA11: it has linear actuators"):
        run(paint, tmp_path / "e", "controllers")
    with pytest.raises(InputError, match="H1: no linear actuators"):
        run(tables, tmp_path / "e", "artist")
    assert not (tmp_path / "e").exists()


def test_the_table_is_of_today_where_no_day_is_named(paint: Path, tmp_path: Path) -> None:
    earliest = datetime.datetime.now(datetime.UTC).date()
    names = run(paint, tmp_path / "e", "table", ExportOptions(step_minutes=60.0)).names
    latest = datetime.datetime.now(datetime.UTC).date()
    assert names[1] in {f"corrections_AA11_{day}.csv" for day in (earliest, latest)}
