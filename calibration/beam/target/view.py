"""From a camera's picture to the target's plane: homography with its residuals, and the rectified picture."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError, InputError
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, FloatArray, float_array, freeze, positive

__all__ = ["Rectifier", "TargetImage", "TargetView", "view_from_points", "whole_image"]

#: Pixels on the longer side of a rectified picture, unless the camera resolves less: a beam is tens of them wide.
_LONGEST_PX = 256
#: Residual of the known points, as a share of the target, above which they cannot be these points.
_MOST_MISFIT = 0.02
#: Sigma of a corner in a crop whose places go by the index [px]: an index is a pixel's edge as well as its centre,
#: which leaves half a pixel open. In the middle of a square crop, where diagonals cross, this makes 0.7 px. Labels of
#: 131 real crops on three targets stand 0.58 px aside (RMS of the targets); those of another heliostat's five, not used
#: for this, have errors of 0.99 sigma with it and 1.41 without.
_INDEX_SIGMA_PX = 1.0
_CORNER_NAMES = ("upper left", "upper right", "lower right", "lower left")


@dataclass(frozen=True, slots=True, eq=False)
class TargetImage:
    """A picture whose pixels lie on the plane of a target.

    values_dn (h, w): Grey values; NaN where the target is not in the picture [DN].
    plane_from_pixel (3, 3): Homography from column and row to x (right) and y (up), as seen from the field [m].
    full_scale_dn: End of the grey scale [DN].
    view: Homography that put the picture onto the plane; without, the plane is known exactly.
    InputError: Not a picture, no homography, or a mirrored one.
    """

    values_dn: FloatArray
    plane_from_pixel: FloatArray
    full_scale_dn: float = 255.0
    view: "TargetView | None" = None

    def __post_init__(self) -> None:
        values = float_array("values_dn", self.values_dn, (None, None), finite=False)
        if min(values.shape) < 8:
            raise InputError(
                f"values_dn: a target needs at least 8 x 8 pixels, not {values.shape[1]} x {values.shape[0]}"
            )
        homography = float_array("plane_from_pixel", self.plane_from_pixel, (3, 3))
        object.__setattr__(self, "values_dn", values)
        object.__setattr__(self, "plane_from_pixel", homography)
        positive("full_scale_dn", self.full_scale_dn, "DN")
        middle = np.array([values.shape[1] - 1, values.shape[0] - 1]) / 2
        if not np.linalg.det(_jacobian(homography, middle)) < 0:
            raise InputError(
                "plane_from_pixel: the picture is mirrored or the corners are in the wrong order; columns run to the "
                "right and rows down, x to the right and y up, as seen from the field"
            )

    def points_m(self, pixels_px: npt.ArrayLike) -> FloatArray:
        """Map pixels, shape (..., 2), onto the target's plane [m]."""
        return _mapped(self.plane_from_pixel, np.asarray(pixels_px, dtype=np.float64))

    def pixels_px(self, points_m: npt.ArrayLike) -> FloatArray:
        """Map points of the plane, shape (..., 2), into the picture [px]."""
        inverse = np.asarray(np.linalg.inv(self.plane_from_pixel), dtype=np.float64)
        return _mapped(inverse, np.asarray(points_m, dtype=np.float64))

    def covariance_m2(self, point_m: npt.ArrayLike) -> FloatArray:
        """Return the covariance of a place on the plane that the homography's errors cause, shape (2, 2) [m^2]."""
        return np.zeros((2, 2)) if self.view is None else self.view.covariance_m2(point_m)

    def jacobian(self, pixel_px: npt.ArrayLike) -> FloatArray:
        """Return the derivative of the place on the plane by column and row, shape (2, 2) [m/px]."""
        return _jacobian(self.plane_from_pixel, np.asarray(pixel_px, dtype=np.float64))


@dataclass(frozen=True, slots=True, eq=False)
class TargetView:
    """How a camera sees the plane of a target.

    pixel_from_plane (3, 3): Homography from the plane [m] to pixels free of distortion [px].
    camera: Lens that distorts them; None for a lens without distortion.
    points_m (n, 2): Known points of the target [m].
    residuals_px (n, 2): Measured minus mapped [px].
    sigma_px: Uncertainty of one measured coordinate: given, or from the residuals where there are more than four
        [px].
    covariance (8, 8): Covariance of the homography's first eight elements, the ninth being 1.
    """

    pixel_from_plane: FloatArray
    camera: Camera | None
    points_m: FloatArray
    residuals_px: FloatArray
    sigma_px: float
    covariance: FloatArray

    def pixels_px(self, points_m: npt.ArrayLike) -> FloatArray:
        """Map points of the plane, shape (..., 2), into the camera's picture, with the lens's distortion [px]."""
        return _distorted(_mapped(self.pixel_from_plane, np.asarray(points_m, dtype=np.float64)), self.camera)

    def covariance_m2(self, point_m: npt.ArrayLike) -> FloatArray:
        """Return the covariance of a place on the plane that errors of the homography cause, shape (2, 2) [m^2]."""
        point = float_array("point_m", point_m, (2,))
        rows = _homography_rows(self.pixel_from_plane, point[None, :])
        back = np.linalg.inv(_jacobian(self.pixel_from_plane, point)) @ rows
        return np.asarray(back @ self.covariance @ back.T)


