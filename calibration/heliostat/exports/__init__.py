"""What other programs and controllers can say of a heliostat, and what is lost when they say it.

The working range over which two models are compared; ARTIST's numbers; rows for controllers; calibrated heliostats as
their results on disk have them.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from calibration.heliostat.exports.aim_table import Calibrated as Calibrated
    from calibration.heliostat.exports.artist_model import artist_heliostat as artist_heliostat
    from calibration.heliostat.exports.controllers import controller_row as controller_row
    from calibration.heliostat.exports.working_range import WorkingRange as WorkingRange

__getattr__, __dir__, __all__ = lazy_face(__name__)
