"""The front door: ``heliogauge INSTRUMENT VERB ...``, and a few commands for all instruments.

The instruments are mounted lazily, by name: `heliogauge.instruments` says where each ``typer.Typer`` lives, and the
module is imported only when its instrument is called. ``--version`` and ``--help`` import nothing but typer.

A user's mistake and a measurement that does not determine its answer are `MetrologyError`: one message on standard
error, exit 2. Any other exception is a bug and shows its traceback. Ctrl-C ends with 130 and a termination signal with
143; both unwind the stack, so that a result that is being written is removed.
"""

import atexit
import gc
import os
import signal
import sys
import warnings
from collections.abc import Sequence
from inspect import Parameter, Signature
from io import TextIOWrapper
from pathlib import Path
from types import FrameType
from typing import Annotated, Any, NoReturn, TextIO

import typer
from typer.core import TyperCommand, TyperGroup

from heliogauge import __version__
from heliogauge.errors import InputError, MetrologyError, ReportWarning, SweptWarning, UnexplainedNumberWarning
from heliogauge.instruments import Instrument, instruments, resolve
from heliogauge.running.commands import (
    AsJson,
    Force,
    FoundAsJson,
    Jobs,
    MeasurementFolder,
    NoReport,
    OutFolder,
    Quiet,
    ResultsFolder,
    Scheduler,
    Verbose,
    on_command_line,
    say_doubts,
    say_ending,
)
from heliogauge.running.help_text import HelpContext, show_whole, write_commands

#: Objects with references, made and still there, before cycles among them are looked for; Python's own number is 700.
_NEW_OBJECTS = 100_000
#: What is said to the user in one line, each time.
_SAID = (ReportWarning, SweptWarning, UnexplainedNumberWarning)


def group_of(instrument: Instrument) -> Any:
    """Return the group of an instrument's verbs: ``init`` and ``synth``, which all have alike, and its own."""
    app: typer.Typer = resolve(instrument.commands)
    verbs = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False, add_completion=False)
    verbs.callback()(lambda: None)
    if instrument.kinds:
        verbs.command("init")(_init(instrument))
    if instrument.synth_command:
        verbs.command("synth")(resolve(instrument.synth_command))
    first: Any = typer.main.get_command(verbs)
    group: Any = typer.main.get_command(app)
    every = first.commands | group.commands
    group.commands = {name: every[name] for name in sorted(every, key=_place)}
    group.name = instrument.name
    return show_whole(group)


#: The verbs of all instruments come first and in this order; their own follow as they are defined.
_VERBS = ("init", "synth", "measure", "plan", "import", "export")


def _place(verb: str) -> int:
    return _VERBS.index(verb) if verb in _VERBS else len(_VERBS)


def _init(instrument: Instrument) -> Any:
    """Return the command that writes a commented measurement.toml, with an option for each kind but the usual one."""
    usual, *others = instrument.kinds
    flags = {one.init_option.removeprefix("--").replace("-", "_"): one for one in others}

    def init(folder: Path, *, force: bool = False, quiet: bool = False, verbose: bool = False, **chosen: bool) -> None:
        """Write a commented measurement.toml to start from."""
        asked = [flags[name] for name, given in chosen.items() if given]
        if len(asked) > 1:
            raise InputError(
                f"{' and '.join(one.init_option for one in asked)}: one file has one kind; give one of them"
            )
        _write_template((asked or [usual])[0].name, folder, force=force, quiet=quiet)

    options = {name: Annotated[bool, typer.Option(one.init_option, help=one.init_help)] for name, one in flags.items()}
    types = {"folder": InitFolder, **options, "force": ForceInit, "quiet": Quiet, "verbose": Verbose}
    # Typer reads the options off the signature: it is written here, since the kinds are the instrument's.
    init.__annotations__ = types
    init.__signature__ = Signature(  # type: ignore[attr-defined]
        [
            Parameter(
                name, Parameter.KEYWORD_ONLY, default=Parameter.empty if name == "folder" else False, annotation=one
            )
            for name, one in types.items()
        ]
    )
    return init


InitFolder = Annotated[
    Path, typer.Argument(metavar="FOLDER", help="Folder of the measurement; made if absent.", show_default=False)
]
ForceInit = Annotated[bool, typer.Option("--force", help="Replace an existing measurement.toml.")]


def _write_template(kind: str, folder: Path, *, force: bool, quiet: bool) -> None:
    from heliogauge.measurement.templates import write_template

    file = write_template(kind, folder, force=force)
    if not quiet:
        print(file)


