"""What was opened to be looked at, and the bounds that no address leaves."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from heliogauge.errors import InputError
from heliogauge.files.own_folder import refuse_links_out
from heliogauge.results.folder import SUMMARY_FILE

#: Files that are handed out as they are, by their ending. Pages and scripts that lie among results never are.
MEDIA_TYPES: dict[str, str] = {
    ".csv": "text/plain; charset=utf-8",
    ".json": "application/json",
    ".txt": "text/plain; charset=utf-8",
    ".toml": "text/plain; charset=utf-8",
    ".yaml": "text/plain; charset=utf-8",
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".jpeg": "image/jpeg",
    ".nc": "application/x-netcdf",
    ".npz": "application/octet-stream",
    ".ply": "application/octet-stream",
    ".sht": "application/octet-stream",
    ".ipynb": "application/octet-stream",
}
#: Files that the browser shows; the others are saved.
SHOWN_TYPES = ("text/plain", "image/", "application/json")
# A campaign of a season has a few thousand results in two or three levels.
_DEEPEST, _MOST_FOLDERS = 6, 50_000


class NotServedError(Exception):
    """An address that is not served; the text says why."""


@dataclass(frozen=True, slots=True)
class Opened:
    """A place whose results may be looked at.

    root: Its folder, without links.
    only: The one file of it that was opened; empty: everything below the folder.
    """

    root: Path
    only: str = ""

    @property
    def name(self) -> str:
        """What it is called in titles."""
        return self.only or self.root.name

    def find(self, address: str) -> Path:
        """Return the file or folder of an address.

        address: Names with forward slashes between them, decoded; empty: the folder itself.
        NotServedError: It leads out of what was opened, to something hidden, or nothing is there.
        """
        parts = [part for part in address.split("/") if part]
        for part in parts:
            # Windows takes "\" and drives; a name that begins with a point is hidden or leads upwards.
            if part.startswith(".") or any(sign in part for sign in "\\:\0"):
                raise NotServedError(f"{part!r} is not served")
        if self.only and parts != [self.only]:
            raise NotServedError(f"only {self.only} was opened")
        place = self.root.joinpath(*parts)
        try:
            real = place.resolve(strict=True)
        except (OSError, RuntimeError, ValueError):
            raise NotServedError(f"{address}: there is no such file among these results") from None
        if not real.is_relative_to(self.root):
            raise NotServedError(f"{address}: a link that leads out of {self.root.name}; links are not followed")
        return place

    def refuse_links(self, folder: Path) -> None:
        """Check that nothing in a folder of results leads out of what was opened, as deep as reports read.

        InputError: A symbolic link does; the message names it.
        """
        refuse_links_out(folder, self.root)


def open_place(path: Path) -> Opened:
    """Open a folder of results, a folder of folders, or a slope map.

    InputError: Nothing is there, or nothing that can be looked at.
    """
    try:
        real = path.expanduser().resolve(strict=True)
    except (OSError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be opened ({reason}); a folder of results is needed") from None
    if real.is_dir():
        return Opened(real)
    if real.is_file() and real.suffix == ".nc":
        return Opened(real.parent, real.name)
    if real.is_file() and real.name in (SUMMARY_FILE, "report.html", "report.ipynb"):
        return Opened(real.parent)
    raise InputError(f"{path}: a folder of results or a slope_map.nc is needed")


def is_result(folder: Path) -> bool:
    """Whether a folder holds results."""
    return (folder / SUMMARY_FILE).is_file()


def folders_of_results(folder: Path) -> Iterator[Path]:
    """Go through the folders of results below a folder; what lies within a result belongs to its page.

    Links and hidden folders are passed over.
    """
    waiting, seen = [(folder, 0)], 0
    while waiting:
        here, depth = waiting.pop()
        seen += 1
        below = sorted((one.name for one in _entries(here) if one.is_dir(follow_symlinks=False)), reverse=True)
        for name in below:
            place = here / name
            if name.startswith("."):
                continue
            if is_result(place) and not (place / SUMMARY_FILE).is_symlink():
                yield place
            elif depth < _DEEPEST and seen < _MOST_FOLDERS:
                waiting.append((place, depth + 1))


def _entries(folder: Path) -> list["os.DirEntry[str]"]:
    try:
        with os.scandir(folder) as entries:
            return list(entries)
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({error.strerror or error})") from error
