"""A network that was measured already, planned again: its targets, its camera, its image sigma."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from heliogauge.errors import InputError
from heliogauge.measurement.load import kind_of
from heliogauge.results.folder import SUMMARY_FILE, read_points_csv, read_summary
from heliogauge.running.either_folder import is_result, planned_from, results_of
from heliogauge.running.progress import Progress
from photogrammetry.planning.keys import (
    GoalSection,
    PhotogrammetryPlanMeasurement,
    PhotogrammetryPlanModel,
    PlannedCameraSection,
    PlannedObjectSection,
    load_photogrammetry_plan,
)

#: What is wanted of a network that was measured, where nothing is said: sigmas of half of those it has.
_BETTER = 0.5


@contextmanager
def planned_measurement(
    folder: Path, sigma_mm: float | None, progress: Progress
) -> Iterator[PhotogrammetryPlanMeasurement]:
    """Give what is to be planned.

    folder: A plan, a measurement, or results of either.
    sigma_mm: Sigma of a coordinate that is wanted; default: that of the plan, and half of that of results [mm].
    InputError: Neither of them.
    EstimationError: The measurement cannot be evaluated.
    """
    folder = planned_from(folder, progress.say)
    kind = read_summary(folder).kind if is_result(folder) else kind_of(folder).name
    if kind != "photogrammetry":
        plan = load_photogrammetry_plan(folder)
        if sigma_mm is not None:
            goal = plan.model.goal.model_copy(update={"sigma_mm": sigma_mm})
            plan = replace(plan, model=plan.model.model_copy(update={"goal": goal}))
        yield plan
        return
    with results_of(folder, kind, progress) as results:
        yield _again(results, sigma_mm)


def _again(results: Path, sigma_mm: float | None) -> PhotogrammetryPlanMeasurement:
    summary = read_summary(results)
    sigma_px = summary.numbers.get("image_sigma_posterior_px")
    if sigma_px is None:
        raise InputError(f"{results}: the image sigma of this network is not known, for it has no redundancy")
    sigma_m = read_points_csv(results / "points.csv").sigma_m
    own_mm = 1e3 * float(np.sqrt(np.nanmean(sigma_m**2)))
    model = PhotogrammetryPlanModel(
        kind="photogrammetry-plan",
        name=summary.name,
        object=PlannedObjectSection(targets="points.csv"),
        camera=PlannedCameraSection(file="cameras.json", sigma_px=float(sigma_px)),
        goal=GoalSection(sigma_mm=_BETTER * own_mm if sigma_mm is None else sigma_mm),
    )
    return PhotogrammetryPlanMeasurement(results, model, SUMMARY_FILE)
