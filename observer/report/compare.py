"""Sections of the report on results of one trough at several orientations or dates; each is a cell of its notebook."""

from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

import numpy as np

from heliogauge.reporting import page
from heliogauge.reporting.html import FirstScreen, Html, beside, join, table
from heliogauge.reporting.look import robust_limit
from heliogauge.reporting.notation import number_text
from heliogauge.reporting.verdict import verdict_of
from heliogauge.results.arrays import read_arrays
from heliogauge.results.folder import Summary, read_summary, read_table_csv, unit_of
from heliogauge.view.maps import MapLayer, MapView
from heliogauge.view.tables import TableColumn, TableView
from observer.files import (
    CHANGED_NUMBERS,
    CHANGED_PANELS,
    COLLECTOR,
    ORIENTATION_CHANGES,
    ORIENTATION_PROFILES,
    ORIENTATION_SAGS,
    read_collector,
)
from observer.product.orientation_study import LEAST_TURN_RAD, SpanSags
from observer.report.figures_modules import CHANGES_TITLE, OneMap, maps_sheet
from observer.report.maps import panel_lines
from observer.report.orientations import Profile, orientation_views, profile_view
from observer.report.results import Columns, numbers
from observer.trough.collector import Collector

_MRAD = 1e3
_CHANGES = ("theta_r_change", "sigma_theta_r_change")


@dataclass(frozen=True, slots=True, eq=False)
class StudyResults:
    """What a folder with compared results holds."""

    summary: Summary
    collector: Collector
    profiles: list[Profile]
    sags: list[SpanSags]
    changes: list[OneMap]
    orientations: Columns
    by_weight: Columns
    changed_numbers: Columns
    changed_panels: Columns

    @property
    def is_turned(self) -> bool:
        """Whether orientations differ enough to say something of weight."""
        return bool(np.ptp([one.orientation_rad for one in self.profiles]) >= LEAST_TURN_RAD)


