"""Which folders a batch measures, and what their results are called."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from heliogauge.errors import InputError
from heliogauge.instruments import every_kind, resolve
from heliogauge.measurement.files import natural_order
from heliogauge.measurement.load import MEASUREMENT_FILE
from heliogauge.results.folder import SUMMARY_FILE


@dataclass(frozen=True, slots=True)
class BatchTask:
    """One measurement of a batch.

    name: Folder of its results within those of the batch.
    folder: The measurement folder, absolute.
    earlier: Digest of what its results were made from that are there already; empty: measure it.
    """

    name: str
    folder: Path
    earlier: str = ""


def is_measurement(folder: Path) -> bool:
    """Return whether a folder holds a measurement: a measurement.toml, or what an instrument recognises without."""
    if (folder / MEASUREMENT_FILE).exists():
        return True
    return any(kind.recognises and resolve(kind.recognises)(folder) for kind in every_kind().values())


def find_measurements(folders: Sequence[Path], out: Path, reserved: Sequence[str]) -> tuple[BatchTask, ...]:
    """Find measurements in folders, and folders of folders, and name their results.

    folders: Those the caller names; each is a measurement, or is searched for measurements. One without any is kept
        as it is: its failure is a row of the index.
    out: Folder of results, which is not searched.
    reserved: Names of results that are taken.
    Returns: In the order given, those within a folder as people count; names that would be the same begin with the
        folders above, as far as they are needed to tell them apart.
    InputError: A folder does not exist, or is a file; or no measurement is in any of them.
    """
    found: dict[Path, None] = {}
    some = False
    for folder in folders:
        if not folder.is_dir():
            what = "is a file" if folder.exists() else "there is no such folder"
            raise InputError(f"{folder}: {what}; give folders with {MEASUREMENT_FILE}, or folders of such folders")
        place = folder.resolve()
        inside = list(_measurements_in(place, out.resolve()))
        some = some or bool(inside)
        found.update(dict.fromkeys(inside or [place]))
    if not some:
        searched = ", ".join(str(folder) for folder in folders[:4]) + (", ..." if len(folders) > 4 else "")
        raise InputError(f"{searched}: no folder with {MEASUREMENT_FILE} is there, nor in the folders below")
    names = unique_names(list(found), reserved)
    return tuple(BatchTask(name, folder) for name, folder in zip(names, found, strict=True))


def unique_names(folders: Sequence[Path], reserved: Sequence[str] = ()) -> list[str]:
    """Name folders so that no two names are the same, not even on a disk that does not tell capitals apart.

    reserved: Names that are taken.

    >>> unique_names([Path("/monday/facet"), Path("/tuesday/facet"), Path("/tuesday/trough")])
    ['monday_facet', 'tuesday_facet', 'trough']
    """
    depths = [1] * len(folders)
    taken = {name.casefold() for name in reserved}
    while True:
        names = [_name(folder, depth) for folder, depth in zip(folders, depths, strict=True)]
        counts: dict[str, int] = {}
        for name in names:
            counts[name.casefold()] = counts.get(name.casefold(), 0) + 1
        deeper = [
            depth + 1
            if (counts[name.casefold()] > 1 or name.casefold() in taken) and depth < len(folder.parts)
            else depth
            for name, folder, depth in zip(names, folders, depths, strict=True)
        ]
        if deeper == depths:
            break
        depths = deeper
    unique = []
    for name in names:
        number, own = 1, name
        while own.casefold() in taken:
            number += 1
            own = f"{name}_{number}"
        taken.add(own.casefold())
        unique.append(own)
    return unique


def _name(folder: Path, depth: int) -> str:
    parts = [part for part in folder.parts[-depth:] if part not in {folder.anchor, os.sep}]
    # A name that begins with a dot would be hidden, and left out wherever results are looked for.
    return "_".join(parts).lstrip(".") or "measurement"


def _measurements_in(folder: Path, out: Path) -> Iterator[Path]:
    """Yield a folder that is a measurement, or those below it; links, hidden folders and results are left out."""
    if folder == out:
        return
    if is_measurement(folder):
        yield folder
        return
    if (folder / SUMMARY_FILE).exists():
        return
    try:
        below = [place for place in folder.iterdir() if not place.name.startswith(".")]
        below = [place for place in below if place.is_dir() and not place.is_symlink()]
    except OSError:
        # What cannot be read holds nothing that could be measured.
        return
    for place in sorted(below, key=lambda one: natural_order(one.name)):
        yield from _measurements_in(place, out)
