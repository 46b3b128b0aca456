"""The cameras of backward gazing and the sun's profile, for the report."""

from pathlib import Path

import numpy as np

from deflectometry.gazing.pipeline.result import CAMERAS_FILE, PROFILE_FILE
from deflectometry.gazing.planning.plan import SPACINGS_FILE
from heliogauge.reporting import page
from heliogauge.reporting.html import FirstScreen, Html, beside, join
from heliogauge.reporting.look import LINE_X, LINE_Y
from heliogauge.reporting.notation import number_text
from heliogauge.reporting.results import Results
from heliogauge.reporting.verdict import verdict_of
from heliogauge.results.folder import SUMMARY_FILE, read_summary, read_table_csv, unit_of
from heliogauge.results.sun_tables import read_sun
from heliogauge.view.charts import ChartSeries, ChartView, Mark
from heliogauge.view.tables import TableColumn, TableView


def cameras_and_sun(results: Results) -> Html:
    """Return how each camera's brightness fits, where the cameras stood, and the sun's profile."""
    columns = read_table_csv(results.folder / CAMERAS_FILE, ("camera", "gain", "sigma_gain", "reason"))
    numbers = {
        key: np.array([float(cell) if cell else np.nan for cell in columns[key]])
        for key in ("x_m", "y_m", "gain", "sigma_gain", "misfit_over_sigma")
    }
    gains = [
        number_text(gain, sigma, "")
        for gain, sigma in zip(numbers["gain"].tolist(), numbers["sigma_gain"].tolist(), strict=True)
    ]
    misfits = ["\u2013" if np.isnan(one) else f"{one:.2f}" for one in numbers["misfit_over_sigma"].tolist()]
    table = TableView(
        "Cameras",
        (
            TableColumn("camera", columns["camera"]),
            TableColumn("gain", gains, numbers["gain"].tolist()),
            TableColumn("RMS residual over sigma", misfits, numbers["misfit_over_sigma"].tolist()),
            TableColumn("left out because", columns["reason"]),
        ),
    )
    profile = read_sun(results.folder / PROFILE_FILE)
    angle, radiance = 1e3 * profile.angle_rad, profile.radiance(profile.angle_rad)
    sun = ChartView(
        "The sun's profile",
        "angle from the centre [mrad]",
        "radiance over the middle's",
        (ChartSeries("measured", angle, radiance, LINE_X),),
        note="Where it is flat the cameras are blind; where it is steep they see best.",
    )
    places = ChartView(
        "Cameras as the mirror sees them",
        "x [m]",
        "y [m]",
        (ChartSeries("cameras", numbers["x_m"], numbers["y_m"], LINE_Y, Mark.POINTS, labels=columns["camera"]),),
        equal=True,
    )
    return join(table, beside(sun, places))


#: Numbers of a plan: key and label.
_PLAN = (
    ("spacing_m", "Side of the square of cameras"),
    ("sigma_measured_rad", "Slopes where measured, each way"),
    ("sigma_at_zero_slope_rad", "Near zero slope"),
    ("measured_share", "Measured"),
    ("blind_share", "Blind"),
)


def plan_first(folder: Path) -> FirstScreen:
    """Return the best spacing of a plan with what it gives."""
    summary = read_summary(folder / SUMMARY_FILE)
    rows = []
    for key, label in _PLAN:
        name, unit = unit_of(key)
        rows.append((label, number_text(float(summary.numbers[key] or 0.0), None, unit, name), ""))
    line = f"{summary.kind}; heliogauge {summary.version}"
    return page.first_screen(summary.name, line, verdict_of(summary), rows, None)


def spacings(folder: Path) -> ChartView:
    """Return what each spacing of a plan gives."""
    names = ("side_m", "expected_error_rad", "sigma_at_zero_rad", "blind_share")
    table = read_table_csv(folder / SPACINGS_FILE, names)
    side, error, at_zero = (np.array(table[name], dtype=np.float64) for name in names[:3])
    return ChartView(
        "What a spacing gives",
        "side of the square of cameras [m]",
        "each slope [mrad]",
        (
            ChartSeries("expected error, blind points with their slopes", side, 1e3 * error, LINE_X),
            ChartSeries("sigma near zero slope", side, 1e3 * at_zero, LINE_Y),
        ),
        note="Close cameras see a slope near zero on the even middle of the sun; far ones lose the sun beside it.",
    )
