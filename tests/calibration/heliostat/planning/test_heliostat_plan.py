"""Planning of measurements and schedules: what is promised is what comes."""

import numpy as np
import pytest

from calibration.heliostat.fitting.fit_result import FitOptions
from calibration.heliostat.fitting.prediction import sun_positions_of_year
from calibration.heliostat.fitting.robust_fit import fit
from calibration.heliostat.kinematic_model.design import PlaneTarget
from calibration.heliostat.kinematic_model.presets import azimuth_elevation, drone_heliostat
from calibration.heliostat.observations.observations import Place
from calibration.heliostat.planning.measurement_plan import (
    Knowledge,
    PlanOptions,
    beam_candidates,
    drone_candidates,
    knowledge_before,
    knowledge_of,
    plan_measurements,
    sigma_over_year,
)
from calibration.heliostat.planning.schedule import Need, ScheduleOptions, propose_schedule
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.sun import Site, sun_directions

SITE = Site(37.0, -2.0, 500.0)
TARGETS = {
    "upper": PlaneTarget.facing("upper", [0.0, 0.0, 42.0], 0.0, 7.0, 6.0),
    "lower": PlaneTarget.facing("lower", [0.0, 0.0, 34.0], 0.0, 7.0, 6.0),
}
AIM = np.array([0.0, 0.0, 50.0])
POSITION = (30.0, 90.0, 2.0)
SIGMAS = {
    "tilt_north": 5e-3,
    "tilt_east": 5e-3,
    "azimuth_offset": 20e-3,
    "elevation_offset": 20e-3,
    "non_orthogonality": 3e-3,
    "position_e": 0.05,
    "position_n": 0.05,
    "position_u": 0.05,
}
SUNS = sun_positions_of_year(SITE, 2025, per_day=12)[0]


def design():
    """Return a heliostat that was never measured."""
    made = azimuth_elevation("H1", POSITION)
    return made.with_parameters(made.parameters.with_sigmas(SIGMAS))


def times(first="2025-03-01", days=20, step=40):
    """Return instants between 7 and 17 UTC."""
    start = np.datetime64(first, "ms") + np.arange(days)[:, None] * np.timedelta64(1, "D")
    return (start + (420 + np.arange(0, 600, step)) * np.timedelta64(1, "m")).ravel()


@pytest.fixture(scope="module")
def before():
    """Return what the priors know, with a misfit of 0.2 mrad."""
    return knowledge_before(design(), 2e-4)


@pytest.fixture(scope="module")
def candidates(before):
    """Return beams that could be looked at."""
    return beam_candidates(before, SITE, TARGETS, times(), sigma_m=0.03)


def test_plan_reaches_the_goal_with_few(before, candidates):
    """Chosen suns bring the beam below 1 mrad, with fewer than suns as they come; each step helps."""
    plan = plan_measurements(before, candidates, SUNS, AIM)
    assert plan.needed is not None
    assert plan.needed == len(plan.chosen)
    assert plan.sigma_beam_rad[-1] <= 1e-3 < plan.sigma_beam_rad[-2]
    assert (np.diff(plan.sigma_beam_rad) < 0).all()
    assert f"{plan.needed} more measurements" in plan.text
    first = candidates.select(np.arange(len(candidates)) < plan.needed)
    as_they_come = plan_measurements(before, first, SUNS, AIM)
    assert as_they_come.sigma_beam_rad[-1] > plan.sigma_beam_rad[-1]


def test_promised_sigma_is_that_of_the_fit(before, candidates):
    """A fit to the chosen beams has the covariance that the plan promised."""
    plan = plan_measurements(before, candidates, SUNS, AIM, options=PlanOptions(most=8), goal_rad=1e-6)
    chosen = np.zeros(len(candidates), dtype=bool)
    chosen[plan.chosen] = True
    found = fit(design(), candidates.select(chosen), FitOptions(loss="squares", sigma="stated"))
    known = knowledge_of(found)
    after = Knowledge(known.design, known.names, known.covariance, before.misfit_rad)
    sigma = np.sqrt(np.mean(sigma_over_year(after, SUNS, AIM) ** 2))
    assert sigma == pytest.approx(plan.sigma_beam_rad[-1], rel=1e-6)


def test_first_choice_is_the_best_of_all(before, candidates):
    """Greedy's first step against trying every candidate alone."""
    few = candidates.select(np.arange(len(candidates)) % 17 == 0)
    plan = plan_measurements(before, few, SUNS, AIM, options=PlanOptions(most=1), goal_rad=1e-6)
    alone = [
        plan_measurements(before, few.select(np.arange(len(few)) == i), SUNS, AIM, goal_rad=1e-6).sigma_beam_rad[-1]
        for i in range(len(few))
    ]
    assert int(plan.chosen[0]) == int(np.argmin(alone))


def test_criterion_and_days(before, candidates):
    """The determinant chooses otherwise; a day holds no more than asked."""
    days = candidates.time.astype("datetime64[D]")
    plan = plan_measurements(
        before, candidates, SUNS, AIM, goal_rad=1e-6, options=PlanOptions(most=12, per_day=1, criterion="parameters")
    )
    assert len(np.unique(days[plan.chosen])) == len(plan.chosen) == 12
    pointing = plan_measurements(before, candidates, SUNS, AIM, goal_rad=1e-6, options=PlanOptions(most=12))
    assert pointing.sigma_beam_rad[-1] < plan.sigma_beam_rad[-1]


