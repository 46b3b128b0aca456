"""What a measurement's results were made from, as one hash."""

import hashlib
import os
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from heliogauge import __version__
from heliogauge.errors import InputError
from heliogauge.files.regular import MOST_IMAGE_BYTES
from heliogauge.files.texts import read_toml
from heliogauge.measurement.load import MEASUREMENT_FILE
from heliogauge.results.folder import hash_files


def input_digest(folder: Path, options: Mapping[str, Any]) -> str:
    """Hash all files of a measurement folder, files elsewhere that it names, the options, and the version.

    folder: The measurement folder; hidden files in it, and what is no regular file, are left out.
    options: Choices that override those of the file.
    Returns: Hexadecimal digits; the same for a folder that was moved or copied. Files larger than anything that is read
        as a whole, such as films, are told apart by their size and time of change.
    InputError: A file cannot be read.
    """
    inside = [(file.relative_to(folder).as_posix(), _digest(file)) for file in _files_in(folder)]
    elsewhere = [(key, _digest(file)) for key, file in _files_elsewhere(folder)]
    said = (
        __version__,
        sorted((name, repr(value)) for name, value in options.items()),
        inside,
        elsewhere,
    )
    return hashlib.sha256(repr(said).encode()).hexdigest()


def _digest(file: Path) -> str:
    about = file.stat()
    if about.st_size > MOST_IMAGE_BYTES:
        return f"{about.st_size} bytes of {about.st_mtime_ns}"
    return next(iter(hash_files([file]).values()))


def _files_in(folder: Path) -> list[Path]:
    """Return the regular files of a folder and those below it, without hidden ones; linked folders are not entered."""
    found = []
    for place, below, names in os.walk(folder):
        below[:] = [name for name in below if not name.startswith(".")]
        found += [Path(place, name) for name in names if not name.startswith(".") and _is_regular(Path(place, name))]
    return sorted(found)


def _files_elsewhere(folder: Path) -> Iterator[tuple[str, Path]]:
    """Yield the files outside of a folder that its measurement.toml names, with the text that names them."""
    try:
        content = read_toml(folder / MEASUREMENT_FILE)
    except InputError:
        # Absent, or damaged: whoever measures says what is wrong with it.
        return
    for text in sorted(set(_texts(content))):
        for place in _places(folder, text):
            for file in _files_in(place) if place.is_dir() else [place]:
                if _is_regular(file):
                    yield f"{text}:{file.name}", file


def _places(folder: Path, text: str) -> list[Path]:
    """Return files and folders outside of a folder that a text names: as a path, or as a pattern (``../*.png``)."""
    home = folder.resolve()
    try:
        is_pattern = ".." in Path(text).parts and any(sign in text for sign in "*?[")
        found = sorted(folder.glob(text)) if is_pattern else [folder / text]
        places = [place.resolve() for place in found if place.exists()]
    except (OSError, ValueError, NotImplementedError, RuntimeError):
        # No text that could be a path.
        return []
    # A folder above is a name such as "..", and no input.
    return [place for place in places if not place.is_relative_to(home) and not home.is_relative_to(place)]


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, list | dict):
        for one in value.values() if isinstance(value, dict) else value:
            yield from _texts(one)


def _is_regular(file: Path) -> bool:
    """Return whether a path is a file that ends: not a pipe, a device, or a link to nowhere."""
    try:
        return stat.S_ISREG(file.stat().st_mode)
    except OSError:
        return False
