"""A trough that was or will be measured, and the pass that is planned over it."""

from pathlib import Path

from heliogauge.errors import InputError
from heliogauge.measurement.load import MEASUREMENT_FILE, kind_of
from heliogauge.results.folder import read_summary
from heliogauge.running.either_folder import is_result, measurement_of, planned_from
from heliogauge.running.progress import Progress
from observer.keys import ObserverModel, load_observer
from observer.planning.keys import (
    ObserverPlanMeasurement,
    ObserverPlanModel,
    PlannedMirrorSection,
    PlannedTargetsSection,
    load_observer_plan,
)


def planned_measurement(folder: Path, progress: Progress) -> ObserverPlanMeasurement:
    """Return what is to be planned.

    folder: A plan; a measurement, of which collector, camera, targets and lengths are taken, with the pass that a plan
        has by default; or results of either. Those of a measurement give the mirror and the camera besides.
    InputError: None of them, or a measurement without marked targets or a known camera.
    """
    folder = planned_from(folder, progress.say)
    place = measurement_of(folder, progress.say)
    if kind_of(place).name != "observer":
        return load_observer_plan(place)
    results = folder if is_result(folder) and read_summary(folder).kind == "observer" else None
    return ObserverPlanMeasurement(place, _planned(place, load_observer(place).model, results))


def _planned(place: Path, model: ObserverModel, results: Path | None) -> ObserverPlanModel:
    file, advice = place / MEASUREMENT_FILE, "write a plan with `heliogauge observer init PLAN --plan`"
    if model.targets is None:
        raise InputError(f"{file}: a pass is planned with marked targets ([targets]); {advice}")
    camera = model.camera[0]
    if results is not None:
        camera = type(camera)(file=str(results.absolute() / "cameras.json"))
    elif not (camera.is_known and camera.has_size):
        raise InputError(
            f"{file}: [camera] is estimated from the photos: measure them and plan from the results, or {advice}"
        )
    return ObserverPlanModel(
        kind="observer-plan",
        name=model.name,
        collector=model.collector,
        camera=camera,
        targets=PlannedTargetsSection(file=model.targets.file),
        scale_bar=model.scale_bar,
        distance=model.distance,
        mirror=PlannedMirrorSection(like=None if results is None else str(results.absolute())),
        evaluation=model.evaluation,
    )
