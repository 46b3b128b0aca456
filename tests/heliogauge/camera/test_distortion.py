"""Brown's distortion: both directions to round-off, NaN where it folds, derivatives."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from heliogauge.camera import brown_polynomial as brown
from heliogauge.camera.distortion import BrownDistortion, DistortionDirection
from heliogauge.errors import InputError

FOCAL_PX = 1500.0


def spread(low, high):
    return st.floats(low, high, allow_subnormal=False)


coefficients = st.tuples(
    spread(-0.4, 0.4), spread(-0.2, 0.2), spread(-5e-3, 5e-3), spread(-5e-3, 5e-3), spread(-0.05, 0.05)
)
directions = st.sampled_from(list(DistortionDirection))


def lens_of(values, direction):
    k1, k2, p1, p2, k3 = values
    return BrownDistortion(k1=k1, k2=k2, k3=k3, p1=p1, p2=p2, direction=direction)


def disc(radius, seed=0, size=400):
    rng = np.random.default_rng(seed)
    angle, r = rng.uniform(0, 2 * np.pi, size), radius * np.sqrt(rng.uniform(0, 1, size))
    return np.stack((r * np.cos(angle), r * np.sin(angle)), axis=-1)


def smallest_eigenvalue(values, xy):
    xx, xy_, yy = brown.derivatives(brown.BrownCoefficients(*values), xy[..., 0], xy[..., 1])
    return 0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy_)


@given(coefficients, directions)
def test_the_two_directions_are_inverse_to_1e_10_px(values, direction):
    lens = lens_of(values, direction)
    argument = disc(min(0.95 * lens.invertible_radius, 1.3))
    if direction is DistortionDirection.IDEAL_TO_MEASURED:
        image, back = lens.distort(argument), lens.undistort(lens.distort(argument))
        again = lens.distort(back)
    else:
        image, back = lens.undistort(argument), lens.distort(lens.undistort(argument))
        again = lens.undistort(back)
    np.testing.assert_allclose(back, argument, atol=1e-10 / FOCAL_PX, rtol=0)
    np.testing.assert_allclose(again, image, atol=1e-10 / FOCAL_PX, rtol=0)


@given(coefficients)
def test_the_inverse_is_either_right_or_not_a_number(values):
    lens = lens_of(values, DistortionDirection.IDEAL_TO_MEASURED)
    measured = disc(3.0)
    ideal = lens.undistort(measured)
    found = np.isfinite(ideal).all(axis=-1)
    assert (np.isnan(ideal).all(axis=-1) == ~found).all()
    assert (np.hypot(*ideal[found].T) < lens.invertible_radius).all()
    np.testing.assert_allclose(lens.distort(ideal[found]), measured[found], atol=1e-10 / FOCAL_PX, rtol=0)


@given(coefficients)
def test_the_inverse_reaches_the_very_edge_of_the_disc(values):
    lens = lens_of(values, DistortionDirection.IDEAL_TO_MEASURED)
    assume(math.isfinite(lens.invertible_radius))
    angle = np.linspace(0, 2 * np.pi, 100)
    edge = lens.invertible_radius * np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    inside = 0.999 * edge
    np.testing.assert_allclose(lens.distort(lens.undistort(lens.distort(inside))), lens.distort(inside), atol=1e-13)
    assert np.isfinite(lens.undistort(lens.distort(0.999999 * edge))).all()
    assert np.isnan(lens.distort(1.0001 * edge)).all()


@given(coefficients)
def test_the_invertible_radius_is_where_the_derivative_first_degenerates(values):
    radius = lens_of(values, DistortionDirection.MEASURED_TO_IDEAL).invertible_radius
    within = np.concatenate([disc(min(radius, 50.0), size=4000), disc(min(radius, 1.5), size=4000)])
    assert smallest_eigenvalue(values, within * (1 - 1e-9)).min() > -1e-8 * max(1.0, min(radius, 50.0) ** 6)
    if math.isfinite(radius):
        angle = np.linspace(0, 2 * np.pi, 20001)
        ring = radius * np.stack((np.cos(angle), np.sin(angle)), axis=-1)
        size = 1 + np.abs(values) @ radius ** np.array([2.0, 4, 1, 1, 6])
        assert abs(smallest_eigenvalue(values, ring).min()) < 1e-6 * size


@pytest.mark.parametrize(
    ("values", "radius"),
    [
        ((-1 / 3, 0, 0, 0, 0), 1.0),  # 1 + 3 k1 r^2 = 0
        ((0, -1 / 5, 0, 0, 0), 1.0),  # 1 + 5 k2 r^4 = 0
        ((0, 0, 0, 0, -1 / 7), 1.0),
        ((0, 0, 0.125, 0, 0), 4 / 3),  # 1 - 6 p1 r = 0
        ((0, 0, 0, 0, 0), math.inf),
        ((0.2, 0, 0, 0, 0), math.inf),
    ],
)
def test_the_invertible_radius_by_hand(values, radius):
    lens = lens_of(values, DistortionDirection.IDEAL_TO_MEASURED)
    assert lens.invertible_radius == pytest.approx(radius, rel=1e-12)


def test_a_lens_that_folds_in_the_image_would_have_two_answers():
    # Negative control: without the limit the polynomial sends 0.9 and 1.1 nearly to the same place.
    lens = BrownDistortion(k1=-1 / 3)
    bare = brown.evaluate(lens.polynomial, np.array([0.9, 1.1]), np.zeros(2))[0]
    assert abs(bare[0] - bare[1]) < 0.01
    assert np.isfinite(lens.distort([[0.9, 0], [1.1, 0]])).all(axis=1).tolist() == [True, False]


@given(coefficients, directions)
def test_jacobians_against_central_differences(values, direction):
    lens = lens_of(values, direction)
    argument = disc(min(0.8 * lens.invertible_radius, 0.9), size=20)
    other = lens.undistort if direction is DistortionDirection.MEASURED_TO_IDEAL else lens.distort
    image = other(argument)
    ideal, measured = (image, argument) if direction is DistortionDirection.MEASURED_TO_IDEAL else (argument, image)
    for name, point in (("distort", ideal), ("undistort", measured)):
        value, d_xy, d_coefficients = getattr(lens, f"{name}_with_jacobians")(point)
        np.testing.assert_array_equal(value, getattr(lens, name)(point))
        step = 1e-6
        for column in range(2):
            move = step * np.eye(2)[column]
            numeric = (getattr(lens, name)(point + move) - getattr(lens, name)(point - move)) / (2 * step)
            np.testing.assert_allclose(d_xy[..., column], numeric, atol=2e-7 * np.abs(d_xy).max())
        for column in range(5):
            move = step * np.eye(5)[column]
            plus = getattr(lens.with_coefficients(lens.coefficients + move), name)(point)
            minus = getattr(lens.with_coefficients(lens.coefficients - move), name)(point)
            scale = np.abs(d_coefficients[..., column]).max()
            np.testing.assert_allclose(
                d_coefficients[..., column], (plus - minus) / (2 * step), atol=1e-6 * scale + 1e-9
            )


def test_jacobians_of_a_perfect_lens_have_true_zeros():
    _, d_xy, _ = BrownDistortion().distort_with_jacobians(disc(0.5))
    assert (d_xy == np.eye(2)).all()


def test_the_photogrammetric_equation_term_by_term():
    # Owkes (2012) eq. 5.22 with P1 = p2 and P2 = p1, written out.
    k1, k2, k3, p1, p2 = 0.1, -0.05, 0.01, 2e-3, -3e-3
    x, y = 0.3, -0.2
    rr = x * x + y * y
    radial = k1 * rr + k2 * rr**2 + k3 * rr**3
    expected = (
        x + x * radial + p2 * (rr + 2 * x * x) + 2 * p1 * x * y,
        y + y * radial + p1 * (rr + 2 * y * y) + 2 * p2 * x * y,
    )
    lens = BrownDistortion(k1=k1, k2=k2, k3=k3, p1=p1, p2=p2, direction=DistortionDirection.MEASURED_TO_IDEAL)
    np.testing.assert_allclose(lens.undistort([x, y]), expected, rtol=1e-15)


def test_values_do_not_depend_on_the_blocks():
    lens = BrownDistortion(k1=-0.25, k2=0.1, p1=1e-3, p2=-2e-3)
    points = disc(0.8, size=2 * brown.BLOCK + 3)
    together = lens.undistort(points)
    np.testing.assert_allclose(lens.undistort(points[-1]), together[-1], atol=1e-15)
    np.testing.assert_allclose(lens.undistort(points[brown.BLOCK]), together[brown.BLOCK], atol=1e-15)
    assert lens.undistort(points.reshape(1, -1, 2)).shape == (1, points.shape[0], 2)
    assert lens.undistort(np.zeros((0, 2))).shape == (0, 2)


def test_one_bad_point_leaves_its_neighbours_alone():
    lens = BrownDistortion(k1=-0.25, k2=0.1, p1=1e-3)
    points = disc(0.5, size=50)
    expected = lens.undistort(points)
    points[7], points[9] = np.nan, (np.inf, 0.0)
    result = lens.undistort(points)
    assert np.isnan(result[[7, 9]]).all()
    kept = np.delete(np.arange(50), [7, 9])
    np.testing.assert_allclose(result[kept], expected[kept], atol=1e-15)


def test_undistortion_agrees_with_opencv_run_to_its_limit():
    lens = BrownDistortion(k1=-0.25, k2=0.12, k3=-0.02, p1=1e-3, p2=-5e-4)
    measured = disc(0.55)
    reference = cv2.undistortPoints(
        measured[:, None], np.eye(3), lens.coefficients, None, None, None, (3, 5000, 1e-15)
    )[:, 0]
    np.testing.assert_allclose(lens.undistort(measured), reference, atol=2e-15)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"k1": math.nan}, "k1: a finite distortion coefficient is needed, not nan"),
        ({"direction": "backwards"}, "one of ideal_to_measured, measured_to_ideal is needed, not 'backwards'"),
    ],
)
def test_impossible_lenses_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        BrownDistortion(**arguments)


@pytest.mark.parametrize("points", [[1.0, 2.0, 3.0], 4.0, "ab", [["a", "b"]]])
def test_impossible_points_are_refused(points):
    with pytest.raises(InputError, match=r"ideal_xy: .*\(\.\.\., 2\) (is|are) needed"):
        BrownDistortion().distort(points)


@pytest.mark.parametrize("tiny", [1e-53, 1e-200, 5e-324])
def test_tiny_coefficients_change_nothing(tiny):
    # The roots of a polynomial with such a term overflow, or are all wrong, when it is solved naively.
    for place in range(5):
        values = np.array([-1 / 3, 0, 0, 0, 0])
        values[place] += tiny
        assert lens_of(values, DistortionDirection.IDEAL_TO_MEASURED).invertible_radius == pytest.approx(1, rel=1e-9)
        alone = tiny * np.eye(5)[place]
        assert math.isinf(lens_of(alone, DistortionDirection.IDEAL_TO_MEASURED).invertible_radius)
