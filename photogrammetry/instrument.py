"""What photogrammetry offers: found by `heliogauge.instruments`."""

from heliogauge.instruments import Commands, Instrument, Kind

INSTRUMENT = Instrument(
    name="photogrammetry",
    summary="Photos of coded targets -> coordinates.",
    commands=Commands(
        "photogrammetry",
        "photogrammetry.cli:app",
        "Photos of coded targets -> coordinates (and sheets to print).",
    ),
    kinds=(
        Kind(
            name="photogrammetry",
            model="photogrammetry.keys.measurement:PhotogrammetryModel",
            load="photogrammetry.keys.load:load_photogrammetry",
            template="photogrammetry:template.toml",
            command="photogrammetry",
            run="photogrammetry.pipeline.measure:run",
            options="photogrammetry.pipeline.measure:Options",
        ),
        Kind(
            name="photogrammetry-plan",
            model="photogrammetry.planning.keys:PhotogrammetryPlanModel",
            load="photogrammetry.planning.keys:load_photogrammetry_plan",
            template="photogrammetry.planning:template.toml",
            command="photogrammetry plan",
            run="photogrammetry.planning.plan:run",
        ),
    ),
    reports={
        "photogrammetry": "photogrammetry.report:report.ipynb",
        "photogrammetry-plan": "photogrammetry.report:report_plan.ipynb",
    },
    synth="data_synth.preset_folders:targets",
)
