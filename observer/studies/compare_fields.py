"""Results of the modules of a field at two dates: which panels of which module turned, what changed."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
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
from observer.product.orientation_study import LEAST_TURN_RAD
from observer.studies.compare import long_table, number_table, read_panels, refuse_other_collector, refuse_same

KIND = "observer-compare-fields"
#: Modules that a doubt and the terminal name.
_SHOWN = 8
#: Modules stand further apart than this [m].
_SAME_PLACE_M = 1.0


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
            numbers["intercept_change_mean_ratio"] = float(np.mean([one.change for one in kept]))
            # Modules of a flight share camera and weather: how much of their sigmas is alike is not known, all at most.
            numbers["sigma_intercept_change_mean_ratio"] = float(np.mean([one.sigma_change for one in kept]))
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

    folders: Two results of ``heliogauge observer measure`` with several modules, or overviews of such results by their
        whole paths; the earlier one first.
    Returns: Changes of the modules that both have, known by their names. A panel has surely turned, and a number surely
        changed, where chance makes the largest change of the whole field so large once in a hundred times.
    InputError: Not two results, the same one twice, or no module of one design in both.
    """
    if len(folders) != 2:
        raise InputError(f"observer compare: {len(folders)} results of several modules given; give those of two dates")
    refuse_same(folders)
    tables = [_measured(folder) for folder in folders]
    shared = [name for name in tables[0] if name in tables[1]]
    if not shared:
        names = " and ".join(", ".join(list(one)[:3]) + (" ..." if len(one) > 3 else "") for one in tables)
        raise InputError(f"observer compare: no module was measured at both dates; their names are {names}")
    compared, numbers, panels, doubts = [], [], [], [*_only_once(tables, folders)]
    used: dict[str, Summary] = {}
    for name in shared:
        own = [table[name].folder for table in tables]
        try:
            refuse_same(own)
            refuse_other_collector(own, [read_collector(one / COLLECTOR) for one in own])
            part = _panels(own)
        except InputError as error:
            doubts.append(Doubt("module_not_compared", f"{name}: not compared: {error}"))
            continue
        summaries = [read_summary(one) for one in own]
        compared.append(name)
        numbers.append(number_changes(summaries[0].numbers, summaries[1].numbers))
        panels.append(part)
        doubts += _moved(name, [table[name].place for table in tables])
        doubts += _turned_meanwhile(name, summaries)
        used |= {str(one): summary for one, summary in zip(own, summaries, strict=True)}
    if not compared:
        raise InputError(f"observer compare: no module can be compared\n{chr(10).join(str(one) for one in doubts)}")
    decided = iter(decide_together([one for one in panels if one is not None]))
    modules = tuple(
        ModuleChange(name, tables[0][name].place, changes, tuple(sure), None if part is None else next(decided))
        for name, changes, sure, part in zip(compared, numbers, surely_changed(numbers), panels, strict=True)
    )
    return FieldComparison(
        (folders[0], folders[1]),
        modules,
        name=f"{folders[0].resolve().name} to {folders[1].resolve().name}",
        doubts=gather_doubts(_serious_of_some(used), doubts),
        input_sha256={one: next(iter(hash_files([Path(one) / SUMMARY_FILE]).values())) for one in used},
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Measured:
    """A measured module at one date: its results, and the columns of the overview that say where it is."""

    folder: Path
    place: dict[str, str]


def _measured(folder: Path) -> dict[str, _Measured]:
    """Return the measured modules of a date by their names.

    Modules of one flight lie below their overview and have its names; results from elsewhere have their paths, and the
    name of each is its way from the folder that all of them lie in, those that failed too.
    """
    table = read_table_csv(folder / OVERVIEW_TABLE, ("result",))
    failed = table.get("failed", [""] * len(table["result"]))
    places = [key for key in table if key == "loop" or (key.startswith("place_") and key.endswith("_m"))]
    paths = [Path(name) for name in table["result"] if Path(name).is_absolute()]
    base = os.path.commonpath([one.parent for one in paths]) if paths else ""
    found = {}
    for row, name in enumerate(table["result"]):
        own = folder / name
        if not failed[row] and (own / SUMMARY_FILE).is_file():
            label = str(own.relative_to(base)) if Path(name).is_absolute() else name
            found[label] = _Measured(own, {key: table[key][row] for key in places})
    if not found:
        raise InputError(
            f"{folder}: none of its {len(failed)} modules has results below it; give the folder of a flight over "
            "several modules, or an overview of results given by their whole paths"
        )
    return found


def _panels(folders: Sequence[Path]) -> PanelChanges | None:
    if not all((folder / ANGLES).is_file() for folder in folders):
        return None
    return panel_changes(*(read_panels(folder, read_collector(folder / COLLECTOR)) for folder in folders))


def _serious_of_some(used: dict[str, Summary]) -> Doubt | None:
    """Return what is serious of single modules: serious for them, for the field a doubt unless most are."""
    found = serious_results(used)
    if found is None or 2 * found.numbers["results_count"] >= len(used):
        return found
    return replace(found, severity=Severity.DOUBT)


def _moved(name: str, places: Sequence[dict[str, str]]) -> Iterator[Doubt]:
    """Doubt that a module is the same where the two overviews have it at different places or in different loops."""
    moved = [key for key in places[0] if key in places[1] and _differ(places[0][key], places[1][key])]
    if moved:
        said = ", ".join(f"{key} {places[0][key]} and {places[1][key]}" for key in moved)
        yield Doubt("module_elsewhere", f"{name}: the two dates have it at different places ({said}): is it the same?")


def _differ(first: str, other: str) -> bool:
    try:
        return abs(float(first) - float(other)) > _SAME_PLACE_M
    except ValueError:
        return bool(first and other) and first != other


def _turned_meanwhile(name: str, summaries: Sequence[Summary]) -> Iterator[Doubt]:
    """Say that a module was measured in two orientations: its weight, too, turns panels."""
    turns = [one.numbers.get("orientation_rad") for one in summaries]
    if None not in turns and np.ptp(np.array(turns, dtype=np.float64)) >= LEAST_TURN_RAD:
        said = " and ".join(f"{np.degrees(float(one or 0.0)):g}" for one in turns)
        text = f"{name}: measured at {said} degrees from zenith; what weight does counts as change here"
        yield Doubt("module_turned_meanwhile", text)


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
