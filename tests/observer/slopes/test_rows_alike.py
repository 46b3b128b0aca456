"""Rows whose mirror is the same: sigmas of sparse flights against their scatter, cameras against dense algebra."""

from dataclasses import dataclass

import numpy as np
import pytest

from heliogauge.doubts import Doubt
from observer.planning.simulated_edges import EdgeNoise
from observer.planning.simulated_flight import Evaluation, Simulated, error_theta_ra, simulate
from observer.product.slope_map import angle_maps, slopes_to_tube
from observer.selection.solve_and_refuse import Reflector
from observer.slopes.edge_gaps import EdgeGaps, edge_gaps, gaps_doubt
from observer.slopes.joint_solution import solve_jointly
from observer.slopes.row_spline import Roughness, RowGrid, TouchingLines, prior_bands
from tests.observer.simulated_trough import believed_with_errors, short_scene

STEP_M = 0.01
NOISE = EdgeNoise(reflection_px=0.1, absorber_px=0.1)
EVALUATION = Evaluation(column_step_m=0.04, station_step_m=0.5, along_rad=1e-3)


@dataclass(frozen=True)
class Walk:
    """A mirror whose bend is a random walk across, the same at all places along the trough."""

    x_m: np.ndarray
    slope: np.ndarray

    @classmethod
    def drawn(cls, rng: np.random.Generator, density: float) -> "Walk":
        x = np.arange(-2.6, 2.6, STEP_M)
        bend = np.cumsum(rng.standard_normal(x.size) * np.sqrt(density * STEP_M))
        slope = np.cumsum(bend) * STEP_M
        line = np.polynomial.Polynomial.fit(x, slope, 1)
        return cls(x, slope - line(x))

    def errors(self, x_m: np.ndarray, y_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.interp(x_m, self.x_m, self.slope), np.zeros_like(y_m)


def flight(seed: int, photos: int) -> tuple[Simulated, np.ndarray, np.ndarray]:
    """Return a simulated flight, error over sigma of theta_ra, and the cameras."""
    rng = np.random.default_rng(seed)
    scene = short_scene(Walk.drawn(rng, 3e-4), photos=photos, rows=24)
    one = simulate(scene, believed_with_errors(scene, rng, position_m=4e-3), NOISE, EVALUATION, rng)
    collector = scene.truth.collector
    angles = angle_maps(one.slope_map, one.absorber, collector, slopes_to_tube(one.reflector, one.slope_map))
    error, sigma = error_theta_ra(one, collector.focal_length_m, scene.truth.absorber), angles.sigma_theta_ra_rad
    known = np.isfinite(error) & np.isfinite(sigma)
    return one, (error / sigma)[known], np.array([view.cam_from_frame.inverse().translation_m for view in scene.views])


def doubt_of(reflector: Reflector, valid: np.ndarray, eyes_m: np.ndarray) -> Doubt | None:
    own = np.sqrt(reflector.errors.random[..., 0, 0][valid])
    return gaps_doubt(reflector.gaps, reflector.roughness, own, eyes_m)


def test_sparse_flights_say_how_wrong_they_are_and_that_slopes_rest_on_smoothness() -> None:
    # As if rows that are alike were independent this was 1.4 to 10, 3.7 on average.
    square = []
    for seed in range(4):
        one, over, eyes = flight(seed, 18)
        square.append(np.mean(over**2))
    assert 0.5 < np.mean(square) < 1.4
    found = doubt_of(one.reflector, one.slope_map.valid, eyes)
    assert found is not None
    assert found.code == "slopes_rest_on_smoothness"
    assert found.numbers["usual_step_m"] == pytest.approx(5.8 / 17, rel=0.02)
    assert found.numbers["needed_step_m"] < found.numbers["usual_step_m"]


@pytest.mark.slow
def test_twelve_photos_are_doubted_even_where_the_mirror_looks_straight() -> None:
    one, _, eyes = flight(5, 12)
    assert doubt_of(one.reflector, one.slope_map.valid, eyes) is not None


def test_a_dense_flight_needs_no_doubt() -> None:
    one, over, eyes = flight(0, 60)
    assert 0.5 < np.mean(over**2) < 1.4
    assert doubt_of(one.reflector, one.slope_map.valid, eyes) is None


@pytest.mark.slow
@pytest.mark.parametrize("photos", [18, 60])
def test_error_over_sigma_of_rows_that_are_alike(photos: int) -> None:
    square = [np.mean(flight(seed, photos)[1] ** 2) for seed in range(10)]
    assert 0.7 < np.mean(square) < 1.4


def test_gaps_are_those_within_rows_and_panels() -> None:
    joined = np.array([True] * 9 + [False] + [True] * 9)
    grid = RowGrid(np.linspace(-0.95, 0.95, 20), joined, 2)
    x = np.array([-0.9, -0.6, -0.5, 0.5, 0.6, -0.3, 0.7])
    zero = np.zeros(x.size)
    lines = TouchingLines(np.array([0, 0, 0, 0, 0, 1, 1]), x, zero, zero, zero, zero, zero[:, None], zero[:, None])
    found = edge_gaps(lines, grid, np.array([True, True, False, False, False, False, False]))
    assert found.gap_m == pytest.approx(np.quantile([0.3, 0.1, 0.1], 0.9))
    assert found.confirmed_share == pytest.approx(2 / 7)


@pytest.mark.parametrize(
    ("gap_m", "confirmed", "sigma_rad", "is_told"),
    [(0.1, 0.3, 2e-4, True), (0.1, 0.7, 2e-4, False), (0.1, 0.3, 0.7e-4, False), (0.3, 0.7, 0.1e-4, True)],
)
def test_the_doubt_needs_gaps_that_matter(gap_m: float, confirmed: float, sigma_rad: float, is_told: bool) -> None:
    eyes = np.column_stack([np.arange(10) * 0.32, np.zeros(10), np.full(10, 12.0)])
    found = gaps_doubt(EdgeGaps(gap_m, confirmed), Roughness(1e-3), np.full(5, sigma_rad), eyes)
    assert (found is not None) == is_told
    if found is not None:
        # A walk that is integrated once strays with the power 1.5 of the gap.
        told = max(sigma_rad, float(np.sqrt(3e-4 * gap_m**3 / 192)))
        assert found.numbers["needed_step_m"] == pytest.approx(0.32 * (1e-4 / told) ** (1 / 1.5))
        assert "0.32 m apart" in found.text
        turning = gaps_doubt(EdgeGaps(gap_m, confirmed), Roughness(1e-3), np.full(5, sigma_rad), eyes + [0, 0, 100])
        assert turning is not None
        assert "turn by at most" in turning.text


@pytest.mark.parametrize("likeness", [0.0, 1.0])
def test_common_unknowns_of_rows_that_are_alike_are_those_of_dense_algebra(likeness: float) -> None:
    rng = np.random.default_rng(3)
    n_rows, m, nodes = 6, 8, 20
    grid = RowGrid(np.linspace(-1, 1, nodes), np.ones(nodes - 1, dtype=bool), n_rows)
    prior, covariance = Roughness(1e-3), np.diag([1e-6, 4e-6])
    # Each row has its edges at the same nodes, as where photos see waves that run along the trough.
    column, sigma = np.sort(rng.choice(nodes, m, replace=False)), 1e-4
    by_common = rng.normal(-0.7, 0.4, m)
    lines = TouchingLines(
        np.repeat(np.arange(n_rows), m),
        np.tile(grid.x_m[column], n_rows),
        np.tile(rng.normal(0, 1e-3, m), n_rows),
        np.full(n_rows * m, -2.0),
        np.zeros(n_rows * m),
        np.full(n_rows * m, sigma),
        np.tile((np.arange(m) % 2)[:, None], (n_rows, 1)),
        np.tile(by_common[:, None], (n_rows, 1)),
    )
    alike = np.where(np.eye(n_rows) > 0, 1.0, likeness)
    found = solve_jointly(lines, grid, prior, covariance, alike=alike)
    bands = prior_bands(grid, prior)[..., 0]
    precision = sum(np.diag(bands[k, : nodes - k], -k) + np.diag(bands[k, : nodes - k], k) for k in (1, 2))
    spread = np.linalg.inv(precision + np.diag(bands[0]))[np.ix_(column, column)]
    whole = np.kron(alike, 4 * spread) + sigma**2 * np.eye(n_rows * m)
    pattern = np.zeros((n_rows * m, 2))
    pattern[np.arange(n_rows * m), lines.common_index[:, 0]] = lines.d_common[:, 0]
    expected = np.linalg.inv(pattern.T @ np.linalg.solve(whole, pattern) + np.linalg.inv(covariance))
    # The bound on slopes of any mirror is not scaled with the roughness.
    np.testing.assert_allclose(found.covariance_common, expected, rtol=0.02, atol=1e-3 * expected.max())
    np.testing.assert_allclose(
        found.common, -expected @ pattern.T @ np.linalg.solve(whole, lines.misfit_rad), rtol=0.03, atol=1e-6
    )
    if likeness == 1.0:
        independent = solve_jointly(lines, grid, prior, covariance)
        assert np.diagonal(found.covariance_common).min() > 1.5 * np.diagonal(independent.covariance_common).min()
