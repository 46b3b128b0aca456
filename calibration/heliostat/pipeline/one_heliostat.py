"""One heliostat from its task to its result, stage by stage."""

from dataclasses import dataclass
from functools import partial
from time import perf_counter

from calibration.heliostat.diagnosis.full_diagnosis import REMEDIED, Diagnosis, Records, diagnose
from calibration.heliostat.files.result import FIELD, REMEDY, HeliostatResult, Shared
from calibration.heliostat.files.sources import HeliostatTask
from calibration.heliostat.fitting.field_fit import WithinField, field_names, linear_rows
from calibration.heliostat.fitting.field_model import FieldUnit
from calibration.heliostat.fitting.fit_result import FitOptions
from calibration.heliostat.fitting.priors import PRIORS
from calibration.heliostat.fitting.robust_fit import fit
from calibration.heliostat.observations.observed import Observed
from calibration.heliostat.observations.rows import Rows
from calibration.heliostat.pipeline.doubts import collect_doubts
from calibration.heliostat.pipeline.free_parameters import (
    FreeParameters,
    choose_free_parameters,
    is_hopeless,
    starting_design,
    unit_groups,
)
from calibration.heliostat.pipeline.reading import read_task
from calibration.heliostat.pipeline.sky_map import map_sky
from calibration.heliostat.pipeline.trials import try_out
from heliogauge.doubts import Severity, gather_doubts
from heliogauge.errors import EstimationError, showing

#: A median farther from the best fit than this is another machine or another sky, not a misfit [rad of the beam].
IMPOSSIBLE_RAD = 0.1


def calibrate_one(shared: Shared, task: HeliostatTask) -> HeliostatResult:
    """Calibrate one heliostat.

    Returns: Fit, splits, and a verdict on every row.
    InputError: What is known of it or its observations cannot be meant.
    EstimationError: No row can be used, they do not determine the answer, or nothing brings it near them.
    """
    begin = perf_counter()
    given = read_task(task, shared)
    nominal, seen, rows, observations = given.nominal, given.seen, given.seen.rows, given.seen.observations
    if observations is None:
        with showing(lambda: () if given.beams is None else given.beams.pictures_of_refused()):
            raise EstimationError(f"{task.name}: {why_none(rows)}")
    options = _fit_options(seen)
    free = choose_free_parameters(nominal, observations, shared, options)
    # Faults are judged by how a heliostat was delivered: by the fit that knows nothing of the field.
    stated = free.first if free.first is not None else fit(free.design, observations, options)
    records = Records(rows.flags, rows.text("image"), rows.times, rows.ids)
    asked = partial(diagnose, targets=shared.plant.targets, site=shared.plant.site, records=records)
    diagnosis = asked(stated)
    if free.judged is not None and diagnosis.remedied is None and set(diagnosis.kinds) & set(REMEDIED):
        # Stated parameters may bend as far as they can, and leave nothing that can be undone.
        usual = asked(fit(free.judged, observations, options))
        diagnosis = usual if usual.remedied is not None else diagnosis
    refuse_impossible(task.name, diagnosis)
    remedied = diagnosis.remedied
    if remedied is not None:
        # What is wrong as a whole is undone: the heliostat as it was stated comes second.
        observations = remedied.observations
        free = FreeParameters(remedied.nominal, f"{REMEDY}: {diagnosis.kinds[0]}", is_stated=True)
        first = fit(free.design, observations, options)
    else:
        first = stated
    hopeless = is_hopeless(first)
    within = WithinField(first, False) if hopeless else free.within(first)
    result = within.fit
    trials = try_out(nominal, free, observations, rows, shared, options, hopeless=hopeless, near=first)
    sky = map_sky(result, shared.plant)
    found = gather_doubts(diagnosis.doubts, collect_doubts(task, seen, within, free.field, trials, shared))
    return HeliostatResult(
        name=task.name,
        nominal=nominal,
        seen=seen,
        fit=result,
        as_stated=stated if remedied is not None else None,
        free=FIELD if within.by_field else free.name,
        choice=free.choice,
        split=shared.split,
        held=trials.held,
        not_split=trials.not_made,
        diagnosis=diagnosis,
        sky=sky,
        beams=given.beams,
        doubts=tuple(one for one in found if one.severity is not Severity.NOTE),
        notes=tuple(one for one in found if one.severity is Severity.NOTE),
        properties=task.properties,
        observations_sha256=task.observations_digest(),
        duration_s=perf_counter() - begin,
    )


@dataclass(frozen=True, slots=True, eq=False)
class FirstLook:
    """What a heliostat tells about its field.

    unit: Its observations about the fit within general priors.
    scales: Prior sigma of each parameter.
    """

    unit: FieldUnit
    scales: dict[str, float]


class ImpossibleError(EstimationError):
    """A heliostat is so far from its observations that no number of it can be true."""

    kind = "unexplained"


def refuse_impossible(name: str, diagnosis: Diagnosis) -> None:
    """Refuse a heliostat that nothing brings near its observations.

    ImpossibleError: With what was tried.
    """
    for finding in diagnosis.findings:
        far = 1e-3 * finding.evidence.get("median_before_mrad", 0.0)
        if finding.kind == "unexplained" and far > IMPOSSIBLE_RAD:
            raise ImpossibleError(f"{name}: {finding.text} {finding.remedy}")


def look_first(shared: Shared, task: HeliostatTask) -> FirstLook | None:
    """Look at a heliostat alone, for what it tells about the field; at one that is hopeless there is nothing to see."""
    given = read_task(task, shared)
    if given.seen.observations is None:
        return None
    design = starting_design(given.nominal)
    found = fit(design, given.seen.observations, _fit_options(given.seen))
    if is_hopeless(found) or not found.converged:
        return None
    names = field_names(design)
    unit = FieldUnit(task.name, linear_rows(found, names), unit_groups(given.nominal))
    return FirstLook(unit, {name: PRIORS[name].of(design.parameters.value(name)) for name in names})


def _fit_options(seen: Observed) -> FitOptions:
    return FitOptions(sigma="auto" if seen.has_sigmas else "estimated")


def why_none(rows: Rows) -> str:
    """Say why no observation of a heliostat can be used."""
    if not len(rows):
        return "no observations"
    reasons = list(rows.reasons)
    common = max(dict.fromkeys(reasons), key=reasons.count)
    return f"none of {len(rows)} observations can be used; {rows.ids[reasons.index(common)]}: {common}"
