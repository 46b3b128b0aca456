"""Gaps between edges of the reflection: which flights are doubted for them, which are not."""

from dataclasses import dataclass

import numpy as np
import pytest

from heliogauge.doubts import Doubt
from observer.planning.simulated_edges import EdgeNoise
from observer.planning.simulated_flight import Evaluation, Simulated, simulate
from observer.selection.solve_and_refuse import Reflector
from observer.slopes.edge_gaps import EdgeGaps, edge_gaps, gaps_doubt
from observer.slopes.row_spline import Roughness, RowGrid, TouchingLines
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


def flight(seed: int, photos: int) -> tuple[Simulated, np.ndarray]:
    """Return a simulated flight and the places of its cameras."""
    rng = np.random.default_rng(seed)
    scene = short_scene(Walk.drawn(rng, 3e-4), photos=photos, rows=24)
    one = simulate(scene, believed_with_errors(scene, rng, position_m=4e-3), NOISE, EVALUATION, rng)
    return one, np.array([view.cam_from_frame.inverse().translation_m for view in scene.views])


def doubt_of(reflector: Reflector, valid: np.ndarray, eyes_m: np.ndarray) -> Doubt | None:
    own = np.sqrt(reflector.errors.random[..., 0, 0][valid])
    return gaps_doubt(reflector.gaps, reflector.roughness, own, eyes_m)


def test_sparse_flights_say_that_slopes_rest_on_smoothness() -> None:
    one, eyes = flight(3, 18)
    found = doubt_of(one.reflector, one.slope_map.valid, eyes)
    assert found is not None
    assert found.code == "slopes_rest_on_smoothness"
    assert found.numbers["usual_step_m"] == pytest.approx(5.8 / 17, rel=0.02)
    assert found.numbers["needed_step_m"] < found.numbers["usual_step_m"]


@pytest.mark.slow
def test_twelve_photos_are_doubted_even_where_the_mirror_looks_straight() -> None:
    one, eyes = flight(5, 12)
    assert doubt_of(one.reflector, one.slope_map.valid, eyes) is not None


def test_a_dense_flight_needs_no_doubt() -> None:
    one, eyes = flight(0, 60)
    assert doubt_of(one.reflector, one.slope_map.valid, eyes) is None


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
