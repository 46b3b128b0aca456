"""Results of several modules side by side: one table for a flight over a field (QFly)."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from heliogauge.errors import InputError
from heliogauge.store import Summary, hash_files, read_summary, write_summary, write_table_csv

#: Kind of the summary; `heliogauge.report` has no page of its own for it.
KIND = "observer-overview"


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """Summaries of modules.

    Parameters
    ----------
    folders : tuple of Path
        Results, in the order given.
    modules : tuple of Summary
        What each says.
    warnings : tuple of str
        Which modules are doubtful.
    input_sha256 : dict of str to str
        Hash of each file read.
    """

    folders: tuple[Path, ...]
    modules: tuple[Summary, ...]
    warnings: tuple[str, ...]
    input_sha256: dict[str, str]


def run(folders: Sequence[Path]) -> Result:
    """Collect results of ``heliogauge observer``.

    Parameters
    ----------
    folders : sequence of Path
        Results of the modules.

    Returns
    -------
    Result
        Their summaries.

    Raises
    ------
    InputError
        A folder that holds no result of the Observer, or the same folder twice.
    """
    if len({folder.resolve() for folder in folders}) < len(folders):
        raise InputError("overview: the same result is given twice")
    modules = tuple(read_summary(folder) for folder in folders)
    for folder, module in zip(folders, modules, strict=True):
        if module.kind != "observer":
            raise InputError(f'{folder}: a result of kind "{module.kind}"; results of `heliogauge observer` are needed')
    doubts = tuple(
        f"{folder}: {len(module.warnings)} warnings, the first: {module.warnings[0]}"
        for folder, module in zip(folders, modules, strict=True)
        if module.warnings
    )
    # All files are called summary.json: the folder tells them apart.
    hashes = {
        str(folder / name): digest
        for folder in folders
        for name, digest in hash_files([folder / "summary.json"]).items()
    }
    return Result(tuple(folders), modules, doubts, hashes)


def write(result: Result, folder: Path) -> None:
    """Write overview.csv and summary.json into an existing folder.

    Parameters
    ----------
    result : Result
        What `run` returned.
    folder : Path
        Where to.

    Raises
    ------
    InputError
        A file cannot be written.
    """
    keys = list(dict.fromkeys(key for module in result.modules for key in module.numbers))
    columns: dict[str, list[Any]] = {
        "result": [str(one) for one in result.folders],
        "name": [module.name for module in result.modules],
        "warnings": [len(module.warnings) for module in result.modules],
    }
    for key in keys:
        values = [module.numbers.get(key) for module in result.modules]
        columns[key] = ["" if value is None else value for value in values]
    write_table_csv(folder / "overview.csv", columns)
    write_summary(folder / "summary.json", Summary(
        kind=KIND, name="overview", numbers={"modules_count": len(result.modules)}, texts={}, warnings=result.warnings,
        durations_s={}, input_sha256=result.input_sha256,
    ))  # fmt: skip


def headline_text(result: Result) -> str:
    """Say each module's most important numbers in a line.

    Parameters
    ----------
    result : Result
        What `run` returned.

    Returns
    -------
    str
        Lines for the terminal.
    """
    lines = []
    for folder, module in zip(result.folders, result.modules, strict=True):
        slope, aimed = (module.numbers.get(key) for key in ("sdx_tilt_removed_rad", "rms_theta_ra_rad"))
        said = [f"SDx {1e3 * slope:.2f} mrad" if slope is not None else "no slopes"]
        said += [f"theta_ra {1e3 * aimed:.2f} mrad RMS"] if aimed is not None else []
        said += [f"{len(module.warnings)} warnings"] if module.warnings else []
        lines.append(f"{folder} ({module.name}): {', '.join(said)}")
    return "\n".join(lines)
