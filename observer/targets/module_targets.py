"""Targets of a collector: which of a list belong to it, where they are in its frame, whether they determine a pose."""

from dataclasses import dataclass

import numpy as np

from heliogauge.geometry.rigid import rotation_from_vector
from heliogauge.validate import FloatArray
from observer.trough.collector import Collector

#: A target belongs to a collector up to this far beside its outline: on its rims, at its ends, on a neighbour's end
#: that is next to it [m].
MARGIN_M = 0.6


@dataclass(frozen=True, slots=True, eq=False)
class ListedPlaces:
    """Targets as a list has them.

    places_m, sigma_m (n, 3): Coordinates with standard deviations; NaN: unknown [m].
    """

    names: tuple[str, ...]
    places_m: FloatArray
    sigma_m: FloatArray


def in_frame(listed: ListedPlaces, place_m: FloatArray, turn_rad: float) -> ListedPlaces:
    """Return targets in a collector's own frame.

    place_m (3,): The collector's origin there [m].
    turn_rad: Its turn there, by the right hand about +y [rad].
    Returns: The same targets. Where the collector is turned, x and z of a target are known together or not at all,
        and what their errors have in common is left out.
    """
    if turn_rad == 0.0:
        return ListedPlaces(listed.names, listed.places_m - place_m, listed.sigma_m)
    turned = rotation_from_vector(np.array([0.0, -turn_rad, 0.0]))
    whole = np.isfinite(listed.sigma_m)
    both = whole[:, 0] & whole[:, 2]
    variance = np.where(whole, listed.sigma_m, 0.0) ** 2 @ (turned**2).T
    known = np.stack([both, whole[:, 1], both], axis=1)
    return ListedPlaces(
        listed.names, (listed.places_m - place_m) @ turned.T, np.where(known, np.sqrt(variance), np.nan)
    )


def beside(listed: ListedPlaces, collector: Collector) -> list[int]:
    """Return numbers of the targets that belong to a collector, those of unknown places among them.

    listed: In the collector's frame.
    """
    reach = np.array([collector.aperture_width_m, collector.length_m]) / 2 + MARGIN_M
    known = np.isfinite(listed.sigma_m).all(axis=1)
    near = (np.abs(listed.places_m[:, :2]) <= reach).all(axis=1)
    return np.flatnonzero(near | ~known).tolist()
