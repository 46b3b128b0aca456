"""``heliogauge survey``: results of many days and heliostats in one store, its report, what was done to whom."""

from pathlib import Path
from typing import Annotated

import typer

from heliogauge.running.commands import Job, OutFolder, Quiet, Verbose, make_app, writes_results

app = make_app("Results of many days, heliostats and facets -> one store, trends, the worst.")

#: Results that are in the store already and are named without --verbose.
_MOST_NOTES = 20

StoreFolder = Annotated[Path, typer.Argument(metavar="STORE", help="Folder of the store.", show_default=False)]


@app.command("add")
def add_command(
    results: Annotated[
        list[Path],
        typer.Argument(metavar="RESULT...", help="Folders of results, or folders of such folders.", show_default=False),
    ],
    to: Annotated[
        Path, typer.Option("--to", metavar="STORE", help="The store; made where absent.", show_default=False)
    ],
    date: Annotated[
        str | None, typer.Option(metavar="YYYY-MM-DD", help="Day of the measurement, where results do not say it.")
    ] = None,
    subject: Annotated[
        str | None, typer.Option(metavar="NAME", help="What was measured, where it is not the results' name.")
    ] = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Put results into a store, each once."""
    from calibration.survey.pipeline.add import AddOptions, add

    added = add(results, to, AddOptions(date, subject))
    for folder in added.known if verbose else added.known[:_MOST_NOTES]:
        typer.echo(f"note: {folder} is in the store already", err=True)
    if len(added.known) > _MOST_NOTES and not verbose:
        typer.echo(f"note: so are {len(added.known) - _MOST_NOTES} more (-v lists them)", err=True)
    if not quiet:
        typer.echo(f"{added.results} results, {added.rows} rows added to {to}")


@app.command("event")
def event_command(
    store: StoreFolder,
    subject: Annotated[str, typer.Option(metavar="NAME", help="To whom; * stands for any text.", show_default=False)],
    date: Annotated[str, typer.Option(metavar="YYYY-MM-DD", help="When.", show_default=False)],
    what: Annotated[str, typer.Option(metavar="WORDS", help="Such as cleaned, drive replaced.", show_default=False)],
    quiet: Quiet = False,
) -> None:
    """Note that something was done: reports compare before and after."""
    from calibration.survey.files.parquet_store import add_event

    add_event(store, subject, date, what)
    if not quiet:
        typer.echo(f"noted in {store}: {subject}, {date}, {what}")


@app.command("report")
@writes_results()
def report_command(
    store: StoreFolder,
    out: OutFolder,
    quantity: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Only this quantity; may be given several times.", show_default=False),
    ] = None,
    since: Annotated[str | None, typer.Option(metavar="YYYY-MM-DD", help="Only results from this day on.")] = None,
    until: Annotated[str | None, typer.Option(metavar="YYYY-MM-DD", help="Only results before this day.")] = None,
) -> Job:
    """Report trends, before and after what was done, the worst: CSV tables, summary.json, report.html."""
    from calibration.survey.pipeline.judge_store import SurveyOptions, run

    options = SurveyOptions(None if not quantity else tuple(quantity), since, until)
    return Job(out, lambda progress: run(store, options, progress))
