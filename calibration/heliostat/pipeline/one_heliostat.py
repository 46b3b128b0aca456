"""One heliostat from its task to its result: design, observations, choice of the model, fit, splits."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from calibration.heliostat.diagnosis.full_diagnosis import Diagnosis, Records, diagnose
from calibration.heliostat.files.sources import HeliostatTask, Plant
from calibration.heliostat.files.store_paint import parse_calibrations, parse_properties
from calibration.heliostat.fitting.fit_result import FitOptions, HeliostatFit
from calibration.heliostat.fitting.model_choice import ModelChoice, choose_model, with_priors
from calibration.heliostat.fitting.population import Population, with_population
from calibration.heliostat.fitting.prediction import predict_aim
from calibration.heliostat.fitting.robust_fit import fit
from calibration.heliostat.fitting.splits import SPLIT_NAMES, HeldOut, held_out, make_split
from calibration.heliostat.keys import HeliostatModel
from calibration.heliostat.kinematic_model.design import HeliostatDesign
from calibration.heliostat.observations.observed import Observed, observed, site_of
from calibration.heliostat.observations.rows import Rows, parse_rows
from calibration.heliostat.pipeline.nominal_design import nominal_design, told_free
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.sun import direction_from_angles
from heliogauge.validate import BoolArray, FloatArray, freeze

if TYPE_CHECKING:
    from calibration.heliostat.beam_photos.pipeline.measure import BeamMeasurements

AUTO = "auto"
#: Name of the model in which values and priors come from the other heliostats of the field.
FIELD = "priors of the field"
#: More readings than this beyond the actuators' geometry are not slips of single rows.
_FEW_BEYOND = 0.02
#: A median farther from the best fit than this is no matter of which parameters are free [rad of the beam].
_HOPELESS_RAD = 0.02
#: Grid of suns for the map of predicted uncertainty [deg].
SKY_AZIMUTHS_DEG = tuple(range(0, 360, 15))
SKY_ELEVATIONS_DEG = tuple(range(10, 90, 10))
#: The sun's largest declination, with its radius [deg].
_LARGEST_DECLINATION_DEG = 23.7
#: More refused rows than this make the rest doubtful too.
_FEW_REFUSED = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Shared:
    """What all heliostats of a run share; sent to each worker once.

    plant: Targets and site.
    model: What measurement.toml says.
    split: The split that the residuals are told by.
    free: Usual choice of free parameters, or "auto".
    label: Method of the beams' centres in PAINT's records.
    folder: The measurement's folder; where work is done elsewhere, photos must be found there too.
    thorough: Try the model out on every split, and choose it again for each.
    population: What the heliostats of the field have in common; None where each is taken for itself.
    """

    plant: Plant
    model: HeliostatModel
    split: str
    free: str
    label: str
    folder: Path
    thorough: bool
    population: Population | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SkyMap:
    """Predicted uncertainty of the beam on one target, over the sky.

    target: Whose centre is aimed at.
    sigma_beam_rad (elevations, azimuths): Expected error of the beam [rad]; NaN where the sun never stands or the
        drives cannot point.
    extrapolated (elevations, azimuths): Whether the sun stands beyond those that were used.
    """

    target: str
    sigma_beam_rad: FloatArray
    extrapolated: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class HeliostatResult:
    """A calibrated heliostat.

    nominal: As it was known before.
    seen: All rows with the verdict on each.
    fit: To all usable observations.
    free: Which parameters were free.
    choice: Why; None where the user said it.
    split: The split that the residuals are told by.
    held: What came of each split that could be made: fit to one part, prediction of the other.
    diagnosis: What is wrong with the heliostat or its records.
    not_split: Why the other splits could not be made.
    sky: Predicted uncertainty over the sky; thorough runs only.
    beams: What was measured in photos; None where no row names one.
    doubts: What makes the numbers doubtful.
    notes: What is good to know besides.
    properties: The properties file of PAINT it came from; empty with tables.
    duration_s: Time it took [s].
    """

    name: str
    nominal: HeliostatDesign
    seen: Observed
    fit: HeliostatFit
    free: str
    choice: ModelChoice | None
    split: str
    held: Mapping[str, HeldOut]
    diagnosis: Diagnosis
    not_split: Mapping[str, str] = field(default_factory=dict)
    sky: SkyMap | None = None
    beams: "BeamMeasurements | None" = None
    doubts: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    properties: str = ""
    duration_s: float = 0.0

    @property
    def main(self) -> HeldOut | None:
        """What came of the split that the residuals are told by; None where it could not be made."""
        return self.held.get(self.split)


def calibrate_one(shared: Shared, task: HeliostatTask) -> HeliostatResult:
    """Calibrate one heliostat.

    Returns: Fit, splits, and a verdict on every row.
    InputError: What is known of it or its observations cannot be meant.
    EstimationError: No row can be used, or they do not determine the answer.
    """
    begin = perf_counter()
    nominal, seen, beams = _look(shared, task)
    if seen.observations is None:
        raise EstimationError(f"{task.name}: {_all_refused(seen.rows)}")
    options = _fit_options(seen)
    chosen, choice, free = _chosen(nominal, seen, shared, options)
    result = fit(chosen, seen.observations, options)
    held, not_split = _splits((nominal, chosen), choice, seen, shared, options, hopeless=_is_hopeless(result))
    main = held.get(shared.split)
    records = Records(seen.rows.flags, seen.rows.text("image"), seen.rows.times, seen.rows.ids)
    # A field's scatter says what is usual, not what a heliostat was delivered as: faults are judged by the latter.
    judged = result if shared.population is None else fit(with_priors(nominal), seen.observations, options)
    diagnosis = diagnose(judged, targets=shared.plant.targets, site=site_of(shared.plant.site), records=records)
    sky = _sky(result, shared, None if main is None else main.prediction.inflation) if shared.thorough else None
    doubts, notes = _said(task, seen, result, (held, not_split), shared)
    doubts = tuple(dict.fromkeys((*diagnosis.doubts, *doubts)))
    return HeliostatResult(
        name=task.name,
        nominal=nominal,
        seen=seen,
        fit=result,
        free=free,
        choice=choice,
        split=shared.split,
        held=held,
        not_split=not_split,
        diagnosis=diagnosis,
        sky=sky,
        beams=beams,
        doubts=doubts,
        notes=notes,
        properties=task.properties,
        duration_s=perf_counter() - begin,
    )


def fit_alone(shared: Shared, task: HeliostatTask) -> HeliostatFit | None:
    """Fit a heliostat within its own priors: a first look, of which the field's population is made."""
    nominal, seen, _ = _look(shared, task)
    if seen.observations is None:
        return None
    found = fit(with_priors(nominal), seen.observations, _fit_options(seen))
    return None if _is_hopeless(found) or not found.converged else found


