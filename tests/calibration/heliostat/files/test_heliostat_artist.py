"""Exports for ARTIST: its own equations, written apart, send the beam where the calibrated model does."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from calibration.heliostat.exports.artist_model import artist_heliostat
from calibration.heliostat.exports.working_range import WorkingRange
from calibration.heliostat.files.store_artist import properties_content, write_scenario_groups
from calibration.heliostat.files.store_heliostat import read_heliostat, stored_site
from calibration.heliostat.keys import load_heliostat
from calibration.heliostat.kinematic_model.kinematics import mirror_poses
from calibration.heliostat.kinematic_model.presets import ideal_actuators, linear_actuators, with_drive_terms
from calibration.heliostat.kinematic_model.store_design import design_from
from calibration.heliostat.pipeline.export import ExportOptions, run
from calibration.heliostat.pipeline.field import run_into
from calibration.heliostat.pipeline.measure import Options
from heliogauge.errors import InputError
from heliogauge.geometry.rays import reflect
from heliogauge.geometry.sun import Site
from heliogauge.results.tables import read_table_csv
from tests.calibration import artist_equations as artist
from tests.calibration.heliostat_folders import ACTUATORS, TARGET, write_paint

SITE = Site(37.4, -6.2, 20.0)
PLANT = (SITE.latitude_deg, SITE.longitude_deg, SITE.altitude_m)
READINGS = np.array([[20000.0, 30000.0], [40000.0, 50000.0], [60000.0, 20000.0], [35000.0, 41000.0]])


def heliostat(*, sag: float = 0.0, worm: float = 0.0) -> Any:
    """Return a heliostat with every number that ARTIST has away from zero, and with terms that it does not have."""
    design = linear_actuators(
        "AA11", [25.0, 60.0, 1.5], ACTUATORS, joints_m=((0.02, -0.03, 0.04), (0.05, 0.06, 0.315))
    ).with_value(
        {
            "tilt_1_n": 0.009,
            "tilt_1_u": -0.03,
            "tilt_2_e": 0.006,
            "tilt_2_n": -0.004,
            "concentrator_e": 0.01,
            "concentrator_n": -0.2,
            "concentrator_u": -0.1,
        }
    )
    if not (sag or worm):
        return design
    design = with_drive_terms(design, 0, ("sag", "worm"), worm_ratio=40.0)
    return design.with_value({"sag_1": sag, "worm_sin_1": worm})


def ranges(design: Any) -> tuple[WorkingRange, WorkingRange]:
    points = [TARGET.center_m]
    return (
        WorkingRange.of(design, SITE, points),
        WorkingRange.of(design, SITE, points, day_of_month=25, per_day=11),
    )


def differences(theirs: artist.Artist, design: Any, at: WorkingRange) -> Any:
    """Return by how much beams of ARTIST's equations differ from the model's, of the same readings and suns [rad]."""
    normals, centres = theirs.mirror(at.readings)
    poses = mirror_poses(design, design.parameters.values, at.readings, at.approach)
    ours = reflect(-at.suns, poses.normals(design))
    apart = centres - poses.centre_m
    distance = np.linalg.norm(at.aim_points_m - poses.centre_m, axis=1, keepdims=True)
    across = apart - np.sum(apart * ours, axis=1, keepdims=True) * ours
    return np.linalg.norm(reflect(-at.suns, normals) - ours + across / distance, axis=1)


def written(design: Any, folder: Path) -> artist.Artist:
    write_scenario_groups({design.name: design}, folder)
    with h5py.File(folder / "artist_heliostats.h5") as file:
        return artist.from_scenario(file, design.name)


@pytest.mark.parametrize("clockwise", [(False, True), (True, False)])
def test_where_nothing_is_lost_the_mirror_is_the_same_to_rounding(tmp_path: Path, clockwise: tuple[bool, bool]) -> None:
    actuators = tuple(replace(one, clockwise=sense) for one, sense in zip(ACTUATORS, clockwise, strict=True))
    known = heliostat()
    design = linear_actuators("AA11", [25.0, 60.0, 1.5], (actuators[0], actuators[1]))
    design = design.with_value(dict(zip(known.parameters.names, known.parameters.values.tolist(), strict=True)))
    said = artist_heliostat(design, *ranges(heliostat()), with_tilts=True)
    normals, centres = written(said.design, tmp_path).mirror(READINGS)
    poses = mirror_poses(design, design.parameters.values, READINGS)
    assert np.abs(normals - poses.normals(design)).max() < 1e-9
    assert np.abs(centres - poses.centre_m).max() < 1e-9
    assert said.loss.largest_rad < 1e-9


def test_ideal_actuators_turn_the_mirror_as_artist_does() -> None:
    """Axis 1 about east and axis 2 about up, from the mirror that looks south; -pi/2 and 0 is the zenith."""
    position, joints, concentrator = [25.0, 60.0, 1.5], ((0.02, -0.03, 0.04), (0.05, 0.06, 0.3)), (0.0, 0.17, 0.1)
    counts = [(0.0, 69525.0), (0.0, 74920.0)]
    design = ideal_actuators("AC43", position, counts, concentrator_m=concentrator, joints_m=joints)
    names = ("first_joint_translation", "second_joint_translation", "concentrator_translation")
    moved = {
        f"{name}_{axis}": value
        for name, shift in zip(names, (*joints, concentrator), strict=True)
        for axis, value in zip("enu", shift, strict=True)
    }
    tilts = ("first_joint_tilt_n", "first_joint_tilt_u", "second_joint_tilt_e", "second_joint_tilt_n")
    ideal = artist.IdealActuator()
    theirs = artist.Artist(np.array(position), moved | dict.fromkeys(tilts, 0.0), (ideal, ideal))
    readings = np.array([[-np.pi / 2, 0.0], [0.0, 0.0], [-0.4, 0.7], [-1.1, -0.9]])
    normals, centres = theirs.mirror(readings)
    poses = mirror_poses(design, design.parameters.values, readings)
    np.testing.assert_allclose(poses.normals(design), normals, atol=1e-15)
    np.testing.assert_allclose(poses.centre_m, centres, atol=1e-14)
    np.testing.assert_allclose(poses.normals(design)[:2], [[0.0, 0.0, 1.0], [0.0, -1.0, 0.0]], atol=1e-15)
    # Limits in counts say nothing of angles; those in radians hold.
    np.testing.assert_array_equal(design.limits, [[-2 * np.pi, 2 * np.pi]] * 2)
    own = ideal_actuators("AC43", position, [(-1.6, 0.1), (-0.96, 0.92)])
    np.testing.assert_array_equal(own.limits, [[-1.6, 0.1], [-0.96, 0.92]])


@pytest.mark.parametrize("tilt", ["tilt_1_n", "tilt_2_n"])
def test_a_turn_about_north_of_the_wrong_hand_is_noticed(tmp_path: Path, tilt: str) -> None:
    design = heliostat()
    said = artist_heliostat(design, *ranges(design), with_tilts=True).design
    wrong = said.with_value({tilt: -said.parameters.value(tilt)})
    assert differences(written(wrong, tmp_path), design, ranges(design)[1]).max() > 2e-3


@pytest.mark.slow
def test_what_is_lost_is_what_is_stated(tmp_path: Path) -> None:
    """The sag goes into the actuators' numbers (dropped it would be 4 mrad); of a short wave something remains."""
    for sag, worm, most in ((2.3e-3, 0.0, 5e-6), (2.3e-3, 3e-4, 1e-3)):
        design = heliostat(sag=sag, worm=worm)
        fitted_on, judged_on = ranges(design)
        said = artist_heliostat(design, fitted_on, judged_on, with_tilts=True)
        theirs = written(said.design, tmp_path)
        found = differences(theirs, design, judged_on)
        assert said.loss.rms_rad == pytest.approx(np.sqrt(np.mean(found**2)), abs=1e-9)
        assert said.loss.largest_rad == pytest.approx(found.max(), abs=1e-9)
        assert said.loss.rms_rad < most
        # On a third set of suns the stated loss holds: of a smooth term by its maximum, 1.1 for suns between those.
        others = WorkingRange.of(design, SITE, [TARGET.center_m], day_of_month=3, per_day=9)
        assert differences(theirs, design, others).max() < 1.1 * said.loss.largest_rad


