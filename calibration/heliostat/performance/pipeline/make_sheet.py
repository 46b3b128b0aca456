"""From results of tests to data sheets: entries of each heliostat, what limits make of them, what was not measured."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from calibration.heliostat.performance.entries import Conformity, Decision, Entry, Limit, decide
from calibration.heliostat.performance.files.limits import Limits, read_limits
from calibration.heliostat.performance.files.result import ENTRIES_FILE, KIND, read_entries
from calibration.heliostat.performance.files.sheets import Sheets
from calibration.heliostat.performance.report.sections import series_chart
from calibration.heliostat.performance.sheet import STANDARD, Sheet, SheetLine
from heliogauge.doubts import Doubt, Severity, gather_doubts
from heliogauge.errors import InputError
from heliogauge.files.faults import explain_faults
from heliogauge.instruments import near_match
from heliogauge.results.folder import SUMMARY_FILE, Summary, hash_files, read_summary, read_table_csv
from heliogauge.running.progress import Progress, SilentProgress

# Tables of results that the sheet shows, with the columns that it needs.
_TABLES = {
    "day_rows": ("time_utc", "beam_right_rad", "sigma_right_rad", "beam_up_rad", "sigma_up_rad"),
    "year_costs": ("cause", "lost_text", "next_mrad_text"),
}


@dataclass(frozen=True, slots=True)
class SheetOptions:
    """Choices of the data sheets.

    limits: File with what entries must keep; None: nothing is asked.
    pdf: Also make PDF.
    """

    limits: Path | None = None
    pdf: bool = True


def run(folders: Sequence[Path], options: SheetOptions | None = None, progress: Progress | None = None) -> Sheets:
    """Make a data sheet of each heliostat that results are of.

    InputError: A folder without entries, or limits that cannot be read.
    """
    options, progress = options or SheetOptions(), progress or SilentProgress()
    limits = Limits() if options.limits is None else read_limits(options.limits)
    by_heliostat: dict[str, list[Path]] = {}
    summaries: dict[Path, Summary] = {}
    for folder in folders:
        summary = summaries[folder] = read_summary(folder / SUMMARY_FILE)
        if summary.kind != KIND:
            raise InputError(
                f"{folder}: results of the kind {summary.kind!r}; those of `heliogauge heliostat test` are "
                "needed. Slope "
                "maps and beams come in by [quality] results of its measurement.toml, which says whose they are"
            )
        name, _ = read_entries(folder / ENTRIES_FILE)
        if name != summary.name:
            raise InputError(
                f"{folder}: entries.csv is of {name!r}, summary.json of {summary.name!r}: results of another heliostat"
            )
        by_heliostat.setdefault(name, []).append(folder)
    with progress.stage("sheets"):
        sheets = tuple(_sheet(name, own, summaries, limits) for name, own in by_heliostat.items())
    hashes = hash_files([folder / ENTRIES_FILE for folder in folders])
    names = list(by_heliostat)
    return Sheets(
        sheets=sheets,
        pdf=options.pdf,
        confidence=limits.confidence,
        name=names[0] if len(names) == 1 else f"{len(names)} heliostats",
        doubts=gather_doubts(*(sheet.doubts for sheet in sheets)),
        durations_s=dict(progress.durations_s),
        input_sha256=hashes,
    )


def _sheet(name: str, folders: Sequence[Path], summaries: dict[Path, Summary], limits: Limits) -> Sheet:
    entries: dict[str, Entry] = {}
    doubts: list[Doubt] = []
    twice: dict[tuple[str, str], list[str]] = {}
    about: dict[str, str] = {}
    tables: dict[str, dict[str, list[str]]] = {}
    doubted: dict[str, int] = {}
    for folder in folders:
        of_result = [one.prefixed(name) for one in summaries[folder].doubts if one.severity is not Severity.NOTE]
        if of_result:
            doubted[folder.resolve().name] = len(of_result)
        doubts += of_result
        about |= summaries[folder].texts
        for file, columns in _TABLES.items():
            if (folder / f"{file}.csv").is_file():
                tables[file] = _rows(folder / f"{file}.csv", columns)
        for entry in read_entries(folder / ENTRIES_FILE)[1]:
            earlier = entries.get(entry.name)
            if earlier is None or not earlier.is_measured or (entry.is_measured and entry.date >= earlier.date):
                entries[entry.name] = entry
            # A result that is given twice was measured once.
            if earlier is not None and earlier.is_measured and entry.is_measured and earlier != entry:
                kept, left = (entry, earlier) if entries[entry.name] is entry else (earlier, entry)
                twice.setdefault((kept.date or "no date", left.date or "no date"), []).append(entry.name)
    doubts += [
        Doubt(
            "measured_twice",
            f"{name}: {_listed(names)} {'was' if len(names) == 1 else 'were'} measured twice; the sheet has that of "
            f"{kept}, not that of {left}",
            {"entries_count": len(names)},
            Severity.NOTE,
        )
        for (kept, left), names in twice.items()
    ]
    for test, key, label in STANDARD:
        entries.setdefault(f"{test}_{key}", Entry(test, key, label, None, note="not measured"))
    known = list(entries)
    for asked in limits.by_name:
        if asked not in entries:
            test, _, key = asked.partition("_")
            entries[asked] = Entry(test, key, key.replace("_", " "), None, note="asked for, not measured")
            doubts.append(
                Doubt(
                    "limit_without_entry",
                    f"{name}: {limits.source} has a limit for {asked}, which no result has; {near_match(asked, known)}",
                )
            )
    lines = tuple(_line(entry, limits.by_name.get(full), limits.confidence) for full, entry in entries.items())
    failed = [one.entry.label for one in lines if one.decision.conformity is Conformity.FAIL]
    if failed:
        doubts.append(
            Doubt("limits_not_kept", f"{name}: limits are not kept: {', '.join(failed)}", {"failed_count": len(failed)})
        )
    return Sheet(name, lines, about, gather_doubts(doubts), tables, doubted)


def _rows(path: Path, columns: Sequence[str]) -> dict[str, list[str]]:
    """Read a table of a result; InputError where the sheet's picture cannot be drawn from it."""
    table = read_table_csv(path, columns)
    if "time_utc" in columns:
        with explain_faults(path, "a table of beams as heliogauge wrote it"):
            series_chart(table, path.stem)
    return table


def _listed(names: Sequence[str], most: int = 4) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _line(entry: Entry, limit: Limit | None, confidence: float) -> SheetLine:
    decision: Decision = decide(entry, limit, confidence)
    return SheetLine(entry, limit, decision)
