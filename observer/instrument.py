"""What the Observer offers: found by `heliogauge.instruments`."""

from heliogauge.instruments import Instrument, Kind

INSTRUMENT = Instrument(
    name="observer",
    summary="Photos of a trough's absorber reflection -> slope errors, absorber.",
    commands="observer.cli:app",
    kinds=(
        Kind(
            name="observer",
            model="observer.keys:ObserverModel",
            load="observer.keys:load_observer",
            template="observer:template.toml",
            command="observer measure",
            run_into="observer.pipeline.measure_folder:run_into",
            options="observer.pipeline.measure:Options",
            check="observer.pipeline.check:find_faults",
        ),
        Kind(
            name="observer-plan",
            model="observer.planning.keys:ObserverPlanModel",
            load="observer.planning.keys:load_observer_plan",
            template="observer.planning:template.toml",
            command="observer plan",
            init_option="--plan",
            init_help="For a plan of a measurement, made before it, instead of a measurement.",
            run="observer.planning.plan:run",
        ),
    ),
    reports={
        "observer": "observer.report:report.ipynb",
        "observer-absorber": "observer.report:report_absorber.ipynb",
        "observer-alignment": "observer.report:report_alignment.ipynb",
        "observer-compare": "observer.report:report_compare.ipynb",
        "observer-compare-fields": "observer.report:report_compare_fields.ipynb",
        "observer-overview": "observer.report:report_overview.ipynb",
        "observer-plan": "observer.report:report_plan.ipynb",
    },
    synth="data_synth.preset_folders:observer",
    synth_command="data_synth.cli:observer",
)
