"""The result of a calibration: what was found, and how that becomes files and lines on a terminal."""

from dataclasses import dataclass
from pathlib import Path

from calibration.camera.files.findings import Findings
from calibration.camera.files.result_folder import read_tables, write_tables
from calibration.camera.files.summary import headline_numbers, headline_text, not_determined, texts
from heliogauge.results.folder import Summary


@dataclass(frozen=True, slots=True, eq=False)
class Result(Findings):
    """A calibration, which can be written."""

    def summarise(self) -> Summary:
        """Collect the headline numbers with their sigmas, doubts and provenance."""
        return self._summary(headline_numbers(self), texts(self), not_determined(self))

    def write_files(self, folder: Path) -> None:
        """Write cameras, points and tables into an existing folder."""
        write_tables(self, folder)

    def headline(self) -> str:
        """Return the most important numbers in a few lines for the terminal."""
        return headline_text(self)


def open_calibration(folder: str | Path = ".") -> Result:
    """Read a folder of results; maps and profile are computed again from the camera with its covariance.

    folder: The folder; the working directory without it, where reports run.
    Returns: As it was written, but for the rejected points' residuals and the poses of photos held out.
    """
    return read_tables(Path(folder), Result)
