"""Troughs without marked targets: panels' corners and the drone's positions, against the truth of drawn photos.

Run ``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/observer_natural.py FOLDER [SEED ..] [OPTION ..]``; the
seeds are 1 to 5 without any. Options are those of ``heliogauge observer synth`` beside ``--preset ls2 --photos 24
--dictionary none --rtk-mm 20 --gimbal-deg 1.5 --mounting-mm 2``, and replace them. FOLDER keeps the photos for the
next run.
"""

import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from _measure import row, title
from observer_accuracy import absorber_error_mm

from data_synth.troughs import read_trough_truth
from heliogauge.errors import MetrologyError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.measurement.load import load
from observer import Options, Result, run

FLIGHT = {
    "--preset": "ls2",
    "--photos": "24",
    "--dictionary": "none",
    "--rtk-mm": "20",
    "--gimbal-deg": "1.5",
    "--mounting-mm": "2",
}


class Corners(NamedTuple):
    """Corners of all photos: errors [px], errors over sigma, used by the adjustment or refused; shown at all."""

    error_px: np.ndarray
    over_sigma: np.ndarray
    used: np.ndarray
    shown: int


def drawn(folder: Path, seed: int, options: dict[str, str], switches: tuple[str, ...] = ()) -> Path:
    """Draw a flight unless it is there."""
    said = "_".join(value for value in options.values())
    place = folder / f"natural_{said}_{seed}"
    if not place.exists():
        command = ["-m", "heliogauge", "observer", "synth", str(place), "--seed", str(seed), "--quiet"]
        subprocess.run(
            [sys.executable, *command, *switches, *(one for pair in options.items() for one in pair)], check=True
        )
    return place


def corners(result: Result, folder: Path) -> Corners:
    """Compare corners with where the true places appear from the true poses, by the true camera."""
    truth = read_trough_truth(folder).parameters
    points, bundle = result.network.measured.points, result.network.solved.bundle
    camera = result.network.camera
    used = {bundle.problem.observations.label(k) for k in range(bundle.problem.observations.n)}
    errors, whitened, kept, shown = [], [], [], 0
    for name, photo in truth["photos"].items():
        pose = RigidTransform.from_rotation_vector(*photo["cam_from_trough"].values())
        pixels = camera.project(pose.apply(np.array(list(truth["corners_m"].values()))))
        inside = ((pixels > 10) & (pixels < (camera.width_px - 11, camera.height_px - 11))).all(axis=1)
        shown += int(np.count_nonzero(inside))
        true = dict(zip(truth["corners_m"], pixels, strict=True))
        for k in range(points.n):
            if points.photos[points.photo_index[k]] == name:
                error = points.pixels_px[k] - true[points.targets[points.target_index[k]]]
                errors.append(error)
                whitened.append(np.linalg.solve(np.linalg.cholesky(points.covariance_px2[k]), error))
                kept.append(points.label(k) in used)
    return Corners(np.array(errors), np.array(whitened), np.array(kept), shown)


def poses_over_sigma(result: Result, folder: Path) -> np.ndarray:
    """Return (error / sigma)^2 of the place of each photo and its turn, summed over all six and divided by them."""
    truth, ratios = read_trough_truth(folder).parameters["photos"], []
    bundle = result.network.solved.bundle
    for k, name in enumerate(bundle.problem.observations.photos):
        true = RigidTransform.from_rotation_vector(*truth[name]["cam_from_trough"].values())
        found = bundle.cam_from_world[k]
        turn = RigidTransform(found.rotation @ true.rotation.T, np.zeros(3)).rotation_vector_rad
        step = np.concatenate([turn, found.translation_m - true.translation_m])
        covariance = bundle.covariance.joint((), np.array([k]))
        ratios.append(float(step @ np.linalg.solve(covariance, step)) / 6)
    return np.array(ratios)


