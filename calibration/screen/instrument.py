"""What the calibration of screens offers: found by `heliogauge.instruments`."""

from heliogauge.instruments import Commands, Instrument, Kind

INSTRUMENT = Instrument(
    name="screen",
    summary="Photographs of grey levels -> response of camera and display.",
    commands=Commands(
        "calibrate", "calibration.cli:app", "Calibrate a camera, the response of a display, or heliostats."
    ),
    kinds=(
        Kind(
            name="response",
            model="calibration.screen.keys:ResponseModel",
            load="calibration.screen.keys:load_response",
            template="calibration.screen:template.toml",
            command="calibrate response",
            run="calibration.screen.pipeline:run",
            options="calibration.screen.pipeline:Options",
        ),
    ),
)
