"""What was seen of heliostats, by kind, each with its equation.

Beams on targets, drones and cameras in the mirror, lamps, normals and points of the mirror.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from calibration.heliostat.observations.beam_observations import BeamSpots as BeamSpots
    from calibration.heliostat.observations.observations import Observations as Observations
    from calibration.heliostat.observations.pointings import Place as Place
    from calibration.heliostat.observations.pointings import Pointings as Pointings
    from calibration.heliostat.observations.residuals import ObservationModel as ObservationModel
    from calibration.heliostat.observations.residuals import evaluate as evaluate
    from calibration.heliostat.observations.residuals import predicted_spots as predicted_spots
    from calibration.heliostat.observations.rtk import rtk_statistics as rtk_statistics
    from calibration.heliostat.observations.visibility import ConcaveMirror as ConcaveMirror

__getattr__, __dir__, __all__ = lazy_face(__name__)
