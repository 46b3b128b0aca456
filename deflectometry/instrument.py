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
        Kind(
            name="slopes",
            model="deflectometry.exchange.measure_slopes:SlopesModel",
            load="deflectometry.exchange.measure_slopes:load_slopes",
            template="deflectometry.exchange:template_slopes.toml",
            command="deflectometry measure",
            init_option="--slopes",
            init_help="For slopes that were measured otherwise, instead of images of fringes.",
            run="deflectometry.exchange.measure_slopes:run",
        ),
        Kind(
            name="deflectometry-dots",
            model="deflectometry.dots.keys:DotsModel",
            load="deflectometry.dots.keys:load_dots",
            template="deflectometry.dots:template_dots.toml",
            command="deflectometry measure",
            init_option="--dots",
            init_help="For a photo of a field of dots, instead of images of fringes.",
            run="deflectometry.dots.pipeline.measure:run",
            options="deflectometry.pipeline.choices:Options",
            check="deflectometry.dots.pipeline.check:find_faults",
        ),
        Kind(
            name="deflectometry-poses",
            model="deflectometry.poses.keys:PosesModel",
            load="deflectometry.poses.keys:load_poses",
            template="deflectometry.poses:template_poses.toml",
            command="deflectometry measure",
            init_option="--poses",
            init_help="For one mirror in several poses, which determine camera and screen.",
            run="deflectometry.poses.pipeline.measure:run",
            options="deflectometry.pipeline.choices:Options",
            check="deflectometry.poses.pipeline.check:find_faults",
        ),
    ),
    synth="data_synth.preset_folders:deflectometry",
    synth_command="data_synth.cli:deflectometry",
    reports={
        "deflectometry": "deflectometry.report:report.ipynb",
        "slopes": "deflectometry.report:report_slopes.ipynb",
        "deflectometry-poses": "deflectometry.report:report_poses.ipynb",
    },
)
