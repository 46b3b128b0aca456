"""Edges across a rectified strip: where brightness changes fastest, to a fraction of a sample."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.validate import Float32Array, FloatArray, IntArray
from observer.photo_edges.rectify import Strip

#: Width of the derivative filter in samples. Below one it follows the pixel grid, above two neighbouring edges mix.
_FILTER_SAMPLES = 1.2
#: An edge stands this many standard deviations of the noise above it.
_NOISE_TIMES = 6.0
#: An edge has at least this share of the contrast that most rows' strongest edges have.
_LEAST_SHARE = 0.2
#: So many samples give the noise to one percent.
_NOISE_SAMPLES = 5000
#: So many samples beside an edge its blur has ended.
_BESIDE_SAMPLES = 4
#: What resampling and the grid of pixels leave of an edge's position, in samples.
_FLOOR_SAMPLES = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """Edges of one strip.

    row (n,): Row of each.
    x_m (n,): Position across the trough [m].
    sigma_x_m (n,): Standard deviation of the position [m].
    rise_dn (n,): Step of the brightness towards larger x, negative where it falls [DN].
    contrast (n,): The step over the brightness of the brighter side.
    """

    row: IntArray
    x_m: FloatArray
    sigma_x_m: FloatArray
    rise_dn: FloatArray
    contrast: FloatArray

    def chosen(self, which: IntArray) -> "Edges":
        """Return some of them."""
        return Edges(*(getattr(self, name)[which] for name in self.__slots__))


@dataclass(frozen=True, slots=True, eq=False)
class _Filter:
    """The derivative of a Gaussian, and by how much it and its own derivative pass noise."""

    weights: FloatArray
    noise: float
    noise_of_slope: float

    @classmethod
    def of_width(cls, width: float) -> "_Filter":
        reach = int(np.ceil(4 * width))
        place = np.arange(-reach, reach + 1)
        bell = np.exp(-0.5 * (place / width) ** 2)
        bell /= bell.sum()
        first, second = place / width**2 * bell, (place**2 / width**4 - 1 / width**2) * bell
        return cls(first, float(np.sqrt((first**2).sum())), float(np.sqrt((second**2).sum())))

    @property
    def reach(self) -> int:
        """Samples on each side."""
        return self.weights.size // 2


@dataclass(frozen=True, slots=True, eq=False)
class _Peaks:
    """Where the brightness of one strip changes fastest, n places.

    Row and column of each, logarithms of the size of the derivative before, at and after it, shape (3, n), the
    derivative itself, the brightness beside it on both sides, shape (2, n); noise of the strip [DN].
    """

    row: IntArray
    column: IntArray
    logs: FloatArray
    height_dn: FloatArray
    sides_dn: FloatArray
    noise_dn: float


def find_edges(strips: Sequence[Strip], *, oversampling: int = 1) -> tuple[Edges, IntArray]:
    """Find all edges across strips.

    Shapes: strip (n,).
    strips: Rectified brightness.
    oversampling: Samples of the strips for each pixel of their photo. With one, interpolation between pixels moves
        an edge by up to 0.025 px with its place among them; with two by less than 0.002 px.

    Extrema of the brightness filtered by the derivative of a Gaussian; the position is the peak of the parabola
    through the logarithms of three values, exact for an edge blurred by a Gaussian. A linear change of the background
    adds a constant to the derivative and leaves its peak where it is, other than a crossing of a level.
    """
    derivative = _Filter.of_width(_FILTER_SAMPLES * oversampling)
    parts = [_peaks(strip, derivative, oversampling) for strip in strips]
    if not parts:
        none, empty = np.zeros(0, dtype=np.intp), np.zeros(0)
        return Edges(none, empty, empty, empty, empty), none
    counts = [part.row.size for part in parts]
    before, here, after = np.concatenate([part.logs for part in parts], axis=1)
    bend = np.minimum(before - 2 * here + after, -1e-3)
    shift = np.clip(0.5 * (before - after) / bend, -0.5, 0.5)
    first_m, step_m, noise_dn = np.repeat(
        [[strip.x_m[0], strip.x_m[1] - strip.x_m[0], part.noise_dn] for strip, part in zip(strips, parts, strict=True)],
        counts,
        axis=0,
    ).T
    height = np.concatenate([part.height_dn for part in parts])
    # The derivative's noise moves its peak by noise of the second derivative over the peak's curvature.
    wander = noise_dn * derivative.noise_of_slope / (np.abs(height) * np.abs(bend))
    sigma = step_m * np.hypot(wander, _FLOOR_SAMPLES)
    rise = height * np.sqrt(-1 / bend) * np.sqrt(2 * np.pi)
    sides = np.concatenate([part.sides_dn for part in parts], axis=1)
    brighter = np.maximum(np.maximum(*sides), np.abs(rise))
    row, column = (np.concatenate([getattr(part, name) for part in parts]) for name in ("row", "column"))
    edges = Edges(row, first_m + step_m * (column + shift), sigma, rise, rise / np.maximum(brighter, 1e-6))
    return edges, np.repeat(np.arange(len(parts)), counts)


def _peaks(strip: Strip, derivative: _Filter, oversampling: int) -> _Peaks:
    """Return where the brightness of a strip changes fastest: more than by noise, and than by most of what it shows."""
    reach = derivative.reach
    is_whole = bool(strip.seen.all())
    image = strip.image_dn if is_whole else np.where(strip.seen, strip.image_dn, np.float32(0))
    gradient = cv2.sepFilter2D(image, cv2.CV_32F, derivative.weights, np.ones(1), borderType=cv2.BORDER_REPLICATE)
    size = np.abs(gradient)
    # Samples between the same pixels share their noise.
    noise_dn = _noise(strip, oversampling, is_whole) * float(np.sqrt(oversampling))
    strongest = float(np.median(size.max(axis=1)))
    least = max(_NOISE_TIMES * noise_dn * derivative.noise, _LEAST_SHARE * strongest, 1e-6)
    peak = _highest(size, least, reach)
    # A filter that reaches beyond the photo, or the strip, sees its border.
    if not is_whole:
        kernel = np.ones((1, 2 * reach + 1), np.uint8)
        peak = peak[cv2.erode(strip.seen.astype(np.uint8), kernel, borderValue=0).ravel()[peak] > 0]
    row, column = np.divmod(peak, size.shape[1])
    logs = np.log(np.maximum(size.ravel()[peak + np.arange(-1, 2)[:, None]], 1e-6)).astype(np.float64)
    # The filter reaches as far, so what is beside lies in the same row.
    beside = min(_BESIDE_SAMPLES * oversampling, reach)
    sides = strip.image_dn.ravel()[peak + np.array([[-beside], [beside]])].astype(np.float64)
    return _Peaks(row, column, logs, gradient.ravel()[peak].astype(np.float64), sides, noise_dn)


def _highest(size: Float32Array, least: float, margin: int) -> IntArray:
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
    return max(1.2 * robust_scale(third, upper=True) / float(np.sqrt(20.0)), 0.05)