def test_misfit_is_a_floor_and_said(before, candidates):
    """No number of measurements removes what the model does not describe."""
    rough = Knowledge(before.design, before.names, before.covariance, 1e-3)
    plan = plan_measurements(rough, candidates, SUNS, AIM, options=PlanOptions(most=10))
    assert plan.needed is None
    assert plan.floor_rad == pytest.approx(np.sqrt(2) * 1e-3)
    assert "misfit" in plan.text


def test_drone_wants_mixed_ranges():
    """Two ranges decide the arm along the normal, which one range, as far as the target is, cannot (spec 000)."""
    made = drone_heliostat("1", (-11.0, -27.0, 0.0), (0.4325, 0.24))
    sigmas = dict.fromkeys(("azimuth_offset", "elevation_offset"), 0.02)
    sigmas |= dict.fromkeys(("tilt_about_east", "tilt_about_north"), 5e-3)
    sigmas |= dict.fromkeys(("position_e", "position_n", "position_u"), 0.05) | {"arm_normal": 0.5, "arm_up": 0.1}
    known = knowledge_before(made.with_parameters(made.parameters.with_sigmas(sigmas)))
    target = Place("tower", np.array([0.0, 0.0, 4.25]))
    suns = sun_positions_of_year(Site(-33.9, 18.9, 100.0), 2018, per_day=8)[0]
    sigma = {}
    for ranges in ((29.5,), (29.5, 70.0)):
        places = drone_candidates(known, target, ranges, sigma_m=(5.6e-3, 5.8e-3, 8.9e-3))
        plan = plan_measurements(known, places, suns, target.center_m, goal_rad=1e-9, options=PlanOptions(most=20))
        sigma[ranges] = plan.sigma_beam_rad[-1]
        if len(ranges) == 2:
            chosen = np.linalg.norm(places.groups[0].source_m[plan.chosen] - made.position_m, axis=1)
            assert {29.5, 70.0} == set(chosen.round(6).tolist())
    assert sigma[(29.5, 70.0)] < 0.7 * sigma[(29.5,)]


def test_what_cannot_be_planned_is_refused(before):
    """No prior, night, nothing uncertain, numbers out of range."""
    made = azimuth_elevation("H1", POSITION).with_free("5")
    with pytest.raises(InputError, match="without a prior"):
        knowledge_before(made)
    night = np.array(["2025-03-01T01:00"], dtype="datetime64[ms]")
    with pytest.raises(EstimationError, match="cannot send the sun"):
        beam_candidates(before, SITE, TARGETS, night, sigma_m=0.03)
    with pytest.raises(InputError, match="nothing to plan"):
        knowledge_before(azimuth_elevation("H1", POSITION))
    with pytest.raises(InputError, match="at least 1"):
        PlanOptions(most=0)


# --- schedule ---------------------------------------------------------------------------------------------------------


def needs(count, beams=4):
    """Return heliostats, the last the worst."""
    return [Need(f"H{i:02d}", 1e-3 * (i + 1), beams, ("upper", "lower")) for i in range(count)]


DAYS = np.arange("2025-03-01", "2025-03-11", dtype="datetime64[D]")


def test_schedule_serves_everyone_once_at_a_time():
    """All beams have a slot; no target has two beams, no heliostat two slots, at once; suns are apart."""
    options = ScheduleOptions(slot_minutes=10.0)
    schedule = propose_schedule(needs(30), SITE, DAYS, options)
    assert schedule.unserved == {}
    slots = schedule.slots
    assert len(slots) == 120
    assert len({(slot.time, slot.target) for slot in slots}) == 120
    assert len({(slot.time, slot.heliostat) for slot in slots}) == 120
    for name in ("H00", "H29"):
        own = np.stack([slot.sun for slot in slots if slot.heliostat == name])
        apart = np.arccos(np.clip(own @ own.T, -1, 1))[np.triu_indices(4, 1)]
        assert apart.min() >= options.apart_rad - 1e-9
        times = np.array([slot.time for slot in slots if slot.heliostat == name])
        assert np.allclose(own, sun_directions(times, SITE))


def test_worst_first_and_so_many_a_day():
    """The first day takes the worst; a day takes no more heliostats than asked; what has no room is reported."""
    options = ScheduleOptions(slot_minutes=20.0, per_day=3)
    schedule = propose_schedule(needs(12, beams=3), SITE, DAYS[:2], options)
    days = {}
    for slot in schedule.slots:
        days.setdefault(slot.time.astype("datetime64[D]"), set()).add(slot.heliostat)
    assert all(len(names) <= 3 for names in days.values())
    assert days[DAYS[0]] == {"H11", "H10", "H09"}
    assert schedule.slots[0].heliostat == "H11"
    assert set(schedule.unserved) == {f"H{i:02d}" for i in range(12)} - set().union(*days.values())


def test_never_calibrated_comes_first():
    """A heliostat without any calibration comes before all others."""
    listed = [*needs(5), Need("new", np.inf, 2, ("upper",))]
    assert propose_schedule(listed, SITE, DAYS[:1]).slots[0].heliostat == "new"


def test_schedule_without_heliostats_or_days():
    """Both are refused, and a name that is there twice."""
    with pytest.raises(InputError, match="names"):
        propose_schedule([], SITE, DAYS)
    with pytest.raises(InputError, match="names"):
        propose_schedule([*needs(2), *needs(1)], SITE, DAYS)
    with pytest.raises(InputError, match="day"):
        propose_schedule(needs(2), SITE, [])
