"""The light of a beam on its target: background, region, centre by four methods, size, and what to trust.

And the aim points that look for a beam which is not on its target.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from calibration.beam.light.aim_spiral import search_spiral as search_spiral
    from calibration.beam.light.background import background_around as background_around
    from calibration.beam.light.beam_flags import BeamFlag as BeamFlag
    from calibration.beam.light.beam_image import measure_beam as measure_beam
    from calibration.beam.light.beam_moments import BeamMoments as BeamMoments
    from calibration.beam.light.beam_moments import encircled_diameters_m as encircled_diameters_m

__getattr__, __dir__, __all__ = lazy_face(__name__)
