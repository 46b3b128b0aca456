"""Start values of cameras, poses and points from nothing but image points.

`build_network` grows a network from two photos; `resect` finds the pose of one photo from known targets.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from photogrammetry.start_values.network import LeftOut as LeftOut
    from photogrammetry.start_values.network import StartValues as StartValues
    from photogrammetry.start_values.network import build_network as build_network
    from photogrammetry.start_values.network import guessed_camera as guessed_camera
    from photogrammetry.start_values.resection import LEAST_TARGETS as LEAST_TARGETS
    from photogrammetry.start_values.resection import resect as resect
    from photogrammetry.start_values.resection import spans_an_area as spans_an_area

__getattr__, __dir__, __all__ = lazy_face(__name__)
