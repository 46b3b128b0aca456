"""Robust adjustment of the model of a heliostat.

What is known beforehand, which parameters may move, what the model is tried out on, how far a prediction may be
believed.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from calibration.heliostat.fitting.field_fit import fit_with_field as fit_with_field
    from calibration.heliostat.fitting.field_model import FieldUnit as FieldUnit
    from calibration.heliostat.fitting.field_model import learn_field as learn_field
    from calibration.heliostat.fitting.fit_result import FitOptions as FitOptions
    from calibration.heliostat.fitting.prediction import predict_aim as predict_aim
    from calibration.heliostat.fitting.prediction import sun_positions_of_year as sun_positions_of_year
    from calibration.heliostat.fitting.priors import PRIORS as PRIORS
    from calibration.heliostat.fitting.priors import with_priors as with_priors
    from calibration.heliostat.fitting.robust_fit import fit as fit
    from calibration.heliostat.fitting.splits import make_split as make_split

__getattr__, __dir__, __all__ = lazy_face(__name__)
