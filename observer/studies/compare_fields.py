"""Results of the modules of a field at two dates: which panels of which module turned, what changed."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from heliogauge.doubts import Doubt, Severity, gather_doubts
from heliogauge.errors import InputError
from heliogauge.reporting.notation import number_text
from heliogauge.results.folder import SUMMARY_FILE, Summary, hash_files, read_summary, write_table_csv
from heliogauge.results.frame import InstrumentResult
from heliogauge.results.tables import read_table_csv
from heliogauge.results.used_results import serious_results
from observer.files import (
    ANGLES,
    CHANGED_MODULES,
    CHANGED_NUMBERS,
    CHANGED_PANELS,
    COLLECTOR,
    OVERVIEW_TABLE,
    read_collector,
)
from observer.product.changes import (
    NumberChange,
    PanelChanges,
    decide_together,
    number_changes,
    panel_changes,
    surely_changed,
)
from observer.studies.compare import long_table, number_table, read_panels, refuse_other_collector, refuse_same

KIND = "observer-compare-fields"
#: Modules that a doubt and the terminal name.
_SHOWN = 8


@dataclass(frozen=True, slots=True, eq=False)
class ModuleChange:
    """How one module changed from the first date to the other.

    place: Columns of the overview that say where it is, as they are there.
    numbers: Changes of its numbers; is_sure says of each whether it surely changed.
    panels: Turns of its panels; None where one of both dates has no angles.
    """

    label: str
    place: dict[str, str]
    numbers: tuple[NumberChange, ...]
    is_sure: tuple[bool, ...]
    panels: PanelChanges | None


@dataclass(frozen=True, slots=True, eq=False)
class FieldComparison(InstrumentResult):
    """The modules of a field at two dates.

    folders: Results of both dates, the earlier one first.
    modules: Those that both have.
    """

    kind: ClassVar[str] = KIND
    folders: tuple[Path, Path]
    modules: tuple[ModuleChange, ...]

    def summarise(self) -> Summary:
        """Collect the headline numbers with their sigmas, doubts and provenance."""
        kept = [each for one in self.modules for each in one.numbers if each.key == "intercept_ratio"]
        numbers: dict[str, float | int | None] = {
            "modules_count": len(self.modules),
            "panels_compared_count": sum(
                int(np.isfinite(one.panels.theta_r_change_rad).sum()) for one in self.modules if one.panels is not None
            ),
            "panels_turned_count": sum(_turned_count(one) for one in self.modules),
            "modules_with_turned_panels_count": sum(_turned_count(one) > 0 for one in self.modules),
        }
        if kept:
            # Modules are measured each for itself.
            numbers["intercept_change_mean_ratio"] = float(np.mean([one.change for one in kept]))
            sigma = float(np.sqrt(np.sum([one.sigma_change**2 for one in kept]))) / len(kept)
            numbers["sigma_intercept_change_mean_ratio"] = sigma
        first, other = self.folders
        return self._summary(numbers, {"first": str(first), "other": str(other)})

    def write_files(self, folder: Path) -> None:
        """Write a table of modules, one of their numbers and one of their panels into an existing folder."""
        write_table_csv(folder / CHANGED_MODULES, _table(self))
        names = [(one.label, one.numbers) for one in self.modules]
        sure = [each for one in self.modules for each in one.is_sure]
        write_table_csv(folder / CHANGED_NUMBERS, number_table(names) | {"is_sure": [int(one) for one in sure]})
        known = [(one.label, one.panels) for one in self.modules if one.panels is not None]
        labels, parts = [label for label, _ in known], [part for _, part in known]
        write_table_csv(folder / CHANGED_PANELS, long_table(parts, PanelChanges, "panel", labels))

    def headline(self) -> str:
        """Return the most important numbers in a few lines for the terminal."""
        numbers = self.summarise().numbers
        lines = [
            f"{len(self.modules)} modules of {self.folders[0]} and {self.folders[1]}: "
            f"{numbers['panels_turned_count']} of {numbers['panels_compared_count']} panels surely turned"
        ]
        change = numbers.get("intercept_change_mean_ratio")
        if change is not None:
            key = "intercept_change_mean_ratio"
            lines.append(f"  intercept factor, mean change {number_text(change, numbers[f'sigma_{key}'], '', key)}")
        turned = [one for one in self.modules if _turned_count(one)]
        lines += [
            f"  {one.label}: panel{'s' * (_turned_count(one) > 1)} {', '.join(_turned_panels(one))}"
            for one in turned[:_SHOWN]
        ]
        if len(turned) > _SHOWN:
            lines.append(f"  and {len(turned) - _SHOWN} modules more: {CHANGED_PANELS}")
        return "\n".join(lines)


def run(folders: Sequence[Path]) -> FieldComparison:
    """Compare the modules of a field at two dates.

    folders: Two results of ``heliogauge observer measure`` with several modules, or of ``heliogauge measure`` with an
        overview, each with the modules' results below it; the earlier one first.
    Returns: Changes of the modules that both have, known by their names. A panel has surely turned, and a number surely
        changed, where chance makes the largest change of the whole field so large once in a hundred times.
    InputError: Not two results, the same one twice, no module in both, or modules of different collectors.
    """
    if len(folders) != 2:
        raise InputError(f"observer compare: {len(folders)} results of several modules given; give those of two dates")
    refuse_same(folders)
    tables = [_measured(folder) for folder in folders]
    shared = [name for name in tables[0] if name in tables[1]]
    if not shared:
        names = " and ".join(", ".join(list(one)[:3]) + (" ..." if len(one) > 3 else "") for one in tables)
        raise InputError(f"observer compare: no module was measured at both dates; their names are {names}")
    numbers, panels = [], []
    used: dict[str, Summary] = {}
    for name in shared:
        own = [table[name].folder for table in tables]
        refuse_other_collector(own, [read_collector(one / COLLECTOR) for one in own])
        summaries = [read_summary(one) for one in own]
        numbers.append(number_changes(summaries[0].numbers, summaries[1].numbers))
        panels.append(_panels(own))
        used |= {str(one): summary for one, summary in zip(own, summaries, strict=True)}
    decided = iter(decide_together([one for one in panels if one is not None]))
    modules = tuple(
        ModuleChange(name, tables[0][name].place, changes, tuple(sure), None if part is None else next(decided))
        for name, changes, sure, part in zip(shared, numbers, surely_changed(numbers), panels, strict=True)
    )
    return FieldComparison(
        (folders[0], folders[1]),
        modules,
        name=f"{folders[0].resolve().name} to {folders[1].resolve().name}",
        doubts=gather_doubts(_only_once(tables, folders), serious_results(used)),
        input_sha256={one: next(iter(hash_files([Path(one) / SUMMARY_FILE]).values())) for one in used},
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Measured:
    """A measured module at one date: its results, and the columns of the overview that say where it is."""

    folder: Path
    place: dict[str, str]


def _measured(folder: Path) -> dict[str, _Measured]:
    """Return the measured modules of a date by their names: their folders, from the one that all lie in."""
    table = read_table_csv(folder / OVERVIEW_TABLE, ("result",))
    failed = table.get("failed", [""] * len(table["result"]))
    places = [key for key in table if key == "loop" or (key.startswith("place_") and key.endswith("_m"))]
    found = []
    for row, name in enumerate(table["result"]):
        # Modules of one flight lie below their overview; one of results from elsewhere has their paths.
        own = next((one for one in (folder / name, Path(name)) if (one / SUMMARY_FILE).is_file()), None)
        if own is not None and not failed[row]:
            found.append(_Measured(own.resolve(), {key: table[key][row] for key in places}))
    if not found:
        raise InputError(
            f"{folder}: none of its {len(failed)} modules has results there; measure again or move them back"
        )
    base = os.path.commonpath([one.folder.parent for one in found])
    return {str(one.folder.relative_to(base)): one for one in found}


def _panels(folders: Sequence[Path]) -> PanelChanges | None:
    if not all((folder / ANGLES).is_file() for folder in folders):
        return None
    return panel_changes(*(read_panels(folder, read_collector(folder / COLLECTOR)) for folder in folders))


def _only_once(tables: Sequence[dict[str, _Measured]], folders: Sequence[Path]) -> list[Doubt]:
    """Say which modules were measured at one date only."""
    found = []
    for own, others, folder in zip(tables, reversed(tables), folders, strict=True):
        names = [name for name in own if name not in others]
        if names:
            more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
            count = "1 module was" if len(names) == 1 else f"{len(names)} modules were"
            text = f"{count} measured in {folder} only: {', '.join(names[:_SHOWN])}{more}"
            found.append(Doubt("module_at_one_date", text, {"modules_count": len(names)}, Severity.NOTE))
    return found


def _turned_count(one: ModuleChange) -> int:
    return 0 if one.panels is None else int(one.panels.is_sure.sum())


def _turned_panels(one: ModuleChange) -> list[str]:
    return [] if one.panels is None else [str(number) for number in one.panels.panel[one.panels.is_sure]]


def _table(result: FieldComparison) -> dict[str, list[Any]]:
    """Return a row for each module: where it is, how many panels turned, which one most."""
    rows: list[dict[str, Any]] = []
    for one in result.modules:
        row: dict[str, Any] = {"module": one.label, **one.place, "panels_turned_count": _turned_count(one)}
        kept = next((each for each in one.numbers if each.key == "intercept_ratio"), None)
        row["intercept_change_ratio"] = "" if kept is None else kept.change
        row["sigma_intercept_change_ratio"] = "" if kept is None else kept.sigma_change
        rows.append(row)
    return {key: [row.get(key, "") for row in rows] for key in rows[0]}
