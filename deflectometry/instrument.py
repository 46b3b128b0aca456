"""What deflectometry offers: found by `heliogauge.instruments`."""

from heliogauge.instruments import Commands, Instrument, Kind

INSTRUMENT = Instrument(
    name="deflectometry",
    summary="Fringe images of a mirror -> slope map.",
    commands=Commands(
        "deflectometry",
        "deflectometry.cli:app",
        "Fringe images of a mirror -> slope map (and patterns, import-opencsp).",
    ),
    kinds=(
        Kind(
            name="deflectometry",
            model="deflectometry.keys:DeflectometryModel",
            load="deflectometry.keys:load_deflectometry",
            template="deflectometry:template.toml",
            command="deflectometry",
            run="deflectometry.pipeline.measure:run",
            options="deflectometry.pipeline.choices:Options",
        ),
    ),
    reports={"deflectometry": "deflectometry:report.ipynb"},
    synth="data_synth.preset_folders:fringes",
)
