"""Square markers (ArUco, AprilTag) in a photo: found by OpenCV, checked bit by bit, corners from their sides.

OpenCV's detector corrects bits and accepts what its contours give, so that a carpet reads as a marker now and then, and
its corners are whole pixels. Here every bit must be that of the dictionary, with contrast, and every side a straight
edge; what fails is named with the reason.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.errors import EstimationError, InputError
from heliogauge.validate import BoolArray, FloatArray, freeze
from photogrammetry.detection.detections import Detections
from photogrammetry.detection.square_edges import SquareCorners, corners_of_squares, with_correlated_errors

Bytes = npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class MarkerLimits:
    """How good a marker must be.

    least_contrast_dn: Paper minus ink, in grey values of 255 [DN].
    most_straightness_px: Rms departure of the sides from lines [px].
    least_bit_margin: Darkest white cell minus lightest black cell, as a share of the contrast.
    most_sigma_px: Standard deviation of the worst corner along its worst direction [px].
    """

    least_contrast_dn: float = 15.0
    most_straightness_px: float = 0.25
    least_bit_margin: float = 0.15
    most_sigma_px: float = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class RejectedMarker:
    """Something that OpenCV takes for a marker.

    number: The number read.
    center_px (2,): Where it is [px].
    reason: Why it is none, with the number that decided.
    """

    number: int
    center_px: FloatArray
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class PhotoMarkers:
    """The markers of one photo.

    detections: Corners "23.0" to "23.3": marker and corner, clockwise from the top left of the upright marker.
    numbers: The markers, four detections each.
    squares: What was measured of each.
    rejected: What only looks like one.
    duplicated: Numbers that occur more than once; all of them are among the detections.
    """

    detections: Detections
    numbers: tuple[int, ...]
    squares: tuple[SquareCorners, ...]
    rejected: tuple[RejectedMarker, ...]
    duplicated: tuple[int, ...]


def find_markers(
    image_dn: npt.NDArray[np.generic], photo: str, dictionary: str, limits: MarkerLimits | None = None
) -> PhotoMarkers:
    """Find the square markers of a photo and measure their corners.

    image_dn (h, w): Grey values: uint8, uint16, or float on the scale of one of them [DN].
    dictionary: OpenCV's name: ``DICT_4X4_1000``, ``DICT_APRILTAG_36h11``...
    limits: How good a marker must be.
    Returns: Corners with covariances, and what was refused. No marker is no error.
    InputError: Not a grey image, or no such dictionary.
    """
    if image_dn.ndim != 2:
        raise InputError(f"image: a grey image is needed, not shape {image_dn.shape}")
    if not dictionary.startswith("DICT_") or not hasattr(cv2.aruco, dictionary):
        raise InputError(f"marker dictionary {dictionary!r}: OpenCV's name is needed, e.g. DICT_4X4_100")
    table = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    allowed = limits or MarkerLimits()
    found, numbers_found, _ = cv2.aruco.ArucoDetector(table).detectMarkers(_bytes(image_dn))
    numbers: Any = numbers_found  # an array, or None: the declaration knows the array only
    # OpenCV 4 gives numbers as a column, OpenCV 5 as a row, both None without a marker.
    read = np.ravel(numbers if numbers is not None else []).tolist()
    starts = [np.asarray(start, dtype=np.float64).reshape(4, 2) for start in found]
    measured: list[tuple[int, SquareCorners]] = []
    rejected = []
    squares_found = _measure(image_dn, starts, [_cells(table, number) for number in read])
    for number, start, square in zip(read, starts, squares_found, strict=True):
        if isinstance(square, EstimationError):
            rejected.append(RejectedMarker(number, freeze(start.mean(axis=0)), str(square)))
        else:
            measured.append((number, square))
    kept = []
    honest = with_correlated_errors([square for _, square in measured])
    for (number, _), square in zip(measured, honest, strict=True):
        reason = _fault(image_dn, square, _cells(table, number), allowed)
        if reason:
            rejected.append(RejectedMarker(number, freeze(square.corners_px.mean(axis=0)), reason))
        else:
            kept.append((number, square))
    kept.sort(key=lambda item: item[0])
    every, squares = [number for number, _ in kept], [square for _, square in kept]
    return PhotoMarkers(
        _detections(photo, every, squares),
        tuple(every),
        tuple(squares),
        tuple(rejected),
        tuple(sorted({number for number in every if every.count(number) > 1})),
    )


def _bytes(image_dn: npt.NDArray[np.generic]) -> Bytes:
    """Return the photo in 8 bit, for OpenCV's detector only."""
    if image_dn.dtype == np.uint8:
        return np.asarray(image_dn, dtype=np.uint8)
    values = np.asarray(image_dn, dtype=np.float32)
    return np.asarray(cv2.convertScaleAbs(values, alpha=_to_bytes(image_dn)), dtype=np.uint8)


