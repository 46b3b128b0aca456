"""Diagnoses on disk: what a field compares of each heliostat, and what is written anew once it is compared."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from calibration.heliostat.diagnosis.findings import Check, Diagnosis
from calibration.heliostat.files.field_work import work_of_findings
from calibration.heliostat.files.store_field import DOUBTS
from calibration.heliostat.files.store_heliostat import AS_STATED_FILE, HELIOSTAT_FILE
from heliogauge.doubts import doubt_content
from heliogauge.results.folder import SUMMARY_FILE, write_json
from heliogauge.results.json_file import read_json

#: Key of a heliostat's row, while the field is calibrated, for what is compared.
VIEW = "view"
_MOST_ROWS = 50


def view_of(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return what of a diagnosis others are compared with: small enough to be kept of 10,000 heliostats."""
    content = diagnosis.content()
    for finding in content["findings"]:
        finding["rows"], finding["images"] = finding["rows"][:_MOST_ROWS], []
    checks: list[Check] = [one for one in diagnosis.checks if one.values.size]
    return {**content, "checks": [one.content() for one in checks]}


def changed_row(row: Mapping[str, Any], old: Diagnosis, new: Diagnosis) -> dict[str, Any]:
    """Return a heliostat's row of ``field.csv`` with another diagnosis; its findings stand where they stood."""
    # The reason begins with what the diagnosis says.
    before, after = ("; ".join(one.text for one in diagnosis.doubts) for diagnosis in (old, new))
    status = "faulty" if new.kinds else "doubtful" if row["status"] == "faulty" else row["status"]
    said = {"status": status, "diagnosis": ", ".join(new.named), "reason": after + str(row["reason"])[len(before) :]}
    doubts = [*(doubt_content(one) for one in new.doubts), *row[DOUBTS][len(old.doubts) :]]
    return {**row, **said, "work": work_of_findings(new.findings), "warnings_count": len(doubts), DOUBTS: doubts}


def rewrite_diagnosis(folder: Path, old: Diagnosis, new: Diagnosis) -> None:
    """Put another diagnosis into the files of a finished heliostat; its findings stand where they stood."""
    own = [doubt_content(one) for one in new.doubts]
    for name in (HELIOSTAT_FILE, AS_STATED_FILE, SUMMARY_FILE):
        if not (folder / name).is_file():
            continue
        content = read_json(folder / name)
        # Doubts begin with those of the diagnosis.
        content["doubts"] = own + content["doubts"][len(old.doubts) :]
        if "diagnosis" in content:
            for finding, now in zip(content["diagnosis"]["findings"], new.findings, strict=True):
                finding |= {"text": now.text, "severity": now.severity}
        write_json(folder / name, content)
