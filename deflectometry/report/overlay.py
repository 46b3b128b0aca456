"""Photos with the image of the source in each facet as it should be and as it is, and tables of turns."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deflectometry.overlay.pipeline.lines import DESIGN_LINE, FACET_LINE, MEASURED_LINE, OVERLAY_FILE
from deflectometry.overlay.pipeline.result import PHOTOS_FILE, TURNS_FILE
from heliogauge.images.thumbnails import decode_thumbnail
from heliogauge.reporting import page
from heliogauge.reporting.html import FirstScreen
from heliogauge.reporting.look import FAINT, LINE_X, LINE_Y
from heliogauge.reporting.notation import number_text
from heliogauge.reporting.verdict import verdict_of
from heliogauge.results.folder import SUMMARY_FILE, Summary, read_summary, read_table_csv
from heliogauge.results.thumbnails import read_thumbnails
from heliogauge.validate import FloatArray
from heliogauge.view.photos import Photo, PhotoLines, PhotoView, photo_sheet
from heliogauge.view.tables import TableColumn, TableView

_COLORS = {FACET_LINE: FAINT, DESIGN_LINE: LINE_Y, MEASURED_LINE: LINE_X}


@dataclass(frozen=True, slots=True, eq=False)
class OverlayFolder:
    """A folder of results.

    folder: The folder.
    summary: Headline numbers, doubts, texts.
    """

    folder: Path
    summary: Summary


def open_overlay(folder: Path) -> OverlayFolder:
    """Read a folder of results."""
    return OverlayFolder(folder, read_summary(folder / SUMMARY_FILE))


def first_screen(results: OverlayFolder) -> FirstScreen:
    """Return verdict, how the heliostat points, the largest canting and move, and the photos with their overlay."""
    summary = results.summary
    numbers = summary.numbers
    rows = []
    shown = (
        ("mean_turn_x_rad", "sigma_mean_turn_x_rad", "rad", "Heliostat as a whole, x"),
        ("mean_turn_y_rad", "sigma_mean_turn_y_rad", "rad", "Heliostat as a whole, y"),
        ("canting_largest_rad", "sigma_canting_largest_rad", "rad", "Largest canting"),
        ("largest_move_mm", "sigma_largest_move_mm", "mm", "Largest move of a mount"),
    )
    for key, sigma, unit, label in shown:
        if key in numbers:
            rows.append((label, number_text(float(numbers[key] or 0.0), float(numbers[sigma] or 0.0), unit), ""))
    measured, count = int(numbers["facets_measured_count"] or 0), int(numbers["facets_count"] or 0)
    rows.append(("Facets", f"{measured} of {count}", f"from {int(numbers['photos_count'] or 0)} photos"))
    line = f"{summary.kind}; angles of the normal, a beam turns by twice as much; heliogauge {summary.version}"
    words = "Image of the source as designed and as measured; where they agree nothing is to move."
    return page.first_screen(summary.name, line, verdict_of(summary), rows, photos(results.folder, words))


def photos(folder: Path, words: str) -> PhotoView:
    """Return each photo with the outlines of facets and of the source's image, as designed and as measured.

    words: Said below each name.
    """
    table = read_table_csv(folder / PHOTOS_FILE, ("photo", "width_px", "height_px"))
    lines = read_table_csv(folder / OVERLAY_FILE, ("photo", "kind", "line", "x_px", "y_px"))
    points = np.array([lines["x_px"], lines["y_px"]], dtype=np.float64).T.reshape(-1, 2)
    pieces: dict[tuple[str, str], dict[str, list[int]]] = {}
    for row, (photo, kind, line) in enumerate(zip(lines["photo"], lines["kind"], lines["line"], strict=True)):
        pieces.setdefault((photo, kind), {}).setdefault(line, []).append(row)
    pictures = read_thumbnails(folder, table["photo"])
    shown = []
    for name, width, height in zip(table["photo"], table["width_px"], table["height_px"], strict=True):
        drawn = []
        for kind, color in _COLORS.items():
            own: list[FloatArray] = [points[rows] for rows in pieces.get((name, kind), {}).values()]
            if own:
                drawn.append(PhotoLines(kind if kind == FACET_LINE else f"source's image {kind}", own, color))
        picture = pictures.get(name)
        image = None if picture is None else decode_thumbnail(picture)
        shown.append(Photo(name, float(width), float(height), image, lines=tuple(drawn)))
    stills = []
    for one in shown:
        sheet = photo_sheet(one)
        sheet.title(one.name, words)
        stills.append(sheet.html(f"{one.name} with the overlay"))
    return PhotoView("Overlay", tuple(shown), stills)


def turns(folder: Path) -> TableView:
    """Return the turn of each facet against its design."""
    columns = read_table_csv(folder / TURNS_FILE, ("facet", "photos"))
    shown = [TableColumn("facet", columns["facet"])]
    for axis in "xy":
        values, sigmas = (
            [float(one) if one else float("nan") for one in columns[key]]
            for key in (f"turn_{axis}_rad", f"sigma_turn_{axis}_rad")
        )
        texts = [
            number_text(value, sigma, "rad") if np.isfinite(value) else "\u2013"
            for value, sigma in zip(values, sigmas, strict=True)
        ]
        shown.append(TableColumn(f"turn in {axis}", texts, values))
    shown.append(TableColumn("seen in", columns["photos"]))
    # Results of before it was said have no such column.
    if "not_used" in columns:
        shown.append(TableColumn("not used", columns["not_used"]))
    return TableView("Turns against the design", tuple(shown))


def cameras(folder: Path) -> TableView:
    """Return where the cameras stood and how points and survey fit."""
    columns = read_table_csv(folder / PHOTOS_FILE, ("photo",))
    shown = [TableColumn("photo", columns["photo"])]
    for key, label, form in (
        ("x_m", "x [m]", "{:.3f}"),
        ("y_m", "y [m]", "{:.3f}"),
        ("z_m", "z [m]", "{:.3f}"),
        ("points_residual_px", "points off, RMS [px]", "{:.2f}"),
        ("place_misfit_sigmas", "all facets off alike, in sigmas", "{:.1f}"),
    ):
        values = [float(one) if one else float("nan") for one in columns[key]]
        shown.append(TableColumn(label, ["\u2013" if np.isnan(one) else form.format(one) for one in values], values))
    return TableView("Cameras", tuple(shown))
