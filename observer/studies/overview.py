"""Results of several modules side by side: one table and one page for a flight over a field (QFly)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from heliogauge.doubts import Doubt, Severity, gather_doubts
from heliogauge.errors import InputError
from heliogauge.results.arrays import read_arrays
from heliogauge.results.folder import Summary, hash_files, read_summary, read_table_csv, write_table_csv
from heliogauge.results.frame import InstrumentResult
from heliogauge.validate import FloatArray
from observer.files import ANGLES, OVERVIEW_LOOPS, OVERVIEW_MAPS, OVERVIEW_TABLE, OVERVIEW_TURNS, ModuleMap, write_maps

#: Kind of the summary, which names its report.
KIND = "observer-overview"
#: A map of the overview has this many nodes along a side at most.
_MOST_NODES = 160
#: Numbers of each module in the summary.
_FACET_KEYS = (
    "rms_theta_r_rad",
    "sigma_rms_theta_r_rad",
    "rms_theta_ra_rad",
    "sigma_rms_theta_ra_rad",
    "intercept_ratio",
    "sigma_intercept_ratio",
    "measured_share",
)
#: Modules that a doubt names.
_SHOWN = 5
#: What the work list takes from the table of a module's panels.
_PANEL_COLUMNS = (
    "centre_x_m",
    "centre_y_m",
    "mean_theta_ra_rad",
    "sigma_mean_theta_ra_rad",
    "mount_move_m",
    "sigma_mount_move_m",
    "gain_ratio",
    "sigma_gain_ratio",
    "gain_is_sure",
)
#: Numbers of which a loop has the RMS over its modules.
_POOLED = ("rms_theta_r_rad", "rms_theta_ra_rad")


@dataclass(frozen=True, slots=True, eq=False)
class Result(InstrumentResult):
    """Summaries of modules.

    folders: Results, in the order given.
    labels: What each is called: its folder, as given or relative to the overview's.
    modules: What each says.
    failed: Modules that could not be measured, with the reason.
    places_m: Where modules are in the common frame, by label, shape (3,) [m].
    loops: The loop of each module that has one, by label.
    """

    kind: ClassVar[str] = KIND
    folders: tuple[Path, ...]
    labels: tuple[str, ...]
    modules: tuple[Summary, ...]
    failed: Mapping[str, str] = field(default_factory=dict)
    places_m: Mapping[str, FloatArray] = field(default_factory=dict)
    loops: Mapping[str, str] = field(default_factory=dict)

    def summarise(self) -> Summary:
        """Collect the headline numbers of all modules."""
        facets = {
            label: {key: value for key in _FACET_KEYS if (value := module.numbers.get(key)) is not None}
            for label, module in zip(self.labels, self.modules, strict=True)
        }
        return self._summary(
            {"modules_count": len(self.modules), "failed_count": len(self.failed)},
            {"sign": "theta_ra and theta_r positive where the mirror's normal is turned towards +x"},
            facets=facets,
        )

    def write_files(self, folder: Path) -> None:
        """Write overview.csv, overview.nc and what follows from them into an existing folder."""
        write_table_csv(folder / OVERVIEW_TABLE, _table(self))
        turns = _turns(self)
        if turns is not None:
            write_table_csv(folder / OVERVIEW_TURNS, turns)
        if self.loops:
            write_table_csv(folder / OVERVIEW_LOOPS, _loops(self))
        maps = [_read_map(one, label) for one, label in zip(self.folders, self.labels, strict=True)]
        write_maps(folder / OVERVIEW_MAPS, [one for one in maps if one is not None])

    def headline(self) -> str:
        """Return each module's most important numbers in a line."""
        lines = []
        for label, module in zip(self.labels, self.modules, strict=True):
            slope, aimed, kept = (
                module.numbers.get(key) for key in ("rms_theta_r_rad", "rms_theta_ra_rad", "intercept_ratio")
            )
            said = [f"theta_r {1e3 * slope:.2f} mrad RMS" if slope is not None else "no slopes"]
            said += [f"theta_ra {1e3 * aimed:.2f} mrad RMS"] if aimed is not None else []
            said += [f"intercept factor {kept:.4f}"] if kept is not None else []
            said += [f"{len(module.doubts)} warning{'s' if len(module.doubts) > 1 else ''}"] if module.doubts else []
            name = label if label == module.name else f"{label} ({module.name})"
            lines.append(f"{name}: {', '.join(said)}")
        return "\n".join([*lines, *(f"{name}: not measured" for name in self.failed)])


