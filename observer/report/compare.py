"""Sections of the report of a gravity study; each is one cell of its notebook."""

from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np

from heliogauge.reporting import page
from heliogauge.reporting.html import Html, join, show, table
from heliogauge.reporting.notation import number_text
from heliogauge.results.arrays import read_arrays
from heliogauge.results.folder import Summary, read_summary, read_table_csv
from observer.files import ORIENTATION_CHANGES, ORIENTATION_PROFILES, ORIENTATION_SAGS
from observer.product.orientation_study import SpanSags
from observer.report.figures_modules import CHANGES_TITLE, OneMap, maps_figure
from observer.report.figures_orientation import Profile, orientation_figure
from observer.report.results import Columns, numbers


@dataclass(frozen=True, slots=True, eq=False)
class StudyResults:
    """What a folder with a gravity study holds."""

    summary: Summary
    profiles: list[Profile]
    sags: list[SpanSags]
    changes: list[OneMap]
    orientations: Columns
    by_weight: Columns


def open_study(folder: str | Path = ".") -> StudyResults:
    """Read a folder with a gravity study.

    folder: The folder; the working directory without it.
    """
    folder = Path(folder)
    lines = read_table_csv(folder / ORIENTATION_PROFILES, ("of", *Profile.__slots__[1:]))
    spans = read_table_csv(folder / ORIENTATION_SAGS, ("of", *SpanSags.__slots__))
    profiles = [
        Profile(name, float(part["orientation_rad"][0]), *(numbers(part, key) for key in Profile.__slots__[2:]))
        for name, part in _parts(lines)
    ]
    sags = [SpanSags(*(numbers(part, key) for key in SpanSags.__slots__)) for _, part in _parts(spans)]
    changes: list[OneMap] = []
    if (folder / ORIENTATION_CHANGES).is_file():
        found, attributes = read_arrays(folder / ORIENTATION_CHANGES, ("x", "y"))
        changes = [
            OneMap(str(name), found["x"], found["y"], found[f"theta_r_change_{k}"].astype(np.float64))
            for k, name in enumerate(attributes["orientations"], start=1)
        ]
    return StudyResults(
        read_summary(folder),
        profiles,
        sags,
        changes,
        read_table_csv(folder / "orientations.csv"),
        read_table_csv(folder / "sag_by_weight.csv"),
    )


def _parts(columns: Columns) -> list[tuple[str, Columns]]:
    """Split a table by its first column, whose equal values stand below each other."""
    found = []
    for name, rows in groupby(range(len(columns["of"])), key=lambda row: columns["of"][row]):
        chosen = list(rows)
        found.append((name, {key: [cells[row] for row in chosen] for key, cells in columns.items()}))
    return found


def head(results: StudyResults) -> Html:
    """Return title and warnings."""
    return page.head(results, f"one trough at {len(results.profiles)} orientations")


def weight(results: StudyResults) -> Html:
    """Return what the tube's weight does to each span, and the bend that it keeps."""
    columns = results.by_weight
    rows = []
    for k in range(len(columns["from_y_m"])):
        ends = " to ".join(f"{float(columns[name][k]):.2f}" for name in ("from_y_m", "to_y_m"))
        pairs = (("by_weight_m", "sigma_by_weight_m"), ("bend_x_m", "sigma_bend_x_m"), ("bend_z_m", "sigma_bend_z_m"))
        cells = [number_text(float(columns[name][k]), float(columns[sigma][k]), "m", name) for name, sigma in pairs]
        rows.append((f"{ends} m", *cells, f"{float(columns['worst_residual'][k]):.1f} sigma"))
    names = ("span, y", "sag by weight, downward", "lasting bend across", "lasting bend along the axis", "worst rest")
    return table(names, rows, numbers=(1, 2, 3, 4)) if rows else Html("<p>No span was measured twice.</p>")


def absorber(results: StudyResults) -> Html:
    """Return the absorber at all orientations."""
    note = (
        "X_a and Z_a as in each result's own report, in the collector's frame, which turns with it. The sag of a span "
        "is the distance of its middle from the middle between its supports; by weight it turns as (sin t, -cos t)."
    )
    return join(show(orientation_figure(results.profiles, results.sags), caption=note), _orientations(results))


def _orientations(results: StudyResults) -> Html:
    """Return a row for each orientation."""
    columns = (
        ("absorber_mean_x_m", "mean X_a", "m"),
        ("absorber_mean_z_offset_m", "mean Z_a - focal length", "m"),
        ("absorber_sag_down_m", "largest sag downward", "m"),
        ("theta_r_turned_rad", "theta_r turned", "rad"),
        ("theta_r_change_rms_rad", "theta_r changed, RMS", "rad"),
        ("theta_r_change_noise_rad", "of noise alone", "rad"),
    )
    rows = []
    for k, name in enumerate(results.orientations["result"]):
        cells = []
        for key, _, unit in columns:
            value, sigma = (_number(results.orientations, one, k) for one in (key, f"sigma_{key}"))
            cells.append("-" if value is None else number_text(value, sigma, unit, key))
        rows.append((f"{name}, {float(results.orientations['orientation_deg'][k]):g} deg", *cells))
    return table(("result", *(title for _, title, _ in columns)), rows, numbers=range(1, len(columns) + 1))


def _number(columns: Columns, key: str, row: int) -> float | None:
    cell = columns[key][row] if key in columns else ""
    return float(cell) if cell and np.isfinite(float(cell)) else None


def mirror(results: StudyResults) -> Html:
    """Return how the mirror's slopes change."""
    if not results.changes:
        return Html("<p>Fewer than two of the results have slopes of the mirror.</p>")
    note = (
        "theta_r minus that of the first orientation, without its mean, which the table gives as theta r turned. "
        "Positive where the mirror's normal turned towards +x. The table gives its RMS, and the RMS that noise alone "
        "would give."
    )
    return show(maps_figure(results.changes, CHANGES_TITLE), caption=note)


def making(results: StudyResults) -> Html:
    """Return the input files."""
    return page.input_table(results)
