"""What a page needs once for its views: style sheet, scripts, and the libraries that its kinds of view use."""

import base64
import gzip
import re
from functools import cache
from importlib.resources import files

_KINDS = re.compile(r'<section class="view" data-view="([a-z]+)"')
#: Own scripts in their order, by the kinds of view that need them.
_SCRIPTS: dict[str, tuple[str, ...]] = {
    "page.js": ("map", "photo", "scene", "table", "chart"),
    "figure.js": ("map", "photo", "scene", "chart"),
    "chart.js": ("map", "chart"),
    "map_data.js": ("map",),
    "map_picture.js": ("map",),
    "map.js": ("map",),
    "table.js": ("table",),
    "photo.js": ("photo",),
    "scene.js": ("scene",),
}
#: Libraries by name, and the kinds of view that need them.
_LIBRARIES: dict[str, tuple[str, ...]] = {
    "echarts": ("map", "photo", "chart"),
    "three": ("scene",),
}


def page_assets(body: str) -> str:
    """Return what stands once in the head of a page.

    body: The HTML of the page, where the views are looked for.
    Returns: Style sheet, scripts and libraries; nothing for a page without views.
    """
    kinds = set(_KINDS.findall(body))
    if not kinds:
        return ""
    scripts = "".join(f"<script>{_text(name)}</script>" for name, of in _SCRIPTS.items() if kinds & set(of))
    libraries = "".join(_library(name) for name, of in _LIBRARIES.items() if kinds & set(of))
    return f"<style>{_text('view.css')}</style>{libraries}{scripts}"


@cache
def _text(name: str) -> str:
    return (files("heliogauge.view") / "browser" / name).read_text(encoding="utf-8")


@cache
def _library(name: str) -> str:
    """Return a library compressed: less than half of its size in the page, and run when the first view needs it."""
    data = gzip.compress((files("heliogauge.view") / "libraries" / f"{name}.min.js").read_bytes(), 9, mtime=0)
    return f'<script type="application/gzip" data-library="{name}">{base64.b64encode(data).decode("ascii")}</script>'
