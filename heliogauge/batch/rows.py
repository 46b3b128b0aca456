"""Rows of the index of a batch, and what they say together."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any
from urllib.parse import quote

from heliogauge.batch.folders import BatchTask
from heliogauge.doubts import Doubt, Severity
from heliogauge.reporting.build import REPORT_HTML
from heliogauge.results.folder import SUMMARY_FILE, Summary, read_summary, write_table_csv

INDEX_FILE = "index.csv"
#: Kind of a folder that holds the results of a batch.
BATCH = "measurements"
MEASURED, FAILED = "measured", "failed"
#: Headline numbers of each kind that the index has, each with its sigma; the others are in the results.
MOST_NUMBERS = 5
#: Columns beside the headline numbers: those before them, and those after.
BEFORE = ("name", "kind", "status")
AFTER = (
    "measured_share",
    "serious_doubts_count",
    "doubts_count",
    "notes_count",
    "duration_s",
    "reason",
    "folder",
    "link",
)

#: A row of the index; ``numbers`` holds the headline numbers by their keys.
Row = dict[str, Any]


def measured_row(task: BatchTask, place: Path, duration_s: float) -> Row:
    """Return the row of a measurement from its results.

    place: Folder of its results.
    duration_s: How long it took [s].
    """
    summary = read_summary(place)
    severities = Counter(one.severity for one in summary.doubts)
    return {
        "name": task.name,
        "kind": summary.kind,
        "status": MEASURED,
        "numbers": _headline(summary),
        "measured_share": summary.numbers.get("measured_share"),
        "serious_doubts_count": severities[Severity.SERIOUS],
        "doubts_count": severities[Severity.DOUBT],
        "notes_count": severities[Severity.NOTE],
        "duration_s": round(duration_s, 3),
        "reason": "",
        "folder": str(task.folder),
        "link": link_to(place),
    }


def link_to(place: Path) -> str:
    """Return the address, within the batch, of what says most of a measurement's results."""
    return f"{quote(place.name)}/{REPORT_HTML if (place / REPORT_HTML).is_file() else SUMMARY_FILE}"


def failed_row(task: BatchTask, kind: str, reason: str, link: str = "") -> Row:
    """Return the row of a measurement that failed.

    kind: Kind of measurement; empty where that is not known.
    reason: What the person who reads it can do something about.
    link: File that says more.
    """
    row: Row = dict.fromkeys(AFTER)
    place = {"folder": str(task.folder), "link": link}
    return {"name": task.name, "kind": kind, "status": FAILED, "numbers": {}, **row, "reason": reason, **place}


def _headline(summary: Summary) -> dict[str, float | int | None]:
    chosen: dict[str, float | int | None] = {}
    keys = [key for key in summary.numbers if not key.startswith("sigma_") and key != "measured_share"]
    for key in keys[:MOST_NUMBERS]:
        chosen[key] = summary.numbers[key]
        if f"sigma_{key}" in summary.numbers:
            chosen[f"sigma_{key}"] = summary.numbers[f"sigma_{key}"]
    return chosen


def write_index(path: Path, rows: Sequence[Row]) -> None:
    """Write ``index.csv``: a row for each measurement; a number that a kind does not have is an empty cell.

    InputError: The file cannot be written.
    """
    keys = list(dict.fromkeys(key for row in rows for key in row["numbers"]))
    columns: dict[str, list[Any]] = {name: [_cell(row[name]) for row in rows] for name in BEFORE}
    columns |= {key: [_cell(row["numbers"].get(key)) for row in rows] for key in keys}
    columns |= {name: [_cell(row[name]) for row in rows] for name in AFTER}
    write_table_csv(path, columns)


def _cell(value: Any) -> str:
    # Columns mix numbers with gaps, and a count must not become a float; repr keeps every digit.
    return "" if value is None else value if isinstance(value, str) else repr(value)


def batch_summary(
    name: str, rows: Sequence[Row], durations_s: Mapping[str, float], digests: Mapping[str, str]
) -> Summary:
    """Return what a batch says as a whole.

    name: Name of the batch.
    durations_s: Wall time of each stage [s].
    digests: Digest of the inputs of each measurement by its name.
    """
    measured = [row for row in rows if row["status"] == MEASURED]
    failed = [row for row in rows if row["status"] == FAILED]
    serious = [row["name"] for row in measured if row["serious_doubts_count"]]
    doubtful = [row["name"] for row in measured if row["doubts_count"] and not row["serious_doubts_count"]]
    numbers: dict[str, float | int | None] = {
        "measurements_count": len(rows),
        "measured_count": len(measured),
        "failed_count": len(failed),
        "seriously_doubtful_count": len(serious),
        "doubtful_count": len(doubtful),
    }
    kinds = Counter(row["kind"] for row in measured)
    if len(kinds) == 1:
        numbers |= _medians(measured)
    if measured:
        numbers["median_duration_s"] = median(row["duration_s"] for row in measured)
    doubts = []
    if failed:
        names = [row["name"] for row in failed]
        doubts.append(
            Doubt(
                "measurements_failed",
                f"{len(failed)} of {len(rows)} measurements failed ({_some(names)}); {INDEX_FILE} has the reasons",
                {"failed_count": len(failed), "measurements_count": len(rows)},
            )
        )
    if serious:
        doubts.append(
            Doubt(
                "measurements_wrong",
                f"{len(serious)} of {len(rows)} measurements have serious doubts, so that something is wrong with "
                f"mirror, set-up or files ({_some(serious)}); their reports name it",
                {"measurements_count": len(serious)},
                Severity.SERIOUS,
            )
        )
    if doubtful:
        doubts.append(
            Doubt(
                "measurements_doubtful",
                f"{len(doubtful)} of {len(rows)} measurements have doubts ({_some(doubtful)}); their reports name them",
                {"measurements_count": len(doubtful)},
            )
        )
    texts = {"kinds": ", ".join(f"{kind} ({count})" for kind, count in kinds.most_common())} if kinds else {}
    return Summary(BATCH, name, numbers, texts, tuple(doubts), dict(durations_s), dict(digests))


def _medians(measured: Sequence[Row]) -> dict[str, float | int | None]:
    """Return the median of each headline number that all measurements of one kind have."""
    medians: dict[str, float | int | None] = {}
    for key in measured[0]["numbers"]:
        values = [row["numbers"].get(key) for row in measured]
        if not key.startswith("sigma_") and all(value is not None for value in values):
            medians[f"median_{key}"] = float(median(values))
    return medians


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
