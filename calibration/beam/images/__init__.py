"""Where targets are in the photos of a camera, and how a photo gets from its file onto the target's plane."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from calibration.beam.images.target_finder import TargetFinder as TargetFinder
    from calibration.beam.images.target_frames import ArucoMarkers as ArucoMarkers
    from calibration.beam.images.target_frames import CornerPixels as CornerPixels
    from calibration.beam.images.target_frames import DarkMarks as DarkMarks
    from calibration.beam.images.target_frames import MarkerTemplates as MarkerTemplates
    from calibration.beam.images.target_frames import TargetFrame as TargetFrame
    from calibration.beam.images.target_frames import WholeImage as WholeImage
    from calibration.beam.images.target_frames import frame_of_section as frame_of_section
    from calibration.beam.keys import BeamImagesSection as BeamImagesSection

__getattr__, __dir__, __all__ = lazy_face(__name__)
