"""The synthetic mirror against closed forms: focal points, centres of curvature, images in a plane."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from data_synth.optics.mirror import Design, SyntheticFacet, reflect
from data_synth.optics.surface_errors import Polynomial, Ripple, SurfaceErrors
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform

SQUARE = np.array([(-0.6, -0.6), (0.6, -0.6), (0.6, 0.6), (-0.6, 0.6)])


def _points(n=300, half=0.6):
    rng = np.random.default_rng(3)
    return rng.uniform(-half, half, n), rng.uniform(-half, half, n)


@pytest.mark.parametrize(
    ("shape", "lengths", "height"),
    [
        ("plane", {}, lambda x, y: 0 * x),
        ("sphere", {"radius_m": 4.0}, lambda x, y: 4 - np.sqrt(16 - x * x - y * y)),
        ("paraboloid", {"focal_length_m": 2.0}, lambda x, y: (x * x + y * y) / 8),
        ("trough", {"focal_length_m": 1.71}, lambda x, y: x * x / 6.84),
        (
            "paraboloid_xy",
            {"focal_length_x_m": 2.0, "focal_length_y_m": 3.0},
            lambda x, y: x * x / 8 + y * y / 12,
        ),
    ],
)
def test_heights_of_designs(shape, lengths, height):
    x, y = _points()
    step = 1e-5
    seen, slope_x, slope_y = Design(shape, lengths).evaluate(x, y)
    assert_allclose(seen, height(x, y), atol=1e-15)
    assert_allclose(slope_x, (height(x + step, y) - height(x - step, y)) / (2 * step), atol=1e-9)
    assert_allclose(slope_y, (height(x, y + step) - height(x, y - step)) / (2 * step), atol=1e-9)


def test_off_axis_facet_parallel_to_the_optic_is_the_optic_shifted():
    design = Design.on_optic("paraboloid", {"focal_length_m": 10.0}, (0.5, -0.2), orientation="axis")
    x, y = _points()
    height, slope_x, slope_y = design.evaluate(x, y)
    assert_allclose(height, ((x + 0.5) ** 2 + (y - 0.2) ** 2 - 0.29) / 40, atol=1e-15)
    assert_allclose(slope_x, (x + 0.5) / 20, atol=1e-15)
    assert_allclose(slope_y, (y - 0.2) / 20, atol=1e-15)


@pytest.mark.parametrize("orientation", ["axis", "normal"])
@pytest.mark.parametrize(("shape", "focus"), [("paraboloid", (0.0, 0.0)), ("trough", (0.0, None))])
def test_light_along_the_axis_meets_the_focus(shape, focus, orientation):
    design = Design.on_optic(shape, {"focal_length_m": 1.71}, (1.0, 0.3), orientation=orientation)
    facet = SyntheticFacet("panel", SQUARE, design)
    x, y = _points(half=0.4)
    down = design.optic_from_facet.inverse().rotate([0.0, 0.0, -1.0])
    height, slope_x, slope_y = facet.surface(x, y)
    after = design.optic_from_facet.rotate(reflect(np.broadcast_to(down, (x.size, 3)), slope_x, slope_y))
    start = design.optic_from_facet.apply(np.column_stack([x, y, height]))
    path = (1.71 - start[:, 2]) / after[:, 2]
    hit = start + path[:, None] * after
    for axis, wanted in enumerate(focus):
        if wanted is not None:
            assert_allclose(hit[:, axis], wanted, atol=1e-13)


def test_the_normal_orientation_has_no_slope_at_its_origin():
    design = Design.on_optic("paraboloid", {"focal_length_m": 10.0}, (0.5, 0.0), orientation="normal")
    assert_allclose(design.evaluate(np.array(0.0), np.array(0.0)), 0, atol=1e-15)


def test_light_from_the_centre_of_a_sphere_returns():
    facet = SyntheticFacet("sphere", SQUARE, Design("sphere", {"radius_m": 5.0}))
    x, y = _points()
    center = np.array([0.0, 0.0, 5.0])
    directions = np.column_stack([x, y, np.full(x.size, -5.0)])
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    points, slope_x, slope_y = facet.intersect(center, directions)
    assert_allclose(np.linalg.norm(points - center, axis=1), 5.0, rtol=1e-15)
    assert_allclose(reflect(directions, slope_x, slope_y), -directions, atol=1e-15)


def test_reflection_keeps_length_and_turns_by_twice_the_slope():
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(50, 3))
    after = reflect(directions, rng.normal(size=50), rng.normal(size=50))
    assert_allclose(np.linalg.norm(after, axis=1), np.linalg.norm(directions, axis=1), rtol=1e-14)
    # A surface that rises towards +x throws light from above towards -x.
    turned = reflect(np.array([0.0, 0.0, -1.0]), np.array(np.tan(1e-3)), np.array(0.0))
    assert_allclose(turned, [-np.sin(2e-3), 0, np.cos(2e-3)], atol=1e-16)


def test_rays_meet_the_surface_with_its_errors():
    errors = SurfaceErrors((Ripple(3e-3, 0.15, 0.5), Polynomial([(2, 1, 5e-3)])))
    facet = SyntheticFacet("rough", SQUARE, Design("paraboloid", {"focal_length_m": 3.0}), errors)
    x, y = _points()
    origin = np.array([4.0, 1.0, 8.0])
    directions = np.column_stack([x, y, 0 * x]) - origin
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    points, slope_x, slope_y = facet.intersect(origin, directions)
    height, true_x, true_y = facet.surface(points[:, 0], points[:, 1])
    assert_allclose(points[:, 2], height, atol=1e-15)
    assert_allclose(np.cross(points - origin, directions), 0, atol=1e-13)
    assert_allclose([slope_x, slope_y], [true_x, true_y], atol=1e-15)


def test_outline_inside_and_distance():
    hexagon = np.column_stack([np.cos(np.arange(6) * np.pi / 3), np.sin(np.arange(6) * np.pi / 3)])
    facet = SyntheticFacet("hexagon", hexagon, Design("plane"))
    x, y = np.array([0.0, 0.99, 1.01, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, 0.8, 0.9])
    assert facet.contains(x, y).tolist() == [True, True, False, True, False]
    assert_allclose(facet.distance_inside(x, y)[0], np.sqrt(3) / 2, rtol=1e-12)
    assert_allclose(facet.distance_inside(x, y)[3], np.sqrt(3) / 2 - 0.8, rtol=1e-12)
    assert facet.distance_inside(x, y)[4] == pytest.approx(np.sqrt(3) / 2 - 0.9)


def test_impossible_designs_are_refused():
    with pytest.raises(InputError, match="one of plane"):
        Design("cone")
    with pytest.raises(InputError, match="focal_length_m needed"):
        Design("paraboloid", {"radius_m": 3.0})
    with pytest.raises(InputError, match="not on the surface"):
        Design("paraboloid", {"focal_length_m": 3.0}, RigidTransform(np.eye(3), np.array([1.0, 0.0, 0.0])))
    with pytest.raises(InputError, match='"normal" or "axis"'):
        Design.on_optic("plane", {}, (0.0, 0.0), orientation="up")
    with pytest.raises(InputError, match="no surface over"):
        Design.on_optic("sphere", {"radius_m": 1.0}, (2.0, 0.0))
