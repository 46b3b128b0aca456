"""Find everything in a photo that may be a circular target: uniform ellipses on a uniform ground, of any size.

The photo is halved again and again; on each scale a local threshold and its outlines find the spots whose size suits
that scale. So the work hardly depends on the sizes searched for: 24 megapixels cost less than decoding them. What
follows judges spots by a few dozen grey values each, all spots at once.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.errors import InputError
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, Float32Array, FloatArray, IntArray
from photogrammetry.centers.edge_rays import outlines_along_rays
from photogrammetry.centers.ellipse import Ellipse
from photogrammetry.centers.pyramid import Pyramid, ellipse_frames, make_pyramid
from photogrammetry.targets.ring_codes import Polarity

Bytes = npt.NDArray[np.uint8]

#: Side of the box whose mean is the local threshold, and smallest and largest width of the spots looked for, in pixels
#: of the level: on the photo itself, and on its halvings. Half as fine, the gap of the smallest code rings is gone: a
#: 6 px dot tilted by 55 deg, or a 12 px dot tilted by 65 deg, merges with its ring.
_FULL_SEARCH, _HALVED_SEARCH = (15, 2.0, 16.0), (31, 3.0, 22.0)
#: Only targets below this diameter are searched on the photo itself; it costs as much as all halvings [px].
_NEEDS_FULL_PX = 20.0
#: Rows that are searched at a time: they stay in the processor's cache, which halves the time.
_STRIPE_ROWS = 384
#: Spots that are judged at a time: a display's pixels are tens of thousands.
_SPOTS_AT_ONCE = 4096
#: Threshold below (above) the local mean, as a share of the least contrast: a spot that fills two thirds of the box
#: still lies a third of its contrast below the box's mean.
_THRESHOLD_SHARE = 0.3
#: Share of its ellipse that a spot must fill: a ring half open fills half of it.
_LEAST_FILLED = 0.7
#: Spots are judged on rings of this many points: two within, at these radii (many prints have a hole or a mark in the
#: middle), and two in the gap, for gaps that end at 1.8, 2 or 2.4 radii and more: a dot of a few pixels bleeds into a
#: narrow gap, and its ring does.
_RING_POINTS, _INNER_RADII, _OUTER_RADII = 16, (0.6, 0.75), ((1.35, 1.5), (1.5, 1.65), (1.65, 1.85))
#: Where the gap of a spot is looked for as well that codes are to confirm: gaps that end at 1.6 radii.
_NARROW_RADII = (1.22, 1.32)
#: Share of ring points that must lie on their side of the middle level; the rest may be covered or in glare.
_RIGHT_SIDE_SHARE = 0.8
#: Mean deviation of the ring's grey values from their median, as a share of the contrast.
_MOST_UNEVEN = 0.2
#: Rms of the edges about the outline above which a spot is no ellipse: in radii, or in pixels for small spots.
_MOST_EDGE_RADII, _MOST_EDGE_PX = 0.05, 0.3
#: The same of a spot that codes are to confirm, in the steps of a display's pixels, and most share of that in the
#: harmonics of triangles and squares. Drawn discs of 7 pixels of a display have 0.05 to 0.075 and 0.2 to 0.63; spots of
#: photos of chessboards and square markers 0.06 to 0.12, and three quarters of them more than 0.65.
_MOST_STEPPED_RADII, _MOST_CORNERED = 0.09, 0.65


@dataclass(frozen=True, slots=True)
class SearchLimits(ShortRepr):
    """What is searched for.

    smallest_px, largest_px: Diameters of targets seen square on [px].
    least_contrast_dn: Difference of target and ground, in grey values of 255 [DN].
    most_tilt_rad: Tilt against the line of sight [rad].
    polarities: Dark targets on light ground, light ones on dark ground, or both; each costs a search of its own.
    InputError: Sizes, contrast or tilt that no target has.
    """

    smallest_px: float = 6.0
    largest_px: float = 300.0
    least_contrast_dn: float = 20.0
    most_tilt_rad: float = 1.2
    polarities: tuple[Polarity, ...] = (Polarity.BLACK_ON_WHITE, Polarity.WHITE_ON_BLACK)

    def __post_init__(self) -> None:
        if not 3 <= self.smallest_px < self.largest_px:
            raise InputError(
                "target diameters: 3 px <= smallest < largest is needed, "
                f"not {self.smallest_px} to {self.largest_px} px"
            )
        if not 0 < self.least_contrast_dn < 255:
            raise InputError(f"least_contrast_dn: between 0 and 255 is needed, not {self.least_contrast_dn}")
        if not 0 <= self.most_tilt_rad < 1.5:
            raise InputError(f"most_tilt_rad: 0 to 1.5 rad is needed, not {self.most_tilt_rad}")


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One spot that may be a target.

    ellipse: Outline in the photo's pixels, good to a tenth of a pixel or so.
    inside_dn, outside_dn: Levels of the spot and of the ground round it, in grey values of 255 [DN].
    edge_rms_px: Rms distance of the edges along 24 rays from the outline [px].
    polarity: Dark or light.
    is_clear: Whether its edge is an ellipse's and its ground even. Else it may be the stepped dot of a display or one
        with a narrow or spoilt gap, which codes confirm.
    """

    ellipse: Ellipse
    inside_dn: float
    outside_dn: float
    edge_rms_px: float
    polarity: Polarity
    is_clear: bool


