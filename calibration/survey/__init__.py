"""Results of many days, heliostats and facets in one store: what changes, what a repair did, which are the worst.

A store is a folder of Parquet files that a manifest lists, queried where they are; there is no server.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from calibration.survey.pipeline.add import AddOptions as AddOptions
    from calibration.survey.pipeline.add import add as add
    from calibration.survey.pipeline.judge_store import SurveyOptions as SurveyOptions
    from calibration.survey.pipeline.judge_store import run as run
    from calibration.survey.pipeline.keep_store import check as check
    from calibration.survey.pipeline.keep_store import remove as remove

__getattr__, __dir__, __all__ = lazy_face(__name__)
