"""What the survey of many results offers: found by `heliogauge.instruments`."""

from heliogauge.instruments import Instrument

INSTRUMENT = Instrument(
    name="survey",
    summary="Results of many days, heliostats and facets -> one store, trends, the worst.",
    commands="calibration.survey.cli:app",
    reports={"survey": "calibration.survey.report:report.ipynb"},
)
