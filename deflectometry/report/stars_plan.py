"""A plan of stars for the report: the best time, all times, and each facet at the best."""

from pathlib import Path

import numpy as np

from deflectometry.stars.planning.plan import FACETS_FILE, TIMES_FILE
from heliogauge.reporting import page
from heliogauge.reporting.html import FirstScreen, Html, beside, join
from heliogauge.reporting.look import LINE_X, LINE_Y
from heliogauge.reporting.notation import number_text
from heliogauge.reporting.verdict import verdict_of
from heliogauge.results.folder import SUMMARY_FILE, read_summary, read_table_csv, unit_of
from heliogauge.view.charts import ChartSeries, ChartView
from heliogauge.view.tables import TableColumn, TableView

#: Numbers of the best time: key and label.
_BEST = (
    ("stars_count", "Stars in all facets"),
    ("fewest_stars_count", "Stars in the poorest facet"),
    ("unknown_facets_count", "Facets that stay unknown"),
    ("sigma_canting_rms_rad", "Canting: sigma, RMS of all facets"),
    ("sigma_canting_rms_low_rad", "smallest, if the mirror leans"),
    ("sigma_canting_rms_high_rad", "largest, if the mirror leans"),
    ("sigma_canting_largest_rad", "Canting: largest sigma of a facet"),
    ("sigma_pointing_x_rad", "Mirror's lean in x: sigma"),
    ("sigma_pointing_y_rad", "Mirror's lean in y: sigma"),
)


def first(folder: Path) -> FirstScreen:
    """Return the best time with what it gives."""
    summary = read_summary(folder / SUMMARY_FILE)
    rows = [("Best time", summary.texts["best_time"], "")]
    for key, label in _BEST:
        name, unit = unit_of(key)
        rows.append((label, number_text(float(summary.numbers[key] or 0.0), None, unit, name), ""))
    line = f"{summary.kind}; heliogauge {summary.version}"
    return page.first_screen(summary.name, line, verdict_of(summary), rows, None)


def times(folder: Path) -> Html:
    """Return stars and sigmas over the night, and the facets at the best time."""
    names = ("time", "fewest_stars", "sigma_canting_rms_rad", "sigma_pointing_x_rad", "sigma_pointing_y_rad")
    table = read_table_csv(folder / TIMES_FILE, names)
    moments = np.array([one.removesuffix("Z") for one in table["time"]], dtype="datetime64[s]")
    hour = (moments - moments.min().astype("datetime64[D]")) / np.timedelta64(1, "h")
    fewest, canting, x, y = (np.array([float(cell) if cell else np.nan for cell in table[name]]) for name in names[1:])
    label = f"hours of {np.datetime_as_string(moments.min(), unit='D')}, UTC"
    stars = ChartView(
        "Stars in the poorest facet", label, "stars of the catalogue", (ChartSeries("stars", hour, fewest, LINE_X),)
    )
    sigmas = ChartView(
        "What one photo gives",
        label,
        "sigma [mrad]",
        (
            ChartSeries("canting, RMS of the facets that are determined", hour, 1e3 * canting, LINE_X),
            ChartSeries("mirror's lean", hour, 1e3 * np.hypot(x, y), LINE_Y),
        ),
    )
    return join(beside(stars, sigmas), _facets(folder))


def _facets(folder: Path) -> TableView:
    best = read_summary(folder / SUMMARY_FILE).texts["best_time"]
    names = ("facet", "stars", "sigma_canting_x_rad", "sigma_canting_y_rad")
    table = read_table_csv(folder / FACETS_FILE, ("time", *names))
    rows = [n for n, time in enumerate(table["time"]) if time == best]
    facet, stars, *sigmas = ([table[name][n] for n in rows] for name in names)
    texts = [[f"{1e3 * float(cell):.4f}" if cell else "\u2013" for cell in one] for one in sigmas]
    return TableView(
        f"Facets at {best}",
        (
            TableColumn("facet", facet),
            TableColumn("stars", stars, [float(one) for one in stars]),
            TableColumn("sigma of canting in x [mrad]", texts[0]),
            TableColumn("in y [mrad]", texts[1]),
        ),
    )
