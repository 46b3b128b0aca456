"""Fringe images become phases, phases become the screen point that each pixel sees."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from deflectometry.fringes.gray_code import GrayCodeObservation as GrayCodeObservation
    from deflectometry.fringes.known_point import KnownDisplayPoint as KnownDisplayPoint
    from deflectometry.fringes.observation import Observation as Observation
    from deflectometry.fringes.screen_map import ScreenMapLimits as ScreenMapLimits
    from deflectometry.fringes.screen_map import measure_screen_map as measure_screen_map
    from deflectometry.fringes.screen_map import modulation_image as modulation_image

__getattr__, __dir__, __all__ = lazy_face(__name__)
