"""Thumbnails of photos in a folder of results: ``photos/NAME.jpg``, few and small."""

import stat
from collections.abc import Iterable, Mapping
from pathlib import Path

from heliogauge.errors import InputError
from heliogauge.files.regular import read_regular

THUMBNAIL_FOLDER = "photos"
#: Thumbnails in one folder of results: 60 of 15 kB are 0.9 MB.
MOST_THUMBNAILS = 60

_MOST_BYTES = 100_000
_JPEG_SIGNATURE = b"\xff\xd8\xff"


def write_thumbnails(folder: Path, thumbnails: Mapping[str, bytes]) -> None:
    """Write thumbnails into a folder of results, the first `MOST_THUMBNAILS` of them.

    folder: The folder of results.
    thumbnails: JPEG files by the name of the photo, the most telling first.
    InputError: The folder cannot be written to.
    """
    place = folder / THUMBNAIL_FOLDER
    try:
        for name, data in list(thumbnails.items())[:MOST_THUMBNAILS]:
            place.mkdir(exist_ok=True)
            (place / f"{Path(name).name}.jpg").write_bytes(data)
    except OSError as error:
        raise InputError(f"{place}: thumbnails cannot be written ({error.strerror or error})") from error


def thumbnail_names(folder: Path) -> tuple[str, ...]:
    """Return the photos of which there are thumbnails in a folder of results, in the order of their names."""
    found = sorted((folder / THUMBNAIL_FOLDER).glob("*.jpg"))
    return tuple(path.name.removesuffix(".jpg") for path in found)


def read_thumbnails(folder: Path, photos: Iterable[str]) -> dict[str, bytes]:
    """Read the thumbnails of photos, as far as there are any.

    folder: The folder of results.
    photos: Names of the photos, as files of results have them.
    Returns: JPEG files by the name of the photo. Links, other files than JPEG and large ones are left out: names come
        from files, and what is read ends in a report.
    """
    found: dict[str, bytes] = {}
    for name in photos:
        path = folder / THUMBNAIL_FOLDER / f"{name}.jpg"
        if Path(name).name != name or len(found) == MOST_THUMBNAILS:
            continue
        try:
            status = path.lstat()
            if not stat.S_ISREG(status.st_mode) or status.st_size > _MOST_BYTES:
                continue
            data = read_regular(path, "a JPEG file", _MOST_BYTES)
        except (OSError, ValueError, InputError):
            continue
        if data.startswith(_JPEG_SIGNATURE):
            found[name] = data
    return found
