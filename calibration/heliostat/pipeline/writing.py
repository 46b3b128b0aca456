"""Files of one calibrated heliostat: results, beams of its photos, summary."""

from pathlib import Path

from calibration.heliostat.files.result import HeliostatResult, Shared
from calibration.heliostat.files.store_heliostat import write_heliostat
from heliogauge.results.folder import Summary, write_summary


def write_result(result: HeliostatResult, shared: Shared, folder: Path, summary: Summary) -> None:
    """Write the files of a heliostat and ``summary.json`` into an existing folder."""
    write_heliostat_files(result, shared, folder)
    write_summary(folder / "summary.json", summary)


def write_heliostat_files(result: HeliostatResult, shared: Shared, folder: Path) -> None:
    """Write ``heliostat.json`` and ``residuals.csv`` into an existing folder.

    Where rows name photos, ``beams.csv`` too; of thorough runs pictures of the most informative beams.
    """
    write_heliostat(result, shared, folder)
    if result.beams is not None:
        # OpenCV costs 0.2 s, which only photos are worth.
        from calibration.heliostat.pipeline.beam_pictures import write_beam_files

        write_beam_files(result, shared, folder, pictures=shared.thorough)
