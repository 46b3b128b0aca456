"""Whether the numbers in a photo are proportional to light, or encoded for the eye as most cameras and programs do.

Lens and pixels blur an edge evenly to both sides of it, in light. Encoded as sRGB (IEC 61966-2-1) dark tones are drawn
apart: the blurred edge looks lopsided, and its steepest place moves by a tenth of a pixel to the dark side, so that a
dark tube looks thinner than it is. So the encoding is estimated from the photos themselves: by the odds of what
targets of a stated diameter and edges of the reflection look like under both.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.validate import FloatArray

AnyImage = npt.NDArray[np.uint8] | npt.NDArray[np.uint16] | npt.NDArray[np.float32]

#: Moments of an edge's slope are taken within so many pixels of its middle.
_HALF_PX = 3
#: Rounds in which the middle is found.
_ROUNDS = 4
#: Steps of the brightness below this share of the usual one are none of an edge.
_LEAST_STEP = 0.2
#: Edges of a photo that are enough to see how lopsided they are.
_ENOUGH = 30
#: Size of targets over the stated one, under the right encoding: mostly right within this, for this share of the
#: flights anything within that (a wrong diameter, overexposed paper). Drawn targets are within 0.5 %, those of an
#: independent renderer 1.0 and 1.5 % too large; the wrong encoding makes 4 to 10 %.
_SIZE, _SIZE_WRONG, _SHARE_WRONG = 0.01, 0.1, 0.05
#: The same for lopsidedness: even under a clear sky, for this share of the flights anything within that: light of glass
#: and clouds beside the tube is not even (-0.13 to 0.26 in photos of an independent renderer, in either encoding).
_EVEN, _UNEVEN, _SHARE_UNEVEN = 0.03, 0.2, 0.2
#: Scatter of lopsidedness between photos as it usually is, counted as so many photos.
_SCATTER, _SCATTER_PHOTOS = 0.1, 2


class Tone(StrEnum):
    """How light becomes numbers."""

    LINEAR = "linear"
    SRGB = "srgb"


class _Pair(NamedTuple):
    """A number under both encodings: of the photo as it is stored, and taken for sRGB."""

    stored: float
    decoded: float


@dataclass(frozen=True, slots=True, eq=False)
class ToneEvidence:
    """What one photo says of its encoding.

    sizes (2, n): Diameters of targets over what was stated, in the photo as stored and taken for sRGB.
    lopsided: How lopsided edges of the reflection are, 0 is even; NaN where there are too few of them.
    edges: Number of those edges.
    """

    sizes: FloatArray
    lopsided: _Pair
    edges: int

    @property
    def tells_something(self) -> bool:
        """Whether it shows a target of a stated diameter, or edges enough."""
        return self.sizes.size > 0 or self.edges > 0


def full_scale(image: AnyImage) -> float:
    """Return the largest number that a photo of this depth can hold [DN].

    image: A photo; luminance of colours (float32) has the depth that its values need.
    """
    if image.dtype == np.uint8:
        return 255.0
    if image.dtype == np.uint16:
        return 65535.0
    return 255.0 if float(image.max(initial=0.0)) <= 255.0 else 65535.0


def linear_light(image: AnyImage, tone: Tone) -> AnyImage:
    """Return a photo whose numbers are proportional to light.

    Shapes: image (height, width).
    Returns (height, width): The photo itself where it is linear, else as float32 of the same full scale.
    """
    if tone is Tone.LINEAR:
        return image
    top = full_scale(image)
    if image.dtype == np.float32:
        return _decoded(np.asarray(image / np.float32(top), dtype=np.float32)) * np.float32(top)
    table = _decoded(np.arange(int(top) + 1, dtype=np.float32) / np.float32(top)) * np.float32(top)
    return np.asarray(cv2.LUT(image, table) if image.dtype == np.uint8 else table[image], dtype=np.float32)


def numbers_for_the_eye(light: AnyImage) -> AnyImage:
    """Return the sRGB numbers of light: dark tones apart again, as the file has them.

    Shapes: light (height, width), result (height, width).
    light: From `linear_light` [DN].
    """
    top = np.float32(full_scale(light))
    share = np.clip(np.asarray(light, dtype=np.float32) / top, 0, 1)
    low, high = np.float32(12.92) * share, np.float32(1.055) * share ** np.float32(1 / 2.4) - np.float32(0.055)
    return np.asarray(np.where(share <= np.float32(0.0031308), low, high) * top, dtype=np.float32)


def _decoded(share: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return the light of sRGB numbers between 0 and 1 (IEC 61966-2-1)."""
    low = share / np.float32(12.92)
    high = ((np.maximum(share, np.float32(0)) + np.float32(0.055)) / np.float32(1.055)) ** np.float32(2.4)
    return np.asarray(np.where(share <= np.float32(0.04045), low, high), dtype=np.float32)


