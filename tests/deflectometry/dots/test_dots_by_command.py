"""Photos of marked dots through the command: a result, a result with a warning, or one sentence."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data_synth.dots import DotScene, write_dot_dataset
from data_synth.fringes.presets import FULL_CAMERA, facet_scene, rectangle, standard_errors
from data_synth.optics.mirror import Design, SyntheticFacet
from heliogauge.results.tables import read_number_columns, write_table_csv
from heliogauge.validate import FloatArray

pytestmark = pytest.mark.slow

COLUMNS = ("column", "row", "x_m", "y_m", "z_m", "radius_m")


@pytest.fixture(scope="module")
def scene() -> DotScene:
    """Return a facet of 0.5 m that shows 16 x 16 dots."""
    facet = SyntheticFacet(
        "facet", rectangle(0.5, 0.5), Design("paraboloid", {"focal_length_m": 60.0}), standard_errors(0.5, 0.5)
    )
    return DotScene(facet_scene("facet of 0.5 m", (facet,), camera=FULL_CAMERA.scaled(0.5)), told_by="marked")


@pytest.fixture(scope="module")
def folder(scene: DotScene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("marked") / "in"
    write_dot_dataset(folder, scene)
    return folder


def _measured(folder: Path) -> tuple[int, str, dict[str, dict[str, float]]]:
    """Run the command; return its exit code, its words and the numbers of each doubt by its code."""
    out = folder.with_name(f"{folder.name}-out")
    command = [sys.executable, "-m", "heliogauge", "deflectometry", "measure", str(folder), "-o", str(out)]
    done = subprocess.run([*command, "--no-report", "-q"], capture_output=True, text=True, check=False)
    if done.returncode:
        assert not out.exists()
        return done.returncode, done.stderr, {}
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    return 0, summary["texts"]["pattern"], {one["code"]: one["numbers"] for one in summary["doubts"]}


def _with_table(folder: Path, out: Path, change: str) -> Path:
    """Copy a measurement with another table of its dots."""
    out.mkdir()
    for name in ("photo.png", "measurement.toml"):
        (out / name).write_bytes((folder / name).read_bytes())
    column, row, x, y, z, radius = read_number_columns(folder / "dots.csv", COLUMNS)
    by_number: dict[tuple[float, float], float] = dict(zip(zip(column, row, strict=True), radius, strict=True))
    if change == "mirrored":
        across = column.min() + column.max() - column
        radius = np.array([by_number[one] for one in zip(across, row, strict=True)])
    elif change == "other pattern":
        radius = np.random.default_rng(0).permutation(radius)
    elif change == "other wall":
        x, y = 1.25 * x, 1.25 * y
    values: tuple[FloatArray, ...] = (x, y, z, radius)
    numbers = {"column": column.astype(int), "row": row.astype(int)}
    write_table_csv(out / "dots.csv", numbers | dict(zip(COLUMNS[2:], values, strict=True)))
    return out


def test_marked_dots_are_measured_where_half_of_them_are_hidden(scene: DotScene, tmp_path: Path) -> None:
    write_dot_dataset(tmp_path / "half", replace(scene, hidden=0.5))
    code, said, doubts = _measured(tmp_path / "half")
    assert code == 0
    assert "slopes and the sizes of the dots, probability 1" in said
    assert "mirror_without_dots" in doubts
    assert "dot_origin_open" not in doubts


@pytest.mark.parametrize(
    ("change", "words"), [("mirrored", "seen mirrored"), ("other pattern", "fit no place in pattern.marks_file")]
)
def test_a_print_that_is_another_is_refused_in_one_sentence(
    folder: Path, tmp_path: Path, change: str, words: str
) -> None:
    code, said, _ = _measured(_with_table(folder, tmp_path / "in", change))
    assert code == 2
    sentence, *rest = said.strip().splitlines()
    assert words in sentence
    assert all(one.startswith("what was seen: ") for one in rest)


def test_a_wall_of_another_size_is_named(folder: Path, tmp_path: Path) -> None:
    code, said, doubts = _measured(_with_table(folder, tmp_path / "in", "other wall"))
    assert code == 2 or {"slopes_of_no_surface", "setup_contradicts_slopes", "slopes_too_far_off_design"} & set(doubts)
    assert said


def test_a_table_without_sizes_is_refused(folder: Path, tmp_path: Path) -> None:
    wrong = _with_table(folder, tmp_path / "in", "")
    table = wrong / "dots.csv"
    table.write_text(table.read_text(encoding="utf-8").replace("radius_m", "size_m"), encoding="utf-8")
    code, said, _ = _measured(wrong)
    assert code == 2
    assert "radius_m" in said
