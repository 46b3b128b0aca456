"""One heliostat from its task to its result, stage by stage."""

from time import perf_counter

from calibration.heliostat.diagnosis.full_diagnosis import Records, diagnose
from calibration.heliostat.files.result import HeliostatResult, Shared
from calibration.heliostat.files.sources import HeliostatTask
from calibration.heliostat.fitting.fit_result import FitOptions, HeliostatFit
from calibration.heliostat.fitting.priors import with_priors
from calibration.heliostat.fitting.robust_fit import fit
from calibration.heliostat.observations.observed import Observed
from calibration.heliostat.observations.rows import Rows
from calibration.heliostat.pipeline.doubts import collect_doubts
from calibration.heliostat.pipeline.free_parameters import choose_free_parameters, is_hopeless
from calibration.heliostat.pipeline.reading import read_task
from calibration.heliostat.pipeline.sky_map import map_sky
from calibration.heliostat.pipeline.trials import try_out
from heliogauge.doubts import Severity, gather_doubts
from heliogauge.errors import EstimationError, showing


def calibrate_one(shared: Shared, task: HeliostatTask) -> HeliostatResult:
    """Calibrate one heliostat.

    Returns: Fit, splits, and a verdict on every row.
    InputError: What is known of it or its observations cannot be meant.
    EstimationError: No row can be used, or they do not determine the answer.
    """
    begin = perf_counter()
    given = read_task(task, shared)
    nominal, seen, rows, observations = given.nominal, given.seen, given.seen.rows, given.seen.observations
    if observations is None:
        with showing(lambda: () if given.beams is None else given.beams.pictures_of_refused()):
            raise EstimationError(f"{task.name}: {why_none(rows)}")
    options = _fit_options(seen)
    free = choose_free_parameters(nominal, observations, shared, options)
    result = fit(free.design, observations, options)
    trials = try_out(nominal, free, observations, rows, shared, options, hopeless=is_hopeless(result))
    # The scatter of a field shows what is usual, not how a heliostat was delivered: faults are judged by the latter.
    judged = result if shared.population is None else fit(with_priors(nominal), observations, options)
    records = Records(rows.flags, rows.text("image"), rows.times, rows.ids)
    diagnosis = diagnose(judged, targets=shared.plant.targets, site=shared.plant.site, records=records)
    main = trials.held.get(shared.split)
    inflation = None if main is None else main.prediction.inflation
    sky = map_sky(result, shared.plant, inflation, thorough=shared.thorough)
    found = gather_doubts(diagnosis.doubts, collect_doubts(task, seen, result, trials, shared))
    return HeliostatResult(
        name=task.name,
        nominal=nominal,
        seen=seen,
        fit=result,
        free=free.name,
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
        duration_s=perf_counter() - begin,
    )


def fit_alone(shared: Shared, task: HeliostatTask) -> HeliostatFit | None:
    """Fit a heliostat within its own priors: a first look, of which the field's population is made."""
    given = read_task(task, shared)
    if given.seen.observations is None:
        return None
    found = fit(with_priors(given.nominal), given.seen.observations, _fit_options(given.seen))
    return None if is_hopeless(found) or not found.converged else found


def _fit_options(seen: Observed) -> FitOptions:
    return FitOptions(sigma="auto" if seen.has_sigmas else "estimated")


def why_none(rows: Rows) -> str:
    """Say why no observation of a heliostat can be used."""
    if not len(rows):
        return "no observations"
    reasons = list(rows.reasons)
    common = max(dict.fromkeys(reasons), key=reasons.count)
    return f"none of {len(rows)} observations can be used; {rows.ids[reasons.index(common)]}: {common}"
