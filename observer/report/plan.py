"""Sections of the report of a planned pass; each is one cell of its notebook."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from heliogauge.reporting import page
from heliogauge.reporting.canvas import FAINT, INK, LINE_X, LINE_Y, MapStyle, add_legend, chart_figure, map_figure
from heliogauge.reporting.html import Html, join, show, table
from heliogauge.reporting.results import Results, open_results
from heliogauge.results.folder import read_table_csv
from heliogauge.validate import FloatArray
from observer.files import COLLECTOR, read_collector
from observer.report.lines import listed
from observer.report.maps import with_panels
from observer.report.results import Columns, numbers
from observer.report.sections import headline_table
from observer.trough.collector import Collector

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MM, _MRAD = 1e3, 1e3
#: Numbers of the headline table and what they are called there.
LABELS: dict[str, str] = {
    "sigma_theta_r_median_rad": "Sigma of theta_r at a point of the map, median",
    "sigma_theta_r_95_percent_rad": "95 % of the points are below",
    "sigma_slope_x_median_rad": "Sigma of dz/dx at a point of the map, median",
    "sigma_random_slope_x_median_rad": "its random share, median",
    "measured_share": "Share of the mirror that will be measured",
    "sigma_absorber_x_rms_m": "Sigma of the absorber, X_a",
    "sigma_absorber_z_rms_m": "Sigma of the absorber, Z_a",
    "sigma_camera_position_rms_m": "Sigma of a camera's coordinates, from the targets alone",
    "photos_count": "Photos",
    "pixel_on_aperture_m": "Pixel on the mirror",
    "camera_angle_step_rad": "Step of the camera angle from photo to photo",
    "longitudinal_incidence_deg": "Largest longitudinal incidence",
    "monte_carlo_rms_slope_x_rad": "Monte Carlo: RMS error of dz/dx",
    "monte_carlo_over_sigma_ratio": "Monte Carlo: RMS error over stated sigma",
}


@dataclass(frozen=True, slots=True, eq=False)
class PlanResults:
    """What a folder of a plan holds."""

    base: Results
    collector: Collector
    stations: Columns

    def table(self, name: str) -> Columns | None:
        """Return a table of the folder as text; None where there is none."""
        path = self.base.folder / name
        return read_table_csv(path) if path.is_file() else None


def open_plan(folder: str | Path = ".") -> PlanResults:
    """Read a folder with a plan.

    folder: The folder; the working directory without it.
    """
    base = open_results(folder)
    names = ("name", "x_m", "y_m", "z_m", "direction_x", "direction_y", "direction_z", "sigma_position_m")
    return PlanResults(
        base, read_collector(base.folder / COLLECTOR), read_table_csv(base.folder / "stations.csv", names)
    )


def head(results: PlanResults) -> Html:
    """Return title and warnings, which say where to fly."""
    return page.head(results.base, f"plan of a pass over a trough; design: {results.base.slope_map.design}")


def overview(results: PlanResults) -> Html:
    """Return the headline numbers and what they refer to."""
    rows = [(name.replace("_", " "), text) for name, text in results.base.summary.texts.items()]
    return join(headline_table(results.base.summary, LABELS), table(("", ""), rows))


def maps(results: PlanResults) -> Html:
    """Return the map of sigmas to be expected, and why parts of the mirror will be missing."""
    from heliogauge.reporting.figures import flag_map

    slope_map = results.base.slope_map
    reasons = with_panels(flag_map(slope_map), results.collector)
    if not slope_map.valid.any():
        return join(Html("<p>No point of the mirror would be measured.</p>"), show(reasons))
    sigma = slope_map.sigma_slope()[0] / (1 + slope_map.slope_x**2)
    own = slope_map.sigma_random_x / (1 + slope_map.slope_x**2)
    drawn = [
        _sigma_map(results, sigma, "Sigma of theta_r to be expected"),
        _sigma_map(results, own, "Its random share: noise and gaps between photos"),
        reasons,
    ]
    missing = results.table("missing.csv") or {"reason": [], "share": []}
    rows = [(reason, f"{float(share):.2%}") for reason, share in zip(*missing.values(), strict=True)]
    note = "What the two maps do not share is common to the whole map: cameras, absorber, frame of the targets."
    causes = table(("not measured, or doubtful", "share of the mirror"), rows, numbers=(1,)) if rows else Html("")
    return join(show(*drawn, caption=note), causes)


def _sigma_map(results: PlanResults, sigma: FloatArray, title: str) -> "Figure":
    slope_map = results.base.slope_map
    values = np.where(slope_map.valid, sigma, np.nan)
    note = f"median {_MRAD * float(np.nanmedian(values)):.3f} mrad"
    style = MapStyle(title, "mrad", _MRAD, diverging=False, note=note)
    return with_panels(map_figure(slope_map, values, style), results.collector)


def flight(results: PlanResults) -> Html:
    """Return where photos are taken, across and along the trough."""
    note = "Every camera with a short line where it looks. Along the trough the mirror is seen from the side."
    drawn = show(flight_figure(results, "x"), flight_figure(results, "y"), caption=note)
    shown = {name: cells for name, cells in results.stations.items() if not name.startswith("direction_")}
    folded = f"<details><summary>{len(shown['name'])} stations</summary>{listed(shown).text}</details>"
    return join(drawn, Html(folded))


def flight_figure(results: PlanResults, axis: str) -> "Figure":
    """Draw mirror, absorber and cameras from the side.

    axis: "x": looking along the trough; "y": from beside it.
    Returns: Height over the vertex against the axis, at one scale [m].
    """
    place, height = (numbers(results.stations, f"{name}_m") for name in (axis, "z"))
    look, down = (numbers(results.stations, f"direction_{name}") for name in (axis, "z"))
    sigma = numbers(results.stations, "sigma_position_m")
    title = "The pass, seen along the trough" if axis == "x" else "The pass, seen from beside the trough"
    words = "x across the aperture" if axis == "x" else "y along the trough"
    note = f"sigma of a camera's coordinates {_MM * float(np.median(sigma)):.2f} mm (median), from the targets alone"
    figure, axes = chart_figure(title, note, f"{words} [m]", "z over the vertex [m]", 4.4)
    collector = results.collector
    half = (collector.aperture_width_m if axis == "x" else collector.length_m) / 2
    fine = np.linspace(-half, half, 101)
    across = fine if axis == "x" else np.zeros_like(fine)
    axes.plot(fine, collector.surface.height(across, fine - across), color=INK, linewidth=1.6, label="mirror")
    if axis == "x":
        axes.plot(0, collector.focal_length_m, "o", color=LINE_Y, markersize=4, linestyle="none", label="absorber")
    else:
        rim = np.full(2, collector.rim_height_m)
        axes.plot([-half, half], rim, color=INK, linewidth=0.8)
        axes.plot([-half, half], np.full(2, collector.focal_length_m), color=LINE_Y, linewidth=2, label="absorber")
    axes.plot([place, place + 1.2 * look], [height, height + 1.2 * down], color=FAINT, linewidth=0.5)
    axes.plot(place, height, ".", color=LINE_X, markersize=4, linestyle="none", label="cameras")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_ylim(-0.5, 1.12 * float(height.max()))
    add_legend(axes, loc="center right")
    return figure


def absorber(results: PlanResults) -> Html:
    """Return how well the absorber will be known."""
    columns = results.table("absorber.csv") or {}
    y, sigma_x, sigma_z = (numbers(columns, name) for name in ("y_m", "sigma_x_a_m", "sigma_z_a_m"))
    if not (sigma_x > 0).any():
        return Html("<p>The absorber's place is not measured.</p>")
    figure, axes = chart_figure(
        "Sigma of the absorber's place",
        "where the tube is seen from two sides",
        "y along the trough [m]",
        "sigma [mm]",
        3.6,
    )
    axes.plot(y, _MM * sigma_x, ".-", color=LINE_X, linewidth=1.2, markersize=4, label="X_a, across")
    axes.plot(y, _MM * sigma_z, ".-", color=LINE_Y, linewidth=1.2, markersize=4, label="Z_a, along the optical axis")
    axes.set_ylim(bottom=0, top=1.25 * _MM * float(np.nanmax([sigma_x, sigma_z])))
    add_legend(axes, loc="upper right", ncols=2)
    return show(figure)


def repeated(results: PlanResults) -> Html:
    """Return the Monte Carlo study with its heading; nothing where there is none."""
    settling, nodes = results.table("monte_carlo_settling.csv"), results.table("monte_carlo.csv")
    if settling is None or nodes is None:
        return Html("")
    runs, rms = numbers(settling, "runs_count"), numbers(settling, "rms_slope_x_rad")
    first, axes = chart_figure("RMS error over the map", "as runs are added", "runs", "RMS error of dz/dx [mrad]", 3.6)
    axes.plot(runs, _MRAD * rms, ".-", color=LINE_X, linewidth=1.2)
    axes.set_ylim(0, 1.25 * _MRAD * float(rms.max()))
    error, sigma = numbers(nodes, "rms_error_slope_x_rad"), numbers(nodes, "sigma_slope_x_rad")
    second, axes = chart_figure(
        "Scatter against stated sigma", "each dot a node", "stated sigma of dz/dx [mrad]", "RMS error [mrad]", 3.6
    )
    axes.plot(_MRAD * sigma, _MRAD * error, ".", color=LINE_X, markersize=2, linestyle="none", alpha=0.5)
    end = _MRAD * float(np.nanpercentile([error, sigma], 99.5))
    axes.plot([0, end], [0, end], color=INK, linewidth=0.8, label="equal")
    axes.set_xlim(0, end)
    axes.set_ylim(0, end)
    add_legend(axes, loc="upper left")
    return join(Html("<h2>Monte Carlo</h2>"), show(first, second))


def making(results: PlanResults) -> Html:
    """Return times and input files."""
    return join(page.duration_table(results.base), page.input_table(results.base))
