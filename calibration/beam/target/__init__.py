"""The target in a photo: its marks, and the photo rectified to its plane."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from calibration.beam.target.view import Rectifier as Rectifier
    from calibration.beam.target.view import view_from_points as view_from_points
    from calibration.beam.target.view import whole_image as whole_image

__getattr__, __dir__, __all__ = lazy_face(__name__)
