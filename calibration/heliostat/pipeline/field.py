"""A field of heliostats, straight into a folder: resumable, with flat memory, one broken heliostat stops no other."""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from calibration.heliostat.diagnosis.field_findings import judge_field
from calibration.heliostat.diagnosis.findings import Diagnosis
from calibration.heliostat.files.field_folder import FieldFolder
from calibration.heliostat.files.result import Shared
from calibration.heliostat.files.sources import HeliostatTask, digest_of_all
from calibration.heliostat.files.store_diagnosis import VIEW, changed_row, rewrite_diagnosis, view_of
from calibration.heliostat.files.store_field import (
    failed_row,
    field_row,
    field_summary,
    headline_text,
    split_lines,
    worst_first,
    write_field,
)
from calibration.heliostat.files.store_heliostat import heliostat_summary
from calibration.heliostat.fitting.field_model import Field
from calibration.heliostat.keys import HeliostatMeasurement
from calibration.heliostat.pipeline.campaign import WORTH, Campaign, with_field
from calibration.heliostat.pipeline.measure import Options, refuse_all, run
from calibration.heliostat.pipeline.one_heliostat import calibrate_one
from calibration.heliostat.pipeline.writing import result_files
from heliogauge import __version__
from heliogauge.doubts import Doubt
from heliogauge.results.failure import pictures_of_failure
from heliogauge.results.folder import SUMMARY_FILE, Summary, hash_files, write_summary
from heliogauge.results.frame import add_report, into_folder
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.running.scale import Failure, run_each

#: Warnings of a field that are repeated in the terminal.
_MOST_SAID = 20
#: Of a field of so many heliostats each gets a report, a second of work; of larger ones the reader asks for them.
_MOST_REPORTS = 12


@dataclass(frozen=True, slots=True)
class FieldResult:
    """What came of a field; the heliostats themselves are in the folder.

    rows: Rows of ``field.csv``, the worst first.
    summary: Counts and the middle of the field.
    resumed: Heliostats that were finished before.
    splits: For a single heliostat: what came of each split.
    """

    rows: list[dict[str, Any]] = field(default_factory=list)
    summary: Summary | None = None
    resumed: int = 0
    splits: tuple[str, ...] = ()

    @property
    def doubts(self) -> tuple[Doubt, ...]:
        """What makes the result doubtful, as much of it as one reads in a terminal."""
        every = () if self.summary is None else self.summary.doubts
        rest = len(every) - _MOST_SAID
        if rest <= 0:
            return every
        more = Doubt("more_doubts", f"... and {rest} more in summary.json and field.csv", {"doubts_count": rest})
        return (*every[:_MOST_SAID], more)

    def headline(self) -> str:
        """Return the most important numbers in a few lines for the terminal."""
        before = f"{self.resumed} of {len(self.rows)} heliostats were finished before\n" if self.resumed else ""
        return before + headline_text(self.rows, self.splits)


@dataclass(frozen=True, slots=True)
class _Finished:
    """A heliostat as it goes into the folder."""

    row: dict[str, Any]
    files: dict[str, bytes]


def run_into(
    measurement: HeliostatMeasurement,
    out: Path,
    options: Options | None = None,
    progress: Progress | None = None,
    *,
    force: bool = False,
    report: bool = False,
) -> FieldResult:
    """Calibrate heliostats into a folder.

    out: The folder. One heliostat: it appears whole or not at all. Several: it fills one by one; what an
        interrupted run has finished is kept, and taken over by the next run with the same measurement and options.
    force: Replace earlier results, interrupted ones too.
    report: Add ``report.html``, also to the folders of the worst dozen of a field.
    Returns: The rows of the field, the worst first.
    InputError: The measurement cannot be meant, or the folder cannot be used.
    EstimationError: No heliostat could be calibrated.
    KeyboardInterrupt: With what is finished in its text.
    """
    options, progress = options or Options(), progress or SilentProgress()
    with progress.stage("look at heliostats"):
        campaign = options.choose(measurement)
    if len(campaign.names) == 1:
        job, own = (lambda: run(measurement, options, progress)), measurement.folder
        result = into_folder(out, job, progress, force=force, report=report, measured=own)
        return FieldResult(result.rows, result.summarise(), splits=split_lines(result.heliostats[0]))
    with pictures_of_failure(out), FieldFolder(out, force=force) as folder:
        try:
            campaign = with_field(campaign, options.workers, progress)
            filled = _fill(folder, campaign, measurement, options, progress)
        except KeyboardInterrupt:
            count = len(folder.finished.keys() | folder.before.keys())
            kept = f"{count} of {len(campaign.names)} heliostats are finished in {out}; the same command continues"
            raise KeyboardInterrupt(kept if count else "nothing was written") from None
    if report:
        for row in filled.rows[:_MOST_REPORTS]:
            if (out / row["heliostat"] / SUMMARY_FILE).is_file():
                add_report(out / row["heliostat"], progress)
        add_report(out, progress)
    return filled


