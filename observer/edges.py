"""Edges across a rectified strip: where brightness changes fastest, to a fraction of a sample."""

from dataclasses import dataclass

import cv2
import numpy as np

from heliogauge.validate import Float32Array, FloatArray
from observer.rectify import Strip
from observer.slope_field import IntArray

#: Width of the derivative filter in samples. Below one it follows the pixel grid, above two neighbouring edges mix.
_FILTER_SAMPLES = 1.2
#: An edge stands this many standard deviations of the noise above it.
_NOISE_TIMES = 6.0
#: An edge has at least this share of the contrast that most rows' strongest edges have.
_LEAST_SHARE = 0.2
#: So many samples tell the noise to one percent.
_NOISE_SAMPLES = 5000
#: So many samples beside an edge its blur has ended.
_BESIDE_SAMPLES = 4
#: What resampling and the grid of pixels leave of an edge's position, in samples.
_FLOOR_SAMPLES = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """Edges of one strip.

    Parameters
    ----------
    row : ndarray of int, shape (n,)
        Row of each.
    x_m : ndarray, shape (n,)
        Position across the trough [m].
    sigma_x_m : ndarray, shape (n,)
        Standard deviation of the position [m].
    rise_dn : ndarray, shape (n,)
        Step of the brightness towards larger x, negative where it falls [DN].
    contrast : ndarray, shape (n,)
        The step over the brightness of the brighter side.
    """

    row: IntArray
    x_m: FloatArray
    sigma_x_m: FloatArray
    rise_dn: FloatArray
    contrast: FloatArray

    def chosen(self, which: IntArray) -> "Edges":
        """Return some of them."""
        return Edges(*(getattr(self, name)[which] for name in self.__slots__))


def find_edges(strip: Strip, *, oversampling: int = 1) -> Edges:
    """Find all edges across a strip.

    Parameters
    ----------
    strip : Strip
        Rectified brightness.
    oversampling : int, optional
        Samples of the strip for each pixel of the photo. With one, interpolation between pixels moves an edge by up to
        0.025 px with its place among them; with two by less than 0.002 px.

    Returns
    -------
    Edges
        In the order of the rows.

    Notes
    -----
    Extrema of the brightness filtered by the derivative of a Gaussian; the position is the peak of the parabola through
    the logarithms of three values, exact for an edge blurred by a Gaussian. A linear change of the background adds a
    constant to the derivative and leaves its peak where it is, other than a crossing of a level.
    """
    width = _FILTER_SAMPLES * oversampling
    reach = int(np.ceil(4 * width))
    place = np.arange(-reach, reach + 1)
    bell = np.exp(-0.5 * (place / width) ** 2)
    bell /= bell.sum()
    derivative = place / width**2 * bell
    is_whole = bool(strip.seen.all())
    image = strip.image_dn if is_whole else np.where(strip.seen, strip.image_dn, np.float32(0))
    gradient = cv2.sepFilter2D(image, cv2.CV_32F, derivative, np.ones(1), borderType=cv2.BORDER_REPLICATE)
    size = np.abs(gradient)
    # Samples between the same pixels share their noise.
    noise_dn = _noise(strip, oversampling, is_whole) * float(np.sqrt(oversampling))
    noise = noise_dn * float(np.sqrt((derivative**2).sum()))
    strongest = float(np.median(size.max(axis=1)))
    peak = _peaks(size, max(_NOISE_TIMES * noise, _LEAST_SHARE * strongest, 1e-6), reach)
    # A filter that reaches beyond the photo, or the strip, sees its border.
    if not is_whole:
        kernel = np.ones((1, 2 * reach + 1), np.uint8)
        peak = peak[cv2.erode(strip.seen.astype(np.uint8), kernel, borderValue=0).ravel()[peak] > 0]
    row, column = np.divmod(peak, size.shape[1])
    flat = size.ravel()
    before, here, after = (np.log(np.maximum(flat[peak + i], 1e-6)).astype(np.float64) for i in (-1, 0, 1))
    bend = np.minimum(before - 2 * here + after, -1e-3)
    shift = np.clip(0.5 * (before - after) / bend, -0.5, 0.5)
    step = float(strip.x_m[1] - strip.x_m[0])
    height = gradient.ravel()[peak].astype(np.float64)
    # The derivative's noise moves its peak by noise of the second derivative over the peak's curvature.
    second = (place**2 / width**4 - 1 / width**2) * bell
    wander = noise_dn * np.sqrt((second**2).sum()) / (np.abs(height) * np.abs(bend))
    sigma = step * np.hypot(wander, _FLOOR_SAMPLES)
    rise = height * np.sqrt(-1 / bend) * np.sqrt(2 * np.pi)
    last = strip.x_m.size - 1
    sides = [strip.image_dn[row, np.clip(column + way * _BESIDE_SAMPLES * oversampling, 0, last)] for way in (-1, 1)]
    brighter = np.maximum(np.maximum(*sides), np.abs(rise)).astype(np.float64)
    return Edges(row, strip.x_m[column] + step * shift, sigma, rise, rise / np.maximum(brighter, 1e-6))


def _peaks(size: Float32Array, least: float, margin: int) -> IntArray:
    """Return where rows have their peaks above a level, away from the ends of the rows, as numbers of ``size.ravel()``.

    Numbers in one line of memory are found three times as fast as rows and columns.
    """
    flat, n_columns = size.ravel(), size.shape[1]
    above = np.flatnonzero(flat > least)
    column = above % n_columns
    above = above[(column >= margin) & (column < n_columns - margin)]
    here = flat[above]
    return np.asarray(above[(here >= flat[above - 1]) & (here > flat[above + 1])], dtype=np.intp)


def _noise(strip: Strip, stride: int, is_whole: bool) -> float:
    """Return the noise of a strip from third differences, which smooth shading leaves out [DN]."""
    some = max(1, strip.image_dn.size // (stride * _NOISE_SAMPLES))
    third = np.diff(strip.image_dn[::some, ::stride], 3, axis=1)
    if not is_whole:
        seen = strip.seen[::some, ::stride]
        third = third[seen[:, 3:] & seen[:, :-3]]
    if third.size < 100:
        return 1.0
    # Weights 1, 3, 3, 1; resampling makes neighbours alike, which the factor 1.2 allows for.
    return max(1.2 * 1.4826 * float(np.median(np.abs(third))) / float(np.sqrt(20.0)), 0.05)
