"""Sections of the report of targets read in single photos; each is one cell of its notebook."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from heliogauge.images.thumbnails import decode_thumbnail
from heliogauge.reporting import page
from heliogauge.reporting.html import Html, Shown
from heliogauge.reporting.look import LINE_X, LINE_Y
from heliogauge.reporting.verdict import verdict_of
from heliogauge.results.folder import SUMMARY_FILE, Summary, read_summary, read_table_csv
from heliogauge.results.thumbnails import read_thumbnails
from heliogauge.validate import FloatArray
from heliogauge.view.photos import Photo, PhotoMarks, PhotoView
from heliogauge.view.tables import TableColumn, TableView
from photogrammetry.report import tables

#: Numbers of the first screen and what they are called there.
LABELS: dict[str, str] = {
    "targets_read_count": "Targets read",
    "codes_count": "Different codes",
    "refused_count": "Refused",
    "dots_without_code_count": "Dots without a code",
    "center_sigma_median_px": "Sigma of a centre, median",
    "dot_diameter_median_px": "Diameter of a dot, median",
    "ring_inner_radius_ratio": "Code ring from, in radii of the dot",
    "ring_outer_radius_ratio": "Code ring to, in radii of the dot",
}
_LOOSE = "#8a6d3b"
_Table = Mapping[str, Sequence[str]]


@dataclass(frozen=True, eq=False)
class TargetResults:
    """What a folder of targets read in single photos holds.

    photos, targets, refused, dots: The tables of these names.
    """

    folder: Path
    summary: Summary
    photos: _Table
    targets: _Table
    refused: _Table
    dots: _Table


def open_targets(folder: Path) -> TargetResults:
    """Read a folder of targets read in single photos.

    InputError: A file is missing or damaged.
    """
    return TargetResults(
        folder,
        read_summary(folder / SUMMARY_FILE),
        read_table_csv(folder / "photos.csv", ("photo", "width_px", "height_px")),
        read_table_csv(folder / "targets.csv", ("photo", "code", "x_px", "y_px", "sigma_px", "radius_px", "flag")),
        read_table_csv(folder / "refused.csv", ("photo", "name", "x_px", "y_px", "reason")),
        read_table_csv(folder / "dots.csv", ("photo", "x_px", "y_px")),
    )


def first_screen(results: TargetResults) -> Html:
    """Return name, headline numbers and the photos with what was found in them."""
    summary = results.summary
    read = int(summary.numbers.get("targets_read_count") or 0)
    refused = int(summary.numbers.get("refused_count") or 0)
    passed = [] if refused or not read else ["every code ring that was found was read"]
    return page.first_screen(
        summary.name,
        f"targets read in single photos; heliogauge {summary.version}",
        verdict_of(summary, [] if read else ["no target was read"], passed),
        tables.headline_rows(summary, LABELS),
        photo_view(results),
    )


def photo_view(results: TargetResults) -> PhotoView:
    """Return the photos with what was read, what was refused and why, and dots without a code."""
    names = list(results.photos["photo"])
    thumbnails = read_thumbnails(results.folder, names)
    photos = []
    for row, name in enumerate(names):
        read = [_of_target(results.targets, k) for k in _rows(results.targets, name)]
        why = [f"{results.refused['name'][k]}: {results.refused['reason'][k]}" for k in _rows(results.refused, name)]
        marks = (
            PhotoMarks("read", _places(results.targets, name), LINE_X, read),
            PhotoMarks("refused", _places(results.refused, name), LINE_Y, why, refused=True),
            PhotoMarks("dots without a code", _places(results.dots, name), _LOOSE),
        )
        size = [float(results.photos[key][row]) for key in ("width_px", "height_px")]
        image = decode_thumbnail(thumbnails[name]) if name in thumbnails else None
        photos.append(Photo(name, size[0], size[1], image, marks))
    return PhotoView("Photos with what was read in them", tuple(photos))


def _of_target(table: _Table, row: int) -> str:
    flag = table["flag"][row]
    return f"{table['code'][row]}: sigma {table['sigma_px'][row]} px" + (f", {flag}" if flag else "")


def _rows(table: _Table, photo: str) -> list[int]:
    return [row for row, name in enumerate(table["photo"]) if name == photo and table["x_px"][row]]


def _places(table: _Table, photo: str) -> FloatArray:
    rows = _rows(table, photo)
    return np.array([[float(table[f"{axis}_px"][row]) for axis in "xy"] for row in rows]).reshape(-1, 2)


def listed(results: TargetResults) -> Shown:
    """Return all targets that were read."""
    table = results.targets
    if not table["code"]:
        return Html("<p>No target was read.</p>")
    number = {name: np.array([float(cell or "nan") for cell in table[name]]) for name in table if name.endswith("_px")}
    return TableView(
        "Targets read",
        (
            TableColumn("photo", table["photo"]),
            TableColumn("code", table["code"]),
            tables.number_column("x [px]", number["x_px"], 3),
            tables.number_column("y [px]", number["y_px"], 3),
            tables.number_column("sigma [px]", number["sigma_px"], 4),
            tables.number_column("radius [px]", number["radius_px"], 2),
            TableColumn("flag", table["flag"]),
        ),
        most_rows=200,
    )


def refused(results: TargetResults) -> Shown:
    """Return what was refused and why."""
    table = results.refused
    if not table["name"]:
        return Html("<p>Nothing was refused.</p>")
    return TableView(
        "Refused",
        (
            TableColumn("photo", table["photo"]),
            TableColumn("what", table["name"]),
            TableColumn("why", table["reason"]),
        ),
        most_rows=200,
    )


def numbers(results: TargetResults) -> Html:
    """Return all numbers, times and input files."""
    return page.join(tables.number_table(results.summary), page.duration_table(results), page.input_table(results))
