"""A series of photos of dots: how mirror and facets turn over time, and how their shape varies."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deflectometry.dots.series.pipeline.result import FACETS_FILE, SERIES_FILE
from heliogauge.reporting import page
from heliogauge.reporting.html import FirstScreen, Html, beside, join
from heliogauge.reporting.look import LINE_X, LINE_Y
from heliogauge.reporting.notation import number_text
from heliogauge.reporting.verdict import verdict_of
from heliogauge.results.folder import SUMMARY_FILE, Summary, read_summary, read_table_csv
from heliogauge.validate import FloatArray
from heliogauge.view.charts import ChartSeries, ChartView
from heliogauge.view.tables import TableColumn, TableView


@dataclass(frozen=True, slots=True, eq=False)
class SeriesFolder:
    """A folder of results.

    folder: The folder.
    summary: Headline numbers, doubts, texts.
    """

    folder: Path
    summary: Summary


def open_series(folder: Path) -> SeriesFolder:
    """Read a folder of results."""
    return SeriesFolder(folder, read_summary(folder / SUMMARY_FILE))


def first_screen(results: SeriesFolder) -> FirstScreen:
    """Return verdict, how far the mirror turns and how its shape varies, and the turns over time."""
    summary = results.summary
    numbers = {key: float(value or 0.0) for key, value in summary.numbers.items()}
    rows = []
    for axis in "xy":
        turn = number_text(numbers[f"turn_{axis}_range_rad"], numbers[f"sigma_turn_{axis}_rad"], "rad")
        rows.append((f"Range of turns in {axis}", turn, "of the mean normal"))
    for axis in "xy":
        said = f"{1e3 * numbers[f'sd{axis}_median_rad']:.3f} mrad"
        rows.append((f"SD{axis}, median", said, f"range {1e3 * numbers[f'sd{axis}_range_rad']:.3f} mrad"))
    measured, count = int(numbers["measured_frames_count"]), int(numbers["frames_count"])
    rows.append(("Frames", f"{measured} of {count}", f"{numbers['duration_s']:.3g} s"))
    line = f"{summary.kind}; angles of the normal, a beam turns by twice as much; heliogauge {summary.version}"
    return page.first_screen(summary.name, line, verdict_of(summary), rows, turns(results.folder))


def _numbers(cells: list[str]) -> FloatArray:
    return np.array([float(one) if one else np.nan for one in cells])


def _chart(table: dict[str, list[str]], key: str, title: str, label: str, note: str = "") -> ChartView:
    """Return a chart of two components over time [mrad]; ``{}`` in the key stands for the axis."""
    time_s = _numbers(table["time_s"])
    series = []
    for axis, color in (("x", LINE_X), ("y", LINE_Y)):
        name = key.format(axis)
        values, sigma = (1e3 * _numbers(table[one]) for one in (name, f"sigma_{name}"))
        series.append(ChartSeries(axis, time_s, values, color, sigma=sigma, labels=table["frame"]))
    return ChartView(title, "time [s]", label, tuple(series), note=note)


def turns(folder: Path) -> ChartView:
    """Return the turn of the mirror's mean normal over time."""
    table = read_table_csv(folder / SERIES_FILE, ("frame", "time_s"))
    note = "Slope of the mean normal against the first frame; gaps are frames that were not measured."
    return _chart(table, "turn_{}_rad", "Turn of the mirror", "turn [mrad]", note)


def shape(folder: Path) -> ChartView:
    """Return the RMS of the slope deviations over time."""
    table = read_table_csv(folder / SERIES_FILE, ("frame", "time_s"))
    return _chart(table, "sd{}_rad", "Slope deviation", "RMS [mrad]")


def facets(folder: Path) -> Html:
    """Return the tilt of each facet over time, with its title; nothing for a single one, which is the mirror."""
    table = read_table_csv(folder / FACETS_FILE, ("frame", "time_s", "facet"))
    names = list(dict.fromkeys(table["facet"]))
    if len(names) < 2:
        return Html("")
    charts = []
    for name in names:
        own = [row for row, facet in enumerate(table["facet"]) if facet == name]
        part = {key: [cells[row] for row in own] for key, cells in table.items()}
        charts.append(_chart(part, "tilt_{}_rad", f"Facet {name}", "tilt [mrad]"))
    head = (
        "<h2>Facets</h2><p>Slope of the mean normal of each against the first frame, in the mirror's frame there.</p>"
    )
    return join(Html(head), beside(*charts))


def flagged(folder: Path) -> Html:
    """Return the frames that are not measured, or open, with the reason and a title; nothing where all are well."""
    table = read_table_csv(folder / SERIES_FILE, ("frame", "time_s", "flag"))
    rows = [row for row, flag in enumerate(table["flag"]) if flag]
    if not rows:
        return Html("")
    columns = [TableColumn(label, [table[key][row] for row in rows]) for key, label in _FLAGGED]
    return join(Html("<h2>Flagged frames</h2>"), TableView("Flagged frames", tuple(columns)))


#: Columns of `flagged`: key and label.
_FLAGGED = (("frame", "frame"), ("time_s", "time [s]"), ("flag", "flag"))
