"""The folder that results were measured from: written as it is seen from the results, so that both can be moved."""

import os
from collections.abc import Mapping
from pathlib import Path, PurePosixPath, PureWindowsPath

from heliogauge.errors import InputError
from heliogauge.results.folder import SUMMARY_FILE, hash_files, read_summary

_MEASUREMENT_FILE = "measurement.toml"
_REMEDY = "give the measurement folder itself"


def seen_from(measured: Path, out: Path) -> str:
    """Return the path from a folder of results to the one that was measured; empty where there is none."""
    try:
        return Path(os.path.relpath(measured.resolve(), out.resolve())).as_posix()
    except ValueError:  # Two drives of Windows.
        return ""


def measured_folder(results: Path) -> Path:
    """Return the folder that results were measured from, known by the files in it.

    InputError: The results do not say; they name an absolute path; the folder is not there any more, or holds other
        files than those that were measured.
    """
    summary = read_summary(results / SUMMARY_FILE)
    said = summary.measured_from
    if not said:
        raise InputError(f"{results}: these results do not say what they were made from; give the measurement folder")
    if _is_absolute(said):
        # The folder may come from somebody else, who must not choose where on this machine is read, or ask a server.
        raise InputError(f"{results}: an absolute path ({said!r:.60}) stands for what was measured; {_REMEDY}")
    folder = Path(os.path.normpath(results.absolute() / said))
    if not folder.is_dir():
        raise InputError(
            f"{results}: these results were measured from {folder}, which is not there; give the measurement folder"
        )
    hashes, is_plan = summary.input_sha256, summary.kind.endswith("-plan")
    # A plan may have read other files than those of the folder: the results that it made for itself.
    if not is_plan or (_MEASUREMENT_FILE in hashes and (folder / _MEASUREMENT_FILE).exists()):
        _refuse_others(results, folder, hashes)
    try:
        # Short where the user is near.
        return folder.relative_to(Path.cwd())
    except ValueError:
        return folder


def _is_absolute(path: str) -> bool:
    """Return whether a path leaves the folder it is seen from by more than dots: on this system or on Windows."""
    return bool(PurePosixPath(path).root or PureWindowsPath(path).anchor)


def _refuse_others(results: Path, folder: Path, hashes: Mapping[str, str]) -> None:
    """Refuse a folder whose files are not those that were measured; files elsewhere are known by their names alone.

    InputError: None of them is in it, or one has another content.
    """
    held = {
        name: folder / name
        for name in hashes
        if not _is_absolute(name) and ".." not in PureWindowsPath(name).parts and (folder / name).is_file()
    }
    if hashes and not held:
        raise InputError(f"{results}: points to {folder}, which holds none of the files that were measured; {_REMEDY}")
    now = dict(zip(held, hash_files(held.values()).values(), strict=True))
    other = next((name for name in held if now[name] != hashes[name]), "")
    if other:
        raise InputError(
            f"{results}: points to {folder}, whose {other} is another than the one that was measured; {_REMEDY}"
        )
