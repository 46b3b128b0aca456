"""Every second photo against the others: what chance makes of them, what one half errs by, what both share."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from heliogauge.adjust.chi_square import chi_square_limit
from observer.doubts.by_chance import chance
from observer.doubts.halves import halves_doubt, halves_limit, halves_words
from observer.pipeline.headline import halves_numbers
from observer.slopes.common_elimination import Beside
from observer.slopes.halves import PRIOR_RAD, Halves, halves_of, halves_patterns
from observer.slopes.joint_solution import solve_jointly
from observer.slopes.pose_modes import MODES_PER_PHOTO
from observer.slopes.row_spline import Roughness, RowGrid, TouchingLines
from observer.trough.collector import ls2

COLLECTOR = replace(
    ls2(),
    aperture_width_m=2.0,
    length_m=2.0,
    panel_edges_x_m=np.array([-1.0, 0.0, 1.0]),
    panel_edges_y_m=np.array([-1.0, 0.0, 1.0]),
)
GRID = RowGrid(np.linspace(-0.975, 0.975, 40), np.arange(39) != 19, 8)
Y = (np.arange(8) - 3.5) / 4
PHOTOS, LINES, ROUGHNESS = 12, 2000, Roughness(1e-4, 1e-4)
COVARIANCE = np.diag(np.tile([1e-8, 2.5e-9, 1e-9], PHOTOS))


def flight(seed: int, planted: Callable[[TouchingLines, np.ndarray], np.ndarray] | None = None) -> Halves:
    """Draw lines of a mirror whose bend is a random walk in each panel, and poses of all photos; compare the halves."""
    rng = np.random.default_rng(seed)
    row, photo = rng.integers(0, 8, LINES), rng.integers(0, PHOTOS, LINES)
    x = rng.uniform(0.025, 0.975, LINES) * rng.choice([-1, 1], LINES)
    by_photo = rng.normal(0, 1, (LINES, MODES_PER_PHOTO))
    lines = TouchingLines(
        row,
        x,
        np.zeros(LINES),
        rng.normal(-2, 0.1, LINES),
        rng.normal(0, 0.1, LINES),
        np.full(LINES, 2e-4),
        MODES_PER_PHOTO * photo[:, None] + np.arange(MODES_PER_PHOTO),
        by_photo,
    )
    walks = np.cumsum(np.sqrt(ROUGHNESS.across * 0.001) * rng.standard_normal((8, 2, 1000)), axis=2)
    slopes = np.cumsum(0.001 * walks, axis=2).reshape(8, 2000)
    poses = rng.multivariate_normal(np.zeros(len(COVARIANCE)), COVARIANCE)
    seen = lines.d_slope_x * np.array(
        [np.interp(at, np.arange(2000) * 0.001 - 1, slopes[k]) for at, k in zip(x, row, strict=True)]
    )
    seen += np.einsum("mc,mc->m", by_photo, poses[lines.common_index]) + 2e-4 * rng.standard_normal(LINES)
    if planted is not None:
        seen += planted(lines, photo)

    def patterns(some: TouchingLines, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found = halves_patterns(some, Y[rows][some.row], COLLECTOR)
        return found, np.full(found.shape[1], PRIOR_RAD)

    solved = solve_jointly(replace(lines, misfit_rad=-seen), GRID, ROUGHNESS, COVARIANCE, patterns=patterns)
    assert solved.beside is not None
    found = halves_of(solved.beside)
    assert found is not None
    return found


def test_differences_of_sound_flights_are_what_their_covariance_says() -> None:
    """Twelve flights of eight numbers each, whitened together: 96 values, within 0.67 to 1.41 (99 %)."""
    found = [flight(seed) for seed in range(12)]
    assert {one.difference_rad.size for one in found} == {8}
    assert 0.67 < np.mean([one.chi_square for one in found]) < 1.41
    rms, expected = np.sqrt(np.mean(np.square([[one.rms_rad, one.expected_rad] for one in found]), axis=0))
    assert rms == pytest.approx(expected, rel=0.25)


def test_what_one_half_alone_errs_by_is_found_with_its_sign() -> None:
    """Slopes of one panel are 0.2 mrad larger by every second photo, bent by 0.1 mrad RMS in another one."""

    def planted(lines: TouchingLines, photo: np.ndarray) -> np.ndarray:
        y = Y[lines.row]
        turned = np.where((lines.x_m < 0) & (y < 0), 2e-4, 0.0)
        bent = np.where((lines.x_m > 0) & (y > 0), 1e-4 * np.sqrt(3.0) * (2 * lines.x_m - 1), 0.0)
        return np.where(photo % 2 == 1, lines.d_slope_x * (turned + bent), 0.0)

    found = flight(3, planted)
    beside = found.difference_rad - np.array([2e-4, 0, 0, 0, 0, 0, 0, 1e-4])
    assert beside @ np.linalg.solve(found.covariance, beside) < chi_square_limit(1e-3, 8)
    assert found.chi_square > halves_limit(8)
    assert found.n_panels == 4


def test_what_both_halves_have_in_common_is_not_seen() -> None:
    """A lens, a list of targets or a radius that is wrong turns what both say by a milliradian."""
    wrong = flight(5, lambda lines, photo: lines.d_slope_x * 1e-3 * (1 + lines.x_m))
    np.testing.assert_allclose(wrong.difference_rad, flight(5).difference_rad, atol=1e-6)


def test_panels_that_photos_do_not_show_do_not_count() -> None:
    amount = np.array([1e-4, 2e-3, -1e-4, 3e-3])
    sigma = np.array([1e-4, 0.9 * PRIOR_RAD, 1e-4, 0.2 * PRIOR_RAD])
    found = halves_of(Beside(amount, np.diag(sigma**2)))
    assert found is not None
    np.testing.assert_array_equal(found.difference_rad, [1e-4, -1e-4])
    assert found.n_panels == 1
    assert found.rms_rad == pytest.approx(np.sqrt(2) * 1e-4)
    assert halves_of(Beside(amount[[1, 3]], np.diag(sigma[[1, 3]] ** 2))) is None


def test_a_difference_is_doubted_where_it_is_not_of_chance_and_matters() -> None:
    def differing(times: float) -> Halves:
        return Halves(np.full(16, times * 1e-4), 1e-8 * np.eye(16), 8)

    # Of 16 squares of unit variance the mean exceeds 2.27 once in 370 times; of a hundred modules another limit holds.
    assert chance(1) == pytest.approx(1 / 370.4, rel=1e-3)
    assert halves_doubt(differing(1.4), 1e-6) is None
    assert halves_doubt(differing(1.6), 1e-6, n_modules=100) is None
    found = halves_doubt(differing(1.6), 1e-6)
    assert found is not None
    assert "differ by more than chance: panels by 0.23 mrad RMS where 0.14 is expected" in found.text
    # The map errs by half of what is not expected: sqrt(0.566^2 - 0.141^2) / 2 mrad.
    assert halves_doubt(differing(4), 0.57e-3) is None
    found = halves_doubt(differing(4), 0.53e-3)
    assert found is not None
    assert "err 4.0 times as much" in found.text
    assert found.numbers["sigma_slope_rad"] == pytest.approx(np.hypot(0.53e-3, 0.274e-3), rel=1e-3)


def test_halves_that_contradict_each_other_beside_few_uncertain_modes_are_doubted() -> None:
    """All panels together are uncertain, so that the RMS is as expected; their differences are known and are wrong."""
    covariance = 1e-10 * np.eye(16) + 1e-7 * np.ones((16, 16))
    difference = np.tile([1e-4, -1e-4], 8)
    found = Halves(difference, covariance, 8)
    assert found.rms_rad < found.expected_rad / 3
    assert found.chi_square == pytest.approx(100)
    doubt = halves_doubt(found, 0.5e-3)
    assert doubt is not None
    assert "by the whole covariance of that, poses or places of edges err 10.0 times as much" in doubt.text
    # By Birge's ratio of 10 the sigma of the mean of both halves, 0.447 mrad / 2, is too small.
    assert doubt.numbers["sigma_slope_rad"] == pytest.approx(np.hypot(0.5e-3, 0.2237e-3 * np.sqrt(99)), rel=2e-3)


def test_terminal_and_report_say_what_was_found() -> None:
    found = flight(1)
    numbers = halves_numbers(SimpleNamespace(halves=found), n_modules=1)
    (said,) = halves_words(numbers)
    assert f"agree: means and bends of panels differ by {1e3 * found.rms_rad:.2g} mrad RMS" in said
    assert "what all photos share is not tested" in said
    (said,) = halves_words(numbers | {"halves_chi_square_ratio": 4.0})
    assert "differ by more than chance" in said
    # Of a hundred modules one has such a chi-square once in three flights: no doubt, and no such words.
    for n_modules, word in ((1, "differ by more than chance"), (100, "agree")):
        numbers = halves_numbers(SimpleNamespace(halves=found), n_modules)
        (said,) = halves_words(numbers | {"halves_chi_square_ratio": 1.01 * halves_limit(found.difference_rad.size)})
        assert word in said
    assert not list(halves_words({}))