class _Layout(NamedTuple):
    """Rows, columns and samples of the camera's picture per pixel and direction."""

    rows: int
    columns: int
    finer: int


class _Maps(NamedTuple):
    """Column and row of each sample in a part of the camera's picture, and where that part begins [px].

    Least and largest column and row of all samples, and whether each sample has a place.
    """

    columns_px: npt.NDArray[np.float32]
    rows_px: npt.NDArray[np.float32]
    left_px: int
    top_px: int
    least_px: tuple[float, float]
    most_px: tuple[float, float]
    are_finite: bool


@dataclass(frozen=True, eq=False)
class Rectifier(ShortRepr):
    """Resample pictures of one camera onto the target's plane; the mapping is computed once for a series.

    view: How the camera sees the target.
    extent_m (4,): Left, right, lower and upper end of the rectified picture on the plane [m].
    shape: Rows and columns; as fine as the camera sees, at most 256 on the longer side, if absent.
    InputError: The extent is empty.
    """

    view: TargetView
    extent_m: FloatArray
    shape: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        extent = float_array("extent_m", self.extent_m, (4,))
        if not (extent[1] > extent[0] and extent[3] > extent[2]):
            raise InputError(f"extent_m: left < right and lower < upper are needed, not {extent.tolist()}")
        object.__setattr__(self, "extent_m", extent)

    @cached_property
    def _layout(self) -> "_Layout":
        left, right, low, high = self.extent_m
        corners = self.view.pixels_px([[left, high], [right, high], [right, low], [left, low]])
        sides = np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)
        wide, tall = max(sides[0], sides[2]), max(sides[1], sides[3])
        if not np.isfinite(wide + tall):
            raise InputError("the target reaches to where the lens model is not one-to-one")
        if self.shape is None:
            scale = min(1.0, _LONGEST_PX / max(wide, tall))
            rows, columns = max(8, round(tall * scale)), max(8, round(wide * scale))
        else:
            rows, columns = self.shape
        ratio = max(wide / columns, tall / rows)
        # Where pixels are averaged, samples 4/3 of a pixel apart use all of them: as if 3.9 of 4 were averaged.
        finer = max(min(ratio, 2.0), 0.75 * ratio)
        return _Layout(rows, columns, int(min(8, max(1, np.ceil(finer - 0.1)))))

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns of the rectified picture."""
        rows, columns, _ = self._layout
        return rows, columns

    @property
    def plane_from_pixel(self) -> FloatArray:
        """Homography of the rectified picture, shape (3, 3)."""
        rows, columns, _ = self._layout
        left, right, low, high = self.extent_m
        dx, dy = (right - left) / columns, (high - low) / rows
        return np.array([[dx, 0, left + dx / 2], [0, -dy, high - dy / 2], [0, 0, 1]])

    @cached_property
    def _maps(self) -> "_Maps":
        rows, columns, finer = self._layout
        left, right, low, high = self.extent_m
        x = left + (np.arange(columns * finer) + 0.5) * ((right - left) / (columns * finer))
        y = high - (np.arange(rows * finer) + 0.5) * ((high - low) / (rows * finer))
        pixels = self.view.pixels_px(np.stack(np.meshgrid(x, y), axis=-1)).astype(np.float32)
        # Only the part of the picture around the target is converted and resampled.
        first = np.maximum(np.floor(np.nanmin(pixels.reshape(-1, 2), axis=0)).astype(int) - 2, 0)
        columns_px, rows_px = (np.ascontiguousarray(pixels[..., k] - np.float32(first[k])) for k in (0, 1))
        least = (float(np.nanmin(columns_px)), float(np.nanmin(rows_px)))
        most = (float(np.nanmax(columns_px)), float(np.nanmax(rows_px)))
        whole = bool(np.isfinite(columns_px).all() and np.isfinite(rows_px).all())
        return _Maps(columns_px, rows_px, int(first[0]), int(first[1]), least, most, whole)

    def rectify(self, image_dn: npt.NDArray[np.generic], *, full_scale_dn: float | None = None) -> TargetImage:
        """Resample one picture.

        image_dn (height, width): The camera's picture [DN].
        full_scale_dn: End of its grey scale; from its type where that is an integer, else 255 [DN].
        Returns: The rectified picture; NaN where the camera does not see the target.
        InputError: Not a grey picture, or the target lies outside of it.
        """
        if image_dn.ndim != 2:
            raise InputError(f"image: shape (height, width) is needed, not {image_dn.shape}; make colours grey first")
        scale = full_scale_dn or _full_scale(image_dn)
        columns, rows, left, top, least, most, whole = self._maps
        right, low = int(most[0]) + left + 3, int(most[1]) + top + 3
        part = np.ascontiguousarray(image_dn[top : max(low, top), left : max(right, left)], dtype=np.float32)
        if min(part.shape) < 2:
            raise InputError("the target lies outside the picture; check the corners")
        finer = self._layout.finer
        how = cv2.INTER_LINEAR if finer > 1 else cv2.INTER_CUBIC
        values = cv2.remap(part, columns, rows, how, borderMode=cv2.BORDER_REPLICATE)
        last = (part.shape[1] - 1, part.shape[0] - 1)
        if not (whole and min(least) >= 0 and most[0] <= last[0] and most[1] <= last[1]):
            inside = (columns >= 0) & (rows >= 0) & (columns <= last[0]) & (rows <= last[1])
            values[~inside] = np.nan
        if finer > 1:
            values = cv2.resize(values, self._layout[1::-1], interpolation=cv2.INTER_AREA)
        return TargetImage(np.asarray(values, dtype=np.float64), self.plane_from_pixel, scale, self.view)


def whole_image(
    image_dn: npt.NDArray[np.generic],
    corners_m: npt.ArrayLike,
    *,
    by_index: bool = False,
    full_scale_dn: float | None = None,
) -> TargetImage:
    """Take a picture that shows exactly the target, such as a crop that was rectified by another program.

    image_dn (h, w): Grey values [DN].
    corners_m (4, 2): Upper left, upper right, lower right, lower left corner as seen from the field: x right, y up
        [m].
    by_index: Whether a pixel's index over the number of pixels is its place, as in the PAINT data base (its labels
        are made so): pixel 0 is then centred on the target's edge, and places have an error of 0.7 px in the middle
        that all pictures of the target share. Otherwise the picture's outer edges are the target's.
    full_scale_dn: End of the grey scale; from the picture's type where that is an integer, else 255 [DN].
    Returns: The picture with its place on the plane; nothing is resampled.
    InputError: Not a grey picture, or corners that are mirrored or in the wrong order.
    """
    if image_dn.ndim != 2:
        raise InputError(f"image: shape (height, width) is needed, not {image_dn.shape}; make colours grey first")
    rows, columns = image_dn.shape
    first = 0.0 if by_index else -0.5
    last_x, last_y = columns + first, rows + first
    pixels = np.array([[first, first], [last_x, first], [last_x, last_y], [first, last_y]])
    view = view_from_points(pixels, corners_m, sigma_px=_INDEX_SIGMA_PX if by_index else 0.0)
    scale = full_scale_dn or _full_scale(image_dn)
    return TargetImage(
        np.asarray(image_dn, dtype=np.float64),
        freeze(np.linalg.inv(view.pixel_from_plane)),
        scale,
        view if by_index else None,
    )


def view_from_points(
    pixels_px: npt.ArrayLike, points_m: npt.ArrayLike, *, camera: Camera | None = None, sigma_px: float = 0.0
) -> TargetView:
    """Find how a camera sees the target's plane from points on it.

    pixels_px (n, 2): Where at least four points are seen [px].
    points_m (n, 2): Where they are on the target: x right, y up, as seen from the field [m].
    sigma_px: Uncertainty of one measured coordinate; from the residuals if larger there and more than four points
        are given [px].
    Returns: The homography that fits best in pixels, its residuals and its covariance.
    InputError: Fewer than four points, points that lie on a line or cross over, a mirrored order.
    EstimationError: The points do not fit one plane: the residual is larger than a fiftieth of the target.
    """
    measured = float_array("pixels_px", pixels_px, (None, 2))
    plane = float_array("points_m", points_m, (measured.shape[0], 2))
    if measured.shape[0] < 4:
        raise InputError(f"target: at least four points are needed, not {measured.shape[0]}")
    straight = _undistorted(measured, camera)
    if not np.isfinite(straight).all():
        raise InputError("target: a point lies where the lens model is not one-to-one")
    _refuse_order(straight, plane)
    homography = _homography(straight, plane)
    residuals = straight - _mapped(homography, plane)
    spare = 2 * measured.shape[0] - 8
    from_residuals = float(np.sqrt(np.sum(residuals**2) / spare)) if spare else 0.0
    size = float(np.ptp(straight, axis=0).max())
    if from_residuals > _MOST_MISFIT * size:
        raise EstimationError(
            f"target: its points miss a plane's picture by {from_residuals:.1f} px (target: {size:.0f} px); check the "
            "order and the coordinates of the points"
        )
    rows = _homography_rows(homography, plane)
    sigma = max(float(sigma_px), from_residuals)
    scale = np.linalg.norm(rows, axis=0)
    cofactor = np.linalg.inv((rows / scale).T @ (rows / scale)) / np.outer(scale, scale)
    return TargetView(homography, camera, plane, freeze(residuals), sigma, freeze(sigma**2 * cofactor))


# --- homography -----------------------------------------------------------------------------------------------------


def _full_scale(image_dn: npt.NDArray[np.generic]) -> float:
    return {"uint8": 255.0, "uint16": 65535.0}.get(image_dn.dtype.name, 255.0)


def _mapped(homography: FloatArray, points: FloatArray) -> FloatArray:
    mapped = points @ homography[:, :2].T + homography[:, 2]
    return np.asarray(mapped[..., :2] / mapped[..., 2:])


def _jacobian(homography: FloatArray, point: FloatArray) -> FloatArray:
    depth = float(homography[2, :2] @ point + homography[2, 2])
    return np.asarray((homography[:2, :2] - np.outer(_mapped(homography, point), homography[2, :2])) / depth)


def _homography_rows(homography: FloatArray, points: FloatArray) -> FloatArray:
    """Return the derivatives of mapped points by the homography's first eight elements, shape (2 n, 8)."""
    depth = points @ homography[2, :2] + homography[2, 2]
    mapped = _mapped(homography, points)
    ones = np.concatenate([points, np.ones((len(points), 1))], axis=1) / depth[:, None]
    rows = np.zeros((len(points), 2, 8))
    rows[:, 0, 0:3], rows[:, 1, 3:6] = ones, ones
    rows[:, :, 6:8] = -mapped[:, :, None] * (points / depth[:, None])[:, None, :]
    return rows.reshape(-1, 8)


