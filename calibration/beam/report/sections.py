"""What the report of measured beams shows: verdict and numbers, flux, places, photos, a line for each beam."""

from typing import Any

import numpy as np
import numpy.typing as npt

from calibration.beam.files.result import CONTOURS_FILE, FLUX_FILE, LEFT_OUT_FILE
from calibration.beam.report.results import BeamsReport
from heliogauge.images.thumbnails import decode_thumbnail
from heliogauge.reporting import page
from heliogauge.reporting.html import Html, join
from heliogauge.reporting.look import FAINT, LINE_X, LINE_Y
from heliogauge.reporting.verdict import verdict_of
from heliogauge.results.arrays import read_arrays
from heliogauge.results.folder import read_table_csv
from heliogauge.results.thumbnails import read_thumbnails
from heliogauge.validate import FloatArray
from heliogauge.view.charts import ChartSeries, ChartView, Mark
from heliogauge.view.maps import MapLayer, MapView
from heliogauge.view.photos import Photo, PhotoView
from heliogauge.view.tables import TableColumn, TableView

#: Beams whose flux can be looked into; the file has all.
_MOST_LAYERS = 8


def first_screen(report: BeamsReport) -> Html:
    """Return name, verdict, headline numbers and the flux."""
    numbers = report.summary.numbers

    def said(key: str) -> str:
        value, sigma = numbers.get(f"median_{key}_m"), numbers.get(f"sigma_median_{key}_m")
        return "not determined" if value is None or sigma is None else f"{value:.3f} \u00b1 {sigma:.3f} m"

    rows: list[tuple[str, ...]] = [
        ("Beams measured", f"{numbers['measured_count']} of {numbers['beams_count']}"),
        ("D50", said("d50"), "diameter of the circle with half of the light, median"),
        ("D90", said("d90"), "90 % of the light"),
        ("D95", said("d95"), "95 % of the light"),
        ("Width, major axis", said("width_major"), "standard deviation of the light"),
        ("Width, minor axis", said("width_minor")),
    ]
    if "median_off_label_m" in numbers:
        rows.append(
            (
                "Off the labels",
                f"{numbers['median_off_label_m']:.3f} m",
                f"median; {numbers['largest_off_label_m']:.3f} m at most",
            )
        )
    line = f"beams on a target; {report.summary.texts.get('flux', '')}; heliogauge {report.summary.version}"
    missing = [] if numbers["measured_count"] else ["no beam was measured"]
    passed = [] if report.summary.doubts else ["all beams stand whole on their targets"]
    return page.first_screen(
        report.summary.name, line, verdict_of(report.summary, missing, passed), rows, beam_map(report)
    )


def beam_map(report: BeamsReport) -> MapView | None:
    """Return the flux of the first target's beams as a map; None without a beam."""
    arrays, attributes = read_arrays(report.folder / FLUX_FILE)
    end = "" if "flux" in arrays else "_1"
    if f"flux{end}" not in arrays or not arrays[f"flux{end}"].shape[0]:
        return None
    flux, rows = arrays[f"flux{end}"], arrays[f"beam{end}"]
    usable = np.flatnonzero(report.used[rows])
    chosen = (usable if usable.size else np.arange(len(rows)))[:_MOST_LAYERS]
    unit = report.table["flux_unit"][int(rows[chosen[0]])]
    unit = "" if unit == "1" else unit
    names = report.table["image"]
    # One scale for all beams, up to the brightest place: a beam is a small part of its target.
    high = float(np.nanmax(flux[chosen]))
    low = float(np.nanmin(flux[chosen]))
    layers = tuple(
        MapLayer(
            f"beam_{int(rows[k])}",
            names[int(rows[k])],
            unit,
            flux[k].astype(np.float64),
            diverging=False,
            low=low,
            limit=high,
        )
        for k in chosen
    )
    x, y = arrays[f"x{end}"], arrays[f"y{end}"]
    shape = (y.size, x.size)
    return MapView(
        name=f"Flux on target {attributes.get(f'target{end}', '')}",
        x_m=x,
        y_m=y,
        layers=layers,
        flags=np.zeros(shape, dtype=np.uint32),
        aperture=np.ones(shape, dtype=np.bool_),
        lines=_contours(report, names[int(rows[chosen[0]])]),
        note=f"without background; contours of {names[int(rows[chosen[0]])]}; {FLUX_FILE} has all {flux.shape[0]}",
    )


