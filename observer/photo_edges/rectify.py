"""A strip of the mirror as one photo shows it, with perspective, lens and curvature taken out (Owkes 2012, 6.3.1)."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.geometry.surfaces import Quadric
from heliogauge.validate import BoolArray, Float32Array, FloatArray
from observer.photo_edges.views import AnyImage, View

#: Samples between exact projections. Across 8 of 6 mm the curved mirror departs from its chord by 0.1 mm in height,
#: which moves its image by less than 0.001 px.
_LATTICE = 8
#: Columns that are closer than this are there to show the shape of an edge.
_CLOSE_PX = 0.6


@dataclass(frozen=True, slots=True, eq=False)
class Strip:
    """Part of the mirror, resampled.

    image_dn (r, n): Brightness, rows of constant y [DN].
    x_m (n,): Columns [m].
    seen (r, n): Whether the photo shows the point.
    """

    image_dn: Float32Array
    x_m: FloatArray
    seen: BoolArray


def rectified_strip(
    image: AnyImage,
    view: View,
    surface: Quadric,
    x_m: FloatArray,
    y_m: FloatArray,
    *,
    rows_each: int = 1,
) -> Strip:
    """Resample a photo on the design surface.

    Shapes: image (height, width).
    view: Its camera and ``cam_from_frame``.
    surface: The mirror's surface in the frame.
    x_m (n,): Ascending, equally spaced columns [m].
    y_m (r,): Ascending, equally spaced rows [m].
    rows_each: Lines of sight that are averaged along each row's width, so that every pixel counts.

    Columns closer than the pixels are interpolated by 4 by 4 pixels, which keeps the shape of an edge wherever it
    lies among them; others by 2 by 2, which blurs it by place but costs little.
    """
    step = float(y_m[1] - y_m[0]) if y_m.size > 1 else 0.0
    inner = step * ((np.arange(rows_each) + 0.5) / rows_each - 0.5)
    fine_y = (y_m[:, None] + inner).reshape(-1)
    lattice = _lattice(view, surface, x_m, fine_y)
    pixels = _spread(lattice, fine_y.size, x_m.size)
    middle = pixels[fine_y.size // 2]
    apart = float(np.hypot(*(middle[-1] - middle[0]))) / max(x_m.size - 1, 1)
    way = cv2.INTER_CUBIC if 0 < apart < _CLOSE_PX else cv2.INTER_LINEAR
    # Both coordinates are in one map; OpenCV's types do not know that the second may then be missing.
    sampled = cv2.remap(image, pixels, None, way, borderMode=cv2.BORDER_REPLICATE)  # type: ignore[call-overload]
    values = _averaged(np.asarray(sampled).reshape(y_m.size, rows_each, x_m.size))
    if _is_inside(lattice, image):
        return Strip(values, x_m, np.ones(values.shape, dtype=bool))
    last = (image.shape[1] - 1, image.shape[0] - 1)
    inside = ((pixels >= 0) & (pixels <= last)).all(axis=2)
    seen = np.asarray(inside.reshape(y_m.size, rows_each, x_m.size).all(axis=1))
    return Strip(values, x_m, seen)


@dataclass(frozen=True, slots=True, eq=False)
class PixelSamples:
    """Pixels of a photo as they are, with the places on a surface at which their lines of sight meet it.

    values_dn (r, k, n): Brightness of the pixels next to k lines in each row; NaN beyond the photo [DN].
    x_m (r, k, n): Where their middles are seen, across the trough [m].
    """

    values_dn: Float32Array
    x_m: Float32Array


def pixel_samples(
    image: AnyImage, view: View, surface: Quadric, x_m: FloatArray, y_m: FloatArray, *, rows_each: int = 1
) -> PixelSamples:
    """Take the pixels next to a grid on a surface: nothing is interpolated, only their places.

    Shapes: image (height, width).
    view: Its camera and ``cam_from_frame``.
    surface: The surface in the frame.
    x_m (n,): Ascending, equally spaced columns, about a pixel apart, two at least [m].
    y_m (r,): Ascending, equally spaced rows, two at least [m].
    rows_each: Lines of sight along each row's width.
    """
    inner = float(y_m[1] - y_m[0]) * ((np.arange(rows_each) + 0.5) / rows_each - 0.5)
    fine_y = (y_m[:, None] + inner).reshape(-1)
    lattice = _lattice(view, surface, x_m, fine_y)
    pixels = _spread(lattice, fine_y.size, x_m.size)
    nearest = np.rint(pixels)
    off_x, off_y = nearest[..., 0] - pixels[..., 0], nearest[..., 1] - pixels[..., 1]
    # Over half a pixel the map is as steep as over the whole strip within a thousandth of it.
    steps = (x_m.size - 1) * float(x_m[1] - x_m[0]), float(fine_y[-1] - fine_y[0])
    across = (pixels[:, -1:] - pixels[:, :1]) / np.float32(steps[0])
    along = (pixels[-1:] - pixels[:1]) / np.float32(steps[1])
    beside = off_x * along[..., 1] - off_y * along[..., 0]
    beside /= across[..., 0] * along[..., 1] - across[..., 1] * along[..., 0]
    beside += x_m.astype(np.float32)
    # What lies beyond the photo takes the last pixel; its place is not in the photo.
    values = cv2.remap(image, nearest, None, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)  # type: ignore[call-overload]
    values = np.asarray(values, dtype=np.float32)
    if not _is_inside(lattice, image):
        height, width = image.shape
        inside = (nearest >= 0).all(axis=2) & (nearest[..., 0] < width) & (nearest[..., 1] < height)
        values[~inside] = np.nan
    shape = (y_m.size, rows_each, x_m.size)
    return PixelSamples(values.reshape(shape), beside.reshape(shape))


def _is_inside(lattice: Float32Array, image: AnyImage) -> bool:
    """Return whether all of a lattice lies in a photo: between its lines nothing lies beyond them."""
    last = (image.shape[1] - 1, image.shape[0] - 1)
    return all(bool(lattice[..., k].min() >= 0 and lattice[..., k].max() <= last[k]) for k in (0, 1))


def _averaged(lines: npt.NDArray[Any]) -> Float32Array:
    """Return the means of the lines of each row, shape (r, k, n) to (r, n); slice by slice, faster than a reduction."""
    total = lines[:, 0].astype(np.float32)
    for k in range(1, lines.shape[1]):
        total += lines[:, k]
    total *= np.float32(1 / lines.shape[1])
    return total


def _lattice(view: View, surface: Quadric, x_m: FloatArray, y_m: FloatArray) -> Float32Array:
    """Project a coarse lattice that reaches beyond the strip on all sides, shape (rows, columns, 2) [px].

    Its lines are in the middle between eight lines of the strip each, as the pixels of a picture reduced by eight.
    """
    axes = []
    for values in (x_m, y_m):
        count = -(-values.size // _LATTICE) + 2
        step = float(values[1] - values[0]) if values.size > 1 else 0.0
        # Rows inside one map row need not be spaced like the map rows: they are, because the inner lines fill it.
        axes.append(values[0] + step * (_LATTICE * (np.arange(count) - 0.5) - 0.5))
    points = np.empty((axes[1].size, axes[0].size, 3))
    points[..., 0], points[..., 1] = axes[0], axes[1][:, None]
    # A surface that is alike along y has one height for each column.
    points[..., 2] = surface.height(axes[0], axes[1][:, None] if surface.matrix[1].any() else 0.0)
    # In one row: of many small matrices each product is a call of its own.
    pixels = view.project(points.reshape(-1, 3)).reshape(*points.shape[:2], 2)
    # What lies behind the camera is outside the photo. Single precision is 1e-4 px.
    return np.where(np.isfinite(pixels), pixels, -1e4).astype(np.float32)


def _spread(lattice: Float32Array, n_rows: int, n_columns: int) -> Float32Array:
    """Interpolate a lattice linearly to every line of the strip, as a picture that is enlarged."""
    height, width = lattice.shape[:2]
    whole = cv2.resize(lattice, (_LATTICE * width, _LATTICE * height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(whole[_LATTICE : _LATTICE + n_rows, _LATTICE : _LATTICE + n_columns], dtype=np.float32)
