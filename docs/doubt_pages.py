"""The list of doubts: a page made from the places in the code that make them, so that no code is missing."""

import ast
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from calibration.heliostat.diagnosis.findings import REMEDIES
from deflectometry.frames.light_checks import FaultKind

#: Folders that make doubts, and the heading under which they are listed.
PLACES = {
    "heliogauge": "All instruments",
    "calibration/camera": "camera",
    "calibration/screen": "screen",
    "photogrammetry": "photogrammetry",
    "deflectometry": "deflectometry",
    "observer": "observer",
    "calibration/beam": "beam",
    "calibration/survey": "survey",
    "calibration/heliostat": "heliostat",
    "data_synth": "Synthetic measurements",
}


@dataclass(frozen=True, slots=True)
class Finding:
    """A doubt as the code makes it.

    code: Its code.
    sentence: Its text, with dots where numbers and names stand.
    severity: note, doubt or serious.
    """

    code: str
    sentence: str
    severity: str


def doubt_pages(root: Path) -> str:
    """Return the list of doubts as Markdown, one section for each instrument.

    root: Folder of the packages.
    """
    lines = []
    for place, heading in PLACES.items():
        found = {one.code: one for path in sorted((root / place).rglob("*.py")) for one in _findings(path)}
        if place == "calibration/heliostat":
            diagnosed = "doubt; serious for a fault"
            found.update({code: Finding(code, remedy, diagnosed) for code, remedy in REMEDIES.items()})
        if found:
            lines += [f"## {heading}", "", "| code | severity | what it says |", "|---|---|---|"]
            for code in sorted(found):
                lines.append(f"| `{code}` | {found[code].severity} | {_cell(found[code].sentence)} |")
            lines.append("")
    return "\n".join(lines)


def _findings(path: Path) -> Iterator[Finding]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for function in ast.walk(tree):
        if not isinstance(function, ast.FunctionDef):
            continue
        texts = _assigned(function)
        for call in ast.walk(function):
            if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.args:
                given = {one.arg: one.value for one in call.keywords}
                code = call.args[0]
                if call.func.id == "Doubt" and isinstance(code, ast.Constant):
                    text = call.args[1] if len(call.args) > 1 else given["text"]
                    severity = call.args[3] if len(call.args) > 3 else given.get("severity")
                    yield Finding(str(code.value), _words(text, texts), _severity(severity))
                elif call.func.id == "FrameFault" and isinstance(code, ast.Attribute):
                    text = call.args[2] if len(call.args) > 2 else given["message"]
                    yield Finding(FaultKind[code.attr].value, _words(text, texts), "doubt")


def _assigned(function: ast.FunctionDef) -> dict[str, ast.expr]:
    """Return what the names of a function are set to first."""
    found: dict[str, ast.expr] = {}
    for node in ast.walk(function):
        if isinstance(node, ast.Assign) and len(node.targets) == 1 and isinstance(node.targets[0], ast.Name):
            found.setdefault(node.targets[0].id, node.value)
    return found


def _words(node: ast.expr, texts: Mapping[str, ast.expr]) -> str:
    """Return the words of an expression that makes a sentence; three dots where it puts a value."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(_words(one, texts) for one in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return _words(node.left, texts) + _words(node.right, texts)
    if isinstance(node, ast.IfExp):
        return _words(node.body, texts)
    if isinstance(node, ast.Name) and node.id in texts:
        return _words(texts[node.id], {name: text for name, text in texts.items() if name != node.id})
    return "…"


def _severity(node: ast.expr | None) -> str:
    if node is None:
        return "doubt"
    if isinstance(node, ast.Attribute):
        return node.attr.lower()
    return "doubt or serious, by its size"


def _cell(text: str) -> str:
    escaped = " ".join(text.split())
    for sign in "\\|<>*_[]":
        escaped = escaped.replace(sign, "\\" + sign)
    return escaped
