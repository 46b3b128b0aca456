"""Dots without a code through the poses of a network: all of them, none by accident, with honest covariances."""

from math import comb

import numpy as np
import pytest

from heliogauge.errors import InputError
from photogrammetry.bundle.adjustment import adjust
from photogrammetry.bundle.datum import Datum
from photogrammetry.bundle.problem import BundleProblem, CameraModel
from photogrammetry.matching.uncertain_rays import Dots, KnownViews, known_views
from photogrammetry.matching.uncoded_matching import MatchLimits, chance_agreements, match_dots
from photogrammetry.networks.solve_network import Knowledge, NetworkCameras, SolveOptions, solve_network
from photogrammetry.networks.solve_uncoded import LooseDots, add_dots
from tests.photogrammetry.bundle_networks import network

SIGMA_PX = 0.03


def adjusted(seed: int, *, n_targets: int = 30):
    """An adjusted network of coded targets and its true state in the same frame (the datum's)."""
    truth, table = network(np.random.default_rng(seed), 8, n_targets, sigma_px=SIGMA_PX)
    return adjust(BundleProblem(table, (CameraModel("camera", ("focal_px", "k1")),)), truth), truth


def drawn(truth, points_m, rng, *, false: int = 0, seen=1.0):
    """Dots of points in all photos, with noise, and false ones, in random order; the true point of each or -1."""
    photo, pixels, point = [], [], []
    for index in range(len(truth.rotations)):
        camera = truth.cameras[0]
        places = camera.project(truth.cam_from_world(index).apply(points_m))
        size = np.array([camera.width_px, camera.height_px])
        inside = ((places > 0) & (places < size - 1)).all(axis=1) & (rng.random(len(points_m)) < seen)
        own = np.concatenate([places[inside], rng.uniform(0, 1, (false, 2)) * (size - 1)])
        who = np.concatenate([np.nonzero(inside)[0], np.full(false, -1)])
        order = rng.permutation(len(own))
        photo += [index] * len(own)
        pixels.append((own + SIGMA_PX * rng.standard_normal(own.shape))[order])
        point.append(who[order])
    count = len(photo)
    shapes = np.broadcast_to(np.eye(2) * 16.0, (count, 2, 2))
    covariance = np.broadcast_to(np.eye(2) * SIGMA_PX**2, (count, 2, 2))
    return Dots(np.array(photo), np.concatenate(pixels), covariance, shapes), np.concatenate(point)


def targets_like(truth, count: int, rng) -> np.ndarray:
    low, high = truth.points_m.min(axis=0), truth.points_m.max(axis=0)
    return np.asarray(rng.uniform(0.15, 0.85, (count, 3)) * (high - low) + low)


def test_all_dots_are_matched_and_no_false_one() -> None:
    result, truth = adjusted(1)
    rng = np.random.default_rng(2)
    points = targets_like(truth, 25, rng)
    dots, who = drawn(truth, points, rng, false=20)
    found = match_dots(dots, known_views(result))
    rays = np.bincount(who[who >= 0], minlength=25)
    assert len(found.points_m) == np.count_nonzero(rays >= 3) == 25
    assert (found.point_of_dot[who < 0] < 0).all()
    # Each point holds dots of one true point, and nearly all of them.
    for place in range(25):
        own = who[found.point_of_dot == place]
        assert own.size >= 3
        assert np.unique(own).size == 1
    assert np.count_nonzero(found.point_of_dot >= 0) > 0.98 * np.count_nonzero(who >= 0)


def test_covariance_is_the_scatter() -> None:
    """With few coded targets the poses are more uncertain than the dots; the datum is that of the true coordinates."""
    total, count = 0.0, 0
    for seed in range(25):
        result, truth = adjusted(10 + seed, n_targets=10)
        rng = np.random.default_rng(100 + seed)
        points = targets_like(truth, 4, rng)
        dots, who = drawn(truth, points, rng)
        found = match_dots(dots, known_views(result))
        true = np.array([who[found.point_of_dot == place][0] for place in range(len(found.points_m))])
        error = found.points_m - points[true]
        total += float(np.einsum("ni,nij,nj->", error, np.linalg.inv(found.covariance_m2), error))
        count += error.size
    assert count >= 250
    # Points of one network share the errors of its poses: worth about a third as many.
    assert abs(total / count - 1) < 4 * np.sqrt(2 / (count / 3))


