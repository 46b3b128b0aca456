"""Edges of the tube in a strip where the glass around it disturbs the background: by the middle level of brightness.

Beside the metal one looks through the glass as through a prism: within some 10 mm of the edge the background may be
darker or brighter on one side than on the other, which pulls the steepest place of a blurred edge by up to 0.15 px. On
the metal the glass throws back what is around, more on one side: low levels are pulled the other way. Half-way between
the tube's brightness and what is seen beyond the glass both nearly cancel, and the blur, whatever it is, leaves that
place where it is: in ray-traced photos of tubes 7 and 12 px wide the bisector stays within 0.008 px, against 0.016 px
at a quarter of the way. Rows are averaged before the level is sought; in single ones noise would cross it too early.

Under broken clouds the sky beyond the glass is not the sky beside the metal, and the same piece of it in all photos:
lines of sight past the tube leave the mirror along its axis wherever the camera is. So what is seen beyond the glass
only says what the glass takes off beside the metal, on the median of all rows; how the background changes along the
tube is read beside the metal. Bisectors of all photos from one side were wrong by 0.038 px together, and are by 0.01.
"""

import cv2
import numpy as np

from heliogauge.validate import Float32Array, FloatArray, IntArray
from observer.photo_edges.rectify import Strip

#: Share of the way from the tube's brightness to the background's.
_LEVEL = 0.5
#: So many neighbouring rows are averaged.
_ROWS_TOGETHER = 8
#: From the middle to the left, and to the right.
_WAYS = np.array([[-1.0], [1.0]])
#: Samples of a strip between places at which brightness is read.
_STEP_SAMPLES = 0.25
#: Numbers that are read on the tube and beyond the glass, of which the median counts; odd.
_LEVEL_SAMPLES = 9
#: Where the background is read: so many samples beyond the glass, over so many more.
_BEYOND_SAMPLES = (2.0, 6.0)
#: And beside the metal, within the glass: from where blur has ended [px].
_BESIDE_PX = (1.0, 2.0)
#: Brightness beside the metal stands for the background where it is between these shares of what is usual along the
#: tube.
_LEAST_BESIDE, _MOST_BESIDE = 0.5, 2.0


