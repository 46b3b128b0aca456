"""Report of the response of camera and display: from the files of its results."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.screen.files import GreyReadings, nonlinearity, read_readings, read_response
from calibration.screen.response import ScreenResponse
from heliogauge.reporting import page
from heliogauge.reporting.html import Html, join
from heliogauge.reporting.look import FAINT, LINE_X, LINE_Y
from heliogauge.reporting.verdict import Verdict, verdict_of
from heliogauge.results.folder import Summary, read_summary
from heliogauge.view.charts import ChartSeries, ChartView, Mark
from heliogauge.view.tables import TableColumn, TableView

_LEVEL = "display level [share of the range]"


@dataclass(frozen=True, slots=True, eq=False)
class ResponseReport:
    """What a folder of results holds.

    summary: Headline numbers, doubts, texts.
    response: The look-up.
    readings: Readings of all levels, also those left out.
    """

    summary: Summary
    response: ScreenResponse
    readings: GreyReadings


def open_response(folder: str | Path = ".") -> ResponseReport:
    """Read a folder of results.

    folder: The folder; the working directory without it.
    """
    folder = Path(folder)
    summary = read_summary(folder / "summary.json")
    return ResponseReport(summary, read_response(folder), read_readings(folder, summary))


def first_screen(report: ResponseReport) -> Html:
    """Return name, verdict, headline numbers and the response."""
    summary, numbers = report.summary, report.summary.numbers

    def said(key: str, factor: float, unit: str) -> str:
        known, scatter = numbers[key], numbers[f"sigma_{key}"]
        if known is None or scatter is None:
            return "not determined"
        value, sigma = factor * float(known), factor * float(scatter)
        digits = max(0, 1 - int(np.floor(np.log10(sigma)))) if sigma > 0 else 2
        return f"{value:.{digits}f} \u00b1 {sigma:.{digits}f} {unit}"

    spread = numbers["brightness_spread_share"]
    rows = [
        ("Nonlinearity", said("nonlinearity_share", 100, "%"), "largest departure from a straight line, of the range"),
        ("Darkest reading", said("darkest_dn", 1, "DN")),
        ("Brightest reading", said("brightest_dn", 1, "DN")),
        ("Levels used", f"{numbers['used_levels_count']} of {numbers['levels_count']}"),
        (
            "Pixels",
            f"{numbers['pixels_count']}",
            "" if spread is None else f"brightness differs by {float(spread):.0%}",
        ),
    ]
    line = f"response of camera and display; {summary.texts.get('range', '')}; heliogauge {summary.version}"
    return page.first_screen(summary.name, line, verdict(report), rows, response_chart(report))


def verdict(report: ResponseReport) -> Verdict:
    """Return what was checked and found right, what is doubtful, and what is missing."""
    numbers, codes = report.summary.numbers, {one.code for one in report.summary.doubts}
    missing = []
    saturated = int(numbers["saturated_levels_count"] or 0)
    if saturated:
        missing.append(f"{saturated} of {numbers['levels_count']} levels saturated: no response there")
    passed = ["readings ascend with the levels"]
    if "pixels_differ_in_brightness" not in codes:
        passed.append("the pixels used are alike in brightness")
    return verdict_of(report.summary, missing, passed)


def response_chart(report: ResponseReport) -> ChartView:
    """Return what the camera reads for each level."""
    response, readings = report.response, report.readings
    ends = [0, -1]
    joined = ~readings.is_saturated & ~np.isin(readings.level, response.display_level)
    series = [
        ChartSeries("straight line", response.display_level[ends], response.camera_dn[ends], FAINT, dashed=True),
        ChartSeries("response", response.display_level, response.camera_dn, LINE_X),
        ChartSeries(
            "used",
            response.display_level,
            response.camera_dn,
            LINE_X,
            Mark.POINTS,
            sigma=response.sigma_camera_dn,
            size_px=5,
        ),
    ]
    for chosen, name, color in (
        (joined, "joined with the level below", "#8a6d3b"),
        (readings.is_saturated, "saturated, left out", LINE_Y),
    ):
        if chosen.any():
            places = readings.level[chosen], readings.mean_dn[chosen]
            series.append(ChartSeries(name, *places, color, Mark.POINTS, size_px=6))
    note = f"means of {readings.pixels} pixels"
    return ChartView("Response of camera and display", _LEVEL, "camera reading [DN]", tuple(series), note)


def departure_chart(report: ResponseReport) -> ChartView:
    """Return how far the readings are from a straight line between the ends."""
    departure, sigma = nonlinearity(report.response)
    level = report.response.display_level
    series = (
        ChartSeries("straight line", level[[0, -1]], np.zeros(2), FAINT, dashed=True),
        ChartSeries("departure", level, 100 * departure, LINE_X, sigma=100 * sigma),
    )
    return ChartView("Departure from a straight line", _LEVEL, "departure [% of the readings]", series, "band: 1 sigma")


def level_table(report: ResponseReport) -> TableView:
    """Return a line for each level."""
    response, readings = report.response, report.readings
    place = {float(level): i for i, level in enumerate(response.display_level)}
    sigma = response.sigma_camera_dn if response.sigma_camera_dn is not None else np.zeros(response.camera_dn.size)
    spread = [float(sigma[place[level]]) if level in place else float("nan") for level in readings.level.tolist()]
    use = [
        "saturated" if full else "used" if level in place else "joined with the level below"
        for level, full in zip(readings.level.tolist(), readings.is_saturated, strict=True)
    ]
    return TableView(
        "Levels",
        (
            TableColumn(_LEVEL, [f"{level:.4f}" for level in readings.level], readings.level.tolist()),
            TableColumn("reading [DN]", [f"{value:.3f}" for value in readings.mean_dn], readings.mean_dn.tolist()),
            TableColumn("sigma [DN]", [f"{value:.2g}" if np.isfinite(value) else "" for value in spread], spread),
            TableColumn("use", use),
        ),
    )


def making(report: ResponseReport) -> Html:
    """Return what is said beside the numbers, times and input files."""
    rows = [(name.replace("_", " "), text) for name, text in report.summary.texts.items()]
    return join(page.table(("", ""), rows), page.duration_table(report), page.input_table(report))
