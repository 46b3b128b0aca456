"""What a field knows: algebra against dense matrices, truth against simulation, one foreign unit, groups."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.stats import kstest, multivariate_normal, norm

from calibration.heliostat.fitting.drift_noise import LinearRows, NoiseShape, Occasions, row_days
from calibration.heliostat.fitting.field_fit import field_names, fit_with_field, fit_within, linear_rows
from calibration.heliostat.fitting.field_model import FieldUnit, learn_field, learn_model
from calibration.heliostat.fitting.field_prior import FieldPrior, settle
from calibration.heliostat.fitting.prediction import covariance_of_misses, predict_aim
from calibration.heliostat.fitting.priors import PRIORS, with_priors
from calibration.heliostat.fitting.robust_fit import fit
from calibration.heliostat.fitting.splits import Misses, Split, held_out
from calibration.heliostat.fitting.unit_noise import unit_noise
from calibration.heliostat.kinematic_model.aiming import aim
from calibration.heliostat.kinematic_model.kinematics import mirror_poses
from calibration.heliostat.kinematic_model.presets import azimuth_elevation
from calibration.heliostat.observations.observations import BeamSpots, Observations, Pointings
from calibration.heliostat.observations.residuals import evaluate
from heliogauge.geometry.rays import intersect_plane, reflect
from tests.calibration.heliostat_days import TARGET, sun_arc

SIGMA_M = 0.02
NOISE = NoiseShape(1.3, 2e-4, 4e-4, 60.0, 3e-4, 0.3)
WHITE = NoiseShape(1.0, 0.0, 0.0, 90.0, 0.0, 0.2)
#: What posts of the simulated field have in common, and by how much they differ.
MEAN = {"tilt_north": 4e-3, "tilt_east": -2e-3, "position_u": -1.2, "azimuth_offset": 0.02, "non_orthogonality": 1e-3}
SCATTER = {
    "tilt_north": 1e-3,
    "tilt_east": 1e-3,
    "position_e": 0.05,
    "position_n": 0.05,
    "position_u": 0.1,
    "azimuth_offset": 0.03,
    "elevation_offset": 5e-3,
    "non_orthogonality": 5e-4,
}


def post(name):
    return with_priors(azimuth_elevation(name, [10.0, 60.0, 1.5]))


def wandering_zeros(days, rng):
    """Draw what the zeros of both drives do: a first-order process in time, and a shift for each day."""
    order = np.argsort(days, kind="stable")
    zeros, state, before = np.zeros((days.size, 2)), rng.normal(0, NOISE.wander_rad, 2), days[order[0]]
    daily = {day: rng.normal(0, NOISE.day_rad, 2) for day in np.unique(np.floor(days))}
    for row in order:
        kept = np.exp(-(days[row] - before) / NOISE.memory_days)
        state = kept * state + np.sqrt(1 - kept**2) * rng.normal(0, NOISE.wander_rad, 2)
        before, zeros[row] = days[row], state + daily[np.floor(days[row])]
    return zeros


def drawn_misfit(rng, waves=300):
    """Draw what the kinematics lack, an angle of both drives by the normal of the mirror (n, 3) to (n, 2).

    Waves with random directions and lengths (Rahimi and Recht 2007): those of Matern's covariance of order 3/2 are
    distributed as Student's t with 3 degrees of freedom.
    """
    lengths = np.sqrt(rng.chisquare(3, (2, waves)) / 3)
    directions = rng.normal(size=(2, waves, 3)) / lengths[:, :, None] / NOISE.reach_rad
    phases = rng.uniform(0, 2 * np.pi, (2, waves))
    size = NOISE.misfit_rad * np.sqrt(2 / waves)
    return lambda normals: size * np.cos(np.einsum("ni,awi->naw", normals, directions) + phases).sum(axis=2)


def drawn(rng, name, *, rows=36, hours=8.0, changes=None, misfit=None):
    """Draw a heliostat of the field and its observations on a dozen days of a year, three or more a day."""
    misfit = misfit or drawn_misfit(rng)
    design = post(name)
    offsets = {one: MEAN.get(one, 0.0) + rng.normal(0, sigma) for one, sigma in SCATTER.items()} | (changes or {})
    values = {one: design.parameters.value(one) + offset for one, offset in offsets.items()}
    truth = design.with_value(values).parameters.values
    dates = np.sort(rng.choice(365, 12, replace=False))
    each = rows // 12
    suns, days = [], []
    for date in dates:
        arc = sun_arc(9 * each, declination=-0.4 * np.cos(2 * np.pi * date / 365), hours=hours)
        suns.append(arc[rng.choice(len(arc), each, replace=False)])
        days.append(date + 0.3 + 0.4 * np.arange(each) / each)
    sun, day = np.concatenate(suns), np.concatenate(days)
    readings = aim(design, design.parameters.values, sun, TARGET.center_m).readings
    lacking = misfit(mirror_poses(design, truth, readings).normals(design))
    poses = mirror_poses(design, truth, readings + wandering_zeros(day, rng) + lacking)
    rays = reflect(-sun, poses.normals(design))
    along = intersect_plane(poses.centre_m, rays, TARGET.center_m, TARGET.normal)
    xy = TARGET.coordinates(poses.centre_m + along[:, None] * rays)
    xy = xy + rng.normal(0, NOISE.white * SIGMA_M, xy.shape)
    time = np.datetime64("2026-01-01T00:00", "ms") + (day * 86_400_000).astype("timedelta64[ms]")
    pointings = Pointings(readings, row=np.arange(len(sun)), time=time)
    spots = BeamSpots.on_targets(pointings, sun, {TARGET.name: TARGET}, (TARGET.name,) * len(sun), xy, SIGMA_M)
    return design, truth, Observations((spots,))


def unit(name, design, seen, groups=None):
    return FieldUnit(name, linear_rows(fit(design, seen), field_names(design)), groups or {})


def scales_of(design):
    return {name: PRIORS[name].of(design.parameters.value(name)) for name in field_names(design)}


def dense_rows(rng, count=40, p=3):
    days = np.sort(rng.uniform(0, 60, count // 2)).repeat(2)
    normals = rng.normal([0.0, 0.0, 1.0], 0.1, (count // 2, 3)).repeat(2, axis=0)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return LinearRows(
        ("a", "b", "c")[:p],
        rng.normal(size=count),
        rng.normal(size=(count, p)),
        rng.normal(size=(count, 2)) * 1e3,
        Occasions(days, normals),
        rng.uniform(0.2, 1.0, count),
    )


def dense_covariance(rows, noise):
    """The noise's covariance with every row written out."""
    days, normals = rows.occasions.days, rows.occasions.normals
    apart, same = np.abs(days[:, None] - days), np.floor(days)[:, None] == np.floor(days)
    turned = np.sqrt(3) * np.linalg.norm(normals[:, None] - normals, axis=2) / noise.reach_rad
    kernel = noise.wander_rad**2 * np.exp(-apart / noise.memory_days) + noise.day_rad**2 * same
    kernel = kernel + noise.misfit_rad**2 * (1 + turned) * np.exp(-turned)
    return np.diag(noise.white**2 / rows.weight) + kernel * (rows.drives @ rows.drives.T)


