"""Where the absorber's reflection is expected on the mirror."""

from dataclasses import dataclass

from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray
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
