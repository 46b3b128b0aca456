"""Texts in cells of CSV that a spreadsheet would compute: behind an apostrophe in the file, plain in the program."""

import re

# What a spreadsheet computes when it opens a CSV file, behind apostrophes or not; and numbers, which begin alike. The
# signs of full width are those of Chinese and Japanese keyboards.
_SIGNS = r"=+\-@\uFF1D\uFF0B\uFF0D\uFF20"
_FORMULA = re.compile(rf"'*[{_SIGNS}\t\r\n]")
_PATTERN = r"[+-]?(?:(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?|inf|nan)"
_NUMBER = re.compile(_PATTERN, re.IGNORECASE)
# Where another cell begins for a spreadsheet whose separator is no comma, as in most of Europe: quotes do not stop it.
_BEGIN = r"(?<=[;\t\r\n])"
_INNER = re.compile(rf"{_BEGIN}(?!{_PATTERN}(?:[;\t\r\n]|\Z))('*[{_SIGNS}])", re.IGNORECASE)
_GUARDED = re.compile(rf"{_BEGIN}'('*[{_SIGNS}])")


def guarded_cell(text: str) -> str:
    """Return a text as it stands in a cell of CSV: behind an apostrophe where a spreadsheet would compute it.

    A name such as ``=cmd|...`` comes from a file of somebody else, and whoever opens the table would run it.

    >>> guarded_cell("=1+1"), guarded_cell("-12"), guarded_cell("-A7"), guarded_cell("'-A7")
    ("'=1+1", '-12', "'-A7", "''-A7")
    """
    is_formula = _FORMULA.match(text) and not _NUMBER.fullmatch(text)
    inner = _INNER.sub(r"'\1", text)
    return f"'{inner}" if is_formula else inner


def plain_cell(cell: str) -> str:
    """Return the text of which `guarded_cell` made a cell.

    >>> plain_cell("'=1+1"), plain_cell("-12"), plain_cell("''-A7"), plain_cell("'quoted'")
    ('=1+1', '-12', "'-A7", "'quoted'")
    """
    if "'" not in cell:
        return cell
    return _GUARDED.sub(r"\1", cell[1:] if cell.startswith("'") and _FORMULA.match(cell) else cell)
