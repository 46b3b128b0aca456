"""Sections of the report of the photos to take next; each is one cell of its notebook."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.camera.report.planned_pictures import board_picture
from heliogauge.camera.model import Camera
from heliogauge.reporting import page
from heliogauge.reporting.html import Html, Shown, join, table, table_under_name
from heliogauge.reporting.look import INK, LINE_X
from heliogauge.reporting.verdict import verdict_of
from heliogauge.results.folder import (
    Summary,
    read_cameras_json,
    read_points_csv,
    read_summary,
    read_table_csv,
)
from heliogauge.validate import FloatArray
from heliogauge.view.charts import ChartSeries, ChartView, Mark
from heliogauge.view.stills import side_by_side
from heliogauge.view.tables import TableColumn, TableView

_SIGMA = "sigma_ray_without_rotation_rms_rad"


@dataclass(frozen=True, slots=True, eq=False)
class PlannedPhotos:
    """What a folder with a plan holds.

    photos: Columns of next_photos.csv.
    outlines_px: Corners of the board in each photo, (4, 2) [px].
    points_px: Its points in each photo, (k, 2) [px].
    unit: Of distances, as names end.
    """

    folder: Path
    summary: Summary
    camera: Camera
    photos: dict[str, list[str]]
    outlines_px: list[FloatArray]
    points_px: list[FloatArray]
    unit: str


def open_plan(folder: str | Path = ".") -> PlannedPhotos:
    """Read a folder with a plan.

    folder: The folder; the working directory without it.
    """
    folder = Path(folder)
    photos = read_table_csv(folder / "next_photos.csv", ("photo", "what", _SIGMA))
    unit = "m" if "distance_m" in photos else "pitch"
    cameras, poses = read_cameras_json(folder / "cameras.json", unit)
    camera = next(iter(cameras.values()))
    points = read_points_csv(folder / "points.csv", unit)
    corners = read_table_csv(folder / "outlines.csv", ("photo", "x_px", "y_px"))
    places = np.array([corners["x_px"], corners["y_px"]], dtype=np.float64).T.reshape(-1, 4, 2)
    seen = [camera.project(poses[name].cam_from_world.apply(points.xyz_m)) for name in photos["photo"]]
    return PlannedPhotos(folder, read_summary(folder / "summary.json"), camera, photos, list(places), seen, unit)


def first_screen(plan: PlannedPhotos) -> Html:
    """Return name, answer, headline numbers and sigma against the photos."""
    summary = plan.summary
    line = (
        f"photos that a calibrated camera needs next; {summary.texts.get('answer', '')}; heliogauge {summary.version}"
    )
    numbers = summary.numbers
    before, after = (float(numbers[key] or np.nan) for key in (_SIGMA, f"planned_{_SIGMA}"))
    rows = [
        ("Sigma of lines of sight today", f"{1e3 * before:.2g} mrad", "RMS, best rotation taken out"),
        ("with the planned photos", f"{1e3 * after:.2g} mrad"),
        ("Photos so far", f"{numbers['earlier_photos_count']}"),
        ("Photos to take", f"{numbers['photos_count']}"),
    ]
    wanted = numbers.get(f"wanted_{_SIGMA}")
    passed = []
    if wanted is not None:
        rows.append(("Wanted", f"{1e3 * wanted:.2g} mrad"))
        if after <= wanted:
            passed.append("the wanted sigma is reached")
    return page.first_screen(summary.name, line, verdict_of(summary, [], passed), rows, sigmas(plan))


def sigmas(plan: PlannedPhotos) -> ChartView:
    """Return the sigma of lines of sight against the photos taken."""
    before = float(plan.summary.numbers[_SIGMA] or np.nan)
    values = 1e3 * np.array([before, *(float(cell) for cell in plan.photos[_SIGMA])])
    count = np.arange(values.size, dtype=np.float64)
    labels = ["today", *plan.photos["photo"]]
    series = [
        ChartSeries("sigma", count, values, LINE_X),
        ChartSeries("after each photo", count, values, INK, Mark.POINTS, labels=labels, size_px=7),
    ]
    wanted = plan.summary.numbers.get(f"wanted_{_SIGMA}")
    if wanted is not None:
        series.append(ChartSeries("wanted", count[[0, -1]], np.full(2, 1e3 * wanted), INK, dashed=True))
    return ChartView(
        "Sigma of lines of sight with each photo",
        "photos taken of those planned",
        "sigma, RMS over the image [mrad]",
        tuple(series),
        "best rotation taken out",
    )


def pictures(plan: PlannedPhotos) -> Html:
    """Return how the board should look in each photo."""
    ones = zip(plan.outlines_px, plan.points_px, plan.photos["photo"], plan.photos["what"], strict=True)
    shown = []
    for outline, points, name, what in ones:
        sheet = board_picture(plan.camera, outline, points, (name, what))
        shown.append(sheet.html(f"How the board should look in {name}: {what}"))
    return side_by_side(shown, caption="Orange: the board's upper edge as drawn, its left end with a dot.")


def photos(plan: PlannedPhotos) -> Shown:
    """Return the photos to take as a table."""
    unit = "m" if plan.unit == "m" else "pitches"
    numbers = (
        ("roll [deg]", "roll_deg", 1.0, ".0f"),
        ("tilt [deg]", "tilt_deg", 1.0, ".0f"),
        (f"distance [{unit}]", f"distance_{plan.unit}", 1.0, ".3g"),
        ("middle x [px]", "center_x_px", 1.0, ".0f"),
        ("middle y [px]", "center_y_px", 1.0, ".0f"),
        ("sigma with it [mrad]", _SIGMA, 1e3, ".3f"),
    )
    columns = [TableColumn("photo", plan.photos["photo"]), TableColumn("what to do", plan.photos["what"])]
    for name, key, factor, form in numbers:
        values = [factor * float(cell) for cell in plan.photos[key]]
        columns.append(TableColumn(name, [format(value, form) for value in values], values))
    return table_under_name(TableView("Photos to take, in this order", tuple(columns)))


def intrinsics(plan: PlannedPhotos) -> Shown:
    """Return the sigma of each intrinsic today and with all planned photos."""
    numbers = plan.summary.numbers
    keys = [key for key in numbers if key.startswith("sigma_") and f"planned_{key}" in numbers and key != _SIGMA]
    both = [[float(numbers[name] or np.nan) for name in (key, f"planned_{key}")] for key in keys]
    columns = [TableColumn("intrinsic", [key.removeprefix("sigma_").replace("_", " ") for key in keys])]
    for place, name in enumerate(("sigma today", "sigma with the photos")):
        values = [pair[place] for pair in both]
        columns.append(TableColumn(name, [f"{value:.2g}" for value in values], values))
    return table_under_name(TableView("Intrinsics", tuple(columns)))


def making(plan: PlannedPhotos) -> Html:
    """Return what must be known beside the numbers, times and input files."""
    said = [(name.replace("_", " "), text) for name, text in plan.summary.texts.items()]
    return join(table(("", ""), said), page.duration_table(plan), page.input_table(plan))
