"""What goes wrong while the content of a file is taken apart is the file's fault, and says so."""

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from heliogauge.errors import InputError

#: What Python raises where content is of another kind, length or size than it should be.
CONTENT_FAULTS = (
    KeyError,
    TypeError,
    ValueError,
    IndexError,
    AttributeError,
    ArithmeticError,
    RecursionError,
)


@contextmanager
def explain_faults(path: Path, needed: str) -> Iterator[None]:
    """Turn what taking the content of a file apart raises into a message that names the file.

    needed: What the file should be.
    InputError: One of `CONTENT_FAULTS` was raised in the ``with``.
    """
    try:
        yield
    except CONTENT_FAULTS as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        text = f"{type(error).__name__}: {str(error)[:200]}, {Path(last.filename).name}:{last.lineno}"
        raise InputError(
            f"{path}: damaged or changed by hand ({text}); {needed} is needed. If nobody changed it, report these words"
        ) from error
