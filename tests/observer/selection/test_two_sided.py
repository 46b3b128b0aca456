"""Edges of a far camera: what both sides of the tube say is kept, rims of the glass and the wrong side are not."""

import numpy as np

from observer.selection.two_sided import agreed_by_both, cells_of

HALF_RAD, GLASS = 20e-3, 1.6


def drawn(rng: np.random.Generator, slope_rad: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return places, sides and shifts of edges in one small piece of a mirror, and which are true."""
    count = 12
    sides = np.where(np.arange(count) % 2, 1.0, -1.0)
    true = 2 * slope_rad + 0.3e-3 * rng.standard_normal(count)
    # The rim of the glass on each side, taken for the tube's edge; true edges taken for the other one.
    glass = 2 * slope_rad - sides * (GLASS - 1) * HALF_RAD + 0.3e-3 * rng.standard_normal(count)
    other = true + 2 * sides * HALF_RAD
    points = np.concatenate([rng.uniform(0.01, 0.09, (3 * count, 1)), rng.uniform(0.01, 0.24, (3 * count, 2))], axis=1)
    is_true = np.repeat([True, False, False], count)
    return points, np.concatenate([sides, sides, -sides]), np.concatenate([true, glass, other]), is_true


def test_true_edges_agree_and_no_others() -> None:
    for seed in range(10):
        rng = np.random.default_rng([seed, 3])
        points, side, shift, is_true = drawn(rng, rng.uniform(-8e-3, 8e-3))
        found = agreed_by_both(cells_of(points), side, shift, np.full(side.shape, HALF_RAD))
        np.testing.assert_array_equal(found, is_true)


def test_one_side_alone_is_not_believed() -> None:
    points, side, shift, is_true = drawn(np.random.default_rng(5), 3e-3)
    alone = is_true & (side > 0)
    found = agreed_by_both(cells_of(points[alone]), side[alone], shift[alone], np.full(alone.sum(), HALF_RAD))
    assert not found.any()
    assert agreed_by_both(cells_of(np.zeros((0, 3))), np.zeros(0), np.zeros(0), np.zeros(0)).size == 0
