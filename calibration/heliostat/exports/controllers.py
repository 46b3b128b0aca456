"""What a local controller of an azimuth-elevation heliostat stores: every number of its model, in closed form."""

from typing import Any

import numpy as np

from calibration.heliostat.kinematic_model.design import (
    Driven,
    HeliostatDesign,
    LinearActuator,
    RotaryDrive,
    Shift,
    Turn,
)
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import rotation_from_vector
from heliogauge.validate import FloatArray

_AXES = ("azimuth", "elevation")
_WORM = ("sin", "cos", "sin2", "cos2")


def controller_row(design: HeliostatDesign) -> dict[str, Any]:
    """Return what a local controller stores (Malan 2014, section 5.4, with the terms of the drives).

    Returns: Rotation ``rm1`` to ``rm9``, non-orthogonality and canting [rad], point of the axes and arm [m], and of
        each drive its angle per reading, bias, sag, worm, backlash [rad] and its limits.
    InputError: A chain that has no such closed form; the message says which part.
    """
    drives = _rotary(design)
    numbers = dict(zip(design.parameters.names, design.parameters.values.tolist(), strict=True))
    places = [index for index, step in enumerate(design.steps) if isinstance(step, Driven)]
    driven = [step for step in design.steps if isinstance(step, Driven)]
    axes = np.stack([step.axis for step in driven] + [design.normal])
    if [step.drive for step in driven] != [0, 1] or (axes != [[0, 0, -1], [1, 0, 0], [0, 1, 0]]).any():
        raise _no_form(design, "its axes are not azimuth and elevation")
    rotation, pivot = np.eye(3), np.zeros(3)
    for step in design.steps[: places[0]]:
        if isinstance(step, Turn):
            rotation = rotation @ rotation_from_vector(step.axis * numbers[step.angle])
        elif isinstance(step, Shift):
            pivot = pivot + rotation @ _shift(step, numbers)
    error = 0.0
    for step in design.steps[places[0] + 1 : places[1]]:
        if not isinstance(step, Turn) or abs(step.axis[1]) != 1:
            raise _no_form(design, "there is more than a non-orthogonality between its axes")
        error -= step.axis[1] * numbers[step.angle]
    canting, arm = 0.0, np.zeros(3)
    for step in design.steps[places[1] + 1 :]:
        if isinstance(step, Turn):
            if abs(step.axis[2]) != 1:
                raise _no_form(design, "there is more than a canting behind its axes")
            canting -= step.axis[2] * numbers[step.angle]
        elif isinstance(step, Shift):
            arm = arm + rotation_from_vector(np.array([0.0, 0.0, -canting])) @ _shift(step, numbers)
    return {
        "heliostat": design.name,
        **{f"rm{place + 1}": float(one) for place, one in enumerate(rotation.ravel())},
        "non_orthogonality_rad": float(error),
        "canting_rad": float(canting),
        **dict(zip(("e_m", "n_m", "u_m"), pivot.tolist(), strict=True)),
        **dict(zip(("arm_x_m", "arm_y_m", "arm_z_m"), arm.tolist(), strict=True)),
        "reading_unit": design.reading_unit,
        **_drive_columns(_AXES[0], drives[0], numbers, design.limits[0]),
        **_drive_columns(_AXES[1], drives[1], numbers, design.limits[1]),
    }


def _rotary(design: HeliostatDesign) -> tuple[RotaryDrive, RotaryDrive]:
    first, second = design.drives
    if isinstance(first, LinearActuator) or isinstance(second, LinearActuator):
        raise _no_form(design, "it has linear actuators")
    return first, second


def _no_form(design: HeliostatDesign, why: str) -> InputError:
    return InputError(
        f"{design.name}: {why}, so controllers.csv has no columns for it; `heliogauge heliostat export table` or "
        "`heliogauge heliostat aim` write its readings"
    )


def _shift(step: Shift, numbers: dict[str, float]) -> FloatArray:
    return step.sign * np.array([0.0 if name is None else numbers[name] for name in step.names])


def _drive_columns(axis: str, drive: RotaryDrive, numbers: dict[str, float], limits: FloatArray) -> dict[str, Any]:
    terms = drive.terms
    scale = 1.0 if drive.scale is None else numbers[drive.scale]
    worm = [numbers[name] for name in terms.worm] + [0.0] * (len(_WORM) - len(terms.worm))
    return {
        f"{axis}_rad_per_reading": scale * drive.rad_per_reading,
        f"{axis}_bias_rad": drive.offset_sign * numbers[drive.offset],
        f"{axis}_sag_rad": 0.0 if terms.sag is None else numbers[terms.sag],
        f"{axis}_sag_zero_rad": terms.sag_zero_rad,
        f"{axis}_worm_ratio": terms.worm_ratio,
        **{f"{axis}_worm_{part}_rad": value for part, value in zip(_WORM, worm, strict=True)},
        f"{axis}_backlash_rad": 0.0 if terms.backlash is None else numbers[terms.backlash],
        f"{axis}_lowest_reading": float(limits[0]),
        f"{axis}_highest_reading": float(limits[1]),
    }
