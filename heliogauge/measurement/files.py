"""Images that a measurement.toml names, in the order in which people count."""

import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from heliogauge.errors import InputError
from heliogauge.files.own_folder import refuse_leading_out


def natural_order(name: str) -> list[tuple[int, int | str]]:
    """Return a sort key that counts: ``frame_2`` comes before ``frame_10``.

    name: A file's name.

    >>> sorted(["b10", "b9", "a"], key=natural_order)
    ['a', 'b9', 'b10']
    """
    parts = re.split(r"(\d+)", name.casefold())
    return [(0, int(part)) if part.isdecimal() else (1, part) for part in parts if part]


def image_files(folder: Path, key: str, named: str | Sequence[str]) -> tuple[Path, ...]:
    """Find the images that a measurement.toml names.

    key: Key of the file that names them, for messages.
    named: A text with ``*`` for all files that match, in natural order; or a list of files.
    InputError: A text without ``*``, no file that matches, or a file that is not there.
    """
    file = folder / "measurement.toml"
    if isinstance(named, str):
        if Path(named).is_absolute() or not any(sign in named for sign in "*?["):
            raise InputError(f"{file}: {key} = {named!r}: give a list of files, or a pattern such as 'photo_*.png'")
        try:
            found = sorted(folder.glob(named), key=lambda path: natural_order(str(path.relative_to(folder))))
        except (OSError, ValueError, NotImplementedError, RuntimeError) as error:
            raise InputError(f"{file}: {key} = {named!r}: is no pattern of files ({error})") from None
        if not found:
            raise InputError(f"{file}: {key} = {named!r}: no file in {folder} matches")
        refuse_leading_out(folder, found)
        return tuple(found)
    missing = [text for text in named if not os.path.isfile(folder / text)]
    if missing:
        others = f" (and {len(missing) - 1} more)" if len(missing) > 1 else ""
        raise InputError(f"{file}: {key}: there is no file {missing[0]!r}{others} in {folder}")
    files = tuple(folder / text for text in named)
    refuse_leading_out(folder, files)
    return files


def refuse_missing_files(folder: Path, named: Iterable[tuple[str, str]]) -> None:
    """Refuse a measurement.toml that names files which are not there.

    named: Key and text of each.
    InputError: Names all that are missing.
    """
    missing = [f"{key} = {text!r}" for key, text in named if not (folder / text).is_file()]
    if missing:
        raise InputError(f"{folder / 'measurement.toml'}: {', '.join(missing)}: there is no such file in {folder}")
