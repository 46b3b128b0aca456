"""Pieces of HTML that report notebooks show: figures side by side, tables, numbers with their uncertainty."""

import base64
import html
from collections.abc import Iterable, Sequence

from matplotlib.figure import Figure

from heliogauge.reporting.canvas import WIDTH_IN, png_of


class Html:
    """A piece of HTML that a notebook shows."""

    def __init__(self, text: str) -> None:
        self.text = text

    def _repr_html_(self) -> str:
        return self.text


def show(*figures: Figure | None, caption: str = "") -> Html:
    """Return figures side by side, as images within the page.

    *figures: The figures; None is left out.
    caption: A line under them.
    Returns: The images with a text for those who cannot see them.
    """
    parts = []
    for figure in filter(None, figures):
        words = ". ".join(text.get_text() for text in figure.texts if text.get_text())
        data = base64.b64encode(png_of(figure)).decode("ascii")
        kind = ' class="wide"' if figure.get_size_inches()[0] > 1.5 * WIDTH_IN else ""
        image = f'<img alt="{html.escape(words, quote=True)}" src="data:image/png;base64,{data}">'
        parts.append(f"<figure{kind}>{image}</figure>")
    below = f'<p class="caption">{html.escape(caption)}</p>' if caption else ""
    return Html(f'<div class="figures">{"".join(parts)}</div>{below}' if parts else "")


def join(*pieces: Html) -> Html:
    """Put pieces below each other."""
    return Html("".join(piece.text for piece in pieces))


def table(head: Sequence[str], rows: Iterable[Sequence[str]], *, numbers: Iterable[int] = ()) -> Html:
    """Return a table.

    head: Names of the columns; no head line where all are empty.
    rows: Cells as text.
    numbers: Columns that are aligned to the right.
    """
    right = set(numbers)

    def line(cells: Sequence[str], tag: str) -> str:
        kinds = [' class="number"' if index in right else "" for index in range(len(cells))]
        body = "".join(f"<{tag}{kind}>{html.escape(cell)}</{tag}>" for cell, kind in zip(cells, kinds, strict=True))
        return f"<tr>{body}</tr>"

    top = f"<thead>{line(head, 'th')}</thead>" if any(head) else ""
    body = "".join(line(row, "td") for row in rows)
    return Html(f'<div class="table"><table>{top}<tbody>{body}</tbody></table></div>')