@pytest.mark.parametrize(
    "noise", [NOISE, replace(WHITE, white=0.7), replace(WHITE, day_rad=1e-3), replace(WHITE, misfit_rad=1e-3)]
)
def test_normal_equations_are_those_of_the_whole_covariance(noise):
    rows = dense_rows(np.random.default_rng(0))
    inverse = np.linalg.inv(dense_covariance(rows, noise))
    found = rows.equations(noise)
    np.testing.assert_allclose(found.matrix, rows.jacobian.T @ inverse @ rows.jacobian, rtol=1e-6)
    np.testing.assert_allclose(found.rhs, -rows.jacobian.T @ inverse @ rows.residuals, rtol=1e-5, atol=1e-9)
    assert found.square == pytest.approx(rows.residuals @ inverse @ rows.residuals, rel=1e-6)
    assert found.log_determinant == pytest.approx(-np.linalg.slogdet(inverse)[1], rel=1e-6)


def test_what_estimates_share_with_the_drives_is_that_of_the_whole_covariance():
    rows = dense_rows(np.random.default_rng(1))
    solved = rows.solved(NOISE)
    inverse = np.linalg.inv(dense_covariance(rows, NOISE))
    one = solved.occasions.select(np.array([3]))
    kernel = NOISE.covariance(one, rows.occasions)[0]
    for drive in (0, 1):
        wanted = (kernel * rows.drives[:, drive]) @ inverse @ rows.jacobian
        found = NOISE.covariance(one, solved.occasions)[0] @ solved.link[drive]
        np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-12)


