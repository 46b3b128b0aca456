"""What the calibration of screens offers: found by `heliogauge.instruments`."""

from heliogauge.instruments import Instrument, Kind

INSTRUMENT = Instrument(
    name="screen",
    summary="Photographs of grey levels -> response of camera and display.",
    commands="calibration.screen.cli:app",
    kinds=(
        Kind(
            name="response",
            model="calibration.screen.keys:ResponseModel",
            load="calibration.screen.keys:load_response",
            template="calibration.screen:template.toml",
            command="screen measure",
            run="calibration.screen.pipeline:run",
            options="calibration.screen.pipeline:Options",
        ),
    ),
    reports={"response": "calibration.screen:report.ipynb"},
)
