"""Nothing that was given is lost in silence: heliostats without files, heliostats twice, rows that cannot be read."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from calibration.heliostat.fitting.priors import PRIORS
from calibration.heliostat.keys import load_heliostat
from calibration.heliostat.kinematic_model.presets import azimuth_elevation, with_drive_terms
from calibration.heliostat.pipeline.measure import Options, Result, run
from heliogauge.errors import EstimationError
from heliogauge.measurement.writer import dump_toml
from heliogauge.results.tables import read_table_csv, write_table_csv
from tests.calibration.heliostat_folders import CONTENT, SIGMA_M, sightings, write_field, write_paint

QUICK = Options(thorough=False, model="4", jobs=1)


def measured(folder: Path, options: Options = QUICK) -> Result:
    return run(load_heliostat(folder), options)


class TestPaint:
    def test_a_folder_without_properties_has_its_row(self, tmp_path: Path) -> None:
        write_paint(tmp_path, names=("AA11", "AA12"), observations=12)
        (tmp_path / "AA12" / "AA12_properties.json").unlink()
        result = measured(tmp_path)
        assert [(row["heliostat"], row["status"]) for row in result.rows] == [("AA11", "ok"), ("AA12", "failed")]
        assert "no properties (*_properties.json) beside its calibration records" in result.rows[1]["reason"]

    def test_a_broken_properties_file_has_its_row(self, tmp_path: Path) -> None:
        write_paint(tmp_path, names=("AA11", "AA12"), observations=12)
        (tmp_path / "AA12" / "AA12_properties.json").write_text('{"heliostat_pos', encoding="utf-8")
        row = measured(tmp_path).rows[1]
        assert (row["heliostat"], row["status"]) == ("AA12", "failed")
        assert "not valid JSON" in row["reason"]

    def test_a_heliostat_that_is_there_twice_has_its_row(self, tmp_path: Path) -> None:
        write_paint(tmp_path, names=("AA11", "AA12"), observations=12)
        shutil.copytree(tmp_path / "AA12", tmp_path / "copy of AA12")
        row = measured(tmp_path).rows[1]
        assert (row["heliostat"], row["status"]) == ("AA12", "failed")
        assert "it is there twice" in row["reason"]

    def test_a_record_that_is_cut_off_is_a_doubt(self, tmp_path: Path) -> None:
        """One of 60 is too few to make the others doubtful, and no less something that happened to the files."""
        write_paint(tmp_path, observations=60)
        record = next((tmp_path / "AA11" / "calibration").iterdir())
        record.write_text(record.read_text(encoding="utf-8")[:40], encoding="utf-8")
        (doubt,) = (one for one in measured(tmp_path).doubts if one.code == "rows_left_out")
        assert "1 of 60 rows left out (unreadable)" in doubt.text


class TestTables:
    def test_a_heliostat_that_is_listed_twice_has_its_row(self, tmp_path: Path) -> None:
        write_field(tmp_path, heliostats=2, observations=12)
        with (tmp_path / "heliostats.csv").open("a", encoding="utf-8") as file:
            file.write("H2,1,80,2\n")
        result = measured(tmp_path, Options(thorough=False, model="5", jobs=1))
        assert [row["heliostat"] for row in result.rows] == ["H1", "H2"]
        assert "it is listed 2 times, in lines 3, 4; keep one row" in result.rows[1]["reason"]

    @pytest.mark.parametrize("heliostats", [1, 2])
    @pytest.mark.parametrize(
        ("line", "why"),
        [
            (b",2026-06-21T10:00:00Z,0.5,0.25,north face,0,0,20\n", "name is missing"),
            (b"\xff\xfe1,2026-06-21T10:00:00Z,0.5,0.25,north face,0,0,20\n", "no UTF-8"),
            (b"H1," + b"7" * (1 << 20) + b"7\n", "longer than 1048576 bytes"),
        ],
    )
    def test_rows_of_no_heliostat_are_counted(self, tmp_path: Path, heliostats: int, line: bytes, why: str) -> None:
        write_field(tmp_path, heliostats=heliostats, observations=12)
        file = tmp_path / "observations.csv"
        lines = file.read_bytes().splitlines(keepends=True)
        file.write_bytes(b"".join([*lines[:5], line, *lines[5:]]))
        result = measured(tmp_path, Options(thorough=False, model="5", jobs=1))
        (doubt,) = (one for one in result.summarise().doubts if one.code == "rows_without_heliostat")
        assert "1 rows belong to no heliostat" in doubt.text
        assert f"line 6: {why}" in doubt.text or why in doubt.text
        # The rows below it are read as ever.
        assert {row["used_count"] for row in result.rows} == {12}


class TestTerms:
    """A term of the drives that measurement.toml names is free."""

    def write(self, folder: Path, kinematics: dict[str, object]) -> None:
        write_field(folder, observations=60)
        (folder / "measurement.toml").write_text(
            dump_toml({**CONTENT, "kinematics": {"preset": "azimuth-elevation", **kinematics}}), encoding="utf-8"
        )
        table = read_table_csv(folder / "observations.csv")
        place = [float(read_table_csv(folder / "heliostats.csv")[name][0]) for name in ("e_m", "n_m", "u_m")]
        truth = with_drive_terms(azimuth_elevation("H1", place), 0, ("worm",), worm_ratio=30.0)
        seen = sightings(truth.with_value({"worm_sin_1": 3e-3}), 60, np.random.default_rng(3))
        table["axis_1_rad"] = [repr(one) for one in seen.readings[:, 0].tolist()]
        table["axis_2_rad"] = [repr(one) for one in seen.readings[:, 1].tolist()]
        table["x_m"], table["y_m"] = ([repr(one) for one in seen.xy_m[:, axis].tolist()] for axis in (0, 1))
        write_table_csv(folder / "observations.csv", table)

    @pytest.mark.parametrize("model", [None, "5"])
    def test_a_named_term_is_free_within_its_usual_prior(self, tmp_path: Path, model: str | None) -> None:
        self.write(tmp_path, {"terms": ["worm"], "worm_ratio": 30.0})
        result = measured(tmp_path, Options(thorough=False, model=model, jobs=1))
        fit = result.heliostats[0].fit
        index = fit.design.parameters.index("worm_sin_1")
        assert fit.nominal.parameters.sigmas[index] == PRIORS["worm_sin_1"].sigma
        assert 0 < fit.sigma[index] < 5e-4
        assert abs(fit.values[index] - 3e-3) < 4 * fit.sigma[index]
        # Spots of 2 cm at 100 m.
        assert fit.residuals.beam_angle_rad.max() < 8 * SIGMA_M / 60

    def test_a_term_that_is_held_stays_held(self, tmp_path: Path) -> None:
        held = {name: {"sigma": 0.0} for name in ("worm_sin_1", "worm_cos_1", "worm_sin_2", "worm_cos_2")}
        self.write(tmp_path, {"terms": ["worm"], "worm_ratio": 30.0, "parameters": held})
        result = measured(tmp_path, Options(thorough=False, model="5", jobs=1))
        assert result.heliostats[0].fit.design.parameters.value("worm_sin_1") == 0.0


class TestImpossible:
    @pytest.mark.slow
    def test_what_nothing_explains_is_refused_with_what_was_tried(self, tmp_path: Path) -> None:
        """Readings of another machine: hundreds of milliradians, and no result."""
        write_field(tmp_path, observations=40)
        table = read_table_csv(tmp_path / "observations.csv")
        rng = np.random.default_rng(2)
        for axis in (1, 2):
            table[f"axis_{axis}_rad"] = [repr(one) for one in rng.permutation(np.linspace(-1.4, 1.4, 40)).tolist()]
        write_table_csv(tmp_path / "observations.csv", table)
        with pytest.raises(EstimationError, match=r"no known fault explains it.* were tried, the nearest"):
            measured(tmp_path, Options(thorough=False, model="5", jobs=1))

    @pytest.mark.slow
    def test_a_latitude_of_the_wrong_sign_is_named_and_undone(self, tmp_path: Path) -> None:
        write_field(tmp_path, observations=60)
        content = {**CONTENT, "site": {**CONTENT["site"], "latitude_deg": -CONTENT["site"]["latitude_deg"]}}
        (tmp_path / "measurement.toml").write_text(dump_toml(content), encoding="utf-8")
        (one,) = measured(tmp_path, Options(thorough=False, model="5", jobs=1)).heliostats
        assert one.diagnosis.kinds == ("site",)
        assert one.fit.residuals.beam_angle_rad.max() < 8 * SIGMA_M / 60
        assert np.median(one.as_stated.residuals.beam_angle_rad) > 0.01
