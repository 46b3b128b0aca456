"""Which measurements to make next: the positions that take most from the uncertainty of a year's pointing.

All errors are of the beam: the root of both axes' variances, as `prediction` has it; the normal is half of it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from calibration.heliostat.fitting.fit_result import HeliostatFit
from calibration.heliostat.kinematic_model.aiming import Aim, aim
from calibration.heliostat.kinematic_model.design import HeliostatDesign, PlaneTarget
from calibration.heliostat.observations.beam_observations import BeamSpots, DroneSightings
from calibration.heliostat.observations.observations import Observations, Place, Pointings
from calibration.heliostat.observations.residuals import evaluate
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.sun import Site, sun_directions
from heliogauge.validate import BoolArray, FloatArray, IntArray, float_array, positive

Criterion: TypeAlias = Literal["pointing", "parameters"]
# Parameters of which not even a thousandth of what could be wrong is known are no use to a plan.
_MOST_VARIANCE = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class Knowledge:
    """What is known of a heliostat now.

    design: With its estimates as values.
    names: Parameters that are not known exactly.
    covariance (k, k): Their covariance; priors alone for a heliostat that was never measured.
    misfit_rad: Scatter of the beam per axis that no parameters explain [rad].
    InputError: Shapes that do not fit, a name that the design does not have, or a negative misfit.
    """

    design: HeliostatDesign
    names: tuple[str, ...]
    covariance: FloatArray
    misfit_rad: float

    def __post_init__(self) -> None:
        count = len(self.names)
        if not count:
            raise InputError(f"{self.design.name}: no parameter is uncertain; there is nothing to plan for")
        object.__setattr__(self, "covariance", float_array("covariance", self.covariance, (count, count)))
        self.design.parameters.indices(self.names)
        if not self.misfit_rad >= 0:
            raise InputError(f"misfit_rad: 0 or more is needed, not {self.misfit_rad}")

    @property
    def columns(self) -> IntArray:
        """Positions of the parameters in the design."""
        return self.design.parameters.indices(self.names)


def knowledge_of(fit: HeliostatFit) -> Knowledge:
    """Return what a fit knows.

    Returns: Estimates, covariance, and the misfit by which estimated sigmas exceed the stated ones.
    """
    free = np.flatnonzero(fit.design.parameters.free)
    factor, sigma = fit.factor[fit.used], fit.residuals.sigma_beam_rad[fit.used]
    excess = np.maximum(factor**2 - 1, 0.0) * sigma**2
    known = excess[np.isfinite(excess)]
    misfit = float(np.sqrt(known.mean())) if known.size else 0.0
    names = tuple(fit.names[i] for i in free)
    return Knowledge(fit.design, names, fit.covariance[np.ix_(free, free)], misfit)


def knowledge_before(design: HeliostatDesign, misfit_rad: float = 0.0) -> Knowledge:
    """Return what the priors know of a heliostat that was never measured.

    misfit_rad: What is expected to remain per axis [rad of the beam].
    InputError: A parameter is free without a prior: nothing would be known of the beam.
    """
    parameters = design.parameters
    unknown = [name for name, sigma in zip(parameters.names, parameters.sigmas, strict=True) if np.isinf(sigma)]
    if unknown:
        raise InputError(f"{design.name}: {', '.join(unknown)} are free without a prior sigma; give one to plan with")
    free = np.flatnonzero(parameters.free)
    return Knowledge(
        design, tuple(parameters.names[i] for i in free), np.diag(parameters.sigmas[free] ** 2), misfit_rad
    )


# --- what could be measured -------------------------------------------------------------------------------------------


def beam_candidates(
    knowledge: Knowledge,
    site: Site,
    targets: Mapping[str, PlaneTarget],
    times: npt.ArrayLike,
    *,
    sigma_m: float,
    lowest_sun_rad: float = np.radians(10.0),
) -> Observations:
    """Return the beams that could be looked at.

    times (t,): When it could be measured (UTC).
    sigma_m: Of a measured centre, each axis [m].
    lowest_sun_rad: No measurements with a lower sun [rad].
    Returns: One row for each time and target that the heliostat can serve; the misfit is part of the sigmas.
    EstimationError: It can serve none.
    """
    positive("sigma_m", sigma_m, "metres")
    instants = np.asarray(times, dtype="datetime64[ms]")
    suns = sun_directions(instants, site)
    up = suns[:, 2] > np.sin(lowest_sun_rad)
    instants, suns = instants[up], suns[up]
    groups = []
    for name, target in targets.items():
        aimed = _aimed(knowledge.design, suns, target.center_m)
        served = _served(aimed.converged & aimed.within_limits, aimed.normals, suns)
        if not served.any():
            continue
        distance = np.linalg.norm(aimed.centre_m[served] - target.center_m, axis=1)
        sigma = np.hypot(sigma_m, knowledge.misfit_rad * distance)[:, None].repeat(2, axis=1)
        pointings = Pointings(aimed.readings[served], time=instants[served])
        centers = np.zeros((int(served.sum()), 2))
        names = (name,) * len(centers)
        groups.append(BeamSpots.on_targets(pointings, suns[served], {name: target}, names, centers, sigma))
    if not groups:
        raise EstimationError(
            f"{knowledge.design.name}: cannot send the sun to {', '.join(targets)} at any of the times; "
            "give other dates or targets"
        )
    return Observations(tuple(groups))


def drone_candidates(
    knowledge: Knowledge, target: Place, ranges_m: npt.ArrayLike, *, sigma_m: npt.ArrayLike, directions: int = 60
) -> Observations:
    """Return places from which a drone could see a target in the mirror.

    target: The point that is seen in the mirror's middle.
    ranges_m (r,): Distances from the heliostat; several, because at one range an arm along the normal trades with
        the target's distance and stays unknown [m].
    sigma_m () or (3,): Of the drone's place: east, north, up [m].
    directions: Directions over the half sphere at each range.
    Returns: One row for each place that the heliostat can serve.
    EstimationError: It can serve none.
    """
    ranges = np.atleast_1d(np.asarray(ranges_m, dtype=np.float64))
    count = np.arange(directions) + 0.5
    height = count / directions
    turn, flat = np.pi * (1 + np.sqrt(5)) * count, np.sqrt(1 - height**2)
    sphere = np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)
    places = knowledge.design.position_m + (ranges[:, None, None] * sphere).reshape(-1, 3)
    aimed = _aimed(knowledge.design, places, target.center_m, finite=True)
    served = _served(aimed.converged & aimed.within_limits, aimed.normals, places - aimed.centre_m)
    if not served.any():
        raise EstimationError(f"{knowledge.design.name}: a drone at {ranges.tolist()} m never sees {target.name} in it")
    covariance = np.broadcast_to(np.eye(3) * np.asarray(sigma_m) ** 2, (int(served.sum()), 3, 3))
    names = (target.name,) * int(served.sum())
    return Observations(
        (DroneSightings(Pointings(aimed.readings[served]), places[served], covariance, names, (target,)),)
    )


def _aimed(design: HeliostatDesign, sources: FloatArray, point: FloatArray, *, finite: bool = False) -> Aim:
    # Many positions of a year cannot be reached; their NaN are asked for.
    with np.errstate(invalid="ignore"):
        return aim(design, design.parameters.values, sources, point, finite=finite)


def _served(possible: BoolArray, normals: FloatArray, sources: FloatArray) -> BoolArray:
    """Whether a position can be had with the mirror's front to the source, and not beyond 80 degrees."""
    with np.errstate(invalid="ignore"):
        cosine = np.einsum("ni,ni->n", normals, sources) / np.linalg.norm(sources, axis=1)
        return np.asarray(possible & (cosine > np.cos(np.radians(80.0))))


