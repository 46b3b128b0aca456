"""What is done from Python with any instrument: measure a folder, open results, make synthetic data, build a report."""

import shutil
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from tempfile import mkdtemp
from typing import TYPE_CHECKING, Any

from heliogauge.errors import InputError
from heliogauge.instruments import Kind, instrument_named, instruments, near_match, resolve

if TYPE_CHECKING:
    from heliogauge.results.opened import Result
    from heliogauge.running.commands import Ended
    from heliogauge.running.progress import Progress


def measure(
    folder: str | Path,
    out: str | Path | None = None,
    *,
    force: bool = False,
    report: bool = False,
    progress: "Progress | None" = None,
    **options: Any,
) -> "Result":
    """Evaluate a measurement folder of any kind.

    Parameters
    ----------
    folder : str or Path
        Folder with measurement.toml and its images.
    out : str or Path, optional
        Folder for the results, whole or not there; a temporary one without it, which goes away with the result.
    force : bool
        Replace earlier results.
    report : bool
        Also make report.html.
    progress : Progress, optional
        Listener for the stages, such as `heliogauge.running.terminal.terminal_progress`.
    **options : Any
        Choices that override those of measurement.toml, called as on the command line with underscores.

    Returns
    -------
    Result
        The results.

    Raises
    ------
    InputError
        A measurement or an option that cannot be meant.
    EstimationError
        The data do not determine the answer; the message has the numbers and the remedy.
    """
    from heliogauge.measurement.load import kind_of
    from heliogauge.results.opened import Result
    from heliogauge.running.progress import SilentProgress

    folder = Path(folder).expanduser()
    kind = kind_of(folder)
    choices = _options(kind, options)
    measurement = resolve(kind.load)(folder)
    target = Path(mkdtemp(prefix="heliogauge-")) if out is None else Path(out).expanduser()
    try:
        listener = progress or SilentProgress()
        _measure_into(kind, measurement, target, choices, listener, force=force, report=report, folder=folder)
    except BaseException:
        if out is None:
            shutil.rmtree(target, ignore_errors=True)
        raise
    return Result(target, temporary=out is None)


def open(folder: str | Path) -> "Result":  # noqa: A001
    """Open a folder of results of any kind.

    Parameters
    ----------
    folder : str or Path
        The folder.

    Returns
    -------
    Result
        Its headline numbers, doubts, maps and tables.

    Raises
    ------
    InputError
        No results are there.
    """
    from heliogauge.results.opened import Result

    return Result(folder)


def report(out: str | Path) -> Path:
    """Make report.html in a folder of results, again if it is there.

    Parameters
    ----------
    out : str or Path
        The folder of results.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        No results are there, or they are of a kind without a report.
    """
    from heliogauge.reporting.build import build_report

    return build_report(Path(out).expanduser())


def synth(
    instrument: str,
    folder: str | Path,
    *,
    preset: str | None = None,
    seed: int = 0,
    force: bool = False,
    progress: "Progress | None" = None,
) -> Path:
    """Make a measurement folder with known truth.

    Parameters
    ----------
    instrument : str
        Which instrument it is for: "deflectometry", "photogrammetry", "observer", "heliostat", "camera".
    folder : str or Path
        The folder to write; absent or empty.
    preset : str, optional
        Which scene; the instrument's small one without it.
    seed : int
        Seed of all errors and noise: the same seed gives the same files.
    force : bool
        Replace an earlier synthetic measurement.
    progress : Progress, optional
        Listener for the stages.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    InputError
        An instrument or a preset that is not known, or a folder that cannot be written.
    """
    scene = instrument_named(instrument).synth
    if scene is None:
        known = ", ".join(one.name for one in instruments() if one.synth)
        raise InputError(f"instrument {instrument!r} has no synthetic measurements; these have: {known}")
    chosen = {} if preset is None else {"preset": preset}
    resolve(scene)(Path(folder).expanduser(), **chosen, seed=seed, force=force, progress=progress)
    return Path(folder).expanduser()


def _options(kind: Kind, given: dict[str, Any]) -> Any:
    """Return the options of a kind of measurement, texts turned into what they stand for; None where it has none."""
    options_type = resolve(kind.options) if kind.options else None
    known = [] if options_type is None else [field.name for field in fields(options_type)]
    for name in given:
        if name not in known:
            hint = near_match(name, known) if known else "it has none"
            raise InputError(f"option {name!r} is not one of the kind {kind.name!r}; {hint}")
    if options_type is None:
        return None
    from pydantic import TypeAdapter, ValidationError

    try:
        return TypeAdapter(options_type).validate_python(given)
    except ValidationError as error:
        fault = error.errors(include_url=False)[0]
        raise InputError(f"option {fault['loc'][0]} = {fault['input']!r}: {fault['msg']}") from None


def measure_into(
    folder: Path,
    out: Path,
    progress: "Progress",
    *,
    jobs: int | None,
    scheduler: str | None = None,
    options: Mapping[str, Any] | None = None,
    force: bool,
    report: bool,
) -> "Ended":
    """Evaluate a measurement folder of any kind into a folder of results, as its measurement.toml says.

    jobs: Processes or threads side by side, where the kind can use several.
    scheduler: Address of a Dask scheduler, where the kind has work for one.
    options: Choices that override those of measurement.toml.
    force: Replace earlier results.
    report: Also make report.html.
    Returns: What came of it, with `doubts` and `headline`.
    InputError: A measurement that cannot be meant, or a folder that cannot be used.
    EstimationError: The data do not determine the answer.
    """
    from heliogauge.measurement.load import kind_of

    kind = kind_of(folder)
    known = {field.name for field in fields(resolve(kind.options))} if kind.options else set()
    if scheduler is not None and "scheduler" not in known:
        raise InputError(
            f"scheduler={scheduler}: one measurement of the kind {kind.name!r} is not divided; leave it out"
        )
    own = {name: value for name, value in (("jobs", jobs), ("scheduler", scheduler)) if name in known}
    choices = _options(kind, own | dict(options or {}))
    has_report = any(kind.name in instrument.reports for instrument in instruments())
    measurement = resolve(kind.load)(folder)
    report = report and has_report
    return _measure_into(kind, measurement, out, choices, progress, force=force, report=report, folder=folder)


def _measure_into(
    kind: Kind,
    measurement: Any,
    out: Path,
    options: Any,
    progress: "Progress",
    *,
    force: bool,
    report: bool,
    folder: Path,
) -> "Ended":
    from heliogauge.results.frame import InstrumentResult, into_folder

    if kind.run_into:
        result: Ended = resolve(kind.run_into)(measurement, out, options, progress, force=force, report=report)
        return result
    chosen = [] if options is None else [options]
    run: Callable[..., InstrumentResult] = resolve(kind.run)
    return into_folder(
        out, lambda: run(measurement, *chosen, progress), progress, force=force, report=report, measured=folder
    )
