"""Commented measurement.toml files to start from."""

from pathlib import Path

from heliogauge.errors import InputError
from heliogauge.instruments import every_kind, near_match, read_resource
from heliogauge.measurement.load import MEASUREMENT_FILE
from heliogauge.measurement.writer import write_text


def write_template(kind: str, folder: Path, *, force: bool = False) -> Path:
    """Write a commented measurement.toml for one kind of measurement.

    force: Replace a file that is there.
    InputError: The kind is not available, the file exists already, or the folder cannot be made.
    """
    kinds = every_kind()
    if kind not in kinds:
        raise InputError(f"kind {kind!r} is not known; {near_match(kind, kinds)}")
    file = folder / MEASUREMENT_FILE
    if file.exists() and not force:
        raise InputError(f"{file}: the file exists already; give force=True to replace it, or give another folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made a folder ({error.strerror}); give another one") from error
    return write_text(file, read_resource(kinds[kind].template))
