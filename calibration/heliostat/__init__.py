"""Tracking models of heliostats from beams on targets, sightings and points of the mirror.

With covariance, how far each model may be believed, and what is wrong with a heliostat or its records. The rooms
listed have faces of their own.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from calibration.heliostat import diagnosis as diagnosis
    from calibration.heliostat import exports as exports
    from calibration.heliostat import fitting as fitting
    from calibration.heliostat import kinematic_model as kinematic_model
    from calibration.heliostat import observations as observations
    from calibration.heliostat import planning as planning
    from calibration.heliostat.pipeline.measure import Options as Options
    from calibration.heliostat.pipeline.measure import Result as Result
    from calibration.heliostat.pipeline.measure import run as run

__getattr__, __dir__, __all__ = lazy_face(__name__)