def test_evidence_is_the_density_of_the_observations():
    rng = np.random.default_rng(2)
    rows = dense_rows(rng)
    mean, root = rng.normal(size=3), rng.normal(size=(3, 3))
    covariance = root @ root.T
    found = unit_noise(rows.equations(NOISE), mean, covariance)
    # The noise's own prior: one sigma is a factor of e^0.5.
    logs = np.linspace(-1.5, 2.5, 201)
    densities = []
    for log in logs.tolist():
        whole = np.exp(2 * log) * dense_covariance(rows, NOISE) + rows.jacobian @ covariance @ rows.jacobian.T
        density = multivariate_normal(-rows.jacobian @ mean, whole).logpdf(rows.residuals)
        densities.append(np.exp(density + 0.5 * rows.residuals.size * np.log(2 * np.pi)) * norm.pdf(log, 0, 0.5))
    assert found.log_evidence == pytest.approx(np.log(trapezoid(densities, logs)), abs=1e-4)
    square = trapezoid(np.exp(2 * logs) * densities, logs) / trapezoid(densities, logs)
    assert found.factor == pytest.approx(np.sqrt(square), rel=1e-4)


def linear_field(rng, count=60, p=4, rows=24):
    """Draw heliostats that are linear, without drift: truth (count, p), units."""
    mean, scatter = np.array([2.0, -1.0, 0.5, 0.0]), np.array([0.5, 1.5, 0.05, 1.0])
    truth = mean + scatter * rng.normal(size=(count, p))
    units = []
    for index, offsets in enumerate(truth):
        jacobian = rng.normal(size=(rows, p)) * 2.0
        residuals = -jacobian @ offsets + rng.normal(size=rows)
        when = Occasions(np.arange(rows) * 1e4, np.tile([0.0, 0.0, 1.0], (rows, 1)))
        own = LinearRows(tuple("abcd"), residuals, jacobian, np.zeros((rows, 2)), when, np.ones(rows))
        units.append(FieldUnit(f"h{index}", own, {}))
    return mean, scatter, truth, units


def test_mean_and_scatter_come_back():
    _, scatter, truth, units = linear_field(np.random.default_rng(3))
    found = learn_model(units, np.full(4, 5.0), WHITE)
    sigma = np.sqrt(np.diag(found.mean_covariance))
    assert (np.abs(found.mean - truth.mean(axis=0)) < 4 * sigma).all()
    # 60 heliostats know a scatter to 9 %; Student's t takes the middle of normal numbers for 0.85 of their sigma.
    np.testing.assert_allclose(found.scatter[[0, 1, 3]], scatter[[0, 1, 3]], rtol=0.4)
    assert found.scatter[2] < 0.15
    assert found.helps


