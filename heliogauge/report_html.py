"""Pieces of HTML that report notebooks show: figures side by side, tables, numbers with their uncertainty."""

import base64
import html
import math
from collections.abc import Iterable, Sequence

from matplotlib.figure import Figure

from heliogauge.figures_canvas import WIDTH_IN, png_of


class Html:
    """A piece of HTML that a notebook shows.

    Parameters
    ----------
    text : str
        The HTML.
    """

    def __init__(self, text: str) -> None:
        self.text = text

    def _repr_html_(self) -> str:
        return self.text


def show(*figures: Figure | None, caption: str = "") -> Html:
    """Return figures side by side, as images within the page.

    Parameters
    ----------
    *figures : Figure or None
        The figures; None is left out.
    caption : str, optional
        A line under them.

    Returns
    -------
    Html
        The images with a text for those who cannot see them.
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
    """Put pieces below each other.

    Parameters
    ----------
    *pieces : Html
        The pieces.

    Returns
    -------
    Html
        All of them.
    """
    return Html("".join(piece.text for piece in pieces))


def table(head: Sequence[str], rows: Iterable[Sequence[str]], *, numbers: Iterable[int] = ()) -> Html:
    """Return a table.

    Parameters
    ----------
    head : sequence of str
        Names of the columns; no head line where all are empty.
    rows : iterable of sequence of str
        Cells as text.
    numbers : iterable of int, optional
        Columns that are aligned to the right.

    Returns
    -------
    Html
        The table.
    """
    right = set(numbers)

    def line(cells: Sequence[str], tag: str) -> str:
        kinds = [' class="number"' if index in right else "" for index in range(len(cells))]
        body = "".join(f"<{tag}{kind}>{html.escape(cell)}</{tag}>" for cell, kind in zip(cells, kinds, strict=True))
        return f"<tr>{body}</tr>"

    top = f"<thead>{line(head, 'th')}</thead>" if any(head) else ""
    body = "".join(line(row, "td") for row in rows)
    return Html(f'<div class="table"><table>{top}<tbody>{body}</tbody></table></div>')


def number_text(value: float, sigma: float | None, unit: str, name: str = "") -> str:
    """Print a number with its standard deviation, both to the digits that the latter allows.

    Parameters
    ----------
    value : float
        The number.
    sigma : float or None
        Its standard deviation.
    unit : str
        Its unit; rad is printed in mrad, lengths below 0.1 m in mm.
    name : str, optional
        A name ending with ``_share`` is printed in per cent.

    Returns
    -------
    str
        The text.

    Examples
    --------
    >>> number_text(1.23456e-3, 1.2e-6, "rad")
    '1.2346 \u00b1 0.0012 mrad'
    >>> number_text(0.98765, None, "", "measured_share")
    '98.77 %'
    """
    if name.endswith("_share"):
        return f"{100 * value:.2f} %"
    if unit == "rad" or (unit == "m" and abs(value) < 0.1):
        value, unit = 1e3 * value, "m" + unit
        sigma = None if sigma is None else 1e3 * sigma
    if isinstance(value, int):
        return f"{value} {unit}".strip()
    if sigma is None or not math.isfinite(sigma) or sigma <= 0:
        return f"{value:.4g} {unit}".strip()
    digits = max(0, 1 - math.floor(math.log10(sigma)))
    return f"{value:.{digits}f} \u00b1 {sigma:.{digits}f} {unit}".strip()
