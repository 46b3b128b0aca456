"""Heliostats drawn at night from their tower: slopes, canting, mean normal, processor time; UNAM's bent facet; a field.

Run ``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/tower.py``. It draws at a quarter of the pixels but for
the cost and one night; ``--small`` leaves out the night of 10^6 pixels, whose drawing alone takes 100 s.
"""

import csv
import re
import sys
import tempfile
from pathlib import Path

import numpy as np
from _measure import command_cost, row, title

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from data_synth.fringes import read_truth
from deflectometry import load_deflectometry, run
from tests.deflectometry.tower_errors import TowerErrors, draw_night, draw_unam, night_errors

NIGHTS = range(6)
QUARTER = 0.25


Night = tuple[TowerErrors, np.ndarray, set[str]]


def measured(folder: Path, scale: float) -> Night:
    """Measure a night: errors, sigma of the mean normal in the screen's frame, codes of doubts."""
    result = run(load_deflectometry(folder))
    numbers = result.numbers
    sigma = np.array([numbers["sigma_mean_normal_x_rad"], numbers["sigma_mean_normal_y_rad"]])
    return night_errors(result, folder, scale), sigma, {one.code for one in result.doubts}


def both_ways(folder: Path, scale: float, seed: int) -> tuple[Night, Night]:
    """Draw a night and measure it without and with the surveyed place of the heliostat."""
    draw_night(folder, scale, seed)
    with_place = measured(folder, scale)
    file = folder / "measurement.toml"
    file.write_text(re.sub(r"(?m)^\[mirror.place\]\n(.+\n)+", "", file.read_text()))
    return measured(folder, scale), with_place


def mrad(values: object) -> str:
    return " / ".join(f"{1e3 * one:.4f}" for one in np.atleast_1d(np.asarray(values)))


def nights(scratch: Path) -> None:
    drawn = [both_ways(scratch / f"night_{seed}", QUARTER, seed) for seed in NIGHTS]
    for way, words in enumerate(("place not surveyed", "place surveyed to 5 mm")):
        found = [one[way] for one in drawn]
        errors = [one for one, _, _ in found]
        title(f"{len(found)} nights at a quarter of the pixels, {words}", ("measured", "asked", "DLR"))
        row("slopes inside facets, RMS [mrad]", mrad(np.sqrt(np.mean([e.inside**2 for e in errors]))), "0.1", "< 0.2")
        row("canting, largest error [mrad]", mrad(max(e.canting for e in errors)), "0.1", "")
        off = np.array([e.normal_screen for e in errors])
        row("mean normal in the screen's frame x / y, RMS [mrad]", mrad(np.sqrt(np.mean(off**2, axis=0))), "0.1", "")
        row("  its sigma [mrad]", mrad(np.mean([one for _, one, _ in found], axis=0)), "", "")
        ratio = off / np.array([one for _, one, _ in found])
        row(f"  error over sigma, squared, mean of {ratio.size}", f"{np.mean(ratio**2):.2f}", "about 1", "")
        in_camera = np.array([e.normal_cam for e in errors])
        row("mean normal in the camera's frame, RMS [mrad]", mrad(np.sqrt(np.mean(in_camera**2, axis=0))), "", "")
        codes = set[str]().union(*(one for _, _, one in found))
        row("doubts", ", ".join(sorted(codes)))


def whole_night(scratch: Path) -> None:
    folder = scratch / "whole"
    draw_night(folder, 1.0, 0)
    result = run(load_deflectometry(folder))
    found = night_errors(result, folder, 1.0)
    points = sum(int(np.isfinite(one.slope_x).sum()) for one in result.evaluation.images.values())
    title("One night with all pixels", ("measured", "asked", "DLR"))
    row("points", f"{points:,}", "1,000,000", "1,000,000")
    row("slopes inside facets, RMS [mrad]", mrad(found.inside), "0.1", "< 0.2")
    row("canting, largest error [mrad]", mrad(found.canting), "0.1", "")
    row("mean normal in the screen's frame x / y [mrad]", mrad(found.normal_screen), "0.1", "")
    cost = command_cost("measure", str(folder), "-o", str(scratch / "out"), "-q")
    row("processor time of the command, with report [s]", f"{cost.cpu_s:.1f}", "60", "60")
    row("  memory [MiB]", f"{cost.mib:.0f}", "", "")


def unam(scratch: Path) -> None:
    folder = scratch / "unam"
    asked = draw_unam(folder)
    result = run(load_deflectometry(folder))
    truth, slopes = read_truth(folder), result.assembled
    true = [float(np.std(one[slopes.valid])) for one in truth.slopes(*np.meshgrid(slopes.x_m, slopes.y_m))]
    title(
        "UNAM's facet, bent about a vertical line, 201 m, 1.5 fringes/m (V-42)", ("measured", "true there", "published")
    )
    for letter, one, published in zip("xy", true, asked, strict=True):
        sd, sigma = result.numbers[f"sd{letter}_rad"], result.numbers[f"sigma_sd{letter}_rad"]
        row(
            f"deviation from a plane in {letter} [mrad]",
            f"{1e3 * sd:.3f} +- {1e3 * sigma:.3f}",
            mrad(one),
            mrad(published),
        )
    row("doubts", ", ".join(one.code for one in result.doubts))


def field(scratch: Path) -> None:
    folders = []
    for seed in range(3):
        folders.append(str(scratch / f"heliostat_{seed}"))
        draw_night(Path(folders[-1]), QUARTER, seed)
    cost = command_cost("measure", *folders, "-o", str(scratch / "field"), "-q", "--jobs", "1")
    with (scratch / "field" / "index.csv").open() as file:
        rows = list(csv.DictReader(file))
    title("heliogauge measure A B C -o FIELD, a quarter of the pixels, with reports", ("measured", "asked", ""))
    row("heliostats in index.csv", f"{len(rows)}", "3", "")
    row("processor time of each [s]", f"{cost.cpu_s / len(folders):.1f}", "60", "")
    row("columns of the index", ", ".join(rows[0]))


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        nights(scratch)
        unam(scratch)
        field(scratch)
        if "--small" not in sys.argv:
            whole_night(scratch)


if __name__ == "__main__":
    main()