class FrontDoor(TyperGroup):
    """The commands for all instruments, and the instruments, of which each is imported only when it is called.

    Contexts and formatters are `Any`: typer below 0.26 takes them from click, later ones carry their own copy.
    """

    context_class = HelpContext

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        for command in self.commands.values():
            show_whole(command)
        self._instruments = {one.name: one for one in instruments()}
        self._own = list(self.commands)
        for name, one in self._instruments.items():
            # A stand-in with the name and the summary: enough for the list and for "did you mean".
            self.commands[name] = TyperCommand(name, help=one.summary)

    def list_commands(self, ctx: Any) -> list[str]:
        """List the instruments, then the commands for all of them."""
        return [*self._instruments, *self._own]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command, importing its package if it is an instrument."""
        if cmd_name in self._instruments:
            return group_of(self._instruments[cmd_name])
        return super().get_command(ctx, cmd_name)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the lists of instruments and commands from what is known without importing them."""
        write_commands(
            formatter,
            "Instruments (heliogauge INSTRUMENT -h lists its verbs)",
            ((name, self.commands[name]) for name in self._instruments),
        )
        write_commands(formatter, "Commands for all instruments", ((name, self.commands[name]) for name in self._own))

    def invoke(self, ctx: Any) -> Any:
        """Run the command; Ctrl-C ends it with exit code 130 in every version of typer."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as stopped:
            print(f"heliogauge: interrupted; {str(stopped) or 'nothing was written'}", file=sys.stderr)
            raise typer.Exit(130) from None


app = typer.Typer(
    cls=FrontDoor,
    help="Metrology of solar mirrors: images in, slope maps with uncertainty out.",
    # The width is the terminal's; commands below take this over from the context above them.
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 10_000},
    rich_markup_mode=None,
    no_args_is_help=True,
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
def measure(
    folders: Annotated[
        list[Path],
        typer.Argument(
            metavar="FOLDER...",
            help="Folders with measurement.toml and images, or folders of such folders.",
            show_default=False,
        ),
    ],
    out: OutFolder,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    force: Force = False,
    no_report: NoReport = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Evaluate measurement folders of any kind, as their measurement.toml says.

    The results of one folder are in OUT. Of several, or of a folder of folders, they are in OUT/NAME each, and OUT has
    an index (index.csv, report.html). The same command again measures only what has changed, and what was not finished.
    """
    from heliogauge.batch.folders import is_measurement
    from heliogauge.running.terminal import terminal_progress

    progress = terminal_progress(quiet=quiet, verbose=verbose)
    if len(folders) == 1 and (is_measurement(folders[0]) or not folders[0].is_dir()):
        from heliogauge.running.verbs import measure_into

        one = measure_into(folders[0], out, progress, jobs=jobs, scheduler=scheduler, force=force, report=not no_report)
        say_ending(one, out, quiet=quiet, as_json=as_json)
        return
    from heliogauge.batch.measure import measure_batch
    from heliogauge.running.scale import Workers

    many = measure_batch(folders, out, Workers(jobs, scheduler), progress, force=force, report=not no_report)
    say_ending(many, out, quiet=quiet, as_json=as_json)


@app.command()
def check(
    folder: MeasurementFolder,
    jobs: Jobs = None,
    as_json: FoundAsJson = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Say what can be found wrong with a measurement folder before measuring; nothing is written.

    Keys, files and tables, every photo's file, and what is quickly seen in some photos. What only the evaluation shows
    (wrong dimensions of mirror or absorber, a camera that is off by a few per cent, targets that moved) measure says.
    """
    from heliogauge.running.check import check_folder
    from heliogauge.running.terminal import terminal_progress

    kind, findings = check_folder(folder, terminal_progress(quiet=quiet, verbose=verbose), jobs=jobs)
    if as_json:
        from heliogauge.results.json_file import json_text

        name = None if kind is None else kind.name
        print(json_text("check", {"folder": str(folder), "kind": name, **findings.content()}).rstrip())
    for fault in findings.faults:
        print(f"error: {on_command_line(fault)}", file=sys.stderr)
    say_doubts(findings.doubts)
    if not (quiet or as_json) and kind is not None:
        print(f"{folder}: {kind.name}, {findings.summary()}")
    if findings.faults:
        raise typer.Exit(2)


@app.command()
def report(
    out: ResultsFolder,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """(Re)build OUT/report.html from the results in OUT."""
    from heliogauge.reporting.build import build_report, refuse_without_report
    from heliogauge.running.terminal import terminal_progress

    refuse_without_report(out)
    with terminal_progress(quiet=quiet, verbose=verbose).stage("report"):
        path = build_report(out)
    if not quiet:
        print(path)


@app.command()
def demo(
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Folder for the results.")] = Path(
        "demo-result"
    ),
    force: Force = False,
    no_report: NoReport = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Measure embedded synthetic data, from images to report; no hardware, no download."""
    from heliogauge.running.demo import run_demo
    from heliogauge.running.terminal import terminal_progress

    run_demo(out, terminal_progress(quiet=quiet, verbose=verbose), force=force, report=not no_report)


@app.command()
def view(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="PATH...",
            help="Results, a folder of results, a slope_map.nc; two: their difference.",
            show_default=False,
        ),
    ],
    port: Annotated[int, typer.Option("--port", metavar="N", min=0, max=65535, help="Port; 0: a free one.")] = 0,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Print the address alone.")] = False,
) -> None:
    """Look at results in the browser, on this machine alone."""
    from heliogauge.view.server.serving import Looking, look_at

    look_at(paths, Looking(port, not no_browser), typer.echo)


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
        if issubclass(category, _SAID)
        else warnings.formatwarning(message, category, filename, lineno, line)
    )
    (file or sys.stderr).write(text)


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and leave the process.

    arguments: Arguments without the program's name; those of the process if absent.
    SystemExit: Always: 0 success, 2 a user's mistake or an undetermined measurement, 130 Ctrl-C, 143 terminated.
    """
    signal.signal(signal.SIGTERM, _terminate)
    # Looking for cycles among the objects of a hundred thousand definitions is a tenth of a short command.
    gc.set_threshold(_NEW_OBJECTS)
    # Nor are cycles looked for among all objects when the process ends and its memory goes back as a whole.
    atexit.register(gc.freeze)
    for stream in (sys.stdout, sys.stderr):
        # A console that cannot show a sign (Windows' code pages, a log in ASCII) gets a stand-in, not a traceback.
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    # One message for one fault: OpenCV's own remarks on a damaged file would stand beside ours. The user's wish counts.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    warnings.showwarning = _show_warning
    for said in _SAID:
        warnings.simplefilter("always", said)
    try:
        typer.main.get_command(app).main(args=arguments, prog_name="heliogauge")
    except MetrologyError as error:
        print(f"heliogauge: {on_command_line(str(error))}", file=sys.stderr)
        sys.exit(2)
    sys.exit(0)