def test_backlash_is_lost_and_stated(tmp_path: Path) -> None:
    design = with_drive_terms(heliostat(), 1, ("backlash",)).with_value({"backlash_2": 4e-4})
    said = artist_heliostat(design, *ranges(design), with_tilts=True)
    # Half of it from either side, twice in the beam, less where the beam leaves along the axis.
    assert 2e-4 < said.loss.rms_rad < 4e-4


def test_a_properties_file_has_no_tilts_and_says_what_that_costs() -> None:
    design = heliostat()
    fitted_on, judged_on = ranges(design)
    said = artist_heliostat(design, fitted_on, judged_on, with_tilts=False)
    site = {"latitude_deg": PLANT[0], "longitude_deg": PLANT[1], "altitude_m": PLANT[2]}
    content = json.loads(json.dumps(properties_content({"site": site}, said.design)))
    theirs = artist.from_properties(content, PLANT)
    assert not [name for name in content["kinematics_properties"] if "tilt" in name]
    # A latitude in degrees has 1e-9 m.
    np.testing.assert_allclose(theirs.position, design.position_m, atol=1e-8)
    found = differences(theirs, design, judged_on)
    assert said.loss.rms_rad == pytest.approx(np.sqrt(np.mean(found**2)), abs=2e-9)
    assert said.loss.rms_rad > 1e-3


