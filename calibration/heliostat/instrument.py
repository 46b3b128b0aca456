"""What the calibration of heliostats offers: found by `heliogauge.instruments`."""

from heliogauge.instruments import Instrument, Kind

INSTRUMENT = Instrument(
    name="heliostat",
    summary="Where beams were seen and the drive readings -> tracking models.",
    commands="calibration.heliostat.cli:app",
    kinds=(
        Kind(
            name="heliostat",
            model="calibration.heliostat.keys:HeliostatModel",
            load="calibration.heliostat.keys:load_heliostat",
            template="calibration.heliostat:template.toml",
            command="heliostat measure",
            run_into="calibration.heliostat.pipeline.field:run_into",
            options="calibration.heliostat.pipeline.measure:Options",
            check="calibration.heliostat.pipeline.check:find_faults",
            recognises="calibration.heliostat.keys:paint_measurement",
        ),
        Kind(
            name="heliostat-tests",
            model="calibration.heliostat.performance.keys:HeliostatTestsModel",
            load="calibration.heliostat.performance.keys:load_tests",
            template="calibration.heliostat.performance:template.toml",
            command="heliostat test all",
            init_option="--tests",
            init_help="Write one for tests and the data sheet of a heliostat.",
            run="calibration.heliostat.performance.pipeline.run_tests:run",
            options="calibration.heliostat.performance.pipeline.run_tests:Options",
        ),
    ),
    reports={
        "heliostat": "calibration.heliostat.report:report.ipynb",
        "heliostat-field": "calibration.heliostat.report:report_field.ipynb",
        "heliostat-tests": "calibration.heliostat.performance.report:report.ipynb",
    },
    synth="data_synth.preset_folders:heliostat",
    synth_command="data_synth.cli:heliostat",
)