# --- the plan ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class MeasurementPlan:
    """Measurements in the order of their worth.

    chosen (m,): Rows of the candidates.
    sigma_beam_rad (m + 1,): Mean over the year of the beam's sigma before any and after each, misfit included
        [rad].
    floor_rad: What remains with perfect parameters: the misfit, both axes [rad of the beam].
    goal_rad: What was asked for [rad of the beam].
    """

    chosen: IntArray
    sigma_beam_rad: FloatArray
    floor_rad: float
    goal_rad: float

    @property
    def needed(self) -> int | None:
        """How many measurements reach the goal: 0 if it is reached already, None if all of these do not."""
        reached = np.flatnonzero(self.sigma_beam_rad <= self.goal_rad)
        return int(reached[0]) if reached.size else None

    @property
    def text(self) -> str:
        """The answer in one sentence."""
        before, after, goal = 1e3 * self.sigma_beam_rad[0], 1e3 * self.sigma_beam_rad[-1], 1e3 * self.goal_rad
        if self.floor_rad >= self.goal_rad:
            return (
                f"the beam's sigma over a year is {before:.2f} mrad; no number of measurements brings it below "
                f"{goal:.2g} mrad: {1e3 * self.floor_rad:.2f} mrad are misfit of the model; {len(self.chosen)} more "
                f"measurements bring it to {after:.2f} mrad"
            )
        if self.needed is None:
            return (
                f"the beam's sigma over a year is {before:.2f} mrad; {len(self.chosen)} more measurements bring it to "
                f"{after:.2f} mrad, not below {goal:.2g} mrad"
            )
        if self.needed == 0:
            return f"the beam's sigma over a year is {before:.2f} mrad, below {goal:.2g} mrad already"
        return (
            f"the beam's sigma over a year is {before:.2f} mrad; {self.needed} more measurements bring it to "
            f"{1e3 * self.sigma_beam_rad[self.needed]:.2f} mrad"
        )


