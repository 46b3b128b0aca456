"""What a user installs: the wheel holds the six packages and nothing else."""

import os
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from tests.architecture.source_tree import PACKAGES

BUILD = """
import sys
from setuptools.build_meta import build_wheel
print(build_wheel(sys.argv[1]))
"""


@pytest.fixture(scope="module")
def names(tmp_path_factory: pytest.TempPathFactory, repository: Path) -> list[str]:
    """Names in the wheel, built in a copy of the tree so that no build folder is left behind."""
    tree = tmp_path_factory.mktemp("tree")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(repository / name, tree / name)
    # Things that lie around in a working tree must not slip in.
    for name in ("tests", "docs", "notebooks", "benchmarks", "demo-result"):
        (tree / name).mkdir()
        (tree / name / "__init__.py").touch()
    for package in PACKAGES:
        shutil.copytree(repository / package, tree / package, ignore=shutil.ignore_patterns("__pycache__"))
    target = tmp_path_factory.mktemp("wheel")
    answer = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", BUILD, str(target)],
        cwd=tree,
        env=os.environ | {"PYTHONPATH": ""},
        capture_output=True,
        text=True,
        check=False,
    )
    assert answer.returncode == 0, answer.stderr
    (wheel,) = target.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        return archive.namelist()


def test_top_level_is_the_six_packages(names: list[str]) -> None:
    top = {name.split("/")[0] for name in names if ".dist-info/" not in name}
    assert top == set(PACKAGES)


def test_every_module_notebook_and_template_is_in(names: list[str], repository: Path) -> None:
    wanted = {
        path.relative_to(repository).as_posix()
        for package in PACKAGES
        for pattern in ("*.py", "*.ipynb", "*.toml", "py.typed")
        for path in (repository / package).rglob(pattern)
        if ".ipynb_checkpoints" not in path.parts
    }
    missing = sorted(wanted - set(names))
    assert not missing, f"not in the wheel (is a new package missing in pyproject.toml?): {missing}"


def test_licence_and_command_are_in(names: list[str]) -> None:
    assert any(name.endswith("LICENSE") for name in names)
    assert any(name.endswith("entry_points.txt") for name in names)


def test_version_has_one_source(repository: Path) -> None:
    project = tomllib.loads((repository / "pyproject.toml").read_text(encoding="utf-8"))
    assert "version" in project["project"]["dynamic"]
    assert project["tool"]["setuptools"]["dynamic"]["version"] == {"attr": "heliogauge.__version__"}