def _fill(
    folder: FieldFolder, campaign: Campaign, measurement: HeliostatMeasurement, options: Options, progress: Progress
) -> FieldResult:
    with progress.stage("hash inputs"):
        hashes = hash_files(campaign.source.files, measurement.folder)
    common = _digest(campaign.shared)
    failures: dict[str, Failure] = {}
    digests: dict[str, str] = {}
    observations: dict[str, str] = {}
    processes = options.workers.processes(len(campaign.names), worth=WORTH[campaign.shared.thorough])
    for name in campaign.names:
        if name in folder.spoiled:
            progress.say(f"{name}: calibrated again: {folder.spoiled[name]}")
    with progress.stage("calibrate heliostats", len(campaign.names)) as stage:

        def fresh() -> Iterator[HeliostatTask]:
            """Yield what is not finished yet; what was finished from the same is taken over."""
            for task in campaign.source.tasks(campaign.names):
                digest = task.digest(common)
                observations[task.name] = task.observations_digest()
                earlier = folder.before.get(task.name)
                if earlier is not None and earlier.digest == digest:
                    folder.finished[task.name] = earlier
                    stage.advance()
                else:
                    digests[task.name] = digest
                    yield task

        for done in run_each(_finish, campaign.shared, fresh(), workers=options.workers, processes=processes):
            name, outcome = done.task.name, done.outcome
            if isinstance(outcome, Failure):
                failures[name] = outcome
                files = {"error.txt": outcome.trace.encode()} if outcome.trace else {}
                folder.keep(name, digests.pop(name), failed_row(name, outcome.reason, outcome.kind), files)
            else:
                folder.keep(name, digests.pop(name), outcome.row, outcome.files)
            stage.advance()
    if len(failures) == len(campaign.names):
        folder.finished.clear()
        refuse_all(failures)
    resumed = sum(folder.finished[name] is folder.before.get(name) for name in campaign.names)
    compared = _compared(folder, campaign.names)
    rows = worst_first(
        [{key: cell for key, cell in compared.rows[name].items() if key != VIEW} for name in campaign.names]
    )
    with progress.stage("write results"):
        summary = field_summary(
            measurement.model.name,
            rows,
            campaign.shared,
            durations_s=dict(progress.durations_s),
            input_sha256={**hashes, "observations": digest_of_all(observations)},
            of_field=(*campaign.source.doubts, *compared.doubts),
        )
        write_field(folder.path, rows)
        write_summary(folder.path / "summary.json", summary)
    return FieldResult(rows, summary, resumed)


@dataclass(frozen=True, slots=True)
class _Compared:
    """The rows of the field once its heliostats were compared, and what concerns it as a whole."""

    rows: dict[str, dict[str, Any]]
    doubts: tuple[Doubt, ...]


def _compared(folder: FieldFolder, names: Sequence[str]) -> _Compared:
    """Compare the diagnoses of a field's heliostats, and write anew the few that read otherwise beside the others."""
    rows = {name: dict(folder.finished[name][1]) for name in names}
    diagnoses = {name: Diagnosis.from_content(row[VIEW]) for name, row in rows.items() if row.get(VIEW)}
    judgement = judge_field(diagnoses)
    for name, changed in judgement.changed.items():
        rewrite_diagnosis(folder.path / name, diagnoses[name], changed)
        folder.note(name, folder.finished[name].digest, folder.finished[name].row)
        rows[name] = changed_row(rows[name], diagnoses[name], changed)
    return _Compared(rows, tuple(one.doubt for one in judgement.findings))


def _digest(shared: Shared) -> str:
    plant = shared.plant
    targets = [
        (name, one.center_m.tolist(), one.axes.tolist(), one.width_m, one.height_m)
        for name, one in plant.targets.items()
    ]
    said = (
        __version__,
        plant.origin,
        plant.site,
        targets,
        plant.other_targets,
        shared.model.model_dump_json(),
        shared.split,
        shared.free,
        shared.label,
        shared.thorough,
        _common(shared.field),
    )
    return hashlib.sha256(repr(said).encode()).hexdigest()


def _common(field: Field | None) -> tuple[Any, ...]:
    """Return what the heliostats know of each other, without the last digits, which differ between processors."""
    if field is None:
        return ()
    models = sorted(field.models.items())
    return field.grouping, [
        (names, group, model.units, model.helps, [f"{value:.3g}" for value in (*model.mean, *model.scatter)])
        for (names, group), model in models
    ]


def _finish(shared: Shared, task: HeliostatTask) -> _Finished:
    """Calibrate a heliostat and return its files, so that whoever asked can write them, here or on another machine."""
    result = calibrate_one(shared, task)
    summary = heliostat_summary(
        result, durations_s={"calibrate": result.duration_s}, input_sha256={"task": task.digest("")}
    )
    row = field_row(result) | {VIEW: view_of(result.diagnosis)}
    return _Finished(row, result_files(result, shared, summary))
