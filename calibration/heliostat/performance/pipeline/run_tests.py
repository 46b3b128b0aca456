"""Evaluate the tests of a heliostat: a section of measurement.toml each, all of them or one."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from calibration.heliostat.performance.files.result import Result
from calibration.heliostat.performance.keys import TESTS, HeliostatTests, TestName
from calibration.heliostat.performance.pipeline.beam_tests import day_test, drift_test, repeat_test, wind_test
from calibration.heliostat.performance.pipeline.other_tests import (
    backlash_test,
    control_test,
    given_test,
    power_test,
    reflectance_test,
    sun_camera_test,
)
from calibration.heliostat.performance.pipeline.outcome import Outcome
from calibration.heliostat.performance.pipeline.quality import quality_test
from calibration.heliostat.performance.pipeline.year_costs import year_test
from heliogauge.doubts import gather_doubts
from heliogauge.errors import EstimationError, InputError
from heliogauge.results.folder import hash_files
from heliogauge.running.progress import Progress, SilentProgress

_TEST_OF: dict[TestName, Callable[[HeliostatTests, Any], Outcome]] = {
    "day": day_test,
    "drift": drift_test,
    "backlash": backlash_test,
    "repeat": repeat_test,
    "wind": wind_test,
    "sun_camera": sun_camera_test,
    "reflectance": reflectance_test,
    "quality": quality_test,
    "control": control_test,
    "power": power_test,
    "given": given_test,
}
#: What [year] takes its errors from.
_FOR_YEAR: tuple[TestName, ...] = ("day", "quality", "reflectance")


@dataclass(frozen=True, slots=True)
class Options:
    """Choices of the evaluation.

    only: The one test to evaluate; None: all that measurement.toml has.
    """

    only: TestName | None = None


def run(tests: HeliostatTests, options: Options | None = None, progress: Progress | None = None) -> Result:
    """Evaluate what was done with a heliostat.

    InputError: A test that is not in measurement.toml, or tables that cannot be meant.
    EstimationError: Data that do not determine an answer; the message names the test.
    """
    options, progress = options or Options(), progress or SilentProgress()
    there = [name for name in TESTS if getattr(tests.model, name) is not None]
    if options.only is not None and options.only not in there:
        raise InputError(f"measurement.toml has no section [{options.only}]; there are: {', '.join(there)}")
    wanted = there if options.only is None else [options.only]
    outcomes: dict[TestName, Outcome] = {}
    # The year comes last, and needs others even where it is wanted alone.
    needed = [name for name in there if name in wanted or ("year" in wanted and name in _FOR_YEAR)]
    for name in needed:
        with progress.stage(name.replace("_", " ")):
            try:
                if name == "year" and tests.model.year is not None:
                    known = [entry for one in outcomes.values() for entry in one.entries]
                    outcomes[name] = year_test(tests, tests.model.year, known)
                else:
                    outcomes[name] = _TEST_OF[name](tests, getattr(tests.model, name))
            except EstimationError as error:
                raise EstimationError(f"[{name}] {error}") from None
    chosen = [outcome for name, outcome in outcomes.items() if name in wanted]
    with progress.stage("hash inputs"):
        hashes = hash_files(tests.input_files, tests.folder)
    result = Result(
        entries=tuple(entry for one in chosen for entry in one.entries),
        tables={name: table for one in chosen for name, table in one.tables.items()},
        about=about(tests),
        name=tests.model.name,
        doubts=gather_doubts(*(one.doubts for one in chosen)),
    )
    return replace(result, durations_s=dict(progress.durations_s), input_sha256=hashes)


def about(tests: HeliostatTests) -> dict[str, str]:
    """Return what the data sheet says of heliostat, laboratory and place, in words."""
    model = tests.model
    own, laboratory = model.heliostat, model.laboratory
    said = {
        "laboratory": laboratory.laboratory,
        "operator": laboratory.operator,
        "approved_by": laboratory.approved_by,
        "order": laboratory.order,
        "conditions": laboratory.conditions,
        "date": tests.date,
        "manufacturer": own.manufacturer,
        "model": own.model,
        "year": "" if own.year is None else str(own.year),
        "mirror": "" if own.width_m is None or own.height_m is None else f"{own.width_m:g} m x {own.height_m:g} m",
        "facets": "" if own.facets is None else str(own.facets),
        "focal_length": "" if own.focal_length_m is None else f"{own.focal_length_m:g} m",
        "position": "east {:g} m, north {:g} m, up {:g} m".format(*own.position_m),
        "drive": own.drive,
        "controller": own.controller,
        "glass": own.glass,
        "pedestal": own.pedestal,
        "mass": "" if own.mass_kg is None else f"{own.mass_kg:g} kg",
        "notes": model.notes,
    }
    if model.site is not None:
        said["site"] = f"latitude {model.site.latitude_deg:g}, longitude {model.site.longitude_deg:g} degrees"
    return {key: text for key, text in said.items() if text}
