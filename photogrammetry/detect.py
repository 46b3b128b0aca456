"""Find everything in a photo that may be a circular target: uniform ellipses on a uniform ground, of any size.

The photo is halved again and again; on each scale a local threshold and connected components find the spots whose size
suits that scale. So the work hardly depends on the sizes searched for: 24 megapixels cost about as much as decoding
them. What follows judges spots by a few dozen grey values each, all spots at once; what remains is measured one by one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.validate import BoolArray, Float32Array, FloatArray
from photogrammetry.coded_targets import Polarity
from photogrammetry.edge_rays import outlines_along_rays
from photogrammetry.ellipse import Ellipse
from photogrammetry.target_center import CenterOperator, TargetCenter, cut_window

__all__ = ["Candidate", "SearchLimits", "find_candidates", "measure_center"]

Bytes = npt.NDArray[np.uint8]

#: Side of the box whose mean is the local threshold, in pixels of each scale.
_BOX_PX = 31
#: Widths of spots that a scale answers for, in its own pixels: above, the next coarser scale sees them better.
_SCALE_WIDTHS_PX = (2.0, 22.0)
#: Targets below this diameter are searched at full resolution; it costs three times all other scales together.
_NEEDS_FULL_PX = 5.0
#: Threshold below (above) the local mean, as a share of the least contrast: a spot that fills two thirds of the box
#: still lies a third of its contrast below the box's mean.
_THRESHOLD_SHARE = 0.3
#: Spots are judged on rings of this many points, at these radii of their ellipse.
_RING_POINTS, _INNER_RADII, _OUTER_RADII = 16, (0.0, 0.5), (1.5, 1.65)
#: Share of ring points that must lie on their side of the middle level; the rest may be covered or in glare.
_RIGHT_SIDE_SHARE = 0.8
#: Mean deviation of the ring's grey values from their median, as a share of the contrast.
_MOST_UNEVEN = 0.2
#: Rms of the edges about the outline above which a spot is no ellipse: in radii, or in pixels for small spots.
_MOST_EDGE_RADII, _MOST_EDGE_PX = 0.05, 0.3


@dataclass(frozen=True, slots=True)
class SearchLimits:
    """What is searched for.

    Parameters
    ----------
    smallest_px, largest_px : float, optional
        Diameters of targets seen square on [px].
    least_contrast_dn : float, optional
        Difference of target and ground, in grey values of 255 [DN].
    most_tilt_rad : float, optional
        Tilt against the line of sight [rad].
    polarities : tuple of Polarity, optional
        Dark targets on light ground, light ones on dark ground, or both; each costs a search of its own.

    Raises
    ------
    InputError
        Sizes, contrast or tilt that no target has.
    """

    smallest_px: float = 6.0
    largest_px: float = 100.0
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

    Parameters
    ----------
    ellipse : Ellipse
        Outline in the photo's pixels, good to a tenth of a pixel or so.
    inside_dn, outside_dn : float
        Levels of the spot and of the ground round it, in grey values of 255 [DN].
    edge_rms_px : float
        Rms distance of the edges along 24 rays from the outline [px].
    polarity : Polarity
        Dark or light.
    """

    ellipse: Ellipse
    inside_dn: float
    outside_dn: float
    edge_rms_px: float
    polarity: Polarity


