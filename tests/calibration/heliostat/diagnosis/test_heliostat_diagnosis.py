"""Diagnosis of heliostats: every fault named with its numbers, no healthy heliostat accused."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from calibration.heliostat.diagnosis.drift import change_dates
from calibration.heliostat.diagnosis.findings import REMEDIES
from calibration.heliostat.diagnosis.full_diagnosis import Records, diagnose
from calibration.heliostat.diagnosis.linear_model import linear_fit
from calibration.heliostat.diagnosis.terms import Terms
from calibration.heliostat.fitting.fit_result import FitOptions
from calibration.heliostat.fitting.robust_fit import fit
from calibration.heliostat.kinematic_model.aiming import aim
from calibration.heliostat.kinematic_model.design import PlaneTarget
from calibration.heliostat.kinematic_model.kinematics import mirror_poses
from calibration.heliostat.kinematic_model.presets import azimuth_elevation, linear_actuators, with_drive_terms
from calibration.heliostat.observations.observations import BeamSpots, Observations, Pointings
from heliogauge.errors import InputError
from heliogauge.geometry.rays import intersect_plane, reflect
from heliogauge.geometry.sun import Site, direction_from_angles, sun_angles, sun_directions
from tests.calibration.heliostat_models import ACTUATORS

SITE = Site(37.0, -2.0, 500.0)
TARGETS = {
    "upper": PlaneTarget.facing("upper", [0.0, 0.0, 42.0], 0.0, 7.0, 6.0),
    "lower": PlaneTarget.facing("lower", [0.0, 0.0, 34.0], 0.0, 7.0, 6.0),
}
POSITION = (30.0, 90.0, 2.0)
SIGMAS = {
    "tilt_north": 3e-3,
    "tilt_east": 3e-3,
    "azimuth_offset": 5e-3,
    "elevation_offset": 5e-3,
    "non_orthogonality": 1e-3,
    "position_e": 0.03,
    "position_n": 0.03,
    "position_u": 0.03,
}
SIGMA_M = 0.02
DAYS = 12


def nominal(sigmas=SIGMAS):
    """Return the heliostat as it is known beforehand."""
    design = azimuth_elevation("H1", POSITION)
    return design.with_parameters(design.parameters.with_sigmas(sigmas))


def drawn(design, rng):
    """Return a heliostat whose numbers come from the priors."""
    parameters = design.parameters
    sigma = np.where(np.isfinite(parameters.sigmas), parameters.sigmas, 0.0)
    return design.with_parameters(parameters.with_values(parameters.values + sigma * rng.normal(size=len(sigma))))


def times_of(count):
    """Return instants over ten months, `DAYS` days, ascending."""
    days = np.repeat(np.arange(DAYS) * 25, -(-count // DAYS))[:count]
    minutes = 500 + (np.arange(count) * 131) % 460
    start = np.datetime64("2025-01-10T00:00:00", "ms")
    return np.sort(start + days * np.timedelta64(1, "D") + minutes * np.timedelta64(1, "m"))


def seen(truth, rng, *, count=72, later=None, approach=None, sigma_m=SIGMA_M):
    """Return beams that a heliostat throws; ``later`` is the heliostat in the second half."""
    times = times_of(count)
    suns = sun_directions(times, SITE)
    names = np.where(rng.random(count) < 0.5, "upper", "lower")
    aims = np.stack([TARGETS[name].points(rng.normal(0, 0.4, (1, 2)))[0] for name in names])
    readings = aim(
        azimuth_elevation("a", POSITION) if truth.reading_unit == "rad" else truth, _plain(truth), suns, aims
    )
    readings = readings.readings
    xy = np.empty((count, 2))
    for part, heliostat in ((times < times[count // 2], truth), (times >= times[count // 2], later or truth)):
        xy[part] = hits(
            heliostat, readings[part], suns[part], names[part], None if approach is None else approach[part]
        )
    xy += rng.normal(0, sigma_m, xy.shape)
    return beams(readings, suns, names, xy, times)


def _plain(truth):
    return (
        azimuth_elevation("a", POSITION).parameters.values if truth.reading_unit == "rad" else truth.parameters.values
    )


def hits(design, readings, suns, names, approach=None):
    """Return where beams meet the targets that are named."""
    poses = mirror_poses(design, design.parameters.values, readings, approach)
    rays = reflect(-suns, poses.normals(design))
    found = np.empty((len(suns), 2))
    for name, target in TARGETS.items():
        mine = names == name
        along = intersect_plane(poses.centre_m[mine], rays[mine], target.center_m, target.normal)
        found[mine] = target.coordinates(poses.centre_m[mine] + along[:, None] * rays[mine])
    return found


def beams(readings, suns, names, xy, times, approach=None):
    """Return observations."""
    pointings = Pointings(readings, time=times, approach=approach)
    spots = BeamSpots.on_targets(pointings, suns, TARGETS, tuple(names.tolist()), xy, SIGMA_M)
    return Observations((spots,))


def changed(observations, **fields):
    """Return observations with fields of their only group replaced."""
    return Observations((replace(observations.groups[0], **fields),))


def judged(observations, design=None, **options):
    """Fit and diagnose."""
    found = fit(nominal() if design is None else design, observations)
    return diagnose(found, targets=TARGETS, site=SITE, **options)


@pytest.fixture
def rng():
    """Return a generator."""
    return np.random.default_rng(5)


@pytest.fixture
def healthy(rng):
    """Return a healthy heliostat and its beams."""
    truth = drawn(nominal(), rng)
    return truth, seen(truth, rng)


# --- healthy ----------------------------------------------------------------------------------------------------------


def _accused(seeds, significance):
    kinds = Counter()
    for seed in seeds:
        rng = np.random.default_rng(seed)
        found = fit(nominal(), seen(drawn(nominal(), rng), rng, count=48))
        diagnosis = diagnose(found, targets=TARGETS, site=SITE, significance=significance)
        kinds.update(one.severity for one in diagnosis.findings if one.kind != "outliers")
    return kinds


@pytest.mark.slow
def test_healthy_heliostats_are_not_accused():
    """No fault at all, and hints no more often than stated: 10 % of 40, three sigma above."""
    kinds = _accused(range(40), 0.1)
    assert kinds["fault"] == 0
    assert kinds["hint"] <= 4 + 3 * np.sqrt(4)


@pytest.mark.slow
def test_false_alarms_of_hundreds():
    """At 5 % no more than 5 % of 400 get any finding, three sigma above; none is accused."""
    kinds = _accused(range(1000, 1400), 0.05)
    assert kinds["fault"] == 0
    assert kinds["hint"] <= 20 + 3 * np.sqrt(20)


# --- faults -----------------------------------------------------------------------------------------------------------


def test_change_point_has_its_date_and_size(rng):
    """A jump of the azimuth on a day is found between the right days, with its size within 4 sigma."""
    truth = drawn(nominal(), rng)
    later = truth.with_value({"azimuth_offset": truth.parameters.value("azimuth_offset") + 3e-3})
    observations = seen(truth, rng, later=later)
    (finding,) = judged(observations).faults
    assert finding.kind == "change_point"
    before, after = (np.datetime64(day) for day in finding.dates)
    assert before < observations.time[36] <= after + np.timedelta64(1, "D")
    size, sigma = finding.evidence["azimuth_offset_rad"], finding.evidence["sigma_azimuth_offset_rad"]
    assert abs(size - 3e-3) < 4 * sigma
    assert finding.chance < 1e-4


def test_drift_has_its_rate(rng):
    """A slow drift is distinguished from a jump, with its rate within 4 sigma."""
    truth = drawn(nominal(), rng)
    times, suns = times_of(72), sun_directions(times_of(72), SITE)
    names = np.array(["upper", "lower"] * 36)
    centers = np.stack([TARGETS[name].center_m for name in names])
    readings = aim(nominal(), nominal().parameters.values, suns, centers).readings
    years = (times - times[0]) / np.timedelta64(31_557_600, "s")
    xy = np.concatenate(
        [
            hits(truth.with_value({"elevation_offset": 6e-3 * year}), readings[[i]], suns[[i]], names[[i]])
            for i, year in enumerate(years)
        ]
    )
    (finding,) = judged(beams(readings, suns, names, xy + rng.normal(0, SIGMA_M, xy.shape), times)).faults
    assert finding.kind == "drift"
    rate, sigma = (finding.evidence[f"{part}elevation_offset_rad_per_year"] for part in ("", "sigma_"))
    assert abs(rate - 6e-3) < 4 * sigma


def test_backlash_from_told_and_from_guessed_approach(rng):
    """Play shows with the direction of the last move."""
    truth = with_drive_terms(drawn(nominal(), rng), 0, ("backlash",)).with_value({"backlash_1": 4e-3})
    moves = np.stack([rng.choice([-1.0, 1.0], 72), np.ones(72)], axis=1)
    observations = seen(truth, rng, approach=moves)
    told = changed(observations, pointings=replace(observations.groups[0].pointings, approach=moves))
    (finding,) = judged(told).faults
    assert finding.kind == "backlash"
    assert abs(finding.evidence["play_1_rad"] - 4e-3) < 4 * finding.evidence["sigma_play_1_rad"]
    # Not told, and not in the order of the readings: nothing to name it by.
    assert "backlash" not in judged(observations).kinds


def test_worm_gear_has_its_period(rng):
    """A periodic error is named with its cycles per turn."""
    truth = with_drive_terms(drawn(nominal(), rng), 1, ("worm",), worm_ratio=60.0).with_value({"worm_sin_2": 2e-3})
    (finding,) = judged(seen(truth, rng)).faults
    assert finding.kind == "worm_gear"
    assert "axis 2" in finding.text
    assert abs(finding.evidence["cycles_per_turn_or_m"] - 60.0) < 1


def test_sag(rng):
    """Bending that follows the elevation is reported where the range of angles lets it be."""
    truth = with_drive_terms(drawn(nominal(), rng), 1, ("sag",), sag_zero_rad=0.0).with_value({"sag_2": 30e-3})
    findings = judged(seen(truth, rng)).findings
    assert findings
    assert findings[0].kind in ("sag", "scale")


def test_small_time_offset(healthy):
    """A clock that is 90 s off is found with its sigma."""
    _, observations = healthy
    late = sun_directions(observations.time + np.timedelta64(90, "s"), SITE)
    (finding,) = judged(changed(observations, sun=late)).faults
    assert finding.kind == "time_offset"
    assert abs(finding.evidence["offset_s"] + 90) < 4 * finding.evidence["sigma_offset_s"] + 1


def test_time_zone(healthy):
    """Local time two hours ahead is found as such."""
    _, observations = healthy
    wrong = sun_directions(observations.time + np.timedelta64(2, "h"), SITE)
    up = wrong[:, 2] > 0.05
    observations = changed(observations, sun=np.where(up[:, None], wrong, observations.sun)).select(up)
    (finding,) = judged(observations).faults
    assert finding.kind == "time_offset"
    assert finding.evidence["offset_s"] == pytest.approx(-7200, abs=60)


def test_south_counted_azimuth(healthy):
    """An azimuth that is 0 in the south is named."""
    _, observations = healthy
    azimuth, elevation = sun_angles(observations.time, SITE)
    (finding,) = judged(changed(observations, sun=direction_from_angles(np.pi - azimuth, elevation))).faults
    assert finding.kind == "sun_convention"
    assert "south, positive to the east" in finding.text


@pytest.mark.slow
@pytest.mark.parametrize("axis", [0, 1])
def test_inverted_axis(healthy, axis):
    """An axis that runs the other way is named by its number."""
    _, observations = healthy
    readings = observations.readings * np.where(np.arange(2) == axis, -1.0, 1.0)
    pointings = replace(observations.groups[0].pointings, readings=readings)
    (finding,) = judged(changed(observations, pointings=pointings)).faults
    assert finding.kind == "inverted_axis"
    assert finding.evidence["axis_number"] == axis + 1


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_azimuths_of_the_mirror_from_the_south(healthy, sign):
    """No mirror that shows its back to the sun is believed instead."""
    _, observations = healthy
    readings = np.stack([sign * (observations.readings[:, 0] - np.pi), observations.readings[:, 1]], axis=1)
    pointings = replace(observations.groups[0].pointings, readings=readings)
    (finding,) = judged(changed(observations, pointings=pointings)).faults
    assert finding.kind == "half_turn"
    assert finding.evidence["axis_number"] == 1
    assert ("other way" in finding.text) == (sign < 0)


@pytest.mark.parametrize(("axis", "severity"), [((0,), "doubt"), ((0, 1), "hint")])
def test_spots_all_at_one_place(rng, axis, severity):
    """A coordinate that never changes is reported, and is no scale of the target."""
    truth = drawn(nominal(), rng)
    times = times_of(72)
    suns = sun_directions(times, SITE)
    aims = TARGETS["upper"].points(np.where(np.isin([0, 1], axis), 0.3, rng.normal(0, 0.4, (72, 2))))
    xy = TARGETS["upper"].coordinates(aims)
    readings = aim(truth, truth.parameters.values, suns, aims).readings
    observations = beams(readings, suns, np.repeat("upper", 72), xy, times)
    (finding,) = judged(observations).findings
    assert (finding.kind, finding.severity) == ("constant_column", severity)
    assert "x = 0.300 m" in finding.text


@pytest.mark.parametrize(("signs", "text"), [([-1.0, 1.0], "to the left"), ([1.0, -1.0], "downwards")])
def test_mirrored_spots_near_the_middle(healthy, signs, text):
    """Spots so near the middle that the fit is not far off are mirrored, not stretched by 200 %; it is undone."""
    _, observations = healthy
    names = np.array(observations.groups[0].target)
    spots = observations.groups[0].spot_m.copy()
    for name, target in TARGETS.items():
        spots[names == name] = target.points(target.coordinates(spots[names == name]) * signs)
    diagnosis = judged(changed(observations, spot_m=spots))
    assert diagnosis.kinds == ("mirrored_spots",)
    assert text in diagnosis.faults[0].text
    undone = np.concatenate([group.spot_m for group in diagnosis.remedied.observations.groups])
    np.testing.assert_allclose(undone, observations.groups[0].spot_m, atol=1e-12)


@pytest.mark.parametrize(("share", "severity"), [(0.03, "fault"), (0.006, "hint")])
def test_scale_of_spots(rng, share, severity):
    """A scale that is off by less than a percent, as the corners of photos are, accuses nobody."""
    truth = drawn(nominal(), rng)
    group = seen(truth, rng, sigma_m=5e-4).groups[0]
    group = group.select(np.array(group.target) == "upper")
    spots = TARGETS["upper"].points(TARGETS["upper"].coordinates(group.spot_m) * (1 - share))
    group = replace(group, spot_m=spots, covariance_m2=group.covariance_m2 * (5e-4 / SIGMA_M) ** 2)
    (finding,) = judged(Observations((group,))).findings
    assert (finding.kind, finding.severity) == ("target_scale", severity)


def test_an_outlier_is_called_as_in_the_table(healthy):
    """By its line, not by a number that counts from 0."""
    _, observations = healthy
    spots = observations.groups[0].spot_m.copy()
    spots[5] += [1.0, 0.0, 0.0]
    ids = tuple(f"line {row + 2}" for row in range(72))
    records = Records(("",) * 72, ("",) * 72, observations.time, ids)
    (finding,) = judged(changed(observations, spot_m=spots), records=records).findings
    assert "the worst is line 7, 2025" in finding.text


def test_swapped_axes(healthy):
    """Exchanged columns are named."""
    _, observations = healthy
    pointings = replace(observations.groups[0].pointings, readings=observations.readings[:, ::-1])
    assert judged(changed(observations, pointings=pointings)).kinds == ("swapped_axes",)


def test_wrong_target_says_which(healthy, rng):
    """Rows that name another target are reported with the target that they fit."""
    _, observations = healthy
    group = observations.groups[0]
    wrong = np.sort(rng.choice(72, 12, replace=False))
    names, spots = list(group.target), group.spot_m.copy()
    for row in wrong:
        was, names[row] = names[row], "lower" if names[row] == "upper" else "upper"
        spots[row] = TARGETS[names[row]].points(TARGETS[was].coordinates(spots[row : row + 1]))[0]
    (finding,) = judged(changed(observations, spot_m=spots, target=tuple(names))).faults
    assert finding.kind == "wrong_target"
    assert finding.rows == tuple(wrong.tolist())
    assert "that name target upper fit target lower" in finding.text


def test_misplaced_target(healthy):
    """A target that stands elsewhere is named with its offset."""
    _, observations = healthy
    group = observations.groups[0]
    moved = np.array([name == "upper" for name in group.target])
    spots = group.spot_m - np.outer(moved, 0.3 * TARGETS["upper"].right)
    (finding,) = judged(changed(observations, spot_m=spots)).faults
    assert finding.kind == "target_place"


def test_outliers_come_with_date_and_photo(healthy, rng):
    """Single wrong rows are rows, not faults; with their date and photo."""
    _, observations = healthy
    spots = observations.groups[0].spot_m.copy()
    spots[7] += [0.8, 0.0, 0.5]
    photos = tuple(f"beam_{row}.png" for row in range(72))
    records = Records(("",) * 72, photos, observations.time)
    diagnosis = judged(changed(observations, spot_m=spots), records=records)
    assert diagnosis.faults == ()
    (finding,) = [one for one in diagnosis.findings if one.kind == "outliers"]
    assert finding.severity == "rows"
    assert finding.rows == (7,)
    assert finding.images == ("beam_7.png",)
    assert finding.dates == (str(observations.time[7].astype("datetime64[D]")),)


def test_wrong_place(rng):
    """A heliostat that stands 2 m from its place in the table."""
    moved = nominal().with_value({"position_e": POSITION[0] + 1.6, "position_n": POSITION[1] - 1.2})
    assert judged(seen(drawn(nominal(), rng), rng), design=moved).kinds == ("position",)


@pytest.mark.slow
def test_wrong_actuator():
    """Numbers of another actuator, at which readings cannot be, are named; the readings too."""
    rng = np.random.default_rng(1)
    truth = linear_actuators("L", POSITION, ACTUATORS)
    observations = seen(truth, rng)
    wrong = truth.with_value({"initial_stroke_1": 0.0757 - 0.03, "pivot_radius_1": 0.3}).with_free("4")
    assert judged(observations, design=wrong).kinds == ("actuator_numbers",)
    assert judged(observations, design=truth.with_free("4")).kinds == ()


def test_too_few():
    """Two beams give the prior's answer, marked as such; no accusation."""
    rng = np.random.default_rng(2)
    diagnosis = judged(seen(drawn(nominal(), rng), rng).select(np.arange(72) < 2))
    assert diagnosis.faults == ()
    assert [one.kind for one in diagnosis.findings] == ["too_few"]
    assert "known beforehand" in diagnosis.findings[0].text


