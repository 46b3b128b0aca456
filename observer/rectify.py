"""A strip of the mirror as one photo shows it, with perspective, lens and curvature taken out (Owkes 2012, 6.3.1)."""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.camera import Camera
from heliogauge.rigid import RigidTransform
from heliogauge.surfaces import Quadric
from heliogauge.validate import BoolArray, Float32Array, FloatArray

#: Samples between exact projections. Across 8 of 6 mm the curved mirror departs from its chord by 0.1 mm in height,
#: which moves its image by less than 0.001 px.
_LATTICE = 8
#: Columns that are closer than this are there to show the shape of an edge.
_CLOSE_PX = 0.6


@dataclass(frozen=True, slots=True, eq=False)
class Strip:
    """Part of the mirror, resampled.

    Parameters
    ----------
    image_dn : ndarray of float32, shape (r, n)
        Brightness, rows of constant y [DN].
    x_m : ndarray, shape (n,)
        Columns [m].
    seen : ndarray of bool, shape (r, n)
        Whether the photo shows the point.
    """

    image_dn: Float32Array
    x_m: FloatArray
    seen: BoolArray


def rectified_strip(
    image: npt.NDArray[np.uint8] | npt.NDArray[np.uint16] | Float32Array,
    view: tuple[Camera, RigidTransform],
    surface: Quadric,
    x_m: FloatArray,
    y_m: FloatArray,
    *,
    rows_each: int = 1,
) -> Strip:
    """Resample a photo on the design surface.

    Parameters
    ----------
    image : ndarray, shape (height, width)
        The photo, grey [DN].
    view : (Camera, RigidTransform)
        Its camera and ``cam_from_frame``.
    surface : Quadric
        The mirror's surface in the frame.
    x_m : ndarray, shape (n,)
        Ascending, equally spaced columns [m].
    y_m : ndarray, shape (r,)
        Ascending, equally spaced rows [m].
    rows_each : int, optional
        Lines of sight that are averaged along each row's width, so that every pixel counts.

    Returns
    -------
    Strip
        Brightness on the mirror.

    Notes
    -----
    Columns closer than the pixels are interpolated by 8 by 8 pixels, which keeps the shape of an edge wherever it lies
    among them; others by 2 by 2, which blurs it by place but costs little.
    """
    step = float(y_m[1] - y_m[0]) if y_m.size > 1 else 0.0
    inner = step * ((np.arange(rows_each) + 0.5) / rows_each - 0.5)
    fine_y = (y_m[:, None] + inner).reshape(-1)
    map_x, map_y = (_spread(part, fine_y.size, x_m.size) for part in _lattice(view, surface, x_m, fine_y))
    apart = np.hypot(np.diff(map_x[fine_y.size // 2]), np.diff(map_y[fine_y.size // 2]))
    way = cv2.INTER_LANCZOS4 if apart.size and float(np.median(apart)) < _CLOSE_PX else cv2.INTER_LINEAR
    sampled = cv2.remap(image, map_x, map_y, way, borderMode=cv2.BORDER_REPLICATE)
    values = np.asarray(sampled, dtype=np.float32).reshape(y_m.size, rows_each, x_m.size).mean(axis=1)
    height, width = image.shape
    inside = (map_x >= 0) & (map_x <= width - 1) & (map_y >= 0) & (map_y <= height - 1)
    seen = inside.reshape(y_m.size, rows_each, x_m.size).all(axis=1)
    return Strip(values, x_m, seen)


def _lattice(
    view: tuple[Camera, RigidTransform], surface: Quadric, x_m: FloatArray, y_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Project a coarse lattice whose first and last lines lie on those of the strip, or beyond."""
    camera, cam_from_frame = view
    axes = []
    for values in (x_m, y_m):
        count = -(-(values.size - 1) // _LATTICE) + 1
        step = float(values[1] - values[0]) if values.size > 1 else 0.0
        # Rows inside one map row need not be spaced like the map rows: they are, because the inner lines fill it.
        axes.append(values[0] + step * _LATTICE * np.arange(count))
    grid_x, grid_y = np.meshgrid(*axes)
    points = np.stack([grid_x, grid_y, surface.height(grid_x, grid_y)], axis=-1)
    pixels = camera.project(cam_from_frame.apply(points))
    # What lies behind the camera is outside the photo.
    pixels = np.where(np.isfinite(pixels), pixels, -1e4)
    return pixels[..., 0], pixels[..., 1]


def _spread(coarse: FloatArray, n_rows: int, n_columns: int) -> Float32Array:
    """Interpolate a lattice linearly to every line of the strip.

    A product with two narrow matrices takes a tenth of the time of indexing; single precision is 1e-4 px.
    """
    down, across = _shares(n_rows, coarse.shape[0]), _shares(n_columns, coarse.shape[1])
    return np.ascontiguousarray(down @ coarse.astype(np.float32) @ across.T)


def _shares(size: int, count: int) -> Float32Array:
    """Return the shares that the lines of a lattice have in each line of the strip, shape (size, count)."""
    index = np.arange(size)
    before = np.minimum(index // _LATTICE, max(count - 2, 0))
    share = (index - before * _LATTICE) / _LATTICE
    shares = np.zeros((size, count), dtype=np.float32)
    shares[index, before] = 1 - share
    shares[index, np.minimum(before + 1, count - 1)] += share.astype(np.float32)
    return shares
