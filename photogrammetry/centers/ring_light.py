"""The light of code rings that blur carries into the gap round their dots, taken away before the dots are centred.

A dot's centre is fitted to the pixels within 1.65 of its radii, and a ring begins at two. Where the blur is a third of
that gap, inked sectors on one side darken the gap there and pull the centre: by 0.08 px on dots of 8 to 15 px at a blur
of 2 px. The ring is known when it has been read: it is drawn with the blur of the dot's own edge, and taken away.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.short_repr import ShortRepr
from heliogauge.validate import Float32Array
from photogrammetry.centers.target_center import TargetCenter

#: Points a side with which a pixel's area is sampled, and reach of the blur in its standard deviations.
_SUBPIXELS, _REACH_SIGMAS = 3, 4.0
#: Blurs between the farthest pixels used for the dot and the ring from which its light is nothing: 0.1 % of the step.
_FAR_SIGMAS = 3.0


@dataclass(frozen=True, slots=True)
class InkedRing(ShortRepr):
    """A code ring round a dot, as it is seen.

    inner, outer: Where it begins and ends, in radii of the dot.
    sectors: Ink of the sectors, clockwise in the image.
    turn_rad: Where the first sector begins, clockwise from the x axis of the dot's frame [rad].
    """

    inner: float
    outer: float
    sectors: tuple[bool, ...]
    turn_rad: float


def ring_disturbs(center: TargetCenter, ring: InkedRing, reach: float) -> bool:
    """Return whether the light of a ring reaches the pixels that a dot is centred with.

    reach: How far from the centre pixels are used, in radii of the dot.
    """
    return bool((ring.inner - reach) * center.ellipse.semi_axes_px[1] < _FAR_SIGMAS * center.blur_px)


def without_rings(
    image_dn: npt.NDArray[np.generic], centers: Sequence[TargetCenter], rings: Sequence[InkedRing]
) -> Float32Array:
    """Return a photo without the light of some code rings.

    image_dn (h, w): Grey values [DN].
    centers: The dots; their blur and contrast are those of their rings.
    Returns (h, w): Grey values [DN].
    """
    left = np.array(image_dn, dtype=np.float32)
    height, width = left.shape
    for center, ring in zip(centers, rings, strict=True):
        larger = ring.outer * center.ellipse.semi_axes_px[0]
        half = int(np.ceil(larger + _REACH_SIGMAS * center.blur_px)) + 1
        x, y = np.rint(center.center_px).astype(int).tolist()
        columns = np.arange(max(x - half, 0), min(x + half + 1, width))
        rows = np.arange(max(y - half, 0), min(y + half + 1, height))
        if not columns.size or not rows.size:
            continue
        ink = _drawn(center, ring, columns, rows)
        if center.blur_px > 0:
            taps = 2 * int(np.ceil(_REACH_SIGMAS * center.blur_px)) + 1
            ink = np.asarray(
                cv2.GaussianBlur(ink, (taps, taps), center.blur_px, borderType=cv2.BORDER_REPLICATE), dtype=np.float32
            )
        left[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] -= np.float32(center.contrast_dn) * ink
    return left


def _drawn(
    center: TargetCenter, ring: InkedRing, columns: npt.NDArray[np.integer], rows: npt.NDArray[np.integer]
) -> Float32Array:
    """Return the share of each pixel that the ring's ink covers."""
    offset = (np.arange(_SUBPIXELS) + 0.5) / _SUBPIXELS - 0.5
    dx = (columns[:, None] + offset - center.center_px[0]).ravel()
    dy = (rows[:, None] + offset - center.center_px[1]).ravel()
    inverse = np.linalg.inv(center.ellipse.frame_px)
    u = inverse[0, 0] * dx + inverse[0, 1] * dy[:, None]
    v = inverse[1, 0] * dx + inverse[1, 1] * dy[:, None]
    radius = np.hypot(u, v)
    n = len(ring.sectors)
    sector = np.floor((np.arctan2(v, u) - ring.turn_rad) % (2 * np.pi) * (n / (2 * np.pi))).astype(np.intp) % n
    inked = (radius >= ring.inner) & (radius <= ring.outer) & np.array(ring.sectors)[sector]
    fine = inked.reshape(rows.size, _SUBPIXELS, columns.size, _SUBPIXELS)
    return np.asarray(fine.mean(axis=(1, 3)), dtype=np.float32)
