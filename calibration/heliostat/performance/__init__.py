"""How well a heliostat does: tests, the data sheet with uncertainty and limits, what an error costs over a year."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from calibration.heliostat.performance.entries import Entry as Entry
    from calibration.heliostat.performance.entries import Limit as Limit
    from calibration.heliostat.performance.entries import decide as decide
    from calibration.heliostat.performance.pipeline.run_tests import Options as Options
    from calibration.heliostat.performance.pipeline.run_tests import run as run
    from calibration.heliostat.performance.reflectance import solar_weighted as solar_weighted

__getattr__, __dir__, __all__ = lazy_face(__name__)
