"""Nothing is executed out of a folder of data: files with the names of modules, and settings, lie there unused."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from heliogauge.results.json_file import read_json

#: Names that somebody imports: Python's own, libraries, our packages, and what Python looks for when it starts.
NAMES = (
    *sorted(name for name in sys.stdlib_module_names if not name.startswith("_")),
    *("numpy", "scipy", "cv2", "h5py", "pydantic", "typer", "click", "rich", "matplotlib", "xarray", "h5netcdf"),
    *("pandas", "shellingham", "typing_extensions", "annotated_types", "pydantic_core", "markdown_it", "contourpy"),
    *("calibration", "observer", "deflectometry", "photogrammetry", "data_synth", "report", "conftest"),
    *("sitecustomize", "usercustomize", "evil"),
)


@pytest.fixture(scope="module")
def field(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A measurement of three heliostats."""
    from data_synth.preset_folders import heliostat

    folder: Path = tmp_path_factory.mktemp("planted") / "field"
    heliostat(folder)
    return folder


def plant(folder: Path) -> None:
    """Put files into a folder that leave a mark where they are executed."""
    for name in NAMES:
        mark = f"open({str(folder / f'executed-{name}')!r}, 'w').close()\n"
        (folder / f"{name}.py").write_text(mark, encoding="utf-8")
    (folder / "x.pth").write_text(f"import pathlib; pathlib.Path({str(folder / 'executed-pth')!r}).touch()\n")
    (folder / "matplotlibrc").write_bytes(b"backend: module://evil\nfont.size: 99\n\xff\xfe\n")
    (folder / "x.mplstyle").write_text("backend: module://evil\n")
    notebook = '{"cells": [{"cell_type": "code", "source": ["import evil"], "metadata": {}, "outputs": []}]}'
    (folder / "report.ipynb").write_text(notebook)


def run(folder: Path, *words: str, path: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": path}
    command = [sys.executable, "-m", "heliogauge", *words]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=120
    )


def executed(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.glob("executed-*"))


def test_planted_files_do_leave_marks(tmp_path: Path) -> None:
    """Negative control."""
    plant(tmp_path)
    subprocess.run([sys.executable, "-c", "import numpy, observer"], cwd=tmp_path, check=False)
    assert {"executed-numpy", "executed-observer"} <= set(executed(tmp_path))


@pytest.mark.slow
@pytest.mark.parametrize("end", ["", os.pathsep], ids=["path", "path with a colon at its end"])
def test_commands_in_a_folder_of_data(field: Path, tmp_path: Path, repository: Path, end: str) -> None:
    if end:
        # Python starts with the working folder in its path then, before any program of ours.
        names = set(sys.stdlib_module_names) | {"sitecustomize", "usercustomize"}
    else:
        names = set()
    folder = Path(shutil.copytree(field, tmp_path / "field"))
    plant(folder)
    for name in names:
        (folder / f"{name}.py").unlink(missing_ok=True)
    path = f"{repository}{end}"
    answer = run(folder, "heliostat", "measure", ".", "-o", "out", "--jobs", "2", "--quick", "-q", path=path)
    assert answer.returncode == 0, answer.stderr
    assert read_json(folder / "out" / "summary.json")["kind"]
    plant(folder / "out")
    for name in names:
        (folder / "out" / f"{name}.py").unlink(missing_ok=True)
    answer = run(folder / "out", "report", ".", path=path)
    assert answer.returncode == 0, answer.stderr
    assert executed(folder) == executed(folder / "out") == []


def test_processes_of_workers(tmp_path: Path, repository: Path) -> None:
    plant(tmp_path)
    program = (
        "from heliogauge.running.scale import Workers, run_each, usable_processors\n"
        "from heliogauge.validate import positive\n"
        "done = run_each(max, 1, [2, 3], workers=Workers(), processes=2)\n"
        "print(sorted(one.outcome for one in done))\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(repository)}
    command = [sys.executable, "-P", "-c", program]
    answer = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False, timeout=60
    )
    assert answer.stdout == "[2, 3]\n", answer.stderr
    assert executed(tmp_path) == []
