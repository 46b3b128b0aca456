"""What a page needs once for its views: style sheet, scripts, and the libraries that its kinds of view use."""

import re
from functools import cache
from importlib.resources import files

_KINDS = re.compile(r'<section class="view" data-view="([a-z]+)"')
#: Own scripts in their order, by the kinds of view that need them.
_SCRIPTS: dict[str, tuple[str, ...]] = {
    "page.js": ("map", "photo", "scene", "table", "chart"),
}


def page_assets(body: str) -> str:
    """Return what stands once in the head of a page.

    body: The HTML of the page, where the views are looked for.
    Returns: Style sheet and scripts; nothing for a page without views.
    """
    kinds = set(_KINDS.findall(body))
    if not kinds:
        return ""
    scripts = "".join(f"<script>{_text(name)}</script>" for name, of in _SCRIPTS.items() if kinds & set(of))
    return f"<style>{_text('view.css')}</style>{scripts}"


@cache
def _text(name: str) -> str:
    return (files("heliogauge.view") / "browser" / name).read_text(encoding="utf-8")
