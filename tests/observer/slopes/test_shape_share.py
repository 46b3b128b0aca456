"""Whether the mirror has the heights of its slopes: told from the edges, said where it matters."""

from dataclasses import replace

import numpy as np
import pytest

from observer.slopes.row_spline import Roughness, RowGrid, TouchingLines
from observer.slopes.shape_share import ShapeShare, find_shape_share, shape_doubt

GRID = RowGrid(np.linspace(-1.0, 1.0, 80), np.ones(79, dtype=bool), 40)


def observed(share: float, rng: np.random.Generator) -> tuple[tuple[TouchingLines, TouchingLines], np.ndarray]:
    """Draw edges of both sides every 2 cm; heights move those of the two sides a little differently."""
    m = 100
    row = np.repeat(np.arange(GRID.n_rows), m)
    x = np.tile(np.linspace(-0.98, 0.98, m), GRID.n_rows)
    side = np.tile(np.where(np.arange(m) % 2, 1.0, -1.0), GRID.n_rows)
    phase = rng.uniform(0, 2 * np.pi, GRID.n_rows)[row]
    slope, height = 3e-3 * np.cos(6 * x + phase), 0.5e-3 * np.sin(6 * x + phase)
    effect = height * (0.2 + 0.05 * side)
    seen = 2 * slope - share * effect + rng.normal(0, 5e-5, x.size)
    none = np.zeros((x.size, 0))
    flat = TouchingLines(
        row, x, seen, np.full(x.size, -2.0), np.zeros(x.size), np.full(x.size, 5e-5), none.astype(int), none
    )
    return (replace(flat, misfit_rad=seen + effect), flat), 0.1 * side


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_the_factor_of_the_heights_is_found(share: float) -> None:
    both, by_edge = observed(share, np.random.default_rng(0))
    found = find_shape_share(both, by_edge, GRID, Roughness(1e-2, 1e-5), np.zeros((0, 0)))
    assert found.is_decided
    assert found.has_shape == (share > 0.5)
    assert abs(found.share - share) < 3 * found.sigma
    # Heights of 0.35 mm RMS move edges of both sides by 0.2 rad / m, half of that is slope.
    assert found.effect_rad == pytest.approx(0.1 * 0.35e-3, rel=0.3)


def test_without_heights_nothing_tells_and_real_mirrors_are_assumed() -> None:
    both, by_edge = observed(0.0, np.random.default_rng(1))
    found = find_shape_share((both[1], both[1]), by_edge, GRID, Roughness(1e-2, 1e-5), np.zeros((0, 0)))
    assert found.has_shape
    assert shape_doubt(found, None, 1e-4) is None


def test_what_is_said() -> None:
    clear, unclear = ShapeShare(0.02, 0.1, 2e-4), ShapeShare(0.4, 0.3, 2e-4)
    assert shape_doubt(clear, None, 1e-4) is None
    assert shape_doubt(clear, False, 1e-4) is None
    assert "shape_from_slopes = true does not fit" in str(shape_doubt(clear, True, 1e-4))
    assert "does not decide between the two; the former was taken" in str(shape_doubt(unclear, None, 1e-4))
    assert shape_doubt(unclear, True, 1e-4) is None
    assert shape_doubt(ShapeShare(0.4, 0.3, 2e-5), None, 1e-4) is None


def test_a_factor_that_no_mirror_has_says_nothing() -> None:
    """-3.6 +- 0.6, from few photos of a mirror that has its shape, was taken for normals that are turned."""
    both, by_edge = observed(-3.0, np.random.default_rng(0))
    found = find_shape_share(both, by_edge, GRID, Roughness(1e-2, 1e-5), np.zeros((0, 0)))
    assert found.share < -2
    assert found.sigma > 1
    assert found.has_shape
    assert not found.is_decided


def test_an_uncertain_factor_contradicts_nothing() -> None:
    """-1.7 +- 1.0 is no hint that the mirror has its shape."""
    assert shape_doubt(ShapeShare(-1.7, 1.0, 2e-4), False, 1e-4) is None


def test_turned_normals_need_evidence() -> None:
    assert not ShapeShare(0.02, 0.1, 2e-4).has_shape
    assert ShapeShare(0.27, 0.41, 2e-4).has_shape
    assert ShapeShare(1.05, 0.1, 2e-4).has_shape


def test_what_edges_far_apart_add_is_taken_off() -> None:
    """Where slopes are what the prior says the estimate is right; on mirrors it is too large by what is taken off.

    Edges of one side are 4 cm apart: 0.2 (4 / 6)^1.5 = 0.109.
    """
    off = []
    for seed in range(8):
        both, by_edge = observed(1.0, np.random.default_rng(seed))
        off.append(find_shape_share(both, by_edge, GRID, Roughness(1e-2, 1e-5), np.zeros((0, 0))).share - 1.0)
    assert np.mean(off) == pytest.approx(-0.109, abs=max(3 * np.std(off) / np.sqrt(8), 0.02))
    assert 3 * np.std(off) / np.sqrt(8) < 0.05
