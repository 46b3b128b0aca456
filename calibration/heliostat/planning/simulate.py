"""Studies by simulation: what a calibration is worth before it is made, from draws of its observations.

A heliostat is given twice, as it truly is and as it is believed to be; observations are drawn from the first, fitted
with the second, and the result then tracks the sun in its stead.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from calibration.heliostat.fitting.fit_result import FitOptions, HeliostatFit
from calibration.heliostat.fitting.robust_fit import fit
from calibration.heliostat.kinematic_model.aiming import aim
from calibration.heliostat.kinematic_model.design import HeliostatDesign, PlaneTarget
from calibration.heliostat.kinematic_model.kinematics import mirror_poses
from calibration.heliostat.observations.observations import BeamSpots, DroneSightings, Observations, Place, Pointings
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rays import intersect_plane, reflect
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, positive

#: Incidence beyond which a mirror shows a drone too little of the target.
MOST_INCIDENCE_RAD = np.radians(80.0)
#: RTK-GPS at rest after Gouws (2018), table 3.1: east, north, up [m].
RTK_SIGMA_M = (5.602e-3, 5.781e-3, 8.866e-3)
_MOST_DRAWS = 50

Draw: TypeAlias = Callable[[np.random.Generator], Observations]
Evaluate: TypeAlias = Callable[[HeliostatDesign], FloatArray]


@dataclass(frozen=True, slots=True)
class Control(ShortRepr):
    """How a controller drives: what it does on purpose and what it cannot help.

    step: The drives stand at whole multiples of this; 0 for any place [readings].
    """

    step: tuple[float, float] = (0.0, 0.0)

    def rounded(self, readings: FloatArray) -> FloatArray:
        """Return the nearest readings at which the drives can stand, shape (n, 2)."""
        steps = np.array(self.step)
        return np.where(steps > 0, np.rint(readings / np.where(steps > 0, steps, 1.0)) * steps, readings)


def commanded_offsets(
    truth: HeliostatDesign,
    believed: HeliostatDesign,
    sun: npt.ArrayLike,
    target: PlaneTarget,
    *,
    set_for: npt.ArrayLike | None = None,
    control: Control | None = None,
) -> FloatArray:
    """Return where the beam goes when a controller with one model aims a heliostat that obeys another.

    Shapes: sun (n, 3).
    believed: The controller's model, of the same readings.
    set_for (n, 3): Directions that the drives were set for: earlier ones, where they are held for a while.
    control: Steps of the drives.
    Returns (n, 2): Right and up from the target's centre; NaN where the heliostat cannot go or the beam leaves the
        plane [m].
    """
    sun_now = np.asarray(sun, dtype=np.float64)
    aimed = aim(believed, believed.parameters.values, sun_now if set_for is None else set_for, target.center_m)
    readings = (Control() if control is None else control).rounded(aimed.readings)
    return _spots(truth, readings, sun_now, target)


def _spots(truth: HeliostatDesign, readings: FloatArray, sun: FloatArray, target: PlaneTarget) -> FloatArray:
    found = np.full((len(sun), 2), np.nan)
    possible = np.isfinite(readings).all(axis=1)
    poses = mirror_poses(truth, truth.parameters.values, readings[possible])
    beam = reflect(-sun[possible], poses.normals(truth))
    travel = intersect_plane(poses.centre_m, beam, target.center_m, target.normal)
    # A beam that runs away from the plane would meet it behind the mirror.
    spots = target.coordinates(poses.centre_m + np.where(travel > 0, travel, np.nan)[:, None] * beam)
    found[possible] = spots
    return found


def beam_angles(offsets_m: npt.ArrayLike, distance_m: float) -> FloatArray:
    """Return the angles of the beam that offsets on a target make, ``atan(|offset| / distance)``.

    Shapes: result (n,).
    offsets_m (n, 2): From the target's centre [m].
    distance_m: From the heliostat to the target's centre [m].
    """
    lengths = np.linalg.norm(np.asarray(offsets_m, dtype=np.float64), axis=-1)
    return np.asarray(np.arctan(lengths / positive("distance_m", distance_m, "metres")))


def drawn_beams(
    truth: HeliostatDesign,
    sun: npt.ArrayLike,
    target: PlaneTarget,
    sigma_m: float,
    rng: np.random.Generator,
    *,
    spread_m: float = 0.0,
) -> Observations:
    """Draw beams on a target: the drives are set so that the beam is on it, then its centre is measured.

    Shapes: sun (n, 3).
    sigma_m: Of the measured centre, right and up [m].
    rng: Draws the errors, and the aim points where they are spread.
    spread_m: Standard deviation of the aim points about the target's centre [m].
    Returns: One row for each sun position that the heliostat can serve.
    InputError: It can serve none.
    """
    directions = np.asarray(sun, dtype=np.float64)
    aims = target.points(spread_m * rng.standard_normal((len(directions), 2)))
    aimed = aim(truth, truth.parameters.values, directions, aims)
    served = aimed.converged & aimed.within_limits
    if not served.any():
        raise InputError(f"{truth.name}: cannot send the sun to {target.name} at any of {len(directions)} positions")
    spots = target.coordinates(aims[served])
    measured = spots + sigma_m * rng.standard_normal(spots.shape)
    names = (target.name,) * len(spots)
    pointings = Pointings(aimed.readings[served])
    return Observations(
        (BeamSpots.on_targets(pointings, directions[served], {target.name: target}, names, measured, sigma_m),)
    )


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """Places of a drone from which a target is seen in a heliostat, and the readings that show it.

    drone_m (n, 3): Places [m].
    readings (n, 2): Readings.
    """

    drone_m: FloatArray
    readings: FloatArray

    def __len__(self) -> int:
        return len(self.drone_m)

    def first(self, count: int) -> "Flight":
        """Return the flight's first points."""
        return Flight(self.drone_m[:count], self.readings[:count])


