"""Pictures and words of quantities of a store."""

import numpy as np

from calibration.survey.worse import extreme
from heliogauge.reporting.look import LINE_X
from heliogauge.reporting.notation import quantity_text
from heliogauge.results.folder import unit_of
from heliogauge.view.charts import ChartSeries, ChartView, Mark


def plain(quantity: str) -> str:
    """Return the name of a quantity in words."""
    return unit_of(quantity)[0].replace("_", " ")


def named(quantity: str) -> str:
    """Return the head of the first subjects of a quantity.

    >>> named("sd_best_focus_rad"), named("curvature_x_per_m")
    ('Worst sd best focus', 'Largest curvature x')
    """
    return f"{extreme(quantity).capitalize()} {plain(quantity)}"


def said(quantity: str, value: str, sigma: str) -> str:
    """Return a value with its sigma as people read it."""
    if not value:
        return ""
    return quantity_text(quantity, float(value), float(sigma) if sigma else None)


def history_charts(table: dict[str, list[str]]) -> list[ChartView]:
    """Return the results of the worst subject of each quantity over time.

    table: Columns of history.csv.
    """
    charts = []
    for quantity in dict.fromkeys(table["quantity"]):
        rows = [row for row, one in enumerate(table["quantity"]) if one == quantity]
        times = np.array([table["time"][row].rstrip("Z") for row in rows], dtype="datetime64[s]").astype(np.float64)
        name, unit = unit_of(quantity)
        scale, shown = (1e3, "mrad") if unit == "rad" else (100.0, "%") if name.endswith("_share") else (1.0, unit)
        values = np.array([scale * float(table["value"][row]) for row in rows], dtype=np.float64)
        sigma = np.array([scale * float(table["sigma"][row]) for row in rows], dtype=np.float64)
        series = (ChartSeries(table["subject"][rows[0]], times, values, LINE_X, Mark.POINTS, sigma=sigma, size_px=4),)
        label = f"{plain(quantity)} [{shown}]" if shown else plain(quantity)
        charts.append(ChartView(f"{named(quantity)}: {table['subject'][rows[0]]}", "UTC", label, series, x_time=True))
    return charts
