"""Report of a store: what is in it, trends, the worst, before and after events."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.survey.report.charts import history_charts, named, said
from calibration.survey.worse import headlines
from heliogauge.reporting import page
from heliogauge.reporting.html import Html, Shown, join
from heliogauge.reporting.verdict import verdict_of
from heliogauge.results.folder import Summary, read_summary, read_table_csv
from heliogauge.view.tables import TableColumn, TableView

_MOST_ROWS = 500
#: Subjects of each quantity, and quantities on the first screen.
_WORST, _HEADLINES = 10, 6


@dataclass(frozen=True, slots=True, eq=False)
class SurveyReport:
    """What a folder of results holds: summary, and tables by name."""

    summary: Summary
    tables: dict[str, dict[str, list[str]]]


def open_survey(folder: str | Path = ".") -> SurveyReport:
    """Read a folder of results.

    folder: The folder; the working directory without it.
    """
    folder = Path(folder)
    names = ("overview", "trends", "worst", "events", "history")
    return SurveyReport(read_summary(folder), {name: read_table_csv(folder / f"{name}.csv") for name in names})


def first_screen(report: SurveyReport) -> Html:
    """Return name, verdict, how much there is, and the history of the worst subject."""
    numbers, worst = report.summary.numbers, report.tables["worst"]
    rows: list[tuple[str, ...]] = [
        ("Subjects", f"{numbers['subjects_count']}"),
        ("Results", f"{numbers['results_count']}", f"{numbers['rows_count']} rows"),
        ("Trends that are no chance", f"{numbers['trends_significant_count']} of {numbers['trends_count']}"),
    ]
    for quantity in headlines(list(dict.fromkeys(worst["quantity"])), _HEADLINES):
        row = worst["quantity"].index(quantity)
        subject = f"{worst['subject'][row]} {worst['part'][row]}".strip()
        rows.append((named(quantity), said(quantity, worst["mean"][row], worst["sigma_mean"][row]), subject))
    charts = history_charts(report.tables["history"])
    line = f"many results of one plant; heliogauge {report.summary.version}"
    return page.first_screen(report.summary.name, line, verdict_of(report.summary), rows, charts[0] if charts else None)


def worst_tables(report: SurveyReport) -> Shown:
    """Return the worst subjects of each quantity; the largest values where worse has no meaning."""
    table = report.tables["worst"]
    pieces: list[Shown] = []
    for quantity in dict.fromkeys(table["quantity"]):
        rows = [row for row, one in enumerate(table["quantity"]) if one == quantity][:_WORST]
        pieces.append(Html(f"<h3>{named(quantity)}</h3>"))
        cells = [
            (
                f"{table['subject'][row]} {table['part'][row]}".strip(),
                said(quantity, table["mean"][row], table["sigma_mean"][row]),
                table["results_count"][row],
                table["last"][row][:10],
            )
            for row in rows
        ]
        pieces.append(page.table(("", "mean \u00b1 1 sigma", "results", "last"), cells, numbers=(1, 2)))
    return join(*pieces) if pieces else Html("<p>No results with an uncertainty.</p>")


def trend_table(report: SurveyReport) -> Shown:
    """Return the trends, the least likely ones to be chance first."""
    table = report.tables["trends"]
    likely = np.array([float(one) for one in table["chance_of_none"]])
    order = [int(row) for row in np.argsort(likely, kind="stable")[:_MOST_ROWS] if table["slope_per_year"][row]]
    if not order:
        return Html("<p>No subject has three results on different dates.</p>")
    columns = (
        TableColumn("quantity", [table["quantity"][row] for row in order]),
        TableColumn("subject", [f"{table['subject'][row]} {table['part'][row]}".strip() for row in order]),
        TableColumn(
            "change in a year",
            [
                said(table["quantity"][row], table["slope_per_year"][row], table["sigma_slope_per_year"][row])
                for row in order
            ],
            [float(table["slope_per_year"][row]) for row in order],
        ),
        TableColumn("chance of none", [f"{likely[row]:.2g}" for row in order], [float(likely[row]) for row in order]),
        TableColumn(
            "results",
            [table["results_count"][row] for row in order],
            [float(table["results_count"][row]) for row in order],
        ),
    )
    return TableView("Trends", columns)


def event_table(report: SurveyReport) -> Shown:
    """Return what events did."""
    table = report.tables["events"]
    if not table["date"]:
        return Html("<p>No cleaning or repair is noted: <code>heliogauge survey event</code> notes one.</p>")
    likely = np.array([float(one) for one in table["chance_of_none"]])
    order = [int(row) for row in np.argsort(likely, kind="stable")[:_MOST_ROWS]]

    def cells(value: str, sigma: str) -> list[str]:
        return [said(table["quantity"][row], table[value][row], table[sigma][row]) for row in order]

    columns = (
        TableColumn("date", [table["date"][row] for row in order]),
        TableColumn("what", [table["what"][row] for row in order]),
        TableColumn("subject", [f"{table['subject'][row]} {table['part'][row]}".strip() for row in order]),
        TableColumn("quantity", [table["quantity"][row] for row in order]),
        TableColumn("before", cells("before", "sigma_before")),
        TableColumn("after", cells("after", "sigma_after")),
        TableColumn("change", cells("change", "sigma_change"), [float(table["change"][row]) for row in order]),
        TableColumn("chance of none", [f"{likely[row]:.2g}" for row in order], [float(likely[row]) for row in order]),
    )
    return TableView("Before and after", columns)


def further_charts(report: SurveyReport) -> Shown:
    """Return the histories that the first screen does not show."""
    return join(*history_charts(report.tables["history"])[1:])


def overview_table(report: SurveyReport) -> Html:
    """Return what is in the store."""
    table = report.tables["overview"]
    rows = list(
        zip(
            table["quantity"],
            table["subjects_count"],
            table["rows_count"],
            table["with_sigma_count"],
            [t[:10] for t in table["first"]],
            [t[:10] for t in table["last"]],
            strict=True,
        )
    )
    return page.table(("quantity", "subjects", "rows", "with sigma", "first", "last"), rows, numbers=(1, 2, 3))
