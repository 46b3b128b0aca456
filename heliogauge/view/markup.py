"""How a view stands in a page: a frame with its static figure, its numbers as JSON, and what makes it alive."""

import html
import json
from typing import TYPE_CHECKING, Any, Protocol

from heliogauge.reporting.html import Html
from heliogauge.view.arrays import PAGE, ArrayStore

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class View(Protocol):
    """A piece of a report that is alive in a page and still elsewhere."""

    def page_html(self, store: ArrayStore = PAGE) -> str:
        """Return the HTML for a page that has the assets of `heliogauge.view.assets`."""

    def figure(self) -> "Figure":
        """Draw it, or what of it is seen first."""

    def _repr_html_(self) -> str:
        """Return the HTML for a notebook: the static figure."""


def view_frame(kind: str, name: str, spec: dict[str, Any], static: Html) -> str:
    """Return the place of a view in a page.

    kind: Kind of view, for the script that shows it.
    name: What it shows, for those who cannot see it.
    spec: Numbers and words.
    static: What print, browsers without script and the time before loading show.
    """
    # "</" would end the script; JSON has no other sign that HTML could mistake.
    data = json.dumps(spec, separators=(",", ":"), ensure_ascii=True, allow_nan=False).replace("<", "\\u003c")
    return (
        f'<section class="view" data-view="{kind}" aria-label="{html.escape(name, quote=True)}">'
        f'<div class="view-static">{static.text}</div>'
        f'<script type="application/json">{data}</script></section>'
    )
