"""Sections of the report of a prescription; each is one cell of its notebook."""

import base64
import html
from dataclasses import dataclass
from pathlib import Path

from heliogauge.reporting import page
from heliogauge.reporting.html import Html, join
from heliogauge.results.folder import Summary, read_summary, read_table_csv
from observer.files import ALIGNMENT_MOVES, ALIGNMENT_OVERLAY
from observer.report.lines import listed
from observer.report.results import Columns


@dataclass(frozen=True, slots=True, eq=False)
class AlignmentResults:
    """What a folder with a prescription holds."""

    folder: Path
    summary: Summary
    panels: Columns
    mounts: Columns


def open_alignment(folder: str | Path = ".") -> AlignmentResults:
    """Read a folder with a prescription.

    folder: The folder; the working directory without it.
    """
    folder = Path(folder)
    tables = (read_table_csv(folder / name) for name in ("panels.csv", "mounts.csv"))
    return AlignmentResults(folder, read_summary(folder), *tables)


def head(results: AlignmentResults) -> Html:
    """Return title and warnings."""
    return page.head(results, f"prescription for {len(results.panels['panel'])} panels")


def moves(results: AlignmentResults) -> Html:
    """Return how far each mount is to be moved."""
    note = (
        "Moves along the mirror's normal, positive towards the absorber; a panel turns about its middle. Colours: mean "
        "theta_ra of each panel, positive where its normal is turned towards +x. Grey: less than half of the panel is "
        "measured. In mounts.csv move_to_design is for the design's focal line instead of the absorber as it is."
    )
    folded = f"<details><summary>{len(results.mounts['panel'])} mounts</summary>{listed(results.mounts).text}</details>"
    return join(_image(results.folder / ALIGNMENT_MOVES, note), listed(results.panels), Html(folded))


def overlay(results: AlignmentResults) -> Html:
    """Return the theoretical image of the absorber over a photo."""
    note = (
        "In a well-aligned collector the dark band would lie between the dashed lines; panel by panel it is moved "
        "aside. overlay.csv has the corners for every photo."
    )
    path = results.folder / ALIGNMENT_OVERLAY
    return _image(path, note) if path.is_file() else Html("<p>The result holds no photo.</p>")


def making(results: AlignmentResults) -> Html:
    """Return the input files."""
    return page.input_table(results)


def _image(path: Path, note: str) -> Html:
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    image = (
        f'<figure class="wide"><img alt="{html.escape(note, quote=True)}" src="data:image/png;base64,{data}"></figure>'
    )
    return Html(f'<div class="figures">{image}</div><p class="caption">{html.escape(note)}</p>')
