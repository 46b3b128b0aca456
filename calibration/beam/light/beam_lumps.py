"""Whether the light on a target is one beam or several."""

import cv2
import numpy as np

from heliogauge.validate import BoolArray, FloatArray

__all__ = ["count_lumps"]

#: Peak and light of a second beam, as shares of the first's.
_LEAST_PEAK, _LEAST_LIGHT = 0.3, 0.1
#: Light of a second beam that the target's edge cuts: how much of it is beyond is not known, and so is which of the two
#: is meant. What a beam as wide and 0.3 as bright as the first has within one of the coarse pixels is about half.
_LEAST_LIGHT_AT_EDGE = 0.01
#: Depth of the valley between two beams that overlap, as a share of the lower peak. The streaks that single facets
#: draw in one beam are as close as a facet is wide, and are smoothed away first.
_LEAST_VALLEY = 0.15
#: Smoothing before valleys are looked for, as a share of the beam's minor width.
_SMOOTHING = 0.6
_LEVELS = np.arange(0.95, 0.1, -0.05)


def count_lumps(smoothed_dn: FloatArray, inside: BoolArray, others: BoolArray) -> int:
    """Count the beams in a picture without background.

    smoothed_dn (h, w): Brightness above the background, smoothed [DN].
    inside (h, w): The region with the most light.
    others (h, w): Other bright regions.
    Returns: The beam inside, those apart from it, and those that overlap with it but leave a valley between the
        peaks.
    """
    apart = _apart(smoothed_dn, inside, others)
    blurred = cv2.GaussianBlur(
        np.where(inside, smoothed_dn, 0.0), (0, 0), max(0.5, _SMOOTHING * _minor(smoothed_dn, inside))
    )
    return apart + _peaks_with_valleys(np.where(inside, blurred, 0.0))


def _minor(smoothed_dn: FloatArray, inside: BoolArray) -> float:
    rows, columns = np.nonzero(inside)
    if rows.size < 3:
        return 1.0
    points, weights = np.stack([columns, rows]).astype(np.float64), np.maximum(smoothed_dn[inside], 1e-12)
    total = float(weights.sum())
    points -= (points @ weights / total)[:, None]
    # As of so many points of unequal weight.
    spread = (points * weights) @ points.T / (total - float(weights @ weights) / total)
    return float(np.sqrt(max(np.linalg.eigvalsh(spread)[0], 0.0)))


def _apart(smoothed_dn: FloatArray, inside: BoolArray, others: BoolArray) -> int:
    count, labels = cv2.connectedComponents(others.astype(np.uint8), connectivity=4)
    peak, light = float(smoothed_dn[inside].max()), float(smoothed_dn[inside].sum())
    at_edge = set(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]).tolist())
    found = 0
    if count < 2:
        return found
    for k in range(1, count):
        own = smoothed_dn[labels == k]
        least = _LEAST_LIGHT_AT_EDGE if k in at_edge else _LEAST_LIGHT
        found += bool(own.max() > _LEAST_PEAK * peak and own.sum() > least * light)
    return found


def _peaks_with_valleys(brightness: FloatArray) -> int:
    """Lower a level through the peaks; peaks that join count as two where the level is far below the lower one."""
    top = float(brightness.max())
    most = 1
    for level in _LEVELS * top:
        count, labels = cv2.connectedComponents((brightness > level).astype(np.uint8), connectivity=8)
        if count <= 2:
            continue
        heights = [float(brightness[labels == k].max()) for k in range(1, count)]
        deep = [h for h in heights if level < (1 - _LEAST_VALLEY) * h and h > _LEAST_PEAK * top]
        most = max(most, len(deep))
    return most
