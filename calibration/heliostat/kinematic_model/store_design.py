"""A heliostat's design as plain tables and back, number for number: what ``heliostat.json`` keeps of the model."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from calibration.heliostat.kinematic_model.design import (
    Drive,
    Driven,
    DriveTerms,
    HeliostatDesign,
    LinearActuator,
    RotaryDrive,
    Shift,
    Step,
    Turn,
)
from calibration.heliostat.kinematic_model.parameters import Parameters, Quantity
from heliogauge.errors import InputError

_NAMES = ("initial_angle", "initial_stroke", "offset", "pivot_radius", "increment")


def design_content(design: HeliostatDesign) -> dict[str, Any]:
    """Return the chain of a heliostat without its numbers, which `parameters` of ``heliostat.json`` has.

    Returns: Texts, numbers, lists and tables only.
    """
    return {
        "name": design.name,
        "steps": [_step_content(step) for step in design.steps],
        "drives": [_drive_content(drive) for drive in design.drives],
        "normal": design.normal.tolist(),
        "limits": [[one if np.isfinite(one) else None for one in row] for row in design.limits.tolist()],
        "reading_unit": design.reading_unit,
        "free_sets": {name: list(names) for name, names in design.free_sets.items()},
    }


def design_from(content: Mapping[str, Any], numbers: Mapping[str, Mapping[str, Any]], *, key: str) -> HeliostatDesign:
    """Return a heliostat from the content of ``heliostat.json``.

    key: Which numbers: "value" or "nominal".
    InputError: A key is missing, or a value that cannot be.
    """
    try:
        parameters = Parameters.of({name: Quantity(float(one[key]), str(one["unit"])) for name, one in numbers.items()})
        first, second = (_drive(one) for one in content["drives"])
        limits = [
            [side if one is None else float(one) for one, side in zip(row, (-np.inf, np.inf), strict=True)]
            for row in content["limits"]
        ]
        return HeliostatDesign(
            name=content["name"],
            steps=tuple(_step(one) for one in content["steps"]),
            drives=(first, second),
            normal=np.array(content["normal"]),
            parameters=parameters,
            limits=np.array(limits),
            reading_unit=content["reading_unit"],
            free_sets={name: tuple(names) for name, names in content["free_sets"].items()},
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"heliostat.json: the design cannot be read ({error!r}); calibrate again") from error


def _step_content(step: Step) -> dict[str, Any]:
    if isinstance(step, Turn):
        return {"turn_about": step.axis.tolist(), "angle": step.angle}
    if isinstance(step, Shift):
        return {"shift": list(step.names), "sign": step.sign}
    return {"driven_about": step.axis.tolist(), "drive": step.drive}


def _step(content: Mapping[str, Any]) -> Step:
    if "turn_about" in content:
        return Turn(np.array(content["turn_about"]), content["angle"])
    if "shift" in content:
        east, north, up = content["shift"]
        return Shift((east, north, up), float(content["sign"]))
    return Driven(np.array(content["driven_about"]), int(content["drive"]))


def _drive_content(drive: Drive) -> dict[str, Any]:
    terms = {
        "worm_ratio": drive.terms.worm_ratio,
        "worm": list(drive.terms.worm),
        "sag": drive.terms.sag,
        "sag_zero_rad": drive.terms.sag_zero_rad,
        "backlash": drive.terms.backlash,
    }
    if isinstance(drive, LinearActuator):
        return {
            "kind": "linear",
            **{name: getattr(drive, name) for name in _NAMES},
            "clockwise": drive.clockwise,
            "zero_rad": drive.zero_rad,
            "terms": terms,
        }
    return {
        "kind": "rotary",
        "offset": drive.offset,
        "rad_per_reading": drive.rad_per_reading,
        "scale": drive.scale,
        "offset_sign": drive.offset_sign,
        "terms": terms,
    }


def _drive(content: Mapping[str, Any]) -> Drive:
    terms = DriveTerms(**{**content["terms"], "worm": tuple(content["terms"]["worm"])})
    if content["kind"] == "linear":
        names = {name: content[name] for name in _NAMES}
        return LinearActuator(
            **names, clockwise=bool(content["clockwise"]), zero_rad=float(content["zero_rad"]), terms=terms
        )
    return RotaryDrive(
        content["offset"], float(content["rad_per_reading"]), content["scale"], float(content["offset_sign"]), terms
    )
