"""What the notebook of the report calls: one function for each part of the page."""

from collections.abc import Mapping

import numpy as np

from deflectometry.pipeline.headline import measured_of
from deflectometry.report.canting import canting_section
from deflectometry.report.inputs import stated_table
from deflectometry.report.light import light
from deflectometry.report.maps import (
    distribution_chart,
    facet_mark,
    facet_views,
    image_view,
    section_chart,
    shape_view,
    slope_view,
)
from deflectometry.shape.facet_canting import CANTING_FILE
from heliogauge.reporting import page
from heliogauge.reporting.html import Html, beside, join, table, table_under_name
from heliogauge.reporting.look import INK, LINE_X, LINE_Y
from heliogauge.reporting.notation import number_text
from heliogauge.reporting.page import (
    doubts_box,
    duration_table,
    flag_table,
    input_table,
    number_table,
    statistics_table,
    text_table,
)
from heliogauge.reporting.results import Results, open_results
from heliogauge.reporting.uncertainty import uncertainty_shares
from heliogauge.reporting.verdict import holes, verdict_of
from heliogauge.results.folder import Summary, read_table_csv, unit_of
from heliogauge.view.charts import ChartSeries, ChartView, Mark
from heliogauge.view.maps import MapView
from heliogauge.view.tables import TableColumn, TableView

__all__ = [
    "canting_section",
    "charts",
    "doubts_box",
    "duration_table",
    "facet_section",
    "facet_table",
    "facet_views",
    "first_screen",
    "flag_table",
    "image_view",
    "input_table",
    "light",
    "making",
    "number_table",
    "open_results",
    "setup",
    "shape_view",
    "share_table",
    "slope_view",
    "stated_table",
    "statistics_table",
    "text_table",
]

#: Headline numbers: key, label, note.
HEADLINE = (
    ("sd_rad", "SD", "RMS angle of the normal from the design's"),
    ("sdx_rad", "SDx", ""),
    ("sdy_rad", "SDy", ""),
    ("sd_best_focus_rad", "SD, best focus", "tilt and focus removed"),
    ("focal_length_x_m", "Focal length in x", ""),
    ("focal_length_y_m", "Focal length in y", ""),
    ("measured_share", "Measured", "share of the area of "),
)
#: An outline that fits to this is as good as edges of a photo can be found.
_GOOD_OUTLINE_PX = 0.3
_COLUMNS = {"sdx": "SDx", "sdy": "SDy", "sd": "SD", "canting_x": "canting in x", "canting_y": "canting in y"}


def first_screen(results: Results, view: MapView) -> Html:
    """Return name, verdict, headline numbers and the map.

    view: The map, from `slope_view`.
    """
    summary = results.summary
    verdict = verdict_of(summary, missing=holes(results.slope_map), passed=passed_checks(summary))
    line = f"{summary.kind}; design: {results.slope_map.design}; heliogauge {summary.version}"
    rows = []
    for key, label, note in HEADLINE:
        if key not in summary.numbers:
            continue
        value, (name, unit) = summary.numbers[key], unit_of(key)
        reason = f"not determined: {summary.not_determined.get(key, '')}"
        sigma = summary.numbers.get(f"sigma_{key}")
        shown = "\u2013" if value is None else number_text(value, sigma, unit, name)
        if key == "measured_share":
            note += measured_of(summary)
        said = "convex" if key.startswith("focal_length") and value is not None and value < 0 else note
        rows.append((label, shown, reason if value is None else said))
    return page.first_screen(summary.name, line, verdict, rows, view)


#: Doubts about the curl of the slopes: where there is one, the curl is no passed check.
_CURL_CODES = {"curl_above_noise", "slopes_of_no_surface", "setup_contradicts_slopes"}


def passed_checks(summary: Summary) -> list[str]:
    """Return the checks whose numbers say that all is well."""
    numbers, codes = summary.numbers, {one.code for one in summary.doubts}
    found = []
    residual = numbers.get("pose_residual_px")
    if residual is not None and residual <= _GOOD_OUTLINE_PX and "outline_points_rejected" not in codes:
        found.append(f"the mirror's outline fits to {residual:.3f} px")
    curl, expected = numbers.get("curl_rms_per_m"), numbers.get("curl_expected_rms_per_m")
    if curl is not None and expected and not _CURL_CODES & codes:
        found.append(f"curl of the slopes is {curl / expected:.2f} times what their noise explains")
    agreement = numbers.get("distance_agreement_probability")
    if agreement is not None and "distance_contradicts_image" not in codes:
        found.append("the measured distance agrees with the image")
    return found


def charts(results: Results) -> Html:
    """Return the sections through the middle and the distribution of the angles."""
    slope_map = results.slope_map
    shown = [section_chart(slope_map, "x"), section_chart(slope_map, "y"), distribution_chart(slope_map)]
    return beside(*shown)


def facet_section(results: Results) -> Html:
    """Return the table of facets under its name; nothing for a single facet."""
    found = facet_table(results)
    return found if isinstance(found, Html) else table_under_name(found)


def facet_table(results: Results) -> TableView | Html:
    """Return the numbers of each facet with a link to its map; nothing for a single facet.

    Where a table of the canting stands above it, it does not repeat it.
    """
    facets = results.summary.facets
    if not facets:
        return Html("")
    names, marks = list(facets), {name: f"#{facet_mark(number)}" for number, name in enumerate(results.facets, start=1)}
    told = {"canting_x", "canting_y"} if (results.folder / CANTING_FILE).exists() else set()
    shown = {*_COLUMNS, "measured_share", "focal_length_x"} - told
    columns = [TableColumn("facet", names, links=[marks.get(name, "") for name in names])]
    for key in next(iter(facets.values())):
        if key.startswith("sigma_") or unit_of(key)[0] not in shown:
            continue
        columns.append(_facet_column(key, facets))
    return TableView("Facets", tuple(columns))


