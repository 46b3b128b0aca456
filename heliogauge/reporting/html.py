"""Pieces of HTML that report notebooks show: figures side by side, tables, pieces below each other."""

import html
import re
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from heliogauge.view.arrays import ArrayStore
    from heliogauge.view.tables import TableView


class Shown(Protocol):
    """Anything that a notebook shows as HTML."""

    def _repr_html_(self) -> str:
        """Return the HTML for a notebook."""


class Html:
    """A piece of HTML.

    text: What a notebook shows.
    page: Returns what a page shows, where that differs: views that are alive.
    """

    def __init__(self, text: str, page: "Callable[[ArrayStore], str] | None" = None) -> None:
        self.text = text
        self._page = page

    def _repr_html_(self) -> str:
        return self.text

    def page_html(self, store: "ArrayStore") -> str:
        """Return the HTML for a page; `store` takes the numbers of its views."""
        return self.text if self._page is None else self._page(store)


class FirstScreen(Html):
    """What a reader sees first.

    picture: What of it shows the result best: a view or pictures; None: there is none.
    """

    def __init__(self, whole: Html, picture: Shown | None) -> None:
        super().__init__(whole.text, whole.page_html)
        self.picture = picture


def sentence(text: str) -> str:
    """Return a sentence as HTML: markup in it stays text, what stands between backticks is code.

    >>> sentence("see `beam plan` <here>")
    'see <code>beam plan</code> &lt;here&gt;'
    """
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", html.escape(text))


def in_page(piece: Shown, store: "ArrayStore") -> str:
    """Return a piece as a page shows it: alive where it can be.

    store: Takes the numbers of views.
    """
    alive: Callable[[ArrayStore], str] | None = getattr(piece, "page_html", None)
    return piece._repr_html_() if alive is None else alive(store)


def wrap(before: str, pieces: Sequence[Shown], after: str) -> Html:
    """Put pieces below each other between two pieces of markup.

    before, after: Such as ``<div class="two">`` and ``</div>``.
    """
    text = before + "".join(piece._repr_html_() for piece in pieces) + after
    return Html(text, lambda store: before + "".join(in_page(piece, store) for piece in pieces) + after)


def join(*pieces: Shown) -> Html:
    """Put pieces below each other."""
    return wrap("", pieces, "")


def beside(*pieces: Shown) -> Html:
    """Put pieces side by side, below each other on narrow screens."""
    return wrap('<div class="beside">', [wrap("<div>", [piece], "</div>") for piece in pieces], "</div>")


def table_under_name(view: "TableView") -> Html:
    """Return a table with its name above it."""
    return join(Html(f'<p class="caption">{html.escape(view.name)}</p>'), view)


#: Characters from which a cell is read as a sentence: it gets the width of one where the page is narrow.
_SENTENCE = 30


def table(head: Sequence[str], rows: Iterable[Sequence[str]], *, numbers: Iterable[int] = ()) -> Html:
    """Return a table.

    head: Names of the columns; no head line where all are empty.
    rows: Cells as text.
    numbers: Columns that are aligned to the right.
    """
    right = set(numbers)

    def line(cells: Sequence[str], tag: str) -> str:
        kinds = [_cell_kind(cell, is_number=index in right) for index, cell in enumerate(cells)]
        body = "".join(f"<{tag}{kind}>{sentence(cell)}</{tag}>" for cell, kind in zip(cells, kinds, strict=True))
        return f"<tr>{body}</tr>"

    top = f"<thead>{line(head, 'th')}</thead>" if any(head) else ""
    body = "".join(line(row, "td") for row in rows)
    return Html(f'<div class="table"><table>{top}<tbody>{body}</tbody></table></div>')


def _cell_kind(cell: str, *, is_number: bool) -> str:
    if is_number:
        return ' class="number"'
    return ' class="sentence"' if len(cell) > _SENTENCE else ""
