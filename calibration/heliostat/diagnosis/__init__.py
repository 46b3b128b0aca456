"""What is wrong with a heliostat or with its records, from the residuals of its fit."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from calibration.heliostat.diagnosis.field_findings import judge_field as judge_field
    from calibration.heliostat.diagnosis.full_diagnosis import Records as Records
    from calibration.heliostat.diagnosis.full_diagnosis import diagnose as diagnose
    from calibration.heliostat.diagnosis.linear_model import linear_fit as linear_fit
    from calibration.heliostat.diagnosis.misfit import GAINS as GAINS
    from calibration.heliostat.diagnosis.misfit import ODDS_OF_A_FAULT as ODDS_OF_A_FAULT
    from calibration.heliostat.diagnosis.misfit import chance_in_sound as chance_in_sound
    from calibration.heliostat.diagnosis.misfit import class_of as class_of
    from calibration.heliostat.diagnosis.residual_terms import term_gains as term_gains
    from calibration.heliostat.diagnosis.rivals import further_numbers as further_numbers
    from calibration.heliostat.diagnosis.terms import Terms as Terms

__getattr__, __dir__, __all__ = lazy_face(__name__)
