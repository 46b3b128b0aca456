"""What is wrong with a heliostat or with its records, from the residuals of its fit."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from calibration.heliostat.diagnosis.field_findings import judge_field as judge_field
    from calibration.heliostat.diagnosis.full_diagnosis import Records as Records
    from calibration.heliostat.diagnosis.full_diagnosis import diagnose as diagnose

__getattr__, __dir__, __all__ = lazy_face(__name__)
