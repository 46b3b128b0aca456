"""Report of the tests of a heliostat: from the files of its results."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.heliostat.performance.entries import Entry
from calibration.heliostat.performance.files.result import ENTRIES_FILE, read_entries, value_text
from heliogauge.reporting import page
from heliogauge.reporting.html import Html, Shown, join, wrap
from heliogauge.reporting.look import FAINT, LINE_X, LINE_Y
from heliogauge.reporting.verdict import verdict_of
from heliogauge.results.folder import Summary, read_summary, read_table_csv
from heliogauge.validate import FloatArray
from heliogauge.view.charts import ChartSeries, ChartView, Mark
from heliogauge.view.tables import TableColumn, TableView

#: What stands first of each test.
FIRST_KEYS = (
    "day_beam_rms_rad",
    "day_beam_spread_rad",
    "drift_right_beam_rad",
    "drift_up_beam_rad",
    "backlash_azimuth_axis_rad",
    "backlash_elevation_axis_rad",
    "repeat_right_beam_rad",
    "repeat_up_beam_rad",
    "wind_w1_1_beam_rms_rad",
    "sun_camera_normal_rms_rad",
    "reflectance_solar_weighted_share",
    "reflectance_reading_share",
    "quality_sd_rad",
    "quality_canting_rms_rad",
    "control_commands_answered_share",
    "control_faults_answered_share",
    "power_energy_wh",
)
TEST_WORDS = {
    "day": "Tracking over the day",
    "drift": "Drift and oscillation",
    "backlash": "Backlash",
    "repeat": "Repeatability",
    "wind": "Wind",
    "sun_camera": "Camera at the sun",
    "reflectance": "Reflectance",
    "quality": "Optical quality",
    "control": "Control",
    "power": "Energy used",
    "given": "Measured elsewhere",
    "year": "Energy over a year",
}


@dataclass(frozen=True, slots=True, eq=False)
class TestsReport:
    """What a folder of results holds.

    summary: Headline numbers, doubts, texts.
    entries: Lines of the data sheet.
    tables: Rows of tests by name.
    """

    __test__ = False
    folder: Path
    summary: Summary
    entries: tuple[Entry, ...]
    tables: dict[str, dict[str, list[str]]]


def open_tests(folder: str | Path = ".") -> TestsReport:
    """Read a folder of results.

    folder: The folder; the working directory without it.
    """
    folder = Path(folder)
    tables = {file.stem: read_table_csv(file) for file in sorted(folder.glob("*.csv")) if file.name != ENTRIES_FILE}
    return TestsReport(folder, read_summary(folder), read_entries(folder / ENTRIES_FILE)[1], tables)


def first_screen(report: TestsReport) -> Html:
    """Return name, verdict, headline numbers and where the beam went."""
    known = {one.name: one for one in report.entries}
    rows = [(known[key].label, value_text(known[key])) for key in FIRST_KEYS if key in known][:8]
    missing = [f"{one.label}: {one.note}" for one in report.entries if not one.is_measured]
    passed = [f"{TEST_WORDS[test]} evaluated" for test in dict.fromkeys(one.test for one in report.entries)]
    charts = beam_charts(report)
    line = f"tests of a heliostat; {report.summary.texts.get('date', '')}; heliogauge {report.summary.version}"
    verdict = verdict_of(report.summary, missing, passed)
    return page.first_screen(report.summary.name, line, verdict, rows, charts[0] if charts else None)


def beam_charts(report: TestsReport) -> list[ChartView]:
    """Return where the beam went over time in each test that has beams."""
    charts = []
    for name in ("day_rows", "drift_rows", "wind_rows"):
        table = report.tables.get(name)
        if table is not None:
            charts.append(series_chart(table, TEST_WORDS[name.removesuffix("_rows")]))
    return charts


def series_chart(table: dict[str, list[str]], title: str) -> ChartView:
    """Return the beam's error right and up over time, with its trend where there is one."""
    seconds = np.array([time.rstrip("Z") for time in table["time_utc"]], dtype="datetime64[ms]").astype(np.int64) / 1e3
    # Several days lie above each other, by the hour.
    days = np.unique(np.floor(seconds / 86_400))
    several = days.size > 1
    x = (seconds % 86_400) / 3600 if several else seconds
    series = []
    for key, sigma, trend, name, color in (
        ("beam_right_rad", "sigma_right_rad", "trend_right_rad", "right", LINE_X),
        ("beam_up_rad", "sigma_up_rad", "trend_up_rad", "up", LINE_Y),
    ):
        values = 1e3 * numbers(table[key])
        series.append(ChartSeries(name, x, values, color, Mark.POINTS, sigma=1e3 * numbers(table[sigma]), size_px=3))
        if trend in table:
            series.append(ChartSeries(f"{name}, cubic", x, 1e3 * numbers(table[trend]), color))
    ends = np.array([x.min(), x.max()])
    series.append(ChartSeries("aim", ends, np.zeros(2), FAINT, dashed=True))
    note = f"bars: 1 sigma of a centroid; {days.size} days" if several else "bars: 1 sigma of a centroid"
    label = "UTC [h]" if several else "UTC"
    return ChartView(title, label, "error of the beam [mrad]", tuple(series), note, x_time=not several)


def numbers(cells: list[str]) -> FloatArray:
    """Return cells as numbers, empty ones as NaN."""
    return np.array([float(cell) if cell else np.nan for cell in cells])


def entry_tables(report: TestsReport) -> Shown:
    """Return the entries of each test."""
    pieces: list[Shown] = []
    for test in dict.fromkeys(one.test for one in report.entries):
        chosen = [one for one in report.entries if one.test == test]
        pieces.append(Html(f"<h3>{TEST_WORDS[test]}</h3>"))
        rows = [(one.label, value_text(one), one.method, one.note) for one in chosen]
        pieces.append(page.table(("", "value \u00b1 1 sigma", "method", "note"), rows, numbers=(1,)))
    return join(*pieces)


def further_charts(report: TestsReport) -> Shown:
    """Return the charts of the other tests with beams, and how each of several days went."""
    pieces: list[Shown] = [*beam_charts(report)[1:]]
    days = report.tables.get("day_each")
    if days is not None:
        pieces.append(
            TableView(
                "Days",
                (
                    TableColumn("day", days["day"]),
                    TableColumn("beams", days["beams_count"], [float(one) for one in days["beams_count"]]),
                    TableColumn(
                        "RMS [mrad]",
                        [f"{1e3 * float(one):.3f}" for one in days["beam_rms_rad"]],
                        [float(one) for one in days["beam_rms_rad"]],
                    ),
                ),
            )
        )
    return wrap("<div>", pieces, "</div>") if pieces else Html("")


def making(report: TestsReport) -> Html:
    """Return what is said beside the numbers, times and input files."""
    rows = [(name.replace("_", " "), text) for name, text in report.summary.texts.items()]
    return join(page.table(("", ""), rows), page.duration_table(report), page.input_table(report))
