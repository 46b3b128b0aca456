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
from heliogauge.validate import Float32Array, FloatArray
from photogrammetry.centers.target_center import TargetCenter

#: Points a side with which a pixel's area is sampled, and reach of the blur in its standard deviations.
_SUBPIXELS, _REACH_SIGMAS = 3, 4.0
#: Pixels beyond what is used: a fit may move its start by so much.
_MARGIN_PX = 4
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


@dataclass(frozen=True, slots=True, eq=False)
class CleanWindows(ShortRepr):
    """What is round some dots without the light of their rings, side by side in one image.

    image_dn (h, w): Grey values [DN].
    origins_px (n, 2): Where in the photo the first pixel of each window lies, less where it lies in the image [px].
    """

    image_dn: Float32Array
    origins_px: FloatArray


def without_rings(
    image_dn: npt.NDArray[np.generic], centers: Sequence[TargetCenter], rings: Sequence[InkedRing], reach: float
) -> CleanWindows:
    """Cut out what is round some dots and take the light of their code rings away.

    image_dn (h, w): Grey values of the photo [DN].
    centers: The dots; their blur and contrast are those of their rings.
    reach: How far from the centre pixels are used, in radii of the dot.
    """
    height, width = image_dn.shape
    half = max(
        int(np.ceil(reach * one.ellipse.semi_axes_px[0] + _REACH_SIGMAS * one.blur_px)) + _MARGIN_PX for one in centers
    )
    side = 2 * half + 1
    clean = np.empty((side, side * len(centers)), dtype=np.float32)
    origins = np.empty((len(centers), 2))
    for k, (center, ring) in enumerate(zip(centers, rings, strict=True)):
        x, y = np.rint(center.center_px).astype(int).tolist()
        columns, rows = np.arange(x - half, x + half + 1), np.arange(y - half, y + half + 1)
        ink = _drawn(center, ring, columns, rows)
        if center.blur_px > 0:
            taps = 2 * int(np.ceil(_REACH_SIGMAS * center.blur_px)) + 1
            ink = np.asarray(
                cv2.GaussianBlur(ink, (taps, taps), center.blur_px, borderType=cv2.BORDER_REPLICATE), dtype=np.float32
            )
        window = image_dn[np.clip(rows, 0, height - 1)[:, None], np.clip(columns, 0, width - 1)]
        clean[:, k * side : (k + 1) * side] = window.astype(np.float32) - np.float32(center.contrast_dn) * ink
        origins[k] = x - half - k * side, y - half
    return CleanWindows(clean, origins)


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
    square = u * u + v * v
    inked = (square >= ring.inner**2) & (square <= ring.outer**2)
    n = len(ring.sectors)
    turn = (np.arctan2(v[inked], u[inked]) - ring.turn_rad) * (n / (2 * np.pi))
    inked[inked] = np.array(ring.sectors)[np.floor(turn).astype(np.intp) % n]
    fine = inked.reshape(rows.size, _SUBPIXELS, columns.size, _SUBPIXELS)
    return np.asarray(fine.mean(axis=(1, 3)), dtype=np.float32)
