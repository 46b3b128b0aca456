"""The Python reference: a page made from the public faces, so that it lists what users may import and nothing else."""

import re
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

#: Packages in the order of the reference.
PACKAGES = (
    "heliogauge", "photogrammetry", "deflectometry", "observer", "calibration.camera", "calibration.screen",
    "calibration.beam", "calibration.heliostat", "calibration.survey", "data_synth",
)  # fmt: skip


PREFACE = """# Python reference

What stands here is public; everything else is internal and may change. `import heliogauge as hg` is the usual
way in; the instruments' own faces are for those who build on a stage of a method.
"""


def write_reference(path: Path) -> None:
    """Write the page: each face with its paragraph and a table of its names, rooms with faces below their package."""
    sections = [section for package in PACKAGES for section in _sections(package, "##")]
    path.write_text("\n".join([PREFACE, *sections]), encoding="utf-8")


def list_facts(lines: list[str]) -> list[str]:
    """Turn the paragraphs of short docstrings whose lines are ``name (shape): meaning`` into lists."""
    listed: list[str] = []
    for paragraph in "\n".join(lines).split("\n\n"):
        is_list = re.match(r"[A-Za-z_][\w, .]*( \([^\n]*?\))?: \S", paragraph) is not None
        for line in paragraph.split("\n"):
            item = f"  {line.strip()}" if line.startswith(" ") else f"- {line}"
            listed.append(item if is_list else line)
        listed.append("")
    return listed


def _sections(package: str, heading: str) -> list[str]:
    module = import_module(package)
    # A module without a face is listed like any other name.
    found = {name: getattr(module, name) for name in module.__all__}
    rooms = [name for name, value in found.items() if isinstance(value, ModuleType) and hasattr(value, "__all__")]
    names = [name for name in module.__all__ if name not in rooms]
    lines = [f"{heading} {package}", "", (module.__doc__ or "").strip(), ""]
    if names:
        table = [".. autosummary::", "   :toctree: api", "", *(f"   {package}.{name}" for name in names)]
        lines += ["```{eval-rst}", *table, "```", ""]
    for room in rooms:
        lines += _sections(f"{package}.{room}", heading + "#")
    return lines


if __name__ == "__main__":
    write_reference(Path(sys.argv[1]))
