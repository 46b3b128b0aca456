"""What the calibration of heliostats offers: found by `heliogauge.instruments`."""

from heliogauge.instruments import Commands, Instrument, Kind

INSTRUMENT = Instrument(
    name="heliostat",
    summary="Where beams were seen and the drive readings -> tracking models.",
    commands=Commands(
        "calibrate", "calibration.cli:app", "Calibrate a camera, the response of a display, or heliostats."
    ),
    kinds=(
        Kind(
            name="heliostat",
            model="calibration.heliostat.keys:HeliostatModel",
            load="calibration.heliostat.keys:load_heliostat",
            template="calibration.heliostat:template.toml",
            command="calibrate heliostat",
            run_into="calibration.heliostat.pipeline.field:run_into",
            options="calibration.heliostat.pipeline.measure:Options",
            recognises="calibration.heliostat.keys:paint_measurement",
        ),
    ),
    reports={
        "heliostat": "calibration.heliostat.report:report.ipynb",
        "heliostat-field": "calibration.heliostat.report:report_field.ipynb",
    },
    synth="data_synth.preset_folders:heliostats",
)
