"""Lines of sight by way of the mirror: closed forms, derivatives, the repaired sign of a displaced absorber."""

from dataclasses import replace

import numpy as np
import pytest

from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector, ls2
from observer.trough.observation_equation import Sights, beside_axis, misfit, misfit_with_slopes

LS2 = ls2()
RADIUS_M = LS2.absorber_diameter_m / 2


def mirror_points(x_m: np.ndarray, y_m: np.ndarray, collector: Collector = LS2) -> np.ndarray:
    return np.stack([x_m, y_m, x_m**2 / (4 * collector.focal_length_m)], axis=1)


def random_sights(n: int = 40) -> tuple[Sights, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-2.4, 2.4, n), rng.uniform(-3, 3, n)
    eyes = np.stack([1.1 * x, rng.uniform(-1, 1, n), np.full(n, 15.0)], axis=1)
    side = np.where(rng.random(n) < 0.5, 1.0, -1.0)
    slope_x = x / (2 * LS2.focal_length_m) + rng.normal(0, 3e-3, n)
    return Sights(mirror_points(x, y), eyes, side), slope_x, rng.normal(0, 2e-3, n)


def test_perfect_mirror_shows_both_edges_half_the_acceptance_angle_beside_the_axis() -> None:
    # A camera far away under the angle Phi sees the edge where Phi = +-asin(r / d) (Owkes 2012, eq. 5.4).
    x = np.linspace(-2.4, 2.4, 7)
    points = mirror_points(x, np.zeros(7))
    reach = np.hypot(x, LS2.focal_length_m - points[:, 2])
    absorber = AbsorberPath.straight(0.0, LS2.focal_length_m, 4.0)
    for side in (1.0, -1.0):
        phi = side * np.arcsin(RADIUS_M / reach)
        eyes = points + 1e3 * np.stack([np.sin(phi), np.zeros(7), np.cos(phi)], axis=1)
        found = misfit(Sights(points, eyes, np.full(7, side)), (x / (2 * 1.49), np.zeros(7)), absorber, RADIUS_M)
        np.testing.assert_allclose(found.angle_rad, 0.0, atol=1e-12)


def test_longitudinal_place_of_the_camera_does_not_matter_without_slope_along_the_trough() -> None:
    sights, slope_x, _ = random_sights()
    absorber = AbsorberPath.straight(0.0, LS2.focal_length_m, 9.0)
    zero = np.zeros_like(slope_x)
    here = misfit(sights, (slope_x, zero), absorber, RADIUS_M)
    moved = replace(sights, eyes_m=sights.eyes_m + [0.0, 3.0, 0.0])
    np.testing.assert_allclose(misfit(moved, (slope_x, zero), absorber, RADIUS_M).angle_rad, here.angle_rad, atol=1e-12)


def test_displaced_absorber_looks_like_half_the_change_of_its_direction() -> None:
    # theta_a = (beta_0 - beta) / 2: the middle of both edges moves by 2 theta_a (the thesis prints the other sign).
    x = np.array([-2.0, -0.7, 0.4, 1.9])
    points = mirror_points(x, np.zeros(4))
    moved = AbsorberPath.straight(0.003, LS2.focal_length_m - 0.005, 4.0)
    beta_0 = np.arctan2(-x, LS2.focal_length_m - points[:, 2])
    beta = np.arctan2(0.003 - x, LS2.focal_length_m - 0.005 - points[:, 2])
    phi = beta_0 - beta
    eyes = points + 1e3 * np.stack([np.sin(phi), np.zeros(4), np.cos(phi)], axis=1)
    angles = [
        misfit(Sights(points, eyes, np.full(4, side)), (x / (2 * 1.49), np.zeros(4)), moved, RADIUS_M).angle_rad
        for side in (1.0, -1.0)
    ]
    np.testing.assert_allclose(angles[0] + angles[1], 0.0, atol=1e-12)


def leaning_tube(x_m: float, z_m: float, lean: float) -> AbsorberPath:
    ends = np.array([-9.0, 9.0])
    return AbsorberPath(ends, x_m + lean * ends, z_m - 0.5 * lean * ends, np.zeros((4, 4)))


@pytest.mark.parametrize("lean", [0.0, 8e-3])
def test_derivatives_are_those_of_differences(lean: float) -> None:
    sights, slope_x, slope_y = random_sights()
    absorber, h = leaning_tube(0.003, 1.485, lean), 1e-6
    found = misfit(sights, (slope_x, slope_y), absorber, RADIUS_M)

    def change(plus: np.ndarray, minus: np.ndarray) -> np.ndarray:
        return (plus - minus) / (2 * h)

    def at(**new: object) -> np.ndarray:
        kept = {"sights": sights, "slopes": (slope_x, slope_y), "absorber": absorber, "radius_m": RADIUS_M} | new
        return misfit(**kept).angle_rad  # type: ignore[arg-type]

    near = {"rtol": 0, "atol": 2e-9}
    np.testing.assert_allclose(
        found.d_angle_d_slope_x, change(at(slopes=(slope_x + h, slope_y)), at(slopes=(slope_x - h, slope_y))), **near
    )
    np.testing.assert_allclose(
        found.d_angle_d_slope_y, change(at(slopes=(slope_x, slope_y + h)), at(slopes=(slope_x, slope_y - h))), **near
    )
    for axis in range(3):
        step = h * np.eye(3)[axis]
        plus, minus = (replace(sights, eyes_m=sights.eyes_m + sign * step) for sign in (1, -1))
        np.testing.assert_allclose(found.d_angle_d_eye[:, axis], change(at(sights=plus), at(sights=minus)), **near)
    for axis in range(2):
        step = h * np.eye(2)[axis]
        plus, minus = (leaning_tube(0.003 + sign * step[0], 1.485 + sign * step[1], lean) for sign in (1, -1))
        np.testing.assert_allclose(
            found.d_angle_d_absorber[:, axis], change(at(absorber=plus), at(absorber=minus)), **near
        )
    np.testing.assert_allclose(
        found.d_angle_d_radius, change(at(radius_m=RADIUS_M + h), at(radius_m=RADIUS_M - h)), **near
    )