def test_repeats_and_constant_columns(healthy):
    """Rows that are there twice, in the fit or refused before it, and a reading that never changes."""
    _, observations = healthy
    twice = Observations((observations.groups[0], observations.select(np.arange(72) < 3).groups[0]))
    assert "duplicates" in judged(twice).kinds
    flags = ("duplicate",) * 2 + ("",) * 72
    refused = Records(flags, ("",) * 74, np.full(74, np.datetime64("2025-01-10", "ms")))
    (finding,) = judged(observations, records=refused).faults
    assert (finding.kind, finding.rows) == ("duplicates", (0, 1))
    stuck = observations.readings.copy()
    stuck[:, 1] = stuck[0, 1]
    pointings = replace(observations.groups[0].pointings, readings=stuck)
    assert judged(changed(observations, pointings=pointings)).kinds == ("constant_column",)


@pytest.mark.slow
def test_nothing_known_explains_it(healthy, rng):
    """Readings in no order at all: a fault without a name rather than a wrong one."""
    _, observations = healthy
    pointings = replace(observations.groups[0].pointings, readings=rng.permutation(observations.readings))
    assert judged(changed(observations, pointings=pointings)).kinds == ("unexplained",)


# --- parts ------------------------------------------------------------------------------------------------------------


def test_score_is_chi_square():
    """The statistic of a term that is not there has the mean of its chi-square."""
    statistics = []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        found = fit(nominal(), seen(drawn(nominal(), rng), rng, count=48), FitOptions(loss="squares", sigma="stated"))
        terms = Terms(found, found.residuals.computable)
        model = linear_fit(found)
        noise = rng.normal(size=(6, 96, 2))
        values, freedom = model.scores(noise)
        assert (freedom == 2).all()
        statistics += values.tolist()
        assert terms.owner.size == 96
    assert np.mean(statistics) == pytest.approx(2.0, abs=3 * 2 / np.sqrt(144))


def test_change_dates_need_rows_on_both_sides():
    """A change is not looked for where fewer than four rows stand on a side."""
    times = np.array(["2025-01-01"] * 3 + ["2025-02-01"] * 3 + ["2025-03-01"] * 4, dtype="datetime64[ms]")
    assert change_dates(times).astype(str).tolist() == ["2025-03-01"]


def test_findings_are_plain_data(healthy):
    """What is written has every key and no number that JSON lacks."""
    truth, observations = healthy
    content = judged(observations).content()
    assert content["checks"]
    assert content["findings"] == []
    later = truth.with_value({"elevation_offset": truth.parameters.value("elevation_offset") + 5e-3})
    (finding,) = judged(seen(truth, np.random.default_rng(3), later=later)).content()["findings"]
    assert finding["remedy"] == REMEDIES["change_point"]
    assert all(np.isfinite(value) for value in finding["evidence"].values())


def test_significance_is_a_probability(healthy):
    """Any other number is refused."""
    with pytest.raises(InputError, match="significance"):
        judged(healthy[1], significance=2.0)
