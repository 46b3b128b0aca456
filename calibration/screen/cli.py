"""``heliogauge screen``: photographs of grey levels to the response of camera and display."""

from heliogauge.running.commands import Job, Jobs, MeasurementFolder, OutFolder, make_app, writes_results

app = make_app("Photographs of uniform grey levels -> response of camera and display.")


@app.command("measure")
@writes_results()
def measure_command(
    folder: MeasurementFolder,
    out: OutFolder,
    jobs: Jobs = None,
) -> Job:
    """Evaluate photographs of uniform grey levels: response.csv, summary.json, report.html."""
    from calibration.screen.keys import load_response
    from calibration.screen.pipeline import Options, run
    from heliogauge.errors import InputError

    if out.suffix == ".csv":
        raise InputError(f"--out {out}: give a folder, such as {out.with_suffix('')}; response.csv is written into it")
    return Job(
        out,
        lambda progress: run(load_response(folder), Options(jobs=jobs), progress),
        hint="; use it with response_file in [screen] of measurement.toml",
    )
