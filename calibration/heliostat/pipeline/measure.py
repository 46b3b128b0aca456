"""Observations of heliostats to tracking models one can trust: read, fit each, try it out, write."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, ClassVar, get_args

from calibration.heliostat.files.field_folder import check_names
from calibration.heliostat.files.result import HeliostatResult, Shared
from calibration.heliostat.files.sources import Source, open_source
from calibration.heliostat.files.store_heliostat import (
    FIELD_KIND,
    failed_row,
    field_row,
    heliostat_summary,
    split_lines,
    worst_first,
    write_field,
)
from calibration.heliostat.fitting.fit_result import HeliostatFit
from calibration.heliostat.fitting.population import Population
from calibration.heliostat.fitting.splits import SPLIT_NAMES
from calibration.heliostat.keys import HeliostatMeasurement, Label, Split
from calibration.heliostat.pipeline.free_parameters import AUTO
from calibration.heliostat.pipeline.nominal_design import frees_parameters
from calibration.heliostat.pipeline.one_heliostat import calibrate_one, fit_alone
from calibration.heliostat.pipeline.writing import write_heliostat_files, write_result
from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import EstimationError, InputError
from heliogauge.results.folder import Summary, hash_files
from heliogauge.results.frame import InstrumentResult
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.running.scale import Failure, Workers, run_each

#: Up to so many heliostats every split is made and the model chosen by trial, unless the user says otherwise: a second
#: each instead of a tenth.
THOROUGH_UP_TO = 25
#: So many sound heliostats say what is usual: each, and four others.
FEWEST_OF_A_FIELD = 5
#: Heliostats that are worth a process of their own, which takes a second to start: quick ones, thorough ones.
WORTH = {False: 16, True: 1}


@dataclass(frozen=True, slots=True)
class Options:
    """Choices of the evaluation; what is None is as the measurement says.

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
    """

    kind: ClassVar[str] = FIELD_KIND
    shared: Shared
    heliostats: tuple[HeliostatResult, ...]
    failures: dict[str, Failure]

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
        return field_summary(self.name, self.rows, self.shared, durations_s=durations, input_sha256=hashes)

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


@dataclass(frozen=True, slots=True, eq=False)
class Chosen:
    """What a run is about: where heliostats come from, which of them, and what they share."""

    source: Source
    names: tuple[str, ...]
    shared: Shared


def run(measurement: HeliostatMeasurement, options: Options | None = None, progress: Progress | None = None) -> Result:
    """Calibrate heliostats and keep everything in memory; for thousands use `calibration.heliostat.pipeline_field`.

    Parameters
    ----------
    measurement : HeliostatMeasurement
        From `heliogauge.measurement.load_heliostat`.
    options : Options, optional
        Choices.
    progress : Progress, optional
        Told of each stage.

    Returns
    -------
    Result
        Each heliostat with its fit, or why it has none.

    Raises
    ------
    InputError
        The measurement cannot be meant.
    EstimationError
        No heliostat could be calibrated.
    """
    options, progress = options or Options(), progress or SilentProgress()
    with progress.stage("look at heliostats"):
        chosen = choose(measurement, options)
    chosen = with_field(chosen, options.workers, progress)
    with progress.stage("hash inputs"):
        hashes = hash_files(chosen.source.files, measurement.folder)
    processes = options.workers.processes(len(chosen.names), worth=WORTH[chosen.shared.thorough])
    tasks = chosen.source.tasks(chosen.names)
    found: dict[str, HeliostatResult | Failure] = {}
    with progress.stage("calibrate heliostats", len(chosen.names)) as stage:
        for done in run_each(calibrate_one, chosen.shared, tasks, workers=options.workers, processes=processes):
            found[done.task.name] = done.outcome
            stage.advance()
    heliostats = tuple(one for name in chosen.names if isinstance(one := found[name], HeliostatResult))
    failures = {name: one for name in chosen.names if isinstance(one := found[name], Failure)}
    if not heliostats:
        refuse_all(failures)
    durations = dict(progress.durations_s)
    if len(heliostats) == 1 and not failures:
        doubts = heliostats[0].doubts
    else:
        doubts = tuple(doubt.prefixed(one.name) for one in heliostats for doubt in one.doubts)
    return Result(
        chosen.shared,
        heliostats,
        failures,
        name=measurement.model.name,
        doubts=doubts,
        durations_s=durations,
        input_sha256=hashes,
    )


def choose(measurement: HeliostatMeasurement, options: Options) -> Chosen:
    """Look at a measurement: which heliostats, and what they share.

    InputError: The measurement cannot be meant, or no heliostat has a name that is asked for.
    """
    source = open_source(measurement)
    names = tuple(_asked_for(source.names, options.only))
    check_names(names)
    evaluation = measurement.model.evaluation
    thorough = len(names) <= THOROUGH_UP_TO if options.thorough is None else options.thorough
    shared = Shared(
        plant=source.plant,
        model=measurement.model,
        split=_one_of("--split", options.split, get_args(Split)) or evaluation.split,
        free=options.model or evaluation.model or AUTO,
        label=_one_of("--label", options.label, get_args(Label)) or evaluation.label,
        folder=measurement.folder.absolute(),
        thorough=thorough,
    )
    return Chosen(source, names, shared)


def with_field(chosen: Chosen, workers: Workers, progress: Progress) -> Chosen:
    """Let heliostats of a small field know what they have in common, where nobody said which parameters are free.

    workers: Who works.
    Returns: With the field's population; as it was for one heliostat, a large field, or beams that are only
        measured yet.
    """
    shared = chosen.shared
    is_stated = shared.free != AUTO or frees_parameters(shared.model.kinematics)
    if is_stated or not shared.thorough or shared.model.images or len(chosen.names) < FEWEST_OF_A_FIELD:
        return chosen
    fits: dict[str, HeliostatFit] = {}
    tasks = chosen.source.tasks(chosen.names)
    processes = workers.processes(len(chosen.names), worth=WORTH[False])
    with progress.stage("what the field has in common", len(chosen.names)) as stage:
        for done in run_each(fit_alone, shared, tasks, workers=workers, processes=processes):
            if isinstance(done.outcome, HeliostatFit):
                fits[done.task.name] = done.outcome
            stage.advance()
    if len(fits) < FEWEST_OF_A_FIELD:
        return chosen
    in_order = [fits[name] for name in chosen.names if name in fits]
    return replace(chosen, shared=replace(shared, population=Population.told_by(in_order)))


def _one_of(flag: str, value: str | None, known: tuple[str, ...]) -> str | None:
    if value is not None and value not in known:
        near = get_close_matches(value, known, n=1)
        raise InputError(f"{flag} {value}: " + (f"did you mean {near[0]}?" if near else f"say {', '.join(known)}"))
    return value


def _asked_for(names: tuple[str, ...], only: str | None) -> Iterator[str]:
    if only is None:
        yield from names
        return
    patterns = [text.strip() for text in only.split(",")]
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in names):
            raise InputError(f"--only {pattern}: no heliostat of that name; there are {', '.join(names[:8])}")
    yield from (name for name in names if any(fnmatchcase(name, pattern) for pattern in patterns))


def refuse_all(failures: dict[str, Failure]) -> None:
    """Say why not one heliostat could be calibrated.

    EstimationError: Always, with the first reason.
    """
    first = next(iter(failures.values()))
    if first.trace:
        raise RuntimeError(f"{first.reason}\n{first.trace}")
    if len(failures) == 1:
        raise EstimationError(first.reason)
    raise EstimationError(f"none of {len(failures)} heliostats can be calibrated; the first: {first.reason}")


def field_summary(
    name: str,
    rows: list[dict[str, object]],
    shared: Shared,
    *,
    durations_s: Mapping[str, float],
    input_sha256: Mapping[str, str],
) -> Summary:
    """Return the summary of a field.

    shared: What all heliostats share.
    durations_s: Time of each stage [s].
    input_sha256: Hashes of what was read.
    """
    import numpy as np

    good = [row for row in rows if row["status"] != "failed"]
    numbers: dict[str, float | int | None] = {
        "heliostats_count": len(rows),
        "calibrated_count": len(good),
        "failed_count": len(rows) - len(good),
        "faulty_count": sum(row["status"] == "faulty" for row in rows),
        "doubtful_count": sum(row["status"] == "doubtful" for row in rows),
    }
    missing = {}
    asked = ["beam_test_rms_mrad", "beam_train_rms_mrad", "normal_test_rms_mrad", "predicted_sigma_beam_mrad"]
    asked += [f"beam_{split.replace('-', '_')}_test_rms_mrad" for split in SPLIT_NAMES if shared.thorough]
    for key in asked:
        known = [float(str(row[key])) for row in good if row.get(key) is not None]
        if not known and key not in asked[:4]:
            continue
        numbers[f"median_{key}"] = float(np.median(known)) if known else None
        if not known:
            missing[f"median_{key}"] = "no heliostat has it"
    worst = [row for row in good if row.get("beam_test_rms_mrad") is not None]
    doubts = [
        Doubt("heliostat_failed", f"{row['heliostat']} failed: {row['reason']}")
        for row in rows
        if row["status"] == "failed"
    ]
    doubts += [
        Doubt(
            "heliostat_faulty",
            f"{row['heliostat']} ({row['diagnosis']}): {row['reason']}",
            severity=Severity.SERIOUS,
        )
        for row in rows
        if row["status"] == "faulty"
    ]
    texts = {"split": shared.split, "model": shared.free, "every split made": "yes" if shared.thorough else "no"}
    if worst:
        first = max(worst, key=lambda row: float(str(row["beam_test_rms_mrad"])))
        texts["worst"] = f"{first['heliostat']}: {float(str(first['beam_test_rms_mrad'])):.2f} mrad"
    return Summary(
        kind=FIELD_KIND,
        name=name,
        numbers=numbers,
        texts=texts,
        doubts=tuple(doubts[:100]),
        durations_s=durations_s,
        input_sha256=input_sha256,
        not_determined=missing,
    )


def headline_text(rows: Sequence[Mapping[str, Any]], splits: Sequence[str] = ()) -> str:
    """Return the most important numbers in a few lines.

    rows: Rows of ``field.csv``, the worst first.
    splits: For a single heliostat: what came of each split.
    """
    lines = []
    shown = rows[:20]
    for row in shown:
        if row["status"] == "failed":
            lines.append(f"{row['heliostat']}: not calibrated: {row['reason']}")
            continue
        lines.append(
            f"{row['heliostat']}{_found(row)}: {row['used_count']} of {row['observations_count']} observations, model "
            f"{row['model']}: beam {_mrad(row['beam_train_rms_mrad'])} train, {_mrad(row['beam_test_rms_mrad'])} test; "
            f"normal {_mrad(row['normal_train_rms_mrad'])}, {_mrad(row['normal_test_rms_mrad'])} (RMS)"
        )
    lines += splits if len(splits) > 1 else ()
    if len(rows) > len(shown):
        lines.append(f"... and {len(rows) - len(shown)} more, better ones: field.csv")
    return "\n".join(lines)


def _found(row: Mapping[str, Any]) -> str:
    kinds = str(row.get("diagnosis") or "").replace("_", " ")
    return f" ({kinds})" if kinds else ""


def _mrad(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f} mrad"
