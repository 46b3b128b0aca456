"""Corners of chessboard squares against squares drawn by their areas, and boards as described."""

import re

import cv2
import numpy as np
import pytest

from calibration.camera.boards import CharucoBoard, Chessboard, CircleGrid, TargetField
from calibration.camera.corners.detection import find_charuco, find_chessboard
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


def charuco_photo(share: float) -> np.ndarray:
    """A board of 7 x 5 squares seen obliquely, 45 px a square; drawn larger, and reduced."""
    words = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    flat = cv2.aruco.CharucoBoard((7, 5), 1.0, share, words).generateImage((1260, 900), marginSize=120)
    corners = np.array([[0, 0], [1260, 0], [1260, 900], [0, 900]], dtype=np.float32)
    seen = np.array([[90, 40], [1250, 0], [1170, 890], [0, 810]], dtype=np.float32)
    oblique = cv2.warpPerspective(flat, cv2.getPerspectiveTransform(corners, seen), (1260, 900), borderValue=255)
    reduced = cv2.resize(cv2.GaussianBlur(oblique, (0, 0), 2.0), (420, 300), interpolation=cv2.INTER_AREA)
    noise = np.random.default_rng(0).normal(0, 1, reduced.shape)
    return np.clip(np.round(30 + 0.7 * reduced + noise), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("stated_mm", [3.0, 10.0, 13.0])
def test_markers_of_another_size_than_stated_are_named(stated_mm: float) -> None:
    photo = charuco_photo(0.73)
    assert find_charuco("a.png", photo, CharucoBoard(7, 5, "DICT_4X4_50", 0.73, 0.03)).n == 24
    with pytest.raises(EstimationError, match=rf"a\.png: .*marker_mm = {stated_mm:g} is not what it shows") as caught:
        find_charuco("a.png", photo, CharucoBoard(7, 5, "DICT_4X4_50", stated_mm / 30, 0.03))
    measured = re.search(r"about ([\d.]+) mm with square_mm = 30", str(caught.value))
    assert measured
    assert float(measured[1]) == pytest.approx(21.9, rel=0.07)


def test_large_markers_are_named_in_plain_numbers() -> None:
    with pytest.raises(EstimationError, match=r"about 14\d mm with square_mm = 200; measure"):
        find_charuco("a.png", charuco_photo(0.73), CharucoBoard(7, 5, "DICT_4X4_50", 0.35, 0.2))


def test_another_board_is_not_called_one_of_other_markers() -> None:
    # Rows and columns exchanged: the numbers stand elsewhere, and the sizes between them mean nothing.
    with pytest.raises(
        EstimationError, match=r"a\.png: .*numbered 0 to 16 were seen, a board of 5 x 7 squares"
    ) as caught:
        find_charuco("a.png", charuco_photo(0.73), CharucoBoard(5, 7, "DICT_4X4_50", 0.73, 0.03))
    assert "marker_mm" not in str(caught.value)
