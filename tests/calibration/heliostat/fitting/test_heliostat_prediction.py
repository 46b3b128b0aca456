"""Splits, held-out rows, prediction with sigma and warning, choice of parameters."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.heliostat.fitting.field_fit import fit_beside
from calibration.heliostat.fitting.fit_result import FitOptions
from calibration.heliostat.fitting.model_choice import Candidate, choose_model, usual_candidates
from calibration.heliostat.fitting.prediction import (
    predict_aim,
    predict_rows,
    sun_positions_of_year,
    tracking_error,
    yearly_evaluation,
)
from calibration.heliostat.fitting.priors import PARTS, PRIORS, with_bending, with_priors
from calibration.heliostat.fitting.robust_fit import fit
from calibration.heliostat.fitting.splits import SPLIT_NAMES, held_out, make_split
from calibration.heliostat.kinematic_model.aiming import aim
from calibration.heliostat.kinematic_model.presets import azimuth_elevation
from calibration.heliostat.observations.observations import BeamSpots, MirrorNormals, Observations, Pointings
from calibration.heliostat.observations.residuals import evaluate
from heliogauge.errors import InputError
from heliogauge.geometry.sun import Site
from tests.calibration.heliostat.fitting.test_heliostat_fit import ANGLES, heliostat, truth_of
from tests.calibration.heliostat.observations.test_heliostat_residuals import designs
from tests.calibration.heliostat_days import TARGET, beams, sun_arc, year

SITE = Site(34.4, 0.0)


def observed(rng, *, count=60, noise_m=0.02, sun=None, spread=5e-3, design=None):
    design = design or heliostat()
    truth = truth_of(design, rng, dict.fromkeys(ANGLES, spread))
    seen = beams(design, truth, year(count) if sun is None else sun, 0.02, rng, noise_m=noise_m)
    times = np.datetime64("2026-01-01T08:00", "ms") + np.arange(len(seen)) * np.timedelta64(3600_000, "ms")
    pointings = Pointings(seen.pointings.readings, row=np.arange(len(seen)), time=times)
    return design, truth, Observations((replace(seen, pointings=pointings),))


@pytest.mark.parametrize("name", SPLIT_NAMES)
def test_splits_keep_their_parts_apart(name):
    _, _, seen = observed(np.random.default_rng(0), count=90)
    split = make_split(seen, name)
    assert not (split.train & split.test).any()
    assert split.train.sum() >= 30
    assert split.test.sum() >= 22
    again = make_split(seen, name)
    np.testing.assert_array_equal(split.train, again.train)


def test_azimuth_split_trains_on_the_smallest_and_reversed_on_the_largest():
    _, _, seen = observed(np.random.default_rng(0), count=90)
    azimuth = np.mod(np.arctan2(seen.sun[:, 0], seen.sun[:, 1]), 2 * np.pi)
    split = make_split(seen, "azimuth")
    assert split.train.sum() == split.test.sum() == 30
    assert azimuth[split.train].max() < azimuth[split.test].min()
    other = make_split(seen, "azimuth-reversed")
    np.testing.assert_array_equal(other.train, split.test)


def test_chronological_split_is_by_time_and_high_variance_by_neighbours():
    _, _, seen = observed(np.random.default_rng(0), count=60)
    split = make_split(seen, "chronological")
    assert split.train.sum() == 45
    assert seen.time[split.train].max() < seen.time[split.test].min()
    lonely = make_split(seen, "high-variance", count=5)
    angles = np.arccos(np.clip(seen.sun @ seen.sun.T, -1, 1)) + 9 * np.eye(60)
    mean = np.sort(angles, axis=1)[:, :3].mean(axis=1)
    assert mean[lonely.test].min() >= np.delete(mean, np.flatnonzero(lonely.test)).max() - 1e-12


def test_own_split_and_what_cannot_be_split():
    _, _, seen = observed(np.random.default_rng(0), count=6)
    split = make_split(seen, "column", column=["train", "Train", "test", "", "validation", "train"])
    assert split.train.tolist() == [True, True, False, False, False, True]
    assert split.test.tolist() == [False, False, True, False, True, False]
    with pytest.raises(InputError, match="6 entries"):
        make_split(seen, "column")
    with pytest.raises(InputError, match="no such split; there are random"):
        make_split(seen, "solstice")
    with pytest.raises(InputError, match="at least 4"):
        make_split(seen.select([True, True, False, False, False, False]), "random")
    normals = MirrorNormals(Pointings(np.zeros((8, 2))), np.tile([0, 0, 1.0], (8, 1)), 1e-3)
    with pytest.raises(InputError, match="needs its sun"):
        make_split(Observations((normals,)), "azimuth")


def test_held_out_error_is_what_was_predicted_and_extrapolation_is_said_first():
    rng = np.random.default_rng(1)
    squares, expected = [], []
    for _ in range(15):
        design, _, seen = observed(rng, count=60)
        held = held_out(design, seen, make_split(seen, "azimuth", count=12))
        rows = held.residuals.beam_rad[held.split.test[held.split.train | held.split.test]]
        squares.append((rows**2).sum(axis=1))
        p = held.prediction
        expected.append(p.sigma_parameters_rad**2 + p.sigma_misfit_rad**2 + p.sigma_noise_rad**2)
    # 15 fits of 5 parameters: the ratio of sigmas is known to about 8 %.
    assert np.sqrt(np.mean(squares) / np.mean(expected)) == pytest.approx(1.0, abs=0.25)
    assert held.prediction.extrapolated.any()
    assert held.doubts[0].code == "test_positions_beyond_training"
    assert held.train.n == 12
    assert held.test.n == 12
    assert held.test.beam_rms_rad > held.train.beam_rms_rad
    assert held.test.normal_rms_rad == pytest.approx(held.test.beam_rms_rad / 2, rel=0.3)


@pytest.mark.slow
def test_prediction_sigma_is_the_scatter_within_five_percent():
    rng = np.random.default_rng(2)
    sun = sun_arc(15, declination=0.3)
    elsewhere = sun_arc(5, declination=-0.3, hours=5.0)
    design = heliostat()
    aimed = aim(design, design.parameters.values, elsewhere, TARGET.center_m)
    squares, expected, refuted = [], [], []
    for _ in range(400):
        _, truth, seen = observed(rng, sun=sun)
        found = fit(design, seen)
        prediction = predict_aim(found, elsewhere, TARGET.center_m)
        error = tracking_error(
            found.design, design.with_parameters(design.parameters.with_values(truth)), elsewhere, TARGET.center_m
        )
        squares.append((error**2).sum(axis=1))
        expected.append(prediction.sigma_beam_rad**2)
        refuted.append(bool(found.sigma_estimated))
    assert aimed.converged.all()
    # Where the residuals refute the stated sigma, in one draw of a thousand, everything may be wrong, and sigma is five
    # times as large.
    assert sum(refuted) <= 3
    believed = ~np.array(refuted)
    assert np.sqrt(np.mean(np.array(squares)[believed]) / np.mean(np.array(expected)[believed])) == pytest.approx(
        1.0, abs=0.05
    )


def test_leverage_and_distance_tell_where_nothing_was_measured():
    rng = np.random.default_rng(3)
    _, _, seen = observed(rng, sun=sun_arc(20, hours=3.0))
    found = fit(heliostat(), seen)
    near = predict_aim(found, seen.sun, TARGET.center_m)
    far = predict_aim(found, sun_arc(7, declination=-0.4, hours=8.0), TARGET.center_m)
    np.testing.assert_allclose(near.distance_rad, 0.0, atol=1e-7)
    assert not near.extrapolated.any()
    assert far.extrapolated.all()
    assert "degrees from the nearest position" in far.reason[0]
    assert far.sigma_beam_rad.min() > near.sigma_beam_rad.mean()
    assert far.leverage.max() > 1
    np.testing.assert_allclose(near.sigma_normal_rad, near.sigma_beam_rad / 2)
    # The leverage of rows in use adds up to the parameters: 5 over 2 components a row.
    rows = predict_rows(found, seen)
    assert rows.leverage.sum() * 2 == pytest.approx(5, rel=0.12)
    below = predict_aim(found, [[0.0, 0.0, -1.0]], TARGET.center_m)
    assert not below.usable[0] or np.isfinite(below.sigma_beam_rad[0])


def test_misfit_of_a_model_that_is_refuted_enters_the_sigma():
    rng = np.random.default_rng(4)
    design, _, seen = observed(rng, noise_m=0.02)
    good = fit(design, seen)
    assert (predict_aim(good, seen.sun, TARGET.center_m).sigma_misfit_rad == 0).all()
    # The truth bends by 3 mrad with elevation, which the model does not have.
    group = seen.groups[0]
    bent = replace(group, spot_m=group.spot_m + np.outer(0.6 * group.sun[:, 2] ** 2, [0, 0, 1.0]))
    bad = fit(design, Observations((bent,)))
    assert bad.sigma_estimated
    prediction = predict_aim(bad, seen.sun, TARGET.center_m)
    assert (prediction.sigma_misfit_rad > 2e-4).all()
    own = predict_aim(replace(bad, sigma_factors={}), seen.sun, TARGET.center_m)
    assert (prediction.sigma_beam_rad > own.sigma_beam_rad).all()


def test_stated_parameters_are_judged_by_all_that_is_known():
    design, _, on_target = observed(np.random.default_rng(6), noise_m=0.02)
    group = on_target.groups[0]
    seen = Observations((BeamSpots.at_points(group.pointings, group.sun, group.spot_m, 0.02, group.target),))
    found = fit(design.with_free("2"), seen)
    judge = fit_beside(found, None)
    assert judge.n_free > found.n_free
    whole = predict_rows(replace(found, beside=judge), seen)
    apart = evaluate(found.design, found.values, seen).beam_rad - evaluate(judge.design, judge.values, seen).beam_rad
    assert np.abs(apart).max() > 1e-4
    known = predict_rows(judge, seen).covariance_rad2
    np.testing.assert_allclose(whole.covariance_rad2, known + apart[:, :, None] * apart[:, None], rtol=1e-9, atol=1e-18)
    # Aimed at, the beam of the judge is as far from the aim point as the fit's predictions are from the judge's.
    aimed = predict_aim(replace(found, beside=judge), seen.sun, TARGET.center_m)
    away = tracking_error(found.design, judge.design, seen.sun, TARGET.center_m)
    assert (aimed.sigma_beam_rad >= np.linalg.norm(away, axis=1)).all()


def test_tracking_error_is_the_small_angle_of_the_offset():
    design = heliostat()
    truth = design.with_value({"azimuth_offset": 1e-3})
    sun = sun_arc(5)
    error = tracking_error(design, truth, sun, TARGET.center_m)
    # 1 mrad of azimuth turns the normal by cos(elevation) to the right, the beam by about twice that.
    assert (error[:, 0] > 0).all()
    assert np.hypot(*error.T).max() < 2.01e-3
    assert tracking_error(design, design, sun, TARGET.center_m) == pytest.approx(0.0, abs=1e-13)


def test_yearly_evaluation_of_a_perfect_and_of_a_wrong_model():
    design = heliostat()
    suns, month = sun_positions_of_year(SITE, 2018)
    assert suns.shape == (12 * 35, 3)
    assert (suns[:, 2] > 0).all()
    assert np.unique(month).tolist() == list(range(1, 13))
    assert yearly_evaluation(design, design, SITE, TARGET.center_m).mean_rad < 1e-12
    wrong = yearly_evaluation(design, design.with_value({"elevation_offset": 1e-3}), SITE, TARGET.center_m)
    assert 1e-3 < wrong.mean_rad < 2e-3
    assert wrong.daily_mean_rad.shape == (12,)
    assert (wrong.daily_offset_rad <= wrong.daily_mean_rad + 1e-15).all()


def test_priors_name_their_source_and_respect_a_survey():
    assert all(prior.sigma > 0 and len(prior.source) > 20 for prior in PRIORS.values())
    design = designs()["actuators"]
    known = with_priors(design)
    assert known.parameters.sigma("tilt_1_u") == PRIORS["tilt_1_u"].sigma
    assert known.parameters.sigma("sag_1") > 0
    assert all(known.parameters.sigma(name) == 0 for name in PARTS if name in known.parameters.names)
    surveyed = design.with_parameters(design.parameters.with_sigmas({"position_u": 0.02}))
    assert with_priors(surveyed).parameters.sigma("position_u") == 0.02
    assert with_bending(known) is known


def test_choice_finds_the_parameters_that_the_data_need():
    rng = np.random.default_rng(5)
    design = azimuth_elevation("h", [10.0, 60.0, 1.5])
    names = [candidate.name for candidate in usual_candidates(design)]
    assert names == ["as delivered", "zeros", "tilts", "place"]
    tilted = design.with_value({"tilt_north": 8e-3, "tilt_east": -6e-3})
    seen = Observations((beams(design, tilted.parameters.values, year(60), 0.02, rng),))
    choice = choose_model(design, seen)
    assert choice.best in ("tilts", "place")
    scores = {score.name: score for score in choice.table}
    assert scores["zeros"].blocked_rms_rad > 2 * scores["tilts"].blocked_rms_rad
    assert "left aside" in choice.reason
    lowest = min(score.blocked_rms_rad for score in choice.table)
    assert ("the usual choice stays" in choice.reason) == (scores[choice.best].blocked_rms_rad > lowest)
    # A model that lacks nothing is not made larger for a hair.
    small = choose_model(
        design, seen, FitOptions(), [Candidate("tilts", dict.fromkeys(ANGLES, 0.01)), Candidate("as delivered", {})]
    )
    assert small.best == "tilts"
    # Two choices that predict alike: the last is the usual one, and the table alone would not tell why it stays.
    alike = [Candidate("tilts", dict.fromkeys(ANGLES, 0.010)), Candidate("looser", dict.fromkeys(ANGLES, 0.012))]
    for pair in (alike, alike[::-1]):
        kept = choose_model(design, seen, FitOptions(), pair)
        assert kept.best == pair[-1].name
        first, last = (score.blocked_rms_rad for score in kept.table)
        assert ("the usual choice stays" in kept.reason) == (last > first)


def test_choice_with_too_few_rows_takes_everything_within_its_prior():
    rng = np.random.default_rng(6)
    design = azimuth_elevation("h", [10.0, 60.0, 1.5])
    seen = Observations((beams(design, design.parameters.values, sun_arc(4), 0.02, rng),))
    choice = choose_model(design, seen)
    assert choice.best == "place"
    assert "too few" in choice.reason
    with pytest.raises(InputError, match="at least one"):
        choose_model(design, seen, candidates=())
