"""Results on disk: the folder that appears whole or not at all, the summary, hashes of the inputs."""

import hashlib
import math
import os
import warnings
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from heliogauge import __version__
from heliogauge.doubts import Doubt, doubt_content, read_doubt
from heliogauge.errors import InputError, UnexplainedNumberWarning
from heliogauge.files.regular import open_regular
from heliogauge.results.json_file import read_json, write_json
from heliogauge.results.slope_map_file import (
    ASSEMBLED,
    CutOut,
    facet_names,
    read_pixels,
    read_slope_map,
    read_slope_map_attributes,
    write_pixels,
    write_slope_map,
)
from heliogauge.results.tables import (
    PhotoPose,
    PointTable,
    read_camera_json,
    read_cameras_json,
    read_columns_csv,
    read_points_csv,
    read_table_csv,
    write_camera_json,
    write_cameras_json,
    write_points_csv,
    write_table_csv,
)
from heliogauge.results.whole_folder import FolderKind, WholeFolder

__all__ = [
    "ASSEMBLED",
    "SUMMARY_FILE",
    "UNEXPLAINED",
    "CutOut",
    "PhotoPose",
    "PointTable",
    "ResultFolder",
    "Summary",
    "explained",
    "facet_names",
    "find_copies",
    "hash_files",
    "read_camera_json",
    "read_cameras_json",
    "read_columns_csv",
    "read_json",
    "read_pixels",
    "read_points_csv",
    "read_slope_map",
    "read_slope_map_attributes",
    "read_summary",
    "read_table_csv",
    "refuse_copies",
    "unit_of",
    "what_instead",
    "write_camera_json",
    "write_cameras_json",
    "write_json",
    "write_pixels",
    "write_points_csv",
    "write_slope_map",
    "write_summary",
    "write_table_csv",
]

SUMMARY_FILE = "summary.json"
SUMMARY_SCHEMA = 1
#: The reason of a number that is not determined and came without one.
UNEXPLAINED = "not determined; the reason was not recorded"
RESULTS = FolderKind(content="results", mark=SUMMARY_FILE, strangers=frozenset({"measurement.toml"}))

#: A key of a number ends with one of these: the unit it is in.
UNITS: dict[str, str] = {
    "_per_m": "1/m",
    "_mrad": "mrad",
    "_urad": "µrad",
    "_rad": "rad",
    "_deg": "deg",
    "_um": "µm",
    "_mm": "mm",
    "_m2": "m²",
    "_m": "m",
    "_px": "px",
    "_dn": "DN",
    "_s": "s",
    "_kwh": "kWh",
    "_wh": "Wh",
    "_w": "W",
    "_mib": "MiB",
    "_share": "",
    "_ratio": "",
    "_count": "",
    "_number": "",
    "_factor": "",
    "_probability": "",
}


@dataclass(frozen=True, slots=True, eq=False)
class Summary:
    """What ``summary.json`` holds.

    kind: Kind of measurement ("deflectometry", ...): names the package whose report is run.
    name: Name of the measured thing.
    numbers: Headline numbers in the order of their importance; the key ends with the unit (`UNITS`), and the
        standard deviation of ``sdx_rad`` is ``sigma_sdx_rad``. None: not determined, see `not_determined`.
    texts: What must be said beside the numbers: design, removed, reference, frame, mounting orientation, setup,
        pattern.
    doubts: What makes the result doubtful.
    durations_s: Wall time of each stage [s].
    input_sha256: Hash of each file that was read; ``observations``: of what was observed, where files also hold what
        may be corrected later.
    not_determined: Why a number is None.
    facets: For several facets: numbers of each by the name of the facet.
    geometry_m: Points for the sketch of the setup, in the frame of the map [m]: ``camera`` (3,), ``camera_axis``
        (3,), ``screen`` (n, 3) outline, ``mirror`` (n, 3) outline; ``facet_frames``: rotation vector and place of each
        facet in the frame of the map, by its name.
    version: Version of the software that measured.
    measured_from: Folder that was measured, as seen from the folder of results; empty where it is not known.
    """

    kind: str
    name: str
    numbers: Mapping[str, float | int | None]
    texts: Mapping[str, str] = field(default_factory=dict)
    doubts: tuple[Doubt, ...] = ()
    durations_s: Mapping[str, float] = field(default_factory=dict)
    input_sha256: Mapping[str, str] = field(default_factory=dict)
    not_determined: Mapping[str, str] = field(default_factory=dict)
    facets: Mapping[str, Mapping[str, float | int | None]] = field(default_factory=dict)
    geometry_m: Mapping[str, Any] = field(default_factory=dict)
    version: str = __version__
    measured_from: str = ""


