"""Sections of the report of several modules; each is one cell of its notebook."""

import html
from dataclasses import dataclass
from pathlib import Path

from heliogauge.reporting import page
from heliogauge.reporting.html import Html, join, show, table
from heliogauge.reporting.notation import number_text
from heliogauge.results.folder import Summary, read_summary, read_table_csv
from observer.files import OVERVIEW_MAPS, OVERVIEW_TABLE, ModuleMap, read_maps
from observer.report.figures_modules import NumbersPanel, modules_figure, numbers_figure

_MRAD = 1e3
#: Columns of the table of modules, and what they are called there.
_COLUMNS = (
    ("rms_theta_r_rad", "theta_r RMS", "rad"),
    ("rms_theta_ra_rad", "theta_ra RMS", "rad"),
    ("absorber_mean_x_m", "absorber X_a", "m"),
    ("absorber_mean_z_offset_m", "Z_a - focal length", "m"),
    ("intercept_ratio", "intercept factor", ""),
    ("measured_share", "measured", ""),
    ("photos_count", "photos", ""),
)


@dataclass(frozen=True, slots=True, eq=False)
class OverviewResults:
    """What a folder with the overview of modules holds."""

    summary: Summary
    table: dict[str, list[str]]
    maps: list[ModuleMap]
    folder: Path

    def value(self, key: str, row: int) -> float | None:
        """Return a number of a module; None where there is none."""
        cell = self.table[key][row] if key in self.table else ""
        return float(cell) if cell else None

    @property
    def measured(self) -> list[int]:
        """Rows of the modules that were measured."""
        reasons = self.table.get("failed", [""] * len(self.table["name"]))
        return [row for row, reason in enumerate(reasons) if not reason]


def open_overview(folder: str | Path = ".") -> OverviewResults:
    """Read a folder with the overview of modules.

    folder: The folder; the working directory without it.
    """
    folder = Path(folder)
    table_ = read_table_csv(folder / OVERVIEW_TABLE, ("result", "name"))
    return OverviewResults(read_summary(folder), table_, read_maps(folder / OVERVIEW_MAPS), folder)


def head(results: OverviewResults) -> Html:
    """Return title and warnings."""
    return page.head(results, f"overview of {len(results.table['name'])} modules")


def modules(results: OverviewResults) -> Html:
    """Return the table of the modules, each with a link to its own report."""
    rows = []
    for row, name in enumerate(results.table["result"]):
        cells = []
        for key, _, unit in _COLUMNS:
            value, sigma = results.value(key, row), results.value(f"sigma_{key}", row)
            cells.append("" if value is None else number_text(value, sigma, unit, key))
        rows.append((name, *cells))
    text = table(("module", *(title for _, title, _ in _COLUMNS)), rows, numbers=range(1, len(_COLUMNS) + 1)).text
    for name in results.table["result"]:
        # Modules of one flight lie below the overview; results from elsewhere may have moved.
        if (results.folder / name / "summary.json").is_file() and not Path(name).is_absolute():
            cell = f"<td>{html.escape(name)}</td>"
            link = f'<td><a href="{html.escape(name, quote=True)}/report.html">{html.escape(name)}</a></td>'
            text = text.replace(cell, link, 1)
    return join(Html(text), _not_measured(results))


def _not_measured(results: OverviewResults) -> Html:
    reasons = results.table.get("failed", [])
    rows = [(name, reason) for name, reason in zip(results.table["name"], reasons, strict=False) if reason]
    return table(("not measured", "why"), rows) if rows else Html("")


def numbers(results: OverviewResults) -> Html:
    """Return figures of the numbers."""
    rows = results.measured
    names = [results.table["result"][row] for row in rows]
    panels = []
    for key, title, factor in (
        ("rms_theta_r_rad", "theta_r RMS [mrad]", _MRAD),
        ("rms_theta_ra_rad", "theta_ra RMS [mrad]", _MRAD),
        ("intercept_ratio", "intercept factor", 1.0),
    ):
        pairs = [(results.value(key, row), results.value(f"sigma_{key}", row)) for row in rows]
        scaled = [[None if value is None else factor * value for value in pair] for pair in pairs]
        if any(value is not None for value, _ in scaled):
            panels.append(NumbersPanel(title, *zip(*scaled, strict=True)))
    return show(numbers_figure(names, panels)) if panels else Html("")


def maps(results: OverviewResults) -> Html:
    """Return the maps of all modules with one scale of colours."""
    if not results.maps:
        return Html("<p>No maps were stored.</p>")
    note = (
        "Each module in its own frame: x across the aperture, y along the trough, seen from the front. Positive where "
        "the mirror's normal is turned towards +x. Grey and hatched: not measured; the module's own report says why."
    )
    return show(modules_figure(results.maps, "theta_ra"), modules_figure(results.maps, "theta_r"), caption=note)


def making(results: OverviewResults) -> Html:
    """Return times and input files."""
    pieces = [page.input_table(results)]
    if results.summary.durations_s:
        pieces.insert(0, page.duration_table(results))
    return join(*pieces)
