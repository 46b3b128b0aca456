"""Make the report of a folder of results: one page that needs nothing else, and the notebook that made it.

The notebook is package data of the instrument that measured (`heliogauge.instruments`). Its cells run in this process;
only the numbers in the folder enter it.
"""

import os
from pathlib import Path

from heliogauge.errors import InputError
from heliogauge.files.faults import explain_faults
from heliogauge.files.own_folder import refuse_links_out
from heliogauge.instruments import every_report, read_resource
from heliogauge.reporting.html import FirstScreen, Shown
from heliogauge.reporting.notebook import Notebook, read_notebook
from heliogauge.reporting.page_frame import page_frame
from heliogauge.results.folder import SUMMARY_FILE, Summary, read_summary, what_instead
from heliogauge.view.arrays import PAGE, ArrayStore

_NEEDED = "a folder of results as heliogauge wrote it"
REPORT_HTML = "report.html"
REPORT_NOTEBOOK = "report.ipynb"


def build_report(folder: Path) -> Path:
    """Write ``report.html``, and ``report.ipynb`` with its outputs, from the results in a folder.

    InputError: No results in the folder, results of a kind without a report, a file of results that is missing or
        damaged, a link that leads out of the folder, or the folder cannot be written to.
    """
    folder = folder.resolve()
    refuse_links_out(folder)
    summary, notebook = run_report(folder, PAGE)
    page = page_frame(f"{summary.name} - {summary.kind} report", notebook.shown)
    try:
        _replace(folder / REPORT_NOTEBOOK, notebook.text())
        _replace(folder / REPORT_HTML, page)
    except OSError as error:
        raise InputError(f"{folder}: the report cannot be written ({error.strerror or error})") from error
    return folder / REPORT_HTML


def run_report(folder: Path, store: ArrayStore) -> tuple[Summary, Notebook]:
    """Run the report of a folder of results without writing anything.

    store: Takes the numbers of the views.
    InputError: No results in the folder, results of a kind without a report, or a file is missing or damaged.
    """
    summary, notebook = _open(folder)
    try:
        with explain_faults(folder, _NEEDED):
            notebook.run(folder, store)
    except InputError as error:
        raise InputError(f"{folder}: no report can be made: {error}") from error
    return summary, notebook


def first_picture(folder: Path) -> Shown | None:
    """Return what the report of a folder of results shows first: a view or pictures; None where it shows no picture.

    InputError: No results in the folder, results of a kind without a report, or a file is missing or damaged.
    """
    _, notebook = _open(folder)
    with explain_faults(folder, _NEEDED):
        for _, value in notebook.values(folder):
            if isinstance(value, FirstScreen):
                return value.picture
    return None


def refuse_without_report(folder: Path) -> Summary:
    """Refuse a folder of which there can be no report.

    Returns: Its summary.
    InputError: No results in the folder, or results of a kind without a report.
    """
    if not (folder / SUMMARY_FILE).is_file():
        raise InputError(f"{folder}: {what_instead(folder)}")
    summary = read_summary(folder / SUMMARY_FILE)
    if summary.kind not in every_report():
        files = ", ".join(sorted(one.name for one in folder.iterdir() if not one.name.startswith(".")))
        raise InputError(f"{folder}: results of the kind {summary.kind!r} have no report; all of them is in {files}")
    return summary


def _open(folder: Path) -> tuple[Summary, Notebook]:
    summary = refuse_without_report(folder)
    return summary, read_notebook(read_resource(every_report()[summary.kind]))


def _replace(path: Path, text: str) -> None:
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        partial.write_text(text, encoding="utf-8")
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
