"""What is known of a heliostat beforehand becomes its kinematic design: preset, position, numbers of its own."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from calibration.heliostat.files.sources import HeliostatTask, position_of
from calibration.heliostat.files.store_paint import PaintProperties, parse_properties
from calibration.heliostat.fitting.priors import with_terms_free
from calibration.heliostat.keys import KinematicsSection
from calibration.heliostat.kinematic_model.design import HeliostatDesign, RotaryDrive
from calibration.heliostat.kinematic_model.parameters import FREE, HELD
from calibration.heliostat.kinematic_model.presets import (
    ActuatorNumbers,
    azimuth_elevation,
    drone_heliostat,
    ideal_actuators,
    linear_actuators,
    six_error,
    two_axes,
    with_drive_terms,
)
from calibration.heliostat.observations.plant import Plant
from heliogauge.errors import InputError

_POSITION_CELLS = frozenset({"e_m", "n_m", "u_m", "lat_deg", "lon_deg", "alt_m"})


def nominal_design(
    task: HeliostatTask, plant: Plant, kinematics: KinematicsSection, *, readings_are_angles: bool = False
) -> HeliostatDesign:
    """Return a heliostat as it is known before any observation.

    task: Its row of the table, or its properties.
    plant: Origin of the field's frame.
    kinematics: Preset, terms, numbers and priors that all share.
    readings_are_angles: As in `paint_design`.
    Returns: All parameters, those of the chosen free set and those with a prior free.
    InputError: A number that is missing or cannot be, a parameter that does not exist.
    """
    if task.properties:
        properties = parse_properties(task.properties, f"properties of {task.name}")
        design = paint_design(properties, task.name, plant, readings_are_angles=readings_are_angles)
    else:
        design = _preset(task, plant, kinematics)
    for drive in (0, 1) if kinematics.terms else ():
        ratio = 0.0 if kinematics.worm_ratio is None else kinematics.worm_ratio[drive]
        design = with_drive_terms(design, drive, kinematics.terms, worm_ratio=ratio)
    return _with_knowledge(design, task.cells, kinematics)


def paint_design(
    properties: PaintProperties, name: str, plant: Plant, *, readings_are_angles: bool = False
) -> HeliostatDesign:
    """Return the heliostat that a properties file of PAINT describes.

    plant: Origin of the field's frame.
    readings_are_angles: Whether its records hold angles [rad], as those of ideal actuators; otherwise counts.
    Returns: Two linear actuators, or two ideal ones; all parameters held.
    InputError: Counts of ideal actuators whose numbers the file does not have.

    Public files say "ideal" of heliostats whose records hold the plant's counts; the numbers beside that word turn
    those into angles as they do for linear actuators.
    """
    shifts = properties.translations_m
    latitude, longitude, altitude = properties.position.tolist()
    place = plant.place_of(latitude, longitude, altitude, f"heliostat_position of {name}")
    joints = (shifts["joint_1"], shifts["joint_2"])
    limits = [(one.get("lowest", -np.inf), one.get("highest", np.inf)) for one in properties.actuators]
    if readings_are_angles:
        return ideal_actuators(name, place, limits, concentrator_m=shifts["concentrator"], joints_m=joints)
    if not all(properties.actuators):
        raise InputError(
            f"properties of {name}: the actuators are ideal, so motor positions are angles of the axes in radians, but "
            "the records hold counts; give the actuators' increment, initial_stroke_length, offset and pivot_radius"
        )
    numbers = [
        ActuatorNumbers(
            initial_angle_rad=one["initial_angle"],
            initial_stroke_m=one["initial_stroke"],
            offset_m=one["offset"],
            pivot_radius_m=one["pivot_radius"],
            increment_per_m=one["increment"],
            clockwise=bool(one["clockwise"]),
            count_limits=limit,
        )
        for one, limit in zip(properties.actuators, limits, strict=True)
    ]
    return linear_actuators(
        name, place, (numbers[0], numbers[1]), concentrator_m=shifts["concentrator"], joints_m=joints
    )


def _preset(task: HeliostatTask, plant: Plant, kinematics: KinematicsSection) -> HeliostatDesign:
    position = position_of(task.cells, plant)
    per_turn = kinematics.counts_per_turn
    rotary: dict[str, Any] = {"rad_per_reading": None if per_turn is None else 2 * np.pi / np.array(per_turn)}
    if kinematics.preset == "azimuth-elevation":
        return azimuth_elevation(task.name, position, printed_tilts=kinematics.printed_signs, **rotary)
    if kinematics.preset == "drone":
        # Arm and pylon are parameters like the others: their values come from [kinematics.parameters] or the table.
        return drone_heliostat(task.name, position, (0.0, 0.0), **rotary)
    if kinematics.preset == "six-error":
        return six_error(task.name, position, **rotary)
    if kinematics.axes is not None and kinematics.normal is not None:
        return two_axes(task.name, position, np.array(kinematics.axes), np.array(kinematics.normal), **rotary)
    return linear_actuators(task.name, position, _actuators(task.cells, kinematics))


def _actuators(cells: Mapping[str, str], kinematics: KinematicsSection) -> tuple[ActuatorNumbers, ActuatorNumbers]:
    found = []
    for axis in (1, 2):

        def number(part: str, axis: int = axis) -> float:
            name = f"{part}_{axis}"
            known = kinematics.parameters.get(name)
            value = _cell(name, cells[name]) if cells.get(name) else None if known is None else known.value
            if value is None:
                raise InputError(
                    f"preset linear-actuators: {name} is missing; give it as a column of the table of heliostats or in "
                    f"[kinematics.parameters]: {name} = {{value = ...}}"
                )
            return value

        found.append(
            ActuatorNumbers(
                initial_angle_rad=number("initial_angle"),
                initial_stroke_m=number("initial_stroke"),
                offset_m=number("offset"),
                pivot_radius_m=number("pivot_radius"),
                increment_per_m=number("increment"),
                # As at Juelich: the first axis counts against, the second with its turn.
                clockwise=axis == 2,
                count_limits=(-np.inf, np.inf),
            )
        )
    return found[0], found[1]


def _cell(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise InputError(f"table of heliostats: {name} = {text!r}: a finite number is needed")
    return value


def _with_knowledge(
    design: HeliostatDesign, cells: Mapping[str, str], kinematics: KinematicsSection
) -> HeliostatDesign:
    """Put in values of the heliostat's own, then those all share; then set what is free and what has a prior."""
    shared = {name: one.value for name, one in kinematics.parameters.items() if one.value is not None}
    own = {name: _cell(name, text) for name, text in cells.items() if name not in _POSITION_CELLS and text}
    design = design.with_value({**shared, **own})
    if kinematics.free is not None:
        design = design.with_free(kinematics.free)
    design = with_terms_free(design, asked_terms(design, kinematics))
    sigmas = {name: one.sigma for name, one in kinematics.parameters.items() if one.sigma is not None}
    return design.with_parameters(design.parameters.with_sigmas(sigmas))


def asked_terms(design: HeliostatDesign, kinematics: KinematicsSection) -> tuple[str, ...]:
    """Return the parameters of the drives' errors that measurement.toml asks for and does not hold."""
    if not kinematics.terms:
        return ()
    held = {name for name, one in kinematics.parameters.items() if one.sigma == HELD}
    scales = [drive.scale for drive in design.drives if isinstance(drive, RotaryDrive) and drive.scale is not None]
    return tuple(
        name for name in (*scales, *(n for drive in design.drives for n in drive.terms.names)) if name not in held
    )


def frees_parameters(kinematics: KinematicsSection) -> bool:
    """Return whether measurement.toml itself frees parameters, so that nothing is left to choose."""
    freed = any(one.sigma == FREE for one in kinematics.parameters.values() if one.sigma is not None)
    return kinematics.free is not None or freed