def find_candidates(image_dn: npt.NDArray[np.generic], limits: SearchLimits | None = None) -> tuple[Candidate, ...]:
    """Find all spots of a photo that may be circular targets.

    image_dn (h, w): Grey values: uint8, uint16, or float on the scale of one of them [DN].
    Returns: Spots with an elliptic edge, each once, from top to bottom.
    InputError: Not an image of one colour.
    """
    return find_in_pyramid(make_pyramid(image_dn), limits or SearchLimits())


def find_outlines(
    image_dn: npt.NDArray[np.generic], limits: SearchLimits | None = None
) -> tuple[FloatArray, FloatArray]:
    """Find the same spots as `find_candidates` as centres (n, 2) [px] and shapes (n, 2, 2) [px^2]: fields of thousands.

    InputError: Not an image of one colour.
    """
    found = _found_in(make_pyramid(image_dn), limits or SearchLimits())
    rows = _apart(found)
    return found.spots.centers[rows], found.spots.shapes[rows]


def find_in_pyramid(pyramid: Pyramid, asked: SearchLimits) -> tuple[Candidate, ...]:
    """Find all spots of a photo that may be circular targets, the photo being halved already.

    Returns: Spots with an elliptic edge, each once, from top to bottom.
    """
    found = _found_in(pyramid, asked)
    return found.candidates(_apart(found))


def _found_in(pyramid: Pyramid, asked: SearchLimits) -> "_Found":
    """Return all spots, some of them twice."""
    parts = []
    for level, image in enumerate(pyramid.levels):
        needed = asked.smallest_px < _NEEDS_FULL_PX if level == 0 else 2**level * _HALVED_SEARCH[1] <= asked.largest_px
        if needed:
            parts += _spots_on_level(image, level, asked)
    spots = _joined(parts)
    every = _once(spots)
    chunks = (every[first : first + _SPOTS_AT_ONCE] for first in range(0, len(every), _SPOTS_AT_ONCE))
    return _Found.joined([_uniform(pyramid, spots.chosen(rows), asked) for rows in chunks])


# --- spots: vectorised over all of a scale --------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Spots:
    """Ellipses (n) in the photo's pixels, and whether they are dark."""

    shapes: FloatArray
    centers: FloatArray
    dark: BoolArray

    def chosen(self, which: BoolArray | IntArray) -> "_Spots":
        return _Spots(self.shapes[which], self.centers[which], self.dark[which])


