"""Pages of one result, of a slope map, and of a folder of results."""

import html
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

from heliogauge.doubts import Severity
from heliogauge.errors import InputError
from heliogauge.reporting.build import REPORT_HTML, run_report
from heliogauge.reporting.html import Html, Shown, in_page
from heliogauge.reporting.notation import number_text
from heliogauge.reporting.notebook import ShownCell
from heliogauge.reporting.page import LABELS, flag_table, name_and_line, statistics_table
from heliogauge.reporting.page_frame import page_frame
from heliogauge.results.folder import Summary, facet_names, read_slope_map, read_summary, unit_of
from heliogauge.results.opened import SLOPE_MAP_FILE
from heliogauge.view.arrays import PAGE, ServedStore
from heliogauge.view.maps import slope_map_view
from heliogauge.view.server.opened import folders_of_results
from heliogauge.view.tables import TableColumn, TableView

#: A link to another page: its words and where it leads.
Link = tuple[str, str]
# Columns for numbers where all results are of one kind; numbers in one cell where they are not.
_MOST_NUMBERS, _FIRST_NUMBERS = 5, 2
# Pairs of more results than these are compared by their addresses.
_MOST_CHOICES = 2000
_SEVERITIES = tuple(Severity)


def result_page(folder: Path, up: Sequence[Link], address: str, store: ServedStore) -> str:
    """Return the report of a folder at full resolution, with links to results within it.

    up: Where the reader came from.
    address: Of this page, as addresses of differences begin.
    InputError: Results of a kind without a report, or a file is missing or damaged.
    """
    summary, notebook = run_report(folder, store)
    cells = list(notebook.shown)
    linked = "".join(cell.html for cell in cells)
    parts = list(folders_of_results(folder))
    more = [one for one in parts if f'href="{quote(_address(one, folder))}' not in linked]
    if more:
        table = _table("Results within this one", _rows(more, folder))
        cells.append(ShownCell("<h2>Results within this one</h2>" + in_page(table, store), printed=True))
    cells += [ShownCell(one.text, printed=False) for one in _choices(parts, folder, address)]
    return page_frame(f"{summary.name} - {summary.kind}", cells, up=up, served=True)


def pieces_page(title: str, pieces: Sequence[Shown], store: ServedStore, up: Sequence[Link] = ()) -> str:
    """Return a page of pieces, one below the other."""
    return page_frame(title, [ShownCell(in_page(one, store), printed=True) for one in pieces], up=up, served=True)


def map_page(file: Path, store: ServedStore) -> str:
    """Return the page of a slope map that stands alone.

    InputError: The file is damaged, or no slope map.
    """
    whole = read_slope_map(file)
    line = f"design: {whole.design}; frame: {whole.frame}; removed: {whole.removed}"
    view = slope_map_view(whole, file.stem)
    pieces: list[Shown] = [name_and_line(file.name, line), view]
    # Too few nodes determine no statistics.
    pieces += [Html("<h2>Numbers</h2>"), statistics_table(whole, view.removals)] if view.removals else []
    pieces += [Html("<h2>Missing nodes</h2>"), flag_table(whole)]
    for name in facet_names(file):
        pieces += [Html(f"<h2>{html.escape(name)}</h2>"), slope_map_view(read_slope_map(file, name), name)]
    return pieces_page(file.name, pieces, store)


def folder_page(folder: Path, up: Sequence[Link], address: str) -> str:
    """Return the table of all results below a folder.

    up: Where the reader came from.
    address: Of this page, as addresses of differences begin.
    InputError: There are none.
    """
    places = list(folders_of_results(folder))
    if not places:
        raise InputError(f"{folder}: there are no results in it")
    rows = _rows(places, folder)
    count = f"{len(places)} result" + ("" if len(places) == 1 else "s")
    pieces: list[Shown] = [name_and_line(folder.name, count), _table(f"Results in {folder.name}", rows)]
    cells = [ShownCell(in_page(one, PAGE), printed=True) for one in pieces]
    cells += [ShownCell(one.text, printed=False) for one in _choices(places, folder, address)]
    return page_frame(folder.name, cells, up=up, served=True)


def _address(place: Path, folder: Path) -> str:
    return f"{place.relative_to(folder).as_posix()}/{REPORT_HTML}"


