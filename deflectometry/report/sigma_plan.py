"""A plan of a measurement without a slope map for the report: its sigmas, and what would better them."""

from pathlib import Path

from deflectometry.planning.pipeline.sigma_plan import PROMISES_FILE, sigma_text
from deflectometry.report.plan import alternative_tables
from heliogauge.reporting import page
from heliogauge.reporting.html import FirstScreen, Html, Shown, table_under_name
from heliogauge.reporting.verdict import verdict_of
from heliogauge.results.folder import SUMMARY_FILE, read_summary, read_table_csv
from heliogauge.view.tables import TableColumn, TableView

_SIGMA = "sigma_"


def first(folder: Path, picture: Shown | None) -> FirstScreen:
    """Return what the measurement will be worth."""
    summary = read_summary(folder / SUMMARY_FILE)
    rows = [(f"{words}{': sigma' if is_sigma else ''}", text, "") for words, text, is_sigma in _promises(folder)]
    line = f"{summary.kind}; heliogauge {summary.version}"
    return page.first_screen(summary.name, line, verdict_of(summary), rows, picture)


def words(folder: Path) -> Html:
    """Return what is said beside the numbers."""
    texts = read_summary(folder / SUMMARY_FILE).texts
    return table_under_name(
        TableView("In words", (TableColumn("about", list(texts)), TableColumn("what", list(texts.values()))))
    )


def alternatives(folder: Path) -> Html:
    """Return by how much each alternative betters each sigma, and those that are not possible."""
    table = read_table_csv(folder / PROMISES_FILE, ("name", "what"))
    labels = dict(zip(table["name"], table["what"], strict=True))
    sigmas = {name.removeprefix(_SIGMA): one for name, one in labels.items() if name.startswith(_SIGMA)}
    shares = {name: one for name, one in labels.items() if not name.startswith(_SIGMA)}
    return alternative_tables(folder, sigmas, shares)


def _promises(folder: Path) -> list[tuple[str, str, bool]]:
    """Return words and value of what is promised, and whether it is a sigma."""
    table = read_table_csv(folder / PROMISES_FILE, ("name", "what", "value"))
    return [
        (words, sigma_text(name, float(value or "nan")), name.startswith(_SIGMA))
        for name, words, value in zip(table["name"], table["what"], table["value"], strict=True)
    ]