def test_a_tilt_about_east_is_no_loss_without_tilts() -> None:
    design = linear_actuators("AA11", [25.0, 60.0, 1.5], ACTUATORS).with_value({"tilt_2_e": 0.006})
    assert artist_heliostat(design, *ranges(design), with_tilts=False).loss.largest_rad < 1e-9


class TestFiles:
    @pytest.fixture(scope="class")
    def paint(self, tmp_path_factory: pytest.TempPathFactory) -> Path:
        """Results of one heliostat with linear actuators."""
        folder = tmp_path_factory.mktemp("paint")
        write_paint(folder, observations=24)
        run_into(load_heliostat(folder), folder / "out", Options(thorough=False))
        return folder / "out"

    def test_the_export_of_a_calibration_is_the_calibration(self, paint: Path, tmp_path: Path) -> None:
        run(paint, tmp_path / "e", "artist")
        content = read_heliostat(paint)
        design = design_from(content["design"], content["parameters"], key="value")
        with h5py.File(tmp_path / "e" / "artist_heliostats.h5") as file:
            theirs = artist.from_scenario(file, "AA11")
        table = read_table_csv(tmp_path / "e" / "exported.csv")
        row = table["file"].index("artist_heliostats.h5")
        points = [one["center_m"] for one in content["targets"].values()]
        at = WorkingRange.of(design, stored_site(content), points, day_of_month=25, per_day=11)
        found = 1e3 * differences(theirs, design, at)
        # The file has six digits behind the point.
        assert found.max() <= float(table["loss_largest_mrad"][row]) + 1e-6
        assert np.sqrt(np.mean(found**2)) <= float(table["loss_rms_mrad"][row]) + 1e-6
        assert 0 < float(table["loss_rms_mrad"][row]) < 0.01

    def test_a_file_that_loses_too_much_is_refused_and_listed(self, paint: Path, tmp_path: Path) -> None:
        strict = run(paint, tmp_path / "strict", "artist", ExportOptions(limit_rad=1e-4))
        assert "AA11_properties.json" not in strict.names
        assert [one.code for one in strict.doubts] == ["export_refused"]
        table = read_table_csv(tmp_path / "strict" / "exported.csv")
        row = table["file"].index("AA11_properties.json")
        assert table["status"][row] == "refused"
        assert "has no place in it for the tilts" in table["reason"][row]
        lost = 1e-3 * float(table["loss_rms_mrad"][row])
        wide = run(paint, tmp_path / "wide", "artist", ExportOptions(limit_rad=1.01 * lost))
        assert "AA11_properties.json" in wide.names
        assert not wide.doubts

    def test_where_everything_is_refused_nothing_is_written(self, paint: Path, tmp_path: Path) -> None:
        content = read_heliostat(paint)
        for target in content["targets"].values():
            # Below the ground in the north, where no mirror of this heliostat can send a beam.
            target["center_m"] = [0.0, 4000.0, -4000.0]
        (tmp_path / "r").mkdir()
        (tmp_path / "r" / "heliostat.json").write_text(json.dumps(content))
        with pytest.raises(InputError, match="no target can be served over a year"):
            run(tmp_path / "r", tmp_path / "e", "artist")
        assert not (tmp_path / "e").exists()

    def test_keys_are_those_that_artist_reads(self, paint: Path, tmp_path: Path) -> None:
        run(paint, tmp_path / "e", "artist", ExportOptions(limit_rad=1.0))
        content = json.loads((tmp_path / "e" / "AA11_properties.json").read_text(encoding="utf-8"))
        kinematics = content["kinematics_properties"]
        assert content["initial_orientation"] == [0.0, -1.0, 0.0]
        assert (content["width"], content["height"]) == (3.22, 2.56)
        assert {"joint_translation_e_1", "joint_translation_u_2", "concentrator_translation_n"} <= set(kinematics)
        actuator = kinematics["actuators"][1]
        assert {"type_axis", "min_increment", "max_increment", "increment", "initial_stroke_length"} <= set(actuator)
        assert {"offset", "pivot_radius", "initial_angle", "clockwise_axis_movement"} <= set(actuator)