def _rows(places: Sequence[Path], folder: Path) -> list[tuple[str, Summary | str]]:
    """Return the address of each result with its summary, or with the reason why it cannot be read."""
    rows: list[tuple[str, Summary | str]] = []
    for place in places:
        try:
            rows.append((_address(place, folder), read_summary(place)))
        except InputError as error:
            rows.append((_address(place, folder), str(error)))
    return rows


def _table(name: str, rows: Sequence[tuple[str, Summary | str]]) -> TableView:
    summaries = [one for _, one in rows if isinstance(one, Summary)]
    columns = [
        TableColumn(
            "name",
            [one.name if isinstance(one, Summary) else "cannot be read" for _, one in rows],
            links=[quote(address) for address, _ in rows],
        ),
        TableColumn("folder", [address.removesuffix(f"/{REPORT_HTML}") for address, _ in rows]),
        TableColumn("kind", [one.kind if isinstance(one, Summary) else "" for _, one in rows]),
    ]
    texts, weights = zip(*(_doubts_of(one) for _, one in rows), strict=True)
    columns.append(TableColumn("doubts", texts, numbers=weights))
    share = "measured_share"
    if any(share in one.numbers for one in summaries):
        columns.append(_number_column(share, rows))
    kinds = {one.kind for one in summaries}
    if len(kinds) == 1:
        first = [key for key in summaries[0].numbers if not key.startswith("sigma_") and key != share]
        columns += [_number_column(key, rows) for key in first[:_MOST_NUMBERS]]
    else:
        columns.append(TableColumn("first numbers", [_first_numbers(one) for _, one in rows]))
    return TableView(name, tuple(columns))


def _first_numbers(one: Summary | str) -> str:
    """Return the first numbers of a result in words."""
    if isinstance(one, str):
        return ""
    shown = [key for key, value in one.numbers.items() if value is not None and not key.startswith("sigma_")]
    return "; ".join(f"{label_of(key)} {_text(one, key)}" for key in shown[:_FIRST_NUMBERS])


def label_of(key: str) -> str:
    """Return what a number is called above a column."""
    name, _ = _name_and_unit(key)
    return LABELS.get(name, name.replace("_", " ")).partition(",")[0]


def _text(one: Summary, key: str) -> str:
    name, unit = _name_and_unit(key)
    value = one.numbers.get(key)
    return "" if value is None else number_text(value, one.numbers.get(f"sigma_{key}"), unit, name)


def _name_and_unit(key: str) -> tuple[str, str]:
    try:
        return unit_of(key)
    except InputError:
        # Written by a later version; its own page says more.
        return key, ""


def _number_column(key: str, rows: Sequence[tuple[str, Summary | str]]) -> TableColumn:
    texts = [_text(one, key) if isinstance(one, Summary) else "" for _, one in rows]
    values = [one.numbers.get(key) if isinstance(one, Summary) else None for _, one in rows]
    return TableColumn(label_of(key), texts, numbers=[float("nan") if one is None else float(one) for one in values])


def _doubts_of(one: Summary | str) -> tuple[str, float]:
    """Return the doubts of a result in words, and how much they weigh."""
    if isinstance(one, str):
        return one, 1e9
    counts = Counter(doubt.severity for doubt in one.doubts)
    words = [f"{counts[severity]} {severity}" for severity in reversed(_SEVERITIES) if counts[severity]]
    weight = sum(counts[severity] * 1000.0**rank for rank, severity in enumerate(_SEVERITIES))
    return ", ".join(words) or "none", weight


def _choices(places: Sequence[Path], folder: Path, address: str) -> list[Html]:
    """Return the form in which two results with slope maps are chosen to be compared; nothing where there are none."""
    maps = [place.relative_to(folder).as_posix() for place in places if (place / SLOPE_MAP_FILE).is_file()]
    if not 2 <= len(maps) <= _MOST_CHOICES:
        return []

    def options(chosen: int) -> str:
        return "".join(
            f'<option value="{html.escape(address + name, quote=True)}/"{" selected" if place == chosen else ""}>'
            f"{html.escape(name)}</option>"
            for place, name in enumerate(maps)
        )

    # From the folder of this page to the first one.
    upwards = "../" * address.count("/")
    form = Html(
        f'<h2>Difference of two</h2><form action="{upwards}difference" method="get">'
        f'<label>before <select name="first" aria-label="before">{options(0)}</select></label> '
        f'<label>after <select name="second" aria-label="after">{options(1)}</select></label> '
        "<button>Show the difference</button></form>"
    )
    return [form]
