"""How a camera flew past each photo, from where the neighbouring photos were taken."""

from dataclasses import dataclass

import numpy as np

from heliogauge.validate import FloatArray, IntArray

#: Where path and neighbours say nothing else, what they leave open is this share of the mean speed; the size of it all
#: is estimated, this says how much a straight part of the path is better known than a bend.
_STEADY_SHARE = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """How the camera flew past each photo.

    velocity (n, 3): In the frame [m/s], or its direction where no speed is known.
    doubt (n,): How uncertain that is at a photo beside others, in any unit: by how much both neighbours differ.
    """

    velocity: FloatArray
    doubt: FloatArray

    def of(self, rows: IntArray) -> "Flight":
        """Return the flight past some of the photos."""
        return Flight(self.velocity[rows], self.doubt[rows])


def flight_by_places(places_m: FloatArray, speed_m_s: float = 1.0) -> Flight:
    """Return in which direction the camera flew past each photo, at one speed over the whole path.

    places_m (n, 3): The cameras in the order of the flight, at least two [m].
    Returns: Along the chord between both neighbours.
    """
    lengths = np.maximum(np.linalg.norm(np.diff(places_m, axis=0), axis=1), 1e-12)
    along = np.concatenate([[0.0], np.cumsum(lengths)]) / speed_m_s
    found = flight_by_times(places_m, along)
    chords = np.linalg.norm(found.velocity, axis=1, keepdims=True)
    return Flight(speed_m_s * found.velocity / np.maximum(chords, 1e-12), found.doubt)


def flight_by_times(places_m: FloatArray, times_s: FloatArray) -> Flight:
    """Return how fast the camera flew past each photo: from the one before to the one after it.

    places_m (n, 3): The cameras in the order of the flight, at least two [m].
    times_s (n,): When each photo was taken, ascending [s].
    """
    count = len(places_m)
    before, after = np.maximum(np.arange(count) - 1, 0), np.minimum(np.arange(count) + 1, count - 1)
    velocity = (places_m[after] - places_m[before]) / (times_s[after] - times_s[before])[:, None]
    rates = np.diff(places_m, axis=0) / np.diff(times_s)[:, None]
    change = np.zeros(count)
    change[1:-1] = np.linalg.norm(np.diff(rates, axis=0), axis=1)
    mean = float(np.linalg.norm(velocity, axis=1).mean())
    return Flight(velocity, np.hypot(change, max(_STEADY_SHARE * mean, 1e-12)))
