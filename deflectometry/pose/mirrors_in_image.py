"""Find mirrors in an image of how much pattern light each pixel gets: regions, polygons, sub-pixel edges, masks.

The image may be the modulation of the fringes or bright minus dark; a mirror is brighter than what surrounds it.
Every length used here follows from the image itself (size of the region, width of its edge), not from a number of
pixels that fits one camera.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.errors import EstimationError, InputError
from heliogauge.validate import BoolArray, Float32Array, FloatArray, IntArray, float_array, freeze

#: A mirror must stand out from its surroundings by this many times the noise of one pixel.
MIN_CONTRAST_TO_NOISE = 8.0
#: Regions below this share of the largest one are lamps, reflections and dust, not facets.
MIN_AREA_SHARE = 0.1
#: Samples per pixel along an edge profile.
_SAMPLES_PER_PIXEL = 2


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """One connected bright region, holes filled.

    contour_px (n, 2): Its outer pixels in order (x, y) [px].
    area_px: Number of pixels inside.
    centroid_px (2,): Mean of the pixels inside (x, y) [px].
    borders: The sides of the image that it touches: "left", "right", "top", "bottom".
    """

    contour_px: FloatArray
    area_px: float
    centroid_px: FloatArray
    borders: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class FoundMirrors:
    """Bright regions, largest first, and the levels that separate them from the rest.

    regions: The regions found; at least one.
    mask (h, w): The pixels of these regions, holes filled.
    level_dn: The level that divides [DN].
    inside_dn, outside_dn: Medians on both sides [DN].
    noise_dn: Standard deviation of the noise of one pixel [DN].
    """

    regions: tuple[Region, ...]
    mask: BoolArray
    level_dn: float
    inside_dn: float
    outside_dn: float
    noise_dn: float


@dataclass(frozen=True, slots=True, eq=False)
class EdgePoints:
    """Where edges lie along given normals.

    offset_px (n,): Distance of the edge from each point along its outward normal; NaN where there is no clear edge
        [px].
    sigma_px (n,): Its standard deviation from the noise alone [px].
    contrast_dn (n,): Inside minus outside level [DN].
    width_px: Width of the edges: height divided by steepest slope, the median of all; NaN without any edge [px].
    """

    offset_px: FloatArray
    sigma_px: FloatArray
    contrast_dn: FloatArray
    width_px: float


def find_mirrors(image_dn: npt.ArrayLike) -> FoundMirrors:
    """Find the bright regions of an image, without a given level or size.

    image_dn (h, w): Modulation, or bright minus dark [DN]. Values that are not finite count as dark.
    Returns: Regions of at least a tenth of the largest one's area.
    InputError: Not an image.
    EstimationError: Nothing stands out from the noise.

    The dividing level is where the level line crosses the largest sum of squared steps between neighbouring pixels:
    the outline of a mirror is a long line of high steps. Unlike a histogram method this also holds when the mirror
    covers a hundredth of the image, or when the room around it has several grey levels.
    """
    image = _as_image(image_dn)
    noise_dn = image_noise(image)
    # The median of 3 x 3 removes hot pixels and keeps straight edges where they are.
    smooth = np.asarray(cv2.medianBlur(image, 3), dtype=np.float32)
    level_dn = _dividing_level(smooth)
    bright = (smooth > level_dn).astype(np.uint8)
    n_labels, label_image, label_stats, _ = cv2.connectedComponentsWithStats(bright, connectivity=4)
    labels, stats = np.asarray(label_image, dtype=np.int32), np.asarray(label_stats, dtype=np.int32)
    areas = stats[1:, cv2.CC_STAT_AREA]
    kept = 1 + np.flatnonzero(areas >= MIN_AREA_SHARE * areas.max()) if n_labels > 1 else np.zeros(0, dtype=np.int64)
    inside_dn, outside_dn = _median(image[bright > 0]), _median(image[bright == 0])
    if not (kept.size and inside_dn - outside_dn > MIN_CONTRAST_TO_NOISE * noise_dn):
        raise EstimationError(
            f"no mirror in view: the bright part of the image ({inside_dn:.1f} DN) stands out from the rest"
            f" ({outside_dn:.1f} DN) by less than {MIN_CONTRAST_TO_NOISE:g} times the noise ({noise_dn:.2f} DN); check"
            " that the mirror is in the image, in focus, and reflects the screen"
        )
    regions = sorted((_region(labels, stats, int(label)) for label in kept), key=lambda region: -region.area_px)
    mask = np.zeros(image.shape, dtype=np.uint8)
    cv2.drawContours(mask, [_as_contour(region) for region in regions], -1, 1, cv2.FILLED)
    return FoundMirrors(tuple(regions), freeze(mask > 0), level_dn, inside_dn, outside_dn, noise_dn)


def _as_image(image_dn: npt.ArrayLike) -> Float32Array:
    image = np.ascontiguousarray(image_dn, dtype=np.float32)
    if image.ndim != 2 or min(image.shape) < 8:
        raise InputError(f"image_dn: an image of shape (h, w), at least 8 x 8, is needed, not {image.shape}")
    finite = np.isfinite(image)
    return image if finite.all() else np.where(finite, image, np.float32(0))


def _median(values: Float32Array) -> float:
    # A sample of every k-th pixel: the median of 65536 pixels is as good as that of millions.
    return float(np.median(values[:: max(1, values.size // 65536)])) if values.size else float("nan")


def image_noise(image_dn: Float32Array) -> float:
    """Estimate the noise of one pixel from second differences, robust against the few pixels on edges.

    Shapes: image_dn (h, w).
    Returns: Standard deviation [DN]; at least that of rounding to the smallest step of the image.
    """
    rows = image_dn[:: max(1, image_dn.shape[0] // 256)]
    second = rows[:, 2:] - 2 * rows[:, 1:-1] + rows[:, :-2]
    # The second difference of noise has sqrt(6) sigma.
    robust = robust_scale(second) / np.sqrt(6)
    steps = np.abs(second[second != 0])
    rounding = float(steps.min()) / np.sqrt(12) if steps.size and robust == 0 else 0.0
    return float(max(robust, rounding))


def _dividing_level(image: Float32Array) -> float:
    shrink = max(1, round(max(image.shape) / 512))
    small = image
    if shrink > 1:
        size = (image.shape[1] // shrink, image.shape[0] // shrink)
        small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.float32)
    low, high = float(small.min()), float(small.max())
    if not high > low:
        return high
    n_levels = 256
    scaled = (small - low) * ((n_levels - 1) / (high - low))
    energy = np.zeros(n_levels + 1)
    for first, second in ((scaled[:, 1:], scaled[:, :-1]), (scaled[1:], scaled[:-1])):
        # A step between two neighbours counts for every level between them, with its square. Steps that noise makes
        # do not count: a million of them would outweigh the outline of a small, dim mirror.
        steps = np.abs(first - second).ravel()
        weights = np.where(steps > 4 * robust_scale(steps[:: max(1, steps.size // 65536)]), steps**2, 0)
        bottom = np.ceil(np.minimum(first, second)).astype(np.intp).ravel()
        top = np.ceil(np.maximum(first, second)).astype(np.intp).ravel()
        energy += np.bincount(bottom, weights, n_levels + 1) - np.bincount(top, weights, n_levels + 1)
    energy = np.cumsum(energy)
    best = int(np.argmax(energy))
    weak = np.flatnonzero(energy < 0.5 * energy[best])
    first_level = int(weak[weak < best].max(initial=-1)) + 1
    last_level = int(weak[weak > best].min(initial=n_levels)) - 1
    return low + 0.5 * (first_level + last_level) * (high - low) / (n_levels - 1)


def _region(labels: npt.NDArray[np.int32], stats: npt.NDArray[np.int32], label: int) -> Region:
    left, top, width, height = (int(value) for value in stats[label, :4])
    window = (labels[top : top + height, left : left + width] == label).astype(np.uint8)
    contours, _ = cv2.findContours(window, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE, offset=(left, top))
    contour = max(contours, key=len)
    moments = cv2.moments(contour)
    area = max(moments["m00"], 1e-12)
    points = contour.reshape(-1, 2).astype(np.float64)
    centroid = np.array([moments["m10"], moments["m01"]]) / area if moments["m00"] > 0 else points.mean(axis=0)
    last_row, last_column = labels.shape[0] - 1, labels.shape[1] - 1
    # The median filter repeats the border, and a mirror that ends one pixel before it has no visible edge either.
    touches = {
        "left": left <= 1,
        "right": left + width - 1 >= last_column - 1,
        "top": top <= 1,
        "bottom": top + height - 1 >= last_row - 1,
    }
    borders = tuple(side for side, touched in touches.items() if touched)
    return Region(freeze(points), float(moments["m00"]), freeze(centroid), borders)


def _as_contour(region: Region) -> npt.NDArray[np.int32]:
    return region.contour_px.astype(np.int32).reshape(-1, 1, 2)


def enclosing_polygon(points_px: npt.ArrayLike, n_corners: int) -> FloatArray:
    """Return the polygon of few corners that encloses points most tightly.

    points_px (n, 2): Points (x, y) [px]; their convex hull counts.
    n_corners: Wanted corners, at least 3.
    Returns (n_corners, 2): Corners in the order of growing angle from x to y, clockwise as displayed (y points
        down) [px].
    EstimationError: The hull has fewer corners, or its sides do not meet.

    Sides of the hull are dropped one by one, each time the one whose neighbours, made longer until they meet, add the
    least area.
    """
    points = float_array("points_px", points_px, (None, 2))
    hull = cv2.convexHull(points.astype(np.float32)).reshape(-1, 2).astype(np.float64)
    if _signed_area(hull) < 0:
        hull = hull[::-1]
    while len(hull) > n_corners:
        added, meeting = _merge_costs(hull)
        cheapest = int(np.argmin(added))
        if not np.isfinite(added[cheapest]):
            break
        hull[cheapest] = meeting[cheapest]
        hull = np.delete(hull, (cheapest + 1) % len(hull), axis=0)
    if len(hull) != n_corners:
        raise EstimationError(
            f"the outline found has {len(hull)} corners, {n_corners} are needed; check the outline in the measurement"
            " against the image"
        )
    return hull


def _signed_area(corners: FloatArray) -> float:
    following = np.roll(corners, -1, axis=0)
    return 0.5 * float((corners[:, 0] * following[:, 1] - corners[:, 1] * following[:, 0]).sum())


def _merge_costs(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """For each side (i, i + 1): the area added when its neighbours are extended, and where they meet."""
    start, end = corners, np.roll(corners, -1, axis=0)
    before = start - np.roll(corners, 1, axis=0)
    after = end - np.roll(corners, -2, axis=0)
    side = end - start
    turn = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (side[:, 0] * after[:, 1] - side[:, 1] * after[:, 0]) / turn
        meeting = start + along[:, None] * before
    reach = meeting - start
    area = 0.5 * np.abs(side[:, 0] * reach[:, 1] - side[:, 1] * reach[:, 0])
    return np.where((along >= 0) & np.isfinite(area), area, np.inf), meeting


def measure_edges(
    image_dn: Float32Array,
    points_px: npt.ArrayLike,
    normals: npt.ArrayLike,
    *,
    reach_px: float,
    noise_dn: float,
    width_px: float | None = None,
) -> EdgePoints:
    """Measure where the bright side ends along normals.

    Shapes: image_dn (h, w).
    points_px (n, 2): Points near the edge (x, y) [px].
    normals (n, 2): Unit vectors from the bright to the dark side.
    reach_px: How far from the points the edge may lie [px].
    width_px: Width of the edges where it is known already; measured otherwise [px].

    The steepest place gives a first position; around it the edge is put where a sharp step of the local levels has
    the same area as the profile. For a blur that is symmetric (optics, defocus, the pixel itself) this is the
    position of the sharp edge, and it averages the noise of all samples.
    """
    points = float_array("points_px", points_px, (None, 2))
    normal = float_array("normals", normals, (points.shape[0], 2))
    # Without a width assume 2 px, the narrowest that sampling of a sharp edge gives after interpolation.
    half_window = _half_window(2.0 if width_px is None else width_px)
    profile, inside_image = _profiles(image_dn, points, normal, reach_px + half_window)
    steepest, slope = _steepest_fall(profile, half_window)
    offset, contrast = _equal_area(profile, steepest, half_window)
    with np.errstate(divide="ignore", invalid="ignore"):
        widths = contrast / (slope * _SAMPLES_PER_PIXEL)
        # The area integral sums 2 * half_window pixels; each of the two levels is the mean of about one pixel's noise
        # and moves the edge by half the window. Interpolation across the profile leaves 2/3 of the variance.
        sigma = noise_dn * np.sqrt((2 * half_window + 0.5 * half_window**2) / 1.5) / contrast
    clear = inside_image & (contrast > MIN_CONTRAST_TO_NOISE * noise_dn) & np.isfinite(offset)
    clear &= np.abs(offset) <= reach_px + 1.0
    if width_px is None and clear.any():
        measured = max(float(np.median(widths[clear])), 1.0)
        if _half_window(measured) > half_window:
            # A blurred edge needs longer windows than assumed.
            return measure_edges(image_dn, points, normal, reach_px=reach_px, noise_dn=noise_dn, width_px=measured)
    width = float(np.median(widths[clear])) if clear.any() else float("nan")
    nothing = np.where(clear, 0.0, np.nan)
    return EdgePoints(freeze(offset + nothing), freeze(sigma + nothing), freeze(contrast), width)


def _half_window(width_px: float) -> float:
    """Return the half length of the window around an edge: its own half width twice, and one pixel of level."""
    return float(np.ceil(_SAMPLES_PER_PIXEL * (width_px + 1.0)) / _SAMPLES_PER_PIXEL)


def _profiles(
    image: Float32Array, points: FloatArray, normals: FloatArray, reach_px: float
) -> tuple[FloatArray, BoolArray]:
    count = int(np.ceil(reach_px * _SAMPLES_PER_PIXEL))
    along = np.arange(-count, count + 1) / _SAMPLES_PER_PIXEL
    x = points[:, :1] + normals[:, :1] * along
    y = points[:, 1:] + normals[:, 1:] * along
    height, width = image.shape
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    # OpenCV's remap rounds positions to 1/32 px, as much as the edges are known: interpolate here.
    column = np.clip(x, 0, width - 2).astype(np.intp)
    row = np.clip(y, 0, height - 2).astype(np.intp)
    right, down = np.clip(x - column, 0, 1), np.clip(y - row, 0, 1)
    flat, base = image.reshape(-1), row * width + column
    upper = flat[base] * (1 - right) + flat[base + 1] * right
    lower = flat[base + width] * (1 - right) + flat[base + width + 1] * right
    return upper * (1 - down) + lower * down, inside.all(axis=1)


def _steepest_fall(profile: FloatArray, half_window: float) -> tuple[IntArray, FloatArray]:
    """Return the sample at which each profile falls most steeply, and the fall per sample there."""
    margin = round(half_window * _SAMPLES_PER_PIXEL)
    fall = 0.5 * (profile[:, :-2] - profile[:, 2:])
    # Mean of three: steadier against noise, one pixel and a half wide.
    fall = (fall[:, :-2] + fall[:, 1:-1] + fall[:, 2:]) / 3
    within = fall[:, margin - 2 : fall.shape[1] - margin + 2]
    best = np.argmax(within, axis=1)
    return best + margin, np.take_along_axis(within, best[:, None], axis=1)[:, 0]


def _equal_area(profile: FloatArray, center: IntArray, half_window: float) -> tuple[FloatArray, FloatArray]:
    half = round(half_window * _SAMPLES_PER_PIXEL)
    window = np.take_along_axis(profile, center[:, None] + np.arange(-half, half + 1), axis=1)
    level = _SAMPLES_PER_PIXEL
    inside, outside = window[:, :level].mean(axis=1), window[:, -level:].mean(axis=1)
    contrast = inside - outside
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (window - outside[:, None]) / contrast[:, None]
        # Trapezoid: the first sample counts half, so that a step exactly at the centre has the area half the window.
        area = (share.sum(axis=1) - 0.5 * (share[:, 0] + share[:, -1])) / _SAMPLES_PER_PIXEL
    middle = (profile.shape[1] - 1) // 2
    return (center - middle) / _SAMPLES_PER_PIXEL - half_window + area, contrast


def polygon_mask(shape: tuple[int, int], corners_px: npt.ArrayLike) -> BoolArray:
    """Return the pixels whose centres lie inside a polygon, exact at any sub-pixel position.

    Shapes: result (h, w).
    shape: (h, w) of the image [px].
    corners_px (n, 2): Corners (x, y) in order, inside or outside the image [px].

    >>> polygon_mask((3, 4), [[0.5, -1], [2.5, -1], [2.5, 1.5], [0.5, 1.5]]).astype(int)
    array([[0, 1, 1, 0],
           [0, 1, 1, 0],
           [0, 0, 0, 0]])
    """
    start = float_array("corners_px", corners_px, (None, 2))
    end = np.roll(start, -1, axis=0)
    lower, upper = np.minimum(start[:, 1], end[:, 1]), np.maximum(start[:, 1], end[:, 1])
    # Each side toggles the rows y with lower <= y < upper, from the column right of where it crosses them.
    first = np.clip(np.ceil(lower), 0, shape[0]).astype(np.intp)
    last = np.clip(np.ceil(upper), 0, shape[0]).astype(np.intp)
    count = last - first
    side = np.repeat(np.arange(len(start)), count)
    row = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + np.repeat(first, count)
    share = (row - start[side, 1]) / (end[side, 1] - start[side, 1])
    x = start[side, 0] + share * (end[side, 0] - start[side, 0])
    column = np.clip(np.ceil(x), 0, shape[1]).astype(np.intp)
    mask = np.zeros(shape, dtype=np.bool_)
    if row.size:
        top, bottom = int(row.min()), int(row.max()) + 1
        left, right = int(column.min()), int(column.max())
        toggles = np.zeros((bottom - top, right - left + 1), dtype=np.uint8)
        np.bitwise_xor.at(toggles, (row - top, column - left), 1)
        mask[top:bottom, left:right] = np.bitwise_xor.accumulate(toggles[:, :-1], axis=1).view(np.bool_)
    return freeze(mask)
