"""What measurement.toml may say of heliostats: the template is true, and mistakes are named with their remedy."""

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from calibration.heliostat.keys import load_heliostat
from heliogauge.errors import InputError
from heliogauge.measurement.load import load, parse_measurement
from heliogauge.measurement.templates import write_template
from heliogauge.measurement.writer import dump_toml

Content = dict[str, Any]
FILE = Path("measurement.toml")


@pytest.fixture
def content(tmp_path: Path) -> Content:
    return tomllib.loads(write_template("heliostat", tmp_path).read_text(encoding="utf-8"))


def test_template_loads_with_its_tables(content: Content, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no file heliostats\.csv"):
        load_heliostat(tmp_path)
    (tmp_path / "heliostats.csv").touch()
    (tmp_path / "observations.csv").touch()
    measurement = load_heliostat(tmp_path)
    assert [file.name for file in measurement.input_files] == ["measurement.toml", "heliostats.csv", "observations.csv"]
    assert measurement.model.target[0].facing_azimuth_deg == content["target"][0]["facing_azimuth_deg"]


def test_every_optional_key_of_the_template_is_a_real_key(tmp_path: Path) -> None:
    text = write_template("heliostat", tmp_path).read_text(encoding="utf-8")
    # Places that offer an alternative instead of an addition: keep one side.
    text = text.replace("#: corners_m", "# ").replace("#: [paint]", "# ").replace('#: folder = "."', "# ")
    content = tomllib.loads(text.replace("#: ", ""))
    model: Any = parse_measurement(content, FILE)
    assert dict(model.kinematics.parameters)["tilt_north"].sigma == 0.005
    assert model.kinematics.worm_ratio == (30.0, 30.0)
    assert model.images[0].corners_px[1] == (1180.0, 90.0)
    assert model.images[0].corners_sigma_px == 0.3


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        (lambda c: c.pop("site"), r"\[site\] is missing: latitude_deg"),
        (lambda c: c["site"].update(latitude_deg=137.0), r"site\.latitude_deg = 137\.0"),
        (lambda c: c["site"].update(latitude=37.0), r"did you mean 'latitude_deg'"),
        (lambda c: c["target"][0].pop("width_m"), r"width_m is missing; or give the four corners_m"),
        (
            lambda c: c["target"][0].update(corners_m=[[0.0, 0.0, 0.0]] * 4),
            r"corners define the target, and so does c",
        ),
        (lambda c: c["target"].append(c["target"][0]), r"target 'target' is described twice"),
        (lambda c: c["kinematics"].update(preset="azimuth"), r"kinematics\.preset = 'azimuth': say"),
        (lambda c: c["kinematics"].update(terms=["worm"]), r"worm_ratio is needed"),
        (lambda c: c["kinematics"].update(preset="two-axes"), r'belong to preset = "two-axes"'),
        (lambda c: c["kinematics"].update(parameters={"a": {"sigma": -1.0}}), r"sigma = -1\.0: a value not below 0"),
        (lambda c: c.update(paint={}), r"\[paint\] names the data, and so does \[heliostats\]"),
        (lambda c: c.update(images=[{"target": "target"}]), r"one of whole, .* not nothing"),
        (
            lambda c: c.update(images=[{"target": "target", "whole": "edge", "anchors_px": [[1.0, 1.0]] * 4}]),
            r"anchors_px are .* pictures of markers, which are missing",
        ),
        (lambda c: c.update(evaluation={"split": "chronologic"}), r"split = 'chronologic': say"),
    ],
)
def test_mistakes_name_key_value_and_remedy(content: Content, change: Callable[[Content], Any], wanted: str) -> None:
    change(content)
    with pytest.raises(InputError, match=wanted):
        parse_measurement(content, FILE)


class TestPaintFolder:
    def test_needs_no_measurement_file(self, tmp_path: Path) -> None:
        (tmp_path / "AA39").mkdir()
        (tmp_path / "AA39" / "AA39_properties.json").touch()
        for folder in (tmp_path, tmp_path / "AA39"):
            measurement = load_heliostat(folder)
            assert measurement.model.paint is not None
            assert measurement.model.name == folder.name
            assert measurement.input_files == ()

    def test_is_recognised_among_all_kinds(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="there is no such file; write one with `heliogauge INSTRUMENT init"):
            load(tmp_path)
        (tmp_path / "AA39_properties.json").touch()
        assert load(str(tmp_path)).has_file is False

    def test_calibrations_alone_are_none(self, tmp_path: Path) -> None:
        (tmp_path / "1_calibration_properties.json").touch()
        with pytest.raises(InputError, match="heliogauge heliostat init"):
            load_heliostat(tmp_path)

    def test_a_measurement_file_may_set_the_evaluation(self, tmp_path: Path) -> None:
        content = {"kind": "heliostat", "name": "x", "paint": {"folder": "."}, "evaluation": {"split": "azimuth"}}
        (tmp_path / "measurement.toml").write_text(dump_toml(content), encoding="utf-8")
        (tmp_path / "AA39_properties.json").touch()
        assert load_heliostat(tmp_path).model.evaluation.split == "azimuth"
