"""How far the mounts of a facet are to be moved so that its mean normal becomes the design's."""

from typing import NamedTuple

import numpy as np

from heliogauge.validate import FloatArray

#: A facet or panel of which less is measured gets no prescription: its mean would be that of a part.
LEAST_SHARE = 0.5


class Moves(NamedTuple):
    """Moves of mounts along the mirror's normal, positive out of the mirror.

    move_m (n,): The move; NaN where the turn is not known [m].
    sigma_m (n,): Its standard deviation [m].
    """

    move_m: FloatArray
    sigma_m: FloatArray


def moves_of_mounts(levers_m: FloatArray, turn_rad: FloatArray, covariance_rad2: FloatArray) -> Moves:
    """Return the moves that take a turn of the mirror back.

    Shapes: levers_m (n, 2): From the point about which the facet turns to each mount, along the surface in x and y [m].
    turn_rad (n, 2): Components of the angle from the design's to the measured normal, with the signs of slope errors:
        positive where the surface rises too much towards +x or +y. Of the facet that each mount holds [rad].
    covariance_rad2 (n, 2, 2): Their covariances [rad^2].

    A surface that rises by t per metre too much stands t * lever too far out: the mount goes back by that. Only the
    differences between the mounts of one facet matter; a common move shifts the facet and turns nothing.
    """
    move = -np.sum(levers_m * turn_rad, axis=1)
    variance = np.einsum("ni,nij,nj->n", levers_m, covariance_rad2, levers_m)
    return Moves(move, np.sqrt(variance))
