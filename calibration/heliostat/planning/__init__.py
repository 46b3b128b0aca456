"""What a calibration will be worth before it is made, and which measurement to make next.

Both with the fit itself, on simulated observations.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from calibration.heliostat.planning.error_curves import error_curve as error_curve
    from calibration.heliostat.planning.error_curves import stability as stability
    from calibration.heliostat.planning.measurement_plan import beam_candidates as beam_candidates
    from calibration.heliostat.planning.measurement_plan import knowledge_before as knowledge_before
    from calibration.heliostat.planning.measurement_plan import plan_measurements as plan_measurements
    from calibration.heliostat.planning.simulate import Control as Control
    from calibration.heliostat.planning.simulate import beam_angles as beam_angles
    from calibration.heliostat.planning.simulate import commanded_offsets as commanded_offsets
    from calibration.heliostat.planning.simulate import drawn_beams as drawn_beams
    from calibration.heliostat.planning.simulate import drawn_flight as drawn_flight
    from calibration.heliostat.planning.simulate import drawn_sightings as drawn_sightings
    from calibration.heliostat.planning.simulate import monte_carlo as monte_carlo

__getattr__, __dir__, __all__ = lazy_face(__name__)