def _homography(pixels: FloatArray, points: FloatArray) -> FloatArray:
    start = np.asarray(cv2.findHomography(points, pixels, 0)[0], dtype=np.float64)
    if start.shape != (3, 3) or not np.isfinite(start).all() or abs(start[2, 2]) < 1e-12:
        raise InputError("target: the points do not determine a homography; are three of them on one line?")
    homography: FloatArray = start / start[2, 2]
    for _ in range(20):
        rows = _homography_rows(homography, points)
        scale = np.linalg.norm(rows, axis=0)
        step = np.linalg.lstsq(rows / scale, (pixels - _mapped(homography, points)).ravel(), rcond=None)[0] / scale
        homography = homography + np.append(step, 0.0).reshape(3, 3)
        if np.abs(step * scale).max() < 1e-10 * max(1.0, float(np.abs(pixels).max())):
            break
    return freeze(homography)


def _refuse_order(pixels: FloatArray, points: FloatArray) -> None:
    """Any three points must be seen in the order that a viewer in the field sees: x right, y up, rows down."""
    turned = np.stack([pixels[:, 0], -pixels[:, 1]], axis=1)
    indices = np.array([(i, j, k) for i in range(len(points)) for j in range(i) for k in range(j)])
    areas = [_areas(each[indices[:, 0]], each[indices[:, 1]], each[indices[:, 2]]) for each in (turned, points)]
    sizes = [float(np.ptp(each, axis=0).max()) ** 2 for each in (turned, points)]
    clear: BoolArray = (np.abs(areas[0]) > 1e-3 * sizes[0]) & (np.abs(areas[1]) > 1e-3 * sizes[1])
    if not clear.any():
        raise InputError("target: its points lie on one line (or are one point); four corners are needed")
    same = np.sign(areas[0][clear]) == np.sign(areas[1][clear])
    if not same.any():
        raise InputError(
            f"target: the points are mirrored; the order is {', '.join(_CORNER_NAMES)}, seen from the field"
        )
    if not same.all():
        raise InputError(f"target: the points cross over; the order is {', '.join(_CORNER_NAMES)}, seen from the field")


def _areas(a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    first, second = b - a, c - a
    return np.asarray(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])


def _undistorted(pixels: FloatArray, camera: Camera | None) -> FloatArray:
    if camera is None:
        return pixels
    rays = camera.cast_rays(pixels)
    return np.asarray((rays / rays[..., 2:]) @ camera.matrix.T)[..., :2]


def _distorted(pixels: FloatArray, camera: Camera | None) -> FloatArray:
    if camera is None:
        return pixels
    inverse = np.linalg.inv(camera.matrix)
    return camera.project(pixels @ inverse[:, :2].T + inverse[:, 2])
