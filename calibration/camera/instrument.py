"""What the calibration of cameras offers: found by `heliogauge.instruments`."""

from heliogauge.instruments import Commands, Instrument, Kind

INSTRUMENT = Instrument(
    name="camera",
    summary="Photos of a board or targets -> calibrated camera.",
    commands=Commands(
        "calibrate", "calibration.cli:app", "Calibrate a camera, the response of a display, or heliostats."
    ),
    kinds=(
        Kind(
            name="camera",
            model="calibration.camera.keys:CameraCalibrationModel",
            load="calibration.camera.keys:load_camera_calibration",
            template="calibration.camera:template.toml",
            command="calibrate camera",
            run="calibration.camera.pipeline.measure:run",
            options="calibration.camera.pipeline.measure:Options",
        ),
    ),
    reports={"camera": "calibration.camera.report:report.ipynb"},
    synth="data_synth.preset_folders:board",
)
