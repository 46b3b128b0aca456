"""The page around the cells of a report: head, navigation, style."""

import html
import re
from collections.abc import Sequence

from heliogauge.reporting.notebook import ShownCell
from heliogauge.reporting.style import STYLE

#: Nothing is fetched, whatever stands in the page: everything it shows lies within it.
POLICY = (
    "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; font-src data:; "
    "script-src 'unsafe-inline' blob:; worker-src blob:; connect-src data: blob:"
)
POLICY_HEAD = f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
_HEADING = re.compile(r"<h2[^>]*>(.*?)</h2>", re.DOTALL)


def page_frame(
    title: str, cells: Sequence[ShownCell], *, up: Sequence[tuple[str, str]] = (), served: bool = False
) -> str:
    """Return a whole page.

    title: As text.
    cells: What stands in it; headings of the second level are linked in the navigation.
    up: Words and addresses of pages that lead here, first in the navigation.
    served: Whether a server hands out the page, with its own rules about what may be fetched.
    """
    from heliogauge.view.assets import page_assets

    links: dict[str, str] = {}

    def named(match: re.Match[str]) -> str:
        words = match[1]
        links[mark := _mark(words, links)] = re.sub(r"<.*?>", "", words)
        return f'<h2 id="{mark}">{words}</h2>'

    parts = []
    for cell in cells:
        kind = "cell print" if cell.printed else "cell"
        parts.append(f'<div class="{kind}">\n{_HEADING.sub(named, cell.html)}\n</div>')
    body = "\n".join(parts)
    assets = page_assets(body)
    navigation = "".join(
        f'<a class="up" href="{html.escape(address, quote=True)}">{html.escape(words)}</a>' for words, address in up
    )
    navigation += "".join(f'<a href="#{mark}">{words}</a>' for mark, words in links.items())
    switch = '<button type="button" data-theme-switch aria-label="Dark or light">\u25d0</button>' if assets else ""
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f"{'' if served else POLICY_HEAD}"
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="color-scheme" content="light dark">'
        # Browsers ask for a picture of the page elsewhere unless it is named.
        '<link rel="icon" href="data:,">'
        f"<title>{html.escape(title)}</title>\n<style>\n{STYLE}</style>\n{assets}</head>\n"
        f"<body><nav><div>{navigation}</div>{switch}</nav><main>\n{body}\n</main></body></html>\n"
    )


def _mark(words: str, taken: dict[str, str]) -> str:
    """Return a place in the page that is called like its heading, and like no other."""
    plain = html.unescape(re.sub(r"<.*?>", "", words)).lower()
    mark = re.sub(r"[^a-z0-9]+", "-", plain).strip("-") or "part"
    number = 2
    while (name := mark if number == 2 else f"{mark}-{number - 1}") in taken:
        number += 1
    return name
