"""Measure many folders side by side, into one folder with an index."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from heliogauge.batch.batch_folder import RESERVED, BatchFolder
from heliogauge.batch.folders import BatchTask, find_measurements
from heliogauge.batch.inputs import input_digest
from heliogauge.batch.rows import (
    INDEX_FILE,
    Row,
    batch_summary,
    failed_row,
    link_to,
    measured_row,
    write_index,
)
from heliogauge.doubts import Doubt
from heliogauge.errors import EstimationError, InputError, MetrologyError
from heliogauge.reporting.build import REPORT_HTML
from heliogauge.results.folder import SUMMARY_FILE, Summary, write_summary
from heliogauge.results.frame import add_report
from heliogauge.results.growing_folder import Finished
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.running.scale import Failure, Workers, run_each
from heliogauge.running.verbs import measure_into

if TYPE_CHECKING:
    from heliogauge.results.opened import Result

#: Measurements that are worth a process of their own, which takes a second to start.
_WORTH = 2


@dataclass(frozen=True, slots=True)
class BatchShared:
    """What all measurements of a batch have in common.

    out: Folder of results.
    options: Choices that override those of the measurement files.
    jobs: Processes or threads that each measurement may use.
    report: Make report.html of each.
    """

    out: Path
    options: Mapping[str, Any]
    jobs: int | None
    report: bool


@dataclass(frozen=True, slots=True)
class BatchResult:
    """What came of a batch; the measurements themselves are in its folder.

    rows: Rows of ``index.csv``.
    summary: Counts and medians.
    resumed: Measurements that were finished before and have not changed.
    """

    rows: tuple[Row, ...] = ()
    summary: Summary = field(default_factory=lambda: Summary("", "", {}))
    resumed: int = 0

    @property
    def doubts(self) -> tuple[Doubt, ...]:
        """What makes the results doubtful."""
        return self.summary.doubts

    def headline(self) -> str:
        """Return the most important numbers in a few lines for the terminal."""
        numbers = self.summary.numbers
        before = f"{self.resumed} were finished before and have not changed\n" if self.resumed else ""
        return (
            f"{before}{numbers['measured_count']} of {numbers['measurements_count']} folders measured, "
            f"{numbers['failed_count']} failed"
        )


def measure_many(
    folders: Sequence[str | Path],
    out: str | Path,
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    force: bool = False,
    report: bool = True,
    progress: Progress | None = None,
    **options: Any,
) -> "Result":
    """Evaluate many measurement folders, side by side, into one folder with an index.

    Parameters
    ----------
    folders : sequence of str or Path
        Measurement folders of any kinds, or folders that are searched for measurement folders.
    out : str or Path
        Folder for the results. Each measurement gets a folder in it that is whole or not there; ``index.csv`` lists
        them with their headline numbers and doubts, failed ones with the reason. Results that are there already are
        kept where neither the inputs nor the options nor the version has changed, so that an interrupted batch goes on
        where it was.
    jobs : int, optional
        Processes on this machine; as many as it has processors without it.
    scheduler : str, optional
        Address of a Dask scheduler, ``tcp://host:port``, to work there instead. Its workers must see the folders under
        the same paths.
    force : bool
        Measure everything anew and replace earlier results.
    report : bool
        Make report.html of each measurement, and of the batch.
    progress : Progress, optional
        Listener for the stages, such as `heliogauge.running.terminal.terminal_progress`.
    **options : Any
        Choices that override those of all measurement files, called as on the command line with underscores.

    Returns
    -------
    Result
        The batch: counts and medians in `summary`, the index in ``tables["index"]``, the results of each measurement
        by its name in `parts`.

    Raises
    ------
    InputError
        A folder that does not exist, no measurement in any of them, a folder for results that cannot be used, or a
        scheduler that does not answer.
    EstimationError
        All measurements failed; the index has the reasons.
    KeyboardInterrupt
        With what is finished in its text.

    Notes
    -----
    Names of results are those of the measurement folders; where two are the same, the names of the folders above come
    first. A measurement that fails stops no other, and is tried again by the next run.
    """
    from heliogauge.results.opened import Result

    places = [Path(folder).expanduser() for folder in folders]
    target = Path(out).expanduser()
    workers = Workers(jobs, scheduler)
    measure_batch(places, target, workers, progress or SilentProgress(), options, force=force, report=report)
    return Result(target)


def measure_batch(
    folders: Sequence[Path],
    out: Path,
    workers: Workers,
    progress: Progress,
    options: Mapping[str, Any] | None = None,
    *,
    force: bool = False,
    report: bool = True,
) -> BatchResult:
    """Evaluate many measurement folders into one folder with an index, as `measure_many` does.

    workers: Who works.
    options: Choices that override those of all measurement files.
    force: Measure everything anew and replace earlier results.
    report: Make report.html of each measurement, and of the batch.
    InputError: See `measure_many`.
    EstimationError: All measurements failed; the index has the reasons.
    KeyboardInterrupt: With what is finished in its text.
    """
    with progress.stage("look for measurements"):
        tasks = find_measurements(folders, out, RESERVED)
    with BatchFolder(out, force=force) as folder:
        try:
            result = _fill(folder, tasks, workers, progress, options or {}, report=report)
        except KeyboardInterrupt:
            count = sum(task.name in folder.finished for task in tasks)
            kept = f"{count} of {len(tasks)} measurements are finished in {out}; the same command continues"
            raise KeyboardInterrupt(kept if count else "nothing was written") from None
        if report:
            from heliogauge.reporting.build import build_report

            with progress.stage("report"):
                build_report(folder.path)
    if not result.summary.numbers["measured_count"]:
        raise EstimationError(
            f"{out / INDEX_FILE}: all {len(tasks)} measurements failed; the first: {result.rows[0]['reason']}"
        )
    return result


def _fill(
    folder: BatchFolder,
    tasks: Sequence[BatchTask],
    workers: Workers,
    progress: Progress,
    options: Mapping[str, Any],
    *,
    report: bool,
) -> BatchResult:
    _refuse_others(folder, tasks)
    processes = 1 if workers.scheduler else workers.processes(len(tasks), worth=_WORTH)
    inner = 1 if workers.scheduler or processes > 1 else workers.jobs
    shared = BatchShared(folder.path, dict(options), inner, report)
    resumed = 0

    def fresh() -> Iterator[BatchTask]:
        for task in tasks:
            earlier = folder.before.get(task.name)
            yield task if earlier is None else replace(task, earlier=earlier.digest)

    named = [task.name for task in tasks]
    for name, fault in folder.spoiled.items():
        what = "measured again" if name in named else f"left out of {INDEX_FILE} until its folder is given again"
        progress.say(f"{name}: {what}: {fault}")
    with progress.stage("measure folders", len(tasks)) as stage:
        for done in run_each(measure_one, shared, fresh(), workers=workers, processes=processes):
            task, outcome = done.task, done.outcome
            if isinstance(outcome, Finished) and not outcome.row:
                resumed += 1
                changes = {"folder": str(task.folder), "link": link_to(folder.path / task.name)}
                folder.take_over(task.name, folder.before[task.name].row | changes)
            elif isinstance(outcome, Finished) and (folder.path / task.name / SUMMARY_FILE).is_file():
                folder.note(task.name, outcome.digest, outcome.row)
            else:
                failure = outcome if isinstance(outcome, Failure) else Failure(_NOT_HERE.format(folder.path))
                folder.remove(task.name)
                link = folder.keep_trace(task.name, failure.trace) if failure.trace else ""
                folder.note(task.name, "", failed_row(task, _kind_name(task.folder), failure.reason, link))
                progress.say(f"{task.name}: failed: {failure.reason}")
            stage.advance()
    others = [name for name in folder.before if name not in folder.finished]
    for name in others:
        folder.finished[name] = folder.before[name]
    names = named + others
    with progress.stage("write index"):
        rows = tuple(folder.finished[name].row for name in names)
        digests = {name: folder.finished[name].digest for name in names if folder.finished[name].digest}
        summary = batch_summary(folder.path.name, rows, progress.durations_s, digests)
        write_index(folder.path / INDEX_FILE, rows)
        write_summary(folder.path / SUMMARY_FILE, summary)
        folder.rewrite_journal(names)
    return BatchResult(rows, summary, resumed)


_NOT_HERE = "its results are not in {0}: the workers of the cluster must see this folder under the same path"


def _refuse_others(folder: BatchFolder, tasks: Sequence[BatchTask]) -> None:
    """Refuse to replace the results of another measurement of the same name.

    InputError: There are some.
    """
    for task in tasks:
        earlier = folder.before.get(task.name)
        if earlier is None or earlier.row.get("folder") == str(task.folder) or not _is_there(earlier.row):
            continue
        raise InputError(
            f"{folder.path / task.name}: holds the results of {earlier.row['folder']}, not of {task.folder}; choose "
            "another folder or give force=True to replace results"
        )


def _is_there(row: Row) -> bool:
    """Return whether the folder that a row was measured from still is: a folder that was moved is no other one."""
    return Path(str(row.get("folder", ""))).is_dir()


def measure_one(shared: BatchShared, task: BatchTask) -> Finished:
    """Measure a folder into its place, unless its results are there already.

    Returns: Digest of its inputs, and its row; no row where its results are there already.
    InputError: The measurement cannot be meant.
    EstimationError: The data do not determine the answer.
    """
    digest = input_digest(task.folder, dict(shared.options))
    place = shared.out / task.name
    if digest == task.earlier:
        if shared.report and not _has_report(place):
            add_report(place, SilentProgress())
        return Finished(digest, {})
    start, before = perf_counter(), _stamp(place)
    try:
        # A worker that was lost after its last step has left its whole result: it is replaced by the same.
        measure_into(
            task.folder,
            place,
            SilentProgress(),
            jobs=shared.jobs,
            options=shared.options,
            force=True,
            report=shared.report,
        )
    except InputError:
        if _stamp(place) in {None, before}:
            raise
        # A worker that the cluster had given up was alive, and moved the same result into place at this moment.
    return Finished(digest, measured_row(task, place, perf_counter() - start))


def _has_report(place: Path) -> bool:
    """Return whether a result has a report that is not empty, as a power cut leaves them."""
    try:
        return (place / REPORT_HTML).stat().st_size > 0
    except OSError:
        return False


def _stamp(place: Path) -> tuple[int, int] | None:
    """Return what tells one result from another that replaces it; None where there is none."""
    try:
        found = (place / SUMMARY_FILE).stat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns


def _kind_name(folder: Path) -> str:
    from heliogauge.measurement.load import kind_of

    try:
        return kind_of(folder).name
    except MetrologyError:
        return ""
