"""Beams of mirrors on targets: measured in photos, with sigma, and compared with the mirror that made them.

The target is found in the photo, the photo put on its plane, the light of the beam separated from the target. The rooms
listed have faces of their own. Nothing here knows how a heliostat turns.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from calibration.beam import images as images
    from calibration.beam import light as light
    from calibration.beam import pipeline as pipeline
    from calibration.beam import target as target
    from calibration.beam.pipeline.measure import Options as Options
    from calibration.beam.pipeline.measure import Result as Result
    from calibration.beam.pipeline.measure import run as run

__getattr__, __dir__, __all__ = lazy_face(__name__)
