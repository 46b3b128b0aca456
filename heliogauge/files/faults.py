"""What goes wrong while the content of a file is taken apart is the file's fault, and says so."""

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
        text = f"lacks {error}" if isinstance(error, KeyError) else str(error)[:200] or type(error).__name__
        raise InputError(f"{path}: damaged or changed by hand ({text}); {needed} is needed") from error