def tone_evidence(as_stored: FloatArray, decoded: FloatArray, sizes: FloatArray) -> ToneEvidence:
    """Collect what one photo says of its encoding.

    as_stored (n, 2 k + 1): Brightness across edges of the reflection from dark to bright, one pixel apart, in the photo
        as it is stored [DN].
    decoded (m, 2 k + 1): The same in the photo taken for sRGB.
    sizes (2, t): Diameters of targets over what was stated, as stored and taken for sRGB.
    """
    enough = min(len(as_stored), len(decoded)) >= _ENOUGH
    lopsided = (_lopsidedness(as_stored), _lopsidedness(decoded)) if enough else (math.nan, math.nan)
    return ToneEvidence(sizes, _Pair(*lopsided), len(as_stored) if np.isfinite(lopsided).all() else 0)


def log_odds_of_linear(photos: Sequence[ToneEvidence]) -> float:
    """Return the logarithm of how much likelier photos look as they do if they are linear than if they are sRGB.

    Notes
    -----
    Of all photos together: the median size of their targets over the stated one, and their mean lopsidedness, each with
    what it is for the right encoding as a mixture of two normal distributions. What makes it differ from 1 and from 0
    under the right encoding is common to all photos, so that the odds do not grow with their number: other photos of
    the same flight make the two numbers exact, no more.
    """
    sizes = np.concatenate([one.sizes for one in photos] or [np.zeros((2, 0))], axis=1)
    lopsided = np.array([one.lopsided for one in photos if one.edges]).reshape(-1, 2)
    total = 0.0
    if sizes.shape[1]:
        middle = np.median(sizes, axis=1)
        scatter = 1.4826 * np.median(np.abs(sizes - middle[:, None]), axis=1)
        # Of a median; a single target says how large it is to the usual scatter at best.
        variance = 0.5 * np.pi * (scatter**2 + _SIZE**2) / sizes.shape[1]
        stored, decoded = (
            _log_mixture(float(off) - 1, float(own), (_SIZE, _SIZE_WRONG), _SHARE_WRONG)
            for off, own in zip(middle, variance, strict=True)
        )
        total += stored - decoded
    if len(lopsided):
        mean = lopsided.mean(axis=0)
        squares = ((lopsided - mean) ** 2).sum(axis=0) + _SCATTER_PHOTOS * _SCATTER**2
        variance = squares / (len(lopsided) - 1 + _SCATTER_PHOTOS) / len(lopsided)
        stored, decoded = (
            _log_mixture(float(off), float(own), (_EVEN, _UNEVEN), _SHARE_UNEVEN)
            for off, own in zip(mean, variance, strict=True)
        )
        total += stored - decoded
    return total


def _log_mixture(off: float, variance: float, sigmas: tuple[float, float], share: float) -> float:
    """Return the logarithm of a density: of two normal distributions, the second with its share, both blurred.

    variance: Of the number itself.
    """
    density = 0.0
    for sigma, part in zip(sigmas, (1 - share, share), strict=True):
        total = sigma**2 + variance
        density += part * math.exp(-0.5 * off * off / total) / math.sqrt(total)
    return math.log(max(density, 1e-300))


def _lopsidedness(profiles: FloatArray) -> float:
    """Return the usual third moment of the edges' slope over the usual second moment's power 3/2."""
    step = profiles[:, -1] - profiles[:, 0]
    # Something thin and dark that is as bright on both sides is no edge.
    is_step = step > _LEAST_STEP * float(np.median(step))
    profiles, step = profiles[is_step], step[is_step]
    if step.size == 0:
        return float("nan")
    share = (profiles - profiles[:, :1]) / step[:, None]
    size = share.shape[1]
    from_middle = np.arange(0.5 - _HALF_PX, _HALF_PX)
    middle = np.zeros(len(share))
    for _ in range(_ROUNDS):
        at = np.clip(middle[:, None] + np.arange(-_HALF_PX, _HALF_PX + 1) + size // 2, 0, size - 1.001)
        before = np.floor(at).astype(np.intp)
        way = at - before
        value = np.take_along_axis(share, before, 1) * (1 - way) + np.take_along_axis(share, before + 1, 1) * way
        slope = np.diff(value, axis=1)
        shift = (slope @ from_middle) / np.maximum(slope.sum(axis=1), 0.1)
        middle = np.clip(middle + shift, _HALF_PX - size // 2, size // 2 - _HALF_PX)
    second, third = ((slope * (from_middle - shift[:, None]) ** power).sum(axis=1) for power in (2, 3))
    return float(np.median(third) / max(float(np.median(second)), 1e-3) ** 1.5)