def unit_of(key: str) -> tuple[str, str]:
    """Split the key of a number into its name and its unit.

    InputError: The key does not end with a unit of `UNITS`.

    >>> unit_of("sdx_rad")
    ('sdx', 'rad')
    """
    for suffix, unit in UNITS.items():
        if key.endswith(suffix):
            return key.removesuffix(suffix) if unit else key, unit
    raise InputError(f"{key}: the name of a number must end with its unit, one of {', '.join(UNITS)}")


def explained(summary: Summary) -> Summary:
    """Return a summary in which each number is finite, or None with a reason.

    A sigma without a reason of its own has that of its number. A number without any keeps its result: it gets
    `UNEXPLAINED`, and an `UnexplainedNumberWarning` says so, which stops every test.

    InputError: A key without a unit.
    """
    numbers = {key: _finite(key, value) for key, value in summary.numbers.items()}
    facets = {name: {key: _finite(key, one) for key, one in own.items()} for name, own in summary.facets.items()}
    reasons = dict(summary.not_determined)
    # Dictionaries keep their order: the same number is named first each time.
    missing = dict.fromkeys(key for own in (numbers, *facets.values()) for key, value in own.items() if value is None)
    for key in [one for one in missing if one not in reasons]:
        reason = reasons.get(key.removeprefix("sigma_"))
        if reason is None:
            warnings.warn(
                f"{summary.kind}: {key} is not determined, and the result does not say why; the other numbers are "
                "right. Please report this",
                UnexplainedNumberWarning,
                stacklevel=2,
            )
        reasons[key] = reason or UNEXPLAINED
    return replace(summary, numbers=numbers, facets=facets, not_determined=reasons)


def write_summary(path: Path, summary: Summary) -> None:
    """Write ``summary.json``.

    InputError: A key without a unit; the file cannot be written.
    """
    write_json(path, summary_content(summary))


def summary_content(summary: Summary) -> dict[str, Any]:
    """Return the content of ``summary.json``, each number finite or with a reason (`explained`).

    InputError: A key without a unit.
    """
    summary = explained(summary)
    return {
        "schema_version": SUMMARY_SCHEMA,
        "kind": summary.kind,
        "name": summary.name,
        "software": "heliogauge",
        "software_version": summary.version,
        "numbers": dict(summary.numbers),
        "not_determined": dict(summary.not_determined),
        "doubts": [doubt_content(one) for one in summary.doubts],
        "texts": dict(summary.texts),
        "facets": {name: dict(own) for name, own in summary.facets.items()},
        "geometry_m": dict(summary.geometry_m),
        "durations_s": {stage: round(float(seconds), 4) for stage, seconds in summary.durations_s.items()},
        "input_sha256": dict(summary.input_sha256),
        "measured_from": summary.measured_from,
    }