def run(
    folders: Sequence[Path],
    *,
    base: Path | None = None,
    places_m: Mapping[str, FloatArray] | None = None,
    loops: Mapping[str, str] | None = None,
    failed: Mapping[str, str] | None = None,
) -> Result:
    """Collect results of ``heliogauge observer measure``.

    base: Folder that their names are given from.
    places_m: Where modules are in a common frame, by their names from there [m].
    loops: Their loops, by these names; by default the folders in which results lie, where these are several.
    failed: Modules that could not be measured, with the reason.
    InputError: A folder that holds no result of the Observer, or the same folder twice.
    """
    if len({folder.resolve() for folder in folders}) < len(folders):
        raise InputError("overview: the same result is given twice")
    modules = tuple(read_summary(folder) for folder in folders)
    for folder, module in zip(folders, modules, strict=True):
        if module.kind == KIND:
            names = ", ".join(str(folder / name) for name in [*module.facets][:2])
            raise InputError(f"{folder}: an overview itself; give the results of its modules: {names} ...")
        if module.kind != "observer":
            raise InputError(
                f'{folder}: a result of kind "{module.kind}"; results of `heliogauge observer measure` are needed'
            )
    labels = tuple(str(folder if base is None else folder.relative_to(base)) for folder in folders)
    not_measured = (
        Doubt("module_not_measured", f"{name}: not measured: {reason}") for name, reason in (failed or {}).items()
    )
    # All files are called summary.json: the folder distinguishes them.
    hashes = {
        str(folder / name): digest
        for folder in folders
        for name, digest in hash_files([folder / "summary.json"]).items()
    }
    return Result(
        tuple(folders),
        labels,
        modules,
        failed or {},
        places_m or {},
        _folders_as_loops(folders, labels) if loops is None else loops,
        name="overview",
        doubts=gather_doubts(not_measured, _doubtful(labels, modules)),
        input_sha256=hashes,
    )


def _folders_as_loops(folders: Sequence[Path], labels: Sequence[str]) -> dict[str, str]:
    above = [folder.resolve().parent for folder in folders]
    if len(set(above)) < 2:
        return {}
    same_name = len({folder.name for folder in above}) < len(set(above))
    return {label: str(folder) if same_name else folder.name for label, folder in zip(labels, above, strict=True)}


def _doubtful(labels: Sequence[str], modules: Sequence[Summary]) -> list[Doubt]:
    """Return what is doubtful of modules, each cause once with those that have it; notes stay in their reports."""
    causes: dict[str, dict[str, Doubt]] = {}
    for label, module in zip(labels, modules, strict=True):
        for one in module.doubts:
            if one.severity is not Severity.NOTE:
                causes.setdefault(one.code, {}).setdefault(label, one)
    found = []
    for own in causes.values():
        first = next(iter(own))
        worst = max((one.severity for one in own.values()), key=list(Severity).index)
        some = ", ".join(list(own)[1 : _SHOWN + 1]) + (" ..." if len(own) > _SHOWN + 1 else "")
        said = f"{first}: {own[first]}"
        if len(own) > 1:
            said = f"in {len(own)} of {len(modules)} modules {own[first]} (numbers of {first}; the others: {some})"
        found.append(Doubt("module_doubtful", said, {"modules_count": len(own)}, worst))
    return found


