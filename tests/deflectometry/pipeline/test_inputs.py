"""What measurement.toml says of the mirror reaches the search for its pose."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deflectometry.keys import DeflectometryMeasurement
from deflectometry.pipeline.inputs import build_knowledge, describe_mirror
from deflectometry.setup.camera_and_screen import RectangularScreen, Setup
from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.measurement.load import parse_measurement
from heliogauge.measurement.templates import write_template

SETUP = Setup(Camera(100, 80, 100.0, 100.0, 50.0, 40.0), RectangularScreen(1.0, 1.0), RigidTransform.identity())


@pytest.fixture
def content(tmp_path: Path) -> dict[str, Any]:
    return tomllib.loads(write_template("deflectometry", tmp_path).read_text(encoding="utf-8"))


def test_trust_in_the_outline_and_roll_reach_the_pose(content: dict[str, Any]) -> None:
    content["mirror"] |= {"outline_sigma_mm": 0.25, "roll_deg": -90.0}
    model = parse_measurement(content, Path("measurement.toml"))
    mirror = describe_mirror(DeflectometryMeasurement(Path(), model, ()), SETUP)
    assert mirror.knowledge.sigma_outline_m == pytest.approx(0.25e-3)
    assert mirror.knowledge.roll_rad == pytest.approx(-np.pi / 2)
    assert len(mirror.knowledge.distances) == 1


def test_without_them_the_outline_is_exact_and_the_camera_upright(content: dict[str, Any]) -> None:
    knowledge = build_knowledge(parse_measurement(content, Path("measurement.toml")).mirror, SETUP)
    assert (knowledge.sigma_outline_m, knowledge.roll_rad) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("key", "value", "wanted"),
    [
        ("outline_sigma_mm", -1.0, r"mirror\.outline_sigma_mm = -1\.0: a value not below 0"),
        ("roll_deg", float("nan"), r"mirror\.roll_deg = nan: a finite number"),
        ("outline_sigma_m", 1.0, r"did you mean 'outline_(sigma_m)?m'"),
    ],
)
def test_nonsense_is_refused(content: dict[str, Any], key: str, value: float, wanted: str) -> None:
    content["mirror"][key] = value
    with pytest.raises(InputError, match=wanted):
        parse_measurement(content, Path("measurement.toml"))


def test_periods_that_no_display_shows_are_refused(content: dict[str, Any]) -> None:
    content["pattern"]["set"][0]["periods"] = 1e200
    with pytest.raises(InputError, match=r"periods = 1e\+200: "):
        parse_measurement(content, Path("measurement.toml"))
