"""The command line says what the pipeline says: flags and `Options` agree in name and default."""

import dataclasses
import math
import tomllib
from enum import Enum
from importlib import import_module
from typing import Any

import pytest
import typer

from heliogauge.instruments import Instrument, instruments, resolve
from heliogauge.running import cli, commands
from tests.architecture.source_tree import PACKAGES, REPOSITORY

#: Pipelines, whose Options must agree with the flags of an instrument's ``measure``.
PIPELINES = {
    "deflectometry.pipeline.measure": "deflectometry",
    "deflectometry.poses.pipeline.measure": "deflectometry",
    "deflectometry.dots.pipeline.measure": "deflectometry",
    "deflectometry.dots.series.pipeline.measure": "deflectometry",
    "deflectometry.scans.pipeline.measure": "deflectometry",
    "deflectometry.laser.pipeline.measure": "deflectometry",
    "deflectometry.gazing.pipeline.measure": "deflectometry",
    "deflectometry.stars.pipeline.measure": "deflectometry",
    "photogrammetry.pipeline.measure": "photogrammetry",
    "observer.pipeline.measure": "observer",
    "calibration.screen.pipeline": "screen",
    "calibration.camera.pipeline.measure": "camera",
    "calibration.beam.pipeline.measure": "beam",
    "calibration.heliostat.pipeline.measure": "heliostat",
}

#: Units of the command line, and what they are in the pipeline.
UNITS = {"_mm": ("_m", 1e-3), "_mrad": ("_rad", 1e-3), "_deg": ("_rad", math.pi / 180)}


def differences(options: type[Any], parameters: dict[str, Any]) -> list[str]:
    """Compare the fields of Options with a command's parameters (name -> default); return what differs."""
    found = []
    fields = {field.name: _default(field) for field in dataclasses.fields(options)}
    for name, default in parameters.items():
        if name in commands.COMMON_PARAMETERS and name not in fields:
            continue
        field, value = _in_pipeline_units(name, default) if name not in fields else (name, default)
        if field not in fields:
            found.append(f"--{name.replace('_', '-')} has no field in Options")
        elif not _same(value, fields[field]):
            found.append(f"--{name.replace('_', '-')} is {value!r} by default, Options.{field} is {fields[field]!r}")
    seen = {_in_pipeline_units(name, None)[0] for name in parameters} | parameters.keys()
    return found + [f"Options.{name} has no flag" for name in fields if name not in seen]


def _default(field: Any) -> Any:
    return field.default_factory() if field.default_factory is not dataclasses.MISSING else field.default


def _in_pipeline_units(name: str, value: Any) -> tuple[str, Any]:
    for suffix, (other, factor) in UNITS.items():
        if name.endswith(suffix):
            return name.removesuffix(suffix) + other, value * factor if isinstance(value, int | float) else value
    return name, value


def _same(one: Any, other: Any) -> bool:
    one, other = (value.value if isinstance(value, Enum) else value for value in (one, other))
    if isinstance(one, float) and isinstance(other, int | float):
        return math.isclose(one, other, rel_tol=1e-12)
    return bool(one == other)


def parameters_of(instrument: str) -> dict[str, Any]:
    """Return names and defaults of the parameters of an instrument's ``measure``."""
    # As pyproject.toml has it: the installed list may be that of another tree.
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    home = project["entry-points"]["heliogauge.instruments"][instrument]
    command = cli.group_of(resolve(home)).commands["measure"]
    return {parameter.name: parameter.default for parameter in command.params if parameter.name != "help"}


@pytest.mark.parametrize("pipeline", PIPELINES)
def test_flags_and_options_agree(pipeline: str) -> None:
    options = import_module(pipeline).Options
    found = differences(options, parameters_of(PIPELINES[pipeline]))
    assert not found, "\n".join(found)


def test_every_pipeline_is_compared() -> None:
    existing = {
        ".".join(path.relative_to(REPOSITORY).with_suffix("").parts)
        for package in PACKAGES
        for path in (REPOSITORY / package).rglob("*.py")
        if path.name == "pipeline.py" or path.parts[-2:] == ("pipeline", "measure.py")
        # A kind without choices has no Options; its command refuses flags.
        if "Options" in path.read_text(encoding="utf-8")
    }
    assert existing == set(PIPELINES)


@pytest.mark.parametrize("instrument", instruments(), ids=lambda one: one.name)
def test_what_is_mounted_exists(instrument: Instrument) -> None:
    assert isinstance(resolve(instrument.commands), typer.Typer)


class Removal(Enum):
    NOTHING = "nothing"


@dataclasses.dataclass(frozen=True)
class Example:
    grid_step_m: float | None = None
    limit_rad: float = 0.002
    remove: Removal = Removal.NOTHING


@pytest.mark.parametrize(
    ("parameters", "wanted"),
    [
        ({"folder": None, "grid_step_mm": None, "limit_mrad": 2.0, "remove": "nothing"}, []),
        ({"grid_step_mm": 1.0, "limit_mrad": 2.0, "remove": "nothing"}, ["--grid-step-mm is 0.001"]),
        ({"grid_step_mm": None, "limit_mrad": 0.002, "remove": "nothing"}, ["--limit-mrad is 2e-06"]),
        ({"grid_step_mm": None, "limit_mrad": 2.0, "remove": "tilt"}, ["--remove is 'tilt'"]),
        ({"grid_step_mm": None, "limit_mrad": 2.0}, ["Options.remove has no flag"]),
        ({"grid_step_mm": None, "limit_mrad": 2.0, "remove": "nothing", "else": 1}, ["--else has no field"]),
    ],
)
def test_the_comparison_itself(parameters: dict[str, Any], wanted: list[str]) -> None:
    """Negative controls."""
    found = differences(Example, parameters)
    assert len(found) == len(wanted)
    assert all(text.startswith(start) for text, start in zip(found, wanted, strict=True))