def test_misfit_with_slopes_is_that_with_all_derivatives() -> None:
    sights, slope_x, slope_y = random_sights()
    absorber = AbsorberPath.straight(0.003, 1.485, 9.0)
    found = misfit(sights, (slope_x, slope_y), absorber, RADIUS_M)
    angle, by_x, by_y = misfit_with_slopes(sights, (slope_x, slope_y), absorber, RADIUS_M)
    np.testing.assert_allclose(angle, found.angle_rad, rtol=1e-14)
    np.testing.assert_allclose(by_x, found.d_angle_d_slope_x, rtol=1e-14)
    np.testing.assert_allclose(by_y, found.d_angle_d_slope_y, rtol=1e-14)


def test_angle_beside_the_axis_and_half_the_width_are_the_misfits_of_both_edges() -> None:
    sights, slope_x, _ = random_sights()
    absorber = AbsorberPath.straight(3e-3, LS2.focal_length_m - 5e-3, 4.0)
    angle, half, passing, _, _ = beside_axis(sights, slope_x, absorber, RADIUS_M)
    for side in (1.0, -1.0):
        one = Sights(sights.points_m, sights.eyes_m, np.full(angle.size, side))
        found = misfit(one, (slope_x, np.zeros_like(slope_x)), absorber, RADIUS_M)
        np.testing.assert_allclose(angle + side * half, found.angle_rad, atol=1e-13)
        np.testing.assert_allclose(passing, found.passing_y_m, atol=1e-12)


def test_a_ray_that_goes_down_has_no_angle() -> None:
    sights = Sights(np.array([[0.0, 0, 0]]), np.array([[0.0, 0, 15.0]]), np.ones(1))
    found = misfit(sights, (np.array([1.5]), np.zeros(1)), AbsorberPath.straight(0, 1.49, 4), RADIUS_M)
    assert np.isnan(found.angle_rad).all()


def test_width_of_the_reflection_hardly_changes_for_a_displaced_absorber() -> None:
    # Owkes (2012), section 5.3: 3.5 cm on an LS-2 changes the width of the reflection by at most 1.5 cm; at 15 m a
    # milliradian of the window is 14 mm of the camera's path and the mirror sees it under 1 / 14 m.
    x = np.linspace(-2.4, 2.4, 9)
    points = mirror_points(x, np.zeros(9))

    def half(x_a: float, z_a: float) -> np.ndarray:
        return np.arcsin(RADIUS_M / np.hypot(x_a - points[:, 0], z_a - points[:, 2]))

    widths = [2 * 14.0 * half(dx, 1.49 + dz) for dx, dz in ((0, 0), (0.035, 0), (-0.035, 0), (0, 0.035), (0, -0.035))]
    assert max(np.abs(one - widths[0]).max() for one in widths[1:]) == pytest.approx(0.0155, abs=0.002)


def test_width_of_the_reflection_hardly_tells_where_the_absorber_is() -> None:
    """Owkes 2012, sec. 5.3: an LS-2's absorber moved by 35 mm changes the width by at most 15 mm (from some 13 m)."""
    trough, height_m = ls2(), 13.0
    x = np.linspace(-2.4, 2.4, 25)
    slope = x / (2 * trough.focal_length_m)
    points = np.stack([x, np.zeros(x.size), 0.5 * x * slope], axis=1)
    sights = Sights(points, np.tile([0.0, 0.0, height_m], (x.size, 1)), np.zeros(x.size))

    def width_rad(moved_x_m: float, moved_z_m: float) -> np.ndarray:
        path = AbsorberPath.straight(moved_x_m, trough.focal_length_m + moved_z_m, trough.length_m / 2)
        return 2 * beside_axis(sights, slope, path, trough.absorber_diameter_m / 2).half_rad

    usual = width_rad(0, 0)
    np.testing.assert_allclose(usual, 2 * np.arcsin(0.035 / np.hypot(x, 1.49 - points[:, 2])), rtol=1e-12)
    turns = np.radians(np.arange(0, 360, 15))
    most = max(np.abs(width_rad(0.035 * np.cos(turn), 0.035 * np.sin(turn)) - usual).max() for turn in turns)
    assert 1.1e-3 < most < 1.15e-3
    assert most * height_m < 0.015