def _turns(result: Result) -> dict[str, list[Any]] | None:
    """Return the panels of all modules that surely gain by a turn, the largest gain first; None where nobody looked."""
    rows: list[dict[str, Any]] = []
    looked = False
    for folder, label in zip(result.folders, result.labels, strict=True):
        if not (folder / "panels.csv").is_file():
            continue
        own = read_table_csv(folder / "panels.csv", ("panel",))
        if not set(_PANEL_COLUMNS) <= set(own):
            continue
        looked = True
        for k in np.flatnonzero(np.array(own["gain_is_sure"]) == "1").tolist():
            number = {key: float(own[key][k]) for key in _PANEL_COLUMNS}
            rows.append(
                {
                    "result": label,
                    "loop": result.loops.get(label, ""),
                    "panel": int(own["panel"][k]),
                    "centre_x_m": number["centre_x_m"],
                    "centre_y_m": number["centre_y_m"],
                    "turn_rad": -number["mean_theta_ra_rad"],
                    "sigma_turn_rad": number["sigma_mean_theta_ra_rad"],
                    "mount_move_m": number["mount_move_m"],
                    "sigma_mount_move_m": number["sigma_mount_move_m"],
                    "gain_ratio": number["gain_ratio"],
                    "sigma_gain_ratio": number["sigma_gain_ratio"],
                }
            )
    rows.sort(key=lambda row: -float(row["gain_ratio"]))
    names = list(rows[0]) if rows else ["result", "loop", "panel", "turn_rad", "gain_ratio"]
    return {name: [row[name] for row in rows] for name in names} if looked else None


def _loops(result: Result) -> dict[str, list[Any]]:
    """Return a row for each loop, and one for all modules."""
    own = [result.loops.get(label, "") for label in result.labels]
    rows = []
    for name in [*dict.fromkeys(own), "all"]:
        modules = [one for one, loop in zip(result.modules, own, strict=True) if name in (loop, "all")]
        slope, aimed, kept, gain, turns = (
            np.array([value for one in modules if (value := one.numbers.get(key)) is not None], dtype=np.float64)
            for key in (*_POOLED, "intercept_ratio", "intercept_gain_panels_turned_ratio", "panels_to_turn_count")
        )
        rows.append(
            {
                "loop": name,
                "modules_count": len(modules),
                **{key: _mean(one**2) ** 0.5 for key, one in zip(_POOLED, (slope, aimed), strict=True)},
                "intercept_ratio": _mean(kept),
                "lowest_intercept_ratio": float(kept.min()) if kept.size else np.nan,
                "intercept_gain_panels_turned_ratio": _mean(gain),
                "panels_to_turn_count": int(turns.sum()),
            }
        )
    return {name: [row[name] for row in rows] for name in rows[0]}


def _mean(values: FloatArray) -> float:
    return float(values.mean()) if values.size else np.nan


def _table(result: Result) -> dict[str, list[Any]]:
    """Return a row for each module, those that failed at the end."""
    keys = list(dict.fromkeys(key for module in result.modules for key in module.numbers))
    none = [""] * len(result.failed)
    columns: dict[str, list[Any]] = {
        "result": [*result.labels, *result.failed],
        "name": [*(module.name for module in result.modules), *result.failed],
        "failed": [*([""] * len(result.modules)), *result.failed.values()],
        "warnings": [*(len(module.doubts) for module in result.modules), *none],
    }
    labels = columns["result"]
    if result.loops:
        columns["loop"] = [result.loops.get(label, "") for label in labels]
    if result.places_m:
        for k, axis in enumerate("xyz"):
            own = [result.places_m.get(label) for label in labels]
            columns[f"place_{axis}_m"] = ["" if one is None else float(one[k]) for one in own]
    for key in keys:
        values = [module.numbers.get(key) for module in result.modules]
        columns[key] = [*("" if value is None else value for value in values), *none]
    return columns


def _read_map(folder: Path, label: str) -> ModuleMap | None:
    """Return a module's angles, coarse; None where there are none."""
    if not (folder / ANGLES).is_file():
        return None
    found, _ = read_arrays(folder / ANGLES, ("x", "y", "theta_ra", "theta_r"))
    odd = [name for name, one in found.items() if one.dtype.kind not in "iuf"]
    if odd:
        raise InputError(f"{folder / ANGLES}: {odd[0]} holds {found[odd[0]].dtype}, not numbers; copy the file again")
    steps = tuple(max(-(-found[axis].size // _MOST_NODES), 1) for axis in "yx")
    angles = [found[name][:: steps[0], :: steps[1]] for name in ("theta_ra", "theta_r")]
    return ModuleMap(label, found["x"][:: steps[1]], found["y"][:: steps[0]], *angles)
