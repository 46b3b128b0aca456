"""``heliogauge heliostat test`` and ``sheet``: tests of a heliostat, its data sheet."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from heliogauge.running.commands import Job, OutFolder, make_app, writes_results

if TYPE_CHECKING:
    from calibration.heliostat.performance.keys import TestName

TestsFolder = Annotated[
    Path, typer.Argument(metavar="FOLDER", help="Folder with measurement.toml and what was done.", show_default=False)
]

_SUMMARIES: "dict[TestName, str]" = {
    "day": "Accuracy and precision of tracking over days.",
    "drift": "Drift, oscillation and sawtooth of the beam (solar spot test).",
    "backlash": "Play of the axes: laser on the mirror, or beams at both ends.",
    "repeat": "Repeated approaches of one aim.",
    "wind": "Accuracy of the beam in each class of wind.",
    "sun_camera": "Camera on the mirror that looks at the sun.",
    "reflectance": "Solar-weighted reflectance of spectra, readings of a reflectometer.",
    "quality": "Slopes, canting and shape of the beam from other results.",
    "control": "Log of the controller: states that are due after commands and faults.",
    "power": "Energy that the heliostat used.",
    "given": "Numbers measured elsewhere.",
    "year": "What errors cost over a year: energy lost by each cause, and by one mrad more.",
}


def add_performance(app: typer.Typer) -> None:
    """Add ``test`` and ``sheet`` to the verbs of the heliostat."""
    tests = make_app("Tests of a heliostat for its data sheet; measurement.toml has a section for each.")
    app.add_typer(tests, name="test")
    app.command("sheet")(_sheet)
    tests.command("all", help="All tests that measurement.toml has: summary.json, entries.csv, report.html.")(
        _test(None)
    )
    for name, summary in _SUMMARIES.items():
        tests.command(name.replace("_", "-"), help=f"{summary} The section [{name}] of measurement.toml alone.")(
            _test(name)
        )


@writes_results(report=False)
def _sheet(
    results: Annotated[
        list[Path],
        typer.Argument(metavar="RESULTS...", help="Results of `heliogauge heliostat test`.", show_default=False),
    ],
    out: OutFolder,
    limits: Annotated[
        Path | None,
        typer.Option(metavar="TOML", help="What entries must keep; without it nothing passes or fails."),
    ] = None,
    pdf: Annotated[bool, typer.Option("--pdf/--no-pdf", help="Also make PDF.")] = True,
) -> Job:
    """Make a data sheet of each heliostat: a page and a PDF, sheet.csv, summary.json."""
    from calibration.heliostat.performance.pipeline.make_sheet import SheetOptions, run

    return Job(out, lambda progress: run(results, SheetOptions(limits, pdf), progress))


def _test(only: "TestName | None") -> Callable[..., None]:
    @writes_results()
    def command(folder: TestsFolder, out: OutFolder) -> Job:
        from calibration.heliostat.performance.keys import load_tests
        from calibration.heliostat.performance.pipeline.run_tests import Options, run

        return Job(
            out,
            lambda progress: run(load_tests(folder), Options(only), progress),
            "; `heliogauge heliostat sheet` makes the data sheet of it",
        )

    return command
