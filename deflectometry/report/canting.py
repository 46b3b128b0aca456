"""Canting of the facets of an ensemble, and what each mount is to be moved: a map with arrows, and two tables."""

import html
from pathlib import Path
from typing import Protocol

import numpy as np

from deflectometry.shape.facet_canting import CANTING_FILE, CANTING_SIGN, MOUNTS_FILE
from heliogauge.geometry.surfaces import Facet, plane
from heliogauge.reporting.html import Html, join, table_under_name
from heliogauge.reporting.look import nice_ceiling
from heliogauge.reporting.notation import number_text
from heliogauge.results.folder import Summary, read_table_csv
from heliogauge.validate import FloatArray
from heliogauge.view.maps import MapLayer, MapMark, MapRegions, MapView
from heliogauge.view.tables import TableColumn, TableView

_MRAD = 1e3
#: Nodes along the longer side of the map: edges of facets are then within a pixel or two.
_NODES = 400
#: The longest arrow is at most this share of a facet's width.
_ARROW_SHARE = 0.45
_COMPONENTS = ("canting_x_rad", "canting_y_rad")

Columns = dict[str, list[str]]


class FolderAndSummary(Protocol):
    """Results of any kind that have a canting."""

    @property
    def folder(self) -> Path:
        """Where they are."""

    @property
    def summary(self) -> Summary:
        """Headline numbers and outlines."""


def canting_section(results: FolderAndSummary) -> Html:
    """Return map and tables of the canting; nothing for a mirror of one facet."""
    if not (results.folder / CANTING_FILE).exists():
        return Html("")
    columns = read_table_csv(results.folder / CANTING_FILE, ("facet", *_COMPONENTS, "rise_x_rad", "rise_y_rad"))
    has_mounts = (results.folder / MOUNTS_FILE).exists()
    mounts = read_table_csv(results.folder / MOUNTS_FILE, ("facet", "mount", "move_mm")) if has_mounts else {}
    words = CANTING_SIGN[0].upper() + CANTING_SIGN[1:]
    head = f"<h2>Canting</h2><p>{html.escape(words)}. The mean tilt of all facets is that of the mirror's frame.</p>"
    if not has_mounts:
        head += "<p>With the places of the mounts (mounts_m in measurement.toml) the moves stand here.</p>"
    tables = [table_under_name(one) for one in (_canting_table(columns), *([_mount_table(mounts)] if mounts else []))]
    return join(Html(head), canting_view(results, columns, mounts), *tables)


def canting_view(results: FolderAndSummary, columns: Columns, mounts: Columns) -> MapView:
    """Return the canting of each facet as a map with arrows, the mounts with their moves on it.

    columns, mounts: ``canting.csv`` and ``mounts.csv``; no mounts: empty.
    """
    outlines = [np.array(one, dtype=np.float64)[:, :2] for one in results.summary.geometry_m["outlines"]]
    corners = np.concatenate(outlines)
    low, high = corners.min(axis=0), corners.max(axis=0)
    step = float((high - low).max()) / _NODES
    x, y = (np.arange(a, b + step, step) for a, b in zip(low, high, strict=True))
    index = np.full((y.size, x.size), 255, dtype=np.uint8)
    for number, (name, outline) in enumerate(zip(columns["facet"], outlines, strict=True)):
        index[Facet(name, outline, plane()).contains(x, y[:, None])] = min(number, 255)
    inside = index < 255

    def spread(values: FloatArray) -> FloatArray:
        return np.where(inside, np.append(values, np.full(256 - len(values), np.nan))[index], np.nan)

    turns = [_numbers(columns, name) for name in _COMPONENTS]
    sigmas = [_numbers(columns, f"sigma_{name}") for name in _COMPONENTS]
    # Half as much again keeps numbers and arrows readable on the strongest colours.
    limit = nice_ceiling(1.5 * _MRAD * max(float(np.nanmax(np.abs(turn), initial=0.0)) for turn in turns))
    layers = [
        MapLayer(f"canting_{axis}", f"Canting in {axis}", "mrad", spread(turn), _MRAD, spread(sigma), limit=limit)
        for axis, turn, sigma in zip("xy", turns, sigmas, strict=True)
    ]
    layers.append(MapLayer("canting", "Canting, magnitude", "mrad", spread(np.hypot(*turns)), _MRAD, diverging=False))
    arrows, longest = _arrows(columns, outlines)
    note = f"Arrows point where a facet rises too much; {longest:g} mrad is {_ARROW_SHARE:.0%} of a facet's width."
    if mounts:
        note += " Numbers: moves of the mounts in mm, + out of the mirror."
    return MapView(
        "Canting of the facets",
        x,
        y,
        tuple(layers),
        np.zeros(index.shape, np.uint32),
        inside,
        note=note,
        lines=[np.vstack([one, one[:1]]) for one in outlines],
        arrows=arrows,
        marks=_marks(mounts) if mounts else (),
        regions=MapRegions(index, columns["facet"][:255]),
    )


