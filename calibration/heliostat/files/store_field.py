"""Results of a field: rows of ``field.csv``, its summary, lines for the terminal."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calibration.heliostat.files.field_work import bad_row_dates, found_over_expected, work_of
from calibration.heliostat.files.result import HeliostatResult, Shared
from calibration.heliostat.files.store_heliostat import counts_of, headline, left_out_text
from calibration.heliostat.fitting.splits import SPLIT_NAMES
from heliogauge.doubts import Doubt, Severity, doubt_content, doubts_of_parts, read_doubt
from heliogauge.results.folder import Summary, write_table_csv
from heliogauge.results.tables import read_table_csv

FIELD_FILE = "field.csv"
FIELD_KIND = "heliostat-field"
#: Key of a heliostat's row, beside the columns of ``field.csv``, for its doubts as JSON has them.
DOUBTS = "doubts"
# So many doubts a field keeps; what all its heliostats say together is never left out.
_MOST_DOUBTS = 100


def split_lines(result: HeliostatResult) -> tuple[str, ...]:
    """Say what came of each split in a line, what to expect before what was found."""
    lines = []
    for name, held in result.held.items():
        asked = f"split {name}: {held.split.note if held.beyond is None else held.beyond.text}"
        train, test = 1e3 * held.train.beam_rms_rad, 1e3 * held.test.beam_rms_rad
        lines.append(f"  {asked}; found {train:.2f} mrad train, {test:.2f} mrad test")
    return (*lines, *(f"  split {name} not made: {why}" for name, why in result.not_split.items()))


def _status(result: HeliostatResult, doubts: Sequence[Doubt]) -> str:
    if result.diagnosis.kinds:
        return "faulty"
    # Single rows that were wrong and left out make a heliostat no worse.
    undecided = any(finding.severity in ("doubt", "field") for finding in result.diagnosis.findings)
    return "doubtful" if undecided or set(doubts) - set(result.diagnosis.doubts) else "ok"


def field_row(result: HeliostatResult) -> dict[str, Any]:
    """Return a heliostat's row of ``field.csv``."""
    east, north, up = result.fit.design.position_m.tolist()
    # Test positions beyond those of training are a property of the split, and no fault of the heliostat.
    beyond = None if result.main is None else result.main.beyond
    doubts = [one for one in result.doubts if beyond is None or one.code != beyond.code]
    status = _status(result, doubts)
    return {
        "heliostat": result.name,
        "status": status,
        "diagnosis": ", ".join(result.diagnosis.named),
        "e_m": east,
        "n_m": north,
        "u_m": up,
        "model": result.free,
        "predicted_sky_beam_mrad": _sky_mrad(result),
        **headline(result),
        "found_over_expected": found_over_expected(result),
        "left_out": left_out_text(counts_of(result)),
        "bad_row_dates": ", ".join(bad_row_dates(result)),
        "work": work_of(result) or _doubt_in_words(status, doubts),
        "duration_s": round(result.duration_s, 4),
        "warnings_count": len(result.doubts),
        DOUBTS: [doubt_content(one) for one in result.doubts],
        "reason": "; ".join(one.text for one in doubts),
    }


def _doubt_in_words(status: str, doubts: Sequence[Doubt]) -> str:
    return f"{doubts[0].text}." if status == "doubtful" and doubts else ""


def _sky_mrad(result: HeliostatResult) -> float | None:
    sky = float("nan") if result.sky is None else result.sky.rms_beam_rad
    return 1e3 * sky if np.isfinite(sky) else None


def failed_row(name: str, reason: str, kind: str = "") -> dict[str, Any]:
    """Return the row of a heliostat that could not be calibrated."""
    return {"heliostat": name, "status": "failed", "diagnosis": kind, "reason": reason}


