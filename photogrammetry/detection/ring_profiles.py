"""Rings about dots as they are seen: ink by radius and angle, and where a code ring begins and ends.

Nothing is assumed of the print but a dot, a gap of the ground's colour and a ring that is inked in sectors. The gap is
even all round and the ring is not: along a circle the ink's scatter is that of the sectors in the ring and nothing in
the gap, however blurred both are, because the dot bleeds evenly to all sides.
"""

from dataclasses import dataclass

import numpy as np

from heliogauge.validate import BoolArray, Float32Array, FloatArray, IntArray
from photogrammetry.centers.pyramid import Pyramid
from photogrammetry.targets.ring_codes import LARGEST_OUTER_RADIUS, LEAST_INNER_RADIUS, LEAST_RING_WIDTH

#: Samples for each sector, and distance of the samples along the radius [radii].
ANGLES_PER_SECTOR = 12
_STEP = 0.1
#: Radii of the samples: from within the dot to beyond the farthest ring, of a zone of half a radius [radii].
RADII = np.round(np.arange(0.5, LARGEST_OUTER_RADIUS + 0.71, _STEP), 6)
#: Where the dot's level is taken, outside of holes and marks in its middle; where the ground's level is looked for.
_DOT_PART, _GROUND_PART = (RADII > 0.55) & (RADII < 0.85), (RADII > 1.2) & (RADII < 2.65)
#: Scatter of ink along a circle from which it belongs to a ring: one inked sector of 20 has 0.22.
_LEAST_SCATTER = 0.12
#: Levels between which the dot's edge is measured, and their distance in standard deviations of its blur.
_EDGE_LEVELS, _EDGE_SIGMAS = (0.75, 0.25), 1.349
_WIDEST_EDGE = 0.4
#: Dots that are sampled at once.
_AT_ONCE = 400


@dataclass(frozen=True, slots=True, eq=False)
class RingProfiles:
    """What is seen round n dots.

    ink (n, radii, angles): Ink at `RADII`, clockwise from the frame's x axis: 0 as the ground, 1 as the dot.
    step_dn (n,): Dot minus ground; NaN where there is no difference [DN].
    edge (n,): Standard deviation of the blur of the dot's edge, in radii of the dot.
    reach (n,): Radius to which the photo shows what is round the dot.
    inner, outer (n,): Where the first ring begins and ends; NaN where there is none.
    """

    ink: Float32Array
    step_dn: FloatArray
    edge: FloatArray
    reach: FloatArray
    inner: FloatArray
    outer: FloatArray

    def chosen(self, rows: IntArray | BoolArray) -> "RingProfiles":
        """Return some of the dots."""
        return RingProfiles(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))

    def band(self, low: FloatArray, high: FloatArray) -> FloatArray:
        """Return the mean ink between two radii of each dot, shape (n, angles)."""
        centre = 0.5 * (low + high)
        half = np.maximum(0.5 * (high - low), 0.5001 * _STEP)
        weights = (np.abs(RADII - centre[:, None]) <= half[:, None]).astype(np.float32)
        weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1)
        return np.asarray(np.matmul(weights[:, None, :], self.ink)[:, 0], dtype=np.float64)


def sample_rings(pyramid: Pyramid, shapes_px2: FloatArray, centers_px: FloatArray, n_angles: int) -> RingProfiles:
    """Sample what is round dots, and find the first ring of each.

    shapes_px2 (n, 2, 2), centers_px (n, 2): Outlines of the dots.
    Returns: Profiles of the dots that may have a ring; the others are left out.
    """
    parts = [
        _sample(pyramid, shapes_px2[first : first + _AT_ONCE], centers_px[first : first + _AT_ONCE], n_angles)
        for first in range(0, max(len(shapes_px2), 1), _AT_ONCE)
    ]
    return RingProfiles(
        *(np.concatenate([getattr(part, name) for part in parts]) for name in RingProfiles.__dataclass_fields__)
    )


