"""Description of a set-up: camera, screen, patterns. Estimates nothing."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from deflectometry.setup.camera_and_screen import Setup as Setup
    from deflectometry.setup.dot_marks import marked_radii as marked_radii
    from deflectometry.setup.patterns import Axis as Axis
    from deflectometry.setup.patterns import FringePattern as FringePattern
    from deflectometry.setup.patterns import FringeSet as FringeSet
    from deflectometry.setup.patterns import GrayCode as GrayCode
    from deflectometry.setup.patterns import make_pattern as make_pattern

__getattr__, __dir__, __all__ = lazy_face(__name__)
