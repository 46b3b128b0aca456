"""What the measurement of beams offers: found by `heliogauge.instruments`."""

from heliogauge.instruments import Instrument, Kind

INSTRUMENT = Instrument(
    name="beam",
    summary="Photos of beams on a target -> centres, sizes, flux.",
    commands="calibration.beam.cli:app",
    kinds=(
        Kind(
            name="beam",
            model="calibration.beam.keys:BeamModel",
            load="calibration.beam.keys:load_beams",
            template="calibration.beam:template.toml",
            command="beam measure",
            run="calibration.beam.pipeline.measure:run",
            options="calibration.beam.pipeline.measure:Options",
            recognises="calibration.beam.keys:paint_beams",
        ),
    ),
    reports={
        "beam": "calibration.beam.report:report.ipynb",
        "beam-mirror": "calibration.beam.report:report_mirror.ipynb",
    },
    synth="data_synth.preset_folders:beam",
    synth_command="data_synth.cli:beam",
)
