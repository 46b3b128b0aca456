"""Writes printable sheets in true scale: sheets.pdf, one SVG per page, and a table of the codes."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from heliogauge.results.tables import write_table_csv
from heliogauge.results.whole_folder import FolderKind, WholeFolder
from photogrammetry.targets.ring_codes import RingCode
from photogrammetry.targets.vector_page import Page, to_pdf, to_svg

PDF_FILE = "sheets.pdf"
CODES_FILE = "codes.csv"
SHEETS = FolderKind(content="target sheets", mark=PDF_FILE, strangers=frozenset({"measurement.toml"}))


def write_sheets(
    folder: Path, pages: Sequence[Page], codes: Sequence[RingCode] = (), *, svg: bool = True, force: bool = False
) -> None:
    """Write pages into a folder that is whole or not there.

    folder: Where to write; must be absent or empty.
    codes: Codes to list in ``codes.csv``: number, word, bits.
    svg: Write each page as SVG too.
    force: Replace earlier sheets.
    InputError: The folder holds something, or cannot be written to.
    """
    with WholeFolder(folder, SHEETS, force=force) as working:
        (working / PDF_FILE).write_bytes(to_pdf(pages))
        if svg:
            for number, page in enumerate(pages, start=1):
                (working / f"sheet_{number:02d}.svg").write_text(to_svg(page), encoding="utf-8")
        if codes:
            write_table_csv(working / CODES_FILE, code_table(codes))


def code_table(codes: Sequence[RingCode]) -> Mapping[str, Sequence[Any]]:
    """Return the table of names, words and bits.

    Returns: Columns; the bits stand clockwise from 3 o'clock, 1 is ink.
    """
    return {
        "target": [code.name for code in codes],
        "word": [code.word for code in codes],
        "bits_clockwise": ["".join("01"[ink] for ink in code.sectors) for code in codes],
    }
