"""The plan of a measurement without a slope map: its sigmas, and what each alternative brings."""

from abc import ABC
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np

from deflectometry.planning.pipeline.alternatives import try_changes, words_of_best, write_alternatives
from deflectometry.planning.prospect import Alternative, Planned
from deflectometry.planning.sigma_prospect import SigmaProspect
from heliogauge.reporting.notation import number_text
from heliogauge.results.folder import Summary, hash_files, unit_of
from heliogauge.results.frame import InstrumentResult
from heliogauge.results.tables import write_table_csv
from heliogauge.running.progress import Progress, SilentProgress

#: Table of what is promised, and of the shares that alternatives may change: name, what it is, value.
PROMISES_FILE = "promises.csv"


@dataclass(frozen=True, slots=True, eq=False)
class SigmaPlanResult(InstrumentResult, ABC):
    """What a measurement will be worth, and what would better it: the base of each instrument's own.

    prospect: As planned.
    alternatives: What was changed, that of the largest gain first; impossible ones last.
    """

    prospect: SigmaProspect
    alternatives: tuple[Alternative, ...]

    def summarise(self) -> Summary:
        """Collect the sigmas, and what would better them."""
        prospect = self.prospect
        numbers: dict[str, float | int | None] = {
            f"sigma_{name}": value if np.isfinite(value) else None for name, value in prospect.promised.items()
        }
        numbers |= {**prospect.shares, **prospect.numbers}
        texts = {
            "best": self._best(),
            "sigma": "1 standard deviation of what the measurement will say, by its own adjustment of predicted "
            "observations",
            **prospect.texts,
        }
        reasons = {f"sigma_{name}": why for name, why in prospect.not_determined.items()}
        return self._summary(numbers, texts, reasons, facets=prospect.facets)

    def _best(self) -> str:
        return words_of_best(self.alternatives, self.prospect.labels, self._costs)

    def _costs(self, one: Alternative) -> Sequence[str]:
        prospect = self.prospect
        return [
            f"{prospect.share_labels[name]} {after:.0%} instead of {prospect.shares[name]:.0%}"
            for name, after in one.beside.items()
            if round(100 * after) != round(100 * prospect.shares[name])
        ]

    def write_files(self, folder: Path) -> None:
        """Write the tables into an existing folder."""
        prospect = self.prospect
        words = {**prospect.labels, **prospect.share_labels}
        values = {f"sigma_{name}": one for name, one in prospect.promised.items()} | dict(prospect.shares)
        write_table_csv(
            folder / PROMISES_FILE, {"name": list(values), "what": list(words.values()), "value": list(values.values())}
        )
        for name, columns in prospect.tables.items():
            write_table_csv(folder / name, columns)
        write_alternatives(folder, prospect, self.alternatives, lambda name: f"sigma_{name}")

    def headline(self) -> str:
        """Return the sigmas and the best alternatives in a few lines for the terminal."""
        prospect = self.prospect
        wide = max(len(one) for one in (*prospect.labels.values(), "would better it"))
        lines = [f"{self.name}: expected sigmas"]
        for name, words in prospect.labels.items():
            lines.append(f"  {words:<{wide}}  {sigma_text(name, prospect.promised[name])}")
        for name, words in prospect.share_labels.items():
            lines.append(f"  {words:<{wide}}  {100 * prospect.shares[name]:.0f} %")
        return "\n".join([*lines, f"  {'would better it':<{wide}}  {self._best()}"])


def sigma_text(name: str, value: float) -> str:
    """Print a sigma by the unit of its name; a word where it is not determined."""
    bare, unit = unit_of(name)
    return number_text(value, None, unit, bare) if np.isfinite(value) else "not determined"


class PlannedSigmas(Planned, Protocol):
    """A set-up whose measurement has no slope map."""

    def prospect(self) -> SigmaProspect:
        """Return what measuring with it will be worth.

        InputError: A set-up that shows nothing.
        EstimationError: One that determines nothing.
        """


_Result = TypeVar("_Result", bound=SigmaPlanResult)


def run_sigma_plan(
    result: type[_Result],
    planned: PlannedSigmas,
    folder: Path,
    files: Iterable[Path],
    progress: Progress | None = None,
) -> _Result:
    """Say what a measurement will be worth, and look at what might be done otherwise.

    result: What becomes of it.
    folder, files: Where measurement.toml is, and all that was read.
    InputError, EstimationError: As for `PlannedSigmas.prospect`.
    """
    progress = progress or SilentProgress()
    with progress.stage("as planned"):
        prospect = planned.prospect()
    alternatives = try_changes(tuple(planned.changes()), prospect, progress)
    return result(
        name=planned.name,
        prospect=prospect,
        alternatives=alternatives,
        doubts=prospect.doubts,
        durations_s=dict(progress.durations_s),
        input_sha256=hash_files(files, folder),
    )