def worst_first(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Sort rows of the field: failed ones, then by the expected error of the beam over the sky, largest first."""
    by_name = sorted((dict(row) for row in rows), key=lambda row: str(row["heliostat"]))
    by_beam = sorted(by_name, key=_beam_mrad, reverse=True)
    return sorted(by_beam, key=lambda row: row["status"] != "failed")


def _beam_mrad(row: Mapping[str, Any]) -> float:
    # Without a map over the sky (no targets) what was found.
    for name in ("predicted_sky_beam_mrad", "beam_test_rms_mrad", "beam_all_rows_rms_mrad"):
        if row.get(name) is not None:
            return float(str(row[name]))
    return float("inf")


def write_field(folder: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write ``field.csv``, the worst heliostat first."""
    ordered = worst_first(rows)
    # The reason is long: it comes last, after whatever columns some row has.
    names = [name for name in dict.fromkeys(key for row in ordered for key in row) if name not in ("reason", DOUBTS)]
    columns = {name: ["" if row.get(name) is None else row[name] for row in ordered] for name in [*names, "reason"]}
    write_table_csv(folder / FIELD_FILE, {name: np.array(cells, dtype=object) for name, cells in columns.items()})


def field_summary(
    name: str,
    rows: list[dict[str, object]],
    shared: Shared,
    *,
    durations_s: Mapping[str, float],
    input_sha256: Mapping[str, str],
    of_field: Sequence[Doubt] = (),
) -> Summary:
    """Return the summary of a field.

    shared: What all heliostats share.
    of_field: What concerns the field as a whole.
    durations_s: Time of each stage [s].
    input_sha256: Hashes of what was read.
    """
    good = [row for row in rows if row["status"] != "failed"]
    numbers: dict[str, float | int | None] = {
        "heliostats_count": len(rows),
        "calibrated_count": len(good),
        "failed_count": len(rows) - len(good),
        "faulty_count": sum(row["status"] == "faulty" for row in rows),
        "doubtful_count": sum(row["status"] == "doubtful" for row in rows),
        "observations_count": sum(int(str(row["observations_count"])) for row in good),
        "without_doubt_count": sum(row["status"] == "ok" and not row["warnings_count"] for row in rows),
        "heliostat_doubts_count": sum(int(str(row["warnings_count"])) for row in good),
        "left_out_count": sum(int(str(row["left_out_count"])) for row in good),
    }
    missing = {}
    asked = ["beam_test_rms_mrad", "beam_train_rms_mrad", "normal_test_rms_mrad", "predicted_sigma_beam_mrad"]
    asked += ["predicted_sky_beam_mrad"]
    asked += [f"beam_{split.replace('-', '_')}_test_rms_mrad" for split in SPLIT_NAMES if shared.thorough]
    for key in asked:
        known = [float(str(row[key])) for row in good if row.get(key) is not None]
        if not known and key not in asked[:4]:
            continue
        numbers[f"median_{key}"] = float(np.median(known)) if known else None
        if not known:
            missing[f"median_{key}"] = "no heliostat has it"
    worst = worst_first(good)
    # Those of a faulty heliostat stand beside its fault.
    parts = {str(row["heliostat"]): _doubts_of(row) if row["status"] != "faulty" else () for row in good}
    together = [*of_field, *doubts_of_parts(parts, "heliostats")]
    doubts = [
        Doubt("heliostat_failed", f"{row['heliostat']} failed: {row['reason']}")
        for row in rows
        if row["status"] == "failed"
    ]
    doubts += [
        Doubt(
            "heliostat_faulty", f"{row['heliostat']} ({row['diagnosis']}): {row['reason']}", severity=Severity.SERIOUS
        )
        for row in rows
        if row["status"] == "faulty"
    ]
    texts = {"split": shared.split, "model": shared.free, "every split made": "yes" if shared.thorough else "no"}
    if worst:
        texts["worst"] = f"{worst[0]['heliostat']}: {_beam_mrad(worst[0]):.2f} mrad"
    return Summary(
        kind=FIELD_KIND,
        name=name,
        numbers=numbers,
        texts=texts,
        doubts=(*of_field, *doubts[: max(_MOST_DOUBTS - len(together), 0)], *together[len(of_field) :]),
        durations_s=durations_s,
        input_sha256=input_sha256,
        not_determined=missing,
    )


def _doubts_of(row: Mapping[str, Any]) -> tuple[Doubt, ...]:
    return tuple(read_doubt(one) for one in row.get(DOUBTS, ()))


def headline_text(rows: Sequence[Mapping[str, Any]], splits: Sequence[str] = ()) -> str:
    """Return the most important numbers in a few lines.

    rows: Rows of ``field.csv``, the worst first.
    splits: For a single heliostat: what came of each split.
    """
    lines = []
    shown = rows[:20]
    for row in shown:
        if row["status"] == "failed":
            lines.append(f"{row['heliostat']}: not calibrated: {row['reason']}")
            continue
        lines.append(
            f"{row['heliostat']}{_found(row)}: {row['used_count']} of {row['observations_count']} observations"
            f"{_aside(row)}, model {row['model']}: beam {_mrad(row['beam_train_rms_mrad'])} train, "
            f"{_mrad(row['beam_test_rms_mrad'])} test; normal {_mrad(row['normal_train_rms_mrad'])}, "
            f"{_mrad(row['normal_test_rms_mrad'])} (RMS)"
        )
    lines += splits if len(splits) > 1 else ()
    if len(rows) > len(shown):
        lines.append(f"... and {len(rows) - len(shown)} more, better ones: field.csv")
    return "\n".join(lines)


def _aside(row: Mapping[str, Any]) -> str:
    text = row.get("left_out") or ""
    return f" ({text})" if text else ""


def _found(row: Mapping[str, Any]) -> str:
    kinds = str(row.get("diagnosis") or "").replace("_", " ")
    return f" ({kinds})" if kinds else ""


def _mrad(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f} mrad"


def failed_heliostats(folder: Path) -> list[tuple[str, str]]:
    """Return the heliostats of a field that could not be calibrated, each with the reason.

    folder: Results of a field, or of one heliostat, which has none.
    """
    if not (folder / FIELD_FILE).is_file():
        return []
    table = read_table_csv(folder / FIELD_FILE, ("heliostat", "status", "reason"))
    rows = zip(table["heliostat"], table["status"], table["reason"], strict=True)
    return [(name, reason) for name, status, reason in rows if status == "failed"]
