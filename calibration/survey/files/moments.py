"""Days and times as they are written: one strict form, within the years of photography."""

import re
from datetime import UTC, datetime

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError

#: First moment, and first moment beyond, of dates that can be meant. No mirror of a plant was measured before 1900 or
#: is after 2099; a year outside is a slip of the pen (20260101 is a year to other programs), or a clock that was never
#: set.
FIRST, BEYOND = np.datetime64("1900-01-01", "us"), np.datetime64("2100-01-01", "us")
_POSSIBLE = "days from 1900-01-01 to 2099-12-31 can be meant"
_FORM = re.compile(r"\d{4}-\d{2}-\d{2}(?:[T ]\d{2}:\d{2}(?::\d{2}(?:\.\d+)?)?(?:Z|[+-]\d{2}:\d{2})?)?", re.ASCII)


def read_moment(text: str, where: str) -> np.datetime64:
    """Read a day (its beginning) or a time; without a zone it is UTC. Of a span ("A to B") its end counts.

    where: What says it, for messages.
    InputError: No date, or none that can be meant.

    >>> read_moment("2026-06-01 to 2026-06-21", "summary.json")
    np.datetime64('2026-06-21T00:00:00.000000')
    """
    last = text.rsplit(" to ", maxsplit=1)[-1].strip()
    try:
        if not _FORM.fullmatch(last):
            raise ValueError
        parsed = datetime.fromisoformat(last)
    except ValueError:
        raise InputError(f"{where}: date {last!r:.60}: a day such as 2026-06-21 is needed") from None
    try:
        local = parsed.astimezone(UTC) if parsed.tzinfo else parsed
    except OverflowError:
        raise InputError(f"{where}: date {last!r}: {_POSSIBLE}") from None
    moment = np.datetime64(local.replace(tzinfo=None), "us")
    refuse_impossible(np.array([moment]), f"{where}: date {last!r}")
    return moment


def read_day(text: str, where: str) -> np.datetime64:
    """Read a day.

    where: What says it, for messages.
    InputError: No day, or none that can be meant.
    """
    if len(text.strip()) != len("2026-06-21"):
        raise InputError(f"{where}: date {text!r:.60}: a day such as 2026-06-21 is needed")
    read_moment(text, where)
    return np.datetime64(text.strip(), "D")


def refuse_impossible(times: npt.NDArray[np.datetime64], where: str) -> None:
    """Refuse times that cannot be meant.

    times (n,): Times.
    where: What says them, for messages.
    InputError: One is missing, before 1900 or after 2099.
    """
    if not np.all((times >= FIRST) & (times < BEYOND)):
        raise InputError(f"{where}: {_POSSIBLE}")
