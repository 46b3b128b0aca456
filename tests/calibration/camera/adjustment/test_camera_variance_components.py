"""Variance components against the dense formulas of a mixed model, and a camera's sigma with errors of a photo."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.camera.adjustment.mixed_adjustment import MixedAdjustment, Sizes, adjust_mixed
from calibration.camera.adjustment.variance_components import Components, MixedModel, PhotoRows
from calibration.camera.boards import Chessboard
from calibration.camera.corners.detection import BoardPoints
from calibration.camera.judgement.network import check_predictions
from calibration.camera.start_values.board_network import BoardNetwork
from heliogauge.camera.distortion import BrownDistortion
from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform

GROUP = np.array([-1, -1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0])
SIZES = Components(np.array([2.0]), np.array([0.7, 0.7, 1.5]), np.array([1.0, 0.5]))


def small_model() -> tuple[list[PhotoRows], MixedModel]:
    """Two photos of 40 points: two fixed unknowns, a group of six effects in each photo, and the points' own steps."""
    rng = np.random.default_rng(3)
    steps, effects = rng.normal(0, 1, (40, 3)) * SIZES.point, rng.normal(0, 2.0, 12)
    rows = []
    for photo in range(2):
        columns = np.concatenate([[0, 1], 2 + 6 * photo + np.arange(6)])
        jacobian, d_point = rng.normal(0, 1, (40, 2, 8)), rng.normal(0, 1, (40, 2, 3))
        common = np.concatenate([[1.0, -1.0], effects])[columns]
        noise = rng.normal(0, SIZES.noise[photo], (40, 2))
        misfit = jacobian @ common + np.einsum("nia,na->ni", d_point, steps) + noise
        rows.append(PhotoRows(columns, jacobian, np.arange(40), d_point, misfit))
    return rows, MixedModel(rows, GROUP, np.zeros((40, 3)), points_estimated=True)


def dense(rows: list[PhotoRows], sizes: Components) -> tuple[float, np.ndarray, np.ndarray]:
    """Restricted log-likelihood, estimate and covariance of the fixed unknowns, from the covariance of all rows."""
    fixed, parts, variances = np.zeros((160, 2)), [], np.zeros((160, 160))
    for photo, one in enumerate(rows):
        own = slice(80 * photo, 80 * photo + 80)
        flat = one.jacobian.reshape(80, -1)
        fixed[own] = flat[:, :2]
        variances[own, own] += sizes.effects[0] ** 2 * flat[:, 2:] @ flat[:, 2:].T + sizes.noise[photo] ** 2 * np.eye(
            80
        )
        through = np.zeros((80, 120))
        for k, block in enumerate(one.d_point):
            through[2 * k : 2 * k + 2, 3 * k : 3 * k + 3] = block
        parts.append(through)
    through = np.vstack(parts)
    variances += through * np.tile(sizes.point**2, 40) @ through.T
    misfit = np.concatenate([one.misfit.ravel() for one in rows])
    weight = np.linalg.inv(variances)
    covariance = np.linalg.inv(fixed.T @ weight @ fixed)
    estimate = covariance @ fixed.T @ weight @ misfit
    rest = misfit - fixed @ estimate
    logs = np.linalg.slogdet(variances)[1] - np.linalg.slogdet(covariance)[1]
    return -0.5 * float(logs + rest @ weight @ rest), estimate, covariance


def test_unknowns_are_those_of_generalised_least_squares() -> None:
    rows, model = small_model()
    posterior = model.solve(SIZES)
    _, estimate, covariance = dense(rows, SIZES)
    np.testing.assert_allclose(posterior.values[:2], estimate, rtol=1e-8)
    np.testing.assert_allclose(posterior.covariance[:2, :2], covariance, rtol=1e-8)


def test_other_sizes_of_a_group_are_those_of_solving_again() -> None:
    """Covariance with unknown sizes by the same integral, each size solved for by itself; a group has nothing."""
    rows, _ = small_model()
    groups = np.array([-1, -1, 0, 0, 1, 1, 1, 1, 0, 0, 1, 1, 1, 1])
    model = MixedModel(rows, groups, np.zeros((40, 3)), points_estimated=True)
    today = replace(SIZES, effects=np.array([2.0, 1e-3]))
    posterior, columns = model.solve(today), np.arange(2)
    usual = np.array([1.0, 10.0])
    covariance, effects = posterior.with_unknown_sizes(columns, usual)
    total, squares = posterior.covariance[:2, :2].copy(), []
    nodes, shares = np.polynomial.legendre.leggauss(6)
    for group, (sigma, first) in enumerate(
        zip(today.effects, np.maximum(2 * today.effects, 0.05 * usual), strict=True)
    ):
        several = [
            model.solve(replace(today, effects=np.where(np.arange(2) == group, size, today.effects)))
            for size in first * 2.0 ** np.arange(8)
        ]
        unlikely = [one.log_likelihood < posterior.log_likelihood - 4 for one in several]
        sizes = first * 2.0 ** [*unlikely, True].index(True) * 0.5 * (nodes + 1)
        others = [
            model.solve(replace(today, effects=np.where(np.arange(2) == group, size, today.effects))) for size in sizes
        ]
        logs = np.array([one.log_likelihood for one in others])
        weights = shares * np.exp(logs - logs.max()) / np.sum(shares * np.exp(logs - logs.max()))
        moved = [one.values[:2] - posterior.values[:2] for one in others]
        moments = np.array([one.covariance[:2, :2] + np.outer(by, by) for one, by in zip(others, moved, strict=True)])
        excess = np.tensordot(weights, moments, axes=1) - posterior.covariance[:2, :2]
        scale = np.sqrt(np.diag(posterior.covariance)[:2])
        values, vectors = np.linalg.eigh(excess / np.outer(scale, scale))
        total += (vectors * np.maximum(values, 0)) @ vectors.T * np.outer(scale, scale)
        squares.append(max(float(sigma) ** 2, float(weights @ sizes**2)))
    np.testing.assert_allclose(covariance, total, rtol=1e-7)
    np.testing.assert_allclose(effects, np.sqrt(squares), rtol=1e-7)


