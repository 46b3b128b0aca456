"""The smallest number of photos that reaches a wanted sigma, by trying rings of stations."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from heliogauge.doubts import Doubt, Severity, gather_doubts
from heliogauge.errors import EstimationError
from heliogauge.validate import positive
from photogrammetry.bundle.constraints import Distance
from photogrammetry.bundle.statistics import examine_intrinsics
from photogrammetry.planning.planned_network import PlannedCamera, Prediction, predict, q_factor
from photogrammetry.planning.stations import PlannedObject, Reach, aims_m, ring_stations

#: Numbers of photos that are tried; the gap before the first that is enough is searched.
_LADDER = (4, 6, 8, 10, 12, 16, 20, 24, 30, 36, 44, 52, 64, 80, 100, 120, 150, 200, 250, 300)
#: With two rays errors hardly show; the third names the culprit.
LEAST_RAYS = 3
#: What makes a network weak.
_WEAK_DEPTH = 2.5
_WEAK_CONVERGENCE_RAD = np.radians(50.0)
_WEAK_COVERAGE = 0.5
_WEAK_CORRELATION = 0.98
#: Fraser's range for convergent networks.
Q_RANGE = (0.4, 0.8)


@dataclass(frozen=True, slots=True)
class Goal:
    """What is wanted.

    sigma_m: Wanted standard deviation of the coordinates [m].
    of_largest: Whether the largest of all sigmas must keep it, or their RMS.
    InputError: A sigma that is not positive.
    """

    sigma_m: float
    of_largest: bool = False
    most_photos: int = 100

    def __post_init__(self) -> None:
        positive("plan: wanted sigma", self.sigma_m, "metres")

    def value_m(self, prediction: Prediction) -> float:
        """Return what is compared with the wanted sigma [m]."""
        return prediction.largest_m if self.of_largest else prediction.rms_m

    def is_reached(self, prediction: Prediction) -> bool:
        """Whether a network is good enough: sigma, nothing undetermined, three rays for every target."""
        enough = bool((prediction.rays >= LEAST_RAYS).all()) and not prediction.reason
        return enough and self.value_m(prediction) <= self.sigma_m


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """What is to be planned.

    planned: The camera.
    reach: Where a camera can be.
    goal: What is wanted.
    bars: Scale bars between targets of the object.
    """

    target_object: PlannedObject
    planned: PlannedCamera
    reach: Reach
    goal: Goal
    bars: tuple[Distance, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """One layout with one number of photos.

    rings_rad: Angles of its rings from the object's normal [rad].
    prediction: What it gives.
    """

    rings_rad: tuple[float, ...]
    count: int
    prediction: Prediction

    @property
    def name(self) -> str:
        """The layout in words."""
        return "rings at " + " and ".join(f"{np.degrees(angle):.0f}" for angle in self.rings_rad) + " deg"


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """The chosen network and all that were tried.

    best: The network with the fewest photos that reaches the goal, or the best one of all where none does.
    reached: Whether it reaches the goal.
    q: Its factor of the planning rule, see `photogrammetry.planning.planned_network.q_factor`.
    doubts: What is weak in it.
    """

    best: Trial
    reached: bool
    trials: tuple[Trial, ...]
    q: float
    doubts: tuple[Doubt, ...]


def plan_network(
    task: Task, layouts: Sequence[tuple[float, ...]], *, tell: Callable[[int], None] | None = None
) -> Plan:
    """Find the smallest number of photos that gives a wanted sigma.

    task: Object, camera, goal.
    layouts: Rings that are tried together: angles from the object's normal [rad].
    tell: Receives each number of photos before it is tried.
    Returns: The network; `reached` is False where even the most photos are not enough.
    EstimationError: No layout sees enough to determine anything.
    """
    goal = task.goal
    aims = aims_m(task.target_object, task.planned.camera, task.reach.distance_m)
    trials: list[Trial] = []

    def tried(rings: tuple[float, ...], count: int) -> Trial:
        stations = ring_stations(task.target_object, aims, task.reach, rings, count)
        trials.append(Trial(rings, count, predict(task.target_object, task.planned, stations, task.reach, task.bars)))
        return trials[-1]

    previous = 2
    for count in [*(n for n in _LADDER if n < goal.most_photos), goal.most_photos]:
        if tell is not None:
            tell(count)
        good = [one for one in [tried(rings, count) for rings in layouts] if goal.is_reached(one.prediction)]
        if good:
            best = _fewest(good, tried, goal, previous)
            # What a few more photos would bring.
            for more in [n for n in _LADDER if best.count < n <= goal.most_photos][:2]:
                tried(best.rings_rad, more)
            return Plan(best, True, tuple(trials), *_judge(best, task))
        previous = count
    usable = [one for one in trials if not one.prediction.reason]
    if not usable:
        last = trials[-1].prediction
        raise EstimationError(f"plan: none of {len(trials)} networks determines all targets; the last: {last.reason}")
    best = min(usable, key=lambda one: goal.value_m(one.prediction))
    return Plan(best, False, tuple(trials), *_judge(best, task))


def _fewest(
    good: Sequence[Trial], tried: Callable[[tuple[float, ...], int], Trial], goal: Goal, previous: int
) -> Trial:
    """Search between the last number of photos that was not enough and the first that is."""
    found = min(good, key=lambda one: goal.value_m(one.prediction))
    for layout in good:
        low, high = previous, found.count
        while high - low > 1:
            middle = (low + high) // 2
            trial = tried(layout.rings_rad, middle)
            if goal.is_reached(trial.prediction):
                found, high = trial, middle
            else:
                low = middle
    return found


def _judge(best: Trial, task: Task) -> tuple[float, tuple[Doubt, ...]]:
    """Return q and what is weak in a network."""
    prediction = best.prediction
    q = q_factor(prediction, task.planned, task.target_object)
    low, high = Q_RANGE
    weak = None
    if q > high:
        weak = Doubt(
            "plan_q_large",
            f"q = {q:.2f} of the planning rule is above {low} to {high} of strong convergent networks: poses, camera "
            "or scale add to what the rays give",
            {"q_ratio": q},
        )
    return q, gather_doubts(
        _about_the_goal(best, task), _about_geometry(prediction, task), _about_the_camera(prediction, task), weak
    )


def _about_the_goal(best: Trial, task: Task) -> Iterator[Doubt]:
    prediction, goal = best.prediction, task.goal
    if not goal.is_reached(prediction):
        value_m = goal.value_m(prediction)
        yield Doubt(
            "plan_goal_not_reached",
            f"the wanted sigma of {1e3 * goal.sigma_m:g} mm is not reached with up to {goal.most_photos} photos: "
            f"{1e3 * value_m:.4f} mm with {best.count}; come closer, take a longer lens, more photos or better targets",
            {"wanted_m": goal.sigma_m, "reached_m": value_m, "photos_count": best.count},
            Severity.SERIOUS,
        )
    few = [name for name, n in zip(task.target_object.names, prediction.rays, strict=True) if n < LEAST_RAYS]
    if few:
        text = f"{len(few)} targets are seen in fewer than {LEAST_RAYS} photos: {', '.join(few[:8])}"
        yield Doubt("plan_targets_in_few_photos", text, {"targets_count": len(few)})
    if not task.bars:
        yield Doubt("plan_without_scale_bar", "there is no scale bar: these sigmas are without the scale's share")


def _about_geometry(prediction: Prediction, task: Task) -> Iterator[Doubt]:
    facing = task.target_object.facing
    along = np.sqrt(np.einsum("i,nij,j->n", facing, prediction.covariance_m2, facing).mean())
    across = np.sqrt(max((prediction.rms_m**2 * 3 - along**2) / 2, 1e-300))
    if along > _WEAK_DEPTH * across:
        yield Doubt(
            "plan_depth_weak",
            f"depth is weak: sigma along the object's normal is {along / across:.1f} times that across it; stand "
            "further from the normal",
            {"along_over_across_ratio": float(along / across)},
        )
    angle = float(np.nanmedian(prediction.convergence_rad))
    if angle < _WEAK_CONVERGENCE_RAD:
        text = f"rays meet at {np.degrees(angle):.0f} degrees at most (median of the targets); 60 to 100 are good"
        yield Doubt("plan_convergence_weak", text, {"convergence_rad": angle})


def _about_the_camera(prediction: Prediction, task: Task) -> Iterator[Doubt]:
    if not task.planned.free or prediction.bundle is None:
        return
    if not task.reach.turned:
        yield Doubt(
            "plan_camera_never_turned",
            "no photo is turned: the principal point is badly separated from the poses; turn the camera by 90 "
            "degrees for every other photo",
        )
    if prediction.coverage_share < _WEAK_COVERAGE:
        yield Doubt(
            "plan_coverage_poor",
            f"targets fill {prediction.coverage_share:.0%} of the image: beyond them the distortion is a guess; go "
            "closer, or calibrate the camera beforehand",
            {"covered_share": prediction.coverage_share},
        )
    own = ("focal_px", "center_x_px", "center_y_px")
    tied = [
        f"{one.name} with {one.rival} ({one.correlation:+.3f})"
        for one in examine_intrinsics(prediction.bundle)
        # The principal point and its tangential coefficient nearly make up for each other in any network.
        if one.name in own and one.rival not in ("p1", "p2") and abs(one.correlation) > _WEAK_CORRELATION
    ]
    if tied:
        text = "the camera's parameters can hardly be separated: " + ", ".join(tied)
        yield Doubt("plan_intrinsics_correlated", text, {"pairs_count": len(tied)})