def open_study(folder: str | Path = ".") -> StudyResults:
    """Read a folder with compared results.

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
            OneMap(str(name), found["x"], found["y"], *(found[f"{one}_{k}"].astype(np.float64) for one in _CHANGES))
            for k, name in enumerate(attributes["orientations"], start=1)
        ]
    return StudyResults(
        read_summary(folder),
        read_collector(folder / COLLECTOR),
        profiles,
        sags,
        changes,
        read_table_csv(folder / "orientations.csv"),
        read_table_csv(folder / "sag_by_weight.csv"),
        read_table_csv(folder / CHANGED_NUMBERS, ("of", "key", "before", "after", "change", "sigma_change")),
        read_table_csv(folder / CHANGED_PANELS, ("of", "panel", "is_sure")),
    )


def _parts(columns: Columns) -> list[tuple[str, Columns]]:
    """Split a table by its first column, whose equal values stand below each other."""
    found = []
    for name, rows in groupby(range(len(columns["of"])), key=lambda row: columns["of"][row]):
        chosen = list(rows)
        found.append((name, {key: [cells[row] for row in chosen] for key, cells in columns.items()}))
    return found


def head(results: StudyResults) -> FirstScreen:
    """Return the first screen: verdict, what changed, what weight does."""
    summary, table_ = results.summary, results.orientations
    rows: list[tuple[str, ...]] = [(f"Sag by weight, {ends}", text) for ends, text, *_ in _weights(results)]
    for k, name in enumerate(table_["result"]):
        values = [_number(table_, f"theta_r_{key}_rad", k) for key in ("change_rms", "change_noise")]
        if k and values[0] is not None:
            noise = "" if values[1] is None else f"noise alone would give {number_text(values[1], None, 'rad')}"
            rows.append((f"theta_r changed, RMS: {name}", number_text(values[0], None, "rad"), noise))
    rows += [(f"Panels that turned: {name}", *said) for name, said in _turned(results)]
    rows += [
        (f"{_title(key)} changed: {name}", text)
        for name, key, _, _, text in _changed(results)
        if key == "intercept_ratio"
    ]
    is_missing = results.is_turned and not results.by_weight["from_y_m"]
    missing = ["no span was measured at two orientations"] if is_missing else []
    words = f"at {len(results.profiles)} orientations" if results.is_turned else f"in {len(results.profiles)} results"
    line = f"one trough {words}; heliogauge {summary.version}"
    view = change_view(results) or profile_view(results.profiles, "z")
    return page.first_screen(summary.name, line, verdict_of(summary, missing), rows, view)


def doubts(results: StudyResults) -> Html:
    """Return all doubts with all their words."""
    return page.doubts_box(results)


def change_view(results: StudyResults) -> MapView | None:
    """Return how theta_r changes from the first orientation to each other one; None without two mirrors."""
    if not results.changes:
        return None
    limit = robust_limit(*(_MRAD * one.angle_rad for one in results.changes))
    first = results.changes[0]
    layers = [
        MapLayer(f"change_{k}", f"theta_r at {one.name} minus the first", "mrad", one.angle_rad, _MRAD, one.sigma_rad)
        for k, one in enumerate(results.changes, start=1)
    ]
    layers = [replace(one, limit=limit) for one in layers]
    rms = ", ".join(f"{one.name} {_MRAD * float(np.sqrt(np.nanmean(one.angle_rad**2))):.3f}" for one in results.changes)
    shape = first.angle_rad.shape
    note = f"Without its mean; RMS [mrad]: {rms}. Positive where the mirror's normal turned towards +x."
    return MapView(
        "Change of the mirror",
        first.x_m,
        first.y_m,
        tuple(layers),
        np.zeros(shape, np.uint32),
        np.ones(shape, np.bool_),
        note=note,
        lines=panel_lines(results.collector),
        stills=[maps_sheet(results.changes, CHANGES_TITLE).html(CHANGES_TITLE)],
    )


def changes(results: StudyResults) -> Html:
    """Return what changed from the first result to each other one: numbers and panels."""
    note = (
        "Other result minus the first. The two measurements are taken to err apart: where they share targets or a "
        "camera calibration, true sigmas are smaller. A panel's change is that of the mean over what both measured. It "
        "has surely turned where chance makes the largest of all these changes so large once in a hundred times."
    )
    rows = [(name, _title(key), *texts) for name, key, *texts in _changed(results)]
    shown = table(("result", "", "first", "then", "change \u00b1 1 sigma"), rows, numbers=(2, 3, 4))
    return join(shown, Html(f'<p class="caption">{note}</p>'), *_panel_tables(results))


def _changed(results: StudyResults) -> list[tuple[str, str, str, str, str]]:
    """Return of each changed number: result, key, first and other value, change."""
    columns, found = results.changed_numbers, []
    for k, (name, key) in enumerate(zip(columns["of"], columns["key"], strict=True)):
        unit = unit_of(key)[1]
        before, after, change, sigma = (float(columns[one][k]) for one in ("before", "after", "change", "sigma_change"))
        first, then = (number_text(value, None, unit, key) for value in (before, after))
        found.append((name, key, first, then, number_text(change, sigma, unit, key)))
    return found


def _title(key: str) -> str:
    return unit_of(key)[0].removesuffix("_ratio").replace("_", " ")


def _turned(results: StudyResults) -> list[tuple[str, tuple[str, str]]]:
    """Say of each other result how many panels turned, and which."""
    found = []
    for name, part in _parts(results.changed_panels):
        sure = [panel for panel, one in zip(part["panel"], part["is_sure"], strict=True) if one == "1"]
        known = int(np.isfinite(numbers(part, "theta_r_change_rad")).sum())
        named = f"panel {', '.join(sure)}" if sure else ""
        rest = len(part["panel"]) - known
        unsaid = f"{rest} more are measured by less than half in both, of which nothing is known" if rest else ""
        found.append((name, (f"{len(sure)} of {known}", "; ".join(text for text in (named, unsaid) if text))))
    return found


def _panel_tables(results: StudyResults) -> list[TableView]:
    tables = []
    for name, part in _parts(results.changed_panels):
        shown = [TableColumn("panel", part["panel"], numbers(part, "panel").tolist())]
        for key, title in (("theta_r_change_rad", "theta_r changed"), ("theta_ra_change_rad", "theta_ra changed")):
            values, sigmas = numbers(part, key), numbers(part, f"sigma_{key}")
            texts = [
                number_text(value, sigma, "rad") if np.isfinite(value) else "-"
                for value, sigma in zip(values.tolist(), sigmas.tolist(), strict=True)
            ]
            shown.append(TableColumn(title, texts, values.tolist()))
        shown.append(TableColumn("surely turned", ["yes" if one == "1" else "" for one in part["is_sure"]]))
        tables.append(TableView(f"panels: {name}", tuple(shown)))
    return tables


def weight(results: StudyResults) -> Html:
    """Return what the tube's weight does to each span, and the bend that it keeps."""
    names = ("span, y", "sag by weight, downward", "lasting bend across", "lasting bend along the axis", "worst rest")
    rows = _weights(results)
    if rows:
        return table(names, rows, numbers=(1, 2, 3, 4))
    if not results.is_turned:
        return Html("<p>All results are at one orientation, which says nothing of what weight does.</p>")
    return Html("<p>No span was measured at two orientations.</p>")