def _arrows(columns: Columns, outlines: list[FloatArray]) -> tuple[FloatArray, float]:
    """Return foot and tip of an arrow for each facet that has a canting, and the canting that the longest may show."""
    rise = np.stack([_numbers(columns, "rise_x_rad"), _numbers(columns, "rise_y_rad")], axis=1)
    feet = np.stack([_numbers(columns, "x_m"), _numbers(columns, "y_m")], axis=1)
    longest = nice_ceiling(max(_MRAD * float(np.nanmax(np.hypot(*rise.T), initial=0.0)), 1e-6))
    size = float(np.median([np.ptp(one, axis=0).min() for one in outlines]))
    known = np.isfinite(rise).all(axis=1)
    steps = _ARROW_SHARE * size * _MRAD / longest * rise
    return np.stack([feet, feet + steps], axis=1)[known], longest


def _marks(mounts: Columns) -> list[MapMark]:
    moves, sigmas = _numbers(mounts, "move_mm"), _numbers(mounts, "sigma_move_mm")
    places = zip(_numbers(mounts, "ensemble_x_m").tolist(), _numbers(mounts, "ensemble_y_m").tolist(), strict=True)
    found = []
    for place, facet, number, move, sigma in zip(places, mounts["facet"], mounts["mount"], moves, sigmas, strict=True):
        known = bool(np.isfinite(move))
        text = f"{move:+z.2f}".replace("-", "\u2212") if known else ""
        said = _signed(float(move), float(sigma), "mm") if known else "no move: too little of it is measured"
        found.append(MapMark(place, text, f"{facet}, mount {number}: {said}"))
    return found


def _canting_table(columns: Columns) -> TableView:
    shown = [TableColumn("facet", columns["facet"])]
    for axis, key in zip("xy", _COMPONENTS, strict=True):
        values, sigmas = _numbers(columns, key), _numbers(columns, f"sigma_{key}")
        texts = [_signed(value, sigma, "rad") for value, sigma in zip(values.tolist(), sigmas.tolist(), strict=True)]
        shown.append(TableColumn(f"canting in {axis}", texts, values.tolist()))
    return TableView("Canting of each facet", tuple(shown))


def _mount_table(mounts: Columns) -> TableView:
    moves, sigmas = _numbers(mounts, "move_mm").tolist(), _numbers(mounts, "sigma_move_mm").tolist()
    places = [
        TableColumn(f"{axis} in the facet [m]", mounts[f"{axis}_m"], _numbers(mounts, f"{axis}_m").tolist())
        for axis in "xy"
    ]
    texts = [_signed(move, sigma, "mm") for move, sigma in zip(moves, sigmas, strict=True)]
    shown = [TableColumn("facet", mounts["facet"]), TableColumn("mount", mounts["mount"]), *places]
    return TableView("Moves of the mounts", (*shown, TableColumn("move", texts, moves)))


def _signed(value: float, sigma: float, unit: str) -> str:
    if not np.isfinite(value):
        return "\u2013"
    return ("+" if value > 0 else "") + number_text(value, sigma, unit)


def _numbers(columns: Columns, name: str) -> FloatArray:
    """Return a column of numbers; NaN where a cell is empty."""
    return np.array([float(cell) if cell else np.nan for cell in columns[name]])
