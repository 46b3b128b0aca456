"""A collector that turns before one far camera (TARMES): slopes from drawn photos and a table of tilts.

Run ``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/observer_tarmes.py FOLDER [SEED ..] [OPTION ..]``; the
seeds are 1 to 3 without any. Options are those of ``heliogauge observer synth`` beside ``--preset far --shaped``.
FOLDER keeps the photos for the next run.

The figure published is about 1 mrad with the camera 100 focal lengths away and 5 degrees of tilt (STAGE-STE D12.6,
3.5.2.2). Below it stands what single causes do, by the equation of the method: rays taken as parallel, a tube aside of
where it is said to be, a tilt read wrongly.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from _measure import row, title
from observer_natural import drawn, theta_ra

from data_synth.troughs import read_trough_truth
from heliogauge.errors import MetrologyError
from heliogauge.measurement.load import load
from observer import Options, Result, run
from observer.trough import ls2


def theta_r(result: Result, folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return error and sigma of theta_r at all nodes."""
    truth, found = read_trough_truth(folder), result.slope_map
    columns, rows = (
        np.abs(here[:, None] - there).argmin(axis=1) for here, there in ((found.x_m, truth.x_m), (found.y_m, truth.y_m))
    )
    error = result.angles.theta_r_rad - truth.theta_r_rad[np.ix_(rows, columns)]
    sigma = found.sigma_slope()[0] / (1 + found.design_slope_x**2)
    known = found.valid & np.isfinite(error)
    return error[known], sigma[known]


def report(folder: Path, seeds: list[int], options: dict[str, str]) -> None:
    """Print the errors of each seed, and of all."""
    found = []
    for seed in seeds:
        place = drawn(folder, seed, {"--preset": "far", **options}, ("--shaped",))
        try:
            result = run(load(place), Options(jobs=1))
        except MetrologyError as error:
            print(f"seed {seed}: refused: {error}")
            continue
        (to_tube, sigma_tube), (mirror, sigma_mirror) = theta_ra(result, place), theta_r(result, place)
        share = float(result.slope_map.valid.mean())
        print(
            f"seed {seed}: theta_r RMS {1e3 * np.sqrt(np.mean(mirror**2)):.3f}, mean {1e3 * mirror.mean():+.3f} mrad, "
            f"(error/sigma)^2 {np.mean((mirror / sigma_mirror) ** 2):.2f}; theta_ra RMS "
            f"{1e3 * np.sqrt(np.mean(to_tube**2)):.3f}, 95 % {1e3 * np.quantile(np.abs(to_tube), 0.95):.3f} mrad, "
            f"(error/sigma)^2 {np.mean((to_tube / sigma_tube) ** 2):.2f}; measured {100 * share:.0f} %"
        )
        found.append((mirror, sigma_mirror, to_tube, sigma_tube, share))
    if not found:
        return
    mirror, sigma_mirror, to_tube, sigma_tube = (np.concatenate([one[k] for one in found]) for k in range(4))
    title(f"camera 100 f away, 41 tilts of 5 deg, {len(found)} seeds", ("measured", "published"))
    row("theta_r, RMS error [mrad]", f"{1e3 * np.sqrt(np.mean(mirror**2)):.3f}", "about 1")
    row("  without its mean [mrad]", f"{1e3 * mirror.std():.3f}", "")
    row("  (error / sigma)^2", f"{np.mean((mirror / sigma_mirror) ** 2):.2f}", "")
    row("theta_ra, 95 % of the points within [mrad]", f"{1e3 * np.quantile(np.abs(to_tube), 0.95):.3f}", "")
    row("  (error / sigma)^2", f"{np.mean((to_tube / sigma_tube) ** 2):.2f}", "")
    row("mirror measured", f"{np.mean([one[4] for one in found]):.2f}", "")


def causes() -> None:
    """Print what single causes do to theta_r of an LS-2, each at its worst place on the mirror."""
    collector = ls2()
    focal, distance = collector.focal_length_m, 100 * collector.focal_length_m
    x = np.linspace(-collector.aperture_width_m / 2, collector.aperture_width_m / 2, 501)
    z = x**2 / (4 * focal)

    def normal(eye: np.ndarray, tube: np.ndarray) -> np.ndarray:
        """Return the angle of the normal that sends a line of sight to the middle of the tube."""
        to_eye, to_tube = np.arctan2(eye[0] - x, eye[1] - z), np.arctan2(tube[0] - x, tube[1] - z)
        return np.asarray((to_eye + to_tube) / 2)

    eye, tube = np.array([0.0, distance]), np.array([0.0, focal])
    true = normal(eye, tube)
    title("what one cause alone does to theta_r, at its worst place [mrad]", ("", ""))
    parallel = np.arctan2(-x, focal - z) / 2
    row("rays taken as parallel", f"{1e3 * np.abs(parallel - true).max():.2f}", "")
    for name, moved in (("x", [1e-3, 0.0]), ("z", [0.0, 1e-3])):
        row(f"tube 1 mm aside in {name}", f"{1e3 * np.abs(normal(eye, tube + moved) - true).max():.2f}", "")
    wrong = normal(distance * np.array([np.sin(1e-3), np.cos(1e-3)]), tube)
    row("tilt wrong by 1 mrad", f"{1e3 * np.abs(wrong - true).max():.2f}", "")
    nearer = replace(collector, focal_length_m=focal * 1.001).focal_length_m
    row("tube 0.1 % of f too high", f"{1e3 * np.abs(normal(eye, np.array([0.0, nearer])) - true).max():.2f}", "")


if __name__ == "__main__":
    said = sys.argv[2:]
    numbers = [int(one) for one in said if one.isdigit() and not said[max(said.index(one) - 1, 0)].startswith("--")]
    pairs = {said[k]: said[k + 1] for k in range(len(said) - 1) if said[k].startswith("--")}
    report(Path(sys.argv[1]), numbers or [1, 2, 3], pairs)
    causes()
