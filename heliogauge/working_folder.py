"""Keep Python from importing modules out of the folder that a command is called in: there lie data, not programs.

``python -m heliogauge`` puts the working folder in front of all others, and a ``PYTHONPATH`` that ends with a colon
adds it, too; a ``numpy.py`` or ``struct.py`` among results would be executed.
"""

import os
import sys

_HOME = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
_COMMAND = ("heliogauge", "heliogauge.exe", "heliogauge-script.py")


def paths_without_working_folder() -> list[str]:
    """Return where Python looks for modules, without the working folder unless heliogauge itself stands there."""
    try:
        here = os.path.realpath(os.getcwd())
    except OSError:
        # It was removed: nothing is in it.
        return [path for path in sys.path if path]
    return [path or here for path in sys.path if os.path.realpath(path or here) != here or here == _HOME]


def forget_working_folder() -> None:
    """Take the working folder out of the search for modules where heliogauge was called as a command."""
    called = sys.argv[0] if getattr(sys, "argv", None) else ""
    # While a package is imported for ``python -m``, this is what stands there.
    if called == "-m" or os.path.basename(called) in _COMMAND:
        sys.path[:] = paths_without_working_folder()
