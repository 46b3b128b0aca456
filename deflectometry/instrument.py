"""What deflectometry offers: found by `heliogauge.instruments`."""

from heliogauge.instruments import Instrument, Kind

INSTRUMENT = Instrument(
    name="deflectometry",
    summary="Fringe images of a mirror -> slope map.",
    commands="deflectometry.cli:app",
    kinds=(
        Kind(
            name="deflectometry",
            model="deflectometry.keys:DeflectometryModel",
            load="deflectometry.keys:load_deflectometry",
            template="deflectometry:template.toml",
            command="deflectometry measure",
            run="deflectometry.pipeline.measure:run",
            options="deflectometry.pipeline.choices:Options",
            check="deflectometry.pipeline.check:find_faults",
        ),
    ),
    synth="data_synth.preset_folders:deflectometry",
    synth_command="data_synth.cli:deflectometry",
    reports={"deflectometry": "deflectometry.report:report.ipynb"},
)
