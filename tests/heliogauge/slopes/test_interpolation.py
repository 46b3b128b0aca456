"""A map read between its nodes: exact shapes, gaps, sigma against scatter."""

from dataclasses import replace

import numpy as np
import pytest

from heliogauge.flags import SampleFlag
from heliogauge.slopes.interpolation import read_map
from heliogauge.slopes.map import CommonModes, SlopeMap

STEP_M = 0.02


def strong_map(noise_correlation: float = 1.0) -> SlopeMap:
    """Return a paraboloid of f = 1.7 m, 1 m square, with a wave of 1 mrad and 0.5 m."""
    axis = np.arange(-25, 26) * STEP_M
    x, y = np.meshgrid(axis, axis)
    slope_x, slope_y = x / 3.4 + 1e-3 * np.sin(4 * np.pi * x), y / 3.4
    return SlopeMap(
        x_m=axis,
        y_m=axis,
        slope_x=slope_x,
        slope_y=slope_y,
        design_slope_x=x / 3.4,
        design_slope_y=y / 3.4,
        sigma_random_x=np.full(x.shape, 1e-5),
        sigma_random_y=np.full(x.shape, 2e-5),
        noise_correlation=noise_correlation,
        common=CommonModes((), np.zeros((0, 2, 3)), np.zeros(2), 1.0),
        height_m=(x**2 + y**2) / 6.8,
        flags=np.zeros(x.shape, dtype=np.uint32),
        aperture=np.ones(x.shape, dtype=bool),
        design="paraboloid",
        frame="facet",
        removed="nothing",
    )


def test_between_nodes_a_strong_mirror_keeps_its_slopes() -> None:
    x_m, y_m = np.random.default_rng(1).uniform(-0.5, 0.5, (2, 4000))
    read = read_map(strong_map(), x_m, y_m)
    np.testing.assert_allclose(read.design_slope_x, x_m / 3.4, atol=1e-12)
    # A chord under a wave of amplitude a misses by a (k step)^2 / 8 at the most, the trend by less.
    np.testing.assert_allclose(read.slope_x, x_m / 3.4 + 1e-3 * np.sin(4 * np.pi * x_m), atol=1e-5)
    np.testing.assert_allclose(read.height_m, (x_m**2 + y_m**2) / 6.8, atol=1e-12)


def test_beside_a_gap_the_other_neighbours_shift_nothing() -> None:
    whole = strong_map()
    flags = whole.flags.copy()
    flags[:, 30] = np.uint32(SampleFlag.NOT_SEEN)
    broken = replace(whole, flags=flags, slope_x=np.where(flags, np.nan, whole.slope_x))
    x_m = whole.x_m[30] + np.array([-0.6, -0.4, 0.4, 0.6]) * STEP_M
    read = read_map(broken, x_m, np.full(4, 0.013))
    assert np.isfinite(read.slope_x).tolist() == [True, False, False, True]
    assert read.flags.tolist() == [0, int(SampleFlag.NOT_SEEN), int(SampleFlag.NOT_SEEN), 0]
    np.testing.assert_allclose(read.slope_x[[0, 3]], (x_m / 3.4 + 1e-3 * np.sin(4 * np.pi * x_m))[[0, 3]], atol=1e-4)
    np.testing.assert_allclose(read.slope_y[[0, 3]], 0.013 / 3.4, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("pixels_per_node", [1.0, 0.4])
def test_sigma_is_the_scatter_on_coarse_and_on_fine_grids(pixels_per_node: float) -> None:
    """Noise is drawn on pixels and put on the nodes linearly, as maps are made."""
    rng, count = np.random.default_rng(3), 100
    at = np.arange(51) * pixels_per_node
    low = np.floor(at).astype(int)
    hat = np.zeros((51, low[-1] + 2))
    hat[np.arange(51), low], hat[np.arange(51), low + 1] = 1 - (at - low), at - low
    drawn = np.einsum("ia,nab,jb->nij", hat, rng.standard_normal((count, hat.shape[1], hat.shape[1])), hat)
    node_sigma = np.sqrt(np.einsum("ia,jb->ij", hat**2, hat**2))
    x_m, y_m = rng.uniform(-0.45, 0.45, (2, 500))
    shared = np.sum(hat.sum(axis=0) ** 2) ** 2 / np.sum(node_sigma**2)
    clean = replace(strong_map(shared), sigma_random_x=1e-5 * node_sigma)
    truth = read_map(clean, x_m, y_m)
    errors = [
        read_map(replace(clean, slope_x=clean.slope_x + 1e-5 * one), x_m, y_m).slope_x - truth.slope_x for one in drawn
    ]
    ratio = np.sqrt(np.mean((np.array(errors) / truth.sigma_random_x) ** 2))
    assert 0.93 < ratio < 1.07
