"""Sections of the report of a planned pass; each is one cell of its notebook."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from heliogauge.reporting import page
from heliogauge.reporting.html import FirstScreen, Html, beside, join, table, wrap
from heliogauge.reporting.look import FAINT, INK, LINE_X, LINE_Y
from heliogauge.reporting.results import Results, open_results
from heliogauge.reporting.verdict import SMALLEST_HOLE_SHARE, verdict_of
from heliogauge.results.folder import read_table_csv
from heliogauge.view.charts import ChartSeries, ChartView, Mark
from heliogauge.view.maps import MapLayer, MapView
from heliogauge.view.scenes import SceneGroup, SceneView
from heliogauge.view.still_maps import flag_still
from heliogauge.view.stills import side_by_side
from observer.files import COLLECTOR, read_collector
from observer.report.lines import listed
from observer.report.maps import panel_lines
from observer.report.results import Columns, numbers
from observer.report.scene import mirror_lines
from observer.report.sections import headline_rows, numbers_table
from observer.trough.collector import Collector

_MM, _MRAD = 1e3, 1e3
#: Numbers of the first screen and what they are called there.
LABELS: dict[str, str] = {
    "sigma_theta_r_median_rad": "Sigma of theta_r at a point of the map, median",
    "sigma_theta_r_95_percent_rad": "95 % of the points are below",
    "sigma_theta_r_without_tilt_median_rad": "The same without the mean tilt, as errors of the slopes are compared",
    "sigma_slope_x_median_rad": "Sigma of dz/dx at a point of the map, median",
    "measured_share": "Share of the mirror that will be measured",
    "sigma_absorber_x_rms_m": "Sigma of the absorber, X_a",
    "sigma_absorber_z_rms_m": "Sigma of the absorber, Z_a",
    "sigma_camera_position_rms_m": "Sigma of a camera's coordinates, from the targets alone",
    "photos_count": "Photos",
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


def head(results: PlanResults) -> FirstScreen:
    """Return the first screen: verdict with what will be missing, numbers to expect, the map of their sigmas."""
    summary, slope_map = results.base.summary, results.base.slope_map
    unseen = 1 - slope_map.measured_share
    missing = [f"{100 * unseen:.1f} % of the mirror would not be measured"] if unseen >= SMALLEST_HOLE_SHARE else []
    line = f"plan of a pass over a trough; design: {slope_map.design}; heliogauge {summary.version}"
    rows = headline_rows(summary, LABELS)
    return page.first_screen(summary.name, line, verdict_of(summary, missing), rows, sigma_view(results))


def doubts(results: PlanResults) -> Html:
    """Return all doubts with all their words, which say where to fly."""
    return page.doubts_box(results.base)


def sigma_view(results: PlanResults) -> MapView:
    """Return the map of the sigmas to be expected."""
    slope_map = results.base.slope_map
    turned = 1 + slope_map.slope_x**2
    layers = tuple(
        MapLayer(key, name, "mrad", np.where(slope_map.valid, sigma / turned, np.nan), _MRAD, None, False, low=0.0)
        for key, name, sigma in (
            ("sigma_theta_r", "Sigma of theta_r to be expected", slope_map.sigma_slope()[0]),
            ("random", "Its random share: noise and gaps between photos", slope_map.sigma_random_x),
        )
    )
    view = MapView(
        "What to expect",
        slope_map.x_m,
        slope_map.y_m,
        layers,
        slope_map.flags,
        slope_map.aperture,
        note="Grey: will not be measured. What the two layers do not share is common to the whole map.",
        lines=panel_lines(results.collector),
    )
    # The still picture is the first layer alone.
    return replace(view, stills=[view.layer_still("sigma_theta_r")])


def overview(results: PlanResults) -> Html:
    """Return all numbers and what they refer to."""
    rows = [(name.replace("_", " "), text) for name, text in results.base.summary.texts.items()]
    return join(numbers_table(results.base.summary), table(("", ""), rows))


def missing(results: PlanResults) -> Html:
    """Return why parts of the mirror will be missing."""
    reasons = side_by_side([flag_still(results.base.slope_map, panel_lines(results.collector), planned=True)])
    columns = results.table("missing.csv") or {"reason": [], "share": []}
    rows = [(reason, f"{float(share):.2%}") for reason, share in zip(*columns.values(), strict=True)]
    causes = table(("not measured, or doubtful", "share of the mirror"), rows, numbers=(1,)) if rows else Html("")
    return beside(reasons, causes)


def alternatives(results: PlanResults) -> Html:
    """Return what other flights would give; nothing where nobody asked."""
    columns = results.table("alternatives.csv")
    if columns is None:
        return Html("")
    rows = [
        (
            columns["flight"][k],
            columns["photos"][k],
            *(
                f"{factor * float(columns[key][k]):.3g}"
                for key, factor in (
                    ("sigma_theta_r_median_rad", _MRAD),
                    ("sigma_theta_r_without_tilt_median_rad", _MRAD),
                    ("sigma_random_slope_x_median_rad", _MRAD),
                    ("measured_share", 100.0),
                    ("sigma_absorber_x_rms_m", _MM),
                    ("sigma_absorber_z_rms_m", _MM),
                )
            ),
        )
        for k in range(len(columns["flight"]))
    ]
    heads = (
        "flight",
        "photos",
        "sigma of theta_r [mrad]",
        "without the mean tilt [mrad]",
        "from point to point alone [mrad]",
        "measured [%]",
        "absorber X_a [mm]",
        "Z_a [mm]",
    )
    return join(Html("<h2>What other flights would give</h2>"), table(heads, rows, numbers=range(1, len(heads))))


def flight(results: PlanResults) -> Html:
    """Return where photos are taken, across and along the trough, and in space."""
    shown = {name: cells for name, cells in results.stations.items() if not name.startswith("direction_")}
    stations = listed(shown, "stations")
    folded = wrap(f"<details><summary>{len(shown['name'])} stations</summary>", [stations], "</details>")
    views = beside(flight_view(results, "x"), flight_view(results, "y"))
    return join(views, Html('<p class="caption">Every camera with a short line where it looks.</p>'), folded)


def scene(results: PlanResults) -> SceneView:
    """Return mirror, absorber and cameras as a scene to turn."""
    stations, collector = results.stations, results.collector
    eyes, looks = (
        np.stack([numbers(stations, f"{name}{axis}{end}") for axis in "xyz"], axis=1)
        for name, end in (("", "_m"), ("direction_", ""))
    )
    mirror, lengths = mirror_lines(collector)
    half = collector.length_m / 2
    axis = np.array([[0.0, -half, collector.focal_length_m], [0.0, half, collector.focal_length_m]])
    sigma = numbers(stations, "sigma_position_m")
    labels = [
        f"{name}: coordinates known to {_MM * one:.2f} mm" for name, one in zip(stations["name"], sigma, strict=True)
    ]
    rays = np.stack([eyes, eyes + 1.2 * looks], axis=1).reshape(-1, 3)
    groups = (
        SceneGroup("mirror", mirror, [FAINT], lengths=lengths, size_px=0.8),
        SceneGroup("absorber", axis, [LINE_Y], lengths=(2,), size_px=3.0),
        SceneGroup("directions of view", rays, [FAINT], lengths=(2,) * len(eyes), size_px=0.8),
        SceneGroup("cameras", eyes, [LINE_X], labels=labels, size_px=6),
    )
    return SceneView("The pass", groups)


def flight_view(results: PlanResults, axis: str) -> ChartView:
    """Return mirror, absorber and cameras from the side, height over the vertex at one scale [m].

    axis: "x": looking along the trough; "y": from beside it.
    """
    place, height = (numbers(results.stations, f"{name}_m") for name in (axis, "z"))
    look, down = (numbers(results.stations, f"direction_{name}") for name in (axis, "z"))
    sigma = numbers(results.stations, "sigma_position_m")
    title = "The pass, seen along the trough" if axis == "x" else "The pass, seen from beside the trough"
    words = "x across the aperture" if axis == "x" else "y along the trough"
    note = f"sigma of a camera's coordinates {_MM * float(np.median(sigma)):.2f} mm (median), from the targets alone"
    collector = results.collector
    half = (collector.aperture_width_m if axis == "x" else collector.length_m) / 2
    fine = np.linspace(-half, half, 101)
    across = fine if axis == "x" else np.zeros_like(fine)
    gap = np.full_like(place, np.nan)
    looks = [
        np.stack([start, start + 1.2 * step, gap], axis=1).ravel() for start, step in ((place, look), (height, down))
    ]
    series = [
        ChartSeries("directions of view", looks[0], looks[1], FAINT, size_px=0.7),
        ChartSeries("mirror", fine, collector.surface.height(across, fine - across), INK, size_px=2.0),
    ]
    ends, focus = np.array([-half, half]), np.full(2, collector.focal_length_m)
    if axis == "x":
        series.append(ChartSeries("absorber", np.zeros(1), focus[:1], LINE_Y, Mark.POINTS, size_px=6.0))
    else:
        series.append(ChartSeries("rim", ends, np.full(2, collector.rim_height_m), INK))
        series.append(ChartSeries("absorber", ends, focus, LINE_Y, size_px=2.5))
    names = results.stations["name"]
    series.append(ChartSeries("cameras", place, height, LINE_X, Mark.POINTS, labels=names, size_px=5.0))
    return ChartView(title, f"{words} [m]", "z over the vertex [m]", tuple(series), note, equal=True)


def absorber(results: PlanResults) -> ChartView | Html:
    """Return how well the absorber will be known."""
    columns = results.table("absorber.csv") or {}
    y, sigma_x, sigma_z = (numbers(columns, name) for name in ("y_m", "sigma_x_a_m", "sigma_z_a_m"))
    if not (sigma_x > 0).any():
        return Html("<p>The absorber's place is not measured.</p>")
    return ChartView(
        "Sigma of the absorber's place",
        "y along the trough [m]",
        "sigma [mm]",
        (
            ChartSeries("X_a, across", y, _MM * sigma_x, LINE_X),
            ChartSeries("Z_a, along the optical axis", y, _MM * sigma_z, LINE_Y),
        ),
        "where the tube is seen from two sides",
    )


def repeated(results: PlanResults) -> Html:
    """Return the Monte Carlo study with its heading; nothing where there is none."""
    settling, nodes = results.table("monte_carlo_settling.csv"), results.table("monte_carlo.csv")
    if settling is None or nodes is None:
        return Html("")
    runs, rms = numbers(settling, "runs_count"), numbers(settling, "rms_slope_x_rad")
    settled = ChartSeries("RMS error", runs, _MRAD * rms, LINE_X)
    error, sigma = numbers(nodes, "rms_error_slope_x_rad"), numbers(nodes, "sigma_slope_x_rad")
    ends = np.array([0.0, _MRAD * float(np.nanpercentile([error, sigma], 99.5))])
    scatter = (
        ChartSeries("nodes", _MRAD * sigma, _MRAD * error, LINE_X, Mark.POINTS, size_px=3.0),
        ChartSeries("equal", ends, ends, INK),
    )
    views = beside(
        ChartView("RMS error over the map", "runs", "RMS error of dz/dx [mrad]", (settled,), "as runs are added"),
        ChartView("Scatter against stated sigma", "stated sigma of dz/dx [mrad]", "RMS error [mrad]", scatter),
    )
    return join(Html("<h2>Monte Carlo</h2>"), views)


def making(results: PlanResults) -> Html:
    """Return how long each stage took."""
    return page.duration_table(results.base)


def inputs(results: PlanResults) -> Html:
    """Return the files that were read."""
    return page.input_table(results.base)
