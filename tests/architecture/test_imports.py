"""Who may know whom: ARCHITECTURE.md's import contract, checked on the syntax trees."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.architecture.source_tree import NUMERIC_MODULES, PACKAGES, Module, all_modules

#: What data_synth may know of an instrument: modules that describe things and estimate nothing.
DESCRIPTIONS = frozenset(
    {
        "calibration.camera.boards",
        "photogrammetry.targets.coded_targets",
        "deflectometry.setup.patterns",
        "deflectometry.setup.bench",
        "observer.trough.collector",
        "calibration.heliostat.kinematic_model.design",
        "calibration.heliostat.kinematic_model.parameters",
        "calibration.heliostat.kinematic_model.presets",
    }
)

#: Kernel modules that stand at the level of a pipeline because they put instruments to work.
PIPELINE_LEVEL = {"heliogauge.running.demo": "the demo makes synthetic data and measures them, so it knows both sides"}

#: Parts of the kernel that open files or talk to people; numeric modules do without.
BORDER = frozenset({
    "heliogauge.images.photos", "heliogauge.measurement.load", "heliogauge.measurement.models", "heliogauge.measurement.writer",
    "photogrammetry.keys.measurement",
    "heliogauge.measurement.templates", "heliogauge.results.whole_folder", "heliogauge.results.folder", "heliogauge.reporting.figures", "heliogauge.reporting.build",
    "heliogauge.running.terminal", "heliogauge.running.commands", "heliogauge.running.cli", "heliogauge.running.demo",
})  # fmt: skip

#: Outside libraries that have no business in a numeric module, with the reason.
BORDER_LIBRARIES = {
    "pathlib": "files belong to images, measurement, store, report, pipeline and cli",
    "os": "files and processes belong to the border",
    "shutil": "files belong to the border",
    "tomllib": "measurement files belong to heliogauge.measurement.load",
    "logging": "the core neither logs nor prints; it returns values and raises errors",
    "matplotlib": "figures belong to heliogauge.reporting.figures",
    "plotly": "figures belong to heliogauge.reporting.figures",
    "rich": "the core never imports the terminal",
    "typer": "commands belong to cli modules",
    "h5py": "files belong to heliogauge.results.folder and readers",
    "h5netcdf": "files belong to heliogauge.results.folder",
    "xarray": "files belong to heliogauge.results.folder",
    "pydantic": "validated files belong to heliogauge.measurement.models",
}

#: Too slow to import for a program that answers within a second: only inside the function that needs it.
LAZY_LIBRARIES = {
    "scipy": "scipy.optimize costs 0.6 s",
    "skimage": "skimage costs 0.4 s",
    "xarray": "xarray costs 0.5 s",
    "matplotlib": "matplotlib costs 0.4 s",
    "plotly": "plotly costs 0.3 s",
    "nbclient": "nbclient costs 0.4 s",
    "nbconvert": "nbconvert costs 0.5 s",
    "nbformat": "nbformat costs 0.2 s",
    "rich": "rich costs 0.1 s",
    "pvlib": "pvlib loads pandas: 0.8 s",
    "open3d": "an optional extra",
    "pycolmap": "an optional extra",
    "rawpy": "an optional extra",
    "dask": "an optional extra",
    "distributed": "an optional extra",
}


@dataclass(frozen=True)
class Import:
    """One import statement's target: as a module path, and whether it runs when the module is imported."""

    target: str
    line: int
    at_import_time: bool


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


def breach(module: str, target: str) -> str:
    """Return why a module must not import a target; empty if it may."""
    own, other = module.split(".")[0], target.split(".")[0]
    last = module.split(".")[-1]
    # A pipeline that does not fit on a page is split into pipeline_*.py.
    is_pipeline = last in {"pipeline", "cli"} or last.startswith("pipeline_") or module in PIPELINE_LEVEL
    if other in PACKAGES and other != own and other != "heliogauge":
        if own == "data_synth" and any(target == d or target.startswith(d + ".") for d in DESCRIPTIONS):
            return ""
        if own == "data_synth" and not any(d.startswith(target + ".") or d == target for d in DESCRIPTIONS):
            return (
                "synthetic data made with the estimator's own code would agree with its errors; draw it independently"
            )
        if other == "data_synth" and module not in PIPELINE_LEVEL:
            return "an estimator that knows the simulation can be tuned to it; only tests and the demo use data_synth"
        if own == "heliogauge" and module not in PIPELINE_LEVEL:
            return "the kernel knows no instrument; heliogauge.running.cli mounts packages by name"
        if own not in {"data_synth", "heliogauge"} and not is_pipeline:
            return "packages meet only in a pipeline.py; pass values in instead"
    if module in NUMERIC_MODULES:
        if other in BORDER_LIBRARIES:
            return f"numeric module: {BORDER_LIBRARIES[other]}"
        if any(target == b or target.startswith((b + ".", b + "_")) for b in BORDER):
            return "numeric module: it takes values and returns values; files, figures and terminals are the border's"
    return ""


