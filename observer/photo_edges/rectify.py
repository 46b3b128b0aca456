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
    last = (image.shape[1] - 1, image.shape[0] - 1)
    if all(lattice[..., k].min() >= 0 and lattice[..., k].max() <= last[k] for k in (0, 1)):
        # Between lines of the lattice nothing lies beyond them.
        return Strip(values, x_m, np.ones(values.shape, dtype=bool))
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
    off = nearest - pixels
    # Over half a pixel the map is as steep as over the whole strip within a thousandth of it.
    steps = (x_m.size - 1) * float(x_m[1] - x_m[0]), float(fine_y[-1] - fine_y[0])
    across = (pixels[:, -1:] - pixels[:, :1]) / steps[0]
    along = (pixels[-1:] - pixels[:1]) / steps[1]
    turn = across[..., 0] * along[..., 1] - across[..., 1] * along[..., 0]
    beside = (off[..., 0] * along[..., 1] - off[..., 1] * along[..., 0]) / turn
    height, width = image.shape
    column, row = (nearest[..., k].astype(np.intp) for k in (0, 1))
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    values = image[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
    shape = (y_m.size, rows_each, x_m.size)
    return PixelSamples(
        np.where(inside, values, np.nan).astype(np.float32).reshape(shape),
        (x_m + beside).astype(np.float32).reshape(shape),
    )


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
    points[..., 2] = surface.height(axes[0], axes[1][:, None])
    pixels = view.project(points)
    # What lies behind the camera is outside the photo. Single precision is 1e-4 px.
    return np.where(np.isfinite(pixels), pixels, -1e4).astype(np.float32)


def _spread(lattice: Float32Array, n_rows: int, n_columns: int) -> Float32Array:
    """Interpolate a lattice linearly to every line of the strip, as a picture that is enlarged."""
    height, width = lattice.shape[:2]
    whole = cv2.resize(lattice, (_LATTICE * width, _LATTICE * height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(whole[_LATTICE : _LATTICE + n_rows, _LATTICE : _LATTICE + n_columns], dtype=np.float32)
