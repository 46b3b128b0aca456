"""Boards that look the same turned: numbering, and how photos are turned as told by the board's own shape."""

import numpy as np
import pytest

from calibration.camera.boards import Chessboard, CircleGrid, renumbering
from calibration.camera.corners.detection import BoardPoints
from calibration.camera.start_values.orientation import find_orientations
from heliogauge.camera.distortion import BrownDistortion
from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import FloatArray

BOARDS = [
    Chessboard(9, 7, 0.03),
    Chessboard(6, 6, 0.03),
    Chessboard(7, 7, 0.03),
    CircleGrid(10, 7, pitch_known_m=0.03),
    CircleGrid(6, 6, pitch_known_m=0.03),
    CircleGrid(4, 10, asymmetric=True, pitch_known_m=0.04),
]
CAMERA = Camera(960, 720, 906.0, 905.0, 483.0, 355.0, 0.0, BrownDistortion(k1=-0.08, k2=0.05))
NOISE_PX = 0.003


@pytest.mark.parametrize("board", BOARDS, ids=lambda board: board.describe())
def test_renumbering_turns_the_board(board: Chessboard | CircleGrid) -> None:
    for turns in board.same_turns:
        angle = 0.5 * np.pi * turns
        rotation = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        np.testing.assert_allclose(board.points_m[renumbering(board, turns)], board.points_m @ rotation.T, atol=1e-12)


def test_which_turns_leave_a_print_as_it_is() -> None:
    assert Chessboard(9, 6).same_turns == (0,)
    assert Chessboard(9, 7).same_turns == Chessboard(6, 6).same_turns == (0, 2)
    assert Chessboard(7, 7).same_turns == CircleGrid(6, 6).same_turns == (0, 1, 2, 3)
    assert CircleGrid(4, 11, asymmetric=True).same_turns == (0,)
    assert CircleGrid(4, 10, asymmetric=True).same_turns == (0, 2)


def photographed(
    board: Chessboard | CircleGrid, shape_m: FloatArray, turns: list[int], seed: int
) -> tuple[list[BoardPoints], list[RigidTransform]]:
    """Photos of a bent board, each counted from a corner of its own, with the pose that belongs to the count."""
    rng = np.random.default_rng(seed)
    photos, poses = [], []
    size = float(np.ptp(board.points_m[:, 0]))
    for k, turn in enumerate(turns):
        tilt = np.array([0.5 * np.cos(2.4 * k), 0.5 * np.sin(2.4 * k), rng.uniform(-3, 3)])
        flip = RigidTransform.from_rotation_vector([np.pi, 0, 0], [0, 0, 0])
        away = RigidTransform.from_rotation_vector(tilt, [*rng.uniform(-0.1, 0.1, 2) * size, 2.0 * size])
        pose = away @ flip
        pixels = CAMERA.project(pose.apply(shape_m)) + rng.normal(0, NOISE_PX, (len(shape_m), 2))
        # Counted from another corner: the photo's number i is the board's point new[i].
        new = renumbering(board, turn)
        index = np.empty_like(new)
        index[new] = np.arange(new.size)
        order = np.argsort(index)
        back = RigidTransform.from_rotation_vector([0, 0, 0.5 * np.pi * turn], np.zeros(3))
        covariance = np.tile(NOISE_PX**2 * np.eye(2), (new.size, 1, 1))
        photos.append(BoardPoints(f"p{k}", index[order], pixels[order], covariance))
        poses.append(pose @ back)
    return photos, poses


def bent(board: Chessboard | CircleGrid, size_m: float) -> FloatArray:
    """Return a board bent, sheared and stretched by about so much."""
    unit = board.points_m / np.abs(board.points_m).max()
    x, y = unit[:, 0], unit[:, 1]
    away = np.stack([0.3 * x * y, 0.4 * x**2, x**2 - 0.5 * y**2 + 0.7 * x**3 + 0.5 * x * y**2], axis=1)
    return np.asarray(board.points_m + size_m * away)


@pytest.mark.parametrize("board", [BOARDS[0], BOARDS[2], BOARDS[3], BOARDS[5]], ids=lambda board: board.describe())
@pytest.mark.parametrize("seed", [1, 2])
def test_turns_are_found_from_the_shape(board: Chessboard | CircleGrid, seed: int) -> None:
    rng = np.random.default_rng(seed)
    turns = rng.choice(board.same_turns, 9).tolist()
    photos, poses = photographed(board, bent(board, 3e-4), turns, seed)
    found = find_orientations(board, photos, poses, CAMERA)
    # All together are open: what is left must be one and the same turn for all photos.
    left = {(turn - own) % 4 for own, turn in zip(turns, found.quarter_turns, strict=True)}
    assert len(left) == 1
    assert found.open == []


def test_a_true_board_does_not_tell() -> None:
    board = BOARDS[0]
    photos, poses = photographed(board, board.points_m, [0, 2, 0, 2, 0, 2], 3)
    found = find_orientations(board, photos, poses, CAMERA)
    assert found.open == list(range(6))


def test_as_many_photos_as_possible_stay_as_they_were_found() -> None:
    board = BOARDS[0]
    photos, poses = photographed(board, bent(board, 3e-4), [2, 0, 0, 0, 2, 0, 0], 4)
    assert find_orientations(board, photos, poses, CAMERA).turned == [0, 4]
