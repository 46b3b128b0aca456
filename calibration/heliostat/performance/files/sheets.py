"""Data sheets on disk: a page and a PDF for each heliostat, sheet.csv, summary.json."""

import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from calibration.heliostat.performance.entries import Conformity
from calibration.heliostat.performance.files.result import value_text
from calibration.heliostat.performance.report.sheet_page import sheet_page
from calibration.heliostat.performance.sheet import Sheet, decision_rule
from heliogauge.doubts import Severity
from heliogauge.errors import InputError
from heliogauge.results.folder import Summary, write_table_csv
from heliogauge.results.frame import InstrumentResult

SHEET_FILE = "sheet.csv"


@dataclass(frozen=True, slots=True, eq=False)
class Sheets(InstrumentResult):
    """Data sheets.

    sheets: One of each heliostat.
    pdf: Whether PDF is made as well.
    confidence: Probability at which passing or failing counts as proven.
    """

    kind: ClassVar[str] = "heliostat-sheet"
    sheets: tuple[Sheet, ...]
    pdf: bool
    confidence: float

    def summarise(self) -> Summary:
        """Count what passed."""
        states = Counter(line.decision.conformity for sheet in self.sheets for line in sheet.lines)
        numbers: dict[str, float | int | None] = {"heliostats_count": len(self.sheets)}
        for state in Conformity:
            name = state.name.lower()
            numbers[f"{name}_count"] = states[state]
        numbers["doubts_count"] = sum(one.severity is not Severity.NOTE for one in self.doubts)
        texts = {"decision": decision_rule(self.confidence)}
        return self._summary(numbers, texts)

    def write_files(self, folder: Path) -> None:
        """Write a page, a PDF and the lines of all sheets into an existing folder.

        InputError: PDF is asked for and cannot be made; `--no-pdf` leaves it out.
        """
        from heliogauge.reporting.print_pdf import write_pdf

        names = file_names([sheet.name for sheet in self.sheets])
        for sheet, name in zip(self.sheets, names, strict=True):
            page = sheet_page(sheet, self.confidence)
            (folder / f"{name}.html").write_text(page, encoding="utf-8")
            if self.pdf:
                try:
                    write_pdf(sheet_page(sheet, self.confidence, printed=True), folder / f"{name}.pdf")
                except InputError as error:
                    raise InputError(f"{error}; or leave PDF out with --no-pdf") from error
        write_table_csv(folder / SHEET_FILE, self._columns())

    def _columns(self) -> dict[str, list[Any]]:
        rows = [(sheet.name, line) for sheet in self.sheets for line in sheet.lines]
        nan = float("nan")
        return {
            "heliostat": [name for name, _ in rows],
            "entry": [line.entry.name for _, line in rows],
            "label": [line.entry.label for _, line in rows],
            "value": [nan if line.entry.value is None else line.entry.value for _, line in rows],
            "below": [nan if line.entry.below is None else line.entry.below for _, line in rows],
            "sigma": [nan if line.entry.sigma is None else line.entry.sigma for _, line in rows],
            "least": [nan if line.limit is None or line.limit.least is None else line.limit.least for _, line in rows],
            "most": [nan if line.limit is None or line.limit.most is None else line.limit.most for _, line in rows],
            "probability": [
                nan if line.decision.probability is None else line.decision.probability for _, line in rows
            ],
            "conformity": [str(line.decision.conformity) for _, line in rows],
            "method": [line.entry.method for _, line in rows],
            "date": [line.entry.date for _, line in rows],
            "conditions": [line.entry.conditions for _, line in rows],
            "note": [line.entry.note for _, line in rows],
        }

    def headline(self) -> str:
        """Return what passed and what did not, of each heliostat."""
        lines = []
        for sheet in self.sheets:
            said = [f"{sheet.count(state)} {state}" for state in Conformity if state and sheet.count(state)]
            lines.append(f"{sheet.name}: {', '.join(said) or 'no limits'}")
            lines += [
                f"  {one.decision.conformity}: {one.entry.label}: {value_text(one.entry)}"
                for one in sheet.lines
                if one.decision.conformity in (Conformity.FAIL, Conformity.CONDITIONAL_FAIL, Conformity.UNDECIDED)
            ]
        return "\n".join(lines)


def file_names(names: list[str]) -> list[str]:
    """Return names of files for names of heliostats, each once.

    >>> file_names(["AB 12", "AB/12"])
    ['AB_12', 'AB_12-2']
    """
    found: list[str] = []
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9._-]+", "_", name).strip("._") or "heliostat"
        number = 1
        while (chosen := plain if number == 1 else f"{plain}-{number}") in found:
            number += 1
        found.append(chosen)
    return found
