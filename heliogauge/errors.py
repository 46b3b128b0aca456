"""The errors every package raises: what went wrong, where, what to do, and the pictures that show why."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from typing import Any

#: Pictures of one failed run: enough to see what is wrong, few enough to look at.
MOST_PICTURES = 12


@dataclass(frozen=True, slots=True, eq=False)
class FailurePicture:
    """A picture that shows why something could not be measured.

    name: What it shows, such as the photo's name.
    image: Grey values of any depth, shape (height, width), or the bytes of a JPEG file.
    note: What was looked for in it and not found.
    size_px: Width and height of the photo that the points refer to, where `image` is a smaller one [px].
    points_px (n, 2): What was found, columns and rows [px].
    labels: Name of each point, and why it was not used; empty: none.
    lines_px: Lines such as an outline that was expected, shape (k, 2) each [px].
    """

    name: str
    image: Any
    note: str = ""
    size_px: tuple[int, int] | None = None
    points_px: Any = ()
    labels: Sequence[str] = ()
    lines_px: Sequence[Any] = ()


class MetrologyError(Exception):
    """Base of every error this software raises on purpose; the command line shows its message and exits with 2.

    pictures: What shows why; written beside the place of the results that could not be made.
    """

    pictures: tuple[FailurePicture, ...] = ()


@contextmanager
def showing(pictures: Callable[[], Iterable[FailurePicture]]) -> Iterator[None]:
    """Let errors of the work within carry pictures that show why, unless they carry some already.

    pictures: Called only after an error; the most telling first.
    """
    try:
        yield
    except MetrologyError as error:
        if not error.pictures:
            error.pictures = tuple(islice(pictures(), MOST_PICTURES))
        raise


class InputError(MetrologyError):
    """The caller's data are impossible: a missing file, a wrong shape, a unit or key that cannot be meant."""


class EstimationError(MetrologyError):
    """The data are valid but do not determine the answer; the message gives the numbers and the remedy."""


class SweptWarning(UserWarning):
    """What a killed run had left beside results was removed, or put back."""


class ReportWarning(UserWarning):
    """A report could not be made; the results it would have shown are complete on disk."""


class UnexplainedNumberWarning(UserWarning):
    """A summary says of a number that it is not determined, but not why: a fault of this software, not of the data."""


class NotConvergedError(EstimationError):
    """An adjustment ended where there is no minimum to the stated tolerance."""
