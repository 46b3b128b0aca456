"""What the report of a batch shows: counts, one headline number of all measurements, and the index as a table."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite, nan
from pathlib import Path

import numpy as np

from heliogauge.batch.rows import AFTER, BEFORE, FAILED, INDEX_FILE, MEASURED
from heliogauge.reporting import page
from heliogauge.reporting.html import Html
from heliogauge.reporting.notation import number_text
from heliogauge.reporting.verdict import verdict_of
from heliogauge.results.folder import Summary, read_summary, read_table_csv, unit_of
from heliogauge.view.charts import ChartSeries, ChartView, Mark
from heliogauge.view.tables import TableColumn, TableView

#: Headline numbers that the table shows; index.csv has more.
_SHOWN_NUMBERS = 4
_BLUE = "#1f6fb4"
#: Words of names that are no plain words.
_PROPER = {"sdx": "SDx", "sdy": "SDy", "sd": "SD", "rms": "RMS"}


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """A batch as its folder has it.

    columns: The columns of ``index.csv`` by name, as text.
    """

    summary: Summary
    columns: dict[str, list[str]]

    @property
    def number_keys(self) -> tuple[str, ...]:
        """Names of the headline numbers, without their sigmas, those that most measurements have first."""
        keys = [key for key in self.columns if key not in {*BEFORE, *AFTER} and not key.startswith("sigma_")]
        filled = {key: sum(map(bool, self.columns[key])) for key in keys}
        return tuple(sorted(keys, key=lambda key: -filled[key]))

    def numbers(self, key: str) -> list[float]:
        """Return a column as numbers; NaN where there is none."""
        return [float(cell) if cell else nan for cell in self.columns.get(key, [""] * len(self.columns["name"]))]


def open_batch(folder: Path) -> Batch:
    """Read the summary and the index of a batch.

    InputError: One is missing or damaged.
    """
    return Batch(read_summary(folder), read_table_csv(folder / INDEX_FILE, (*BEFORE, *AFTER)))


def first_screen(batch: Batch) -> Html:
    """Return name, verdict, counts and medians, and the first headline number of all measurements."""
    numbers = batch.summary.numbers
    count, failed = int(numbers["measurements_count"] or 0), int(numbers["failed_count"] or 0)
    measured = int(numbers["measured_count"] or 0)
    sure = measured - int(numbers["doubtful_count"] or 0) - int(numbers["seriously_doubtful_count"] or 0)
    verdict = verdict_of(
        batch.summary,
        missing=(f"{failed} of {count} measurements failed",) if failed else (),
        passed=(f"{sure} of {count} measurements without a doubt",) if sure else (),
    )
    rows = [("Folders measured", f"{measured} of {count}")]
    for key, value in numbers.items():
        if key.startswith("median_") and value is not None:
            name, unit = unit_of(key)
            rows.append((_words(name), number_text(value, None, unit, name)))
    line = (
        f"{count} measurements: {batch.summary.texts.get('kinds', 'none measured')}; heliogauge {batch.summary.version}"
    )
    return page.first_screen(batch.summary.name, line, verdict, rows, headline_chart(batch))


def headline_chart(batch: Batch) -> ChartView | None:
    """Return the first headline number of the most frequent kind, with its sigma, measurement by measurement."""
    kinds = Counter(
        kind for kind, status in zip(batch.columns["kind"], batch.columns["status"], strict=True) if status == MEASURED
    )
    if not kinds:
        return None
    kind = kinds.most_common(1)[0][0]
    chosen = np.array([one == kind for one in batch.columns["kind"]])
    for key in batch.number_keys:
        values = np.where(chosen, batch.numbers(key), nan)
        name, unit = unit_of(key)
        good = np.flatnonzero(np.isfinite(values))
        if unit and good.size:
            break
    else:
        return None
    scale, unit = (1e3, f"m{unit}") if unit == "rad" or (unit == "m" and np.nanmax(abs(values)) < 0.1) else (1.0, unit)
    sigma = scale * np.array(batch.numbers(f"sigma_{key}"))[good]
    labels = [batch.columns["name"][index] for index in good]
    series = ChartSeries(
        _words(name),
        np.asarray(1.0 + good, dtype=np.float64),
        scale * values[good],
        _BLUE,
        mark=Mark.POINTS,
        sigma=sigma if np.isfinite(sigma).all() else None,
        labels=labels,
        size_px=5,
    )
    words = _words(name)
    place = "measurement, in the order of the index"
    return ChartView(f"{words} ({kind})", place, f"{words} [{unit}]", (series,), x_counts=True)


def index_table(batch: Batch) -> TableView:
    """Return the index as a table that sorts, with links to the reports of the measurements."""
    columns, count = batch.columns, len(batch.columns["name"])
    reasons = [
        reason if status == FAILED else status
        for reason, status in zip(columns["reason"], columns["status"], strict=True)
    ]
    shown = [
        TableColumn("measurement", columns["name"], links=columns["link"]),
        TableColumn("kind", columns["kind"]),
        TableColumn("status", reasons),
    ]
    for key in batch.number_keys[:_SHOWN_NUMBERS]:
        name, _ = unit_of(key)
        shown.append(TableColumn(_words(name), _number_texts(batch, key), numbers=batch.numbers(key)))
    shares = batch.numbers("measured_share")
    if any(map(isfinite, shares)):
        shown.append(
            TableColumn("measured", _texts(shares, lambda index: f"{100 * shares[index]:.1f} %"), numbers=shares)
        )
    for key, words in (("serious_doubts_count", "serious"), ("doubts_count", "doubts"), ("notes_count", "notes")):
        shown.append(TableColumn(words, columns[key], numbers=batch.numbers(key)))
    seconds = batch.numbers("duration_s")
    shown.append(TableColumn("time", _texts(seconds, lambda index: f"{seconds[index]:.1f} s"), numbers=seconds))
    return TableView(f"{count} measurements", tuple(shown))


def _texts(values: Sequence[float], text: Callable[[int], str]) -> list[str]:
    return [text(index) if isfinite(value) else "" for index, value in enumerate(values)]


def _number_texts(batch: Batch, key: str) -> list[str]:
    (name, unit), values, sigmas = unit_of(key), batch.numbers(key), batch.numbers(f"sigma_{key}")

    def text(index: int) -> str:
        value = int(values[index]) if name.endswith("_count") else values[index]
        return number_text(value, sigmas[index] if isfinite(sigmas[index]) else None, unit, name)

    return _texts(values, text)


def _words(name: str) -> str:
    words = name.removesuffix("_count").split("_")
    text = " ".join(_PROPER.get(word, word) for word in words)
    return text[:1].upper() + text[1:]
