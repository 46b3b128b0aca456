"""When photos were taken, and times in tables: both as seconds, in whatever clock they were read."""

from datetime import datetime
from pathlib import Path

from heliogauge.errors import InputError
from heliogauge.files.regular import open_regular
from heliogauge.images.exif import EXIF_BYTES, time_taken

#: Times in tables, as in the EXIF block of photos or as databases write them.
_PATTERNS = (
    "%Y-%m-%d %H:%M:%S.%f",
    "%Y-%m-%d %H:%M:%S",
    "%Y-%m-%dT%H:%M:%S.%f",
    "%Y-%m-%dT%H:%M:%S",
    "%Y:%m:%d %H:%M:%S",
)
_BEGIN = datetime(1970, 1, 1)
#: What is cut off a time of whole seconds is anywhere in one.
WHOLE_SECOND_S = 12**-0.5


def seconds_of(cell: str, where: str) -> float:
    """Return a time in seconds.

    where: Where it stands, for the message.
    InputError: It is no time.
    """
    for pattern in _PATTERNS:
        try:
            return (datetime.strptime(cell, pattern) - _BEGIN).total_seconds()
        except ValueError:
            continue
    raise InputError(f"{where}: {cell!r} is not a time like 2026-05-04 10:31:07")


def photo_time_s(file: Path) -> tuple[float, float] | None:
    """Return when a photo was taken by its EXIF block, and how well that says it; None where it does not.

    Times are cut off to whole seconds, unless the file says their fractions: half a second is added to the former.

    InputError: The file cannot be read.
    """
    with open_regular(file) as stream:
        text = time_taken(stream.read(EXIF_BYTES))
    if text is None:
        return None
    seconds = seconds_of(text, file.name)
    return (seconds, 0.0) if "." in text else (seconds + 0.5, WHOLE_SECOND_S)
