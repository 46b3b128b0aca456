"""Where the absorber's reflection is expected on the mirror."""

from dataclasses import dataclass

import numpy as np

from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, FloatArray
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector


@dataclass(frozen=True, slots=True, eq=False)
class Expectation(ShortRepr):
    """Where reflections are expected.

    collector: The design.
    absorber: The tube's axis, as well as it is known.
    y_m (r,): Equally spaced rows of the map [m].
    slope_error_rad: Largest slope error of the mirror that is searched for [rad].
    """

    collector: Collector
    absorber: AbsorberPath
    y_m: FloatArray
    slope_error_rad: float = 12e-3

    def goes_either_way(self, eyes_m: FloatArray) -> BoolArray:
        """Return from which places the reflection may move either way on the mirror as the camera moves one way.

        Shapes: eyes_m (k, 3), result (k,).

        The design's own angle changes along the mirror as that of the camera does, by 1/d in a metre. From far away a
        slope error that goes from minus to plus half the largest one within a metre outweighs that: the tube's two
        edges then follow each other in either order.
        """
        return np.asarray(1 / np.linalg.norm(eyes_m, axis=1) < 2 * self.slope_error_rad)
