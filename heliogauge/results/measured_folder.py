"""The folder that results were measured from: written as it is seen from the results, so that both can be moved."""

import os
from pathlib import Path

from heliogauge.errors import InputError
from heliogauge.results.folder import SUMMARY_FILE, read_summary


def seen_from(measured: Path, out: Path) -> str:
    """Return the path from a folder of results to the one that was measured; absolute where there is no such path."""
    try:
        return Path(os.path.relpath(measured.resolve(), out.resolve())).as_posix()
    except ValueError:  # Two drives of Windows.
        return str(measured.resolve())


def measured_folder(results: Path) -> Path:
    """Return the folder that results were measured from.

    InputError: The results do not say, or it is not there any more.
    """
    said = read_summary(results / SUMMARY_FILE).measured_from
    if not said:
        raise InputError(f"{results}: these results do not say what they were made from; give the measurement folder")
    folder = Path(os.path.normpath(results.absolute() / said))
    if not folder.is_dir():
        raise InputError(
            f"{results}: these results were measured from {folder}, which is not there; give the measurement folder"
        )
    try:
        # Short where the user is near.
        return folder.relative_to(Path.cwd())
    except ValueError:
        return folder