def level_edges(
    strip: Strip,
    row: IntArray,
    middle_m: FloatArray,
    half_width_m: FloatArray,
    glass_ratio: float,
    oversampling: int = 1,
) -> tuple[FloatArray, FloatArray]:
    """Find both edges of the tube by the level half-way between its brightness and what is seen beyond the glass.

    Shapes: middle_m (m,), half_width_m (m,).
    row (m,): Rows in which the tube was found.
    glass_ratio: Outer radius of the glass over that of the tube; 1 without glass.
    oversampling: Samples of the strip for each pixel of the photo.
    left_m, right_m (m,): Edges at the smaller and at the larger x; NaN where the brightness does not cross the
        level near the edge [m].
    """
    if row.size == 0:
        return np.zeros(0), np.zeros(0)
    step = oversampling * float(strip.x_m[1] - strip.x_m[0])
    _, group = np.unique(row // _ROWS_TOGETHER, return_inverse=True)
    # Means over the rows of each group.
    mean = (group == np.arange(group.max() + 1)[:, None]).astype(np.float64)
    mean /= mean.sum(axis=1, keepdims=True)
    half = mean @ half_width_m
    beyond = glass_ratio * half[:, None] + step * np.linspace(*_BEYOND_SAMPLES, _LEVEL_SAMPLES)
    beside = half[:, None] + step * np.linspace(*_BESIDE_PX, _LEVEL_SAMPLES)
    across = np.linspace(-0.5, 0.5, _LEVEL_SAMPLES) * half[:, None]
    offsets = np.stack([-beyond, -beside, across, beside, beyond], axis=1)[group]
    before, near_before, inside, near_after, after = (mean @ _plateaus(strip, row, middle_m, offsets)).T
    contrast = np.stack(
        [_as_beside(before - inside, near_before - inside), _as_beside(after - inside, near_after - inside)]
    )
    # The level is crossed where the tube ends: nothing is read far within it.
    skipped = max(int(0.5 * float(half.min()) / (_STEP_SAMPLES * step)) - 1, 0)
    outward = _STEP_SAMPLES * step * np.arange(skipped, (1.5 * float(half.max()) / step + 1) / _STEP_SAMPLES)
    profile = mean @ _outward(strip, row, middle_m, outward / step * oversampling)
    share = (profile - inside[:, None]) / contrast[:, :, None]
    # The last place below the level on the way out, within the tube's half width.
    above = (share > _LEVEL) & (outward > 0.5 * half[:, None])
    first = np.argmax(above, axis=2)
    last = np.maximum(first - 1, 0)
    low, high = (np.take_along_axis(share, place[..., None], axis=2)[..., 0] for place in (last, first))
    part = (_LEVEL - low) / np.where(high > low, high - low, np.nan)
    place = outward[last] + part * (outward[1] - outward[0])
    found = above.any(axis=2) & (first > 0) & (np.abs(place - half) < 2 * step)
    left, right = middle_m + _WAYS * np.where(found, place, np.nan)[:, group]
    return left, right


def _as_beside(far: FloatArray, near: FloatArray) -> FloatArray:
    """Return how much brighter than the tube the background is: as beyond the glass on the median, changing as beside.

    Where both differ too much from what is usual something else is beside the metal, and what is beyond counts.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        taken = near / far
        usual = float(np.median(taken[np.isfinite(taken)])) if np.isfinite(taken).any() else 1.0
        share = taken / usual
    return np.asarray(np.where((share > _LEAST_BESIDE) & (share < _MOST_BESIDE), share, 1.0) * far)


def _plateaus(strip: Strip, row: IntArray, middle_m: FloatArray, offsets_m: FloatArray) -> FloatArray:
    """Return the median brightness of rows over offsets, shape (m, i, k), from their middles, shape (m, i)."""
    step = float(strip.x_m[1] - strip.x_m[0])
    places = np.empty((*offsets_m.shape, 2), dtype=np.float32)
    places[..., 0] = (offsets_m + (middle_m - strip.x_m[0])[:, None, None]) / step
    places[..., 1] = row[:, None, None]
    flat = places.reshape(row.size, -1, 2)
    values = cv2.remap(strip.image_dn, flat, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)  # type: ignore[call-overload]
    middle = offsets_m.shape[2] // 2
    return np.partition(np.asarray(values).reshape(offsets_m.shape), middle, axis=2)[..., middle].astype(np.float64)


def _outward(strip: Strip, row: IntArray, middle_m: FloatArray, places: FloatArray) -> Float32Array:
    """Interpolate the brightness of m rows outwards by cubic convolution to both sides, shape (2, m, n).

    At n places, counted in samples from the middles, whose step is a whole fraction of a sample: places that are whole
    samples apart share their weights. Linear interpolation would move the level by 0.03 px with the place of the edge
    among the pixels.
    """
    each, width = round(1 / (places[1] - places[0])), strip.x_m.size
    count = -(-places.size // each)
    start = _WAYS * ((middle_m - strip.x_m[0]) / (strip.x_m[1] - strip.x_m[0])) + places[0]
    first = np.floor(start)
    columns = np.clip(_WAYS[..., None] * (first[..., None] + np.arange(-1, count + 3)), 0, width - 1).astype(np.intp)
    found = strip.image_dn.ravel()[columns + (row * width)[:, None]]
    weights = _five_weights(start - first + (np.arange(each) / each)[:, None, None]).astype(np.float32)
    values = np.empty((*start.shape, count, each), dtype=np.float32)
    for k in range(each):
        values[..., k] = sum(weights[i, k][..., None] * found[..., i : i + count] for i in range(5))
    return values.reshape(*start.shape, -1)[..., : places.size]


def _five_weights(place: FloatArray) -> FloatArray:
    """Return the weights of neighbours -1 to 3 of places between 0 and 2 by cubic convolution, shape (5, ...).

    Keys 1981, eq. 15: pieces of third degree over four neighbours, the fifth has none.
    """
    distance = np.abs(place - np.arange(-1.0, 4.0).reshape(5, *np.ones(place.ndim, dtype=np.intp)))
    near = (1.5 * distance - 2.5) * distance * distance + 1.0
    far = ((-0.5 * distance + 2.5) * distance - 4.0) * distance + 2.0
    return np.where(distance < 1, near, np.where(distance < 2, far, 0.0))