def _facet_column(key: str, facets: Mapping[str, Mapping[str, float | int | None]]) -> TableColumn:
    name, unit = unit_of(key)
    texts, numbers = [], []
    for one in facets.values():
        value = one.get(key)
        texts.append("\u2013" if value is None else number_text(value, one.get(f"sigma_{key}"), unit, name))
        numbers.append(float("nan") if value is None else float(value))
    return TableColumn(_COLUMNS.get(name, name.replace("_", " ")), texts, numbers)


def share_table(results: Results) -> Html:
    """Return where the uncertainty comes from: RMS over the mirror of each share of the sigma."""
    shares = uncertainty_shares(results.slope_map)
    total = [float(np.sqrt(sum(one[axis] ** 2 for one in shares.values()))) for axis in (0, 1)]
    rows = []
    for name, values in [*shares.items(), ("together", total)]:
        parts = [f"{100 * (value / whole) ** 2:.0f} %" for value, whole in zip(values, total, strict=True) if whole]
        rows.append((name, *(f"{1e6 * value:.3g} \u00b5rad" for value in values), ", ".join(parts)))
    head = ("source", "slope x", "slope y", "share of the variance in x, y")
    return table(head, rows, numbers=(1, 2, 3))


def setup(results: Results) -> Html:
    """Return where camera, screen and mirror stood, and how well the outline fits."""
    shown = [*_setup_charts(results.summary), *_outline_charts(results)]
    return beside(*shown) if shown else Html("")


def _setup_charts(summary: Summary) -> list[ChartView]:
    if not summary.geometry_m:
        return []
    points = {
        name: np.atleast_2d(np.asarray(summary.geometry_m[name], dtype=np.float64))
        for name in ("camera", "screen", "mirror")
    }
    camera, middle = points["camera"][0], points["mirror"].mean(axis=0)
    reach = float(np.linalg.norm(camera - middle))
    axis = np.asarray(summary.geometry_m["camera_axis"], dtype=np.float64)
    sight = np.stack([camera, camera + axis / np.linalg.norm(axis) * reach])
    to_screen = float(np.linalg.norm(points["screen"].mean(axis=0) - middle))
    note = f"mirror frame, to scale; mirror to camera {reach:.3f} m, to screen {to_screen:.3f} m (centres)"
    charts = []
    for words, across in (("from the side", 1), ("from above", 0)):
        series = [
            ChartSeries("line of sight", sight[:, 2], sight[:, across], LINE_X, dashed=True, size_px=1.0),
            ChartSeries("camera", camera[2:], camera[[across]], LINE_X, Mark.POINTS, size_px=9.0),
        ]
        for name, color in (("mirror", INK), ("screen", LINE_Y)):
            closed = np.vstack([points[name], points[name][:1]])
            series.append(ChartSeries(name, closed[:, 2], closed[:, across], color, size_px=2.5))
        title = f"Where all stood, {words}"
        charts.append(ChartView(title, "z [m]", f"{'xy'[across]} [m]", tuple(series), note=note, equal=True))
    return charts


def _outline_charts(results: Results) -> list[ChartView]:
    path = results.folder / "outline.csv"
    if not path.exists():
        return []
    columns = read_table_csv(path, ("x_px", "y_px", "residual_x_px", "residual_y_px"))
    x, y, dx, dy = (np.array(columns[name], dtype=np.float64) for name in columns)
    size = np.hypot(dx, dy)
    rms = float(np.sqrt(np.mean(size**2))) if size.size else 0.0
    # A residual of three times the RMS is drawn as a tenth of the mirror.
    enlarged = 0.1 * max(float(np.ptp(x)), float(np.ptp(y))) / max(3 * rms, 1e-6) if x.size else 1.0
    gaps = np.full(x.size, np.nan)
    arrows = [np.stack([one, one + enlarged * step, gaps], axis=1).ravel() for one, step in ((x, dx), (y, dy))]
    labels = [f"residual {one:.3f} px" for one in size]
    series = (
        ChartSeries("residuals", arrows[0], arrows[1], LINE_Y, size_px=1.2),
        ChartSeries("points of the edge", x, y, INK, Mark.POINTS, labels=labels, size_px=2.5),
    )
    largest = float(size.max(initial=0.0))
    note = f"RMS {rms:.3f} px, largest {largest:.3f} px; residuals enlarged {enlarged:.0f} times"
    title = "How well the outline fits"
    return [ChartView(title, "column [px]", "row [px]", series, note=note, equal=True, y_down=True)]


def pose_table(results: Results) -> Html:
    """Return the pose of the mirror in the camera's frame with its uncertainty."""
    rows = []
    for name, pose in results.poses.items():
        sigma = np.sqrt(np.diag(pose.covariance))
        place = ", ".join(f"{value:.4f}" for value in pose.cam_from_world.translation_m)
        spread = ", ".join(f"{1e3 * value:.2f}" for value in sigma[3:])
        turn = ", ".join(f"{1e3 * value:.3f}" for value in sigma[:3])
        residual = "-" if pose.residual_rms_px is None else f"{pose.residual_rms_px:.3f} px"
        rows.append((name, f"({place}) m", f"({spread}) mm", f"({turn}) mrad", residual))
    head = ("pose", "origin in the camera frame", "sigma of position", "sigma of rotation", "RMS residual")
    return table(head, rows, numbers=(4,)) if rows else Html("")


def making(results: Results) -> Html:
    """Return the facts in words, the pose, times and inputs."""
    return join(text_table(results), pose_table(results), duration_table(results), input_table(results))
