"""Folders whose files stay in them: no symbolic link leads elsewhere."""

import os
from collections.abc import Iterable
from pathlib import Path

from heliogauge.errors import InputError


def refuse_leading_out(folder: Path, files: Iterable[Path]) -> None:
    """Refuse files of a folder that a symbolic link takes out of it.

    folder: The folder; it may be a link itself, since the user named it.
    files: Files in it; those that are named by a path out of it (``../camera.json``) are elsewhere on purpose.
    InputError: A file, or a folder on the way to it, is a link to elsewhere.
    """
    root = os.path.realpath(folder)
    home = os.path.abspath(folder)
    for file in files:
        inside = os.path.relpath(os.path.abspath(file), home)
        if inside.split(os.sep)[0] == os.pardir:
            continue
        real = os.path.realpath(os.path.join(root, inside))
        if real != root and not real.startswith(root.rstrip(os.sep) + os.sep):
            raise InputError(f"{file}: a symbolic link leads out of {folder}, to {real}; copy the file into the folder")


def refuse_links_out(folder: Path) -> None:
    """Refuse a folder in which a symbolic link leads elsewhere, down to the files of its folders.

    InputError: Names the link.
    """
    places = [folder, *(Path(one.path) for one in _entries(folder) if one.is_dir(follow_symlinks=False))]
    refuse_leading_out(folder, (Path(one.path) for place in places for one in _entries(place) if one.is_symlink()))


def _entries(folder: Path) -> list["os.DirEntry[str]"]:
    try:
        with os.scandir(folder) as entries:
            return list(entries)
    except OSError:
        # What is no folder is explained where it is opened.
        return []
