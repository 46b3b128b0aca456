"""Sections of the report on a field at two dates; each is a cell of its notebook."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from heliogauge.reporting import page
from heliogauge.reporting.html import FirstScreen, Html, join
from heliogauge.reporting.notation import number_text
from heliogauge.reporting.verdict import verdict_of
from heliogauge.results.folder import Summary, read_summary, read_table_csv, unit_of
from heliogauge.view.charts import ChartSeries, ChartView, Mark
from heliogauge.view.tables import TableColumn, TableView
from observer.files import CHANGED_MODULES, CHANGED_NUMBERS, CHANGED_PANELS
from observer.report.results import Columns, numbers

_TURNED, _STEADY = "#b3261e", "#3f7f4f"


@dataclass(frozen=True, slots=True, eq=False)
class FieldChanges:
    """What a folder with a field at two dates holds."""

    summary: Summary
    modules: Columns
    numbers: Columns
    panels: Columns


def open_comparison(folder: str | Path = ".") -> FieldChanges:
    """Read a folder with a field at two dates.

    folder: The folder; the working directory without it.
    """
    folder = Path(folder)
    return FieldChanges(
        read_summary(folder),
        read_table_csv(folder / CHANGED_MODULES, ("module", "panels_turned_count")),
        read_table_csv(folder / CHANGED_NUMBERS, ("of", "key", "before", "after", "change", "sigma_change", "is_sure")),
        read_table_csv(folder / CHANGED_PANELS, ("of", "panel", "is_sure")),
    )


def head(results: FieldChanges) -> FirstScreen:
    """Return the first screen: verdict, how many panels turned, the field."""
    found = results.summary.numbers
    turned, own = found["panels_turned_count"], found["modules_with_turned_panels_count"]
    rows = [
        (
            "Panels that surely turned",
            f"{turned} of {found['panels_compared_count']}",
            f"in {own} of {found['modules_count']} modules" if turned else "",
        )
    ]
    key = "intercept_change_mean_ratio"
    change = found.get(key)
    if change is not None:
        text = number_text(change, found.get(f"sigma_{key}"), "", key)
        rows.append(
            ("Intercept factor changed by", text, "mean of the modules; share of the light that meets the tube")
        )
    texts = results.summary.texts
    line = f"{texts['other']} against {texts['first']}; heliogauge {results.summary.version}"
    return page.first_screen(results.summary.name, line, verdict_of(results.summary), rows, field_chart(results))


def field_chart(results: FieldChanges) -> ChartView:
    """Return modules where they are, those with turned panels in another colour.

    Without places modules stand in the order of the table.
    """
    modules = results.modules
    names = modules["module"]
    counts = numbers(modules, "panels_turned_count")
    is_placed = {"place_x_m", "place_y_m"} <= set(modules) and all([*modules["place_x_m"], *modules["place_y_m"]])
    if is_placed:
        x, y = numbers(modules, "place_x_m"), numbers(modules, "place_y_m")
    else:
        x, y = np.arange(1.0, len(names) + 1), counts
    classes = (("panels turned", _TURNED, counts > 0), ("none surely turned", _STEADY, counts == 0))
    series = []
    for name, color, chosen in classes:
        own = np.flatnonzero(chosen).tolist()
        if own:
            labels = [f"{names[k]}: {int(counts[k])} panels turned" for k in own]
            shown = [names[k] for k in own]
            series.append(ChartSeries(name, x[own], y[own], color, Mark.POINTS, None, labels, False, 13.0, shown))
    axes = ("across [m]", "along [m]") if is_placed else ("module in the order of the table", "panels turned")
    note = "Modules by whether any of their panels surely turned; which ones is in the table below."
    return ChartView("What turned between the two dates", *axes, tuple(series), note, x_counts=not is_placed)


def turned(results: FieldChanges) -> TableView | Html:
    """Return the panels that surely turned, the largest turn first."""
    columns = results.panels
    rows = [k for k, one in enumerate(columns["is_sure"]) if one == "1"]
    if not rows:
        return Html("<p>No panel surely turned.</p>")
    size = np.abs(numbers(columns, "theta_ra_change_rad"))
    rows.sort(key=lambda k: -size[k])
    shown = [
        TableColumn("module", [columns["of"][k] for k in rows]),
        TableColumn("panel", [columns["panel"][k] for k in rows], [float(columns["panel"][k]) for k in rows]),
    ]
    for key, title in (("theta_r_change_rad", "theta_r changed"), ("theta_ra_change_rad", "theta_ra changed")):
        values, sigmas = numbers(columns, key)[rows], numbers(columns, f"sigma_{key}")[rows]
        texts = [number_text(*one, "rad") for one in zip(values.tolist(), sigmas.tolist(), strict=True)]
        shown.append(TableColumn(title, texts, values.tolist()))
    note = (
        "Later date minus the earlier one, of the mean over what both measured. The two measurements are taken to err "
        "apart. Surely: chance makes the largest change of all panels of the field so large once in a hundred times."
    )
    return join(TableView("panels that turned", tuple(shown)), Html(f'<p class="caption">{note}</p>'))


def changes(results: FieldChanges) -> TableView:
    """Return the changes of each module's numbers, those that are sure first."""
    columns = results.numbers
    sure = [one == "1" for one in columns["is_sure"]]
    rows = sorted(range(len(sure)), key=lambda k: not sure[k])
    cells: dict[str, list[str]] = {name: [] for name in ("module", "number", "first", "then", "change \u00b1 1 sigma")}
    for k in rows:
        key = columns["key"][k]
        name, unit = unit_of(key)
        before, after, change, sigma = (float(columns[one][k]) for one in ("before", "after", "change", "sigma_change"))
        texts = [number_text(one, None, unit, key) for one in (before, after)]
        own = (columns["of"][k], name.removesuffix("_ratio").replace("_", " "), *texts)
        for title, text in zip(cells, (*own, number_text(change, sigma, unit, key)), strict=True):
            cells[title].append(text)
    shown = [TableColumn(title, texts) for title, texts in cells.items()]
    shown.append(TableColumn("surely changed", ["yes" if sure[k] else "" for k in rows]))
    return TableView("numbers of the modules", tuple(shown))


def doubts(results: FieldChanges) -> Html:
    """Return all doubts with all their words."""
    return page.doubts_box(results)


def inputs(results: FieldChanges) -> Html:
    """Return the input files."""
    return page.input_table(results)
