"""The demo: a synthetic measurement of each kind, evaluated from its images to its report, compared with its truth."""

from pathlib import Path

import numpy as np

from data_synth.dataset import DatasetOptions, read_truth, write_dataset
from data_synth.presets import preset_scene
from deflectometry.headline import headline_text
from deflectometry.pipeline import Result, run, summarise, write
from heliogauge.measurement import load_measurement
from heliogauge.progress import SilentProgress
from heliogauge.slope_map import monomials
from heliogauge.store import ResultFolder

MEASUREMENT = "measurement"


def run_demo(out: Path, progress: SilentProgress, *, force: bool = False, report: bool = True) -> None:
    """Draw fringe images of a facet with known slope errors, measure them, and say how near the result is.

    Parameters
    ----------
    out : Path
        Folder for the results; the images lie in its folder ``measurement``.
    progress : SilentProgress
        Told of each stage.
    force : bool, optional
        Replace an earlier result.
    report : bool, optional
        Also write report.html.

    Raises
    ------
    InputError
        The folder cannot be written, or holds something else.
    """
    with ResultFolder(out, force=force) as working:
        folder = working / MEASUREMENT
        write_dataset(folder, preset_scene("small"), DatasetOptions(seed=0), progress)
        result = run(load_measurement(folder), progress=progress)
        with progress.stage("write results"):
            write(result, working)
        if report:
            from heliogauge.report import build_report

            with progress.stage("report"):
                build_report(working)
        compared = compare_with_truth(result, folder)
    progress.say(headline_text(summarise(result)))
    progress.say(compared)
    progress.say(f"results: {out}" + (f"; open {out / 'report.html'} in a browser" if report else ""))


def compare_with_truth(result: Result, folder: Path) -> str:
    """Say how far the measured slopes are from the true ones, beside what their sigma expects.

    Parameters
    ----------
    result : Result
        What the measurement gave.
    folder : Path
        The synthetic measurement.

    Returns
    -------
    str
        One line.

    Notes
    -----
    The frame of the slopes is defined by the measured normal itself, so the mean tilt is taken out of the difference;
    what pose and camera do to the map is smooth and has a sigma of its own, so a cubic is taken out as well before
    the rest is compared with the random sigma.
    """
    name, image = next(iter(result.evaluation.images.items()))
    truth = read_truth(folder).pixels
    rows = slice(image.row, image.row + image.x_m.shape[0])
    columns = slice(image.column, image.column + image.x_m.shape[1])
    good = np.isfinite(image.slope_x)
    differences = [
        (image.slope_x - truth.slope_x[rows, columns])[good],
        (image.slope_y - truth.slope_y[rows, columns])[good],
    ]
    terms = monomials(image.x_m[good], image.y_m[good], 3).T
    rest = [difference - terms @ np.linalg.lstsq(terms, difference, rcond=None)[0] for difference in differences]
    ratios = [
        np.sqrt(np.mean((one / sigma[good]) ** 2))
        for one, sigma in zip(rest, (image.sigma_x, image.sigma_y), strict=True)
    ]
    rms = [1e3 * float(np.std(difference)) for difference in differences]
    return (
        f"truth: slopes of {name} differ by {rms[0]:.4f} and {rms[1]:.4f} mrad RMS in x and y; "
        f"their noise is {ratios[0]:.2f} and {ratios[1]:.2f} times the sigma given"
    )