def _sample(pyramid: Pyramid, shapes: FloatArray, centers: FloatArray, n_angles: int) -> RingProfiles:
    count = len(shapes)
    angles = np.arange(n_angles) * (2 * np.pi / n_angles)
    circle = np.stack([np.cos(angles), np.sin(angles)])
    unit = (circle[:, None, :] * RADII[:, None]).reshape(2, -1)
    values = pyramid.around(centers, shapes, unit).reshape(count, RADII.size, n_angles)
    dot = np.median(values[:, _DOT_PART].reshape(count, -1), axis=1).astype(np.float64)
    means = values.mean(axis=2, dtype=np.float64)
    # The ground is where the mean along a circle is farthest from the dot.
    away = np.where(_GROUND_PART, np.abs(means - dot[:, None]), -1.0)
    ground_at = away.argmax(axis=1)
    ground = values[np.arange(count), ground_at].astype(np.float64)
    # Its level as a plane: the first harmonic round the dot. Levels of the ring follow the plane outwards.
    harmonics = ground @ circle.T * (2 / n_angles)
    step = dot - ground.mean(axis=1)
    step = np.where(np.abs(step) > 1e-3, step, np.nan)
    slope = (harmonics @ circle)[:, None, :] * (RADII / RADII[ground_at][:, None])[:, :, None]
    ink = (values - (ground.mean(axis=1)[:, None, None] + slope).astype(np.float32)) / step.astype(np.float32)[
        :, None, None
    ]
    inner, outer = _first_ring(ink.std(axis=2), ground_at)
    half = np.sqrt(np.diagonal(shapes, axis1=1, axis2=2))
    far = np.array(pyramid.size_px) - 1 - centers
    reach = np.minimum(centers / half, far / half).min(axis=1)
    return RingProfiles(np.nan_to_num(ink), step, _edge_width(ink.mean(axis=2)), reach, inner, outer)


def _first_ring(scatter: FloatArray, ground_at: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return where the scatter along circles first rises to half of its peak and falls below half again."""
    place = np.arange(RADII.size)
    scatter = np.nan_to_num(scatter)
    risen = (scatter > _LEAST_SCATTER) & (place >= ground_at[:, None])
    first = risen.argmax(axis=1)
    highest = np.maximum.accumulate(np.where(place >= first[:, None], scatter, 0.0), axis=1)
    fallen = (scatter < 0.5 * highest) & (place > first[:, None])
    last = fallen.argmax(axis=1)
    within = (place >= first[:, None]) & (place < last[:, None])
    peak_at = np.where(within, scatter, -1.0).argmax(axis=1)
    half = 0.5 * scatter[np.arange(len(scatter)), peak_at]
    below = (scatter <= half[:, None]) & (place < peak_at[:, None])
    before = RADII.size - 1 - below[:, ::-1].argmax(axis=1)
    found = risen.any(axis=1) & fallen.any(axis=1) & below.any(axis=1)
    inner, outer = _crossing(scatter, before, half), _crossing(scatter, last - 1, half)
    found &= (inner > LEAST_INNER_RADIUS) & (outer < LARGEST_OUTER_RADIUS) & (outer - inner > LEAST_RING_WIDTH)
    return np.where(found, inner, np.nan), np.where(found, outer, np.nan)


def _crossing(values: FloatArray, before: IntArray, level: FloatArray) -> FloatArray:
    """Return the radius at which values cross a level after a place."""
    row = np.arange(len(values))
    here, following = values[row, before], values[row, np.minimum(before + 1, RADII.size - 1)]
    step = np.where(following == here, 1.0, following - here)
    return np.asarray(RADII[before] + _STEP * np.clip((level - here) / step, 0.0, 1.0))


def _edge_width(means: Float32Array) -> FloatArray:
    """Return the blur of the dots' edges, from where the mean along circles passes two levels."""
    inside = RADII < 1.65
    values = means[:, inside].astype(np.float64)
    places = []
    for level in _EDGE_LEVELS:
        below = values < level
        below[:, : int(np.searchsorted(RADII, 0.75))] = False
        at = below.argmax(axis=1)
        place = _crossing(means.astype(np.float64), np.maximum(at - 1, 0), np.full(len(values), level))
        places.append(np.where(below.any(axis=1), place, np.nan))
    width = (places[1] - places[0]) / _EDGE_SIGMAS
    return np.clip(np.nan_to_num(width, nan=_WIDEST_EDGE), 0.0, _WIDEST_EDGE)
