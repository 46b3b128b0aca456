"""What the page of a field says of one heliostat."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.heliostat.diagnosis.findings import Finding
from calibration.heliostat.diagnosis.full_diagnosis import Diagnosis
from calibration.heliostat.files.field_work import bad_row_dates, found_over_expected, work_of
from calibration.heliostat.files.result import HeliostatResult, SkyMap
from calibration.heliostat.files.store_field import field_row, worst_first
from calibration.heliostat.fitting.splits import AngleSummary, held_out
from calibration.heliostat.keys import load_heliostat
from calibration.heliostat.pipeline.measure import Options, run
from tests.calibration.heliostat_folders import write_paint


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> HeliostatResult:
    folder = tmp_path_factory.mktemp("paint")
    write_paint(folder, observations=40)
    found = run(load_heliostat(folder), Options(thorough=False, model="4")).heliostats[0]
    return replace(found, diagnosis=Diagnosis((), (), 0.01))


def with_sigma(result: HeliostatResult, factor: float) -> HeliostatResult:
    """Multiply what was expected of held-out beams."""
    main = result.main
    assert main is not None
    prediction = main.prediction
    covariance = {
        name: factor * getattr(prediction, name)
        for name in ("sigma_parameters_rad", "sigma_misfit_rad", "sigma_noise_rad")
    }
    return replace(result, held={result.split: replace(main, prediction=replace(prediction, **covariance))})


def test_a_sound_heliostat_needs_no_work_and_is_found_where_expected(sound: HeliostatResult) -> None:
    assert work_of(sound) == ""
    ratio = found_over_expected(sound)
    # Ten held-out beams of the stated noise: their RMS over the expected one scatters by 1/sqrt(2 x 20) = 0.16.
    assert ratio is not None
    assert 0.5 < ratio < 1.5
    doubled = found_over_expected(with_sigma(sound, 2.0))
    assert doubled == pytest.approx(ratio / 2)


def with_misses(result: HeliostatResult, ratio: float, rows: int) -> HeliostatResult:
    """Hold out so many rows, and stretch their misses to an RMS over the expected one."""
    main, seen = result.main, result.fit.observations
    assert main is not None
    test = main.split.test & (np.cumsum(main.split.test) <= rows)
    held = held_out(main.fit.nominal, seen, replace(main.split, test=test))
    before = found_over_expected(replace(result, held={result.split: held}))
    assert before is not None
    residuals = replace(held.residuals, beam_rad=held.residuals.beam_rad * ratio / before)
    tested = held.split.test[held.split.train | held.split.test]
    held = replace(held, residuals=residuals, test=AngleSummary.of(residuals, tested))
    return replace(result, held={result.split: held})


def chance_of(result: HeliostatResult) -> float:
    misses = result.misses(result.split)
    assert misses is not None
    assert misses.ratio == pytest.approx(found_over_expected(result))
    return misses.chance


def test_beams_far_from_where_they_were_expected(sound: HeliostatResult) -> None:
    text = work_of(with_misses(sound, 2.2, 10))
    assert text.startswith("Held-out beams miss by 2.2 times of what was expected")
    assert work_of(with_misses(sound, 1.8, 10)) == ""
    # One row is worth two components: chi-square of 2 x 2.2^2 is exceeded by one sound heliostat in 130.
    few, many = (with_misses(sound, 2.2, rows) for rows in (1, 10))
    assert 1e-3 < chance_of(few) < 0.1
    assert chance_of(many) < 1e-4
    assert work_of(few) == ""
    assert work_of(with_misses(sound, 4.0, 1)) != ""


def test_an_expected_error_beyond_the_radius_of_the_sun(sound: HeliostatResult) -> None:
    def at(mrad: float) -> HeliostatResult:
        sky = SkyMap("t", (0, 180), (10, 40), np.full((2, 2), 1e-3 * mrad), np.zeros((2, 2), np.bool_))
        return replace(sound, sky=sky)

    assert work_of(at(4.6)) == ""
    assert work_of(at(4.7)).startswith("Its beam is expected to be wrong by 4.7 mrad over the sky")


def test_findings_are_said_with_their_dates_and_remedy(sound: HeliostatResult) -> None:
    days = ("2026-03-03T10:00Z", "2026-03-01", "2026-03-01")
    fault = Finding("worm_gear", "fault", "It swings.", {}, dates=days)
    rows = Finding("outliers", "rows", "Two rows.", {}, dates=("2026-04-01",))
    hint = Finding("sag", "hint", "Perhaps.", {}, dates=("2026-05-01",))
    judged = replace(sound, diagnosis=Diagnosis((fault, rows, hint), (), 0.01))
    text = "Worm gear (2026-03-01, 2026-03-03): Free the periodic error of this axis with this period."
    assert work_of(judged) == text
    assert bad_row_dates(judged) == ("2026-03-01", "2026-03-03", "2026-04-01")
    row = field_row(judged)
    assert row["work"] == text
    assert row["bad_row_dates"] == "2026-03-01, 2026-03-03, 2026-04-01"
    # Single rows that were left out ask for no work.
    assert work_of(replace(sound, diagnosis=Diagnosis((rows, hint), (), 0.01))) == ""


def test_the_worst_across_the_sky_comes_first() -> None:
    rows = [
        {"heliostat": "a", "status": "ok", "predicted_sky_beam_mrad": 1.0, "beam_test_rms_mrad": 9.0},
        {"heliostat": "b", "status": "ok", "predicted_sky_beam_mrad": 3.0, "beam_test_rms_mrad": 2.0},
        {"heliostat": "c", "status": "ok", "predicted_sky_beam_mrad": None, "beam_test_rms_mrad": 2.5},
        {"heliostat": "d", "status": "failed"},
    ]
    assert [row["heliostat"] for row in worst_first(rows)] == ["d", "b", "c", "a"]


def test_the_expected_error_over_the_sky_weighs_by_solid_angle(tmp_path: Path) -> None:
    sigma = np.array([[1e-3, 2e-3], [3e-3, np.nan]])
    sky = SkyMap("t", (0, 180), (10, 60), sigma, np.zeros((2, 2), np.bool_))
    low, high = np.cos(np.deg2rad([10, 60]))
    assert sky.rms_beam_rad == pytest.approx(1e-3 * np.sqrt((low * 5 + high * 9) / (2 * low + high)))
    assert np.isnan(replace(sky, sigma_beam_rad=np.full((2, 2), np.nan)).rms_beam_rad)
