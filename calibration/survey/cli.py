"""``heliogauge survey``: results of many days and heliostats in one store, its report, what was done to whom."""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from heliogauge.running.commands import Job, OutFolder, Quiet, make_app, writes_results

if TYPE_CHECKING:
    from calibration.survey.files.manifest import Entry

app = make_app("Results of many days, heliostats and facets -> one store, trends, the worst.")

#: Lines of one kind that are written without --verbose.
_MOST_NOTES = 20
#: Digits of a result's name that people see; 2^48 names.
_SHOWN_DIGITS = 12

StoreFolder = Annotated[Path, typer.Argument(metavar="STORE", help="Folder of the store.", show_default=False)]
AsJson = Annotated[bool, typer.Option("--json", help="Print what came of it as JSON, and nothing else there.")]
NameEvery = Annotated[bool, typer.Option("-v", "--verbose", help="Name every result.")]


@app.command("add")
def add_command(
    results: Annotated[
        list[Path],
        typer.Argument(
            metavar="RESULT...",
            help="Folders of results, or folders of such folders; a store of an earlier version.",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path,
        typer.Option("-o", "--out", "--to", metavar="STORE", help="The store; made where absent.", show_default=False),
    ],
    date: Annotated[
        str | None, typer.Option(metavar="YYYY-MM-DD", help="Day of the measurement, where results do not say it.")
    ] = None,
    subject: Annotated[
        str | None, typer.Option(metavar="NAME", help="What was measured, where it is not the results' name.")
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace earlier evaluations of the same measurements.")
    ] = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
    verbose: NameEvery = False,
) -> None:
    """Put results into a store, each once and whole."""
    from calibration.survey.pipeline.add import AddOptions, add
    from heliogauge.running.terminal import terminal_progress

    added = add(results, out, AddOptions(date, subject, force), terminal_progress(quiet=quiet, verbose=False))
    advice = "the later folder of this command is kept" if force else "--force puts this evaluation in its place"
    warnings = [f"left out: {reason}" for _, reason in added.left_out]
    warnings += [
        f"{folder}: the same measurement is in the store as {name[:_SHOWN_DIGITS]} with other numbers and counts "
        f"once; {advice}"
        for folder, name in added.again
    ]
    advice = advice if force else "--force puts it under the new subject and date"
    warnings += [
        f"{folder}: the same measurement is in the store as {name[:_SHOWN_DIGITS]} with the same numbers, under "
        f"{words}, and counts once; {advice}"
        for folder, name, words in added.elsewhere
    ]
    _say("warning", warnings, verbose=verbose)
    if as_json:
        _print_json(
            {
                "store": str(out),
                "results_count": added.results,
                "rows_count": added.rows,
                "added": [{"folder": str(folder), "result": name} for folder, name in added.added],
                "replaced": [{"folder": str(folder), "result": name} for folder, name in added.replaced],
                "known": [str(folder) for folder in added.known],
                "same_measurement": [{"folder": str(folder), "result": name} for folder, name in added.again],
                "other_subject_or_date": [
                    {"folder": str(folder), "result": name, "there": words} for folder, name, words in added.elsewhere
                ],
                "left_out": [{"folder": str(folder), "reason": reason} for folder, reason in added.left_out],
            }
        )
    if as_json or quiet:
        return
    _say("note", [f"{folder} is in the store already" for folder in added.known], verbose=verbose)
    replaced = dict(added.replaced)
    for folder, name in added.added if verbose else ():
        instead = f", in the place of {replaced[folder][:_SHOWN_DIGITS]}" if folder in replaced else ""
        typer.echo(f"{name[:_SHOWN_DIGITS]} {folder}{instead}")
    others = {
        "replaced": len(added.replaced),
        "known already": len(added.known),
        "in the store with other numbers": len(added.again),
        "in the store under another subject or date": len(added.elsewhere),
        "left out": len(added.left_out),
    }
    more = "".join(f"; {count} {words}" for words, count in others.items() if count)
    typer.echo(f"{_counted(added.results, 'result')}, {_counted(added.rows, 'row')} added to {out}{more}")


@app.command("event")
def event_command(
    store: StoreFolder,
    subject: Annotated[str, typer.Option(metavar="NAME", help="To whom; * stands for any text.", show_default=False)],
    date: Annotated[str, typer.Option(metavar="YYYY-MM-DD", help="When.", show_default=False)],
    what: Annotated[str, typer.Option(metavar="WORDS", help="Such as cleaned, drive replaced.", show_default=False)],
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Note that something was done: reports compare before and after."""
    from calibration.survey.pipeline.keep_store import add_event, subjects_meant
    from heliogauge.errors import InputError
    from heliogauge.instruments import near_match

    is_new = add_event(store, subject, date, what)
    meant: list[str] | None = None
    try:
        known, meant = subjects_meant(store, subject)
    except InputError as error:
        typer.echo(f"warning: noted, but whether a result is of {subject!r} cannot be told: {error}", err=True)
    if meant == []:
        near = f"; {near_match(subject, known)}" if known else ""
        typer.echo(f"warning: no subject of {store} is called {subject!r}: the event says nothing yet{near}", err=True)
    if as_json:
        _print_json(
            {
                "store": str(store),
                "subject": subject,
                "date": date,
                "what": what,
                "is_new": is_new,
                "subjects_count": None if meant is None else len(meant),
            }
        )
    elif not quiet:
        typer.echo(f"{'noted' if is_new else 'noted already'} in {store}: {subject}, {date}, {what}")


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


@app.command("check")
def check_command(
    store: StoreFolder,
    as_json: AsJson = False,
    quiet: Quiet = False,
    verbose: NameEvery = False,
) -> None:
    """Compare a store with its manifest: files, rows, events; exit code 2 where something is wrong."""
    from calibration.survey.pipeline.keep_store import check

    found = check(store)
    if as_json:
        _print_json(
            {
                "store": str(store),
                "results_count": len(found.entries),
                "rows_count": found.rows,
                "files_count": found.files,
                "events_count": found.events,
                "faults": list(found.faults),
                "notes": list(found.notes),
                "results": [
                    {
                        "result": one.result,
                        "subject": one.subject,
                        "kind": one.kind,
                        "source": one.source,
                        "rows_count": one.rows,
                        "file": file,
                    }
                    for file, one in found.entries
                ],
            }
        )
    elif not quiet:
        for _, one in found.entries if verbose else ():
            typer.echo(_line(one))
        typer.echo(
            f"{store}: {_counted(len(found.entries), 'result')}, {_counted(found.rows, 'row')}, "
            f"{_counted(found.files, 'file')}, {_counted(found.events, 'event')}; "
            + ("as they were written" if not found.faults else _counted(len(found.faults), "fault"))
        )
    _say("fault", found.faults, verbose=True)
    if not quiet:
        _say("note", found.notes, verbose=verbose)
    if found.faults:
        raise typer.Exit(2)


@app.command("remove")
def remove_command(
    store: StoreFolder,
    results: Annotated[
        list[str],
        typer.Argument(
            metavar="RESULT...",
            help="Results as `survey check -v` lists them (six digits or more), or a file of rows with all in it.",
            show_default=False,
        ),
    ],
    as_json: AsJson = False,
    quiet: Quiet = False,
    verbose: NameEvery = False,
) -> None:
    """Take results out of a store."""
    from calibration.survey.pipeline.keep_store import remove
    from heliogauge.running.terminal import terminal_progress

    gone = remove(store, results, terminal_progress(quiet=quiet, verbose=False))
    rows = sum(one.rows for one in gone)
    if as_json:
        removed = [{"result": one.result, "subject": one.subject, "source": one.source} for one in gone]
        _print_json({"store": str(store), "results_count": len(gone), "rows_count": rows, "removed": removed})
    elif not quiet:
        for one in gone if verbose else ():
            typer.echo(_line(one))
        typer.echo(f"{_counted(len(gone), 'result')}, {_counted(rows, 'row')} removed from {store}")


def _line(one: "Entry") -> str:
    return f"{one.result[:_SHOWN_DIGITS]}  {one.subject}  {one.kind}  {one.source}  {_counted(one.rows, 'row')}"


def _counted(count: int, word: str) -> str:
    """Return a number with its noun: 1 row, 2 rows."""
    return f"{count} {word}" if count == 1 else f"{count} {word}s"


def _say(word: str, lines: Iterable[str], *, verbose: bool) -> None:
    """Write lines of one kind on standard error, without --verbose not all of very many."""
    every = list(lines)
    for line in every if verbose else every[:_MOST_NOTES]:
        typer.echo(f"{word}: {line}", err=True)
    if len(every) > _MOST_NOTES and not verbose:
        typer.echo(f"{word}: and {len(every) - _MOST_NOTES} more (-v lists them)", err=True)


def _print_json(content: Mapping[str, Any]) -> None:
    typer.echo(json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False))
