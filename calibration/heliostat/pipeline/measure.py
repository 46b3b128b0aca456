"""Observations of heliostats to tracking models one can trust: read, fit each, try it out, write."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from calibration.heliostat.diagnosis.field_findings import judge_field
from calibration.heliostat.diagnosis.findings import Diagnosis
from calibration.heliostat.files.result import HeliostatResult, Shared
from calibration.heliostat.files.sources import HeliostatTask, digest_of_all
from calibration.heliostat.files.store_field import (
    FIELD_KIND,
    failed_row,
    field_row,
    field_summary,
    headline_text,
    split_lines,
    worst_first,
    write_field,
)
from calibration.heliostat.files.store_heliostat import heliostat_summary
from calibration.heliostat.keys import HeliostatMeasurement
from calibration.heliostat.pipeline.campaign import WORTH, Campaign, choose, with_field
from calibration.heliostat.pipeline.one_heliostat import calibrate_one
from calibration.heliostat.pipeline.writing import write_heliostat_files, write_result
from heliogauge.doubts import Doubt
from heliogauge.errors import EstimationError
from heliogauge.results.folder import Summary, hash_files
from heliogauge.results.frame import InstrumentResult
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.running.scale import Failure, Workers, run_each


@dataclass(frozen=True, slots=True)
class Options:
    """Choices of the evaluation; what is None is as in measurement.toml.

    Parameters
    ----------
    split : str or None
        What the model is tried out on: "chronological", "random", "azimuth", "azimuth-reversed", "high-variance", or
        "column" of the table.
    model : str or None
        Usual choice of free parameters of the preset ("4", "8", "15", ...), or "auto".
    label : str or None
        Method of the beams' centres in PAINT's records: "UTIS" or "HeliOS".
    only : str or None
        Heliostats to calibrate, by name, a text with ``*``; several with commas.
    thorough : bool or None
        Make every split, and choose the model by trial; None for small fields only.
    jobs : int or None
        Processes side by side; None for all processors.
    scheduler : str or None
        Address of a Dask cluster that does the work instead.
    """

    split: str | None = None
    model: str | None = None
    label: str | None = None
    only: str | None = None
    thorough: bool | None = None
    jobs: int | None = None
    scheduler: str | None = None

    def choose(self, measurement: HeliostatMeasurement) -> Campaign:
        """Return the heliostats of a measurement that are to be calibrated, and what they share."""
        return choose(
            measurement, split=self.split, model=self.model, label=self.label, only=self.only, thorough=self.thorough
        )

    @property
    def workers(self) -> Workers:
        """Who does the work."""
        return Workers(self.jobs, self.scheduler)


@dataclass(frozen=True, slots=True, eq=False)
class Result(InstrumentResult):
    """Calibrated heliostats.

    Parameters
    ----------
    shared : Shared
        What all share.
    heliostats : tuple of HeliostatResult
        Those that could be calibrated, in the order of the measurement.
    failures : dict of str to Failure
        Why the others could not.
    of_field : tuple of Doubt
        What concerns the field as a whole.
    observations_sha256 : str
        Hash of the observations of all, those that could not be calibrated too.
    name : str
        Name of the measurement.
    doubts : tuple of Doubt
        What makes the results doubtful; with the name of the heliostat where there are several.
    durations_s : mapping of str to float
        Wall time of each stage [s].
    input_sha256 : mapping of str to str
        Hash of each file that was read.
    """

    kind: ClassVar[str] = FIELD_KIND
    shared: Shared
    heliostats: tuple[HeliostatResult, ...]
    failures: dict[str, Failure]
    of_field: tuple[Doubt, ...] = ()
    observations_sha256: str = ""

    @property
    def only_one(self) -> HeliostatResult | None:
        """The heliostat, where the measurement is of a single one."""
        return self.heliostats[0] if len(self.heliostats) == 1 and not self.failures else None

    @property
    def rows(self) -> list[dict[str, Any]]:
        """The rows of ``field.csv``, those without a model last."""
        good = [field_row(one) for one in self.heliostats]
        return good + [failed_row(name, failure.reason, failure.kind) for name, failure in self.failures.items()]

    def summarise(self) -> Summary:
        """Collect the headline numbers of the heliostat, or of the field."""
        durations, hashes = self.durations_s, self.input_sha256
        if self.only_one is not None:
            return heliostat_summary(self.only_one, durations_s=durations, input_sha256=hashes)
        hashes = {**hashes, "observations": self.observations_sha256}
        return field_summary(
            self.name, self.rows, self.shared, durations_s=durations, input_sha256=hashes, of_field=self.of_field
        )

    def write_files(self, folder: Path) -> None:
        """Write one heliostat, or a folder for each and ``field.csv``, into an existing folder."""
        if self.only_one is not None:
            write_heliostat_files(self.only_one, self.shared, folder)
            return
        for one in self.heliostats:
            place = folder / one.name
            place.mkdir()
            write_result(one, self.shared, place, heliostat_summary(one, durations_s={}, input_sha256={}))
        write_field(folder, self.rows)

    def headline(self) -> str:
        """Return a line for each heliostat, and for a single one what came of each split."""
        return headline_text(worst_first(self.rows), () if self.only_one is None else split_lines(self.only_one))


def run(measurement: HeliostatMeasurement, options: Options | None = None, progress: Progress | None = None) -> Result:
    """Calibrate heliostats and keep everything in memory; for thousands use the command.

    Parameters
    ----------
    measurement : HeliostatMeasurement
        From `heliogauge.load`.
    options : Options, optional
        Choices.
    progress : Progress, optional
        Notified of each stage.

    Returns
    -------
    Result
        Each heliostat with its fit, or why it has none.

    Raises
    ------
    InputError
        The measurement contradicts itself.
    EstimationError
        No heliostat could be calibrated.
    """
    options, progress = options or Options(), progress or SilentProgress()
    with progress.stage("look at heliostats"):
        campaign = options.choose(measurement)
    campaign = with_field(campaign, options.workers, progress)
    with progress.stage("hash inputs"):
        hashes = hash_files(campaign.source.files, measurement.folder)
    processes = options.workers.processes(len(campaign.names), worth=WORTH[campaign.shared.thorough])
    observations: dict[str, str] = {}

    def tasks() -> Iterator[HeliostatTask]:
        for task in campaign.source.tasks(campaign.names):
            observations[task.name] = task.observations_digest()
            yield task

    found: dict[str, HeliostatResult | Failure] = {}
    with progress.stage("calibrate heliostats", len(campaign.names)) as stage:
        for done in run_each(calibrate_one, campaign.shared, tasks(), workers=options.workers, processes=processes):
            found[done.task.name] = done.outcome
            stage.advance()
    heliostats = tuple(one for name in campaign.names if isinstance(one := found[name], HeliostatResult))
    failures = {name: one for name in campaign.names if isinstance(one := found[name], Failure)}
    if not heliostats:
        refuse_all(failures)
    durations = dict(progress.durations_s)
    judgement = judge_field({one.name: one.diagnosis for one in heliostats})
    heliostats = tuple(_beside_others(one, judgement.changed.get(one.name)) for one in heliostats)
    of_field = (*campaign.source.doubts, *(one.doubt for one in judgement.findings))
    if len(heliostats) == 1 and not failures:
        doubts = (*of_field, *heliostats[0].doubts)
        heliostats = (replace(heliostats[0], doubts=doubts),)
    else:
        doubts = (*of_field, *(doubt.prefixed(one.name) for one in heliostats for doubt in one.doubts))
    return Result(
        campaign.shared,
        heliostats,
        failures,
        of_field,
        digest_of_all(observations),
        name=measurement.model.name,
        doubts=doubts,
        durations_s=durations,
        input_sha256=hashes,
    )


def _beside_others(result: HeliostatResult, diagnosis: Diagnosis | None) -> HeliostatResult:
    """Return a heliostat with the diagnosis that the others leave of its own."""
    if diagnosis is None:
        return result
    # Doubts begin with those of the diagnosis.
    rest = result.doubts[len(result.diagnosis.doubts) :]
    return replace(result, diagnosis=diagnosis, doubts=(*diagnosis.doubts, *rest))


def refuse_all(failures: dict[str, Failure]) -> None:
    """Raise the reason why not one heliostat could be calibrated.

    EstimationError: Always, with the first reason.
    """
    first = next(iter(failures.values()))
    if first.trace:
        raise RuntimeError(f"{first.reason}\n{first.trace}")
    alone = len(failures) == 1
    error = EstimationError(
        first.reason if alone else f"none of {len(failures)} heliostats can be calibrated; the first: {first.reason}"
    )
    error.pictures = first.pictures
    raise error