@pytest.mark.slow
def test_one_post_askew_moves_nothing_and_keeps_its_other_numbers():
    _, _, _, units = linear_field(np.random.default_rng(4), count=12)
    scales, noise = np.full(4, 5.0), WHITE
    before = learn_model(units, scales, noise)
    askew = units[5].rows
    moved = replace(askew, residuals=askew.residuals - 40.0 * askew.jacobian[:, 0])
    after = learn_model([*units[:5], replace(units[5], rows=moved), *units[6:]], scales, noise)
    assert (np.abs(after.mean - before.mean) < 0.6).all()
    assert after.weights[5, 0] < 0.1
    assert after.weights[5, 2] > 0.7
    # Of the others alone each learns what it learned before, and of itself what its own rows say.
    settled = settle(moved.equations(noise), after.prior("h5"))
    assert np.sqrt(settled.covariance[0, 0]) > 5 * after.scatter[0]
    assert np.sqrt(settled.covariance[2, 2]) < 2 * np.sqrt(after.prior("h5").covariance[2, 2])


@pytest.mark.slow
def test_groups_are_told_apart_where_they_predict_each_other_better():
    _, _, _, units = linear_field(np.random.default_rng(5), count=24)
    scales = dict.fromkeys("abcd", 5.0)
    alike = [replace(one, groups={"row": "AB"[index % 2]}) for index, one in enumerate(units)]
    assert learn_field(alike, scales).grouping == ""
    apart = [
        replace(one, rows=replace(one.rows, residuals=one.rows.residuals - (index % 2) * 8 * one.rows.jacobian[:, 2]))
        for index, one in enumerate(alike)
    ]
    field = learn_field(apart, scales)
    assert field.grouping == "row"
    first, second = (field.model(tuple("abcd"), {"row": row}) for row in "AB")
    assert second.mean[2] - first.mean[2] == pytest.approx(8.0, abs=0.5)


def test_a_survey_that_knows_more_than_the_field_is_believed():
    rng = np.random.default_rng(6)
    design, _, seen = drawn(rng, "h")
    surveyed = design.with_parameters(design.parameters.with_sigmas({"position_u": 1e-3}))
    names = field_names(design)
    mean = np.array([MEAN.get(name, 0.0) for name in names])
    scatter = np.array([SCATTER[name] for name in names])
    prior = FieldPrior(names, mean, scatter, scatter**2, np.zeros((8, 8)), NOISE, 9)
    found = fit_with_field(fit(surveyed, seen), prior)
    nominal = design.parameters.value("position_u")
    assert found.design.parameters.value("position_u") == pytest.approx(nominal, abs=0.02)
    free = fit_with_field(fit(design, seen), prior)
    assert free.design.parameters.value("position_u") == pytest.approx(nominal - 1.2, abs=0.4)


def test_rows_without_a_time_lie_between_their_neighbours_or_on_their_own():
    _, _, seen = drawn(np.random.default_rng(7), "h")
    days = row_days(seen)
    group = seen.groups[0]
    time = group.pointings.time.copy()
    time[5] = np.datetime64("NaT")
    pointings = replace(group.pointings, time=time)
    some = row_days(Observations((replace(group, pointings=pointings),)))
    assert some[5] == pytest.approx((days[4] + days[6]) / 2)
    pointings = replace(group.pointings, time=np.full(time.size, np.datetime64("NaT"), dtype=time.dtype))
    assert np.diff(row_days(Observations((replace(group, pointings=pointings),)))).min() > 1e4


