"""What ``pip install heliogauge`` brings along: a list that grows on purpose only, enough for all instruments."""

import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, packages_distributions, requires

import pytest

from tests.architecture.source_tree import REPOSITORY, all_modules

#: Packages of the core with what each is for. A new one costs everybody: CONTRIBUTING says what belongs in an extra.
CORE = {
    "numpy": "arrays",
    "scipy": "solvers, sparse matrices, filters",
    "opencv-contrib-python-headless": "images, markers, video",
    "scikit-image": "image operations that OpenCV lacks",
    "h5py": "slope maps",
    "pydantic": "measurement files",
    "tomlkit": "measurement files, written",
    "typer": "the command line",
    "rich": "bars of progress; typer needs it anyway",
    "markdown-it-py": "texts of reports; rich needs it anyway",
}

PROGRAM = """
import sys
from importlib import import_module
from pathlib import Path

blocked = set(sys.argv[2].split(","))


class OnlyTheCore:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in blocked:
            raise ModuleNotFoundError(f"No module named {name!r} (not in the core)", name=name)


sys.meta_path.insert(0, OnlyTheCore())
for module in sys.argv[3].split(","):
    import_module(module)

import heliogauge as hg
from heliogauge.errors import InputError

folder = hg.synth("heliostat", Path(sys.argv[1]) / "field")
result = hg.measure(folder, thorough=False, jobs=1, report=True)
assert (result.folder / "report.html").is_file()
try:
    result.tables["field"]
except InputError as error:
    print(error)
try:
    result.plot()
except InputError as error:
    print(error)
"""


def core_distributions() -> set[str]:
    """Names of the packages of the core and all that they need here."""
    found: set[str] = set()
    waiting = list(CORE)
    while waiting:
        name = canonical(waiting.pop())
        if name not in found:
            found.add(name)
            waiting += needed(name)
    return found


def needed(name: str) -> Iterator[str]:
    try:
        every = requires(name) or []
    except PackageNotFoundError:
        # Another build of the same library is installed here, such as OpenCV with its contributed modules.
        return
    for one in every:
        if "extra ==" not in one:
            yield re.split(r"[^A-Za-z0-9._-]", one.strip(), maxsplit=1)[0]


def canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def test_the_core_is_this_list() -> None:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    names = {canonical(re.split(r"[^A-Za-z0-9._-]", one, maxsplit=1)[0]) for one in project["dependencies"]}
    assert names == set(CORE)
    extras = {extra for extra in project["optional-dependencies"] if extra not in {"all", "bench", "dev", "docs"}}
    (every,) = project["optional-dependencies"]["all"]
    assert set(re.findall(r"\[(.*)\]", every)[0].split(",")) == extras


def test_the_page_lists_the_core_beside_a_build_of_opencv_that_is_kept() -> None:
    page = (REPOSITORY / "docs/howto/install.md").read_text(encoding="utf-8")
    (listed,) = re.findall(r"^pip install (numpy .*)$", page, re.MULTILINE)
    names = {canonical(re.split(r"[^A-Za-z0-9._-]", one.strip("'"), maxsplit=1)[0]) for one in listed.split()}
    assert names == set(CORE) - {"opencv-contrib-python-headless"}


@pytest.mark.slow
def test_the_core_is_enough(tmp_path) -> None:
    """All modules import, a field is calibrated with its report, and what needs an extra says so."""
    core = core_distributions()
    blocked = {
        module
        for module, distributions in packages_distributions().items()
        if not core & {canonical(one) for one in distributions} and module not in {"heliogauge", "cv2"}
    } - {module.name.partition(".")[0] for module in all_modules()}
    assert {"matplotlib", "pandas", "pvlib", "xarray"} <= blocked
    left_out = {"heliogauge.reporting.canvas"}
    names = {module.name for module in all_modules() if not module.name.endswith("__main__")}
    assert left_out < names
    modules = sorted(names - left_out)
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(tmp_path), ",".join(sorted(blocked)), ",".join(modules)],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
        env={"PYTHONPATH": str(REPOSITORY), "PATH": ""},
    )
    assert done.returncode == 0, done.stderr
    assert "pip install 'heliogauge[notebook]'" in done.stdout
    assert "pip install 'heliogauge[plots]'" in done.stdout
