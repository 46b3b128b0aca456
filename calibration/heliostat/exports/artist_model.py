"""The kinematics of ARTIST: which numbers of a heliostat it has, in its own signs, and what it cannot say.

ARTIST (github.com/ARTIST-Association/ARTIST, ``kinematics_rigid_body.py``, ``actuators_linear.py``, ``transforms.py``
of 2026) multiplies ``T(position) N(first_joint_tilt_n) U(first_joint_tilt_u) T(joint 1) E(axis 1)
E(second_joint_tilt_e) N(second_joint_tilt_n) T(joint 2) U(axis 2) T(concentrator)``. E and U are right-handed turns
about east and up; N has ``e' = e cos - u sin``, a left-handed turn about north. There is no sag, worm or backlash.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.heliostat.exports.working_range import Loss, WorkingRange
from calibration.heliostat.kinematic_model.design import DriveTerms, HeliostatDesign, LinearActuator, Turn
from calibration.heliostat.kinematic_model.kinematics import pose_derivatives
from calibration.heliostat.kinematic_model.parameters import Parameters
from heliogauge.validate import FloatArray

#: Turns of the chain that ARTIST has; its reader of PAINT's files sets them to 0 whatever the file says.
TILTS = ("tilt_1_n", "tilt_1_u", "tilt_2_e", "tilt_2_n")
_ACTUATORS = tuple(
    f"{name}_{axis}" for axis in (1, 2) for name in ("initial_angle", "initial_stroke", "offset", "pivot_radius")
)
#: A step of each that moves a beam by about a milliradian: what makes the columns of the adjustment alike.
_STEPS = {"rad": 1e-3, "m": 1e-4}
#: Below this two models are the same to rounding [rad].
_SAME_RAD = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class ArtistHeliostat:
    """A heliostat in ARTIST's own numbers.

    design: Its chain, with left-handed turns about north and actuators without further terms.
    loss: What is lost against the calibrated heliostat.
    """

    design: HeliostatDesign
    loss: Loss


def artist_heliostat(
    design: HeliostatDesign, fitted_on: WorkingRange, judged_on: WorkingRange, *, with_tilts: bool
) -> ArtistHeliostat:
    """Say a calibrated heliostat in ARTIST's numbers.

    design: With linear actuators.
    fitted_on: Where the numbers are adjusted, if ARTIST does not have all of them.
    judged_on: Where the loss is found; other positions.
    with_tilts: Whether the tilts can be said: in a scenario, not in a properties file of PAINT.
    Returns: The same numbers if nothing is lost, else those whose beams are nearest over the working range.
    """
    known = _artist_chain(design)
    if not with_tilts:
        values = dict.fromkeys(TILTS, 0.0)
        # The tilt about east and axis 1 are one turn: nothing of it is lost.
        values["initial_angle_1"] = known.parameters.value("initial_angle_1") + known.parameters.value("tilt_2_e")
        known = known.with_value(values)
    loss = _loss(design, known, judged_on)
    if loss.largest_rad > _SAME_RAD:
        # The tilt about east has the part of initial_angle_1: one of them moves.
        names = (*TILTS, *_ACTUATORS[1:]) if with_tilts else _ACTUATORS
        refitted = _refitted(design, known, names, fitted_on)
        after = _loss(design, refitted, judged_on)
        if after.rms_rad < loss.rms_rad:
            known, loss = refitted, after
    return ArtistHeliostat(known, loss)


def _loss(design: HeliostatDesign, known: HeliostatDesign, at: WorkingRange) -> Loss:
    ours, theirs = (at.beams(one, one.parameters.values) for one in (design, known))
    return Loss.of(at.difference(theirs, ours))


def _artist_chain(design: HeliostatDesign) -> HeliostatDesign:
    """Return the same heliostat in ARTIST's signs, without the terms that it does not have."""
    flipped = {step.angle for step in design.steps if isinstance(step, Turn) and (step.axis == [0.0, 1.0, 0.0]).all()}
    steps = tuple(
        Turn(-step.axis, step.angle) if isinstance(step, Turn) and step.angle in flipped else step
        for step in design.steps
    )
    first, second = (
        replace(drive, terms=DriveTerms()) if isinstance(drive, LinearActuator) else drive for drive in design.drives
    )
    own = design.parameters
    signs = np.array([-1.0 if name in flipped else 1.0 for name in own.names])
    parameters = Parameters(own.names, own.values * signs + 0.0, own.sigmas, own.units)
    return replace(design, steps=steps, drives=(first, second), parameters=parameters)


def _refitted(
    design: HeliostatDesign, known: HeliostatDesign, names: Sequence[str], at: WorkingRange
) -> HeliostatDesign:
    """Adjust some numbers of a heliostat until its beams are nearest to those of another."""
    from scipy.optimize import least_squares

    columns = known.parameters.indices(names)
    steps = np.array([_STEPS[known.parameters.units[column]] for column in columns])
    wanted, start = at.beams(design, design.parameters.values), known.parameters.values

    def values(moves: FloatArray) -> FloatArray:
        changed = start.copy()
        changed[columns] += moves * steps
        return changed

    def residuals(moves: FloatArray) -> FloatArray:
        apart = at.difference(at.beams(known, values(moves)), wanted)
        # A triangle that does not close is as wrong as a beam can be.
        return np.nan_to_num(apart, nan=2.0).ravel()

    def derivatives(moves: FloatArray) -> FloatArray:
        found = pose_derivatives(known, values(moves), at.readings, at.approach, columns=columns, outside="nan")
        normals = found.poses.normals(known)
        turned = np.cross(found.omega.transpose(0, 2, 1), normals[:, None, :])
        cosine = np.einsum("ij,ij->i", at.suns, normals)[:, None, None]
        # beam = 2 (s.n) n - s.
        by_sun = np.einsum("ij,ikj->ik", at.suns, turned)[:, :, None]
        change = 2 * (by_sun * normals[:, None, :] + cosine * turned)
        distance = np.linalg.norm(at.aim_points_m - wanted.centre_m, axis=1)[:, None, None]
        moved = found.shift.transpose(0, 2, 1)
        along = np.einsum("ikj,ij->ik", moved, wanted.directions)[:, :, None] * wanted.directions[:, None, :]
        change += (moved - along) / distance
        return np.asarray(np.nan_to_num(change.transpose(0, 2, 1).reshape(-1, len(columns)) * steps))

    # Sides and strokes share a nearly free direction, along which a fit creeps: it ends where a step gains no
    # hundredth of what is left.
    found = least_squares(residuals, np.zeros(len(columns)), jac=derivatives, ftol=0.01, xtol=1e-12, gtol=1e-14)
    return known.with_parameters(known.parameters.with_values(values(found.x)))
