"""Facets of a strong mirror put into one map: the optic's slopes at every node, whatever way facets are turned."""

from dataclasses import replace

import numpy as np
import pytest

from deflectometry.shape.assemble import assemble_maps
from deflectometry.shape.smooth_shape import Align
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet, paraboloid
from heliogauge.slopes.map import SlopeMap, no_common_modes
from heliogauge.slopes.removal import Removal

OPTIC = paraboloid(1.7)
SQUARE = np.array([[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.2, 0.2]])


def facet_of_optic(name: str, center: tuple[float, float], turn_rad: float) -> Facet:
    """Return a facet whose z is the optic's normal in its middle, turned about it."""
    height = float(OPTIC.height(*center))
    slope_x, slope_y = (float(one) for one in OPTIC.gradient(*center))
    normal = np.array([-slope_x, -slope_y, 1.0]) / np.sqrt(1 + slope_x**2 + slope_y**2)
    across = np.array([np.cos(turn_rad), np.sin(turn_rad), 0.0])
    across -= (across @ normal) * normal
    across /= np.linalg.norm(across)
    pose = RigidTransform(np.stack([across, np.cross(normal, across), normal], axis=1), np.array([*center, height]))
    return Facet(name, SQUARE, OPTIC.transformed(pose.inverse()), pose)


def exact_map(facet: Facet, step_m: float) -> SlopeMap:
    axis = np.arange(-round(0.2 / step_m), round(0.2 / step_m) + 1) * step_m
    x, y = np.meshgrid(axis, axis)
    slope_x, slope_y = facet.design.gradient(x, y)
    return SlopeMap(
        x_m=axis,
        y_m=axis,
        slope_x=slope_x,
        slope_y=slope_y,
        design_slope_x=slope_x,
        design_slope_y=slope_y,
        sigma_random_x=np.full(x.shape, 1e-5),
        sigma_random_y=np.full(x.shape, 3e-5),
        noise_correlation=4.0,
        common=no_common_modes(),
        height_m=facet.design.height(x, y),
        flags=np.zeros(x.shape, dtype=np.uint32),
        aperture=np.ones(x.shape, dtype=bool),
        design="paraboloid",
        frame="facet",
        removed="nothing",
    )


@pytest.mark.parametrize("turn_rad", [0.0, 0.4, np.pi / 2])
def test_the_whole_has_the_slopes_of_the_optic(turn_rad: float) -> None:
    facets = [facet_of_optic("low", (-0.25, 0.1), turn_rad), facet_of_optic("high", (0.3, -0.2), 0.0)]
    maps = {facet.name: exact_map(facet, 0.01) for facet in facets}
    whole = assemble_maps(facets, maps, Align.OUTLINE, Removal.NOTHING)
    x, y = np.meshgrid(whole.x_m, whole.y_m)
    true_x, true_y = OPTIC.gradient(x, y)
    good = whole.valid
    assert np.count_nonzero(good) == np.count_nonzero(whole.aperture) > 2000
    np.testing.assert_allclose(whole.slope_x[good], true_x[good], atol=4e-6)
    np.testing.assert_allclose(whole.slope_y[good], true_y[good], atol=4e-6)
    np.testing.assert_allclose(whole.height_m[good], OPTIC.height(x, y)[good], atol=1e-7)
    np.testing.assert_allclose(whole.slope_error_x[good], 0.0, atol=1e-12)


def test_a_facet_of_another_slope_shows_its_canting_alone() -> None:
    facets = [facet_of_optic("low", (-0.25, 0.1), 0.0), facet_of_optic("high", (0.3, -0.2), 0.0)]
    maps = {facet.name: exact_map(facet, 0.01) for facet in facets}
    maps["high"] = replace(maps["high"], slope_x=maps["high"].slope_x + 1e-3)
    whole = assemble_maps(facets, maps, Align.OUTLINE, Removal.NOTHING)
    error, right = whole.slope_error_x, whole.x_m > 0.05
    assert np.nanmax(np.abs(error[:, ~right])) < 1e-12
    # A normal turned by 1 mrad in a frame that is itself turned by 0.05: 1 mrad but for second order.
    assert np.nanmean(error[:, right]) == pytest.approx(1e-3, rel=0.02)
    assert np.nanstd(error[:, right]) < 2e-5
