"""The modules of all packages with their syntax trees, and which of them are numeric."""

import ast
from dataclasses import dataclass
from functools import cache
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGES = ("heliogauge", "photogrammetry", "deflectometry", "observer", "calibration", "data_synth")

#: Modules that open files, draw or talk; everything else is numeric. A prefix ending in _ covers a family.
_BORDER_NAMES = frozenset({
    "images", "measurement", "measurement_models", "measurement_writer", "templates", "store", "figures", "report",
    "folders", "terminal", "commands", "cli", "__main__", "demo", "pipeline", "scale", "video", "video_names",
})  # fmt: skip
_BORDER_FAMILIES = ("store_", "figures_", "report_", "pipeline_", "measurement_")
#: Readers of other programs' files and writers of whole data sets: a border of their own, one reason each.
_BORDER_MODULES = {
    "deflectometry.pipeline.inputs": "turns a measurement folder into the values the numeric modules take",
    "deflectometry.pipeline.headline": "fills summary.json",
    "deflectometry.exchange.opencsp": "reads another program's HDF5 and JSON files",
    "deflectometry.exchange.opencsp_import": "writes a measurement folder from another program's files",
    "deflectometry.setup.pattern_files": "writes the frames to display and the tables that describe them",
    "data_synth.fringes.dataset": "writes a measurement folder",
    "photogrammetry.targets.target_sheets": "writes printable sheets",
    "data_synth.targets.dataset": "writes a measurement folder",
    "data_synth.troughs.dataset": "writes a measurement folder",
    "data_synth.heliostats.dataset": "writes a measurement folder",
}


@dataclass(frozen=True)
class Module:
    """A module of ours: dotted name, path relative to the repository, source and syntax tree."""

    name: str
    path: str
    source: str
    tree: ast.Module

    def __str__(self) -> str:
        return self.name


@cache
def all_modules() -> tuple[Module, ...]:
    """Read all modules of all packages."""
    modules = []
    for package in PACKAGES:
        for file in sorted((REPOSITORY / package).rglob("*.py")):
            relative = file.relative_to(REPOSITORY)
            parts = relative.with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            source = file.read_text(encoding="utf-8")
            modules.append(Module(name, relative.as_posix(), source, ast.parse(source)))
    return tuple(modules)


def is_numeric(name: str) -> bool:
    """Whether a module must do without files, figures and terminals."""
    last = name.split(".")[-1]
    return not (last in _BORDER_NAMES or last.startswith(_BORDER_FAMILIES) or name in _BORDER_MODULES)


class _NumericNames:
    """All numeric names, also of modules that do not exist (negative controls ask for those)."""

    def __contains__(self, name: object) -> bool:
        return is_numeric(str(name))


NUMERIC_MODULES = _NumericNames()