def _to_bytes(image_dn: npt.NDArray[np.generic]) -> float:
    deep = image_dn.dtype == np.uint16 or (image_dn.dtype != np.uint8 and float(np.max(image_dn)) > 255.5)
    return 1 / 257 if deep else 1.0


def _measure(
    image_dn: npt.NDArray[np.generic], starts: Sequence[FloatArray], white: Sequence[BoolArray]
) -> list[SquareCorners | EstimationError]:
    """Measure the corners of markers in windows of the photo."""
    lows, windows = [], []
    for start in starts:
        low = np.maximum(np.floor(start.min(axis=0)).astype(int) - 7, 0)
        high = np.ceil(start.max(axis=0)).astype(int) + 8
        windows.append(np.asarray(image_dn[low[1] : high[1], low[0] : high[0]], dtype=np.float64))
        lows.append(low)
    found = corners_of_squares(windows, [start - low for start, low in zip(starts, lows, strict=True)], white)
    return [
        one if isinstance(one, EstimationError) else replace(one, corners_px=freeze(one.corners_px + low))
        for one, low in zip(found, lows, strict=True)
    ]


def _cells(table: cv2.aruco.Dictionary, number: int) -> BoolArray:
    """Which cells of a marker are white, its black border included."""
    return np.asarray(cv2.aruco.generateImageMarker(table, number, table.markerSize + 2, borderBits=1)) > 0


def _fault(image_dn: npt.NDArray[np.generic], square: SquareCorners, white: BoolArray, limits: MarkerLimits) -> str:
    """Why a square is not this marker; empty if it is."""
    contrast = square.contrast_dn * _to_bytes(image_dn)
    if contrast < limits.least_contrast_dn:
        return f"contrast {contrast:.1f} of 255 grey values, {limits.least_contrast_dn:g} are needed"
    if square.straightness_px > limits.most_straightness_px:
        return f"sides bend by {square.straightness_px:.2f} px rms, {limits.most_straightness_px:g} are allowed"
    sigma = float(np.sqrt(np.linalg.eigvalsh(square.covariance_px2)[:, -1].max()))
    if sigma > limits.most_sigma_px:
        return f"a corner has sigma {sigma:.2f} px, {limits.most_sigma_px:g} are allowed"
    levels = _cell_levels(image_dn, square.corners_px, len(white))
    # Shading across a marker is far less than its contrast: one threshold for all cells.
    margin = (float(levels[white].min()) - float(levels[~white].max())) / square.contrast_dn
    if margin < limits.least_bit_margin:
        return f"white and black cells differ by {margin:.2f} of the contrast, {limits.least_bit_margin:g} are needed"
    return ""


def _cell_levels(image_dn: npt.NDArray[np.generic], corners: FloatArray, cells: int) -> FloatArray:
    """Grey values at the middles of a marker's cells, shape (cells, cells)."""
    upright = np.array([[0, 0], [cells, 0], [cells, cells], [0, cells]], dtype=np.float32)
    low = np.maximum(np.floor(corners.min(axis=0)).astype(int) - 2, 0)
    high = np.ceil(corners.max(axis=0)).astype(int) + 3
    window = np.ascontiguousarray(image_dn[low[1] : high[1], low[0] : high[0]], dtype=np.float32)
    homography = cv2.getPerspectiveTransform(upright, (corners - low).astype(np.float32))
    middle = np.arange(cells) + 0.5
    x, y = np.meshgrid(middle, middle)
    points = cv2.perspectiveTransform(np.stack([x, y], axis=-1).reshape(1, -1, 2).astype(np.float32), homography)
    at = np.asarray(points, dtype=np.float32).reshape(cells, cells, 2)
    return np.asarray(cv2.remap(window, at[..., 0], at[..., 1], cv2.INTER_LINEAR), dtype=np.float64)


def _detections(photo: str, numbers: list[int], squares: list[SquareCorners]) -> Detections:
    n = 4 * len(numbers)
    return Detections(
        photo,
        tuple(f"{number}.{corner}" for number in numbers for corner in range(4)),
        np.array([square.corners_px for square in squares]).reshape(n, 2),
        np.array([square.covariance_px2 for square in squares]).reshape(n, 2, 2),
        np.full(n, np.nan),
        np.zeros(n, dtype=np.uint32),
    )
