"""Exported calibrations: controllers, tables of corrections and files of PAINT give the beam that was calibrated."""

import datetime
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.heliostat.files.store_heliostat import read_heliostat
from calibration.heliostat.files.store_paint import parse_properties
from calibration.heliostat.keys import load_heliostat
from calibration.heliostat.kinematic_model.aiming import aim
from calibration.heliostat.kinematic_model.kinematics import mirror_poses
from calibration.heliostat.kinematic_model.presets import (
    azimuth_elevation,
    drone_heliostat,
    linear_actuators,
    six_error,
    with_drive_terms,
)
from calibration.heliostat.kinematic_model.store_design import design_content, design_from
from calibration.heliostat.observations.plant import Plant
from calibration.heliostat.pipeline.export import ExportOptions, controller_row, correction_columns, run
from calibration.heliostat.pipeline.field import run_into
from calibration.heliostat.pipeline.measure import Options
from calibration.heliostat.pipeline.nominal_design import paint_design
from heliogauge.errors import InputError
from heliogauge.geometry.rays import reflect
from heliogauge.geometry.sun import Site, direction_from_angles
from heliogauge.results.tables import read_table_csv
from tests.calibration.heliostat_folders import ACTUATORS, SITE, TARGET, write_field, write_paint

ORIGIN = (SITE.latitude_deg, SITE.longitude_deg, SITE.altitude_m)


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


class TestControllers:
    def test_the_closed_form_gives_the_commands(self) -> None:
        """Malan (2014), section 5.4: stored rotation and biases, by an arithmetic of its own."""
        design = azimuth_elevation("a", [10.0, 80.0, 2.0]).with_value(
            {
                "tilt_north": 0.013,
                "tilt_east": -0.005,
                "azimuth_offset": 0.02,
                "elevation_offset": -0.01,
                "non_orthogonality": 0.03,
            }
        )
        row = controller_row(design)
        assert row is not None
        suns = direction_from_angles(np.deg2rad([110.0, 150.0, 220.0]), np.deg2rad([20.0, 50.0, 35.0]))
        wanted = aim(design, design.parameters.values, suns, TARGET.center_m)
        rotation = np.array([row[f"rm{place}"] for place in range(1, 10)]).reshape(3, 3)
        turned = wanted.normals @ rotation
        error = row["non_orthogonality_rad"]
        elevation = np.arcsin(turned[:, 2] / np.cos(error))
        azimuth = np.arctan2(turned[:, 0], turned[:, 1]) + np.arctan2(
            np.sin(elevation) * np.sin(error), np.cos(elevation)
        )
        commands = np.column_stack([azimuth - row["azimuth_bias_rad"], elevation - row["elevation_bias_rad"]])
        apart = (commands - wanted.readings + np.pi) % (2 * np.pi) - np.pi
        assert np.abs(apart).max() < 1e-12

    def test_other_chains_have_no_such_form(self) -> None:
        assert controller_row(six_error("d", [10.0, 80.0, 2.0])) is None
        assert controller_row(linear_actuators("e", [10.0, 80.0, 2.0], ACTUATORS)) is None

    def test_the_file_has_a_row_for_each(self, tables: Path, tmp_path: Path) -> None:
        assert run(tables, tmp_path / "e", "controllers") == ["README.txt", "controllers.csv"]
        table = read_table_csv(tmp_path / "e" / "controllers.csv")
        assert table["heliostat"] == ["H1", "H2"]
        value = read_heliostat(tables / "H2")["parameters"]["azimuth_offset"]["value"]
        assert float(table["azimuth_bias_rad"][1]) == value


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


class TestPaint:
    def test_exported_properties_read_as_the_calibrated_heliostat(self, paint: Path, tmp_path: Path) -> None:
        run(paint, tmp_path / "e", "artist")
        content = read_heliostat(paint)
        calibrated = design_from(content["design"], content["parameters"], key="value")
        text = (tmp_path / "e" / "AA11_properties.json").read_text(encoding="utf-8")
        plant = Plant(ORIGIN, Site(37.0, -2.0, 0.0), {})
        back = paint_design(parse_properties(text, "f"), "AA11", plant)
        readings = np.array([[20000.0, 30000.0], [40000.0, 50000.0], [60000.0, 20000.0]])
        one, other = (mirror_poses(each, each.parameters.values, readings) for each in (calibrated, back))
        np.testing.assert_allclose(one.rotation, other.rotation, atol=1e-12)
        # A latitude in degrees has 1e-9 m.
        np.testing.assert_allclose(one.centre_m, other.centre_m, atol=1e-8)

    def test_keys_are_those_that_artist_reads(self, paint: Path, tmp_path: Path) -> None:
        run(paint, tmp_path / "e", "artist")
        content = json.loads((tmp_path / "e" / "AA11_properties.json").read_text(encoding="utf-8"))
        kinematics = content["kinematics_properties"]
        assert content["initial_orientation"] == [0.0, -1.0, 0.0]
        assert (content["width"], content["height"]) == (3.22, 2.56)
        assert {"joint_translation_e_1", "joint_translation_u_2", "concentrator_translation_n"} <= set(kinematics)
        actuator = kinematics["actuators"][1]
        assert {"type_axis", "min_increment", "max_increment", "increment", "initial_stroke_length"} <= set(actuator)
        assert {"offset", "pivot_radius", "initial_angle", "clockwise_axis_movement"} <= set(actuator)
        assert kinematics["first_joint_tilt_n"] != 0


def test_no_results_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no heliostat\.json here or one folder below"):
        run(tmp_path, tmp_path / "e", "controllers")


def test_earlier_exports_are_replaced_only_when_asked(paint: Path, tmp_path: Path) -> None:
    run(paint, tmp_path / "e", "artist")
    with pytest.raises(InputError, match="force=True"):
        run(paint, tmp_path / "e", "artist")
    run(paint, tmp_path / "e", "artist", ExportOptions(force=True))


def test_a_form_that_no_heliostat_has_is_refused(paint: Path, tables: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no heliostat turns about azimuth and elevation"):
        run(paint, tmp_path / "e", "controllers")
    with pytest.raises(InputError, match="no heliostat has linear actuators"):
        run(tables, tmp_path / "e", "artist")
    assert not (tmp_path / "e").exists()


def test_the_table_is_of_today_where_no_day_is_named(paint: Path, tmp_path: Path) -> None:
    earliest = datetime.datetime.now(datetime.UTC).date()
    names = run(paint, tmp_path / "e", "table", ExportOptions(step_minutes=60.0))
    latest = datetime.datetime.now(datetime.UTC).date()
    assert names[1] in {f"corrections_AA11_{day}.csv" for day in (earliest, latest)}
