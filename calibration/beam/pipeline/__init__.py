"""Photos of beams, one after the other, to places and sizes on their targets."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from calibration.beam.pipeline import compare as compare
    from calibration.beam.pipeline.beams import BeamMeasurements as BeamMeasurements
    from calibration.beam.pipeline.beams import measure_beams as measure_beams
    from calibration.beam.pipeline.beams import write_beams as write_beams
    from calibration.beam.pipeline.compare import CompareOptions as CompareOptions

__getattr__, __dir__, __all__ = lazy_face(__name__)
