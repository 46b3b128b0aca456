"""What every instrument's command line is built from: the common flags, the groups of verbs, and how a command ends.

An instrument exposes ``app: typer.Typer`` with its verbs in its ``cli.py``; `heliogauge.running.cli` mounts it by name
and imports it only when it is called. Flags that mean the same everywhere are the annotated types below, so that they
have one name, one help text and one meaning.
"""

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from inspect import Parameter, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol

import typer

from heliogauge.doubts import Doubt, Severity, heaviest_first
from heliogauge.errors import InputError
from heliogauge.running.help_text import VerbGroup
from heliogauge.running.progress import Progress

if TYPE_CHECKING:
    from heliogauge.results.frame import InstrumentResult

MeasurementFolder = Annotated[
    Path, typer.Argument(metavar="FOLDER", help="Folder with measurement.toml and its images.", show_default=False)
]
EitherFolder = Annotated[
    Path,
    typer.Argument(
        metavar="FOLDER", help="Folder with measurement.toml, or results of such a folder.", show_default=False
    ),
]
ResultsFolder = Annotated[Path, typer.Argument(metavar="OUT", help="Folder with results.", show_default=False)]
NewFolder = Annotated[
    Path, typer.Argument(metavar="FOLDER", help="Measurement folder to write; absent or empty.", show_default=False)
]
OutMeasurement = Annotated[
    Path, typer.Option("-o", "--out", metavar="FOLDER", help="Measurement folder to write.", show_default=False)
]
OutPath = Annotated[
    Path, typer.Option("-o", "--out", metavar="PATH", help="File or folder to write.", show_default=False)
]
OutFolder = Annotated[
    Path, typer.Option("-o", "--out", metavar="DIR", help="Folder for the results.", show_default=False)
]
Force = Annotated[bool, typer.Option("--force", help="Replace an existing result.")]
ForceMeasurement = Annotated[bool, typer.Option("--force", help="Replace an earlier measurement folder.")]
Quiet = Annotated[bool, typer.Option("-q", "--quiet", help="Say nothing but warnings.")]
Verbose = Annotated[bool, typer.Option("-v", "--verbose", help="Say when each stage starts, in plain lines.")]
NoReport = Annotated[
    bool, typer.Option("--no-report", help="Leave out report.html; `heliogauge report` makes it later.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print summary.json on standard output, and nothing else there.")]
FoundAsJson = Annotated[bool, typer.Option("--json", help="Print what was found as JSON, and nothing else there.")]
Jobs = Annotated[
    int | None,
    typer.Option("--jobs", metavar="N", min=1, help="Work side by side on this machine; default: what it has."),
]
Scheduler = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="tcp://HOST:PORT", help="Send the work to an existing Dask cluster."),
]

#: Parameters of a command that are not options of its pipeline.
COMMON_PARAMETERS = frozenset(
    {"folder", "out", "force", "quiet", "verbose", "no_report", "as_json", "jobs", "scheduler"}
)


def make_app(summary: str) -> typer.Typer:
    """Make the group of an instrument's verbs, or of the formats of one of its verbs: plain help, no rich (0.2 s)."""
    app = typer.Typer(
        cls=VerbGroup,
        help=summary,
        rich_markup_mode=None,
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
    )
    # With a callback typer keeps the group even while it holds a single command.
    app.callback()(lambda: None)
    return app


def add_formats(app: typer.Typer, verb: str) -> typer.Typer:
    """Add ``import`` or ``export`` to the verbs of an instrument.

    Returns: The group to which each format is a command.
    """
    formats = make_app(
        {
            "import": "Files of another program become a measurement folder.",
            "export": "Results in the form of another program.",
        }[verb]
    )
    app.add_typer(formats, name=verb)
    return formats


@dataclass(frozen=True, slots=True)
class Job:
    """What a command has to do, and where its result goes.

    out: Folder for the result; written whole or not at all.
    run: Does the work; is called when the folder is known to be usable.
    hint: What can be done with the result.
    measured: Folder that is measured, which the result will name.
    """

    out: Path
    run: Callable[[Progress], "InstrumentResult"]
    hint: str = ""
    measured: Path | None = None


