"""What every package's command line is built from: the common flags and the group with a default command.

A package that has commands exposes ``app: typer.Typer`` in its ``cli.py``; `heliogauge.running.cli` mounts it by name
and imports it only when it is called. Flags that mean the same everywhere are the annotated types below, so that they
have one name, one help text and one meaning.
"""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from heliogauge.doubts import Doubt
from heliogauge.errors import InputError
from heliogauge.running.progress import Progress

if TYPE_CHECKING:
    from heliogauge.results.frame import InstrumentResult

MeasurementFolder = Annotated[
    Path, typer.Argument(metavar="FOLDER", help="Folder with measurement.toml and its images.", show_default=False)
]
OutFolder = Annotated[
    Path, typer.Option("-o", "--out", metavar="DIR", help="Folder for the results.", show_default=False)
]
Force = Annotated[bool, typer.Option("--force", help="Replace an existing result.")]
Quiet = Annotated[bool, typer.Option("-q", "--quiet", help="Say nothing but warnings.")]
Verbose = Annotated[bool, typer.Option("-v", "--verbose", help="Say when each stage starts, in plain lines.")]
NoReport = Annotated[
    bool, typer.Option("--no-report", help="Leave out report.html; `heliogauge report` makes it later.")
]
Jobs = Annotated[
    int | None,
    typer.Option("--jobs", metavar="N", min=1, help="Work side by side on this machine; default: what it has."),
]
Scheduler = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="tcp://HOST:PORT", help="Send the work to an existing Dask cluster."),
]

#: Parameters of a command that are not options of its pipeline.
COMMON_PARAMETERS = frozenset({"folder", "out", "force", "quiet", "verbose", "no_report", "jobs", "scheduler"})


class DefaultCommandGroup(TyperGroup):
    """A group whose command ``run`` needs no name: ``heliogauge deflectometry FOLDER`` beside named commands.

    Anything that is not the name of a command is taken as the first argument of ``run``. A folder that is called like
    a command is given as ``./name``.
    """

    default_command = "run"

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put the default command's name in front where no command is named; a group may have none."""
        has_default = self.default_command in self.commands
        if has_default and args and args[0] not in self.commands and args[0] != "--help":
            args = [self.default_command, *args]
        return super().parse_args(ctx, args)


def make_app(summary: str) -> typer.Typer:
    """Make the typer application of a package: plain help (no rich, 0.2 s quicker), ``run`` as default command."""
    app = typer.Typer(
        cls=DefaultCommandGroup,
        help=summary,
        rich_markup_mode=None,
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
    )
    # With a callback typer keeps the group even while it holds a single command.
    app.callback()(lambda: None)
    return app


def deliver(
    out: Path,
    job: Callable[[], "InstrumentResult"],
    progress: Progress,
    *,
    force: bool,
    quiet: bool,
    report: bool,
    hint: str = "",
) -> None:
    """Do a command's work, write its result into a folder that is whole or not there, and report how it ended.

    Doubts go to standard error, headline and place of the result to standard output.

    job: Does the work; is called when the folder is known to be usable.
    force: Replace an earlier result.
    quiet: Only doubts are reported.
    report: Add ``report.html``.
    hint: What can be done with the result.
    InputError: The folder cannot be used, or the job refuses its input.
    EstimationError: The job's answer is not determined.
    """
    from heliogauge.results.frame import into_folder

    result = into_folder(out, job, progress, force=force, report=report)
    say_ending(result.doubts, result.headline(), f"results: {out}{hint}", quiet=quiet)


def say_ending(doubts: Iterable[Doubt], headline: str, ending: str, *, quiet: bool) -> None:
    """Report how a command ended: doubts on standard error, the numbers and where they are on standard output."""
    for one in doubts:
        typer.echo(f"warning: {one.text}", err=True)
    if not quiet:
        typer.echo(headline)
        typer.echo(ending)


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
