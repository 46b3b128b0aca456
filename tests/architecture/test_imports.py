"""Who may know whom: ARCHITECTURE.md's import contract, checked on the syntax trees."""

import ast
import json
from collections.abc import Iterable, Mapping

import pytest

from tests.architecture.source_tree import (
    PACKAGES,
    REPOSITORY,
    all_modules,
    faces,
    imports_of,
    instruments,
    is_numeric,
    owner,
)

#: What data_synth may know of an instrument: faces of rooms that describe things and estimate nothing.
DESCRIPTIONS = frozenset(
    {
        "calibration.camera",
        "calibration.heliostat",
        "calibration.heliostat.kinematic_model",
        "deflectometry.setup",
        "observer.trough",
        "photogrammetry.targets",
    }
)

#: Kernel modules that put instruments to work.
DEMONSTRATION = "heliogauge.running.demo"

#: Rooms of the kernel that open files or talk to people; numeric modules do without.
KERNEL_BORDER = ("files", "images", "measurement", "results", "reporting", "view", "running", "batch")
#: Modules of those rooms that hold values alone.
KERNEL_VALUES = frozenset({"heliogauge.running.progress", "heliogauge.running.threads"})

#: Outside libraries that have no business in a numeric module, with the reason.
BORDER_LIBRARIES = {
    "pathlib": "files belong to images, measurement, results, files, report, pipeline and cli",
    "os": "files and processes belong to the border",
    "shutil": "files belong to the border",
    "tomllib": "files belong to heliogauge.files",
    "logging": "the core neither logs nor prints; it returns values and raises errors",
    "matplotlib": "pictures of reports are stills; figures to be changed belong to heliogauge.reporting.canvas",
    "plotly": "figures belong to the report rooms",
    "rich": "the core never imports the terminal",
    "typer": "commands belong to cli modules",
    "h5py": "files belong to heliogauge.files and heliogauge.results",
    "h5netcdf": "files belong to heliogauge.results",
    "xarray": "files belong to heliogauge.results",
    "pydantic": "validated files belong to keys",
}

#: Too slow to import for a program that answers within a second: only inside the function that needs it.
LAZY_LIBRARIES = {
    "scipy": "scipy.optimize costs 0.6 s",
    "skimage": "skimage costs 0.4 s",
    "xarray": "xarray costs 0.5 s",
    "pandas": "pandas costs 0.6 s",
    "matplotlib": "matplotlib costs 0.4 s",
    "plotly": "plotly costs 0.3 s",
    "markdown_it": "markdown_it costs 0.1 s",
    "rich": "rich costs 0.1 s",
    "pvlib": "only tests use it",
    "open3d": "an optional extra",
    "pycolmap": "an optional extra",
    "rawpy": "an optional extra",
    "dask": "an optional extra",
    "distributed": "an optional extra",
}


#: The room of figures that a person changes or saves, and the libraries that only it may need.
CANVAS = "heliogauge.reporting.canvas"
PLOTTING = frozenset({"matplotlib", "contourpy", "PIL", "fontTools", "dateutil", "pyparsing", "kiwisolver"})


def breach(module: str, target: str) -> str:
    """Return why a module must not import a target; empty if it may."""
    own, other = owner(module), owner(target)
    if target.split(".")[0] in PACKAGES and own != other and other != "heliogauge":
        if own == "heliogauge" and module != DEMONSTRATION:
            return "the kernel knows no instrument; heliogauge.instruments finds them by name"
        if other == "data_synth" and module != DEMONSTRATION:
            return "an estimator that knows the simulation can be tuned to it; only tests and the demo use data_synth"
        home, _, name = target.rpartition(".")
        if own == "data_synth" and not any(
            target == d or (home == d and name in faces().get(d, {})) or d.startswith(target + ".")
            for d in DESCRIPTIONS
        ):
            return (
                "synthetic data made with the estimator's own code would agree with its errors; draw it independently"
            )
        if not _is_of_a_face(target):
            return "instruments meet at their public faces: import a name that the package's or room's __init__ lists"
    if is_numeric(module):
        if (library := target.split(".")[0]) in BORDER_LIBRARIES:
            return f"numeric module: {BORDER_LIBRARIES[library]}"
        border = target.split(".")[:2]
        if (
            border[0] == "heliogauge"
            and border[-1] in KERNEL_BORDER
            and len(target.split(".")) > 2
            and not any(target == value or target.startswith(value + ".") for value in KERNEL_VALUES)
        ):
            return "numeric module: it takes values and returns values; files, figures and terminals are the border's"
    return ""


def _is_of_a_face(target: str) -> bool:
    """Whether a target is a package or room with a face, or a name that such a face lists."""
    home, _, name = target.rpartition(".")
    return target in faces() or target in PACKAGES or name in faces().get(home, {})


def test_imports_keep_the_contract() -> None:
    breaches = [
        f"{module.path}:{found.line}: {module.name} imports {found.target}: {reason}"
        for module in all_modules()
        for found in imports_of(module.tree)
        if (reason := breach(module.name, found.target))
    ]
    assert not breaches, "\n".join(breaches)


def _outside_imports() -> Iterable[tuple[str, str]]:
    """Yield file and target of each import in benchmarks, docs and notebooks."""
    for file in [*(REPOSITORY / "benchmarks").glob("*.py"), REPOSITORY / "docs" / "conf.py"]:
        for found in imports_of(ast.parse(file.read_text(encoding="utf-8"))):
            yield file.name, found.target
    for file in [*(REPOSITORY / "notebooks").glob("*.ipynb")]:
        for cell in json.loads(file.read_text(encoding="utf-8"))["cells"]:
            if cell["cell_type"] == "code":
                # Lines for the shell are no Python.
                lines = [line for line in cell["source"] if not line.startswith("!")]
                for found in imports_of(ast.parse("".join(lines))):
                    yield file.name, found.target


