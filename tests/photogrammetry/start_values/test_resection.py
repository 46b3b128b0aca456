"""Resection and relative orientation: exact, robust, and honest about what they cannot tell."""

import numpy as np
import pytest

from heliogauge.errors import EstimationError
from photogrammetry.start_values.relative_pose import SharedTargets, parallax_rad, relate
from photogrammetry.start_values.resection import resect, spans_an_area
from photogrammetry.start_values.triangulation import intersect_lines
from tests.photogrammetry.bundle_networks import camera_of, look_at, network


def seen(n=20, seed=0, sigma_px=0.1, flat=False):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (n, 3)) * [1, 1, 0 if flat else 0.5]
    pose = look_at(np.array([1.0, -2.0, 4.0]), [0, 0, 0], 0.7)
    camera = camera_of()
    pixels = camera.project(pose.apply(points)) + rng.normal(0, sigma_px, (n, 2))
    return rng, camera, pose, points, pixels, np.broadcast_to(np.eye(2) * sigma_px**2, (n, 2, 2))


def turn_between(a, b):
    return np.linalg.norm((a @ b.inverse()).rotation_vector_rad)


@pytest.mark.parametrize("flat", [False, True])
def test_pose_and_its_covariance(flat):
    chi = []
    for seed in range(60):
        _, camera, pose, points, pixels, covariance = seen(seed=seed, flat=flat)
        found = resect(camera, points, pixels, covariance)
        step = found.cam_from_world @ pose.inverse()
        shift = found.cam_from_world.translation_m - pose.translation_m
        error = np.concatenate([step.rotation_vector_rad, shift])
        chi.append(error @ np.linalg.solve(found.covariance, error))
        assert found.inliers.mean() > 0.9
    # Chi-square with 6 degrees of freedom; the mean of 60 has a sigma of 0.45.
    assert np.mean(chi) == pytest.approx(6.0, abs=1.5)


def test_a_third_of_the_targets_false():
    rng, camera, pose, points, pixels, covariance = seen(30)
    bad = rng.choice(30, 10, replace=False)
    spoiled = pixels.copy()
    spoiled[bad] = rng.uniform([0, 0], [6000, 4000], (10, 2))
    found = resect(camera, points, spoiled, covariance)
    assert set(np.nonzero(~found.inliers)[0]) == set(bad.tolist())
    assert turn_between(found.cam_from_world, pose) < 1e-3


def test_too_few_or_nonsense():
    rng, camera, _, points, pixels, covariance = seen(30)
    with pytest.raises(EstimationError, match="3 targets"):
        resect(camera, points[:3], pixels[:3], covariance[:3])
    with pytest.raises(EstimationError, match="agree"):
        resect(camera, points[:8], rng.uniform([0, 0], [6000, 4000], (8, 2)), covariance[:8])
    line = np.outer(np.arange(8.0), [1, 0.5, 0.2])
    with pytest.raises(EstimationError, match="no pose"):
        resect(camera, line, pixels[:8], covariance[:8])


def test_small_far_plane_has_a_rival():
    camera = camera_of()
    pose = look_at(np.array([0.0, 3.0, 40.0]), [0, 0, 0])
    square = np.array([[-0.1, -0.1, 0], [0.1, -0.1, 0], [0.1, 0.1, 0], [-0.1, 0.1, 0]])
    found = resect(camera, square, camera.project(pose.apply(square)), np.broadcast_to(np.eye(2), (4, 2, 2)))
    assert found.rival < 1.5


@pytest.mark.parametrize("flat", [False, True], ids=["space", "plane"])
def test_relative_pose(flat):
    _, camera, first, points, _, covariance = seen(40, flat=flat)
    rng = np.random.default_rng(3)
    second = look_at(np.array([-2.0, -1.0, 3.5]), [0, 0, 0], -0.4)
    pixels = np.stack([camera.project(pose.apply(points)) for pose in (first, second)])
    pixels += rng.normal(0, 0.1, pixels.shape)
    solutions = relate(SharedTargets((camera, camera), pixels, np.stack([covariance, covariance])))
    truth = second @ first.inverse()
    direction = truth.translation_m / np.linalg.norm(truth.translation_m)
    fits = [
        turn_between(one.second_from_first, truth) < 2e-3
        and np.linalg.norm(one.second_from_first.translation_m - direction) < 5e-3
        for one in solutions
    ]
    assert any(fits)
    if not flat:
        assert fits[0]
        assert solutions[0].inliers.all()
    # A plane has two solutions that fit equally well; the right one must be among the good ones.
    assert solutions[fits.index(True)].misfit < 2 * solutions[0].misfit + 0.5


def test_parallax_is_that_of_the_rays():
    truth, _ = network(np.random.default_rng(0), 4, 30)
    rays = [truth.cam_from_world(i).apply(truth.points_m) for i in (0, 1)]
    rays = np.stack([ray / np.linalg.norm(ray, axis=1, keepdims=True) for ray in rays])
    assert parallax_rad(rays) > 0.02
    assert parallax_rad(np.stack([rays[0], rays[0] @ truth.rotations[2].T])) < 1e-12


def test_lines_meet_and_false_lines_do_no_harm():
    rng = np.random.default_rng(1)
    points = rng.uniform(-1, 1, (10, 3))
    origins = np.array([[5.0, 0, 1], [0, 5, 1], [-5, 0, 1], [0, -5, 2], [4, 4, 3]])
    place = np.tile(np.arange(10), 5)
    starts = np.repeat(origins, 10, axis=0)
    directions = points[place] - starts
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    found = intersect_lines(starts, directions, np.full(50, 1e-4), place, 11)
    np.testing.assert_allclose(found.points_m[:10], points, atol=1e-7)
    assert not found.found[10]
    spoiled = directions.copy()
    spoiled[0] = [-0.9, 0.1, -np.sqrt(1 - 0.82)]
    again = intersect_lines(starts, spoiled, np.full(50, 1e-4), place, 11)
    np.testing.assert_allclose(again.points_m[0], points[0], atol=1e-3)
    one = intersect_lines(starts[:10], directions[:10], np.full(10, 1e-4), place[:10], 10)
    assert not one.found.any()


def test_one_rim_tells_no_pose() -> None:
    rng = np.random.default_rng(0)
    y = np.linspace(-1.5, 1.5, 6)
    rim = np.stack([np.full(6, 2.6), y, np.full(6, 1.0)], axis=1) + 1e-3 * rng.standard_normal((6, 3))
    assert not spans_an_area(rim)
    assert spans_an_area(np.concatenate([rim, rim[:1] * [-1, 1, 1]]))
    assert not spans_an_area(rim[:2])
