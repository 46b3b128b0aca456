"""Sections of the report of several modules; each is one cell of its notebook."""

import html
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from heliogauge.reporting import page
from heliogauge.reporting.html import FirstScreen, Html, beside, join
from heliogauge.reporting.look import FAINT, LINE_X, robust_limit
from heliogauge.reporting.notation import light_text, number_text, turn_text
from heliogauge.reporting.verdict import SMALLEST_HOLE_SHARE, verdict_of
from heliogauge.results.folder import Summary, read_summary, read_table_csv
from heliogauge.validate import FloatArray
from heliogauge.view.charts import ChartSeries, ChartView, Mark
from heliogauge.view.maps import MapLayer, MapView
from heliogauge.view.stills import side_by_side
from heliogauge.view.tables import TableColumn, TableView
from observer.files import OVERVIEW_LOOPS, OVERVIEW_MAPS, OVERVIEW_TABLE, OVERVIEW_TURNS, ModuleMap, read_maps
from observer.report.figures_modules import maps_sheet, module_angle
from observer.report.sections import numbers_table

_MRAD = 1e3
_TITLES = {
    "theta_ra": "theta_ra: mirror and absorber, what the sun meets",
    "theta_r": "theta_r without its mean: mirror alone",
}
#: Columns of the table of modules, and what they are called there.
_COLUMNS = (
    ("intercept_gain_panels_turned_ratio", "gain by turning panels", ""),
    ("panels_to_turn_count", "panels to turn", ""),
    ("intercept_ratio", "intercept factor", ""),
    ("rms_theta_ra_rad", "theta_ra RMS", "rad"),
    ("rms_theta_r_rad", "theta_r RMS", "rad"),
    ("absorber_mean_x_m", "absorber X_a", "m"),
    ("absorber_mean_z_offset_m", "Z_a - focal length", "m"),
    ("measured_share", "measured", ""),
    ("photos_count", "photos", ""),
)
#: What a number of the first screen means, where it first stands.
_MEANINGS = {
    "intercept_gain_panels_turned_ratio": "more light on the tube, as a share of what the mirror reflects",
    "intercept_ratio": "share of the reflected light that meets the tube",
    "rms_theta_ra_rad": "turn of the mirror's normal off the one that lights the absorber as it is",
    "rms_theta_r_rad": "turn of the mirror's normal off its design",
    "absorber_mean_x_m": "absorber beside the focal line, across",
    "absorber_mean_z_offset_m": "absorber above the focal line",
    "measured_share": "share of the mirror that was measured",
}
#: Colours of the field's map: gains of modules from these shares of the light on, the least one first.
_GAINS = (
    (1e-2, "gains 1 % and more", "#b3261e"),
    (1e-3, "gains 0.1 to 1 %", "#e08a1e"),
    (0.0, "gains less", "#e9cf63"),
)
_NOTHING = ("nothing sure to gain", "#3f7f4f")
#: Share of all gains that is printed as 100 %.
_ALL_GAINS = 0.995
#: Panels that the first screen names; modules from which on it shows the field.
_MOST_PANELS, _FIELD = 3, 4
#: Maps that can be looked into in a page, about 0.1 MB each.
_MOST_MAPS = 12
#: Numbers of each module that a chart shows beside those of the others: name and factor to the printed unit.
_CHARTS = (
    ("rms_theta_r_rad", "theta_r RMS [mrad]", _MRAD),
    ("rms_theta_ra_rad", "theta_ra RMS [mrad]", _MRAD),
    ("intercept_ratio", "intercept factor", 1.0),
    ("intercept_gain_panels_turned_ratio", "gain by turning panels", 1.0),
)