def drawn_flight(
    truth: HeliostatDesign, target_m: npt.ArrayLike, radius_m: tuple[float, float], count: int, rng: np.random.Generator
) -> Flight:
    """Draw places of a drone on a dome about a heliostat.

    target_m (3,): The point that the drone shall see in the mirror [m].
    radius_m: Least and greatest distance, drawn evenly [m].
    Returns: Places that the heliostat can serve, seen at less than 80 deg from the normal.
    InputError: It can serve hardly any.

    Gouws (2018), section 5.1: directions even over the half sphere; a candidate that cannot be served is drawn anew.
    """
    found_m: list[FloatArray] = []
    readings: list[FloatArray] = []
    for _ in range(_MOST_DRAWS):
        height = rng.random(2 * count)
        turn, radius = 2 * np.pi * rng.random(2 * count), rng.uniform(*radius_m, 2 * count)
        flat = np.sqrt(1 - height**2)
        drone = truth.position_m + radius[:, None] * np.stack(
            [flat * np.sin(turn), flat * np.cos(turn), height], axis=1
        )
        aimed = aim(truth, truth.parameters.values, drone, target_m, finite=True)
        sight = drone - aimed.centre_m
        cosine = np.einsum("ni,ni->n", sight, aimed.normals) / np.linalg.norm(sight, axis=1)
        with np.errstate(invalid="ignore"):
            served = aimed.converged & aimed.within_limits & (cosine > np.cos(MOST_INCIDENCE_RAD))
            served &= aimed.normals[:, 2] > 0
        found_m.append(drone[served])
        readings.append(aimed.readings[served])
        if sum(len(part) for part in found_m) >= count:
            return Flight(np.concatenate(found_m)[:count], np.concatenate(readings)[:count])
    raise InputError(f"{truth.name}: a drone at {radius_m[0]:g} to {radius_m[1]:g} m hardly ever sees the target in it")


def drawn_sightings(
    flight: Flight,
    target: Place,
    rng: np.random.Generator,
    *,
    sigma_m: tuple[float, float, float] = RTK_SIGMA_M,
    offset_sigma_m: npt.ArrayLike = 0.0,
) -> Observations:
    """Draw the places of a drone as an RTK-GPS measures them.

    target: The point seen, with its survey sigma.
    sigma_m: Of the drone's position, east, north, up; white [m].
    offset_sigma_m () or (3,): Prior sigma of the camera's place beside the antenna [m].
    """
    sigma = np.asarray(sigma_m)
    measured = flight.drone_m + sigma * rng.standard_normal(flight.drone_m.shape)
    covariance = np.broadcast_to(np.diag(sigma**2), (len(flight), 3, 3))
    sightings = DroneSightings(
        Pointings(flight.readings),
        measured,
        covariance,
        (target.name,) * len(flight),
        (target,),
        np.asarray(offset_sigma_m, dtype=np.float64),
    )
    return Observations((sightings,))


