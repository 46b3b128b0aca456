"""Validation of the absorber's position: refraction's share (V2), and the thesis's set-up by ray-traced photos (V4)."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from data_synth.troughs.dataset import read_trough_truth
from heliogauge.results.tables import read_table_csv
from heliogauge.running.cli import app

OUTER_M, INNER_M, INDEX, RADIUS_M = 0.115 / 2, 0.109 / 2, 1.47, 0.035


def refracted(direction: np.ndarray, normal: np.ndarray, ratio: float) -> np.ndarray:
    """Return a unit ray behind a face whose normal looks against it; ratio: index before over index behind."""
    cos_in = -direction @ normal
    cos_out = np.sqrt(1 - ratio**2 * (1 - cos_in**2))
    return np.asarray(ratio * direction + (ratio * cos_in - cos_out) * normal)


def distance_within(eye: np.ndarray, angle: float, axis: np.ndarray) -> float:
    """Follow a ray through the glass around the origin; return how far beside an axis it passes, signed."""
    place, ray = eye, np.array([np.sin(angle), -np.cos(angle)])
    for radius, ratio in ((OUTER_M, 1 / INDEX), (INNER_M, INDEX)):
        along = place @ ray
        place = place + ray * (-along - np.sqrt(along**2 - place @ place + radius**2))
        ray = refracted(ray, place / radius, ratio)
    return float((axis - place)[0] * ray[1] - (axis - place)[1] * ray[0])


def bisector(eye: np.ndarray, axis: np.ndarray) -> float:
    """Return the middle of the two directions in which the metal's edges are seen."""
    towards = np.arctan2(axis[0] - eye[0], eye[1] - axis[1])
    edges = []
    for side in (1.0, -1.0):
        low, high = towards, towards + side * 1.25 * RADIUS_M / np.hypot(*(axis - eye))
        for _ in range(60):
            middle = 0.5 * (low + high)
            if abs(distance_within(eye, middle, axis)) < RADIUS_M:
                low = middle
            else:
                high = middle
        edges.append(low)
    return float(np.mean(edges))


@pytest.mark.parametrize(("displaced_m", "largest_m"), [((0.0, 0.0), 1e-9), ((3e-3, -5e-3), 1e-4)])
def test_refraction_displaces_the_absorber_by_less_than_a_tenth_of_a_millimetre(
    displaced_m: tuple[float, float], largest_m: float
) -> None:
    # V2: cameras at (-7, 7) and (7, 7) m, the focal line at 1.49 m, the glass around it.
    axis = np.array(displaced_m)
    eyes = [np.array([x, 7.0 - 1.49]) for x in (-7.0, 7.0)]
    rows, values = [], []
    for eye in eyes:
        angle = bisector(eye, axis)
        across = np.array([np.cos(angle), np.sin(angle)])
        rows.append(across)
        values.append(across @ eye)
    found = np.linalg.solve(np.array(rows), np.array(values))
    assert np.abs(found - axis).max() < largest_m


@pytest.mark.slow
def test_two_photos_of_the_thesis_give_the_absorber_within_half_a_millimetre(tmp_path: Path) -> None:
    folder, out = tmp_path / "absorber", tmp_path / "result"
    made = CliRunner().invoke(app, ["observer", "synth", str(folder), "--preset", "absorber", "-q"])
    assert made.exit_code == 0, made.output
    done = CliRunner().invoke(app, ["observer", "absorber", str(folder), "-o", str(out), "-q"])
    assert done.exit_code == 0, done.output
    truth = read_trough_truth(folder)
    table = read_table_csv(out / "absorber.csv")
    seen = [k for k, cell in enumerate(table["x_a_m"]) if cell]
    # 33 stations every 0.25 m; three supports, whose images reach 0.25 m beyond them, hide seven.
    assert len(seen) == 26
    assert {table["reason"][k] for k in range(33) if k not in seen} == {"hidden by a receiver support"}
    columns = {name: np.array([float(table[name][k]) for k in seen]) for name in ("y_m", "x_a_m", "z_a_m")}
    for axis in "xz":
        true = np.interp(columns["y_m"], truth.absorber_y_m, getattr(truth, f"absorber_{axis}_m"))
        assert np.sqrt(np.mean((columns[f"{axis}_a_m"] - true) ** 2)) < 0.5e-3
    for cell, sigma in zip(
        *(read_table_csv(out / "absorber_spans.csv")[name] for name in ("sag_down_m", "sigma_sag_down_m")), strict=True
    ):
        assert abs(float(cell) - 4e-3) < 3 * float(sigma) < 2e-3