@dataclass(frozen=True, slots=True, eq=False)
class OverviewResults:
    """What a folder with the overview of modules holds."""

    summary: Summary
    table: dict[str, list[str]]
    maps: list[ModuleMap]
    folder: Path
    turns: dict[str, list[str]] | None = None

    def value(self, key: str, row: int) -> float | None:
        """Return a number of a module; None where there is none."""
        cell = self.table[key][row] if key in self.table else ""
        return float(cell) if cell else None

    def values(self, key: str, rows: list[int]) -> FloatArray:
        """Return a number of some modules; NaN where there is none."""
        found = [self.value(key, row) for row in rows]
        return np.array([np.nan if one is None else one for one in found], dtype=np.float64)

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
    turns_ = folder / OVERVIEW_TURNS
    return OverviewResults(
        read_summary(folder),
        table_,
        read_maps(folder / OVERVIEW_MAPS),
        folder,
        read_table_csv(turns_, ("result", "panel")) if turns_.is_file() else None,
    )


def head(results: OverviewResults) -> FirstScreen:
    """Return the first screen: verdict, the numbers of all modules, their maps."""
    summary, count, measured = results.summary, len(results.table["name"]), results.measured
    missing = [f"{count - len(measured)} of {count} modules not measured"] if len(measured) < count else []
    shares = results.values("measured_share", measured)
    holes = shares[np.isfinite(shares) & (1 - shares >= SMALLEST_HOLE_SHARE)]
    if holes.size:
        missing.append(
            f"{holes.size} modules not measured everywhere, {100 * (1 - float(holes.min())):.1f} % missing of the worst"
        )
    passed = [f"{len(measured)} modules measured"] if measured else []
    line = f"overview of {count} modules; heliogauge {summary.version}"
    return page.first_screen(
        summary.name,
        line,
        verdict_of(summary, missing, passed),
        [*_work(results), *_rows(results)],
        first_view(results),
    )


def _is_field(results: OverviewResults) -> bool:
    """Return whether modules are so many that one looks at the field first."""
    return results.turns is not None and len(results.measured) >= _FIELD


def _work(results: OverviewResults) -> list[tuple[str, str, str]]:
    """Say which panels gain by a turn, how far, and what all of them gain."""
    if results.turns is None:
        return []
    shown = results.measured
    key = "intercept_gain_panels_turned_ratio"
    gains, sigmas = results.values(key, shown), results.values(f"sigma_{key}", shown)
    known = np.isfinite(gains)
    count = len(results.turns["panel"])
    if not count or not known.any():
        return [("Panels that surely gain by a turn", "none", "in none of the modules")]
    # Of modules that were measured each for itself.
    sigma = float(np.sqrt(np.nansum(sigmas[known] ** 2))) / int(known.sum())
    turns, own = results.turns, len(set(results.turns["result"]))
    best = ", ".join(
        f"{turns['result'][k]} panel {turns['panel'][k]} by "
        f"{turn_text(float(turns['turn_rad'][k]), float(turns['sigma_turn_rad'][k]))}"
        for k in range(min(count, _MOST_PANELS))
    )
    more = f" and {count - _MOST_PANELS} more" if count > _MOST_PANELS else ""
    return [
        (
            f"Gain by turning {count} panels of {own} modules",
            light_text(float(gains[known].mean()), sigma),
            f"mean of all modules; most by {best}{more}: see Work list",
        )
    ]


def _number(columns: dict[str, list[str]], key: str, row: int, unit: str) -> str:
    return number_text(float(columns[key][row]), float(columns[f"sigma_{key}"][row]), unit, key)


def field(results: OverviewResults) -> ChartView | MapView | Html:
    """Return the map of the field where the first screen shows another picture, else the maps of the worst modules."""
    if results.turns is None:
        return Html("")
    return module_view(results, "theta_r") or Html("") if _is_field(results) else _field_chart(results)


