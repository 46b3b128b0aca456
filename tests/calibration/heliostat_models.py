"""Every kind of heliostat the software knows, with all of its errors switched on, for tests that hold for all."""

import numpy as np

from calibration.heliostat.kinematic_model.design import Driven, HeliostatDesign, RotaryDrive, Shift, Turn
from calibration.heliostat.kinematic_model.parameters import Parameters
from calibration.heliostat.kinematic_model.presets import (
    ActuatorNumbers,
    azimuth_elevation,
    drone_heliostat,
    linear_actuators,
    six_error,
    two_axes,
    with_drive_terms,
)

POSITION = (19.2, -30.8, 1.2)
ACTUATORS = (
    ActuatorNumbers(0.0137, 0.0757, 0.3353, 0.3381, 154166.6667, False, (0.0, 69001.0)),
    ActuatorNumbers(0.9371, 0.0784, 0.3408, 0.3191, 154166.6667, True, (0.0, 75454.0)),
)
#: Angles of a few mrad, lengths of some cm: what a real heliostat has.
_SIZES = {"rad": 5e-3, "m": 0.02, "1/m": 100.0, "1": 1e-3}


def with_errors(design, seed=0):
    """Move every number a little, so that no derivative is only right at zero."""
    rng = np.random.default_rng(seed)
    sizes = np.array([_SIZES[unit] for unit in design.parameters.units])
    sizes[[name.startswith(("offset_", "pivot_", "initial_stroke")) for name in design.parameters.names]] = 1e-3
    # Beyond 1 / (2 * 180) a worm would run backwards twice a turn: no drive, and no way back.
    sizes[[name.startswith("worm") for name in design.parameters.names]] = 5e-4
    parameters = design.parameters
    return design.with_parameters(parameters.with_values(parameters.values + sizes * rng.normal(size=len(sizes))))


def all_terms(design, ratios):
    """Give both drives periodic error, sag and backlash; rotary ones a scale."""
    rotary = isinstance(design.drives[0], RotaryDrive)
    terms = ("worm2", "sag", "backlash") + (("scale",) if rotary else ())
    for drive, ratio in enumerate(ratios):
        design = with_drive_terms(design, drive, terms, worm_ratio=ratio, sag_zero_rad=0.1)
    return design


def rolling():
    """Return a heliostat whose first axis points at the tower: roll, then pitch, in a chain of its own."""
    names = ("position_e", "position_n", "position_u", "roll_offset", "pitch_offset", "bend", "reach")
    units = ("m", "m", "m", "rad", "rad", "rad", "m")
    return HeliostatDesign(
        "rolling",
        (
            Shift(names[:3]),
            Driven((-0.5, 0.8, 0.33), 1),
            Shift((None, "reach", None)),
            Turn((0.0, 0.0, 1.0), "bend"),
            Driven((1.0, 0.0, 0.0), 0),
            Shift((None, None, "reach"), -1.0),
        ),
        (RotaryDrive("pitch_offset"), RotaryDrive("roll_offset")),
        (0.1, 0.0, 1.0),
        Parameters(names, [*POSITION, 0.0, 0.0, 0.0, 0.2], np.zeros(7), units),
        [[-1.2, 1.2], [-1.5, 1.5]],
    )


def all_models():
    """Return every preset bare and with all terms, each with small errors."""
    counts = 2 * np.pi / 48000
    rotary = {
        "azimuth_elevation": azimuth_elevation("a", POSITION),
        "printed": azimuth_elevation("p", POSITION, printed_tilts=True),
        "counts": azimuth_elevation("c", POSITION, rad_per_reading=(counts, -counts)),
        "drone": drone_heliostat("d", POSITION, (0.4325, 0.24)),
        "six_error": six_error("s", POSITION, arm_normal_m=0.15),
        "rolling": rolling(),
        "two_axes": two_axes(
            "t", POSITION, [[-0.5, 0.8, 0.33], [0.85, 0.53, 0.0]], (-0.1, 0.2, 1.0), arm_m=(0.1, 0.0, 0.3)
        ),
    }
    linear = linear_actuators("l", POSITION, ACTUATORS, joints_m=((0.01, 0.02, -0.03), (0.02, -0.01, 0.3)))
    models = rotary | {"linear": linear}
    models |= {f"{name}_terms": all_terms(design, (30.0, 180.0)) for name, design in rotary.items()}
    # Ten cycles per metre of stroke: a spindle with a pitch of 0.1 m would be an odd one, but aliases nothing here.
    models["linear_terms"] = all_terms(linear, (10.0, 15.0))
    return {name: with_errors(design) for name, design in models.items()}


def readings_within(design, count, seed=1):
    """Draw readings inside the limits, away from their ends (and within the one turn that the way back finds)."""
    low, high = design.limits.T
    share = np.random.default_rng(seed).uniform(0.1, 0.9, (count, 2))
    return (0.5 if isinstance(design.drives[0], RotaryDrive) else 1.0) * (low + share * (high - low))
