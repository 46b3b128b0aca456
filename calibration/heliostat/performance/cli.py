"""``heliogauge heliostat test`` and ``sheet``: tests of a heliostat, its data sheet."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from heliogauge.running.commands import AsJson, Force, NoReport, OutFolder, Quiet, Verbose, deliver, make_app

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
        _all_tests
    )
    for name, summary in _SUMMARIES.items():
        tests.command(name.replace("_", "-"), help=f"{summary} The section [{name}] of measurement.toml alone.")(
            _one(name)
        )


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
    force: Force = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Make a data sheet of each heliostat: a page and a PDF, sheet.csv, summary.json."""
    from calibration.heliostat.performance.pipeline.make_sheet import SheetOptions, run
    from heliogauge.running.terminal import terminal_progress

    progress = terminal_progress(quiet=quiet, verbose=verbose)
    options = SheetOptions(limits, pdf)
    job = lambda: run(results, options, progress)  # noqa: E731
    deliver(out, job, progress, force=force, quiet=quiet, report=False, as_json=as_json)


def _all_tests(
    folder: TestsFolder,
    out: OutFolder,
    force: Force = False,
    no_report: NoReport = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    _run(folder, out, None, force=force, no_report=no_report, as_json=as_json, quiet=quiet, verbose=verbose)


def _one(name: "TestName"):  # type: ignore[no-untyped-def]  # noqa: ANN202
    def command(
        folder: TestsFolder,
        out: OutFolder,
        force: Force = False,
        no_report: NoReport = False,
        as_json: AsJson = False,
        quiet: Quiet = False,
        verbose: Verbose = False,
    ) -> None:
        _run(folder, out, name, force=force, no_report=no_report, as_json=as_json, quiet=quiet, verbose=verbose)

    return command


def _run(
    folder: Path,
    out: Path,
    only: "TestName | None",
    *,
    force: bool,
    no_report: bool,
    as_json: bool,
    quiet: bool,
    verbose: bool,
) -> None:
    from calibration.heliostat.performance.keys import load_tests
    from calibration.heliostat.performance.pipeline.run_tests import Options, run
    from heliogauge.running.terminal import terminal_progress

    progress = terminal_progress(quiet=quiet, verbose=verbose)
    deliver(
        out,
        lambda: run(load_tests(folder), Options(only), progress),
        progress,
        force=force,
        quiet=quiet,
        report=not no_report,
        as_json=as_json,
        hint="; `heliogauge heliostat sheet` makes the data sheet of it",
    )