def test_benchmarks_docs_and_notebooks_use_faces() -> None:
    breaches = [
        f"{file} imports {target}: use a name that a public face lists"
        for file, target in _outside_imports()
        if owner(target) in {*instruments(), "calibration", "data_synth"} and not _is_of_a_face(target)
    ]
    assert not breaches, "\n".join(breaches)


def test_slow_libraries_are_imported_where_they_are_used() -> None:
    # Figures and reports exist to use these; nobody imports them without wanting a figure.
    breaches = [
        f"{module.path}:{found.line}: import {found.target} inside the function that needs it: {LAZY_LIBRARIES[top]}"
        for module in all_modules()
        if not {"reporting", "report", "view"}.intersection(module.name.split(".")) and "figures" not in module.name
        for found in imports_of(module.tree)
        if found.at_import_time and (top := found.target.split(".")[0]) in LAZY_LIBRARIES
    ]
    assert not breaches, "\n".join(breaches)


def test_one_room_needs_matplotlib_and_only_views_that_draw_figures_open_it() -> None:
    """What ``pip install heliogauge`` brings measures and reports without it; its extra is ``plots``."""
    imports = [(module.name, found) for module in all_modules() for found in imports_of(module.tree)]
    needed = {name for name, found in imports if found.target.split(".")[0] in PLOTTING and found.at_import_time}
    assert needed == {CANVAS}
    views = {f"heliogauge.view.{kind}" for kind in ("charts", "maps", "photos", "scenes")}
    opening = {name for name, found in imports if found.target.startswith(CANVAS) and name != CANVAS}
    assert opening == views
    assert not [name for name, found in imports if found.target.startswith(CANVAS) and found.at_import_time]
    # Others name its figures in annotations alone.
    named = {name for name, found in imports if found.target.split(".")[0] in PLOTTING} - {CANVAS}
    assert named == views | {"heliogauge.results.opened", "heliogauge.view.markup"}


@pytest.mark.parametrize(
    ("module", "target", "allowed"),
    [
        ("deflectometry.shape.smooth_shape", "heliogauge.camera.model", True),
        ("deflectometry.shape.smooth_shape", "deflectometry.setup.camera_and_screen", True),
        ("deflectometry.shape.smooth_shape", "calibration.screen.response", False),
        ("deflectometry.pipeline.measure", "calibration.screen.response.ScreenResponse", False),
        ("deflectometry.pipeline.measure", "calibration.screen", True),
        ("deflectometry.shape.smooth_shape", "data_synth.fringes", False),
        ("heliogauge.camera.model", "deflectometry.setup", False),
        ("heliogauge.running.cli", "deflectometry.cli", False),
        ("heliogauge.running.demo", "deflectometry", True),
        ("heliogauge.running.demo", "deflectometry.pipeline.measure.run", False),
        ("data_synth.fringes.scene", "deflectometry.setup", True),
        ("data_synth.fringes.scene", "deflectometry.shape.smooth_shape", False),
        ("data_synth.fringes.scene", "calibration.screen", False),
        ("observer.planning.photo_network", "photogrammetry.bundle.adjustment", False),
        ("observer.planning.photo_network", "photogrammetry.bundle", True),
        ("heliogauge.camera.model", "pathlib", False),
        ("heliogauge.camera.model", "matplotlib.pyplot", False),
        ("heliogauge.camera.model", "heliogauge.results.folder", False),
        ("observer.slopes.row_spline", "heliogauge.results.json_file.read_json", False),
        ("observer.slopes.row_spline", "heliogauge.running.progress.Progress", True),
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
        ("a", True),
        ("b", False),
        ("c", False),
        ("c.d", False),
        ("e", True),
        ("g", True),
        ("h", True),
    }


def circles(graph: Mapping[str, Iterable[str]]) -> list[list[str]]:
    """Return the groups of nodes that reach each other (Tarjan's strongly connected components, by two searches)."""
    reach: dict[str, set[str]] = {}
    for start in graph:
        seen: set[str] = set()
        waiting = list(graph[start])
        while waiting:
            node = waiting.pop()
            if node not in seen:
                seen.add(node)
                waiting.extend(graph.get(node, ()))
        reach[start] = seen
    groups = {tuple(sorted(b for b in reach[a] if a in reach.get(b, ()))) for a in graph if a in reach[a]}
    return [list(group) for group in sorted(groups)]


def _graph(*, by_owner: bool) -> dict[str, set[str]]:
    # A face loads its modules when asked, and every module loads the faces above it: no circle.
    names = {module.name for module in all_modules() if not module.is_face}
    graph: dict[str, set[str]] = {}
    for module in all_modules():
        here = owner(module.name) if by_owner else module.name
        for found in imports_of(module.tree):
            if by_owner and module.name != DEMONSTRATION and found.target.split(".")[0] in PACKAGES:
                graph.setdefault(here, set()).update({owner(found.target)} - {here})
            elif not by_owner and found.target in names - {here} and not module.is_face:
                # Also what is imported inside a function: it ties two modules as closely.
                graph.setdefault(here, set()).add(found.target)
    return graph


@pytest.mark.parametrize("by_owner", [False, True], ids=["modules", "packages"])
def test_nothing_imports_in_a_circle(by_owner: bool) -> None:
    assert circles(_graph(by_owner=by_owner)) == []


def test_circles_are_found() -> None:
    """Negative control."""
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}}) == [["b", "c"]]