def plan_measurements(
    knowledge: Knowledge,
    candidates: Observations,
    suns: npt.ArrayLike,
    aim_point_m: npt.ArrayLike,
    *,
    goal_rad: float = 1e-3,
    options: "PlanOptions | None" = None,
) -> MeasurementPlan:
    """Choose measurements one by one, each the one that helps most after those before it.

    knowledge: What is known now.
    candidates: What could be measured; their sigmas hold what a measurement is worth.
    suns (y, 3): Suns of the year over which the heliostat shall point.
    aim_point_m (3,): Where the beam shall go then [m].
    goal_rad: Mean sigma of the beam over the year at which to stop [rad].
    EstimationError: The heliostat can serve none of the year's suns.

    Greedy I-optimal design: with covariance C, a candidate of whitened derivatives G takes
    ``tr((G C G' + I)^-1 G C W C G')`` from the year's mean variance ``tr(C W)``; D-optimal ("parameters"):
    ``log det(I + G C G')``. Greedy is within 1 - 1 / e of the best of as many for the determinant.
    """
    options = options or PlanOptions()
    positive("goal_rad", goal_rad, "radians")
    year = _year(knowledge, np.asarray(suns, dtype=np.float64), aim_point_m)
    worth = np.einsum("yij,yik->jk", year, year) / len(year)
    rows = _derivatives(knowledge, candidates)
    floor = 2 * knowledge.misfit_rad**2
    scale = np.sqrt(np.maximum(np.diag(knowledge.covariance), 1 / _MOST_VARIANCE**2))
    covariance = knowledge.covariance / scale[:, None] / scale
    rows, worth = rows * scale, worth * scale[:, None] * scale
    chosen: list[int] = []
    sigmas = [float(np.sqrt(np.einsum("ij,ji->", covariance, worth) + floor))]
    left = np.ones(len(rows), dtype=np.bool_)
    days = candidates.time.astype("datetime64[D]")
    while len(chosen) < options.most and left.any() and sigmas[-1] > goal_rad:
        gain = _gains(covariance, worth, rows, options.criterion)
        gain[~left] = -np.inf
        best = int(np.argmax(gain))
        if gain[best] <= 0:
            break
        covariance = _updated(covariance, rows[best])
        chosen.append(best)
        sigmas.append(float(np.sqrt(np.einsum("ij,ji->", covariance, worth) + floor)))
        left[best] = False
        # Beneath a floor that is too high, measurements that bring less than a percent are wasted.
        if np.sqrt(floor) >= goal_rad and sigmas[-1] > 0.99 * sigmas[-2]:
            break
        same = (days == days[best]) & ~np.isnat(days)
        if options.per_day and int(same[chosen].sum()) >= options.per_day:
            left &= ~same
    return MeasurementPlan(np.array(chosen, dtype=np.intp), np.array(sigmas), float(np.sqrt(floor)), goal_rad)