def _field_chart(results: OverviewResults) -> ChartView:
    """Return modules where they are, coloured by what turning their panels gains.

    Without places modules stand in the order of the table, loop by loop.
    """
    rows = list(range(len(results.table["result"])))
    places = np.array([results.values(f"place_{axis}_m", rows) for axis in "xy"])
    is_placed = bool(np.isfinite(places[:, results.measured]).all()) and bool(results.measured)
    note = "Colours: what turning a module's panels gains. Its numbers are at the pointer, its page in the table below."
    if not is_placed:
        loop_of = results.table.get("loop", [""] * len(rows))
        names = list(dict.fromkeys(loop_of))
        if len(names) > 1:
            note += f" Loops from below: {', '.join(names[:12])}{' ...' if len(names) > 12 else ''}."
        places = np.array(
            [
                [float(loop_of[:row].count(loop_of[row])) + 1 for row in rows],
                [float(names.index(loop_of[row])) + 1 for row in rows],
            ]
        )
    key = "intercept_gain_panels_turned_ratio"
    gains, turned = results.values(key, rows), results.values("panels_to_turn_count", rows)
    kind = np.full(len(rows), -1)
    for number, (least, *_) in reversed(list(enumerate(_GAINS))):
        kind[(gains >= least) & (turned > 0)] = number
    kind[np.isfinite(gains) & ~(turned > 0)] = len(_GAINS)
    classes = [*((name, color) for _, name, color in _GAINS), _NOTHING, ("not measured", FAINT)]
    kind[kind < 0] = len(classes) - 1
    series = []
    for number, (name, color) in enumerate(classes):
        own = np.flatnonzero(kind == number)
        labels = [_module_words(results, row) for row in own.tolist()]
        names_ = [results.table["result"][row] for row in own.tolist()]
        if own.size:
            series.append(
                ChartSeries(name, places[0, own], places[1, own], color, Mark.POINTS, None, labels, False, 13.0, names_)
            )
    axes = ("across [m]", "along [m]") if is_placed else ("module in its loop", "loop")
    return ChartView("The field by what its panels gain", *axes, tuple(series), note, x_counts=not is_placed)


def _module_words(results: OverviewResults, row: int) -> str:
    key = "intercept_gain_panels_turned_ratio"
    name, gain, count = (
        results.table["result"][row],
        results.value(key, row),
        results.value("panels_to_turn_count", row),
    )
    if gain is None or count is None:
        return f"{name}: not measured"
    if not count:
        return f"{name}: no panel surely gains by a turn"
    said = number_text(gain, results.value(f"sigma_{key}", row), "", key)
    return f"{name}: turning {int(count)} panels gains {said}"


def work_list(results: OverviewResults) -> TableView | Html:
    """Return the panels to turn, the largest gain first, with the moves of their mounts and a link to the module."""
    turns = results.turns
    if turns is None:
        return Html("<p>No result says what turning its panels gains.</p>")
    rows = range(len(turns["panel"]))
    if not rows:
        return Html("<p>No panel surely gains by a turn: both its angle and its gain beyond three sigma.</p>")
    number = {key: [float(cell) for cell in turns[key]] for key in turns if key not in ("result", "loop")}
    share = np.cumsum(number["gain_ratio"]) / np.sum(number["gain_ratio"])
    places = [f"{x:.2f}, {y:.2f}" for x, y in zip(number["centre_x_m"], number["centre_y_m"], strict=True)]
    columns = [
        TableColumn("module", turns["result"], links=[_link(results, name) for name in turns["result"]]),
        TableColumn("panel", turns["panel"], number["panel"]),
        TableColumn("middle x, y [m]", places),
    ]
    for key, title, unit in (
        ("turn_rad", "turn its normal to +x by", "rad"),
        ("mount_move_m", "move its mount at larger x by", "m"),
    ):
        columns.append(TableColumn(title, [_number(turns, key, k, unit) for k in rows], number[key]))
    gains = [light_text(*one) for one in zip(number["gain_ratio"], number["sigma_gain_ratio"], strict=True)]
    columns.append(
        TableColumn(
            "gain [% of its light]", [one.removesuffix(" % of the light") for one in gains], number["gain_ratio"]
        )
    )
    columns.append(TableColumn("of all gains", [f"{100 * one:.0f} %" for one in share], share.tolist()))
    # The rest together gains less than is printed.
    most = 1 + int(np.argmax(share >= _ALL_GAINS))
    return TableView("panels to turn", tuple(columns), most_rows=min(most, TableView.most_rows))


