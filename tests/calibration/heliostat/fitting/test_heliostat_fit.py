"""The fit: truth recovered within its sigma, outliers named, what is not observable said."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.heliostat.fitting.fit_model import FitModel, descend
from calibration.heliostat.fitting.fit_result import FitOptions
from calibration.heliostat.fitting.robust_fit import fit
from calibration.heliostat.kinematic_model.design import POSITION
from calibration.heliostat.kinematic_model.kinematics import mirror_poses
from calibration.heliostat.kinematic_model.presets import azimuth_elevation
from calibration.heliostat.observations.observations import BeamSpots, MirrorNormals, Observations, Pointings
from heliogauge.errors import EstimationError, InputError
from tests.calibration.heliostat.observations.test_heliostat_residuals import designs
from tests.calibration.heliostat_days import beams, sun_arc, year

ANGLES = ("tilt_north", "tilt_east", "azimuth_offset", "elevation_offset", "non_orthogonality")
PRIORS = dict.fromkeys(ANGLES, 5e-3) | dict.fromkeys(POSITION, 0.05)


def heliostat(free="5"):
    return azimuth_elevation("h", [10.0, 60.0, 1.5]).with_free(free)


def truth_of(design, rng, sigmas):
    values = design.parameters.values.copy()
    for name, sigma in sigmas.items():
        values[design.parameters.index(name)] += rng.normal(0, sigma)
    return values


def honesty(design, *, trials, options, spread, noise_m=0.02, stated_m=0.02, outliers=0, count=30):
    """Return the mean of e' C^-1 e per parameter, and of the squared error of each over its variance."""
    rng = np.random.default_rng(7)
    sun = year(count)
    squares, singles = [], []
    for _ in range(trials):
        truth = truth_of(design, rng, spread)
        seen = beams(design, truth, sun, stated_m, rng, noise_m=noise_m)
        if outliers:
            spot = seen.spot_m.copy()
            spot[:outliers] += rng.normal(0, 2.0, (outliers, 3)) * [1, 0, 1]
            seen = replace(seen, spot_m=spot)
        found = fit(design, Observations((seen,)), options)
        free = design.parameters.free
        error = (found.values - truth)[free]
        covariance = found.covariance[np.ix_(free, free)]
        squares.append(error @ np.linalg.solve(covariance, error) / error.size)
        singles.append(error**2 / np.diag(covariance))
    return np.mean(squares), np.mean(singles, axis=0)


def test_without_noise_the_truth_comes_back_to_rounding():
    rng = np.random.default_rng(0)
    design = heliostat()
    truth = truth_of(design, rng, dict.fromkeys(ANGLES, 20e-3))
    found = fit(design, Observations((beams(design, truth, sun_arc(12), 0.02, rng, noise_m=0.0),)))
    np.testing.assert_allclose(found.values, truth, atol=1e-12)
    assert found.converged
    assert found.basins == 1
    assert found.rank == found.n_free == 5
    assert not found.rejected.any()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("free", "priors", "options", "noise"),
    [
        ("5", {}, FitOptions(loss="squares", sigma="stated"), 0.02),
        ("5", {}, FitOptions(), 0.02),
        ("5", {}, FitOptions(), 0.07),
        ("8", PRIORS, FitOptions(), 0.02),
    ],
)
def test_errors_are_as_large_as_the_sigmas_say(free, priors, options, noise):
    design = heliostat(free)
    design = design.with_parameters(design.parameters.with_sigmas(priors))
    # 60 x 5 squares: the mean is known to 8 %, the sigma to 4 %.
    mean, _ = honesty(
        design, trials=60, options=options, spread=PRIORS if priors else dict.fromkeys(ANGLES, 5e-3), noise_m=noise
    )
    assert 0.76 < mean < 1.28


