"""Diagnoses on disk: what a field compares of each heliostat, and what is written anew once it is compared."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from calibration.heliostat.diagnosis.findings import Check, Diagnosis
from calibration.heliostat.files.store_heliostat import AS_STATED_FILE, HELIOSTAT_FILE
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
    """Return a heliostat's row of ``field.csv`` with another diagnosis."""
    reason = str(row["reason"])
    texts = {one.text: one.text for one in new.doubts}
    for before, after in _pairs(old, new).items():
        reason = reason.replace(before, texts.get(after, after))
    status = "faulty" if new.kinds else "doubtful" if row["status"] == "faulty" else row["status"]
    return {**row, "status": status, "diagnosis": ", ".join(new.named), "reason": reason}


def rewrite_diagnosis(folder: Path, old: Diagnosis, new: Diagnosis) -> None:
    """Put another diagnosis into the files of a finished heliostat."""
    pairs = _pairs(old, new)
    severities = {one.text: one.severity.value for one in new.doubts}
    for name in (HELIOSTAT_FILE, AS_STATED_FILE, SUMMARY_FILE):
        if not (folder / name).is_file():
            continue
        content = read_json(folder / name)
        for doubt in content["doubts"]:
            doubt["text"] = pairs.get(doubt["text"], doubt["text"])
            doubt["severity"] = severities.get(doubt["text"], doubt["severity"])
        if "diagnosis" in content:
            for finding in content["diagnosis"]["findings"]:
                said = next((one for one in new.findings if one.text.startswith(finding["text"])), None)
                if said is not None:
                    finding |= {"text": said.text, "severity": said.severity}
        write_json(folder / name, content)


def _pairs(old: Diagnosis, new: Diagnosis) -> dict[str, str]:
    """Return the texts of doubts that changed: a finding's new text begins with the old one."""
    found = {}
    for before in old.findings:
        after = next((one for one in new.findings if one.text.startswith(before.text)), before)
        if after.text != before.text:
            found[before.doubt.text] = after.doubt.text
    return found
