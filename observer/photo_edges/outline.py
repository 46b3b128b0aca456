"""Where the mirror ends in the photos: its width and length as they are, beside what measurement.toml says.

The rim is a step of brightness at the same place of the mirror in all rows and all photos; targets, the tube's
reflection and shadows on the ground are at other places in each, so that the median over rows leaves the rim alone.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.validate import BoolArray, Float32Array, FloatArray
from observer.photo_edges.rectify import rectified_strip
from observer.photo_edges.views import AnyImage, View
from observer.trough.collector import Collector

#: Rims are looked for within this share of the mirror's width or length beside where the design has them.
_MARGIN_SHARE = 0.04
#: Samples across each rim, and lines that cross it.
_SAMPLES, _LINES = 129, 96
#: Ends of the rims that are left out: corners, and what holds the receiver, are there.
_MIDDLE_SHARE = 0.94
#: The rim is clear where its median step is so many times the usual one beside it.
_CLEAR_TIMES = 4.0
#: ... and all others at other places are at most this share of it: beside a mirror that is as bright as what is behind
#: it, targets and shadows have steps as large (0.7 to 1 at a reflectance of 0.7, 0.2 to 0.8 where the rim shows).
_SECOND_SHARE = 0.8
#: Samples around the largest step that belong to it.
_OWN_SAMPLES = 6
#: Fewest photos that must show a rim clearly.
_FEWEST = 3
#: ... at the same place, within this share of the distance from the middle (6 mm; a pixel of 12 mm leaves 2 to 3 mm).
_ALIKE_SHARE = 2.5e-3
#: Lines need some contrast to be scaled by it [DN].
_LEAST_STEP_DN = 1.0

#: Lines that must be left beside square markers, whose steps are larger than the rim's.
_FEWEST_LINES = 16
#: A square marker's white rim is one of its six modules wide.
_WHITE_SHARE = 1 / 6

#: Photos that are looked at, and what glass edges and their clamps leave undecided of where a mirror ends [m].
_PHOTOS = 7
_SYSTEMATIC_M = 1e-3


@dataclass(frozen=True, slots=True)
class Span:
    """Distance of two opposite rims.

    value_m, sigma_m: The distance and its standard deviation [m].
    """

    value_m: float
    sigma_m: float
    middle_m: float


def plates_of(names: Sequence[str], points_m: FloatArray) -> FloatArray:
    """Return what square markers cover of the plane across the optical axis.

    names: Names of all targets; corners are called by marker and corner, "7.0" to "7.3".
    points_m (n, 3): Their coordinates; NaN where not known [m].
    Returns (k, 4): Smallest and largest x, smallest and largest y of each marker with its white rim [m].
    """
    corners: dict[str, list[FloatArray]] = {}
    for name, point in zip(names, points_m, strict=True):
        if "." in name and np.isfinite(point).all():
            corners.setdefault(name.partition(".")[0], []).append(point[:2])
    plates = [(np.min(own, axis=0), np.max(own, axis=0)) for own in corners.values() if len(own) > 1]
    spans = np.array([[low[0], high[0], low[1], high[1]] for low, high in plates]).reshape(-1, 4)
    rim = _WHITE_SHARE * np.maximum(spans[:, 1] - spans[:, 0], spans[:, 3] - spans[:, 2])
    return np.asarray(spans + rim[:, None] * [-1, 1, -1, 1])


def rims_in_photo(image: AnyImage, view: View, collector: Collector, plates_m: FloatArray | None = None) -> FloatArray:
    """Find the mirror's four rims in one photo.

    Shapes: image (height, width).
    view: Its camera and ``cam_from_frame``.
    plates_m (k, 4): From `plates_of`: lines that cross one are left out [m].
    Returns (4,): x of the rims at -x and +x, y of the ends at -y and +y; NaN where the photo does not show one
        clearly [m].
    """
    half_x, half_y = collector.aperture_width_m / 2, collector.length_m / 2
    along_x = np.linspace(-_MIDDLE_SHARE, _MIDDLE_SHARE, _LINES) * half_x
    along_y = np.linspace(-_MIDDLE_SHARE, _MIDDLE_SHARE, _LINES) * half_y
    found = []
    for half, is_end in ((half_x, False), (half_y, True)):
        for place in (-half, half):
            across = place + np.linspace(-1, 1, _SAMPLES) * 2 * _MARGIN_SHARE * half
            columns, rows = (along_x, across) if is_end else (across, along_y)
            strip = rectified_strip(image, view, collector.surface, columns, rows)
            seen, values = (strip.seen.T, strip.image_dn.T) if is_end else (strip.seen, strip.image_dn)
            whole = seen.all(axis=1)
            lines = values[whole & ~_on_plates(columns if is_end else rows, across, plates_m, is_end=is_end)]
            enough = 2 * np.count_nonzero(whole) > _LINES and len(lines) >= _FEWEST_LINES
            found.append(_step_place(lines, across) if enough else np.nan)
    return np.array(found)


def _on_plates(lines_m: FloatArray, across_m: FloatArray, plates_m: FloatArray | None, *, is_end: bool) -> BoolArray:
    """Return which lines across a rim cross a plate."""
    if plates_m is None:
        return np.zeros(lines_m.size, dtype=bool)
    own, other = (plates_m[:, :2], plates_m[:, 2:]) if is_end else (plates_m[:, 2:], plates_m[:, :2])
    near = (other[:, 1] > across_m[0]) & (other[:, 0] < across_m[-1])
    return np.asarray(((lines_m[:, None] > own[near, 0]) & (lines_m[:, None] < own[near, 1])).any(axis=1))


def clipped_share(image: AnyImage, view: View, collector: Collector) -> float:
    """Return how much of the mirror is as bright as a photo can be.

    Shapes: image (height, width).
    view: Its camera and ``cam_from_frame``.
    Returns: Share between 0 and 1; NaN where the photo shows nothing of the mirror.
    """
    columns, rows = (
        np.linspace(-0.49, 0.49, _LINES) * size for size in (collector.aperture_width_m, collector.length_m)
    )
    strip = rectified_strip(image, view, collector.surface, columns, rows)
    # Luminance of a photo in colour is float32 in the file's depth.
    full = 255.0 if image.dtype == np.uint8 or image.max() <= 255 else 65535.0
    return float(np.mean(strip.image_dn[strip.seen] >= full - 0.5)) if strip.seen.any() else float(np.nan)


def _step_place(lines_dn: Float32Array, place_m: FloatArray) -> float:
    """Return where most lines have their step; NaN where there is no such place."""
    # Differences over three samples: a rim is two pixels wide or more.
    step = np.abs(lines_dn[:, 3:] - lines_dn[:, :-3])
    step = step / np.maximum(step.max(axis=1, keepdims=True), _LEAST_STEP_DN)
    usual = np.median(step, axis=0)
    middle = (place_m[3:] + place_m[:-3]) / 2
    peak = int(np.argmax(usual))
    if usual[peak] < max(_CLEAR_TIMES * float(np.median(usual)), 0.2) or not 0 < peak < usual.size - 1:
        return float(np.nan)
    from_peak = np.abs(np.arange(usual.size) - peak)
    if usual[from_peak > _OWN_SAMPLES].max() > _SECOND_SHARE * usual[peak]:
        return float(np.nan)
    near = from_peak <= 4
    weight = np.where(near, np.maximum(usual - usual[peak] / 4, 0.0), 0.0)
    return float(weight @ middle / weight.sum())


def spans_of(rims_m: FloatArray) -> tuple[Span, Span]:
    """Combine the rims of several photos.

    Shapes: rims_m (n, 4).
    across, along: The mirror's width and length; NaN where too few photos show a rim.
    """
    places, sigmas = [], []
    for rim in rims_m.T:
        seen = rim[np.isfinite(rim)]
        alike = np.abs(seen - np.median(seen)) < _ALIKE_SHARE * np.abs(seen) if seen.size else np.zeros(0, dtype=bool)
        if np.count_nonzero(alike) < max(_FEWEST, len(seen) / 2):
            places.append(np.nan)
            sigmas.append(np.inf)
            continue
        middle = float(np.median(seen))
        scatter = robust_scale(seen - middle)
        places.append(middle)
        sigmas.append(float(np.hypot(1.25 * scatter / np.sqrt(len(seen)), _SYSTEMATIC_M)))
    return (
        Span(places[1] - places[0], math.hypot(*sigmas[:2]), (places[0] + places[1]) / 2),
        Span(places[3] - places[2], math.hypot(*sigmas[2:]), (places[2] + places[3]) / 2),
    )


def photos_from_above(eyes_m: FloatArray) -> list[int]:
    """Choose photos that see both rims under nearly the same angle.

    Shapes: eyes_m (n, 3).
    Returns: Numbers of at most seven photos, from the half of them that are nearest to the optical axis.
    """
    order = np.argsort(np.abs(np.arctan2(eyes_m[:, 0], eyes_m[:, 2])), kind="stable")
    near = np.sort(order[: max(len(order) // 2, min(len(order), _PHOTOS))])
    return [int(k) for k in near[np.unique(np.linspace(0, near.size - 1, min(near.size, _PHOTOS)).round().astype(int))]]
