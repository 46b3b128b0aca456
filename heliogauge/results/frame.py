"""What the result of any instrument has, and what is done with all of them alike."""

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from heliogauge.doubts import Doubt
from heliogauge.errors import MetrologyError, ReportWarning
from heliogauge.results.failure import pictures_of_failure
from heliogauge.results.folder import SUMMARY_FILE, ResultFolder, Summary, explained, write_summary
from heliogauge.results.measured_folder import seen_from
from heliogauge.running.progress import Progress

#: Headline numbers by name with unit; None where one is not determined.
Numbers = Mapping[str, float | int | None]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class InstrumentResult(ABC):
    """Result of a command that measures, plans or compares: the base of each instrument's own.

    An instrument's result adds what it measured, names its `kind`, and says how that becomes files, headline numbers
    and lines on a terminal.

    name: Name of what was measured.
    doubts: What makes the result doubtful.
    durations_s: Wall time of each stage [s].
    input_sha256: Hash of each file that was read.
    """

    kind: ClassVar[str]
    name: str
    doubts: tuple[Doubt, ...] = ()
    durations_s: Mapping[str, float] = field(default_factory=dict)
    input_sha256: Mapping[str, str] = field(default_factory=dict)

    def __init_subclass__(cls) -> None:
        """Keep the short repr: a dataclass would write one that prints all arrays."""
        cls.__repr__ = InstrumentResult.__repr__  # type: ignore[method-assign]

    @abstractmethod
    def summarise(self) -> Summary:
        """Collect the headline numbers with their sigmas, doubts and provenance."""

    @abstractmethod
    def write_files(self, folder: Path) -> None:
        """Write everything but ``summary.json`` into an existing folder."""

    @abstractmethod
    def headline(self) -> str:
        """Return the most important numbers in a few lines for the terminal."""

    @property
    def exit_code(self) -> int:
        """Exit code of the command that made it; another than 0 where the result itself is a no."""
        return 0

    def __repr__(self) -> str:
        """Show what it is and the most important numbers, not its arrays."""
        more = f"; {len(self.doubts)} doubts" if self.doubts else ""
        return f"<{self.kind} result of {self.name!r}{more}>\n{self.headline()}"

    def write(self, folder: Path, measured_from: str = "") -> Summary:
        """Write all files into an existing folder, usually that of `heliogauge.results.folder.ResultFolder`.

        measured_from: Folder that was measured, as seen from that of the results.
        Returns: What ``summary.json`` holds.
        """
        self.write_files(folder)
        summary = replace(self.summarise(), measured_from=measured_from)
        write_summary(folder / SUMMARY_FILE, summary)
        return summary

    def _summary(
        self,
        numbers: Numbers,
        texts: Mapping[str, str],
        not_determined: Mapping[str, str] | None = None,
        facets: Mapping[str, Numbers] | None = None,
        geometry_m: Mapping[str, Any] | None = None,
    ) -> Summary:
        """Return a summary with what every result has, each number finite or None with a reason."""
        return explained(
            Summary(
                self.kind,
                self.name,
                numbers,
                texts,
                self.doubts,
                self.durations_s,
                self.input_sha256,
                not_determined or {},
                facets or {},
                geometry_m or {},
            )
        )


_ResultT = TypeVar("_ResultT", bound=InstrumentResult)


def into_folder(
    out: Path,
    job: Callable[[], _ResultT],
    progress: Progress,
    *,
    force: bool,
    report: bool,
    measured: Path | None = None,
) -> _ResultT:
    """Do the work of a command and write its result into a folder that is whole or not there.

    job: Does the work; is called when the folder is known to be usable.
    measured: Folder that is measured, which the result will name.
    force: Replace an earlier result.
    report: Add ``report.html`` when the results are in place (`add_report`).
    InputError: The folder cannot be used, or the job refuses its input.
    EstimationError: The job's answer is not determined. What its pictures show is in ``OUT-failed/``.
    """
    with pictures_of_failure(out), ResultFolder(out, force=force) as working:
        result = job()
        with progress.stage("write results"):
            result.write(working, "" if measured is None else seen_from(measured, out))
    if report:
        add_report(out, progress)
    return result


def add_report(folder: Path, progress: Progress) -> None:
    """Add a report to results that are complete and in their place; one that fails costs the report alone.

    Whatever goes wrong becomes a `ReportWarning` with its reason: hours of measuring are worth more than a picture.

    KeyboardInterrupt: With what is kept in its text.
    """
    again = f"`heliogauge report {folder}` makes the report"
    try:
        from heliogauge.reporting.build import build_report

        with progress.stage("report"):
            build_report(folder)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"the results are complete in {folder}; {again}") from None
    except Exception as error:
        reason = str(error) if isinstance(error, MetrologyError) else f"{type(error).__name__}: {error}"
        warnings.warn(
            f"no report: {reason}; the results are complete in {folder}, and {again}", ReportWarning, stacklevel=2
        )
