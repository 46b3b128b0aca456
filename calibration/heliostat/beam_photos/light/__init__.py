"""The light of a beam on its target: background, region, centre by four methods, size, and what to trust."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from calibration.heliostat.beam_photos.light.background import background_around as background_around
    from calibration.heliostat.beam_photos.light.beam_image import measure_beam as measure_beam

__getattr__, __dir__, __all__ = lazy_face(__name__)
