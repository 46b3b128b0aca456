"""Aim points that look for a beam which is not on its target."""

import numpy as np

from heliogauge.errors import InputError
from heliogauge.validate import FloatArray, freeze, positive

__all__ = ["search_spiral"]


#: Harmless: 40,401 aim points, which take a heliostat four days at ten seconds each.
MOST_RINGS = 100


def search_spiral(target_side_m: float, rings: int) -> FloatArray:
    """Return offsets of the aim point that look for a beam which is not on the target (Malan 2014, 6.5).

    rings: Rings around the start.
    Returns ((2 rings + 1)^2, 2): Offsets right and up in the order of the visit: a square spiral outwards (right,
        up, left, left, down, ...) in blocks of half the target's side [m].
    InputError: A side that is not positive, fewer than no rings, or more than `MOST_RINGS`.

    >>> search_spiral(2.0, 1)[:4].tolist()
    [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
    """
    block = positive("target_side_m", target_side_m, "metres") / 2
    wanted = (2 * rings + 1) ** 2
    if not 0 <= rings <= MOST_RINGS:
        raise InputError(f"rings: 0 to {MOST_RINGS} are needed, not {rings}, which are {wanted:,} aim points")
    place, direction = np.zeros(2), np.array([1.0, 0.0])
    places, leg = [place], 0
    while len(places) < wanted:
        for _ in range(leg // 2 + 1):
            place = place + direction
            places.append(place)
        direction = np.array([-direction[1], direction[0]])
        leg += 1
    return freeze(block * np.array(places[:wanted]))