def read_summary(path: Path) -> Summary:
    """Read ``summary.json``.

    path: The file, or the folder of results that holds it.
    """
    path = path / SUMMARY_FILE if path.is_dir() else path
    content = read_json(path)
    schema = content.get("schema_version")
    if (
        content.get("software") != "heliogauge"
        or not isinstance(schema, int)
        or schema not in range(1, SUMMARY_SCHEMA + 1)
    ):
        raise InputError(f"{path}: schema_version {schema} is not one this version reads (1 to {SUMMARY_SCHEMA})")
    renamed = {"version": "software_version"}
    keys = {item.name: renamed.get(item.name, item.name) for item in fields(Summary)}
    # Results of earlier versions do not know what they were measured from.
    content = {"measured_from": ""} | content
    missing = [key for key in keys.values() if key not in content]
    if missing:
        raise InputError(f"{path}: the keys {', '.join(missing)} are missing")
    values = {name: content[key] for name, key in keys.items()}
    try:
        doubts = tuple(read_doubt(one) for one in values.pop("doubts"))
    except (TypeError, KeyError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(f"{path}: doubts cannot be read ({error}); code, text, numbers, severity are needed") from None
    for name in ("kind", "name", "version", "measured_from"):
        if not isinstance(values[name], str):
            raise InputError(f"{path}: {keys[name]} = {values[name]!r:.60}: a text is needed")
    for name in ("texts", "not_determined", "input_sha256"):
        _check_values(path, keys[name], values[name], str, "texts")
    for name in ("numbers", "durations_s"):
        _check_values(path, keys[name], values[name], int | float | None, "numbers")
    _check_values(path, "facets", values["facets"], dict, "tables of numbers")
    for facet, own in values["facets"].items():
        _check_values(path, f"facets.{facet}", own, int | float | None, "numbers")
    if not isinstance(values["geometry_m"], dict):
        raise InputError(f"{path}: geometry_m: a table of points is needed")
    for key in (*values["numbers"], *(key for own in values["facets"].values() for key in own)):
        try:
            unit_of(key)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
    return Summary(**values, doubts=doubts)


def _check_values(path: Path, key: str, value: Any, kind: Any, what: str) -> None:
    """Refuse a table whose values are of another kind than they should be."""
    if not isinstance(value, dict):
        raise InputError(f"{path}: {key}: a table of {what} is needed, not {value!r:.60}")
    for name, one in value.items():
        if not isinstance(one, kind) or isinstance(one, bool):
            raise InputError(f"{path}: {key}.{name} = {one!r:.60}: {what} are needed here")
        if isinstance(one, float) and not math.isfinite(one):
            raise InputError(f"{path}: {key}.{name} = {one}: finite {what} are needed here")


def _finite(key: str, value: float | int | None) -> float | int | None:
    """Return a number as JSON has it, None where it is not finite."""
    unit_of(key)
    if value is None or not math.isfinite(value):
        return None
    return value if isinstance(value, int) else float(value)


def what_instead(folder: Path, below: str = "") -> str:
    """Say why a folder is not one of results.

    below: What follows where nothing is known of the folder: that none are in those below it either.
    """
    if not folder.is_dir():
        return "there is no such folder"
    if (folder / "measurement.toml").is_file():
        command = f"`heliogauge measure {folder} -o OUT`"
        return f"a measurement, not results; evaluate it first with {command}, in Python with `hg.measure`"
    return f"no results, for there is no {SUMMARY_FILE} in it{below}"


def hash_files(paths: Iterable[Path], relative_to: Path | None = None, most_bytes: int | None = None) -> dict[str, str]:
    """Hash files, several at a time.

    relative_to: Folder the names are given from; the bare file name for files elsewhere and without it.
    most_bytes: Largest size of a file; any size without it.
    Returns: Name with forward slashes, SHA-256 in hexadecimal digits, in the order given.
    """
    files = list(dict.fromkeys(paths))
    with ThreadPoolExecutor(max_workers=min(4, os.cpu_count() or 1)) as pool:
        digests = list(pool.map(lambda path: _hash_file(path, most_bytes), files))
    return dict(zip(_relative_names(files, relative_to), digests, strict=True))


def find_copies(files: Iterable[Path], hashes: Mapping[str, str], relative_to: Path | None = None) -> dict[Path, Path]:
    """Find files with the content of an earlier one: counted as measurements of their own, they make sigmas too small.

    hashes: From `hash_files` with the same folder.
    Returns: Each copy with the first file of that content.
    """
    some, first = list(files), dict[str, Path]()
    names = _relative_names(some, relative_to)
    same = {file: first.setdefault(hashes.get(name, str(file)), file) for file, name in zip(some, names, strict=True)}
    return {file: original for file, original in same.items() if file != original}


def refuse_copies(photos: Iterable[Path], hashes: Mapping[str, str], relative_to: Path | None = None) -> None:
    """Refuse a photo that is there twice.

    hashes: From `hash_files` with the same folder.
    InputError: Two photos have the same content.
    """
    for copy, first in find_copies(photos, hashes, relative_to).items():
        raise InputError(
            f"images.photos: {copy.name} is a copy of {first.name}; remove one (counted twice, sigmas are too small)"
        )


def _relative_names(files: Iterable[Path], relative_to: Path | None) -> list[str]:
    """Return how files are called from a folder, or by their bare names; a folder of many is resolved once."""
    root = relative_to.resolve() if relative_to is not None else None
    folders: dict[Path, Path] = {}

    def name_of(path: Path) -> str:
        if path.parent not in folders:
            folders[path.parent] = path.parent.resolve()
        resolved = path.resolve() if path.is_symlink() else folders[path.parent] / path.name
        return resolved.relative_to(root).as_posix() if root and resolved.is_relative_to(root) else path.name

    return [name_of(path) for path in files]


def _hash_file(path: Path, most_bytes: int | None) -> str:
    with open_regular(path, most_bytes=most_bytes) as file:
        try:
            return hashlib.file_digest(file, "sha256").hexdigest()
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error


class ResultFolder(WholeFolder):
    """A folder of results that appears whole or not at all.

    target: Where the results shall stand.
    force: Replace earlier results. Only a folder that is empty or holds a ``summary.json`` is ever replaced.
    InputError: On entering: results are there already, the place is not one for results, or it cannot be written
        to.

    ``with ResultFolder(out) as folder:`` gives a temporary folder beside the target. On success it is moved into
    place (one rename); after an error or Ctrl-C it is removed and earlier results stay as they were.

    >>> import tempfile
    >>> out = Path(tempfile.mkdtemp()) / "result"
    >>> with ResultFolder(out) as folder:
    ...     _ = (folder / "points.csv").write_text("id")
    >>> [path.name for path in out.iterdir()]
    ['points.csv']
    """

    def __init__(self, target: Path, *, force: bool = False) -> None:
        super().__init__(target, RESULTS, force=force)