def theta_ra(result: Result, folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return error and sigma of theta_ra at all nodes: the normal against the one that would light the true tube."""
    truth, found = read_trough_truth(folder), result.slope_map
    columns, rows = (
        np.abs(here[:, None] - there).argmin(axis=1) for here, there in ((found.x_m, truth.x_m), (found.y_m, truth.y_m))
    )
    focal = result.collector.focal_length_m
    x, y = np.meshgrid(found.x_m, found.y_m)
    z = x**2 / (4 * focal)
    tube_x, tube_z = (np.interp(y, truth.absorber_y_m, values) for values in (truth.absorber_x_m, truth.absorber_z_m))
    # A normal that lights the tube halves the angle between the sun, along z, and the way to the tube.
    wanted = 0.5 * np.arctan2(tube_x - x, tube_z - z)
    designed = 0.5 * np.arctan2(-x, focal - z)
    true = truth.theta_r_rad[np.ix_(rows, columns)] + designed - wanted
    error = result.angles.theta_ra_rad - true
    known = found.valid & np.isfinite(error)
    return error[known], result.angles.sigma_theta_ra_rad[known]


def report(folder: Path, seeds: list[int], options: dict[str, str]) -> None:
    """Print every number of all seeds together, and of each."""
    pixels, over, used, shown, chi, errors, ratios = [], [], [], 0, [], [], []
    absorber, over_absorber = [], []
    for seed in seeds:
        place = drawn(folder, seed, options)
        try:
            result = run(load(place), Options(jobs=1))
        except MetrologyError as error:
            print(f"seed {seed}: refused: {error}")
            continue
        found = corners(result, place)
        error, sigma = theta_ra(result, place)
        off = absorber_error_mm(result, place)
        path, truth = result.absorber, read_trough_truth(place)
        middle = slice(1, -1)
        for got, true, own in (
            (path.x_m, truth.absorber_x_m, path.sigma_at(path.y_m)[0]),
            (path.z_m, truth.absorber_z_m, path.sigma_at(path.y_m)[1]),
        ):
            over_absorber.append(((got - np.interp(path.y_m, truth.absorber_y_m, true)) / own)[middle])
        poses = poses_over_sigma(result, place)
        far = np.linalg.norm(found.error_px, axis=1)
        print(
            f"seed {seed}: corners {far.size} of {found.shown}, {np.mean(far <= 1):.4f} within 1 px, used above 3 px "
            f"{np.count_nonzero(far[found.used] > 3)}; theta_ra RMS {1e3 * error.std():.3f}, mean "
            f"{1e3 * error.mean():+.3f}, 95 % {1e3 * np.quantile(np.abs(error), 0.95):.3f} mrad, (error/sigma)^2 "
            f"{np.mean((error / sigma) ** 2):.2f}; absorber {off[0]:.2f}, {off[1]:.2f} mm; poses {poses.mean():.2f}"
        )
        pixels.append(far)
        used.append(found.used)
        over.append(found.over_sigma)
        shown += found.shown
        chi.append(poses)
        errors.append(error)
        ratios.append(error / sigma)
        absorber.append(off)
    if not errors:
        return
    far, kept, error, ratio = (np.concatenate(one) for one in (pixels, used, errors, ratios))
    title(f"without marked targets, {len(errors)} seeds: {' '.join(options.values())}", ("measured", "asked"))
    row("corners found, of those in the photos", f"{far.size / shown:.3f}", "")
    row("  of these within 1 px", f"{np.mean(far <= 1):.4f}", ">= 0.98")
    row("  beyond 3 px, found; used", f"{np.count_nonzero(far > 3)}; {np.count_nonzero(far[kept] > 3)}", "0 used")
    row("  RMS of those used [px]", f"{np.sqrt(np.mean(far[kept] ** 2)):.3f}", "")
    squares = np.concatenate(over)[kept] ** 2
    row("  (error / sigma)^2 of those used: mean, median", f"{squares.mean():.2f}, {np.median(squares):.2f}", "1, 0.45")
    row("(error / sigma)^2 of poses", f"{np.concatenate(chi).mean():.2f}", "1")
    row("theta_ra, 95 % within [mrad]", f"{1e3 * np.quantile(np.abs(error), 0.95):.3f}", "<= 0.5")
    row("  (error / sigma)^2", f"{np.mean(ratio**2):.2f}", "0.8 to 1.3")
    row("  beyond 3 sigma", f"{np.mean(np.abs(ratio) > 3):.4f}", "<= 0.005")
    row("absorber x, z, RMS [mm]", "{:.2f}, {:.2f}".format(*np.sqrt(np.mean(np.square(absorber), axis=0))), "<= 1")
    row("  (error / sigma)^2", f"{np.mean(np.concatenate(over_absorber) ** 2):.2f}", "0.8 to 1.3")


def main() -> None:
    """Read folder, seeds and options."""
    folder, *words = sys.argv[1:]
    seeds = [int(word) for word in words if word.isdigit() and words[max(words.index(word) - 1, 0)][:2] != "--"]
    given = [k for k, word in enumerate(words) if word.startswith("--")]
    options = FLIGHT | {words[k]: words[k + 1] for k in given}
    report(Path(folder), seeds or list(range(1, 6)), options)


if __name__ == "__main__":
    main()
