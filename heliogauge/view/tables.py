"""Tables that sort, filter and link; without script they are tables."""

import html
import math
from collections.abc import Sequence
from dataclasses import dataclass

from heliogauge.errors import InputError
from heliogauge.view.arrays import PAGE, ArrayStore

#: Characters of numbers that a printed line has room for: of A4 186 mm are left, a digit of 9 pt takes 1.75 mm, and the
#: space beside a column as much as 1.5 digits.
_PRINTED, _BESIDE_COLUMN = 106, 1.5


@dataclass(frozen=True, slots=True, eq=False)
class TableColumn:
    """One column of a table.

    name: Head, with the unit.
    texts: What the cells show.
    numbers: What the column is sorted by where that is a number; NaN comes last; None: it is sorted by its texts.
    links: Where each cell leads: a relative address, "#id" of a part of this page, or nothing; None: nowhere.
    """

    name: str
    texts: Sequence[str]
    numbers: Sequence[float] | None = None
    links: Sequence[str] | None = None


@dataclass(frozen=True, eq=False)
class TableView:
    """A table whose rows the reader sorts and filters.

    name: What it lists.
    columns: All of one length.
    row_ids: Marks of the rows in the page, where links such as "#module-12" lead; empty: none.
    most_rows: Rows that are shown before the reader asks for all; print shows them alone, with the number left out.
    InputError: Columns of different lengths.
    """

    name: str
    columns: tuple[TableColumn, ...]
    row_ids: Sequence[str] = ()
    most_rows: int = 60

    def __post_init__(self) -> None:
        lengths = {
            len(part) for one in self.columns for part in (one.texts, one.numbers, one.links) if part is not None
        }
        if self.row_ids:
            lengths.add(len(self.row_ids))
        if len(lengths) > 1:
            raise InputError(f"table {self.name}: columns of different lengths: {sorted(lengths)}")

    @property
    def count(self) -> int:
        """Number of rows."""
        return len(self.columns[0].texts) if self.columns else 0

    def _repr_html_(self) -> str:
        return self._table()

    def page_html(self, store: ArrayStore = PAGE) -> str:
        """Return the view for a page: a table that the page's script sorts and filters."""
        name = html.escape(self.name, quote=True)
        left_out = self.count - self.most_rows
        note = f'<p class="left-out">{left_out} more rows are in the page on screen.</p>' if left_out > 0 else ""
        return (
            f'<section class="view" data-view="table" data-rows="{self.most_rows}" aria-label="{name}">'
            f"{self._table()}{note}</section>"
        )

    def _table(self) -> str:
        heads = "".join(f'<th scope="col"{_kind(column)}>{html.escape(column.name)}</th>' for column in self.columns)
        rows = "".join(self._row(index) for index in range(self.count))
        numbers = [column for column in self.columns if column.numbers is not None]
        width = sum(max(map(len, column.texts), default=0) + _BESIDE_COLUMN for column in numbers)
        # Printed smaller, so that a number and its sigma stay in one line.
        kind = "table wide" if width > _PRINTED else "table"
        return f'<div class="{kind}"><table><thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table></div>'

    def _row(self, index: int) -> str:
        cells = []
        for column in self.columns:
            text = html.escape(column.texts[index])
            target = column.links[index] if column.links is not None else ""
            if target:
                text = f'<a href="{html.escape(_safe(target), quote=True)}">{text}</a>'
            order = ""
            if column.numbers is not None and math.isfinite(column.numbers[index]):
                order = f' data-order="{float(column.numbers[index]):.12g}"'
            cells.append(f"<td{_kind(column)}{order}>{text}</td>")
        mark = f' id="{html.escape(self.row_ids[index], quote=True)}"' if self.row_ids else ""
        # Rows beyond the first are hidden by the style sheet of pages, never in notebooks.
        kind = ' class="further"' if index >= self.most_rows else ""
        return f"<tr{mark}{kind}>{''.join(cells)}</tr>"


def _kind(column: TableColumn) -> str:
    return ' class="number"' if column.numbers is not None else ""


def _safe(target: str) -> str:
    """Return a relative address or a place in the page: names from files must not become scripts or other hosts."""
    if target.startswith("#") or not (":" in target.split("/", maxsplit=1)[0] or target.startswith(("/", "\\"))):
        return target
    return "./" + target.replace(":", "%3A").lstrip("/\\")
