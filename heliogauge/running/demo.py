"""The demo: a synthetic measurement of each kind, evaluated from its images to its report, compared with its truth."""

from pathlib import Path

import numpy as np

from calibration import heliostat as heliostats
from calibration.heliostat.planning import commanded_offsets
from data_synth.fringes import DatasetOptions, preset_scene, read_truth, write_dataset
from data_synth.heliostats import HeliostatTruth, heliostat_scene, read_heliostat_truth, write_heliostat_dataset
from deflectometry import Result, run
from heliogauge.measurement.load import load
from heliogauge.results.folder import ResultFolder
from heliogauge.results.frame import add_report
from heliogauge.running.progress import SilentProgress
from heliogauge.slopes.map import monomials

MEASUREMENT = "measurement"
HELIOSTATS = "heliostats"


def run_demo(out: Path, progress: SilentProgress, *, force: bool = False, report: bool = True) -> None:
    """Draw fringe images of a facet and beams of heliostats with known errors, measure them, and say how near it comes.

    out: Folder for the results; the images lie in its folder ``measurement``, the heliostats in ``heliostats``.
    force: Replace an earlier result.
    report: Also write report.html.
    InputError: The folder cannot be written, or holds something else.
    """
    with ResultFolder(out, force=force) as working:
        folder = working / MEASUREMENT
        write_dataset(folder, preset_scene("small"), DatasetOptions(seed=0), progress)
        result = run(load(folder), progress=progress)
        with progress.stage("write results"):
            result.write(working)
        calibrated = calibrate_heliostats(working / HELIOSTATS, progress)
        compared = compare_with_truth(result, folder)
    for place in (out, out / HELIOSTATS) if report else ():
        add_report(place, progress)
    progress.say(result.headline())
    progress.say(compared)
    progress.say(calibrated)
    pages = f"; open {out / 'report.html'} and {out / HELIOSTATS / 'report.html'} in a browser"
    progress.say(f"results: {out}" + (pages if report else ""))


def compare_with_truth(result: Result, folder: Path) -> str:
    """Say how far the measured slopes are from the true ones, beside what their sigma expects.

    result: What the measurement gave.

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


def calibrate_heliostats(folder: Path, progress: SilentProgress) -> str:
    """Draw the beams of four heliostats, calibrate them, and say how near their models come to the true ones.

    folder: Folder for the results, to be made; the tables lie in its folder ``measurement``.
    """
    folder.mkdir()
    place = folder / MEASUREMENT
    write_heliostat_dataset(place, heliostat_scene("small"), progress=progress)
    with progress.stage("calibrate heliostats"):
        # Its own progress: the report of the heliostats would list the stages of the facet. Four heliostats are not
        # worth processes of their own, nor every split.
        options = heliostats.Options(thorough=False, jobs=1)
        result = heliostats.run(load(place), options, SilentProgress())
    with progress.stage("write results"):
        result.write(folder)
    truth = read_heliostat_truth(place)
    lines = []
    for number, one in enumerate(result.heliostats):
        held = "" if one.main is None else f"beam predicted to {1e3 * one.main.test.beam_rms_rad:.2f} mrad RMS; "
        lines.append(f"heliostat {one.name}: {held}{_against_truth(result, number, truth)}")
    return "\n".join(lines)


def _against_truth(result: heliostats.Result, number: int, truth: HeliostatTruth) -> str:
    one = result.heliostats[number]
    design, (target, *_) = one.fit.design, result.shared.plant.targets.values()
    known = {name: value for name, value in truth.values(one.name).items() if name in design.parameters.names}
    missed = commanded_offsets(design.with_value(known), design, one.seen.suns, target)
    rms_mm = 1e3 * float(np.sqrt(np.mean((missed**2).sum(axis=1))))
    return f"aimed with its model, the true one misses by {rms_mm:.0f} mm RMS"
