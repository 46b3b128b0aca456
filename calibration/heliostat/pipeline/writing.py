"""Files of one calibrated heliostat: results, beams of its photos, summary."""

import tempfile
from pathlib import Path

from calibration.heliostat.files.result import HeliostatResult, Shared
from calibration.heliostat.files.store_heliostat import heliostat_texts
from heliogauge.errors import InputError
from heliogauge.files.regular import read_regular
from heliogauge.results.folder import SUMMARY_FILE, Summary, summary_content, write_summary
from heliogauge.results.json_file import json_text


def result_files(result: HeliostatResult, shared: Shared, summary: Summary) -> dict[str, bytes]:
    """Return the content of all files of a heliostat by their paths in its folder."""
    texts = heliostat_texts(result, shared) | {SUMMARY_FILE: json_text(SUMMARY_FILE, summary_content(summary))}
    files = {name: text.encode() for name, text in texts.items()}
    if result.beams is None:
        return files
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        _write_beams(result, shared, folder)
        written = [path for path in sorted(folder.rglob("*")) if not path.is_dir()]
        return files | {path.relative_to(folder).as_posix(): read_regular(path) for path in written}


def write_result(result: HeliostatResult, shared: Shared, folder: Path, summary: Summary) -> None:
    """Write the files of a heliostat and ``summary.json`` into an existing folder."""
    write_heliostat_files(result, shared, folder)
    write_summary(folder / SUMMARY_FILE, summary)


def write_heliostat_files(result: HeliostatResult, shared: Shared, folder: Path) -> None:
    """Write ``heliostat.json`` and ``residuals.csv`` into an existing folder.

    Where rows name photos, ``beams.csv`` too; of thorough runs pictures of the most informative beams.

    InputError: A file cannot be written.
    """
    for name, text in heliostat_texts(result, shared).items():
        try:
            (folder / name).write_bytes(text.encode())
        except OSError as error:
            raise InputError(f"{folder / name}: cannot be written ({error})") from error
    if result.beams is not None:
        _write_beams(result, shared, folder)


def _write_beams(result: HeliostatResult, shared: Shared, folder: Path) -> None:
    # OpenCV costs 0.2 s, which only photos are worth.
    from calibration.heliostat.pipeline.beam_pictures import write_beam_files

    write_beam_files(result, shared, folder, pictures=shared.thorough)