@dataclass(frozen=True, slots=True, eq=False)
class MonteCarlo:
    """Repeated fits to drawn observations.

    names: Parameters, length p.
    truth (p,): Their true values.
    values, sigmas (t, p): Estimates and their stated standard deviations.
    chi_squares (t,): Squared length of each fit's errors in terms of its stated covariance, over the number of free
        parameters.
    figures (t, k): What the evaluation returned for each fit.
    failed: Messages of trials that gave no fit.
    """

    names: tuple[str, ...]
    truth: FloatArray
    values: FloatArray
    sigmas: FloatArray
    chi_squares: FloatArray
    figures: FloatArray
    failed: tuple[str, ...]

    @property
    def errors(self) -> FloatArray:
        """Estimates less truth, shape (t, p)."""
        return np.asarray(self.values - self.truth)

    @property
    def consistency(self) -> float:
        """Scatter over stated sigma of all free parameters together: 1 +- 0.7 / root(t p)."""
        return float(np.sqrt(np.mean(self.chi_squares)))

    @property
    def scatter_over_sigma(self) -> FloatArray:
        """RMS error of each parameter over the RMS of its stated sigma, shape (p,); NaN for held ones."""
        stated = np.sqrt(np.mean(self.sigmas**2, axis=0))
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.where(stated > 0, np.sqrt(np.mean(self.errors**2, axis=0)) / stated, np.nan))


def monte_carlo(
    truth: HeliostatDesign,
    believed: HeliostatDesign,
    draw: Draw,
    trials: int,
    seed: int | tuple[int, ...],
    *,
    evaluate: Evaluate | None = None,
) -> MonteCarlo:
    """Fit a heliostat again and again to newly drawn observations.

    believed: What is known before: values and prior sigmas.
    draw: Returns observations for a random generator.
    seed: Of all draws; trial t has a generator of its own.
    evaluate: Returns k figures of the fitted heliostat, such as its tracking errors.
    Returns: All fits. The stated sigmas are believed, since the errors are drawn with them.
    InputError: No trial is asked for.
    EstimationError: No trial gave a fit.
    """
    if trials < 1:
        raise InputError(f"trials: at least one is needed, not {trials}")
    fits: list[HeliostatFit] = []
    failed: list[str] = []
    for rng in np.random.default_rng(seed).spawn(trials):
        try:
            fits.append(fit(believed, draw(rng), FitOptions(loss="squares", sigma="stated")))
        except EstimationError as error:
            failed.append(str(error))
    if not fits:
        raise EstimationError(f"none of {trials} trials gave a fit: {failed[0]}")
    kept = [name for name in fits[0].names if name in truth.parameters.names]
    index = fits[0].design.parameters.indices(kept)
    figures = [np.zeros(0) if evaluate is None else np.atleast_1d(evaluate(one.design)) for one in fits]
    return MonteCarlo(
        tuple(kept),
        truth.parameters.values[truth.parameters.indices(kept)],
        np.array([one.values[index] for one in fits]),
        np.array([one.sigma[index] for one in fits]),
        np.array([_chi_square(one, truth) for one in fits]),
        np.array(figures),
        tuple(failed),
    )


def _chi_square(found: HeliostatFit, truth: HeliostatDesign) -> float:
    """Return the errors' squared Mahalanobis length over their number, without what the observations brought along."""
    free = [name for name in found.solution.names if name in truth.parameters.names]
    if not free:
        return float("nan")
    index = found.design.parameters.indices(free)
    sigma = found.sigma[index]
    error = (found.values[index] - truth.parameters.values[truth.parameters.indices(free)]) / sigma
    correlation = found.covariance[np.ix_(index, index)] / np.outer(sigma, sigma)
    return float(error @ np.linalg.solve(correlation, error)) / len(free)
