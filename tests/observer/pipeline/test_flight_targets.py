"""Through the command line: absorber photos with few codes, exchanged entries, several kinds of targets."""

import csv
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from data_synth.troughs import TroughChoice, TroughOptions, read_trough_truth, trough_scene, write_trough_dataset
from heliogauge.results.folder import read_summary
from heliogauge.running.cli import app

MIXED = "aicon-12+circles+DICT_4X4_50"
FEW_CODES = "+".join(["aicon-12", *["circles"] * 5])


def drawn(folder: Path, preset: str, dictionary: str) -> Path:
    write_trough_dataset(folder, trough_scene(preset, TroughChoice(1, dictionary=dictionary)), TroughOptions(1))
    return folder


def heliogauge(*arguments: str | Path) -> None:
    result = CliRunner().invoke(app, [str(one) for one in (*arguments, "-q")])
    assert result.exit_code == 0, result.output


def exchange(path: Path, first: int, second: int) -> tuple[str, str]:
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    one, other = rows[first], rows[second]
    for axis in ("x_m", "y_m", "z_m"):
        one[axis], other[axis] = other[axis], one[axis]
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return one["target"], other["target"]


@pytest.mark.slow
def test_absorber_from_photos_with_too_few_codes_for_their_pose(tmp_path):
    """Two codes and ten dots: all twelve are used. Rings that were read in clutter had both codes lost."""
    folder, out = drawn(tmp_path / "flight", "absorber", FEW_CODES), tmp_path / "out"
    heliogauge("observer", "absorber", folder, "-o", out)
    summary = read_summary(out / "summary.json")
    codes = [one.code for one in summary.doubts]
    assert "photos_placed_by_list" in codes
    assert "known_values_not_used" not in codes
    truth = read_trough_truth(folder)
    with (out / "absorber.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["x_a_m"]]
    y, x, z = (np.array([float(row[name]) for row in rows]) for name in ("y_m", "x_a_m", "z_a_m"))
    assert len(rows) > 15
    # Two photos and twelve targets known to 1 mm: 0.3 and 0.4 mm.
    assert abs(np.mean(x - np.interp(y, truth.absorber_y_m, truth.absorber_x_m))) < 1.2e-3
    assert abs(np.mean(z - np.interp(y, truth.absorber_y_m, truth.absorber_z_m))) < 1.6e-3


@pytest.mark.slow
def test_mixed_targets_with_two_exchanged_entries(tmp_path):
    folder = drawn(tmp_path / "flight", "small", MIXED)
    first, second = exchange(folder / "targets.csv", 0, 12)
    heliogauge("observer", "measure", folder, "-o", tmp_path / "out")
    summary = read_summary(tmp_path / "out" / "summary.json")
    [said] = [one for one in summary.doubts if one.code == "targets_exchanged"]
    assert f"exchanged in the list: {first} and {second};" in said.text
    innocent = ("targets_not_where_listed", "known_value_contradicts", "known_place_contradicts")
    assert not [one for one in summary.doubts if one.code in innocent]
    with (tmp_path / "out" / "points.csv").open(newline="") as file:
        points = {row["id"]: row for row in csv.DictReader(file)}
    truth = read_trough_truth(folder).parameters["points_m"]
    assert set(points) == set(truth)
    for name, row in points.items():
        off = np.array([float(row[f"{axis}_m"]) for axis in "xyz"]) - truth[name]
        assert np.linalg.norm(off) < 3e-3  # A list of 1 mm holds the frame.
