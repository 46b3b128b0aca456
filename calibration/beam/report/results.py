"""A folder of measured beams as its report reads it."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.beam.files.result import BEAMS_FILE
from heliogauge.results.folder import Summary, read_summary, read_table_csv
from heliogauge.validate import BoolArray, FloatArray

__all__ = ["BeamsReport", "open_beams"]


@dataclass(frozen=True, slots=True, eq=False)
class BeamsReport:
    """What a folder of results holds.

    folder: The folder.
    summary: Headline numbers, doubts, texts.
    table: Columns of beams.csv as texts.
    """

    folder: Path
    summary: Summary
    table: Mapping[str, list[str]]

    def numbers(self, name: str) -> FloatArray:
        """Return a column as numbers; NaN where a cell is empty."""
        cells = self.table.get(name)
        count = len(self.table["image"])
        return np.array([float(cell) if cell else np.nan for cell in cells] if cells else [np.nan] * count)

    @property
    def used(self) -> BoolArray:
        """Beams that can be used, shape (n,)."""
        return np.asarray((self.numbers("rejected") == 0) & np.isfinite(self.numbers("x_m")))


def open_beams(folder: str | Path = ".") -> BeamsReport:
    """Read a folder of results.

    folder: The folder; the working directory without it.
    """
    folder = Path(folder)
    return BeamsReport(folder, read_summary(folder / "summary.json"), read_table_csv(folder / BEAMS_FILE))