def first_view(results: OverviewResults) -> MapView | ChartView:
    """Return the map of the field; of few modules their maps, and numbers where there are no maps on one grid."""
    if _is_field(results):
        return _field_chart(results)
    view = module_view(results, "theta_r")
    if view is not None:
        return view
    chart = _chart(results, *_CHARTS[0])
    return replace(chart, stills=[_still(results, "theta_r")]) if results.maps else chart


def module_view(results: OverviewResults, angle: str) -> MapView | None:
    """Return one angle of the modules with the largest errors as maps; None where there are none on one grid.

    angle: "theta_ra", or "theta_r", which is shown without each module's mean.
    """
    maps_ = [module_angle(one, angle) for one in results.maps]
    first = maps_[0] if maps_ else None
    if first is None or any(
        one.x_m.shape != first.x_m.shape
        or one.y_m.shape != first.y_m.shape
        or not np.allclose(one.x_m, first.x_m)
        or not np.allclose(one.y_m, first.y_m)
        for one in maps_
    ):
        return None
    shown = sorted(maps_, key=lambda one: -_mean(one.angle_rad**2))[:_MOST_MAPS]
    limit = robust_limit(*(_MRAD * one.angle_rad for one in maps_))
    words = " without its mean" if angle == "theta_r" else ""
    layers = tuple(
        MapLayer(one.name, f"{one.name}: {angle}{words}", "mrad", one.angle_rad, _MRAD, limit=limit)
        for one in maps_
        if one in shown
    )
    note = "" if angle == "theta_ra" else "Positive where the mirror's normal is turned towards +x. Grey: not measured."
    if len(shown) < len(maps_):
        note = f"{note} The {len(shown)} modules with the largest errors.".strip()
    flags = np.zeros(first.angle_rad.shape, np.uint32)
    still = [_still(results, angle)]
    return MapView(_TITLES[angle], first.x_m, first.y_m, layers, flags, first.aperture, note=note, stills=still)


def _still(results: OverviewResults, angle: str) -> Html:
    """Draw one angle of all modules beside each other."""
    maps_ = [module_angle(one, angle) for one in results.maps]
    return maps_sheet(maps_, _TITLES[angle], wide=angle == "theta_ra").html(_TITLES[angle])


def _mean(values: FloatArray) -> float:
    return float(np.nanmean(values)) if np.isfinite(values).any() else 0.0


def _rows(results: OverviewResults) -> list[tuple[str, str, str]]:
    """Return median and range over the modules of the headline numbers."""
    rows = []
    for key, title, unit in _COLUMNS:
        found = results.values(key, results.measured)
        found = found[np.isfinite(found)]
        if found.size and not key.endswith("_count"):
            texts = [number_text(float(one), None, unit, key) for one in (np.median(found), found.min(), found.max())]
            meaning = f"; {_MEANINGS[key]}" if key in _MEANINGS else ""
            rows.append((title, texts[0], f"median of the modules; {texts[1]} to {texts[2]}{meaning}"))
    return rows


def doubts(results: OverviewResults) -> Html:
    """Return all doubts with all their words."""
    return page.doubts_box(results)