def _weights(results: StudyResults) -> list[tuple[str, ...]]:
    """Return the cells of each span: where it is, its sag by weight, its bends, the worst rest."""
    columns = results.by_weight
    rows = []
    for k in range(len(columns["from_y_m"])):
        ends = " to ".join(f"{float(columns[name][k]):.2f}" for name in ("from_y_m", "to_y_m"))
        pairs = (("by_weight_m", "sigma_by_weight_m"), ("bend_x_m", "sigma_bend_x_m"), ("bend_z_m", "sigma_bend_z_m"))
        cells = [number_text(float(columns[name][k]), float(columns[sigma][k]), "m", name) for name, sigma in pairs]
        rows.append((f"{ends} m", *cells, f"{float(columns['worst_residual'][k]):.1f} sigma"))
    return rows


def absorber(results: StudyResults) -> Html:
    """Return the absorber at all orientations."""
    note = (
        "X_a and Z_a as in each result's own report, in the collector's frame, which turns with it. The sag of a span "
        "is the distance of its middle from the middle between its supports; by weight it turns as (sin t, -cos t)."
    )
    shown = beside(*orientation_views(results.profiles, results.sags))
    return join(shown, Html(f'<p class="caption">{note}</p>'), _orientations(results))


def _orientations(results: StudyResults) -> TableView:
    """Return a row for each orientation."""
    table_ = results.orientations
    turns = [float(cell) for cell in table_["orientation_deg"]]
    shown = [
        TableColumn("result", table_["result"]),
        TableColumn("orientation", [f"{turn:g} deg" for turn in turns], turns),
    ]
    for key, title, unit in (
        ("absorber_mean_x_m", "mean X_a", "m"),
        ("absorber_mean_z_offset_m", "mean Z_a - focal length", "m"),
        ("absorber_sag_down_m", "largest sag downward", "m"),
        ("theta_r_turned_rad", "theta_r turned", "rad"),
        ("theta_r_change_rms_rad", "theta_r changed, RMS", "rad"),
        ("theta_r_change_noise_rad", "of noise alone", "rad"),
    ):
        values, sigmas = ([_number(table_, name, k) for k in range(len(turns))] for name in (key, f"sigma_{key}"))
        texts = [
            "-" if value is None else number_text(value, sigma, unit, key)
            for value, sigma in zip(values, sigmas, strict=True)
        ]
        shown.append(TableColumn(title, texts, [np.nan if value is None else value for value in values]))
    return TableView("orientations", tuple(shown))


def _number(columns: Columns, key: str, row: int) -> float | None:
    cell = columns[key][row] if key in columns else ""
    return float(cell) if cell and np.isfinite(float(cell)) else None


def inputs(results: StudyResults) -> Html:
    """Return the input files."""
    return page.input_table(results)