@dataclass(frozen=True, slots=True)
class PlanOptions:
    """How to choose measurements.

    per_day: Measurements on one day at most; 0 for any number.
    criterion: What shall become small: the beam's variance over the year, or that of the parameters as a whole.
    InputError: A number below 0, or a criterion that does not exist.
    """

    most: int = 50
    per_day: int = 0
    criterion: Criterion = "pointing"

    def __post_init__(self) -> None:
        if self.most < 1 or self.per_day < 0:
            raise InputError(f"plan: at least 1 measurement, 0 or more a day, not {self.most}, {self.per_day}")
        if self.criterion not in ("pointing", "parameters"):
            raise InputError(f"criterion: pointing or parameters is needed, not {self.criterion!r}")


def sigma_over_year(knowledge: Knowledge, suns: npt.ArrayLike, aim_point_m: npt.ArrayLike) -> FloatArray:
    """Return the beam's sigma at each sun that the heliostat can serve, misfit included.

    Shapes: suns (y, 3).
    aim_point_m (3,): Where the beam shall go [m].
    Returns (served,): Root of both axes' variances [rad of the beam].
    EstimationError: It can serve none.
    """
    year = _year(knowledge, np.asarray(suns, dtype=np.float64), aim_point_m)
    variance = np.einsum("yij,jk,yik->y", year, knowledge.covariance, year)
    return np.asarray(np.sqrt(variance + 2 * knowledge.misfit_rad**2))


def _gains(covariance: FloatArray, worth: FloatArray, rows: FloatArray, criterion: Criterion) -> FloatArray:
    spread = rows @ covariance
    own = spread @ rows.transpose(0, 2, 1) + np.eye(rows.shape[1])
    if criterion == "parameters":
        return np.asarray(np.linalg.slogdet(own)[1])
    taken = spread @ worth @ spread.transpose(0, 2, 1)
    return np.asarray(np.trace(np.linalg.solve(own, taken), axis1=1, axis2=2))


def _updated(covariance: FloatArray, row: FloatArray) -> FloatArray:
    spread = row @ covariance
    left = covariance - spread.T @ np.linalg.solve(spread @ row.T + np.eye(len(row)), spread)
    return np.asarray((left + left.T) / 2)


def _derivatives(knowledge: Knowledge, candidates: Observations) -> FloatArray:
    """Whitened derivatives of each candidate, (n, 2, k)."""
    design = knowledge.design
    design = design.with_parameters(design.parameters.extended(candidates.extra_parameters(design)))
    rows = evaluate(design, design.parameters.values, candidates, columns=knowledge.columns)
    return np.asarray(rows.jacobian.reshape(len(candidates), -1, len(knowledge.names)))


def _year(knowledge: Knowledge, suns: FloatArray, aim_point_m: npt.ArrayLike) -> FloatArray:
    """Return derivatives of the beam's direction at the suns that can be served, (y, 2, k) [rad]."""
    design, values = knowledge.design, knowledge.design.parameters.values
    point = float_array("aim_point_m", aim_point_m, (3,))
    aimed = _aimed(design, suns, point)
    served = _served(aimed.converged & aimed.within_limits, aimed.normals, suns)
    if not served.any():
        raise EstimationError(f"{design.name}: cannot send the sun to the aim point at any of {len(suns)} positions")
    count = int(served.sum())
    # Seen with a sigma of 1 m, whitened residuals are angles times the distance.
    seen = BeamSpots.at_points(
        Pointings(aimed.readings[served]), suns[served], np.broadcast_to(point, (count, 3)), 1.0, ("",) * count
    )
    rows = evaluate(design, values, Observations((seen,)), columns=knowledge.columns)
    own = rows.jacobian.reshape(count, 2, len(knowledge.names))
    return np.asarray(own * rows.sigma_beam_rad[:, None, None])
