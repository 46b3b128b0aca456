"""The front door: ``heliogauge COMMAND ...``.

Commands of the instruments are mounted lazily, by name: `heliogauge.instruments` says where each ``typer.Typer`` lives,
and the module is imported only when its command is called. ``--version`` and ``--help`` import nothing but typer.

A user's mistake and a measurement that does not determine its answer are `MetrologyError`: one message on standard
error, exit 2. Any other exception is a bug and shows its traceback. Ctrl-C ends with 130 and a termination signal with
143; both unwind the stack, so that a result that is being written is removed.
"""

import os
import signal
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import Annotated, Any, NoReturn, TextIO

import typer
from typer.core import TyperCommand, TyperGroup

from heliogauge import __version__
from heliogauge.errors import MetrologyError, ReportWarning
from heliogauge.instruments import Commands, every_kind, instruments, resolve
from heliogauge.running.commands import Force, NoReport, Quiet, Verbose

#: Commands before those of the instruments, and after them.
FIRST, LAST = ("demo", "init", "synth"), ("report",)
SYNTH = Commands("synth", "data_synth.cli:app", "Make a measurement folder with known truth.")


def mounted() -> dict[str, Commands]:
    """Return the commands that are imported only when they are called, by the word that calls them."""
    return {one.name: one for one in (SYNTH, *(instrument.commands for instrument in instruments()))}


class LazyGroup(TyperGroup):
    """A group that knows its commands by name and loads a package only when its command is called.

    Contexts and formatters are `Any`: typer below 0.26 takes them from click, later ones carry their own copy.
    """

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self._mounted = mounted()
        for name, one in self._mounted.items():
            # A stand-in with the name and the summary: enough for the list and for "did you mean".
            self.commands[name] = TyperCommand(name, help=one.summary)

    def list_commands(self, ctx: Any) -> list[str]:
        """List all names, those of the instruments in the middle."""
        between = sorted(self.commands.keys() - {*FIRST, *LAST})
        return [*FIRST, *between, *LAST]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command, importing its package if it is a mounted one."""
        if cmd_name not in self._mounted:
            command: Any = super().get_command(ctx, cmd_name)
            if cmd_name == "init":
                command.params[0].help = f"{', '.join(every_kind())}."
            return command
        command = typer.main.get_command(resolve(self._mounted[cmd_name].app))
        command.name = cmd_name
        return command

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the list of commands from what is known without importing them."""
        names = self.list_commands(ctx)
        with formatter.section("Commands"):
            formatter.write_dl([(name, self.commands[name].get_short_help_str(limit=200)) for name in names])

    def invoke(self, ctx: Any) -> Any:
        """Run the command; Ctrl-C ends it with exit code 130 in every version of typer."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as stopped:
            print(f"heliogauge: interrupted; {str(stopped) or 'nothing was written'}", file=sys.stderr)
            raise typer.Exit(130) from None


app = typer.Typer(
    cls=LazyGroup,
    help="Metrology of solar mirrors: images in, slope maps with uncertainty out.",
    rich_markup_mode=None,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def _show_version(asked: bool) -> None:
    if asked:
        print(f"heliogauge {__version__}")
        raise typer.Exit


@app.callback()
def front_door(
    version: Annotated[
        bool, typer.Option("--version", help="Show the version and exit.", callback=_show_version, is_eager=True)
    ] = False,
) -> None:
    """Metrology of solar mirrors: images in, slope maps with uncertainty out."""


@app.command()
def demo(
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Folder for the results.")] = Path(
        "demo-result"
    ),
    force: Force = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    no_report: NoReport = False,
) -> None:
    """Measure embedded synthetic data, from images to report; no hardware, no download."""
    from heliogauge.running.demo import run_demo
    from heliogauge.running.terminal import terminal_progress

    run_demo(out, terminal_progress(quiet=quiet, verbose=verbose), force=force, report=not no_report)


@app.command()
def init(
    kind: Annotated[
        str,
        typer.Argument(metavar="KIND", help="Kind of measurement."),
    ],
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of the measurement; made if absent.")],
    force: Annotated[bool, typer.Option("--force", help="Replace an existing measurement.toml.")] = False,
) -> None:
    """Write a commented measurement.toml to start from."""
    from heliogauge.measurement.templates import write_template

    print(write_template(kind, folder, force=force))


@app.command()
def report(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder with results.")],
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """(Re)build OUT/report.html from the results in OUT."""
    from heliogauge.reporting.build import build_report
    from heliogauge.running.terminal import terminal_progress

    with terminal_progress(quiet=quiet, verbose=verbose).stage("report"):
        path = build_report(out)
    print(path)


def _terminate(number: int, frame: FrameType | None) -> NoReturn:
    # SystemExit unwinds the stack as Ctrl-C does; the default action would leave temporary folders behind.
    raise SystemExit(128 + number)


def _show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    text = (
        f"warning: {message}\n"
        if issubclass(category, ReportWarning)
        else warnings.formatwarning(message, category, filename, lineno, line)
    )
    (file or sys.stderr).write(text)


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and leave the process.

    arguments: Arguments without the program's name; those of the process if absent.
    SystemExit: Always: 0 success, 2 a user's mistake or an undetermined measurement, 130 Ctrl-C, 143 terminated.
    """
    signal.signal(signal.SIGTERM, _terminate)
    # One message for one fault: OpenCV's own remarks on a damaged file would stand beside ours. The user's wish counts.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    warnings.showwarning = _show_warning
    warnings.simplefilter("always", ReportWarning)
    try:
        typer.main.get_command(app).main(args=arguments, prog_name="heliogauge")
    except MetrologyError as error:
        print(f"heliogauge: {error}", file=sys.stderr)
        sys.exit(2)
    sys.exit(0)
