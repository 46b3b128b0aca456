"""Kinds of observation that contradict each other: said first, and nothing else is a fault while they do."""

import tracemalloc

import numpy as np
import pytest

from calibration.heliostat.diagnosis.full_diagnosis import diagnose
from calibration.heliostat.diagnosis.kinds import contradiction_finding, squared_distance
from calibration.heliostat.fitting.fit_result import FitOptions
from calibration.heliostat.fitting.robust_fit import fit
from calibration.heliostat.kinematic_model.kinematics import mirror_poses
from calibration.heliostat.observations.observations import (
    DroneSightings,
    MirrorNormals,
    Observations,
    Place,
    Pointings,
)
from calibration.heliostat.observations.residuals import evaluate
from tests.calibration.heliostat.diagnosis.test_heliostat_diagnosis import SITE, TARGETS, drawn, nominal, seen

NORMAL_SIGMA_RAD, PLACE_SIGMA_M = 0.2e-3, 0.01


def turned(vectors, angle):
    """Turn vectors about the vertical."""
    sine, cosine = np.sin(angle), np.cos(angle)
    return vectors @ np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]]).T


def beside(kind, turn, seed, *, count=24, later=0.0):
    """Return 80 beams and so many normals, or sightings of a drone, whose frame is turned about the vertical [rad].

    later: Jump of a drive's zero in the second half [rad].
    """
    rng = np.random.default_rng(seed)
    truth = drawn(nominal(), rng)
    jumped = truth.with_value({"azimuth_offset": truth.parameters.value("azimuth_offset") + later})
    beams = seen(truth, rng, count=80, later=jumped if later else None)
    rows = np.linspace(0, 79, count).round().astype(int)
    pointings = Pointings(beams.readings[rows], 80 + np.arange(count), beams.time[rows])
    poses = mirror_poses(truth, truth.parameters.values, beams.readings[rows])
    after = mirror_poses(jumped, jumped.parameters.values, beams.readings[rows])
    normals = np.where(rows[:, None] < 40, poses.normals(truth), after.normals(jumped))
    if kind == "normal":
        noisy = normals + NORMAL_SIGMA_RAD * rng.standard_normal((count, 3))
        group = MirrorNormals(pointings, turned(noisy, turn), NORMAL_SIGMA_RAD)
    else:
        place = TARGETS["upper"].center_m
        ray = place - poses.centre_m
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        line = 2 * normals * np.einsum("ni,ni->n", normals, ray)[:, None] - ray
        drone = poses.centre_m + 40 * line + PLACE_SIGMA_M * rng.standard_normal((count, 3))
        drone = poses.centre_m + turned(drone - poses.centre_m, turn)
        group = DroneSightings(
            pointings,
            drone,
            np.broadcast_to(PLACE_SIGMA_M**2 * np.eye(3), (count, 3, 3)),
            ("upper",) * count,
            (Place("upper", place),),
        )
    return Observations((beams.groups[0], group))


def judged(observations):
    """Fit and diagnose."""
    return diagnose(fit(nominal(), observations), targets=TARGETS, site=SITE)


@pytest.mark.parametrize("kind", ["normal", "drone"])
@pytest.mark.parametrize("turn", [1e-3, 5e-3])
def test_kinds_that_contradict_are_said_first(kind, turn):
    for seed in range(4):
        diagnosis = judged(beside(kind, turn, seed))
        first = diagnosis.findings[0]
        assert (first.kind, first.severity) == ("unexplained", "fault")
        assert first.evidence["largest_ratio"] > 1.3
        assert first.chance < 0.01
        assert diagnosis.doubts[0].code == "unexplained"
        assert diagnosis.kinds == ("unexplained",)


@pytest.mark.parametrize("kind", ["normal", "drone"])
def test_no_half_of_a_milliradian_is_a_fault_of_clock_or_drives(kind):
    for seed in range(8):
        assert set(judged(beside(kind, 0.5e-3, seed)).kinds) <= {"unexplained"}


@pytest.mark.parametrize("kind", ["normal", "drone"])
def test_kinds_that_agree_are_not_accused(kind):
    found = [contradiction_finding(fit(nominal(), beside(kind, 0.0, seed)), 0.01) for seed in range(20)]
    assert sum(one is not None for one in found) <= 1


def test_a_sigma_that_is_too_small_contradicts_nothing():
    """The normals scatter three times as much as is said, about where the beams have them."""
    observations = beside("normal", 0.0, 3)
    normals = observations.groups[1]
    small = MirrorNormals(normals.pointings, normals.normal, NORMAL_SIGMA_RAD / 3)
    assert contradiction_finding(fit(nominal(), Observations((observations.groups[0], small))), 0.01) is None


def test_a_jump_is_a_fault_where_kinds_agree_and_open_where_they_do_not():
    """Beams and normals both show the jump; a frame that is turned leaves it open which of all that is wrong."""
    assert judged(beside("normal", 0.0, 1, later=1e-3)).kinds == ("change_point",)
    found = judged(beside("normal", 2e-3, 1, later=1e-3))
    # The beams scatter by the jump: that stands between the kinds too.
    assert found.kinds == ()
    assert found.named == ("unexplained?", "change_point?")
    text = next(one.text for one in found.findings if one.kind == "change_point")
    assert "It is open, because kinds of observation contradict each other" in text


@pytest.mark.parametrize("kind", ["normal", "drone"])
def test_ratio_is_that_of_the_whole_covariance_of_the_rows(kind):
    """Against the dense system of all rows; its memory and time grow by their square and cube."""
    seen_ones = beside(kind, 2e-3, 1)
    fitted = fit(nominal(), seen_ones)
    found = contradiction_finding(fitted, 0.01)
    kinds, ratios = np.array(seen_ones.kind), []
    for own in dict.fromkeys(seen_ones.kind):
        mine, others = fitted.used & (kinds == own), fitted.used & (kinds != own)
        rest = fit(fitted.nominal, seen_ones.select(others), FitOptions(restarts=0))
        alone = fit(fitted.nominal, seen_ones.select(mine), FitOptions(restarts=0))
        free = np.flatnonzero(rest.design.parameters.free)
        rows = evaluate(rest.design, rest.values, seen_ones.select(mine), columns=free)
        known = rows.computable[rows.owner]
        missed, moved = rows.whitened[known], rows.jacobian[known]
        noise = max(alone.sigma0[own], 1.0) ** 2 * np.eye(missed.size)
        square = missed @ np.linalg.solve(moved @ rest.solution.covariance @ moved.T + noise, missed)
        ratios.append(np.sqrt(square / missed.size))
    assert found.evidence["largest_ratio"] == pytest.approx(max(ratios), rel=1e-9)


def test_thousands_of_beams_are_compared_without_a_matrix_of_all_of_them():
    rng = np.random.default_rng(0)
    moved, missed = rng.standard_normal((6000, 8)), rng.standard_normal(6000)
    covariance = np.diag(np.logspace(-12, 0, 8))
    tracemalloc.start()
    square = squared_distance(missed, moved, covariance, 1.5)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10 * moved.nbytes
    few = slice(300)
    dense = moved[few] @ covariance @ moved[few].T + 1.5**2 * np.eye(300)
    expected = missed[few] @ np.linalg.solve(dense, missed[few])
    assert squared_distance(missed[few], moved[few], covariance, 1.5) == pytest.approx(expected, rel=1e-12)
    assert 5000 < square * 1.5**2 < 7000


def test_beams_alone_contradict_no_kind():
    observations = beside("normal", 5e-3, 1)
    assert contradiction_finding(fit(nominal(), Observations(observations.groups[:1])), 0.01) is None
