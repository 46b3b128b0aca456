"""What the calibration of cameras offers: found by `heliogauge.instruments`."""

from heliogauge.instruments import Instrument, Kind

INSTRUMENT = Instrument(
    name="camera",
    summary="Photos of a board or targets -> calibrated camera.",
    commands="calibration.camera.cli:app",
    kinds=(
        Kind(
            name="camera",
            model="calibration.camera.keys:CameraCalibrationModel",
            load="calibration.camera.keys:load_camera_calibration",
            template="calibration.camera:template.toml",
            command="camera measure",
            run="calibration.camera.pipeline.measure:run",
            options="calibration.camera.pipeline.measure:Options",
            check="calibration.camera.pipeline.check:find_faults",
        ),
    ),
    reports={
        "camera": "calibration.camera.report:report.ipynb",
        "camera-plan": "calibration.camera.report:report_plan.ipynb",
    },
    synth="data_synth.preset_folders:camera",
    synth_command="data_synth.cli:camera",
)
