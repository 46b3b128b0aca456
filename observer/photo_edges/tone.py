"""Whether the numbers in a photo are proportional to light, or encoded for the eye as most cameras and programs do.

Lens and pixels blur an edge evenly to both sides of it, in light. Encoded as sRGB (IEC 61966-2-1) dark tones are drawn
apart: the blurred edge looks lopsided, and its steepest place moves by a tenth of a pixel to the dark side, so that a
dark tube looks thinner than it is. So the encoding is estimated from the edges in the photos themselves.
"""

from dataclasses import dataclass
from enum import StrEnum

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
#: Edges that are enough to estimate it.
_ENOUGH = 100
#: Without targets: photos that are lopsided by more than this towards the dark are no linear ones. Those have
#: -0.12 to 0.03 (once 0.055, under clouds), sRGB as it is stored 0.05 to 0.2, linear ones taken for sRGB -0.4 to 0.02.
_CLEARLY = 0.045
#: Fewest targets, how well one encoding must fit their stated diameter, and by how much better than the other.
_ENOUGH_TARGETS, _FITS, _BETTER = 6, 0.025, 0.015


class Tone(StrEnum):
    """How light becomes numbers."""

    LINEAR = "linear"
    SRGB = "srgb"


@dataclass(frozen=True, slots=True)
class ToneFound:
    """How photos are encoded, and how lopsided their edges are.

    tone: The encoding that leaves edges most even; the usual one where there are too few edges.
    lopsided: What it leaves; 0 is even. NaN where there are too few edges.
    as_stored: Lopsidedness of the numbers as they are.
    by_targets: Whether the size of the targets decided.
    """

    tone: Tone
    lopsided: float
    as_stored: float
    by_targets: bool = False


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


def _decoded(share: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return the light of sRGB numbers between 0 and 1 (IEC 61966-2-1)."""
    low = share / np.float32(12.92)
    high = ((np.maximum(share, np.float32(0)) + np.float32(0.055)) / np.float32(1.055)) ** np.float32(2.4)
    return np.asarray(np.where(share <= np.float32(0.04045), low, high), dtype=np.float32)


def find_tone(
    as_stored: FloatArray,
    decoded: FloatArray,
    sizes: tuple[FloatArray, FloatArray] | None = None,
    *,
    usual: Tone = Tone.LINEAR,
) -> ToneFound:
    """Tell from targets, and from edges of the tube's reflection, how photos are encoded.

    as_stored (n, 2 k + 1): Brightness across edges from dark to bright, one pixel apart, in photos as they are
        stored [DN].
    decoded (m, 2 k + 1): The same in the photos taken for sRGB.
    sizes: Diameters of targets over what was stated, in the photos as stored and taken for sRGB.
    usual: What such photos usually are, where neither targets nor edges show it.
    Returns: The encoding under which targets are as large as stated; where that does not decide, the one that leaves
        edges most even.
    """
    stored, as_srgb = (_lopsidedness(part) if len(part) >= _ENOUGH else float("nan") for part in (as_stored, decoded))
    if sizes is not None and min(part.size for part in sizes) >= _ENOUGH_TARGETS:
        misfit = [abs(float(np.median(part)) - 1) for part in sizes]
        if min(misfit) < _FITS and abs(misfit[0] - misfit[1]) > _BETTER:
            linear = misfit[0] < misfit[1]
            return ToneFound(Tone.LINEAR if linear else Tone.SRGB, stored if linear else as_srgb, stored, True)
    if np.isnan(stored):
        return ToneFound(usual, stored, stored)
    if stored > _CLEARLY and stored > abs(as_srgb):
        return ToneFound(Tone.SRGB, as_srgb, stored)
    return ToneFound(Tone.LINEAR, stored, stored)


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
