"""Texts in cells of CSV that a spreadsheet would compute: behind an apostrophe in the file, plain in the program."""

import re

# What a spreadsheet computes when it opens a CSV file, behind apostrophes or not; and numbers, which begin alike.
_FORMULA = re.compile(r"'*[=+\-@\t\r]")
_NUMBER = re.compile(r"[+-]?(?:(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?|inf|nan)", re.IGNORECASE)


def guarded_cell(text: str) -> str:
    """Return a text as it stands in a cell of CSV: behind an apostrophe where a spreadsheet would compute it.

    A name such as ``=cmd|...`` comes from a file of somebody else, and whoever opens the table would run it.

    >>> guarded_cell("=1+1"), guarded_cell("-12"), guarded_cell("-A7"), guarded_cell("'-A7")
    ("'=1+1", '-12', "'-A7", "''-A7")
    """
    return f"'{text}" if _FORMULA.match(text) and not _NUMBER.fullmatch(text) else text


def plain_cell(cell: str) -> str:
    """Return the text of which `guarded_cell` made a cell.

    >>> plain_cell("'=1+1"), plain_cell("-12"), plain_cell("''-A7"), plain_cell("'quoted'")
    ('=1+1', '-12', "'-A7", "'quoted'")
    """
    return cell[1:] if cell.startswith("'") and _FORMULA.match(cell) else cell
