"""What a folder of a heliostat's results holds, read back for its report."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calibration.heliostat.files.store_heliostat import read_heliostat
from heliogauge.errors import InputError
from heliogauge.results.folder import Summary, read_summary, read_table_csv
from heliogauge.validate import BoolArray, FloatArray, TimeArray, freeze

_FIELD_COLUMNS = (
    "heliostat",
    "status",
    "e_m",
    "n_m",
    "predicted_sky_beam_mrad",
    "beam_test_rms_mrad",
    "predicted_sigma_beam_mrad",
    "found_over_expected",
    "bad_row_dates",
    "work",
)
_NUMBERS = (
    "sun_azimuth_deg",
    "sun_elevation_deg",
    "measured_x_m",
    "measured_y_m",
    "predicted_x_m",
    "predicted_y_m",
    "residual_right_mrad",
    "residual_up_mrad",
    "residual_beam_mrad",
    "residual_normal_mrad",
    "sigma_mrad",
    "weight",
)


@dataclass(frozen=True, slots=True, eq=False)
class ResidualTable:
    """The rows of residuals.csv.

    observation, target, split, flag, reason length n: Name of each observation, its target, "train" or "test", why
        it is left out.
    time (n,): When it was taken; NaT where nobody knows.
    numbers (n,): Columns of numbers; NaN where a cell is empty.
    """

    observation: tuple[str, ...]
    target: tuple[str, ...]
    split: tuple[str, ...]
    flag: tuple[str, ...]
    reason: tuple[str, ...]
    time: TimeArray
    numbers: dict[str, FloatArray]

    def __len__(self) -> int:
        return len(self.observation)

    @property
    def used(self) -> BoolArray:
        """Rows that are neither flagged nor without a residual, shape (n,)."""
        clean = np.array([not flag for flag in self.flag], dtype=np.bool_)
        return np.asarray(clean & np.isfinite(self.numbers["residual_beam_mrad"]))

    @property
    def is_test(self) -> BoolArray:
        """Rows that the shown residuals were predicted for, not fitted to, shape (n,)."""
        return np.array([split == "test" for split in self.split], dtype=np.bool_)


@dataclass(frozen=True, slots=True, eq=False)
class HeliostatReport:
    """What a folder of one heliostat's results holds.

    summary: Headline numbers, warnings, texts.
    content: heliostat.json.
    residuals: residuals.csv.
    """

    folder: Path
    summary: Summary
    content: dict[str, Any]
    residuals: ResidualTable


@dataclass(frozen=True, slots=True, eq=False)
class FieldReport:
    """What a folder of a field's results holds.

    rows: Columns of field.csv, the worst heliostat first.
    """

    folder: Path
    summary: Summary
    rows: dict[str, tuple[str, ...]]

    def numbers(self, name: str) -> FloatArray:
        """Return a column as numbers, NaN where a cell is empty, shape (n,)."""
        return _numbers(self.folder / "field.csv", name, self.rows[name])


def open_heliostat(folder: str | Path = ".") -> HeliostatReport:
    """Read the results of one heliostat.

    folder: The folder; the working directory without it.
    """
    folder = Path(folder)
    content = read_heliostat(folder)
    return HeliostatReport(folder, read_summary(folder / "summary.json"), content, _residuals(folder / "residuals.csv"))


def open_field(folder: str | Path = ".") -> FieldReport:
    """Read the results of a field.

    folder: The folder; the working directory without it.
    """
    folder = Path(folder)
    rows = read_table_csv(folder / "field.csv", _FIELD_COLUMNS)
    table = {name: tuple(cells) for name, cells in rows.items()}
    return FieldReport(folder, read_summary(folder / "summary.json"), table)


def _residuals(path: Path) -> ResidualTable:
    rows = read_table_csv(path, ("observation", "time_utc", "target", "split", "flag", "reason", *_NUMBERS))
    try:
        times = np.array([cell.removesuffix("Z") or "NaT" for cell in rows["time_utc"]], dtype="datetime64[ms]")
    except ValueError as error:
        raise InputError(f"{path}: time_utc holds something that is no time ({error})") from error
    return ResidualTable(
        tuple(rows["observation"]),
        tuple(rows["target"]),
        tuple(rows["split"]),
        tuple(rows["flag"]),
        tuple(rows["reason"]),
        freeze(times),
        {name: _numbers(path, name, rows[name]) for name in _NUMBERS},
    )


def _numbers(path: Path, name: str, cells: list[str] | tuple[str, ...]) -> FloatArray:
    try:
        return np.asarray(freeze(np.array([float(cell) if cell else np.nan for cell in cells])))
    except ValueError as error:
        raise InputError(f"{path}: column {name} holds something that is no number ({error})") from error