@pytest.mark.slow
@pytest.mark.parametrize(
    ("free", "priors", "options", "noise", "outliers"),
    [
        ("5", {}, FitOptions(), 0.02, 0),
        ("5", {}, FitOptions(sigma="estimated"), 0.07, 0),
        ("5", {}, FitOptions(), 0.07, 0),
        ("8", PRIORS, FitOptions(), 0.02, 0),
        ("8", PRIORS, FitOptions(loss="tukey"), 0.02, 0),
        ("5", {}, FitOptions(), 0.02, 3),
    ],
)
def test_scatter_over_sigma_is_one_within_five_percent(free, priors, options, noise, outliers):
    design = heliostat(free)
    design = design.with_parameters(design.parameters.with_sigmas(priors))
    mean, singles = honesty(
        design,
        trials=500,
        options=options,
        spread=PRIORS if priors else dict.fromkeys(ANGLES, 5e-3),
        noise_m=noise,
        outliers=outliers,
        count=60,
    )
    assert 0.95 < np.sqrt(mean) < 1.05
    # Each parameter alone is known to 3.2 % only.
    np.testing.assert_allclose(np.sqrt(singles), 1.0, atol=0.11)


def test_sigma_that_the_residuals_refute_is_estimated_and_said():
    rng = np.random.default_rng(2)
    design = heliostat()
    seen = beams(design, design.parameters.values, year(60), 0.02, rng, noise_m=0.08)
    found = fit(design, Observations((seen,)))
    assert found.sigma_estimated == ("beam",)
    assert found.sigma_factors["beam"] == pytest.approx(4.0, rel=0.15)
    assert "sigma_estimated_from_residuals" in [one.code for one in found.doubts]
    believed = fit(design, Observations((seen,)), FitOptions(sigma="stated"))
    assert believed.sigma_factors["beam"] == 1.0
    assert believed.sigma0["beam"] == pytest.approx(4.0, rel=0.2)
    right = fit(design, Observations((beams(design, design.parameters.values, year(60), 0.02, rng),)))
    assert right.sigma_factors["beam"] == 1.0


def test_outliers_are_named_with_their_row_and_change_nothing():
    rng = np.random.default_rng(3)
    design = heliostat()
    truth = truth_of(design, rng, dict.fromkeys(ANGLES, 5e-3))
    seen = beams(design, truth, year(60), 0.02, rng)
    clean = fit(design, Observations((seen,)))
    spot = seen.spot_m.copy()
    wrong = [4, 17, 18, 33, 50, 51, 58]
    spot[wrong] += [0.0, 0.0, 3.0]
    rows = Pointings(seen.pointings.readings, row=np.arange(60) + 1000)
    found = fit(design, Observations((replace(seen, spot_m=spot, pointings=rows),)))
    assert np.flatnonzero(found.rejected).tolist() == wrong
    assert found.observations.row[found.rejected].tolist() == [row + 1000 for row in wrong]
    assert all("outlier" in found.reason[i] and "mrad of the beam" in found.reason[i] for i in wrong)
    assert all(found.reason[i] == "" for i in range(60) if i not in wrong)
    assert (found.weight[wrong] == 0).all()
    np.testing.assert_allclose(found.values, clean.values, atol=1.2 * clean.sigma.max())
    # The residual of an outlier stays in the table: 3 m at 63 m.
    assert np.abs(found.residuals.beam_rad[4, 1]) == pytest.approx(3 / 63, rel=0.2)


def test_no_good_row_is_rejected_more_often_than_stated():
    rng = np.random.default_rng(4)
    design = heliostat()
    rejected = [
        fit(design, Observations((beams(design, design.parameters.values, year(30), 0.02, rng),))).rejected.any()
        for _ in range(60)
    ]
    # 0.01 each: four or more of 60 happen once in 300.
    assert sum(rejected) < 4


def test_place_along_the_line_of_sight_is_not_observed_and_said():
    rng = np.random.default_rng(5)
    design = azimuth_elevation("h", [19.2, -30.8, 1.2]).with_free("8")
    found = fit(design, Observations((beams(design, design.parameters.values, year(30), 0.01, rng),)))
    assert found.n_free == 8
    assert found.rank == 7
    (lost,) = found.unobservable
    line = np.array([0.0, 0.0, 20.0]) - [19.2, -30.8, 1.2]
    direction = np.array([dict(zip(lost.names, lost.coefficients, strict=True)).get(name, 0.0) for name in POSITION])
    assert abs(direction @ line) / np.linalg.norm(direction) / np.linalg.norm(line) > 0.98
    assert not lost.held_by_prior
    assert any(one.code == "parameters_not_observed" and "position" in one.text for one in found.doubts)
    prior = design.with_parameters(design.parameters.with_sigmas(dict.fromkeys(POSITION, 0.3)))
    held = fit(prior, Observations((beams(design, design.parameters.values, year(30), 0.01, rng),)))
    assert all(one.held_by_prior for one in held.unobservable)
    assert held.rank < 8


