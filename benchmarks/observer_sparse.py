"""Sparse flights over two rows: sigmas of slopes that rest on the mirror's smoothness, against true errors.

Run ``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/observer_sparse.py FOLDER [SEED ..] [OPTION ..]``; the
seeds are 1 to 5 without any. Options are those of ``heliogauge observer synth`` beside ``--preset flight --photos 40
--dictionary none --rtk-mm 20 --gimbal-deg 1.5 --mounting-mm 2``, and replace them; ``--turned 1`` draws normals that
are turned on the design's surface, by waves in all directions, in place of a shaped mirror whose waves run along the
trough. FOLDER keeps the photos for the next run.
"""

import subprocess
import sys
from pathlib import Path

import numpy as np
from _measure import row, title

from data_synth.troughs import read_trough_truth
from heliogauge.results.slope_map_file import read_slope_map

FLIGHT = {
    "--preset": "flight",
    "--photos": "40",
    "--dictionary": "none",
    "--rtk-mm": "20",
    "--gimbal-deg": "1.5",
    "--mounting-mm": "2",
}


def measured(folder: Path, seed: int, options: dict[str, str], *, shaped: bool) -> tuple[Path, Path]:
    """Draw a flight unless it is there, and measure it; return both folders."""
    place = folder / "_".join(["sparse", *options.values(), "shaped" if shaped else "turned", str(seed)])
    python = [sys.executable, "-m", "heliogauge", "observer"]
    if not place.exists():
        words = [one for pair in options.items() for one in pair] + ["--shaped"] * shaped
        subprocess.run([*python, "synth", str(place), "--seed", str(seed), "--quiet", *words], check=True)
    result = place.with_name(f"{place.name}_result")
    subprocess.run(
        [*python, "measure", str(place), "-o", str(result), "--no-report", "--quiet", "--force"],
        check=True,
        capture_output=True,
    )
    return place, result


def errors(truth_folder: Path, result: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return error and sigma of dz/dx at all nodes that have a value [rad]."""
    truth, found = read_trough_truth(truth_folder), read_slope_map(result / "slope_map.nc")
    columns, rows = (
        np.abs(here[:, None] - there).argmin(axis=1) for here, there in ((found.x_m, truth.x_m), (found.y_m, truth.y_m))
    )
    error = found.slope_error_x - truth.slope_error_x[np.ix_(rows, columns)]
    known = found.valid & np.isfinite(error)
    return error[known], found.sigma_slope()[0][known]


def report(folder: Path, seeds: list[int], options: dict[str, str], *, shaped: bool) -> None:
    """Print each module's numbers and those of all together."""
    squares, ratios, worst = [], [], []
    for seed in seeds:
        place, result = measured(folder, seed, options, shaped=shaped)
        truths = sorted((place / "truth").glob("row-*")) or [place]
        for truth in truths:
            own = result / truth.name if truth != place else result
            if not (own / "slope_map.nc").exists():
                print(f"seed {seed}, {truth.name}: refused")
                continue
            error, sigma = errors(truth, own)
            squares.append(np.mean(error**2))
            ratios.append(np.mean((error / sigma) ** 2))
            worst.append(np.mean(np.abs(error) > 3 * sigma))
            print(
                f"seed {seed}, {own.name}: RMS {1e3 * np.sqrt(squares[-1]):.3f} mrad, "
                f"sigma {1e3 * np.sqrt(np.mean(sigma**2)):.3f}, (error/sigma)^2 {ratios[-1]:.2f}",
                flush=True,
            )
    title(f"sparse flights, {len(seeds)} seeds: {' '.join(options.values())}", ("measured", "asked"))
    row("RMS error of dz/dx over modules [mrad]", f"{1e3 * np.sqrt(np.mean(squares)):.3f}", "")
    row("(error / sigma)^2: mean, median", f"{np.mean(ratios):.2f}, {np.median(ratios):.2f}", "0.8 to 1.3")
    row("  smallest, largest of one module", f"{np.min(ratios):.2f}, {np.max(ratios):.2f}", "")
    row("  beyond 3 sigma", f"{np.mean(worst):.4f}", "<= 0.005")


def main() -> None:
    """Read folder, seeds and options."""
    folder, *words = sys.argv[1:]
    given = [k for k, word in enumerate(words) if word.startswith("--")]
    values = {k + 1 for k in given}
    seeds = [int(word) for k, word in enumerate(words) if word.isdigit() and k not in values]
    options = FLIGHT | {words[k]: words[k + 1] for k in given}
    shaped = options.pop("--turned", "0") == "0"
    report(Path(folder), seeds or list(range(1, 6)), options, shaped=shaped)


if __name__ == "__main__":
    main()
