"""Response of camera and display from photos of uniform grey levels.

It is the signal of the camera for each level shown, with sigma, and makes fringes linear.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from calibration.screen.response import ScreenResponse as ScreenResponse
    from calibration.screen.response import linearise_frames as linearise_frames

__getattr__, __dir__, __all__ = lazy_face(__name__)
