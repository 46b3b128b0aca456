"""Measurement folders made from another program's files: what they were made of, and which may be replaced."""

from collections.abc import Sequence
from pathlib import Path

from heliogauge.results.folder import hash_files
from heliogauge.results.json_file import write_json
from heliogauge.results.whole_folder import FolderKind

#: Says from which files a measurement was imported.
IMPORTED_FILE = "imported.json"
#: Only a folder that an import wrote is replaced by one; a measurement with photos of its own never is.
IMPORTED = FolderKind(content="imported measurements", mark=IMPORTED_FILE)


def write_imported(folder: Path, form: str, files: Sequence[Path]) -> None:
    """Write down from which files a measurement folder was made.

    form: Name of the format, as the command line has it.
    """
    hashes = {path.name: digest for path in files for digest in hash_files([path], path.parent).values()}
    write_json(folder / IMPORTED_FILE, {"format": form, "sha256": hashes})
