"""Photos of a screen or wall to its geometry: points with covariance, shape, and the measuring camera's pose to it.

`find_dots` numbers a field of dots in each photo, `numbering` gives all photos the same numbers, photogrammetry adjusts
the network, `screen_shape` describes the screen in a frame of its own; as a `MeasuredScreen` it goes into a set-up.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from deflectometry.screen_geometry.keys import load_screen as load_screen
    from deflectometry.screen_geometry.measured_screen import MeasuredScreen as MeasuredScreen
    from deflectometry.screen_geometry.pipeline.geometry import run as run
    from deflectometry.screen_geometry.pipeline.screen_file import read_screen as read_screen

__getattr__, __dir__, __all__ = lazy_face(__name__)