def find_candidates(image_dn: npt.NDArray[np.generic], limits: SearchLimits | None = None) -> tuple[Candidate, ...]:
    """Find all spots of a photo that may be circular targets.

    Parameters
    ----------
    image_dn : ndarray, shape (h, w)
        Grey values: uint8, uint16, or float on the scale of one of them [DN].
    limits : SearchLimits, optional
        What is searched for.

    Returns
    -------
    tuple of Candidate
        Spots with an elliptic edge, each once, from top to bottom.

    Raises
    ------
    InputError
        Not an image of one colour.
    """
    asked = limits or SearchLimits()
    if image_dn.ndim != 2 or min(image_dn.shape) < 16:
        raise InputError(f"image: a grey image of at least 16 x 16 px is needed, not shape {image_dn.shape}")
    image = _bytes(image_dn)
    spots: list[Candidate] = []
    scale, level = 1, image
    while scale * _SCALE_WIDTHS_PX[0] <= asked.largest_px and min(level.shape) >= 16:
        # Full resolution is needed for the smallest spots only.
        if scale > 1 or asked.smallest_px < _NEEDS_FULL_PX:
            spots += _spots_on_scale(level, scale, image, asked)
        scale *= 2
        half = (level.shape[1] // 2, level.shape[0] // 2)
        level = np.asarray(cv2.resize(level, half, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return _apart(spots)


def measure_center(image_dn: npt.NDArray[np.generic], start: Ellipse, operator: CenterOperator) -> TargetCenter:
    """Measure a target's centre in the photo's pixels.

    Parameters
    ----------
    image_dn : ndarray, shape (h, w)
        Grey values [DN].
    start : Ellipse
        The target's outline in the photo, to a pixel or so.
    operator : CenterOperator
        The estimator.

    Returns
    -------
    TargetCenter
        The result in the photo's pixels.

    Raises
    ------
    EstimationError
        The target touches the border, or the estimator refuses.
    """
    window = cut_window(image_dn, start)
    origin = np.array(window.origin_px, dtype=np.float64)
    found = operator(window.values_dn, start.moved(-origin))
    return TargetCenter(
        found.ellipse.moved(origin),
        found.covariance_px2,
        found.contrast_dn,
        found.inside_dn,
        found.blur_px,
        found.residual_dn,
        found.n_samples,
    )


def _bytes(image_dn: npt.NDArray[np.generic]) -> Bytes:
    """Return the photo in 8 bit, for the search only."""
    if image_dn.dtype == np.uint8:
        return np.asarray(image_dn, dtype=np.uint8)
    values = np.ascontiguousarray(image_dn, dtype=image_dn.dtype if image_dn.dtype == np.uint16 else np.float32)
    deep = image_dn.dtype == np.uint16 or float(values.max(initial=0)) > 255.5
    return np.asarray(cv2.convertScaleAbs(values, alpha=1 / 257 if deep else 1.0), dtype=np.uint8)


# --- spots: vectorised over all of a scale --------------------------------------------------------------------------


def _spots_on_scale(level: Bytes, scale: int, image: Bytes, asked: SearchLimits) -> list[Candidate]:
    mean = cv2.blur(level, (_BOX_PX, _BOX_PX))
    threshold = max(_THRESHOLD_SHARE * asked.least_contrast_dn, 3.0)
    found: list[Candidate] = []
    for polarity in asked.polarities:
        dark = polarity is Polarity.BLACK_ON_WHITE
        difference = cv2.subtract(mean, level) if dark else cv2.subtract(level, mean)
        mask = cv2.threshold(difference, threshold, 255, cv2.THRESH_BINARY)[1]
        _, _, statistics, centroids = cv2.connectedComponentsWithStats(mask, connectivity=4, ltype=cv2.CV_32S)
        shapes, centers = _ellipses_of_boxes(
            np.asarray(statistics[1:], dtype=np.float64), np.asarray(centroids[1:], dtype=np.float64), scale, asked
        )
        found += _uniform(image, shapes, centers, polarity, asked)
    return found


def _ellipses_of_boxes(
    statistics: FloatArray, centroids: FloatArray, scale: int, asked: SearchLimits
) -> tuple[FloatArray, FloatArray]:
    """Shapes and centres, in the photo's pixels, of the ellipses that have a spot's bounding box and area.

    Box and area leave the sign of the tilt open: both ellipses are returned, one after the other.
    """
    width, height, area = (statistics[:, k] for k in (2, 3, 4))
    longest = np.maximum(width, height)
    low = max(_SCALE_WIDTHS_PX[0], 0.6 * asked.smallest_px / scale)
    high = min(1.1 * asked.largest_px / scale + 1, _SCALE_WIDTHS_PX[1])
    ratio = np.cos(asked.most_tilt_rad)
    # A slim ellipse at 45 degrees fills pi/2 ratio / (1 + ratio^2) of its box.
    fill = area / (width * height)
    kept = (longest >= low) & (longest <= high) & (area >= 3) & (fill > 0.75 * np.pi / 2 * ratio / (1 + ratio**2))
    width, height, area, center = width[kept], height[kept], area[kept], centroids[kept]
    half_x, half_y = 0.5 * width * scale, 0.5 * height * scale
    xx, yy = half_x**2, half_y**2
    xy = np.sqrt(np.maximum(xx * yy - np.minimum((area * scale**2 / np.pi) ** 2, xx * yy), 0.0))
    xy = np.minimum(xy, 0.97 * np.sqrt(xx * yy))
    signs = np.array([1.0, -1.0])
    both = np.empty((len(xx), 2, 2, 2))
    both[..., 0, 0], both[..., 1, 1] = xx[:, None], yy[:, None]
    both[..., 0, 1] = both[..., 1, 0] = xy[:, None] * signs
    centers = np.repeat((center + 0.5) * scale - 0.5, 2, axis=0)
    shapes = both.reshape(-1, 2, 2)
    middle, reach = (
        0.5 * (shapes[:, 0, 0] + shapes[:, 1, 1]),
        np.hypot(0.5 * (shapes[:, 0, 0] - shapes[:, 1, 1]), shapes[:, 0, 1]),
    )
    # Boxes of a few pixels tell the axes to half a pixel each.
    slack = 0.6 * scale
    larger, smaller = np.sqrt(middle + reach), np.sqrt(np.maximum(middle - reach, 0.0))
    slim = smaller + slack > ratio * (larger - slack)
    return shapes[slim], centers[slim]


def _uniform(
    image: Bytes, shapes: FloatArray, centers: FloatArray, polarity: Polarity, asked: SearchLimits
) -> list[Candidate]:
    """Keep the ellipses that are even inside, even in a ring around, differ from it, and have an elliptic edge."""
    if len(shapes) == 0:
        return []
    dark = polarity is Polarity.BLACK_ON_WHITE
    kept, inside, outside = _judged(image, shapes, centers, asked.least_contrast_dn, dark=dark, uneven=2 * _MOST_UNEVEN)
    shapes, centers = shapes[kept], centers[kept]
    outlines = outlines_along_rays(image, centers, shapes, 0.5 * (inside + outside)[kept])
    shapes, centers, rms = outlines.shapes_px2[outlines.found], outlines.centers_px[outlines.found], outlines.rms_px
    rms = rms[outlines.found]
    middle, reach = (
        0.5 * (shapes[:, 0, 0] + shapes[:, 1, 1]),
        np.hypot(0.5 * (shapes[:, 0, 0] - shapes[:, 1, 1]), shapes[:, 0, 1]),
    )
    larger, smaller = np.sqrt(middle + reach), np.sqrt(np.maximum(middle - reach, 1e-6))
    fits = (
        (rms < np.maximum(_MOST_EDGE_RADII * np.sqrt(larger * smaller), _MOST_EDGE_PX))
        & (smaller > 0.85 * np.cos(asked.most_tilt_rad) * larger)
        & (2 * larger > 0.8 * asked.smallest_px)
        & (2 * larger < 1.2 * asked.largest_px)
        & _inside(image, shapes, centers)
    )
    shapes, centers, rms = shapes[fits], centers[fits], rms[fits]
    if len(shapes) == 0:
        return []
    kept, inside, outside = _judged(image, shapes, centers, asked.least_contrast_dn, dark=dark, uneven=_MOST_UNEVEN)
    return [
        Candidate(Ellipse(centers[k], shapes[k]), float(inside[k]), float(outside[k]), float(rms[k]), polarity)
        for k in np.flatnonzero(kept)
    ]


def _inside(image: Bytes, shapes: FloatArray, centers: FloatArray) -> BoolArray:
    """Tell which ellipses lie wholly within the photo."""
    half = np.sqrt(np.diagonal(shapes, axis1=1, axis2=2))
    size = np.array([image.shape[1], image.shape[0]])
    return np.asarray(((centers - half > 1) & (centers + half < size - 2)).all(axis=1))


def _judged(
    image: Bytes, shapes: FloatArray, centers: FloatArray, least_contrast: float, *, dark: bool, uneven: float
) -> tuple[BoolArray, FloatArray, FloatArray]:
    """Tell which ellipses are even inside and in a ring around, and differ from it; levels inside and outside."""
    root = np.sqrt(np.maximum(np.linalg.det(shapes), 1e-9))
    trace = shapes[:, 0, 0] + shapes[:, 1, 1]
    frames = (shapes + root[:, None, None] * np.eye(2)) / np.sqrt(trace + 2 * root)[:, None, None]
    inner = _on_rings(image, frames, centers, _INNER_RADII)
    outer = _on_rings(image, frames, centers, _OUTER_RADII)
    inside = np.asarray(np.median(inner, axis=1), dtype=np.float64)
    outside = np.asarray(np.median(outer, axis=1), dtype=np.float64)
    contrast = (outside - inside) if dark else (inside - outside)
    middle = 0.5 * (inside + outside)[:, None]
    right_inside = np.mean((inner < middle) == dark, axis=1)
    right_outside = np.mean((outer > middle) == dark, axis=1)
    unevenness = np.maximum(
        np.abs(inner - inside[:, None]).mean(axis=1), np.abs(outer - outside[:, None]).mean(axis=1)
    ) / np.maximum(contrast, 1e-6)
    kept = (
        (contrast >= least_contrast)
        & (right_inside >= _RIGHT_SIDE_SHARE)
        & (right_outside >= _RIGHT_SIDE_SHARE)
        & (unevenness < uneven)
    )
    return kept, inside, outside


def _on_rings(image: Bytes, frames: FloatArray, centers: FloatArray, radii: Sequence[float]) -> Float32Array:
    """Grey values of the nearest pixels on rings, shape (n, points)."""
    angles = np.arange(_RING_POINTS) * (2 * np.pi / _RING_POINTS)
    circle = np.concatenate([radius * np.stack([np.cos(angles), np.sin(angles)]) for radius in radii], axis=1)
    points = np.matmul(frames, circle)
    columns = np.rint(points[:, 0] + centers[:, :1]).astype(np.intp)
    rows = np.rint(points[:, 1] + centers[:, 1:]).astype(np.intp)
    np.clip(columns, 0, image.shape[1] - 1, out=columns)
    np.clip(rows, 0, image.shape[0] - 1, out=rows)
    return np.asarray(image[rows, columns], dtype=np.float32)


def _apart(spots: list[Candidate]) -> tuple[Candidate, ...]:
    """Keep of spots at one place and of one size the one with the cleanest edge; sort from top to bottom."""
    kept: list[Candidate] = []
    places = np.empty((len(spots), 3))
    for spot in sorted(spots, key=lambda spot: spot.edge_rms_px):
        x, y = spot.ellipse.center_px
        radius = spot.ellipse.radius_px
        taken = places[: len(kept)]
        off = np.hypot(taken[:, 0] - x, taken[:, 1] - y)
        near = off < 0.5 * np.minimum(taken[:, 2], radius)
        if (near & (np.abs(np.log(taken[:, 2] / radius)) < 0.5)).any():
            continue
        places[len(kept)] = x, y, radius
        kept.append(spot)
    return tuple(sorted(kept, key=lambda spot: (spot.ellipse.center_px[1], spot.ellipse.center_px[0])))
