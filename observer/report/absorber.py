"""Sections of the report of an absorber measured alone; each is one cell of its notebook."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from heliogauge.reporting import page
from heliogauge.reporting.html import FirstScreen, Html, join, wrap
from heliogauge.reporting.verdict import verdict_of
from heliogauge.results.folder import Summary, read_summary, read_table_csv
from observer.files import COLLECTOR, read_collector
from observer.report.lines import absorber_view, listed
from observer.report.results import Columns, numbers
from observer.report.sections import headline_rows, not_used, numbers_table, stations_missing
from observer.trough.collector import Collector

#: Numbers of the first screen and what they are called there.
LABELS: dict[str, str] = {
    "absorber_mean_x_m": "Mean X_a, across, + towards +x",
    "absorber_mean_z_offset_m": "Mean Z_a",
    "absorber_tilt_x_rad": "Tilt across",
    "absorber_tilt_z_rad": "Tilt along the optical axis",
    "absorber_sag_down_m": "Largest sag downward",
    "absorber_range_x_m": "Range of X_a along the trough",
    "absorber_range_z_m": "Range of Z_a along the trough",
    "photos_count": "Photos",
    "absorber_stations_measured_count": "Stations measured",
}


@dataclass(frozen=True, slots=True, eq=False)
class AbsorberResults:
    """What a folder with an absorber measured alone holds."""

    folder: Path
    summary: Summary
    collector: Collector

    def table(self, name: str) -> Columns | None:
        """Return a table of the folder as text; None where there is none."""
        path = self.folder / name
        return read_table_csv(path) if path.is_file() else None


def open_absorber(folder: str | Path = ".") -> AbsorberResults:
    """Read a folder with an absorber measured alone.

    folder: The folder; the working directory without it.
    """
    folder = Path(folder)
    return AbsorberResults(folder, read_summary(folder), read_collector(folder / COLLECTOR))


def head(results: AbsorberResults) -> FirstScreen:
    """Return the first screen: verdict, headline numbers, where the absorber runs."""
    summary = results.summary
    line = f"absorber of a trough; {summary.texts.get('design', '')}; heliogauge {summary.version}"
    columns = results.table("absorber.csv") or {"x_a_m": []}
    measured = int(np.isfinite(numbers(columns, "x_a_m")).sum())
    passed = [f"{measured} stations measured"] if measured else []
    verdict = verdict_of(summary, stations_missing(results), passed)
    return page.first_screen(summary.name, line, verdict, headline_rows(summary, LABELS), absorber_view(results, "xz"))


def doubts(results: AbsorberResults) -> Html:
    """Return all doubts with all their words."""
    return page.doubts_box(results)


def absorber(results: AbsorberResults) -> Html:
    """Return the sag of each span, and the stations."""
    columns = results.table("absorber.csv")
    count = 0 if columns is None else len(columns["y_m"])
    stations = listed(columns, "stations of the absorber")
    folded = wrap(f"<details><summary>{count} stations</summary>", [stations], "</details>")
    return join(listed(results.table("absorber_spans.csv"), "spans of the absorber"), folded)


def overview(results: AbsorberResults) -> Html:
    """Return all numbers."""
    return numbers_table(results.summary)


def refused(results: AbsorberResults) -> Html:
    """Return photos and targets that were not used, with reasons."""
    return not_used(results)


def making(results: AbsorberResults) -> Html:
    """Return how long each stage took."""
    return page.duration_table(results)


def inputs(results: AbsorberResults) -> Html:
    """Return the files that were read."""
    return page.input_table(results)
