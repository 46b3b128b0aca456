"""The cameras of backward gazing and the sun's profile, for the report."""

import numpy as np

from deflectometry.gazing.pipeline.result import CAMERAS_FILE, PROFILE_FILE
from heliogauge.reporting.html import Html, beside, join
from heliogauge.reporting.look import LINE_X, LINE_Y
from heliogauge.reporting.notation import number_text
from heliogauge.reporting.results import Results
from heliogauge.results.folder import read_table_csv
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
    profile = read_table_csv(results.folder / PROFILE_FILE, ("angle_mrad", "relative_radiance"))
    angle, radiance = (np.array(profile[key], dtype=np.float64) for key in ("angle_mrad", "relative_radiance"))
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
