"""Notebooks as values: read, run in this process, written with what their cells showed.

A report notebook is package data; its cells are as trusted as any module. Files of results are numbers only and are
never run.
"""

import ast
import copy
import html
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from heliogauge.files.texts import parse_json
from heliogauge.reporting.html import in_page

if TYPE_CHECKING:
    from heliogauge.view.arrays import ArrayStore

#: Tag of the cell that says where the results are: ``folder = Path.cwd()`` in Jupyter, the given folder here.
FOLDER_TAG = "folder"
#: Tag of a cell that is on the printed sheet.
PRINT_TAG = "print"


@dataclass(frozen=True, slots=True, eq=False)
class ShownCell:
    """What a reader sees of one cell.

    html: Its markup in a page.
    printed: Whether it is on the printed sheet.
    """

    html: str
    printed: bool


@dataclass(slots=True, eq=False)
class Notebook:
    """A notebook in the JSON of format 4.

    content: All of it; running writes the outputs into it.
    shown: What its cells show in a page, once it has run.
    """

    content: dict[str, Any]
    shown: list[ShownCell] = field(default_factory=list)

    def run(self, folder: Path, store: "ArrayStore") -> None:
        """Run the cells of code in their order, in one namespace; the value of a cell's last expression is shown.

        folder: What the cell with the tag `FOLDER_TAG` would have found.
        store: Takes the numbers of views in the page.
        Exception: What a cell raises.
        """
        count, parts = 0, []
        for cell, value in self.values(folder):
            if cell["cell_type"] == "markdown":
                shown = markdown("".join(cell["source"]))
            else:
                count += 1
                cell["execution_count"] = count
                cell["outputs"] = [] if value is None else [_output(value, count)]
                shown = "" if value is None else _in_page(value, store)
            parts.append(_Part(ShownCell(shown, PRINT_TAG in _tags(cell)), is_text=cell["cell_type"] == "markdown"))
        self.shown += _with_content(parts)

    def values(self, folder: Path) -> Iterator[tuple[dict[str, Any], Any]]:
        """Go through the cells of text and code, each with the value of its last expression, running one at a time.

        folder: What the cell with the tag `FOLDER_TAG` would have found.
        Exception: What a cell raises.
        """
        namespace: dict[str, Any] = {"__name__": "report", "folder": folder, "Path": Path}
        for number, cell in enumerate(self.content["cells"], start=1):
            if cell["cell_type"] == "code" and FOLDER_TAG not in _tags(cell):
                yield cell, _run("".join(cell["source"]), f"<report, cell {number}>", namespace)
            elif cell["cell_type"] in ("code", "markdown"):
                yield cell, None

    def text(self) -> str:
        """Return the notebook as its file holds it."""
        return json.dumps(self.content, indent=1, ensure_ascii=False) + "\n"


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """A cell as the page would have it, before it is known whether there is something under its heading."""

    shown: ShownCell
    is_text: bool

    @property
    def is_heading(self) -> bool:
        return self.shown.html.startswith("<h2")


def _with_content(parts: Sequence[_Part]) -> list[ShownCell]:
    """Return the cells of a page: without those that show nothing, and without text of which nothing is shown.

    A heading is of all that follows up to the next one, other text of the results that follow it. Text that no result
    follows is content itself.
    """
    kept: dict[int, ShownCell] = {}
    for number, part in reversed(list(enumerate(parts))):
        if not part.is_text:
            if part.shown.html:
                kept[number] = part.shown
            continue
        end = number + 1
        while end < len(parts) and not parts[end].is_heading and (part.is_heading or not parts[end].is_text):
            end += 1
        inside = range(number + 1, end)
        if all(parts[one].is_text for one in inside) or any(one in kept for one in inside):
            kept[number] = part.shown
    return [kept[number] for number in sorted(kept)]


def _tags(cell: dict[str, Any]) -> Sequence[str]:
    tags: Sequence[str] = cell.get("metadata", {}).get("tags", ())
    return tags


def read_notebook(text: str) -> Notebook:
    """Return the notebook that a file's text holds, without outputs."""
    content = copy.deepcopy(parse_json(text, "the notebook of the report"))
    for cell in content["cells"]:
        if cell["cell_type"] == "code":
            cell.update(execution_count=None, outputs=[])
    return Notebook(content)


def markdown(text: str) -> str:
    """Return Markdown as HTML; markup within it stays text."""
    from markdown_it import MarkdownIt

    return str(MarkdownIt("commonmark", {"html": False}).enable("table").render(text))


def _run(source: str, name: str, namespace: dict[str, Any]) -> Any:
    body: Sequence[ast.stmt] = ast.parse(source, name).body
    last = body[-1] if body and isinstance(body[-1], ast.Expr) else None
    statements = ast.Module(body=list(body[:-1] if last else body), type_ignores=[])
    exec(compile(statements, name, "exec"), namespace)
    return None if last is None else eval(compile(ast.Expression(last.value), name, "eval"), namespace)


def _output(value: Any, count: int) -> dict[str, Any]:
    text = value._repr_html_() if hasattr(value, "_repr_html_") else _plain(value)
    data = {"text/html": text.splitlines(keepends=True), "text/plain": [f"<{type(value).__name__}>"]}
    return {"output_type": "execute_result", "execution_count": count, "metadata": {}, "data": data}


def _in_page(value: Any, store: "ArrayStore") -> str:
    return in_page(value, store) if hasattr(value, "_repr_html_") else _plain(value)


def _plain(value: Any) -> str:
    return f"<pre>{html.escape(str(value))}</pre>"
