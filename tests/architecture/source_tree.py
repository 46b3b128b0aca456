"""The modules of all packages with their syntax trees and imports, the instruments, and which modules are numeric."""

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

from heliogauge.faces import face_homes

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGES = ("heliogauge", "photogrammetry", "deflectometry", "observer", "calibration", "data_synth")

#: Rooms, and modules called like them, that open files, draw or talk; everything else is numeric.
BORDER_ROOMS = frozenset(
    {
        "batch",
        "cli",
        "exchange",
        "files",
        "images",
        "instrument",
        "keys",
        "measurement",
        "pipeline",
        "report",
        "reporting",
        "view",
        "results",
        "running",
        "__main__",
    }
)
#: Modules of other rooms at the border, one reason each.
BORDER_MODULES = {
    "heliogauge": "opens measurements and results by their path",
    "heliogauge.working_folder": "says where modules are looked for",
    "heliogauge.instruments": "finds the instruments by name",
    "deflectometry.pipeline.write_patterns": "writes the frames to display and the tables that describe them",
    "photogrammetry.targets.target_sheets": "writes printable sheets",
    "photogrammetry.targets.store_ring_codes": "reads tables of codes",
    "photogrammetry.surface.store_mesh": "reads and writes meshes",
    "calibration.heliostat.kinematic_model.store_design": "reads and writes designs",
    "deflectometry.stars.sky": "asks for the library of the stars' places, an extra",
    "calibration.screen.figures": "draws",
    "observer.studies.align": "from results on disk to a prescription",
    "observer.studies.align_photos": "from photos to a prescription",
    "observer.studies.compare": "from results on disk to a table of orientations",
    "observer.studies.compare_fields": "from results on disk to a table of what turned",
    "observer.studies.overview": "from results on disk to a page of modules",
    "data_synth.heliostats.beam_photos": "writes folders of photos of beams and their truth",
    "data_synth.preset_folders": "writes measurement folders by the name of a preset",
}


@dataclass(frozen=True)
class Module:
    """A module of ours: dotted name, path relative to the repository, and source."""

    name: str
    path: str
    source: str

    def __str__(self) -> str:
        return self.name

    @cached_property
    def tree(self) -> ast.Module:
        """Its syntax; read when asked for, as every process that collects the tests makes this list."""
        return ast.parse(self.source)

    @property
    def is_face(self) -> bool:
        return self.path.endswith("__init__.py")

    @property
    def room(self) -> str:
        """The folder it stands in, dotted."""
        return self.name if self.is_face else self.name.rpartition(".")[0]


@dataclass(frozen=True)
class Import:
    """One import's target: as a module path, and whether it runs when the module is imported."""

    target: str
    line: int
    at_import_time: bool


@cache
def all_modules() -> tuple[Module, ...]:
    """Read all modules of all packages."""
    return tuple(_read(file) for package in PACKAGES for file in sorted((REPOSITORY / package).rglob("*.py")))


def _read(file: Path) -> Module:
    relative = file.relative_to(REPOSITORY)
    parts = relative.with_suffix("").parts
    name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
    return Module(name, relative.as_posix(), file.read_text(encoding="utf-8"))


@cache
def instruments() -> tuple[str, ...]:
    """Names of the instruments: packages, and those of calibration, which stand one level deeper."""
    flat = ("photogrammetry", "deflectometry", "observer")
    return flat + tuple(
        f"calibration.{place.name}"
        for place in sorted((REPOSITORY / "calibration").iterdir())
        if (place / "__init__.py").is_file()
    )


def owner(name: str) -> str:
    """Return the instrument, or else the package, that a module belongs to."""
    for instrument in instruments():
        if name == instrument or name.startswith(instrument + "."):
            return instrument
    return name.split(".")[0]


def is_numeric(name: str) -> bool:
    """Whether a module must do without files, figures and terminals; also for modules that do not exist."""
    rooms = name.split(".")
    # data_synth writes measurement folders in modules called dataset, and draws nothing for people.
    return not (BORDER_ROOMS.intersection(rooms) or name in BORDER_MODULES or rooms[-1] in {"dataset", "plan"})


def imports_of(tree: ast.Module) -> Iterator[Import]:
    """Yield what a module imports; ``from a import b`` yields both ``a`` and ``a.b`` (b may be a module)."""
    yield from _imports(tree.body, at_import_time=True)


def _imports(nodes: list[ast.stmt], *, at_import_time: bool) -> Iterator[Import]:
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (Import(alias.name, node.lineno, at_import_time) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            home = node.module or ""
            yield Import(home, node.lineno, at_import_time)
            yield from (Import(f"{home}.{alias.name}", node.lineno, at_import_time) for alias in node.names)
        else:
            is_typing_only = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)
            is_function = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
            inner = at_import_time and not is_typing_only and not is_function
            for name in ("body", "orelse", "finalbody"):
                yield from _imports(
                    [n for n in getattr(node, name, []) if isinstance(n, ast.stmt)], at_import_time=inner
                )
            for handler in getattr(node, "handlers", []):
                yield from _imports(handler.body, at_import_time=inner)


@cache
def faces() -> dict[str, dict[str, str]]:
    """Return the names of every package and room that has a face."""
    return {module.name: names for module in all_modules() if module.is_face and (names := face_homes(module.source))}