def test_two_rays_stand_alone_only_where_nothing_else_explains_them() -> None:
    result, truth = adjusted(3)
    rng = np.random.default_rng(4)
    points = targets_like(truth, 1, rng)
    dots, _ = drawn(truth, points, rng)
    two = np.isin(dots.photo_index, (0, 2))
    few = Dots(dots.photo_index[two], dots.pixels_px[two], dots.covariance_px2[two], dots.ellipses_px2[two])
    found = match_dots(few, known_views(result))
    assert len(found.points_m) == 0
    assert "other photos should show it and do not" in found.rejected[0].reason
    allowed = match_dots(few, known_views(result), MatchLimits(most_missing=6))
    assert np.linalg.norm(allowed.points_m[0] - points[0]) < 6 * np.sqrt(np.trace(allowed.covariance_m2[0]))
    # Many dots along the line: two rays say nothing.
    crowd = np.random.default_rng(5).uniform(0, 1, (400, 2)) * (truth.cameras[0].width_px - 1, 700)
    many = Dots(
        np.concatenate([few.photo_index, np.full(400, 2)]),
        np.concatenate([few.pixels_px, crowd]),
        np.broadcast_to(np.eye(2) * 0.01, (402, 2, 2)),
        np.broadcast_to(np.eye(2) * 16.0, (402, 2, 2)),
    )
    crowded = match_dots(many, known_views(result), MatchLimits(most_missing=6))
    assert len(crowded.points_m) == 0
    assert any("partners" in one.reason or "by accident" in one.reason for one in crowded.rejected)


def test_noise_alone_gives_no_points() -> None:
    result, truth = adjusted(6)
    dots, _ = drawn(truth, np.zeros((0, 3)), np.random.default_rng(7), false=60)
    assert len(match_dots(dots, known_views(result)).points_m) == 0


def test_no_dots_and_strange_photos() -> None:
    result, _ = adjusted(8)
    none = Dots(np.zeros(0, dtype=int), np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2, 2)))
    assert len(match_dots(none, known_views(result)).points_m) == 0
    strange = Dots(np.array([99]), np.ones((1, 2)), np.eye(2)[None], np.eye(2)[None])
    with pytest.raises(InputError, match="photo 99 is not among the 8 views"):
        match_dots(strange, known_views(result))
    with pytest.raises(InputError, match="match limits"):
        MatchLimits(significance=1.0)
    assert isinstance(known_views(result), KnownViews)


def test_a_dot_displaced_in_some_photos_is_no_second_point() -> None:
    """Glare or a cover moves a centre alike in three photos: the two places are nearer than the dot is large."""
    truth, table = network(np.random.default_rng(3), 8, 30, sigma_px=SIGMA_PX)
    points = targets_like(truth, 3, np.random.default_rng(4))
    depth = float(np.mean([truth.cam_from_world(k).apply(points[0])[2] for k in range(8)]))
    shift = 1.0 * depth / truth.cameras[0].focal_x_px * np.array([1.0, 0.0, 0.0])
    real, _ = drawn(truth, points, np.random.default_rng(5))
    moved, _ = drawn(truth, points[:1] + shift, np.random.default_rng(6))
    odd = real.photo_index < 3
    nearest = np.array(
        [
            np.argmin(np.linalg.norm(real.pixels_px - moved.pixels_px[k], axis=1) + 1e9 * (real.photo_index != photo))
            for k, photo in enumerate(moved.photo_index)
        ]
    )
    pixels = np.array(real.pixels_px)
    for k, row in enumerate(nearest):
        if odd[row]:
            pixels[row] = moved.pixels_px[k]
    dots = Dots(real.photo_index, pixels, real.covariance_px2, real.ellipses_px2)
    free = (CameraModel("camera", ("focal_px", "k1")),)
    cameras = NetworkCameras(truth.cameras, free, dict.fromkeys(table.photos, 0))
    knowledge = Knowledge((), {}, Datum())
    nothing = np.full((table.n, 2, 2), np.nan)
    first = solve_network(table, nothing, cameras, knowledge, SolveOptions())
    # In the network's own unit of length, radii are the same share of everything.
    found = add_dots(first, table, nothing, LooseDots(table.photos, dots), cameras, knowledge, SolveOptions())
    assert found.names == ("u1", "u2", "u3")
    rays = dict(
        zip(
            found.solved.bundle.problem.observations.targets,
            found.solved.bundle.problem.observations.n_rays.tolist(),
            strict=True,
        )
    )
    assert sorted(rays[name] for name in found.names) == [5, 8, 8]
    assert any(
        "contradict those in 5 others" in one.reason and "covered or in glare" in one.reason for one in found.left
    )


def test_agreements_by_chance_of_a_thousand_photos_are_counted() -> None:
    assert chance_agreements(12, 3, 0.1) == pytest.approx(comb(12, 3) * 0.1**3)
    assert chance_agreements(12, 0, 0.0) == 1.0
    assert chance_agreements(12, 3, 0.0) == chance_agreements(2, 3, 0.5) == 0.0
    # 1e330 sets, of which one in 1e354 agrees.
    assert chance_agreements(1100, 550, 10**-0.645) == pytest.approx(
        10 ** (np.log10(float(comb(1100, 550) // 10**100)) + 100 - 354.75), rel=1e-6
    )
    assert chance_agreements(5000, 2500, 1.0) > 1e300
