"""What photogrammetry offers: found by `heliogauge.instruments`."""

from heliogauge.instruments import Instrument, Kind

INSTRUMENT = Instrument(
    name="photogrammetry",
    summary="Photos of coded targets -> coordinates.",
    commands="photogrammetry.cli:app",
    kinds=(
        Kind(
            name="photogrammetry",
            model="photogrammetry.keys.measurement:PhotogrammetryModel",
            load="photogrammetry.keys.load:load_photogrammetry",
            template="photogrammetry:template.toml",
            command="photogrammetry measure",
            run="photogrammetry.pipeline.measure:run",
            options="photogrammetry.pipeline.measure:Options",
            check="photogrammetry.pipeline.check:find_faults",
        ),
        Kind(
            name="photogrammetry-plan",
            model="photogrammetry.planning.keys:PhotogrammetryPlanModel",
            load="photogrammetry.planning.keys:load_photogrammetry_plan",
            template="photogrammetry.planning:template.toml",
            command="photogrammetry plan",
            init_option="--plan",
            init_help="For a plan of a measurement, made before it, instead of a measurement.",
            run="photogrammetry.planning.plan:run",
        ),
    ),
    reports={
        "photogrammetry": "photogrammetry.report:report.ipynb",
        "photogrammetry-plan": "photogrammetry.report:report_plan.ipynb",
        "photogrammetry-targets": "photogrammetry.report:report_targets.ipynb",
    },
    synth="data_synth.preset_folders:photogrammetry",
    synth_command="data_synth.cli:photogrammetry",
)
