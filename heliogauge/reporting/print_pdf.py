"""Pages as PDF, from the same HTML and styles that a browser shows."""

import logging
from pathlib import Path

from heliogauge.errors import InputError
from heliogauge.files.extras import of_extra

#: What the library needs of the system, by the names that Debian and Ubuntu have for it.
SYSTEM_LIBRARIES = "libpango-1.0-0 libpangoft2-1.0-0 libharfbuzz-subset0"


def write_pdf(page: str, path: Path) -> int:
    """Print a page.

    page: Whole HTML; everything it shows lies within it.
    Returns: Number of pages.
    InputError: The library or what it needs of the system is not installed, or the file cannot be written.
    """
    try:
        weasyprint = of_extra("weasyprint")
    except OSError as error:
        raise InputError(
            f"PDF cannot be made: a library of the system is missing ({error}); as root: apt-get install "
            f"{SYSTEM_LIBRARIES}"
        ) from error
    # It reports each rule of style that only browsers know.
    logging.getLogger("weasyprint").setLevel(logging.ERROR)

    # Pictures lie within the page; nothing is fetched from elsewhere.
    within = of_extra("weasyprint.urls").URLFetcher(allowed_protocols=["data"])
    document = weasyprint.HTML(string=page, url_fetcher=within).render()
    try:
        document.write_pdf(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error})") from error
    return len(document.pages)