@pytest.mark.slow
def test_errors_are_what_the_field_predicts_in_ten_fields():
    """One that was seen twelve times in the morning: its numbers and its evening, whitened jointly."""
    numbers, rows, together, chances, apart, aims, gains = [], [], [], [], [], [], []
    elsewhere = sun_arc(5, declination=0.1, hours=6.0)
    for seed in range(10):
        rng = np.random.default_rng(100 + seed)
        units = [unit(f"h{index}", *drawn(rng, f"h{index}")[::2]) for index in range(20)]
        field = learn_field(units, scales_of(post("h")))
        model = field.model(units[0].rows.names, {})
        assert model is not None
        for index in range(4):
            misfit = drawn_misfit(rng)
            design, truth, seen = drawn(rng, f"new{index}", rows=48, misfit=misfit)
            east = seen.sun[:, 0] > 0
            within = partial(fit_with_field, prior=model.prior("new"))
            held = held_out(design, seen, Split("column", east, ~east, ""), refine=within)
            found, prediction = held.fit, held.prediction
            place = design.parameters.indices(found.solution.names)
            error = (found.values - truth)[place]
            numbers.append(error @ np.linalg.solve(found.solution.covariance, error) / error.size)
            later = seen.select(~east)
            missed = evaluate(found.design, found.values, later).beam_rad
            noise = np.eye(2) * 0.5 * prediction.sigma_noise_rad[:, None, None] ** 2
            whole = prediction.covariance_rad2 + noise
            rows.append(np.einsum("ni,nij,nj->n", missed, np.linalg.inv(whole), missed) / 2)
            every = covariance_of_misses(found, later, prediction)
            index = np.arange(len(later))
            np.testing.assert_array_equal(every[index, :, index], prediction.covariance_rad2)
            every[index, :, index] += noise
            every = every.reshape(missed.size, missed.size)
            together.append(missed.ravel() @ np.linalg.solve(every, missed.ravel()) / missed.size)
            misses = Misses.of(held, seen)
            assert misses is not None
            chances.append(misses.chance)
            apart.append(replace(misses, freedom=float(missed.size)).chance)
            # On a day of which nothing is known: the truth, its drives' zeros drawn anew.
            aimed = predict_aim(found, elsewhere, TARGET.center_m)
            zeros = rng.normal(0, np.hypot(NOISE.day_rad, NOISE.wander_rad), (5, 2))
            lacking = misfit(mirror_poses(design, truth, aimed.readings).normals(design))
            poses = mirror_poses(design, truth, aimed.readings + zeros + lacking)
            beams = reflect(-elsewhere, poses.normals(design))
            wanted = TARGET.center_m - poses.centre_m
            wanted /= np.linalg.norm(wanted, axis=1)[:, None]
            aims.append(np.sum((beams - wanted) ** 2, axis=1) / aimed.sigma_beam_rad**2)
            alone = fit(design, seen.select(east))
            plain = evaluate(alone.design, alone.values, later).beam_angle_rad
            gains.append(np.sqrt(np.mean(missed**2) * 2 / np.mean(plain**2)))
    # Student's t takes normal numbers for 0.85 of their sigma and says 5/3 of the variance that follows: 0.83 is
    # expected, less for the scatter that few heliostats leave open. Taking its most probable value, which may be 0,
    # the mean of these 40 sums over 8 numbers was 1.5.
    assert 0.45 < np.median(numbers) < 1.1
    assert 0.5 < np.mean(numbers) < 1.1
    # What is asked for is the beam: 40 evenings in ten fields, known to 15 %.
    assert np.mean(np.concatenate(rows)) == pytest.approx(1.0, abs=0.3)
    assert 0.9 < np.mean(2 * np.concatenate(rows) < 5.99) < 0.98
    # All rows of an evening at once, to 3 %; and how far its RMS may be from what was expected.
    assert np.mean(together) == pytest.approx(1.0, abs=0.15)
    assert kstest(chances, "uniform").pvalue > 0.01
    # Rows taken for independent would let every other evening contradict what was expected.
    assert kstest(apart, "uniform").pvalue < 1e-3
    assert np.mean(np.concatenate(aims)) == pytest.approx(1.0, abs=0.35)
    assert np.median(gains) < 0.85


def test_one_that_is_alone_gets_its_noise_from_its_own_rows():
    rng = np.random.default_rng(8)
    design, truth, seen = drawn(rng, "h", rows=72)
    within = fit_within(fit(design, seen), None)
    assert not within.by_field
    noise = within.fit.drift.noise
    assert 0.8 < noise.white / NOISE.white < 1.25
    assert 0.4 < np.sqrt(noise.drive_variance_rad2 / NOISE.drive_variance_rad2) < 2.5
    error = within.fit.values - truth
    assert (np.abs(error) < 4 * within.fit.sigma + 1e-12).all()
