"""Measure a folder with the photos of one trough, or of several modules, into a folder of results."""

from pathlib import Path

from heliogauge.results.failure import pictures_of_failure
from heliogauge.results.folder import ResultFolder
from heliogauge.results.frame import add_report, into_folder
from heliogauge.running.progress import Progress, SilentProgress
from observer.keys import ObserverMeasurement
from observer.pipeline import modules
from observer.pipeline.measure import Options, run
from observer.pipeline.result import Result
from observer.studies import overview


def run_into(
    measurement: ObserverMeasurement,
    out: Path,
    options: Options | None = None,
    progress: Progress | None = None,
    *,
    force: bool = False,
    report: bool = False,
) -> Result | overview.Result:
    """Evaluate a measurement; one that names several modules gives a folder of results for each, and an overview.

    out: Folder for the results; whole or not there.
    force: Replace earlier results.
    report: Add ``report.html``.
    Returns: The result, or what each of several modules gave.
    InputError: Photos, targets, camera or dimensions that cannot be used, or the folder cannot.
    EstimationError: No module could be measured.
    """
    progress = progress or SilentProgress()
    if not measurement.model.module:
        job, own = (lambda: run(measurement, options, progress)), measurement.folder
        return into_folder(out, job, progress, force=force, report=report, measured=own)
    with pictures_of_failure(out), ResultFolder(out, force=force) as working:
        found = modules.run(measurement, working, options, progress)
    if report:
        measured = [out / one.name for one in measurement.model.module if (out / one.name).is_dir()]
        for place in (*measured, out):
            add_report(place, progress)
    return found
