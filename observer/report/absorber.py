"""Sections of the report of an absorber measured alone; each is one cell of its notebook."""

from dataclasses import dataclass
from pathlib import Path

from heliogauge.reporting import page
from heliogauge.reporting.html import Html, join, table
from heliogauge.results.folder import Summary, read_summary, read_table_csv
from observer.files import COLLECTOR, read_collector
from observer.report.lines import absorber as profiles
from observer.report.lines import listed
from observer.report.results import Columns
from observer.report.sections import headline_table
from observer.trough.collector import Collector

#: Numbers of the headline table and what they are called there.
LABELS: dict[str, str] = {
    "absorber_mean_x_m": "Mean X_a, across, + towards +x",
    "absorber_mean_z_offset_m": "Mean Z_a from the focal line, + away from the mirror",
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


def head(results: AbsorberResults) -> Html:
    """Return title and warnings."""
    return page.head(results, f"absorber of a trough; {results.summary.texts.get('design', '')}")


def overview(results: AbsorberResults) -> Html:
    """Return the headline numbers."""
    return headline_table(results.summary, LABELS)


def absorber(results: AbsorberResults) -> Html:
    """Return the profiles along the trough, the sag of each span, and the stations."""
    columns = results.table("absorber.csv")
    count = 0 if columns is None else len(columns["y_m"])
    folded = f"<details><summary>{count} stations</summary>{listed(columns).text}</details>"
    return join(profiles(results), Html(folded))


def refused(results: AbsorberResults) -> Html:
    """Return photos and targets that were not used, with reasons."""
    columns = results.table("rejected.csv") or {"name": [], "reason": []}
    rows = list(zip(columns["name"], columns["reason"], strict=True))
    return table(("not used", "why"), rows) if rows else Html("<p>All photos and targets were used.</p>")


def making(results: AbsorberResults) -> Html:
    """Return times and input files."""
    return join(page.duration_table(results), page.input_table(results))