def modules(results: OverviewResults) -> TableView:
    """Return the table of the modules, largest gain first, each with a link to its report; why some have none."""
    gains = results.values("intercept_gain_panels_turned_ratio", list(range(len(results.table["result"]))))
    rows = np.argsort(-np.nan_to_num(gains, nan=-np.inf), kind="stable").tolist()
    names = [results.table["result"][row] for row in rows]
    columns = [TableColumn("module", names, links=[_link(results, name) for name in names])]
    for key, title, unit in _COLUMNS:
        found = [results.value(key, row) for row in rows]
        texts = [
            "" if value is None else number_text(value, results.value(f"sigma_{key}", row), unit, key)
            for row, value in zip(rows, found, strict=True)
        ]
        columns.append(TableColumn(title, texts, [np.nan if value is None else value for value in found]))
    failed = results.table.get("failed", [""] * len(names))
    reasons = [failed[row] for row in rows]
    if any(reasons):
        columns.append(TableColumn("not measured, because", reasons))
    return TableView("modules", tuple(columns), [f"module-{name}" for name in names])


def loops(results: OverviewResults) -> Html:
    """Return the numbers of each loop and of all modules; nothing where no loops are named."""
    path = results.folder / OVERVIEW_LOOPS
    if not path.is_file():
        return Html("")
    columns = read_table_csv(path, ("loop", "modules_count"))
    shown = [TableColumn(one, columns[one.replace("modules", "modules_count")]) for one in ("loop", "modules")]
    for key, title, unit in (
        ("rms_theta_r_rad", "theta_r RMS", "rad"),
        ("rms_theta_ra_rad", "theta_ra RMS", "rad"),
        ("intercept_ratio", "intercept factor", ""),
        ("lowest_intercept_ratio", "lowest", ""),
        ("intercept_gain_panels_turned_ratio", "gain by turning panels", ""),
    ):
        values = [float(cell) if cell else np.nan for cell in columns[key]]
        texts = [number_text(one, None, unit, key) if np.isfinite(one) else "-" for one in values]
        shown.append(TableColumn(title, texts, values))
    shown.append(TableColumn("panels to turn", columns["panels_to_turn_count"]))
    return join(
        Html("<h2>Loops</h2><p>RMS of the angles over the modules, means of the others.</p>"),
        TableView("loops", tuple(shown)),
    )


def _link(results: OverviewResults, name: str) -> str:
    # Modules of one flight lie below the overview; results from elsewhere may have moved.
    is_below = not Path(name).is_absolute() and (results.folder / name / "summary.json").is_file()
    return f"{name}/report.html" if is_below else ""


def numbers(results: OverviewResults) -> Html:
    """Return charts of the numbers, so that the odd one out is seen."""
    views = [_chart(results, *one) for one in _CHARTS if np.isfinite(results.values(one[0], results.measured)).any()]
    return beside(*views) if views else Html("")


def _chart(results: OverviewResults, key: str, title: str, factor: float) -> ChartView:
    rows = results.measured
    place = np.arange(1.0, len(rows) + 1)
    values, sigmas = (factor * results.values(name, rows) for name in (key, f"sigma_{key}"))
    names = [results.table["result"][row] for row in rows]
    series = ChartSeries("modules", place, values, LINE_X, Mark.POINTS, np.nan_to_num(sigmas), names, size_px=6.0)
    note = f"in the order of the table: {', '.join(names[:8])}{' ...' if len(names) > 8 else ''}; error bars: 1 sigma"
    return ChartView(title.partition(" [")[0], "module", title, (series,), note, x_counts=True)


def maps(results: OverviewResults) -> Html:
    """Return the maps of all modules with one scale of colours."""
    if not results.maps:
        return Html("<p>No maps were stored.</p>")
    note = (
        "Each module in its own frame: x across the aperture, y along the trough. Positive where the mirror's normal "
        "is turned towards +x. Hatched: not measured; the module's own report says why."
    )
    caption = Html(f'<p class="caption">{html.escape(note)}</p>')
    return join(module_view(results, "theta_ra") or side_by_side([_still(results, "theta_ra")]), caption)


def making(results: OverviewResults) -> Html:
    """Return all numbers, and how long each stage took."""
    return join(
        numbers_table(results.summary), *([page.duration_table(results)] if results.summary.durations_s else [])
    )


def inputs(results: OverviewResults) -> Html:
    """Return the files that were read."""
    return page.input_table(results)
