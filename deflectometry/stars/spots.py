"""Points of light in a photo at night, with the standard deviations of their places."""

from dataclasses import dataclass

import cv2
import numpy as np

from heliogauge.validate import BoolArray, FloatArray

#: Pixels that stand out by so many standard deviations may be a star: 1 in 10^6 does by chance.
_SIGNIFICANT = 5.0
#: The sky's own light is the median over so many pixels.
_GROUND_PX = 25
#: Stars nearer to the outline are cut by it: their centres would be drawn inwards [px].
RIM_PX = 4
#: Beyond so many times the size of its bright part a star has no light that matters.
_WINDOW_PX = 5
#: Centres of light are no better than this, whatever the noise: pixels are no points [px].
FLOOR_PX = 0.03


@dataclass(frozen=True, slots=True, eq=False)
class Spots:
    """Points of light.

    places_px (n, 2): Centres of light. sigma_px (n,): Of each coordinate. flux_dn (n,): Light of each.
    """

    places_px: FloatArray
    sigma_px: FloatArray
    flux_dn: FloatArray


def find_spots(image_dn: FloatArray, region: BoolArray, saturation_dn: float) -> Spots:
    """Find stars in a part of a photo.

    region (h, w): Where to look: pixels that are at least `RIM_PX` inside a facet's outline.
    Returns: Centres of light, brightest first; saturated ones with half a pixel of sigma.

    The ground is that of the facet alone: under a sky that glows a mirror and what is around it differ in light, and a
    mean across the outline makes stars of its rim.
    """
    smooth = image_dn.astype(np.float32)
    quiet = cv2.medianBlur(np.clip(smooth, 0, 65535).astype(np.uint16), 5).astype(np.float32)
    weight = region.astype(np.float32)
    size = (_GROUND_PX, _GROUND_PX)
    ground = cv2.blur(quiet * weight, size) / np.maximum(cv2.blur(weight, size), 1e-9)
    facet = cv2.dilate(region.astype(np.uint8), np.ones((2 * RIM_PX + 1,) * 2, np.uint8)) > 0
    signal = np.where(facet, smooth - ground, np.float32(0))
    inside = signal[region]
    noise = 1.4826 * float(np.median(np.abs(inside - np.median(inside)))) if inside.size else 0.0
    noise = max(noise, 0.3)
    # Over the width of a star noise averages out: its blurred peak stands out further.
    blurred = cv2.GaussianBlur(signal, (0, 0), 1.0)
    spread = noise / (2 * np.sqrt(np.pi))
    peak = (blurred == cv2.dilate(blurred, np.ones((7, 7), np.uint8))) & region
    peak &= blurred > _SIGNIFICANT * spread
    rows, columns = np.nonzero(peak)
    places, sigmas, fluxes = [], [], []
    height, width = image_dn.shape
    for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
        top, left = max(row - _WINDOW_PX, 0), max(column - _WINDOW_PX, 0)
        part = signal[top : min(row + _WINDOW_PX + 1, height), left : min(column + _WINDOW_PX + 1, width)]
        y, x = np.mgrid[top : top + part.shape[0], left : left + part.shape[1]]
        centre, spread_px = np.array([column, row], dtype=np.float64), 1.5
        flux = 0.0
        for _ in range(8):
            weight = np.exp(-0.5 * ((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / spread_px**2)
            total = float((weight * part).sum())
            if total <= 0:
                break
            # A Gaussian weight of the star's own width halves each step: twice the step is taken.
            step = np.array([(weight * part * (x - centre[0])).sum(), (weight * part * (y - centre[1])).sum()]) / total
            centre = centre + 2 * step
            flux = 2 * total
        if flux <= 0 or np.abs(centre - [column, row]).max() > 3:
            continue
        variance = noise**2 + np.maximum(part, 0.0)
        weight = np.exp(-0.5 * ((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / spread_px**2)
        sigma = 2 * np.sqrt(float((weight**2 * variance * (x - centre[0]) ** 2).sum())) / (flux / 2)
        full = bool((image_dn[y, x] >= saturation_dn).any())
        places.append(centre)
        sigmas.append(0.5 if full else float(np.hypot(sigma, FLOOR_PX)))
        fluxes.append(flux)
    order = np.argsort(fluxes)[::-1]
    return Spots(
        np.reshape(np.array(places, dtype=np.float64), (-1, 2))[order],
        np.array(sigmas, dtype=np.float64)[order],
        np.array(fluxes, dtype=np.float64)[order],
    )
