"""Sections of the report of a planned network; each is one cell of its notebook."""

import numpy as np

from heliogauge.reporting import page
from heliogauge.reporting.html import Html, Shown, join, table_under_name
from heliogauge.reporting.look import INK
from heliogauge.reporting.verdict import verdict_of
from heliogauge.view.charts import ChartSeries, ChartView, Mark
from heliogauge.view.scenes import SceneView
from heliogauge.view.tables import TableColumn, TableView
from photogrammetry.report import charts, tables
from photogrammetry.report.network import NetworkResults
from photogrammetry.report.scene import network_view

#: Numbers of the first screen and what they are called there.
LABELS: dict[str, str] = {
    "photos_count": "Photos to take",
    "point_sigma_rms_m": "RMS sigma of all coordinates",
    "point_sigma_largest_m": "Largest sigma of a coordinate",
    "wanted_sigma_m": "Wanted",
    "sigma_with_known_cameras_rms_m": "RMS sigma if cameras and scale were known without error",
    "relative_precision_ratio": "Relative precision",
    "q_ratio": "q of the planning rule",
    "distance_m": "Distance of the camera",
    "convergence_median_deg": "Largest angle between two rays, median of the targets",
    "least_rays_count": "Photos that see the target seen least",
    "image_coverage_share": "Share of the image with targets",
}
_COLORS = ("#1b6ca8", "#c8552b", "#2f8f5b", "#8a4fa3", "#b8860b", "#66717d", "#d14d8b", "#3aa6a6", "#5a5a5a", "#999900")


def first_screen(results: NetworkResults) -> Html:
    """Return name, answer, headline numbers and the planned network in space."""
    summary = results.summary
    line = f"plan of a photogrammetric measurement; {summary.texts.get('answer', '')}; heliogauge {summary.version}"
    unseen = len(results.points.ids) - len(results.known)
    missing = [f"{unseen} of {len(results.points.ids)} targets cannot be determined"] if unseen else []
    codes, passed = {one.code for one in summary.doubts}, []
    wanted, reached = (summary.numbers.get(key) for key in ("wanted_sigma_m", "point_sigma_rms_m"))
    if wanted and reached and "plan_goal_not_reached" not in codes:
        passed.append(f"the wanted sigma of {1e3 * wanted:.3g} mm is reached")
    return page.first_screen(
        summary.name,
        line,
        verdict_of(summary, missing, passed),
        tables.headline_rows(summary, LABELS),
        _network(results),
    )


def _network(results: NetworkResults) -> SceneView | None:
    if not len(results.known):
        return None
    roll = results.column("stations", "roll_deg")
    notes = [f"{name}: turned by {turn:.0f} deg" for name, turn in zip(results.poses, roll, strict=True)]
    return network_view(results, notes, name="Planned network")


def numbers(results: NetworkResults) -> Html:
    """Return what is said beside the numbers, and all of them, folded."""
    every = tables.number_table(results.summary).text
    folded = f"<details><summary>All {len(results.summary.numbers)} numbers</summary>{every}</details>"
    return join(tables.text_table(results.summary), Html(folded))


def search(results: NetworkResults) -> Shown:
    """Return sigma against the number of photos for every layout that was tried."""
    columns = results.tables["trials"]
    layouts = np.array(columns["layout"])
    count, sigma = results.column("trials", "photos_count"), 1e3 * results.column("trials", "sigma_rms_m")
    largest = 1e3 * results.column("trials", "sigma_largest_m")
    chosen = results.column("trials", "chosen") == 1
    known = np.isfinite(sigma)
    series = []
    for place, layout in enumerate(dict.fromkeys(layouts.tolist())):
        own = np.nonzero((layouts == layout) & known)[0]
        own = own[np.argsort(count[own], kind="stable")]
        if own.size:
            color = _COLORS[place % len(_COLORS)]
            series.append(ChartSeries(layout, count[own], sigma[own], color))
    own = np.nonzero(chosen & known)[0]
    labels = layouts[own].tolist()
    series.append(ChartSeries("chosen", count[own], sigma[own], INK, Mark.POINTS, labels=labels, size_px=8))
    wanted = results.summary.numbers.get("wanted_sigma_m")
    if wanted and known.any():
        ends = np.array([count[known].min(), count[known].max()])
        series.append(ChartSeries("wanted", ends, np.full(2, 1e3 * float(wanted)), INK, dashed=True))
    chart = ChartView(
        "Sigma against the number of photos",
        "photos",
        "RMS sigma of all coordinates [mm]",
        tuple(series),
        "of all layouts that were tried",
        x_log=True,
        y_log=True,
    )
    digits = tables.digits_for(sigma)
    listed = TableView(
        "Networks that were tried",
        (
            TableColumn("layout", columns["layout"]),
            tables.number_column("photos", count, 0),
            tables.number_column("RMS sigma [mm]", sigma, digits),
            tables.number_column("largest sigma [mm]", largest, digits),
            tables.number_column("least rays", results.column("trials", "least_rays"), 0),
            TableColumn("chosen", ["yes" if one else "" for one in chosen]),
            TableColumn("why not", columns["reason"]),
        ),
        most_rows=15,
    )
    return join(chart, table_under_name(listed))


def sigmas(results: NetworkResults) -> Shown:
    """Return the expected sigma of each target."""
    listed = tables.point_table(results)
    if listed is None:
        return Html("<p>No target can be determined.</p>")
    return join(charts.ray_chart(results), table_under_name(listed))


def stations(results: NetworkResults) -> Shown:
    """Return where to take the photos."""
    columns = results.tables["stations"]
    number = {name: results.column("stations", name) for name in columns if name != "name"}
    looks = np.stack([number[f"direction_{axis}"] for axis in "xyz"], axis=1)

    return TableView(
        "Photos to take",
        (
            TableColumn("photo", columns["name"]),
            *(tables.number_column(f"{axis} [m]", number[f"{axis}_m"], 2) for axis in "xyz"),
            TableColumn("looks along", [", ".join(f"{value:+.3f}" for value in row) for row in looks]),
            tables.number_column("turned [deg]", number["roll_deg"], 0),
            tables.number_column("ring [deg]", number["ring_deg"], 0),
            tables.number_column("azimuth [deg]", number["azimuth_deg"], 0),
            tables.number_column("targets", number["targets_count"], 0),
        ),
    )


def making(results: NetworkResults) -> Html:
    """Return times and input files."""
    return join(page.duration_table(results), page.input_table(results))