def _contours(report: BeamsReport, image: str) -> list[FloatArray]:
    table = read_table_csv(report.folder / CONTOURS_FILE)
    lines: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for name, share, line, x, y in zip(
        table["image"], table["share_of_peak"], table["line"], table["x_m"], table["y_m"], strict=True
    ):
        if name == image:
            lines.setdefault((share, line), []).append((float(x), float(y)))
    return [np.array([*points, points[0]]) for points in lines.values()]


def place_chart(report: BeamsReport) -> ChartView:
    """Return where the beams are on their targets."""
    x, y, used = report.numbers("x_m"), report.numbers("y_m"), report.used
    names = report.table["image"]
    series = [_points("beams", x, y, used, names, LINE_X)]
    refused = ~used & np.isfinite(x)
    if refused.any():
        labels = [f"{name}: {reason}" for name, reason in zip(names, report.table["reason"], strict=True)]
        series.append(_points("refused", x, y, refused, labels, LINE_Y))
    if "label_x_m" in report.table:
        series.append(_points("labels", report.numbers("label_x_m"), report.numbers("label_y_m"), used, names, FAINT))
    return ChartView("Centres of the beams", "right [m]", "up [m]", tuple(series), equal=True)


def _points(
    name: str, x: FloatArray, y: FloatArray, which: npt.NDArray[np.bool_], labels: list[str], color: str
) -> ChartSeries:
    texts = [label for label, one in zip(labels, which, strict=True) if one]
    return ChartSeries(name, x[which], y[which], color, Mark.POINTS, labels=texts, size_px=5)


def photo_strip(report: BeamsReport) -> PhotoView | Html:
    """Return some photos on their targets' planes."""
    names = sorted(file.stem for file in (report.folder / "photos").glob("beam_*.jpg"))
    photos = []
    for name, data in sorted(read_thumbnails(report.folder, names).items()):
        image = decode_thumbnail(data)
        if image is None:
            continue
        row = int(name.removeprefix("beam_")) - 1
        note = report.table["reason"][row] or "used"
        photos.append(Photo(report.table["image"][row], image.shape[1], image.shape[0], image, note=note))
    return PhotoView("Photos on the target's plane", tuple(photos)) if photos else Html("<p>No picture was kept.</p>")


def beam_table(report: BeamsReport) -> TableView:
    """Return a line for each beam."""
    wanted = (
        ("x_m", "x [m]", "{:.3f}"),
        ("sigma_x_m", "sigma x [m]", "{:.3f}"),
        ("y_m", "y [m]", "{:.3f}"),
        ("sigma_y_m", "sigma y [m]", "{:.3f}"),
        ("d50_m", "D50 [m]", "{:.3f}"),
        ("d90_m", "D90 [m]", "{:.3f}"),
        ("sigma_d90_m", "sigma D90 [m]", "{:.3f}"),
        ("width_major_m", "major [m]", "{:.3f}"),
        ("width_minor_m", "minor [m]", "{:.3f}"),
        ("peak_flux", "peak flux", "{:.4g}"),
        ("power", "power or area", "{:.4g}"),
    )
    columns = [TableColumn("photo", report.table["image"]), TableColumn("target", report.table["target"])]
    for key, name, form in wanted:
        values = report.numbers(key)
        texts = [form.format(value) if np.isfinite(value) else "" for value in values]
        columns.append(TableColumn(name, texts, values.tolist()))
    columns.append(TableColumn("reason", report.table["reason"]))
    return TableView("Beams", tuple(columns))


def making(report: BeamsReport) -> Html:
    """Return what is said beside the numbers, what was left out, times and input files."""
    rows = [(name.replace("_", " "), text) for name, text in report.summary.texts.items()]
    parts: list[Any] = [page.table(("", ""), rows)]
    if (report.folder / LEFT_OUT_FILE).is_file():
        table = read_table_csv(report.folder / LEFT_OUT_FILE)
        parts.append(page.table(("left out", "reason"), list(zip(table["photo"], table["reason"], strict=True))))
    return join(*parts, page.duration_table(report), page.input_table(report))
