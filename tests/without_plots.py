"""What has only the core's libraries: no matplotlib, and nothing that comes with it."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

_NOT_IN_THE_CORE = ("matplotlib", "contourpy", "fontTools", "kiwisolver", "PIL", "pyparsing", "dateutil")


@contextmanager
def without_plots() -> Iterator[None]:
    """Let every import of matplotlib fail, as it does where the extra ``plots`` is not installed."""
    with pytest.MonkeyPatch.context() as patch:
        for name in (*_NOT_IN_THE_CORE, "heliogauge.reporting.canvas"):
            patch.setitem(sys.modules, name, None)
        yield
