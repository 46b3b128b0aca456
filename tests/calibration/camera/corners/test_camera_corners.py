"""Corners of chessboard squares against squares drawn by their areas, and boards as described."""

import numpy as np
import pytest

from calibration.camera.boards import CharucoBoard, Chessboard, CircleGrid, TargetField
from calibration.camera.corners.detection import find_chessboard
from heliogauge.errors import EstimationError, InputError


def test_boards_say_what_they_are() -> None:
    board = Chessboard(9, 6, 0.03)
    assert len(board.names) == len(board.points_m) == 54
    # From the top left, row by row: x grows first, y falls.
    np.testing.assert_allclose(board.points_m[1] - board.points_m[0], [0.03, 0, 0], atol=1e-15)
    np.testing.assert_allclose(board.points_m[9] - board.points_m[0], [0, -0.03, 0], atol=1e-15)
    assert not board.looks_the_same_turned
    assert Chessboard(9, 7).looks_the_same_turned
    assert CircleGrid(10, 7).looks_the_same_turned
    assert not CircleGrid(4, 11, asymmetric=True).looks_the_same_turned
    assert not Chessboard(9, 6).is_metric
    assert "squares of 30 mm" in board.describe()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Chessboard(2, 6), "2 x 6 inner corners"),
        (lambda: Chessboard(9, 6, -1.0), "square_m"),
        (lambda: CharucoBoard(10, 7, "DICT_5X5_100", 1.2), "must be smaller"),
        (lambda: CircleGrid(10, 7, diameter_share=1.1), "touch"),
        (lambda: TargetField("aicon-12", ("1", "2"), np.zeros((2, 3))), "2 targets"),
    ],
)
def test_impossible_boards(make: object, words: str) -> None:
    with pytest.raises(InputError, match=words):
        make()  # type: ignore[operator]


def test_no_board_in_the_photo() -> None:
    with pytest.raises(EstimationError, match=r"a\.png: no chessboard of 9 x 6"):
        find_chessboard("a.png", np.full((200, 300), 90, np.uint8), Chessboard(9, 6))


@pytest.mark.parametrize("shape", [(1, 1), (8, 200), (14, 14), (29, 40)])
def test_a_thumbnail_shows_no_board(shape: tuple[int, int]) -> None:
    with pytest.raises(EstimationError, match=f"{shape[1]} x {shape[0]} px are too few"):
        find_chessboard("a.png", np.full(shape, 90, np.uint8), Chessboard(3, 3))
