"""What the glass around the absorber does to lines of sight that pass close to the metal."""

from typing import NamedTuple

import numpy as np

from heliogauge.validate import FloatArray, IntArray
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector


def turned_rad(collector: Collector, radii: float) -> float:
    """Return by what angle the glass turns a line of sight on its way in, before it passes the middle.

    radii: Distance at which the line passes the middle of the glass, in radii of the tube.
    Returns: Angle towards the side on which the line passes, in the plane across the tube; on the way out it is
        turned by as much once more; 0 without glass [rad].

    By the plane law of refraction: towards the middle at the outer face, away from it at the inner one. Beyond the
    inner face it stays what it is there.
    """
    glass = collector.glass
    if glass is None:
        return 0.0
    inner = min(radii * collector.absorber_diameter_m / glass.inner_diameter_m, 1.0)
    outer = inner * glass.inner_diameter_m / glass.outer_diameter_m
    at_inner = np.arcsin(inner) - np.arcsin(inner / glass.index)
    return float(at_inner - np.arcsin(outer) + np.arcsin(outer / glass.index))


class GlassBeside(NamedTuple):
    """Where the middle of the glass is beside the tube's.

    receiver (m,): Which piece of glass surrounds the tube there.
    x_m, z_m (m,): Middle of the glass less that of the tube, were both one at the ends of the piece [m].
    """

    receiver: IntArray
    x_m: FloatArray
    z_m: FloatArray


def count_receivers(collector: Collector) -> int:
    """Return how many pieces of glass there are: one between each two neighbouring supports, at least one."""
    return max(collector.held_y_m.size - 1, 1)


class GlassEnds(NamedTuple):
    """Which piece of glass surrounds the tube at some places, where it begins and ends, and the share of the way.

    Shapes: receiver, first_m, last_m, share (m,).
    """

    receiver: IntArray
    first_m: FloatArray
    last_m: FloatArray
    share: FloatArray


def glass_ends(collector: Collector, y_m: FloatArray) -> GlassEnds | None:
    """Return the glass around places (m,) along the tube, between its bellows; None without two supports."""
    supports, half = collector.held_y_m, collector.support_width_m / 2
    if supports.size < 2:
        return None
    receiver = np.clip(np.searchsorted(supports, y_m, side="right") - 1, 0, supports.size - 2)
    first, last = (supports[:-1] + half)[receiver], (supports[1:] - half)[receiver]
    return GlassEnds(
        np.asarray(receiver, dtype=np.intp), first, last, np.asarray(np.clip((y_m - first) / (last - first), 0.0, 1.0))
    )


def glass_beside_tube(collector: Collector, path: AbsorberPath, y_m: FloatArray) -> GlassBeside:
    """Return where a glass that is straight between its bellows is beside a tube that sags and bends within it.

    path: The tube's axis.
    y_m (m,): Places along the trough [m].
    Returns: Of each place; zeros where no two supports are listed.
    """
    ends = glass_ends(collector, y_m)
    if ends is None:
        return GlassBeside(np.zeros(y_m.size, dtype=np.intp), np.zeros(y_m.size), np.zeros(y_m.size))
    # A station at a bellows has its place from those beside it; the tube is held there and has no kink.
    beside = [
        (1 - ends.share) * at_first + ends.share * at_last - at_tube
        for at_first, at_last, at_tube in zip(path.at(ends.first_m), path.at(ends.last_m), path.at(y_m), strict=True)
    ]
    return GlassBeside(ends.receiver, beside[0], beside[1])
