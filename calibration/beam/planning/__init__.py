"""What photos of a beam will tell of its mirror, before they are taken."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from calibration.beam.planning import plan as plan
    from calibration.beam.planning.plan import BeamPlanOptions as BeamPlanOptions

__getattr__, __dir__, __all__ = lazy_face(__name__)
