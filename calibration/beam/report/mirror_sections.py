"""What the report of beams against their mirror shows: verdict, flux measured and expected, canting."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.beam.files.comparison import CANTING_FILE, COMPARISON_FILE, EXPECTED_FILE
from heliogauge.reporting import page
from heliogauge.reporting.html import Html, join
from heliogauge.reporting.verdict import verdict_of
from heliogauge.results.arrays import read_arrays
from heliogauge.results.folder import Summary, read_summary, read_table_csv
from heliogauge.validate import FloatArray
from heliogauge.view.maps import MapLayer, MapView
from heliogauge.view.tables import TableColumn, TableView

#: Photos whose flux is shown; the file has all.
_MOST_MAPS = 6


@dataclass(frozen=True, slots=True, eq=False)
class MirrorReport:
    """What a folder of results holds.

    folder: The folder.
    summary: Headline numbers, doubts, texts.
    table: Columns of comparison.csv as texts.
    """

    folder: Path
    summary: Summary
    table: Mapping[str, list[str]]


def open_comparison(folder: str | Path = ".") -> MirrorReport:
    """Read a folder of results.

    folder: The folder; the working directory without it.
    """
    folder = Path(folder)
    return MirrorReport(folder, read_summary(folder / "summary.json"), read_table_csv(folder / COMPARISON_FILE))


def first_screen(report: MirrorReport) -> Html:
    """Return name, verdict, headline numbers and the first photo's flux."""
    numbers = report.summary.numbers

    def said(key: str, form: str, factor: float = 1.0, unit: str = "") -> str:
        value, sigma = numbers.get(key), numbers.get(f"sigma_{key}")
        if value is None:
            return "not determined"
        more = "" if sigma is None else f" \u00b1 {form.format(factor * float(sigma))}"
        return f"{form.format(factor * float(value))}{more} {unit}".strip()

    rows: list[tuple[str, ...]] = [
        ("Correlation, mirror as given", said("least_correlation_ratio", "{:.4f}"), "the least of all photos"),
        ("Correlation, fitted", said("least_correlation_fitted_ratio", "{:.4f}"), "canting, focus, scatter"),
        ("D90, expected to measured", said("largest_d90_difference_share", "{:.1f}", 100, "%"), "largest difference"),
        ("Centre", said("largest_center_off_m", "{:.3f}", 1, "m"), "largest difference"),
        (
            "Largest canting",
            said("largest_canting_rad", "{:.2f}", 1e3, "mrad"),
            "of a facet's normal, beyond the surface",
        ),
        ("Scatter of the beam", said("scatter_rad", "{:.2f}", 1e3, "mrad"), "beyond surface and sun"),
        ("Slope error at most", said("slope_error_bound_rad", "{:.2f}", 1e3, "mrad"), "bound, 95 %"),
    ]
    line = f"{report.summary.texts.get('mirror', '')}; {report.summary.texts.get('sun', '')}"
    passed = [] if report.summary.doubts else ["measured and expected flux are those of one mirror"]
    maps = flux_maps(report)
    return page.first_screen(
        report.summary.name, line, verdict_of(report.summary, [], passed), rows, maps[0] if maps else None
    )


def flux_maps(report: MirrorReport) -> list[MapView]:
    """Return measured, expected and fitted flux of the first photos, and the differences."""
    arrays, attributes = read_arrays(report.folder / EXPECTED_FILE)
    maps = []
    for number in range(1, _MOST_MAPS + 1):
        if f"measured_{number}" not in arrays:
            break
        measured = arrays[f"measured_{number}"].astype(np.float64)
        top = float(np.nanmax(measured))
        titles = {"expected": "Expected flux", "fitted": "Expected flux, fitted"}
        computed = {key: arrays[f"{key}_{number}"].astype(np.float64) for key in titles if f"{key}_{number}" in arrays}
        # One scale for all pictures of a photo, from its darkest noise to its brightest place.
        every = [100 * one / top for one in (measured, *computed.values())]
        low, high = min(float(np.nanmin(one)) for one in every), max(float(np.nanmax(one)) for one in every)

        def layer(key: str, title: str, values: FloatArray, low: float = low, high: float = high) -> MapLayer:
            return MapLayer(key, title, "% of peak", values, 100, diverging=False, low=low, limit=high)

        layers = [layer("measured", "Measured flux", measured / top)]
        for key, values in computed.items():
            layers.append(layer(key, titles[key], values / top))
            layers.append(_difference(key, titles[key], measured - values, top))
        shape = measured.shape
        maps.append(
            MapView(
                name=str(attributes.get(f"photo_{number}", number)),
                x_m=arrays[f"x_{number}"],
                y_m=arrays[f"y_{number}"],
                layers=tuple(layers),
                flags=np.zeros(shape, dtype=np.uint32),
                aperture=np.ones(shape, dtype=np.bool_),
                note=f"correlation {float(report.table['correlation'][number - 1]):.4f} with the mirror as it is given",
            )
        )
    return maps


def _difference(key: str, title: str, values: FloatArray, top: float) -> MapLayer:
    return MapLayer(
        f"difference_{key}", f"Measured minus {title[0].lower()}{title[1:]}", "% of peak", values / top, 100
    )


def photo_table(report: MirrorReport) -> TableView:
    """Return a line for each photo."""
    columns = [TableColumn("photo", report.table["image"]), TableColumn("target", report.table["target"])]
    for key, name, form in (
        ("correlation", "correlation", "{:.4f}"),
        ("correlation_fitted", "fitted", "{:.4f}"),
        ("d90_m", "D90 measured [m]", "{:.3f}"),
        ("d90_expected_m", "expected [m]", "{:.3f}"),
        ("d90_fitted_m", "fitted [m]", "{:.3f}"),
        ("center_off_m", "centre off [m]", "{:.3f}"),
    ):
        values = [float(cell) if cell else float("nan") for cell in report.table[key]]
        texts = [form.format(value) if np.isfinite(value) else "" for value in values]
        columns.append(TableColumn(name, texts, values))
    return TableView("Photos", tuple(columns))


def canting_table(report: MirrorReport) -> TableView | Html:
    """Return a line for each facet."""
    if not (report.folder / CANTING_FILE).is_file():
        return Html("<p>Canting was not estimated.</p>")
    table = read_table_csv(report.folder / CANTING_FILE)
    columns = [TableColumn("facet", table["facet"])]
    for key, name in (
        ("canting_x_mrad", "towards +x [mrad]"),
        ("sigma_canting_x_mrad", "sigma"),
        ("canting_y_mrad", "towards +y [mrad]"),
        ("sigma_canting_y_mrad", "sigma y"),
    ):
        values = [float(cell) for cell in table[key]]
        columns.append(TableColumn(name, [f"{value:.3f}" for value in values], values))
    return TableView("Canting of the facets' normals beyond the given surface", tuple(columns))


def making(report: MirrorReport) -> Html:
    """Return what is said beside the numbers, times and input files."""
    rows = [(name.replace("_", " "), text) for name, text in report.summary.texts.items()]
    return join(page.table(("", ""), rows), page.duration_table(report), page.input_table(report))
