"""The Python reference: a page made from the public faces, so that it lists what users may import and nothing else."""

import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

#: Packages in the order of the reference.
PACKAGES = (
    "heliogauge", "photogrammetry", "deflectometry", "observer", "calibration.camera", "calibration.screen",
    "calibration.heliostat", "data_synth",
)  # fmt: skip


def write_reference(path: Path) -> None:
    """Write the page: each face with its paragraph and a table of its names, rooms with faces below their package."""
    path.parent.mkdir(parents=True, exist_ok=True)
    sections = [section for package in PACKAGES for section in _sections(package, "##")]
    path.write_text("\n".join(sections), encoding="utf-8")


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
