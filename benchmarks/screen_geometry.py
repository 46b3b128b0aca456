"""Screens from photos: the published dot wall with its processor time, and drawn screens against their truth.

Run ``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/screen_geometry.py``; ``--wall`` stops after the wall.
"""

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import h5py
import numpy as np
from _measure import OPENCSP, StageClock, evaluation_inputs, row, title

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from data_synth.fringes import Knowledge, expected_light, preset_scene
from data_synth.screens import ScreenChoice, write_screen_dataset
from deflectometry.fringes import Observation, ScreenMapLimits
from deflectometry.pipeline import Choices, evaluate_source
from deflectometry.screen_geometry import load_screen, read_screen, run
from heliogauge.geometry.alignment import align_points
from heliogauge.running.progress import SilentProgress
from tests.deflectometry.screen_geometry.published_wall import write_published_wall

SEEDS = range(3)
#: From the mirror of the small drawn measurement to its camera and screen [m].
DISTANCE_M = float(np.linalg.norm(preset_scene("small").bench.cam_from_mirror.translation_m))


def command(folder: Path, out: Path) -> float:
    """Run the command and return its processor time [s]."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    words = [sys.executable, "-m", "heliogauge", "deflectometry", "screen", "geometry", str(folder), "-o", str(out)]
    subprocess.run(words, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return (after.ru_utime - before.ru_utime) + (after.ru_stime - before.ru_stime)


def published_wall(scratch: Path) -> None:
    if not OPENCSP.is_dir():
        print(f"no published data in {OPENCSP}")
        return
    folder = scratch / "wall"
    folder.mkdir()
    write_published_wall(OPENCSP / "screen_dots", folder)
    cpu = command(folder, scratch / "wall_out")
    start = time.process_time()
    for file in folder.glob("*.JPG"):
        cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    decode = time.process_time() - start
    clock = StageClock()
    run(load_screen(folder), clock)
    measured = read_screen(scratch / "wall_out")
    with h5py.File(OPENCSP / "screen_dots" / "expected_fixed_pattern_dot_locations.h5") as file:
        published = file["DotLocationsFixedPattern/xyz_dot_loc"][()]
        first = [int(file[f"DotLocationsFixedPattern/{axis}_dot_index"][0]) for axis in "xy"]
    rows, columns = np.mgrid[0:64, 0:64]
    away = measured.screen.xyz_m - published[-(31 - rows) - first[1], -(columns - 31) - first[0]]
    sigma = measured.sigma_points_m(columns / 63, rows / 63)
    own = measured.screen.sigma_at(columns / 63, rows / 63)

    def three(values: np.ndarray) -> str:
        return " / ".join(f"{1e3 * one:.2f}" for one in values)

    title("Published dot wall: 5 photos of 64 x 64 dots")
    row("dots with a place", f"{np.isfinite(away[..., 0]).sum()}", "4096", "4096")
    row("off the published places, RMS x / y / z [mm]", three(np.sqrt(np.nanmean(away**2, axis=(0, 1)))), "sigma", "")
    row("sigma x / y / z [mm]", three(np.sqrt(np.mean(sigma**2, axis=(0, 1)))), "", "none stated")
    row("of it each dot's own [mm]", three(np.sqrt(np.mean(own**2, axis=(0, 1)))), "", "")
    row("processor time of the command [s]", f"{cpu:.1f}", "1", "21")
    row("decoding the photos alone [s]", f"{decode:.2f}", "", "")
    for name, seconds in clock.cpu_s.items():
        row(f"  {name} [s]", f"{seconds:.2f}", "", "")


def drawn_screens(scratch: Path, show: str, noise_rad: float) -> None:
    """Compare points and measuring camera of drawn photos with the truth."""
    u, v = (one.ravel() for one in np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9)))
    ratios, errors, poses, slopes = [], [], [], []
    for seed in SEEDS:
        folder = scratch / f"{show}{seed}"
        drawn = write_screen_dataset(folder, ScreenChoice(show, seed))
        measured = run(load_screen(folder)).measured
        screen = measured.screen
        if show == "dots":
            line, column = np.nonzero(np.isfinite(screen.xyz_m[..., 0]))
            lines, columns = screen.shape
            u, v, found = column / (columns - 1), line / (lines - 1), screen.xyz_m[line, column]
            low, high = drawn.dots_m.min(axis=0), drawn.dots_m.max(axis=0)
            truth = drawn.shape.points_m(low + np.stack([u, 1 - v], axis=1) * (high - low))
        else:
            found = screen.points_m(u, v)
            truth = drawn.shape.points_m(np.stack([(u - 0.5) * drawn.size_m[0], (0.5 - v) * drawn.size_m[1]], axis=1))
        place = align_points(truth, found, with_scale=False).b_from_a
        error = found - place.apply(truth)
        bench = drawn.scene.views[-1].cam_from_world @ place.inverse()
        turn = measured.cam_from_screen @ bench.inverse()
        off = np.concatenate([turn.rotation_vector_rad, measured.cam_from_screen.translation_m - bench.translation_m])
        poses.append(off @ np.linalg.solve(measured.covariance_pose, off) / 6)
        errors.append(error)
        ratios.append(error / measured.sigma_points_m(u, v))
        # A source point that is off by e across turns a normal by half the angle under which the mirror sees it.
        slopes.append(error[:, :2] / (2 * DISTANCE_M))
    title(f"Drawn photos of a bent screen, {show}, {len(SEEDS)} sets", ("measured", "asked", "fringe noise"))
    row("error of points over sigma, RMS", f"{np.sqrt(np.mean(np.concatenate(ratios) ** 2)):.2f}", "0.8 to 1.25", "")
    row("pose of the measuring camera, chi-square over 6", f"{np.mean(poses):.2f}", "about 1", "")
    row("error of points, RMS [um]", f"{1e6 * np.sqrt(np.mean(np.concatenate(errors) ** 2)):.1f}", "", "")
    slope = np.sqrt(np.mean(np.concatenate(slopes) ** 2))
    row("slope error it causes [urad]", f"{1e6 * slope:.2f}", "below noise", f"{1e6 * noise_rad:.1f}")


def fringe_noise_rad() -> float:
    """Return the random sigma of a pixel's slope in the small drawn measurement."""
    scene = preset_scene("small")
    rng = np.random.default_rng(1)
    taken = [scene.sensor.expose(one, rng) for one in expected_light(scene, np.random.default_rng(1))[0]]
    limits = ScreenMapLimits(saturation_dn=float(scene.sensor.saturation_dn))
    lit = taken[-1].astype(np.float32) - taken[-2].astype(np.float32)
    observation = Observation(np.stack(taken[:-2]), scene.pattern, lit=lit, limits=limits)
    setup, mirror = evaluation_inputs(scene, Knowledge(), 0)
    (image,) = evaluate_source(observation, setup, mirror, Choices(), SilentProgress()).images.values()
    return float(np.nanmedian(image.sigma_x))


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        published_wall(scratch)
        if "--wall" in sys.argv:
            return
        noise = fringe_noise_rad()
        for show in ("dots", "rims"):
            drawn_screens(scratch, show, noise)


if __name__ == "__main__":
    main()
