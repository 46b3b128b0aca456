"""A measurement or its results: commands that need the one of the two and are given the other."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from heliogauge.batch.folders import is_measurement
from heliogauge.errors import InputError
from heliogauge.measurement.load import MEASUREMENT_FILE, kind_of
from heliogauge.results.folder import SUMMARY_FILE, read_summary
from heliogauge.results.measured_folder import measured_folder
from heliogauge.running.progress import Progress
from heliogauge.running.verbs import measure_into


def is_result(folder: Path) -> bool:
    """Return whether a folder holds results, and no measurement."""
    return (folder / SUMMARY_FILE).is_file() and not (folder / MEASUREMENT_FILE).exists()


def planned_from(folder: Path, say: Callable[[str], None] = lambda text: None) -> Path:
    """Return what a plan was made from, and any other folder as it is.

    say: Takes the folder that is used instead of the one given, for the person who waits.
    InputError: A plan that does not say what it was made from, or of a folder that is not there any more or has
        changed.
    """
    while is_result(folder) and read_summary(folder).kind.endswith("-plan"):
        folder = measured_folder(folder)
        say(f"planned from {folder}")
    return folder


def measurement_of(folder: Path, say: Callable[[str], None] = lambda text: None) -> Path:
    """Return a measurement folder: the one given, or that which the results given were measured or planned from.

    say: Takes the folder that is used instead of the one given, for the person who waits.
    InputError: Results that do not say what they were measured from, or of a folder that is not there any more or has
        changed.
    """
    folder = planned_from(folder, say)
    if not is_result(folder):
        return folder
    folder = measured_folder(folder)
    say(f"measured from {folder}")
    return folder


@contextmanager
def results_of(folder: Path, kind: str, progress: Progress) -> Iterator[Path]:
    """Give a folder of results: the one given, or for as long as it is needed what measuring the one given says.

    kind: The kind that a measurement must be of; one of another kind is not evaluated.
    InputError, EstimationError: The measurement is of another kind, or cannot be evaluated.
    """
    folder = planned_from(folder, progress.say)
    if is_result(folder) or not is_measurement(folder):
        yield folder
        return
    own = kind_of(folder).name
    if own != kind:
        raise InputError(f'{folder}: a measurement of the kind "{own}"; one of "{kind}", or its results, is needed')
    with TemporaryDirectory(prefix="heliogauge-") as place:
        results = Path(place) / folder.resolve().name
        measure_into(folder, results, progress, jobs=None, force=False, report=False)
        yield results
