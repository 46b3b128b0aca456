"""Stage 1: a task of texts becomes what is known of a heliostat and what was seen of it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from calibration.heliostat.files.result import Shared
from calibration.heliostat.files.sources import HeliostatTask
from calibration.heliostat.files.store_paint import parse_calibrations, parse_properties
from calibration.heliostat.keys import HeliostatCameraSection
from calibration.heliostat.kinematic_model.design import HeliostatDesign
from calibration.heliostat.observations.observations import Place
from calibration.heliostat.observations.observed import Observed, observed
from calibration.heliostat.observations.rows import Rows, parse_rows
from calibration.heliostat.pipeline.nominal_design import nominal_design
from heliogauge.errors import InputError

if TYPE_CHECKING:
    from calibration.beam.pipeline import BeamMeasurements


@dataclass(frozen=True, slots=True, eq=False)
class Given:
    """What the calibration of a heliostat starts from.

    nominal: The heliostat as it is known before.
    seen: All rows with the verdict on each, and the observations.
    beams: What was measured in photos; None where no row names one.
    """

    nominal: HeliostatDesign
    seen: Observed
    beams: "BeamMeasurements | None" = None


def read_task(task: HeliostatTask, shared: Shared) -> Given:
    """Read what is known of a heliostat and its observations.

    InputError: Either cannot be meant.
    """
    if task.fault:
        raise InputError(f"{task.name}: {task.fault}")
    model = shared.model
    if task.header:
        nominal = nominal_design(task, shared.plant, model.kinematics)
        rows, beams = _rows(task, shared)
    else:
        # Whether a reading of an ideal actuator is an angle or a count shows in the records.
        rows, beams = _records(task, shared), None
        are_angles = "axis_1_rad" in rows.numbers
        nominal = nominal_design(task, shared.plant, model.kinematics, readings_are_angles=are_angles)
    cameras = tuple(_place(section) for section in model.camera)
    spot_sigma_m = 1e-3 * model.evaluation.spot_sigma_mm
    return Given(nominal, observed(rows, nominal, shared.plant, cameras, spot_sigma_m), beams)


def _records(task: HeliostatTask, shared: Shared) -> Rows:
    properties = parse_properties(task.properties, f"properties of {task.name}")
    return parse_calibrations(
        task.records,
        task.times,
        label=shared.label,
        origin=shared.plant.origin,
        is_ideal=properties.is_ideal,
    )


def _rows(task: HeliostatTask, shared: Shared) -> tuple[Rows, "BeamMeasurements | None"]:
    rows = parse_rows(task.header, {int(number): text for number, text in task.records})
    if not shared.model.images:
        return rows, None
    # OpenCV costs 0.1 s, which only photos are worth.
    from calibration.heliostat.pipeline.photo_beams import with_measured_beams

    return with_measured_beams(rows, shared.folder, shared.plant, shared.model)


def _place(section: HeliostatCameraSection) -> Place:
    if section.center_m is None:
        return Place(section.name, np.zeros(3), np.array(np.inf))
    return Place(section.name, np.array(section.center_m), np.array(section.sigma_m or 0.0))
