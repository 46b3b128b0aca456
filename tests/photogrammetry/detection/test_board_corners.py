"""Corners of chessboard squares against squares drawn by their areas."""

import cv2
import numpy as np
import pytest

from heliogauge.validate import FloatArray
from photogrammetry.detection.board_corners import edge_curvatures
from photogrammetry.detection.corner_fit import CornerStart, fit_corners


def crossing(corner: FloatArray, angles: tuple[float, float], size: int = 61, fine: int = 8) -> FloatArray:
    """Draw four squares that meet in a corner: areas in fine x fine cells of each pixel, blurred, then their mean."""
    steps = (np.arange(size * fine) + 0.5) / fine - 0.5
    x, y = steps - corner[0], (steps - corner[1])[:, None]
    first, second = (np.cos(a) * x + np.sin(a) * y for a in angles)
    return drawn(first, second, fine)


def drawn(first: FloatArray, second: FloatArray, fine: int) -> FloatArray:
    """Draw light where both distances from the edges have one sign."""
    size = max(first.shape) // fine
    # The share of a cell beyond an edge is linear in the distance while the edge crosses it (exact along the axes).
    one, other = (2 * np.clip(distance * fine + 0.5, 0, 1) - 1 for distance in (first, second))
    blurred = cv2.GaussianBlur(125 + 75 * one * other, (0, 0), 0.7 * fine)
    return np.asarray(blurred.reshape(size, fine, size, fine).mean(axis=(1, 3)))


def corner_start(at: FloatArray, angles: tuple[float, float], side: float) -> CornerStart:
    # The edge of an angle's normal runs a right angle from it.
    along = [np.array([[-np.sin(a), np.cos(a)]]) * side for a in angles]
    return CornerStart(at[None], along[0], along[1], np.zeros((1, 2)))


@pytest.mark.parametrize("angles", [(0.0, np.pi / 2), (0.3, 1.7), (-0.2, 1.1)])
def test_corner_without_noise(angles: tuple[float, float]) -> None:
    truth = np.array([30.37, 29.81])
    found = fit_corners(crossing(truth, angles), corner_start(truth + [0.6, -0.5], angles, 40.0))
    assert np.abs(found.pixels_px[0] - truth).max() < 0.002
    assert abs(found.blur_px[0] - 0.7) < 0.03


def test_corner_covariance_is_honest() -> None:
    rng = np.random.default_rng(5)
    truth, angles = np.array([30.2, 30.4]), (0.2, 1.6)
    clean = crossing(truth, angles)
    squares = []
    for _ in range(150):
        noisy = clean + rng.normal(0, 2.0, clean.shape)
        found = fit_corners(noisy, corner_start(truth, angles, 30.0))
        error = found.pixels_px[0] - truth
        squares.append(float(error @ np.linalg.solve(found.covariance_px2[0], error)))
    # 300 degrees of freedom: 1 +- 0.08.
    assert 0.75 < np.mean(squares) / 2 < 1.25


def test_what_is_no_corner_is_refused() -> None:
    truth, angles = np.array([30.0, 30.0]), (0.2, 1.6)
    start = corner_start(truth, angles, 30.0)
    edge = np.where(np.arange(61) > 30, 200.0, 50.0) * np.ones((61, 1))
    assert not fit_corners(edge, start).found[0]
    assert not fit_corners(np.random.default_rng(0).normal(100, 5, (61, 61)), start).found[0]
    assert not fit_corners(crossing(truth, angles), corner_start(np.array([2.0, 30.0]), angles, 30.0)).found[0]


def test_bent_edges_do_not_shift_the_corner() -> None:
    fine, size, bent = 8, 61, 4e-4
    steps = (np.arange(size * fine) + 0.5) / fine - 0.5
    x, y = steps - 30.3, (steps - 29.6)[:, None]
    # Right of the first edge, below the second one; both bend towards their normals.
    first, second = x - 0.5 * bent * y**2, y - 0.5 * bent * x**2
    image = drawn(first, second, fine)
    at = np.array([[30.3, 29.6]])
    # along_x runs along the second edge (rightwards), along_y along the first (downwards): its normal points left.
    straight = CornerStart(at, np.array([[40.0, 0.0]]), np.array([[0.0, 40.0]]), np.zeros((1, 2)))
    known = CornerStart(at, straight.along_x, straight.along_y, np.array([[bent, -bent]]))
    assert np.abs(fit_corners(image, straight).pixels_px[0] - at[0]).max() > 0.01
    assert np.abs(fit_corners(image, known).pixels_px[0] - at[0]).max() < 0.002


def test_curvature_of_a_bent_grid() -> None:
    row, column = np.indices((6, 9)).astype(float)
    grid = np.stack([40 * column, 40 * row + 0.5 * 1e-4 * (40 * column) ** 2], axis=-1)
    found = edge_curvatures(grid)
    np.testing.assert_allclose(found[..., 0], 1e-4, rtol=0.02)
    np.testing.assert_allclose(found[..., 1], 0, atol=1e-9)