def test_sizes_are_a_maximum_of_the_restricted_likelihood() -> None:
    rows, model = small_model()
    found = SIZES
    for _ in range(4):
        found = model.settle(found).components
    best = dense(rows, found)[0]
    for k in range(5):
        for factor in (0.9, 1.1):
            effects, point, noise = found.effects.copy(), found.point.copy(), found.noise.copy()
            places = [(effects, [0]), (point, [0, 1]), (point, [2]), (noise, [0]), (noise, [1])]
            array, which = places[k]
            array[which] *= factor
            assert dense(rows, Components(effects, point, noise))[0] < best


def drawn_network(seed: int, bend_px: float) -> tuple[BoardNetwork, Camera]:
    """Eight photos of a bent and stretched board; the points of each are off by a smooth field besides their noise."""
    rng = np.random.default_rng(seed)
    board, camera = Chessboard(9, 6, 0.03), Camera(1600, 1200, 1500.0, 1500.0, 790.0, 610.0, 0.0, BrownDistortion(-0.1))
    drawn = board.points_m
    x, y = (drawn[:, :2] / np.abs(drawn[:, :2]).max(axis=0)).T
    terms = np.stack([x, y, x * x, x * y, y * y], axis=1)
    places = drawn + terms @ rng.normal(0, 1, (5, 3)) * np.array([1e-4, 1e-4, 3e-4])
    photos, poses = [], []
    for i in range(8):
        turn = np.array([[0.0, 0.0, 0.5 * np.pi * (i % 4)], [np.pi, 0.0, 0.0]])
        tilt = 0.55 * np.array([np.cos(2.4 * i), np.sin(2.4 * i), 0.0])
        pose = RigidTransform.from_rotation_vector(tilt, [0, 0, 0.33 + 0.04 * (i % 3)])
        for vector in turn:
            pose = pose @ RigidTransform.from_rotation_vector(vector, np.zeros(3))
        field = terms @ rng.normal(0, bend_px, (5, 2))
        pixels = camera.project(pose.apply(places)) + field + rng.normal(0, 0.01, (54, 2))
        photos.append(BoardPoints(f"{i}", np.arange(54), pixels, np.tile(1e-4 * np.eye(2), (54, 1, 1))))
        poses.append(pose)
    free = ("focal_px", "aspect", "center_x_px", "center_y_px", "k1", "k2")
    return BoardNetwork(board, tuple(photos), free, camera, tuple(poses)), camera


def chi_square_share(found: MixedAdjustment, camera: Camera) -> float:
    chosen = [0, 1, 2, 3, 5, 6]
    error = (found.camera.parameters - camera.parameters)[chosen]
    return float(error @ np.linalg.solve(found.camera.covariance[np.ix_(chosen, chosen)], error)) / 6


@pytest.mark.slow
def test_sigma_counts_what_the_corners_of_a_photo_share() -> None:
    shares, without = [], []
    for seed in range(4):
        # Fields of 0.05 px beside noise of 0.01 px.
        network, camera = drawn_network(seed, 0.05)
        table, start = network.observations(), network.start()
        found = adjust_mixed(network, table, start, refine_board=True)
        shares.append(chi_square_share(found, camera))
        names, sizes = found.sizes
        board = np.array([1.0 if name in ("in plane", "across") else 1e-3 for name in names])
        independent = Sizes(names, replace(sizes, effects=sizes.effects * board))
        plain = adjust_mixed(network, table, found.state, refine_board=True, sizes=independent, settled=True)
        # The camera's own covariance contains that these sizes may be wrong: not so that of the adjustment.
        n_free = len(network.free)
        plain.__dict__["covariance_intrinsics"] = plain.posterior.covariance[:n_free, :n_free]
        without.append(chi_square_share(plain, camera))
    # 24 degrees of freedom: 99.8 % between 0.32 and 2.13.
    assert 0.32 < np.mean(shares) < 2.13
    assert np.mean(without) > 5


def test_a_photo_that_others_contradict_is_named() -> None:
    names, expected = ["a", "b", "c", "d"], np.array([0.012, 0.012, 0.012, 0.012])
    doubts = {one.code: one.text for one in check_predictions(names, np.array([0.01, 0.011, 0.012, 0.116]), expected)}
    assert list(doubts) == ["photos_contradict"]
    assert "d (0.116 px" in doubts["photos_contradict"]
    expected[3] = 0.1
    found = list(check_predictions(names, np.array([0.01, 0.011, 0.012, 0.116]), expected))
    assert [one.code for one in found] == ["photos_stand_alone"]
    assert not list(check_predictions(names, np.full(4, 0.01), expected))
