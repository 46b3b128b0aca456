"""Surfaces: closed forms, exact transforms, flat limits, intersections, facets."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import (
    Facet,
    Quadric,
    cylinder,
    facet_on_optic,
    paraboloid,
    paraboloid_xy,
    plane,
    quadric,
    sphere,
    trough,
)

X, Y = np.random.default_rng(5).uniform(-1, 1, (2, 400))
DESIGNS = {
    "plane": (plane(), lambda x, y: 0 * x),
    "paraboloid": (paraboloid(3.0), lambda x, y: (x**2 + y**2) / 12),
    "astigmatic": (paraboloid_xy(3.0, -5.0), lambda x, y: x**2 / 12 - y**2 / 20),
    "trough": (trough(1.71), lambda x, y: x**2 / 6.84),
    "sphere": (sphere(4.0), lambda x, y: 4 - np.sqrt(16 - x**2 - y**2)),
    "convex sphere": (sphere(-4.0), lambda x, y: np.sqrt(16 - x**2 - y**2) - 4),
    "cylinder": (cylinder(4.0), lambda x, y: 4 - np.sqrt(16 - x**2)),
    "quadric": (
        quadric([0.1, 0.2, 0.03, -0.04, 0.05, 0.6]),
        lambda x, y: 0.1 * x**2 + 0.2 * y**2 + 0.03 * x - 0.04 * y + 0.05 * x * y + 0.6,
    ),
}
every_design = pytest.mark.parametrize(("design", "formula"), DESIGNS.values(), ids=DESIGNS.keys())


@every_design
def test_height_is_the_closed_form(design, formula):
    np.testing.assert_allclose(design.height(X, Y), formula(X, Y), rtol=0, atol=3e-16 * 4)


@every_design
def test_gradient_is_the_derivative_of_the_closed_form(design, formula):
    step = 1e-5
    slope_x, slope_y = design.gradient(X, Y)
    np.testing.assert_allclose(slope_x, (formula(X + step, Y) - formula(X - step, Y)) / (2 * step), rtol=0, atol=5e-11)
    np.testing.assert_allclose(slope_y, (formula(X, Y + step) - formula(X, Y - step)) / (2 * step), rtol=0, atol=5e-11)


def test_a_trough_has_no_slope_along_itself_and_a_plane_none_at_all():
    assert not trough(1.0).gradient(X, Y)[1].any()
    assert not cylinder(9.0).gradient(X, Y)[1].any()
    assert not np.any(plane().gradient(X, Y))


@every_design
def test_the_normal_is_a_unit_vector_on_the_upper_side_across_the_slope(design, formula):
    normals = design.normal(X, Y)
    slope_x, slope_y = design.gradient(X, Y)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1, rtol=0, atol=1e-15)
    assert (normals[:, 2] > 0).all()
    np.testing.assert_allclose(normals[:, 0] + slope_x * normals[:, 2], 0, rtol=0, atol=1e-15)
    np.testing.assert_allclose(normals[:, 1] + slope_y * normals[:, 2], 0, rtol=0, atol=1e-15)


@pytest.mark.parametrize("make", [paraboloid, sphere, trough, cylinder])
def test_flat_limit_has_no_loss(make):
    # A textbook root (-b + sqrt(b^2 - 4 a c)) / 2a loses all digits here: height 1e-16 relative to radius 1e8
    for length in (1e2, 1e4, 1e8):
        expected = make(1.0).height(1e-3, 0.0) / length  # small slope: z scales with 1 / length
        np.testing.assert_allclose(make(length).height(1e-3, 0.0), expected, rtol=1e-6)
    assert make(np.inf).height(0.7, 0.3) == 0
    assert not np.any(make(np.inf).gradient(0.7, 0.3))


def pose(seed):
    rng = np.random.default_rng(seed)
    return RigidTransform.from_rotation_vector(rng.uniform(-0.4, 0.4, 3), rng.uniform(-1, 1, 3))


@given(st.integers(0, 10**6), st.sampled_from(sorted(DESIGNS)))
def test_a_transformed_surface_is_the_same_set_of_points(seed, name):
    design, formula = DESIGNS[name]
    b_from_a = pose(seed)
    moved = design.transformed(b_from_a)
    points = np.stack([0.3 * X, 0.3 * Y, formula(0.3 * X, 0.3 * Y)], -1)
    there = b_from_a.apply(points)
    np.testing.assert_allclose(moved.height(there[:, 0], there[:, 1]), there[:, 2], rtol=0, atol=1e-13)
    normals = b_from_a.rotate(design.normal(0.3 * X, 0.3 * Y))
    np.testing.assert_allclose(moved.normal(there[:, 0], there[:, 1]), normals, rtol=0, atol=1e-13)
    back = moved.transformed(b_from_a.inverse())
    np.testing.assert_allclose(back.matrix, design.matrix, rtol=0, atol=1e-14)


@pytest.mark.parametrize(("focal_m", "off_m", "slope"), [(10.0, 0.5, 25e-3), (20.0, 0.25, 6.25e-3)])
def test_off_axis_facet_has_its_design_slope_where_its_axes_follow_the_optic(focal_m, off_m, slope):
    # z = r^2 / 4f has slope r / 2f: 25 mrad at 0.5 m for f = 10 m; a facet mounted along its normal sees none
    optic = paraboloid(focal_m)
    along_axis = optic.transformed(facet_on_optic(optic, [off_m, 0], "axis").inverse())
    assert along_axis.height(0, 0) == pytest.approx(0, abs=1e-16)
    np.testing.assert_allclose(along_axis.gradient(0, 0), [slope, 0], rtol=0, atol=1e-16)
    along_normal = optic.transformed(facet_on_optic(optic, [off_m, 0], "normal").inverse())
    np.testing.assert_allclose(along_normal.gradient(0, 0), [0, 0], rtol=0, atol=1e-16)
    # in its own frame the normal-mounted facet is astigmatic: radii 2f/cos^3 in the plane of the turn, 2f/cos across
    cosine = np.cos(np.arctan(slope))
    h = 1e-3
    curvature_x = (along_normal.gradient(h, 0)[0] - along_normal.gradient(-h, 0)[0]) / (2 * h)
    curvature_y = (along_normal.gradient(0, h)[1] - along_normal.gradient(0, -h)[1]) / (2 * h)
    assert curvature_x == pytest.approx(cosine**3 / (2 * focal_m), rel=1e-6)
    assert curvature_y == pytest.approx(cosine / (2 * focal_m), rel=1e-6)


@every_design
def test_lines_meet_the_surface_where_they_were_aimed_from_near_and_from_far(design, formula):
    target = np.stack([X, Y, formula(X, Y)], -1)
    for distance, tolerance in ((3.0, 4e-15), (10.0, 1e-14), (1e3, 1e-12), (1e4, 1e-11)):
        camera = np.array([0.3, -0.2, 1.0]) * distance
        ray = (target - camera) / np.linalg.norm(target - camera, axis=1)[:, None]
        hit = camera + design.intersect(camera, ray)[:, None] * ray
        np.testing.assert_allclose(hit[:, 2], formula(*hit[:, :2].T), rtol=0, atol=tolerance)
        t = design.intersect(camera, target - camera)
        np.testing.assert_allclose(t, 1, rtol=0, atol=1e-10)  # a grazing line fixes its place less well
        np.testing.assert_allclose(design.intersect(camera, camera - target), -t, rtol=1e-14)


@pytest.mark.parametrize("make", [trough, paraboloid, lambda f: sphere(2 * f)])
def test_steeply_tilted_sheets_keep_their_side(make):
    # turned by 60 degrees the other sheet crosses over the facet: roots change their roles, the surface does not
    design = make(1.0)
    b_from_a = RigidTransform.from_rotation_vector([0.0, np.deg2rad(60), 0.0], [0.0, 0.0, 0.0])
    x, y = np.meshgrid(np.linspace(-1.5, 1.0, 41), np.linspace(-0.3, 0.3, 5))
    z = design.height(x, y)
    there = b_from_a.apply(np.stack([x, y, z], -1))
    upright = b_from_a.rotate(design.normal(x, y))[..., 2] > 0.05
    assert upright.sum() > 100
    moved = design.transformed(b_from_a)
    heights = moved.height(there[..., 0], there[..., 1])
    np.testing.assert_allclose(heights[upright], there[..., 2][upright], rtol=0, atol=1e-12)


def test_a_ray_parallel_to_the_plane_z_zero_meets_a_trough_wall():
    t = trough(1.0).intersect([0.0, 0.0, 0.25], [2.0, 0.0, 0.0])
    assert abs(t) == pytest.approx(0.5)
    assert np.isnan(plane().intersect([0.0, 0.0, 1.0], [1.0, 0.0, 0.0]))


def test_lines_that_miss_and_points_outside_are_nan():
    ball = sphere(1.0)
    assert np.isnan(ball.height(1.5, 0.0))
    assert np.isnan(ball.intersect([5.0, 0.0, 5.0], [0.0, 0.0, -1.0]))


def test_a_sphere_is_met_on_the_mirror_not_on_the_near_side_when_seen_from_beyond_its_centre():
    t = sphere(10.0).intersect([0.1, 0.0, 50.0], [0.0, 0.0, -1.0])
    assert 50 - t == pytest.approx(10 - np.sqrt(100 - 0.01), abs=1e-13)


def test_description_names_shape_numbers_and_mounting():
    optic = paraboloid(10.0)
    assert optic.describe() == "paraboloid of focal length 10 m"
    moved = optic.transformed(facet_on_optic(optic, [0.5, 0], "axis").inverse())
    assert "slopes 25, 0 mrad" in moved.describe()


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: paraboloid(0.0), "focal_length_m"),
        (lambda: sphere(np.nan), "radius_m"),
        (lambda: quadric([1, 2, 3]), "coefficients"),
        (lambda: Quadric(np.triu(np.ones((4, 4))), "odd"), "symmetric"),
        (lambda: Quadric(np.diag([1.0, 1, 0, -1]), "upright cylinder"), "no sheet"),
        (lambda: Facet("A", [[0, 0], [0, 1], [1, 0]], plane()), "counter-clockwise"),
        (lambda: Facet("A", [[0, 0], [0, 1]], plane()), "at least 3 corners"),
        (lambda: facet_on_optic(sphere(1.0), [2.0, 0.0]), "no point"),
        (lambda: facet_on_optic(plane(), [0.0, 0.0], "sideways"), "orientation"),
    ],
)
def test_impossible_input_is_refused_by_name(call, words):
    with pytest.raises(InputError, match=words):
        call()


def test_facet_area_centroid_corners_and_inside():
    # an L of 3 unit squares, far from the origin
    shape = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]]) + [1000.0, 2000.0]
    facet = Facet("L", shape, paraboloid(1e6))
    assert facet.area_m2 == pytest.approx(3, abs=1e-12)
    np.testing.assert_allclose(facet.reference_point_m, [1000 + 2.5 / 3, 2000 + 2.5 / 3], rtol=1e-15)
    assert facet.contains([1000.5, 1001.5, 1000.5, 1001.5], [2000.5, 2000.5, 2001.5, 2001.5]).tolist() == [
        True,
        True,
        True,
        False,
    ]
    np.testing.assert_allclose(facet.corners_m[:, 2], (shape**2).sum(1) / 4e6, rtol=1e-12)


def test_neighbouring_facets_share_no_point_and_leave_none_out():
    left = Facet("left", [[0, 0], [1, 0], [1, 1], [0, 1]], plane())
    right = Facet("right", [[1, 0], [2, 0], [2, 1], [1, 1]], plane())
    x, y = np.meshgrid(np.linspace(0, 2, 41)[:-1], np.linspace(0, 1, 21)[:-1])
    assert (left.contains(x, y) ^ right.contains(x, y)).all()