@pytest.mark.parametrize("module", all_modules(), ids=str)
def test_imports_keep_the_contract(module: Module) -> None:
    breaches = [
        f"{module.path}:{found.line}: {module.name} imports {found.target}: {reason}"
        for found in imports_of(module.tree)
        if (reason := breach(module.name, found.target))
    ]
    assert not breaches, "\n".join(breaches)


@pytest.mark.parametrize("module", all_modules(), ids=str)
def test_slow_libraries_are_imported_where_they_are_used(module: Module) -> None:
    # figures and reports exist to use these; nobody imports them without wanting a figure.
    figures = module.name.startswith(("heliogauge.reporting.figures", "heliogauge.reporting.build"))
    breaches = [
        f"{module.path}:{found.line}: import {found.target} inside the function that needs it: {LAZY_LIBRARIES[top]}"
        for found in imports_of(module.tree)
        if found.at_import_time and (top := found.target.split(".")[0]) in LAZY_LIBRARIES and not figures
    ]
    assert not breaches, "\n".join(breaches)


@pytest.mark.parametrize(
    ("module", "target", "allowed"),
    [
        ("deflectometry.shape.slopes", "heliogauge.camera.model", True),
        ("deflectometry.shape.slopes", "deflectometry.setup.bench", True),
        ("deflectometry.shape.slopes", "calibration.screen.response", False),
        ("deflectometry.pipeline.measure", "calibration.screen.response", True),
        ("deflectometry.shape.slopes", "data_synth.fringes.truth", False),
        ("deflectometry.pipeline.measure", "data_synth.fringes.truth", False),
        ("heliogauge.camera.model", "deflectometry.setup.bench", False),
        ("heliogauge.running.cli", "deflectometry.cli", False),
        ("heliogauge.running.demo", "data_synth.fringes.dataset", True),
        ("heliogauge.running.demo", "deflectometry.pipeline.measure", True),
        ("data_synth.fringes.scene", "deflectometry.setup.patterns", True),
        ("data_synth.fringes.scene", "deflectometry.setup.patterns.make_pattern", True),
        ("data_synth.fringes.scene", "deflectometry", True),
        ("data_synth.fringes.scene", "deflectometry.shape.slopes", False),
        ("data_synth.fringes.scene", "calibration.screen.response", False),
        ("heliogauge.camera.model", "pathlib", False),
        ("heliogauge.camera.model", "matplotlib.pyplot", False),
        ("heliogauge.camera.model", "heliogauge.results.folder", False),
        ("heliogauge.camera.model", "heliogauge.results.json_file.read_json", False),
        ("heliogauge.results.folder", "pathlib", True),
    ],
)
def test_the_contract_itself(module: str, target: str, allowed: bool) -> None:
    """Negative controls: a contract that forbids nothing would pass on everything."""
    assert (breach(module, target) == "") is allowed


def test_imports_are_found_wherever_they_stand() -> None:
    source = """
import a
if TYPE_CHECKING:
    import b
def f():
    from c import d
try:
    import e
except ImportError:
    import g
class K:
    import h
"""
    found = {(item.target, item.at_import_time) for item in imports_of(ast.parse(source))}
    assert found == {
        ("a", True), ("b", False), ("c", False), ("c.d", False), ("e", True), ("g", True), ("h", True),
    }  # fmt: skip


def test_no_module_imports_itself_in_a_circle() -> None:
    """Every module can be the first one that is imported."""
    names = [module.name for module in all_modules() if not module.name.endswith("__main__")]
    program = """
import sys, importlib
for name in sys.argv[1:]:
    for loaded in [m for m in sys.modules if m.split(".")[0] in %r]:
        del sys.modules[loaded]
    importlib.import_module(name)
""" % (PACKAGES,)  # noqa: UP031  (braces are code here)
    answer = subprocess.run(
        [sys.executable, "-c", program, *names],
        capture_output=True, text=True, check=False, cwd=Path(__file__).parents[2],
    )  # fmt: skip
    assert answer.returncode == 0, answer.stderr
