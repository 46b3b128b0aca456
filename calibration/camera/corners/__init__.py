"""Corners and circles of a board in a photo: found, refused with a reason, placed to hundredths of a pixel."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from calibration.camera.boards import CharucoBoard as CharucoBoard
    from calibration.camera.corners.detection import find_charuco as find_charuco

__getattr__, __dir__, __all__ = lazy_face(__name__)