def writes_results(*, report: bool = True) -> Callable[[Callable[..., Job]], Callable[..., None]]:
    """Make a command of a function that returns its job: it does the job, writes the result and says how it ended.

    The command has the parameters of the function, and behind them the flags of all commands that write results.

    report: The results have a report, which ``--no-report`` leaves out.
    """
    flags: dict[str, Any] = {"force": Force} | ({"no_report": NoReport} if report else {})
    flags |= {"as_json": AsJson, "quiet": Quiet, "verbose": Verbose}

    def make(prepare: Callable[..., Job]) -> Callable[..., None]:
        def command(
            *, force: bool, quiet: bool, verbose: bool, as_json: bool, no_report: bool = not report, **own: Any
        ) -> None:
            from heliogauge.results.frame import into_folder
            from heliogauge.running.terminal import terminal_progress

            progress = terminal_progress(quiet=quiet, verbose=verbose)
            job = prepare(**own)
            if job.measured not in (None, *own.values()):
                # Results were given, and have led to it.
                progress.say(f"measured from {job.measured}")
            result = into_folder(
                job.out,
                lambda: job.run(progress),
                progress,
                force=force,
                report=not no_report,
                measured=job.measured,
            )
            say_ending(result, job.out, quiet=quiet, as_json=as_json, hint=job.hint)
            if result.exit_code:
                raise typer.Exit(result.exit_code)

        # Typer reads arguments and options off the signature, and the help off the docstring.
        own = signature(prepare)
        extra = [Parameter(name, Parameter.KEYWORD_ONLY, default=False, annotation=one) for name, one in flags.items()]
        command.__signature__ = own.replace(  # type: ignore[attr-defined]
            parameters=[*own.parameters.values(), *extra], return_annotation=None
        )
        command.__annotations__ = {name: one.annotation for name, one in own.parameters.items()} | flags
        command.__doc__, command.__name__ = prepare.__doc__, prepare.__name__
        return command

    return make


class Ended(Protocol):
    """What came of a command that measures."""

    @property
    def doubts(self) -> tuple[Doubt, ...]:
        """What makes the result doubtful."""

    def headline(self) -> str:
        """Return the most important numbers in a few lines for the terminal."""


def say_ending(result: Ended, out: Path, *, quiet: bool, as_json: bool = False, hint: str = "") -> None:
    """Report how a command ended: doubts on standard error, the numbers and where they are on standard output.

    out: Folder of results that was written.
    quiet: Only doubts are reported.
    as_json: The summary is printed instead of headline and place.
    hint: What can be done with the result.
    """
    say_doubts(result.doubts)
    if as_json:
        from heliogauge.files.texts import read_text
        from heliogauge.results.folder import SUMMARY_FILE

        typer.echo(read_text(out / SUMMARY_FILE).rstrip())
    elif not quiet:
        typer.echo(result.headline())
        typer.echo(f"results: {out}{hint}")


#: What stands before a doubt on the terminal; "error" is kept for what ends a command with exit code 2.
_SEVERITY_WORDS = {Severity.NOTE: "note", Severity.DOUBT: "warning", Severity.SERIOUS: "serious"}


#: How messages name an argument, so that it is right in Python: ``force=True``, ``only=BE36``.
_ARGUMENT = re.compile(r"(?<![\w./`'\"])([a-z][a-z_]+)=(True\b)?")


def on_command_line(message: str) -> str:
    """Respell the arguments that a message names as options.

    >>> on_command_line("facet: holds files already; choose another folder or give force=True to replace results")
    'facet: holds files already; choose another folder or give --force to replace results'
    >>> on_command_line("hold_out=check_*: no photo of that name shows the board")
    '--hold-out check_*: no photo of that name shows the board'
    """
    return _ARGUMENT.sub(lambda found: f"--{found[1].replace('_', '-')}{'' if found[2] else ' '}", message)


def say_doubts(doubts: Iterable[Doubt]) -> None:
    """Write doubts on standard error, each with how much it weighs, the heaviest first."""
    for _, one in heaviest_first(doubts):
        typer.echo(f"{_SEVERITY_WORDS[one.severity]}: {on_command_line(one.text)}", err=True)


def parse_periods(text: str) -> tuple[float, ...]:
    """Read numbers of fringe periods that are separated by commas.

    text: Such as ``0.9,3.9,15.9``.
    InputError: Something else than numbers.

    >>> parse_periods("0.9,3.9")
    (0.9, 3.9)
    """
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(f"periods {text!r}: numbers with commas are needed, such as 0.9,3.9,15.9") from error