def _look(shared: Shared, task: HeliostatTask) -> "tuple[HeliostatDesign, Observed, BeamMeasurements | None]":
    if task.fault:
        raise InputError(f"{task.name}: {task.fault}")
    nominal = nominal_design(task, shared.plant, shared.model.kinematics)
    rows, beams = _rows(task, shared)
    return nominal, observed(rows, nominal, shared.plant, shared.model), beams


def _fit_options(seen: Observed) -> FitOptions:
    return FitOptions(sigma="auto" if seen.has_sigmas else "estimated")


def _rows(task: HeliostatTask, shared: Shared) -> tuple[Rows, "BeamMeasurements | None"]:
    if task.header:
        rows = parse_rows(task.header, [(int(number), text) for number, text in task.records])
        if not shared.model.images:
            return rows, None
        # OpenCV costs 0.1 s, which only photos are worth.
        from calibration.heliostat.pipeline.photo_beams import with_measured_beams

        return with_measured_beams(rows, shared.folder, shared.plant, shared.model)
    return parse_calibrations(task.records, task.times, label=shared.label, origin=shared.plant.origin), None


def _all_refused(rows: Rows) -> str:
    if not len(rows):
        return "no observations"
    reasons = list(rows.reasons)
    common = max(dict.fromkeys(reasons), key=reasons.count)
    return f"none of {len(rows)} observations can be used; {rows.ids[reasons.index(common)]}: {common}"


def _is_hopeless(found: HeliostatFit) -> bool:
    """Whether something is wrong that no choice of parameters mends: trying them all would only take time."""
    angles = found.residuals.beam_angle_rad[np.isfinite(found.residuals.beam_angle_rad)]
    return bool(angles.size) and float(np.median(angles)) > _HOPELESS_RAD


def _says_itself(shared: Shared) -> bool:
    return shared.free == AUTO and told_free(shared.model.kinematics)


def _sky(result: HeliostatFit, shared: Shared, inflation: float | None) -> SkyMap | None:
    """Return the predicted uncertainty wherever the sun can stand."""
    targets = shared.plant.targets
    name = next((label for label in result.observations.label if label in targets), next(iter(targets), None))
    if name is None:
        return None
    azimuth, elevation = np.meshgrid(np.deg2rad(SKY_AZIMUTHS_DEG), np.deg2rad(SKY_ELEVATIONS_DEG))
    latitude = np.deg2rad(shared.plant.origin[0])
    rise = np.sin(latitude) * np.sin(elevation) + np.cos(latitude) * np.cos(elevation) * np.cos(azimuth)
    stands = np.abs(rise) <= np.sin(np.deg2rad(_LARGEST_DECLINATION_DEG))
    sigma, beyond = np.full(azimuth.shape, np.nan), np.zeros(azimuth.shape, dtype=np.bool_)
    if stands.any():
        suns = direction_from_angles(azimuth[stands], elevation[stands])
        predicted = predict_aim(result, suns, targets[name].center_m, inflation=inflation)
        sigma[stands] = predicted.sigma_beam_rad
        beyond[stands] = predicted.extrapolated & predicted.usable
    return SkyMap(name, np.asarray(freeze(sigma)), np.asarray(freeze(beyond)))


