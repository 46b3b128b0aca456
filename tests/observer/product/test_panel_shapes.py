"""Focal lengths of panels: a closed form, and scatter against sigma."""

from dataclasses import replace

import numpy as np
import pytest

from heliogauge.slopes.map import SlopeMap, no_common_modes
from observer.product.panel_shapes import panel_shapes
from observer.trough.collector import Collector

COLLECTOR = Collector(
    4.0, 4.0, 1.5, 0.07, panel_edges_x_m=np.array([-2.0, 0.0, 2.0]), panel_edges_y_m=np.array([-2.0, 0.0, 2.0])
)
FOCAL_M = np.array([1.45, 1.5, 1.52, 1.6])


def mirror(noise_rad: float, rng: np.random.Generator) -> SlopeMap:
    x, y = (np.arange(80) + 0.5) * 0.05 - 2.0, (np.arange(80) + 0.5) * 0.05 - 2.0
    grid_x, grid_y = np.meshgrid(x, y)
    panel = COLLECTOR.panel_index(grid_x, grid_y)
    design = grid_x / (2 * COLLECTOR.focal_length_m)
    slope = grid_x / (2 * FOCAL_M[panel]) + 1e-3 * panel + rng.normal(0, noise_rad, panel.shape)
    zero = np.zeros(panel.shape)
    return SlopeMap(
        x,
        y,
        slope,
        zero,
        design,
        zero,
        np.full(panel.shape, max(noise_rad, 1e-9)),
        zero,
        1.0,
        no_common_modes(),
        np.full(panel.shape, np.nan),
        zero.astype(np.uint32),
        panel >= 0,
        "trough",
        "trough",
        "nothing",
    )


def test_focal_lengths_of_parabolic_panels() -> None:
    found = panel_shapes(mirror(0.0, np.random.default_rng(0)), COLLECTOR)
    np.testing.assert_allclose(found.focal_length_m, FOCAL_M, rtol=1e-12)
    assert np.nanmax(found.rest_rad) < 1e-12


def test_sigma_is_the_scatter() -> None:
    rng = np.random.default_rng(1)
    runs = [panel_shapes(mirror(1e-3, rng), COLLECTOR) for _ in range(60)]
    ratio = np.array([(one.focal_length_m - FOCAL_M) / one.sigma_focal_length_m for one in runs])
    # 240 values: standard deviation of their RMS 0.046.
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(1.0, abs=0.15)
    assert np.mean([one.rest_rad for one in runs]) == pytest.approx(1e-3, rel=0.02)


def test_a_panel_of_which_little_was_measured_has_none() -> None:
    whole = mirror(0.0, np.random.default_rng(2))
    flags = np.array(whole.flags)
    flags[:40, :38] = 1 << 9
    found = panel_shapes(replace(whole, flags=flags), COLLECTOR)
    assert np.isnan(found.focal_length_m[0])
    assert np.isfinite(found.focal_length_m[1:]).all()