def test_many_beams_do_not_push_the_heliostat_away_from_its_target():
    """Weights of angles frozen at the start would be rewarded for distance: chi-square falls as it grows."""
    rng = np.random.default_rng(11)
    design = azimuth_elevation("h", [19.2, -30.8, 1.2]).with_free("8")
    design = design.with_parameters(design.parameters.with_sigmas(dict.fromkeys(POSITION, 0.6)))
    truth = design.with_value({"position_e": 19.8, "position_n": -31.4, "tilt_north": 4e-3})
    found = fit(design, Observations((beams(design, truth.parameters.values, year(501), 0.0076, rng),)))
    assert not found.sigma_estimated
    free = [found.names.index(name) for name in POSITION]
    pulls = (found.values - truth.parameters.values)[free] / found.sigma[free]
    assert np.abs(pulls).max() < 3
    assert found.sigma0["beam"] == pytest.approx(1.0, abs=0.06)


def test_random_starts_end_in_one_basin():
    rng = np.random.default_rng(6)
    design = heliostat("8")
    design = design.with_parameters(design.parameters.with_sigmas(PRIORS))
    truth = truth_of(design, rng, dict.fromkeys(ANGLES, 5e-3))
    seen = Observations((beams(design, truth, year(30), 0.02, rng),))
    first = fit(design, seen)
    model = FitModel(design, seen, FitOptions())
    for _ in range(60):
        start = first.solution.parameters + rng.normal(0, 1, 8) * np.where(
            [name in ANGLES for name in model.names], 0.1, 0.5
        )
        end = descend(model, start, {"beam": 1.0}, np.ones(30, dtype=np.bool_), 1e-6)
        assert np.abs((end.values - first.solution.parameters) / first.solution.sigmas).max() < 0.01


def test_too_few_observations_give_a_marked_answer_from_the_priors():
    rng = np.random.default_rng(8)
    design = heliostat("8")
    design = design.with_parameters(design.parameters.with_sigmas(PRIORS))
    seen = Observations((beams(design, design.parameters.values, sun_arc(1), 0.02, rng),))
    found = fit(design, seen)
    assert found.rank == 2
    nothing = fit(design, seen.select([False]))
    assert "answer_is_of_priors_only" in [one.code for one in nothing.doubts]
    np.testing.assert_allclose(nothing.sigma[design.parameters.free], design.parameters.sigmas[design.parameters.free])
    np.testing.assert_array_equal(nothing.values, design.parameters.values)


def test_kinds_have_factors_of_their_own():
    rng = np.random.default_rng(9)
    design = heliostat()
    seen = beams(design, design.parameters.values, year(60), 0.02, rng, noise_m=0.06)
    normals = mirror_poses(design, design.parameters.values, seen.pointings.readings).normals(design)
    normal = MirrorNormals(seen.pointings, normals + rng.normal(0, 1e-3, normals.shape), 1e-3)
    found = fit(design, Observations((seen, normal)))
    assert found.sigma_factors["beam"] == pytest.approx(3.0, rel=0.2)
    assert found.sigma_factors["normal"] == 1.0
    assert np.isnan(found.residuals.beam_rad[60:]).all()


def test_nothing_free_gives_residuals_only():
    rng = np.random.default_rng(10)
    design = azimuth_elevation("h", [10.0, 60.0, 1.5])
    found = fit(design, Observations((beams(design, design.parameters.values, year(9), 0.02, rng),)))
    assert found.n_free == 0
    assert (found.sigma == 0).all()
    assert np.median(found.residuals.beam_angle_rad) < 1e-3


def test_readings_in_the_wrong_unit_are_refused():
    design = designs()["actuators"].with_free("4")
    sun = sun_arc(4)
    seen = BeamSpots.at_points(Pointings(np.full((4, 2), 1e7)), sun, np.zeros((4, 3)), 0.02, ("t",) * 4)
    with pytest.raises(EstimationError, match="unit of the readings"):
        fit(design, Observations((seen,)))


@pytest.mark.parametrize(
    "options", [{"loss": "cubic"}, {"sigma": "x"}, {"significance": 0.0}, {"restarts": -1}, {"max_iterations": 0}]
)
def test_impossible_options_are_refused(options):
    with pytest.raises(InputError):
        FitOptions(**options)