def _chosen(
    nominal: HeliostatDesign, seen: Observed, shared: Shared, options: FitOptions
) -> tuple[HeliostatDesign, ModelChoice | None, str]:
    """Return the design with the parameters that shall be free, how that came about, and its name."""
    if _says_itself(shared):
        free = shared.model.kinematics.free
        return nominal, None, free if isinstance(free, str) else "as the measurement says"
    if shared.free != AUTO:
        return nominal.with_free(shared.free), None, shared.free
    known = with_priors(nominal), None, "all with priors"
    if seen.observations is None or not shared.thorough:
        return known
    if shared.population is not None and shared.population.knows(nominal.name):
        usual = with_population(known[0], shared.population)
        # What is usual is no help to a heliostat that something is wrong with.
        return known if _is_hopeless(fit(usual, seen.observations, options)) else (usual, None, FIELD)
    if _is_hopeless(fit(known[0], seen.observations, options)):
        return known
    choice = choose_model(nominal, seen.observations, options)
    return choice.design, choice, choice.best


def _splits(
    designs: tuple[HeliostatDesign, HeliostatDesign],
    choice: ModelChoice | None,
    seen: Observed,
    shared: Shared,
    options: FitOptions,
    *,
    hopeless: bool,
) -> tuple[dict[str, HeldOut], dict[str, str]]:
    nominal, chosen = designs
    held: dict[str, HeldOut] = {}
    not_split: dict[str, str] = {}
    if seen.observations is None:
        return held, not_split
    # The choice is part of what is tried out: it is made again from the training rows alone.
    design, chooser = (chosen, None) if choice is None else (nominal, choose_model)
    others = SPLIT_NAMES if shared.thorough and not hopeless else ()
    options = replace(options, restarts=0) if hopeless else options
    names = tuple(dict.fromkeys((shared.split, *others)))
    for name in names:
        column = None
        if name == "column":
            told = seen.rows.text("split", "train")
            column = tuple(told[row] for row in seen.observations.row.tolist())
        try:
            split = make_split(seen.observations, name, seed=shared.model.evaluation.random_seed, column=column)
            held[name] = held_out(design, seen.observations, split, options, chooser=chooser)
        except (EstimationError, InputError) as error:
            not_split[name] = str(error)
    return held, not_split


def _without_sigma(rows: Rows) -> tuple[str, ...]:
    """Return the usable beams of a table whose own cell of ``sigma_mm`` is empty; none where both axes have columns."""
    if "sigma_mm" not in rows.numbers or "sigma_x_mm" in rows.numbers:
        return ()
    given, kinds = rows.numbers["sigma_mm"], rows.text("kind", "beam")
    return tuple(
        rows.ids[row]
        for row in np.flatnonzero(np.isnan(given)).tolist()
        if kinds[row] == "beam" and not rows.flags[row]
    )


def _said(
    task: HeliostatTask,
    seen: Observed,
    result: HeliostatFit,
    splits: tuple[Mapping[str, HeldOut], Mapping[str, str]],
    shared: Shared,
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return what makes the numbers doubtful, and what is only good to know."""
    held, not_split = splits
    doubts: list[str] = []
    notes: list[str] = []
    if task.properties:
        doubts += list(parse_properties(task.properties, task.name).doubts)
    beyond = ~result.residuals.computable
    if np.count_nonzero(beyond) > _FEW_BEYOND * len(beyond):
        doubts.append(
            f"{np.count_nonzero(beyond)} of {len(beyond)} readings cannot be reached with the actuators as delivered: "
            "their numbers (strokes, offsets, radii) are wrong for this heliostat"
        )
    rows = seen.rows
    refused = [flag for flag in rows.flags if flag]
    for flag in dict.fromkeys(refused):
        first, count = rows.flags.index(flag), refused.count(flag)
        text = f"{count} of {len(rows)} rows left out ({flag}), the first: {rows.ids[first]}: {rows.reasons[first]}"
        (doubts if count > _FEW_REFUSED * len(rows) else notes).append(text)
    if shared.population is not None and shared.population.knows(task.name):
        others = len(set(shared.population.heliostats) - {task.name})
        common = ", ".join(shared.population.names)
        notes.append(f"{others} other heliostats of the field say what is usual: values and priors of {common}")
    if not seen.has_sigmas:
        notes.append(
            f"the observations come without sigmas: {shared.model.evaluation.spot_sigma_mm:g} mm is taken for beams, "
            "and its scale estimated from the residuals"
        )
    elif empty := _without_sigma(rows):
        doubts.append(
            f"{len(empty)} of {len(rows)} rows have no sigma_mm beside others that have one, the first: {empty[0]}: "
            f"{shared.model.evaluation.spot_sigma_mm:g} mm is taken for them"
        )
    for text in result.doubts:
        # That the scale of the sigmas is estimated is no fault of the heliostat.
        (notes if text.startswith("sigma of ") else doubts).append(text)
    main = held.get(shared.split)
    if main is not None:
        # Extrapolation is told before any number; the rest are warnings of the fit to the train rows.
        doubts = [text for text in main.doubts if text.startswith("split ")] + doubts
    elif shared.split in not_split:
        notes.append(f"nothing was held out: {not_split[shared.split]}")
    return tuple(dict.fromkeys(doubts)), tuple(dict.fromkeys(notes))