def _once(spots: _Spots) -> IntArray:
    """Return the rows of spots without those that two stripes show alike."""
    keys = np.column_stack([spots.centers, spots.shapes[:, 0, 0], spots.dark])
    order = np.lexsort(keys.T)
    first = np.ones(len(order), dtype=np.bool_)
    first[1:] = (keys[order[1:]] != keys[order[:-1]]).any(axis=1)
    return np.sort(order[first])


def _joined(parts: Sequence[_Spots]) -> _Spots:
    return _Spots(
        np.concatenate([np.empty((0, 2, 2)), *(part.shapes for part in parts)]),
        np.concatenate([np.empty((0, 2)), *(part.centers for part in parts)]),
        np.concatenate([np.empty(0, dtype=np.bool_), *(part.dark for part in parts)]),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """Spots (n) that may be targets, and what `Candidate` says of them."""

    spots: _Spots
    inside_dn: FloatArray
    outside_dn: FloatArray
    rms_px: FloatArray
    is_clear: BoolArray

    @classmethod
    def joined(cls, parts: Sequence["_Found"]) -> "_Found":
        none = np.empty(0)
        return cls(
            _joined([part.spots for part in parts]),
            np.concatenate([none, *(part.inside_dn for part in parts)]),
            np.concatenate([none, *(part.outside_dn for part in parts)]),
            np.concatenate([none, *(part.rms_px for part in parts)]),
            np.concatenate([np.empty(0, dtype=np.bool_), *(part.is_clear for part in parts)]),
        )

    def candidates(self, rows: IntArray) -> tuple[Candidate, ...]:
        polarities = (Polarity.WHITE_ON_BLACK, Polarity.BLACK_ON_WHITE)
        return tuple(
            Candidate(
                Ellipse(self.spots.centers[k], self.spots.shapes[k]),
                float(self.inside_dn[k]),
                float(self.outside_dn[k]),
                float(self.rms_px[k]),
                polarities[int(self.spots.dark[k])],
                bool(self.is_clear[k]),
            )
            for k in rows.tolist()
        )


def _spots_on_level(image: Bytes, level: int, asked: SearchLimits) -> list[_Spots]:
    box, low, high = _FULL_SEARCH if level == 0 else _HALVED_SEARCH
    threshold = max(_THRESHOLD_SHARE * asked.least_contrast_dn, 3.0, min(3 * _noise(image), asked.least_contrast_dn))
    # A spot on the border of two stripes lies whole in one of them, with the ground that its threshold needs.
    overlap = int(high) + box // 2 + 1
    found = []
    for first in range(0, image.shape[0], _STRIPE_ROWS):
        top = max(first - overlap, 0)
        stripe = image[top : first + _STRIPE_ROWS + overlap]
        mean, difference = cv2.blur(stripe, (box, box)), np.empty_like(stripe)
        for polarity in asked.polarities:
            dark = polarity is Polarity.BLACK_ON_WHITE
            cv2.subtract(mean if dark else stripe, stripe if dark else mean, difference)
            cv2.threshold(difference, threshold, 255, cv2.THRESH_BINARY, difference)
            lines = cv2.findContours(difference, cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE, offset=(0, top))[0]
            shapes, centers = _ellipses_of_lines(lines, 2**level, asked, (low, high))
            found.append(_Spots(shapes, centers, np.full(len(shapes), dark)))
    return found


def _noise(image: Bytes) -> float:
    """Return the noise of a pixel from neighbours, in some fifty rows: half of them lie on even ground [DN]."""
    rows = image[:: max(image.shape[0] // 50, 1)].astype(np.int16)
    steps = rows[:, 1::2] - rows[:, : rows.shape[1] // 2 * 2 : 2]
    return robust_scale(steps, upper=True) / 2**0.5


def _ellipses_of_lines(
    lines: Sequence[npt.NDArray[np.integer | np.floating]], scale: int, asked: SearchLimits, widths: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """Shapes and centres, in the photo's pixels, of the ellipses with the second moments of the spots' outlines.

    Outlines run through the middles of a spot's outermost pixels, half a pixel within its edge. Those of holes run the
    other way round and have a negative area.
    """
    lengths = np.fromiter(map(len, lines), dtype=np.intp, count=len(lines))
    enough = np.flatnonzero(lengths >= 4)
    if len(enough) == 0:
        return np.empty((0, 2, 2)), np.empty((0, 2))
    points = np.concatenate([lines[k] for k in enough.tolist()]).reshape(-1, 2)
    lengths = lengths[enough]
    starts = np.concatenate([[0], np.cumsum(lengths)[:-1]])
    width = 1 + np.maximum.reduceat(points, starts) - np.minimum.reduceat(points, starts)
    longest = width.max(axis=1)
    low = max(widths[0], 0.6 * asked.smallest_px / scale)
    high = min(1.1 * asked.largest_px / scale + 1, widths[1] / np.cos(asked.most_tilt_rad))
    chosen = (longest >= low) & (longest <= high)
    if not chosen.any():
        return np.empty((0, 2, 2)), np.empty((0, 2))
    points, lengths = points[np.repeat(chosen, lengths)].astype(np.float64), lengths[chosen]
    starts = np.concatenate([[0], np.cumsum(lengths)[:-1]])
    origin = points[starts]
    area, first, second = _moments(points - np.repeat(origin, lengths, axis=0), starts, lengths)
    solid = area > 0.5
    area, first, second = area[solid, None], first[solid], second[solid]
    middle = first / area
    xx, xy, yy = (second / area - middle[:, [0, 0, 1]] * middle[:, [0, 1, 1]]).T
    shapes = 4 * np.stack([np.stack([xx, xy], axis=1), np.stack([xy, yy], axis=1)], axis=1)
    frames = ellipse_frames(shapes)
    shapes = (shapes + frames + 0.25 * np.eye(2)) * scale**2
    # An ellipse has the area pi sqrt(det S). Half a pixel all round adds half the outline, pi (a + b) / 2, and pi / 4.
    whole = area[:, 0] + 0.5 * np.pi * np.trace(frames, axis1=1, axis2=2) + 0.8
    filled = whole * scale**2 > _LEAST_FILLED * np.pi * np.sqrt(np.maximum(np.linalg.det(shapes), 0.0))
    larger, smaller = _semi_axes(shapes)
    # Boxes of a few pixels give the axes to half a pixel each.
    slack = 0.6 * scale
    kept = filled & (smaller + slack > np.cos(asked.most_tilt_rad) * (larger - slack))
    kept &= 2 * smaller <= widths[1] * scale
    return shapes[kept], ((origin[solid] + middle + 0.5) * scale - 0.5)[kept]


class _Moments(NamedTuple):
    """Areas, first and second moments of polygons."""

    area: FloatArray
    first: FloatArray
    second: FloatArray


def _moments(points: FloatArray, starts: IntArray, lengths: IntArray) -> _Moments:
    """Areas, first and second moments of polygons one after the other, counter-clockwise on the screen positive."""
    following = np.arange(1, len(points) + 1)
    following[starts + lengths - 1] = starts
    x, y = points.T
    x1, y1 = points[following].T
    cross = x1 * y - x * y1
    parts = np.stack(
        [
            cross / 2,
            (x + x1) * cross / 6,
            (y + y1) * cross / 6,
            (x * x + x * x1 + x1 * x1) * cross / 12,
            (x * (2 * y + y1) + x1 * (y + 2 * y1)) * cross / 24,
            (y * y + y * y1 + y1 * y1) * cross / 12,
        ],
        axis=1,
    )
    sums = np.add.reduceat(parts, starts, axis=0)
    return _Moments(sums[:, 0], sums[:, 1:3], sums[:, 3:])


def _semi_axes(shapes: FloatArray) -> tuple[FloatArray, FloatArray]:
    middle = 0.5 * (shapes[:, 0, 0] + shapes[:, 1, 1])
    reach = np.hypot(0.5 * (shapes[:, 0, 0] - shapes[:, 1, 1]), shapes[:, 0, 1])
    return np.sqrt(middle + reach), np.sqrt(np.maximum(middle - reach, 1e-6))


def _uniform(pyramid: Pyramid, spots: _Spots, asked: SearchLimits) -> _Found:
    """Keep the ellipses that are even inside, even in a ring around, differ from it, and have an elliptic edge."""
    kept, clear, inside, outside = _judge(pyramid, spots, asked, uneven=2 * _MOST_UNEVEN)
    spots, clear = spots.chosen(kept), clear[kept]
    lines = outlines_along_rays(pyramid, spots.centers, spots.shapes, 0.5 * (inside + outside)[kept], spots.dark)
    spots = _Spots(lines.shapes_px2, lines.centers_px, spots.dark).chosen(lines.found)
    rms = lines.rms_px[lines.found]
    larger, smaller = _semi_axes(spots.shapes)
    radius, pixel = np.sqrt(larger * smaller), 2.0 ** pyramid.level_for(spots.shapes)
    smooth = rms < np.maximum(_MOST_EDGE_RADII * radius, _MOST_EDGE_PX * pixel)
    fits = (
        (smooth | ((rms < _MOST_STEPPED_RADII * radius) & (lines.cornered[lines.found] < _MOST_CORNERED)))
        & (smaller > 0.85 * np.cos(asked.most_tilt_rad) * larger)
        & (2 * larger > 0.8 * asked.smallest_px)
        & (2 * larger < 1.2 * asked.largest_px)
        & _inside(pyramid.size_px, spots.shapes, spots.centers)
    )
    spots, rms, before = spots.chosen(fits), rms[fits], (smooth & clear[lines.found])[fits]
    kept, clear, inside, outside = _judge(pyramid, spots, asked, uneven=_MOST_UNEVEN)
    return _Found(spots.chosen(kept), inside[kept], outside[kept], rms[kept], (before & clear)[kept])


def _inside(size_px: tuple[int, int], shapes: FloatArray, centers: FloatArray) -> BoolArray:
    """Return which ellipses lie wholly within the photo."""
    half = np.sqrt(np.diagonal(shapes, axis1=1, axis2=2))
    return np.asarray(((centers - half > 1) & (centers + half < np.array(size_px) - 2)).all(axis=1))


class _Levels(NamedTuple):
    """Which ellipses are even inside and in a ring around, and differ from it; levels inside and outside [DN].

    clear: Which are so where their ground is farthest from their own level, not merely where it is most even.
    """

    kept: BoolArray
    clear: BoolArray
    inside_dn: FloatArray
    outside_dn: FloatArray


def _judge(pyramid: Pyramid, spots: _Spots, asked: SearchLimits, *, uneven: float) -> _Levels:
    """Compare ellipses with a ring around each."""
    around = (*_OUTER_RADII, _NARROW_RADII)
    values = _on_rings(pyramid, spots, (*_INNER_RADII, *(radius for pair in around for radius in pair)))
    inner = values[:, : 2 * _RING_POINTS]
    inside = _medians(inner)
    pairs = values[:, 2 * _RING_POINTS :].reshape(len(inside), len(around), 2 * _RING_POINTS)
    levels = _medians(pairs)
    sign = np.where(spots.dark, np.float32(1.0), np.float32(-1.0))
    # How far each ring of values lies on the ground's side of the dot: all as for dark dots.
    values *= sign[:, None]
    inside, levels = sign * inside, sign[:, None] * levels
    spread = np.abs(pairs - levels[..., None]).mean(axis=2)
    # The gap is where the ground is farthest from the dot; or, in the second place, where it is even as well.
    farthest = levels[:, : len(_OUTER_RADII)].argmax(axis=1)
    evenest = (levels - spread).argmax(axis=1)
    middle = 0.5 * (inside[:, None] + levels)
    contrast = levels - inside[:, None]
    right_inside = np.stack([np.count_nonzero(inner < one[:, None], axis=1) for one in middle.T], axis=1)
    right_outside = np.count_nonzero(pairs > middle[..., None], axis=2)
    unevenness = np.maximum(np.abs(inner - inside[:, None]).mean(axis=1)[:, None], spread)
    fine = (contrast >= asked.least_contrast_dn) & (unevenness < uneven * np.maximum(contrast, 1e-6))
    fine &= np.minimum(right_inside, right_outside) >= _RIGHT_SIDE_SHARE * inner.shape[1]
    rows = np.arange(len(inside))
    clear, other = fine[rows, farthest], fine[rows, evenest]
    outside = np.where(clear | ~other, levels[rows, farthest], levels[rows, evenest])
    return _Levels(clear | other, clear, (sign * inside).astype(np.float64), (sign * outside).astype(np.float64))


def _medians(values: Float32Array) -> Float32Array:
    """Return the medians of rings of an even number of values, along the last axis."""
    # Sorted whole: that few numbers a processor sorts eight times as fast as it parts them.
    middle, ordered = values.shape[-1] // 2, np.sort(values, axis=-1)
    return np.asarray(0.5 * (ordered[..., middle - 1] + ordered[..., middle]), dtype=np.float32)


def _on_rings(pyramid: Pyramid, spots: _Spots, radii: Sequence[float]) -> Float32Array:
    """Grey values on rings, shape (n, points)."""
    angles = np.arange(_RING_POINTS) * (2 * np.pi / _RING_POINTS)
    circle = np.concatenate([radius * np.stack([np.cos(angles), np.sin(angles)]) for radius in radii], axis=1)
    return pyramid.around(spots.centers, spots.shapes, circle)


def _apart(found: _Found) -> IntArray:
    """Return of spots at one place and of one size the one with the cleanest edge, from top to bottom.

    Scales overlap, and so do the stripes of one scale.
    """
    centers = found.spots.centers
    radii = np.sqrt(np.sqrt(np.linalg.det(found.spots.shapes)))
    first, second = _beside(centers, radii)
    near = np.hypot(*(centers[first] - centers[second]).T) < 0.5 * np.minimum(radii[first], radii[second])
    near &= np.abs(np.log(radii[first] / radii[second])) < 0.5
    first, second = first[near], second[near]
    # The cleanest edge first; what is at its place goes. Who is cleaner than all his open rivals is next.
    rank = np.empty(len(centers), dtype=np.intp)
    rank[np.argsort(found.rms_px, kind="stable")] = np.arange(len(centers))
    cleaner = rank[first] < rank[second]
    better, worse = np.where(cleaner, first, second), np.where(cleaner, second, first)
    kept = np.zeros(len(centers), dtype=np.bool_)
    is_open = ~kept
    while is_open.any():
        rivals = is_open[better] & is_open[worse]
        kept |= is_open
        kept[worse[rivals]] = False
        is_open[kept] = False
        is_open[worse[kept[better]]] = False
    chosen = np.flatnonzero(kept)
    return np.asarray(chosen[np.lexsort((centers[chosen, 0], centers[chosen, 1]))])


def _beside(centers: FloatArray, radii: FloatArray) -> tuple[IntArray, IntArray]:
    """Return pairs of spots less than half a radius apart in y: each with those that follow from top to bottom."""
    order = np.argsort(centers[:, 1], kind="stable")
    y, reach = centers[order, 1], 0.5 * radii[order]
    # How far on from each spot its own reach goes; only the smaller one of a pair counts, so that this misses none.
    count = np.searchsorted(y, y + reach, side="left") - np.arange(1, len(y) + 1)
    count = np.maximum(count, 0)
    start = np.repeat(np.arange(len(y)), count)
    step = np.arange(start.size) - np.repeat(np.cumsum(count) - count, count)
    end = start + 1 + step
    close = np.abs(centers[order[start], 0] - centers[order[end], 0]) < np.minimum(reach[start], reach[end])
    return order[start[close]], order[end[close]]
