"""Photos of beams on targets to places with covariance.

The target is found in the photo, the photo put on its plane, the light of the beam separated from the target.
Nothing here knows heliostats.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from calibration.heliostat.beam_photos.pipeline.beams import BeamMeasurements as BeamMeasurements
    from calibration.heliostat.beam_photos.pipeline.beams import measure_beams as measure_beams
    from calibration.heliostat.beam_photos.pipeline.beams import write_beams as write_beams
    from calibration.heliostat.beam_photos.pipeline.target_frames import ArucoMarkers as ArucoMarkers
    from calibration.heliostat.beam_photos.pipeline.target_frames import CornerPixels as CornerPixels
    from calibration.heliostat.beam_photos.pipeline.target_frames import DarkMarks as DarkMarks
    from calibration.heliostat.beam_photos.pipeline.target_frames import MarkerTemplates as MarkerTemplates
    from calibration.heliostat.beam_photos.pipeline.target_frames import TargetFinder as TargetFinder
    from calibration.heliostat.beam_photos.pipeline.target_frames import TargetFrame as TargetFrame
    from calibration.heliostat.beam_photos.pipeline.target_frames import WholeImage as WholeImage

__getattr__, __dir__, __all__ = lazy_face(__name__)
