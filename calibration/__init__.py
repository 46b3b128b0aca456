"""Calibration of what measures.

Cameras, the response of camera and display, and heliostats are instruments of their own, each with a face of its
own.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from calibration import camera as camera
    from calibration import heliostat as heliostat
    from calibration import screen as screen

__getattr__, __dir__, __all__ = lazy_face(__name__)
