"""Folders whose files stay in them: no symbolic link leads elsewhere."""

import os
from collections.abc import Iterable
from pathlib import Path

from heliogauge.errors import InputError


def refuse_leading_out(folder: Path, files: Iterable[Path], root: Path | None = None) -> None:
    """Refuse files of a folder that a symbolic link takes out of it.

    folder: The folder; it may be a link itself, since the user named it.
    files: Files in it; those that are named by a path out of it (``../camera.json``) are elsewhere on purpose.
    root: Folder above it that the user named, where links may lead anywhere within that.
    InputError: A file, or a folder on the way to it, is a link to elsewhere.
    """
    home, real_home = os.path.abspath(folder), os.path.realpath(folder)
    real_root = real_home if root is None else os.path.realpath(root)
    for file in files:
        inside = os.path.relpath(os.path.abspath(file), home)
        if inside.split(os.sep)[0] == os.pardir:
            continue
        real = os.path.realpath(os.path.join(real_home, inside))
        if real != real_root and not real.startswith(real_root.rstrip(os.sep) + os.sep):
            raise InputError(
                f"{file}: a symbolic link leads out of {root or folder}, to {real}; copy the file into the folder"
            )


def refuse_links_out(folder: Path, root: Path | None = None) -> None:
    """Refuse a folder of results in which a symbolic link leads elsewhere, down to the files of its folders.

    root: Folder above it that the user named, where links may lead anywhere within that.
    InputError: Names the link.
    """
    places = [folder, *(Path(one.path) for one in _entries(folder) if one.is_dir(follow_symlinks=False))]
    refuse_leading_out(
        folder, (Path(one.path) for place in places for one in _entries(place) if one.is_symlink()), root
    )


def _entries(folder: Path) -> list["os.DirEntry[str]"]:
    try:
        with os.scandir(folder) as entries:
            return list(entries)
    except OSError:
        # What is no folder is explained where it is opened.
        return []
