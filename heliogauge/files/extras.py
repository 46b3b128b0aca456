"""Libraries that only some need: what shows results as tables and labelled arrays in Python."""

from importlib import import_module
from typing import Any

from heliogauge.errors import InputError


def of_extra(library: str) -> Any:
    """Import a library of the extra ``notebook``.

    library: "pandas", "xarray" or "h5netcdf".
    InputError: It is not installed.
    """
    try:
        return import_module(library)
    except ImportError as error:
        raise InputError(
            f"{library} is not installed; tables and labelled arrays need it: pip install 'heliogauge[notebook]'"
        ) from error
