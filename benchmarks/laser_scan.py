"""A trough panel scanned by a laser (VSHOT), or swept by lines: slope errors, sigmas by position, what limits them.

Beside each stands the least that any evaluation could reach (`_laser_bound`); 0.1 mrad are asked.

Run ``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/laser_scan.py [SEEDS]``.
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from _laser_bound import least_sigmas
from _measure import row, title

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from data_synth.lasers import LaserScene, line_scene, write_laser_scan, write_line_sweep
from tests.deflectometry.laser.test_laser_scan import errors_of, measured

STATED = LaserScene(columns=41, rows=27)
SWEPT = replace(line_scene(), columns=41, rows=27)
COMMON = (
    "sigma_distance_m",
    "sigma_offset_m",
    "sigma_laser_place_m",
    "sigma_target_scale",
    "sigma_angle_scale",
    "sigma_roll_rad",
)
#: As good as exact.
NOTHING = 1e-9


def errors(scene: LaserScene, seeds: range) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return places (2, n), slope errors without their mean (2, n) and whole sigmas (2, n) of all scans."""
    places, found, sigmas = [], [], []
    for seed in seeds:
        with tempfile.TemporaryDirectory() as name:
            write = write_laser_scan if scene.distance_of_curvature == 1.0 else write_line_sweep
            write(Path(name) / "scan", scene, seed)
            result = measured(Path(name) / "scan")
        off, random, common = errors_of(result, scene)
        # The frame's tilt is free.
        found.append(off - off.mean(axis=1, keepdims=True))
        sigmas.append(np.sqrt(random**2 + (common**2).sum(axis=0)))
        places.append(result.found.points_m[:, result.flags == 0])
    return np.concatenate(places, axis=1), np.concatenate(found, axis=1), np.concatenate(sigmas, axis=1)


def rms(values: np.ndarray) -> str:
    return " / ".join(f"{1e3 * one:.3f}" for one in np.sqrt((values**2).mean(axis=1)))


def main() -> None:
    seeds = range(int(sys.argv[1]) if len(sys.argv) > 1 else 6)
    titles = ("x / y [mrad]", "sigma [mrad]", "least possible")
    title(f"Trough panel f = 1.71 m, 2.7 m wide, from 2 f, {len(seeds)} scans: RMS slope error", titles)
    exact = replace(STATED, **dict.fromkeys(COMMON, NOTHING))
    cases = {
        "set-up as stated": STATED,
        "distance known to 1 mm": replace(STATED, sigma_distance_m=1e-3),
        "everything but the spots known twice as well": replace(
            STATED, **{name: 0.5 * getattr(STATED, name) for name in COMMON}
        ),
        "spots and beams alone (0.5 mm, 0.02 mrad)": exact,
        "68 lines from 0.8 of 2 f, set-up as stated": SWEPT,
        "68 lines, points of lines and sheets alone": replace(SWEPT, **dict.fromkeys(COMMON, NOTHING)),
    }
    cases |= {
        f"the same and {name.removeprefix('sigma_')} off": replace(exact, **{name: getattr(STATED, name)})
        for name in COMMON
    }
    for words, scene in cases.items():
        at, off, sigma = errors(scene, seeds)
        # The bound is that of single beams.
        row(words, rms(off), rms(sigma), rms(least_sigmas(scene)) if scene.distance_of_curvature == 1.0 else "")
        if scene is not STATED:
            continue
        size = np.abs(at[0])
        for low, high in ((0.0, 0.45), (0.45, 0.9), (0.9, 1.4)):
            there = (size >= low) & (size < high)
            row(f"  {low:g} to {high:g} m from the vertex", rms(off[:, there]), rms(sigma[:, there]), "")


if __name__ == "__main__":
    main()
