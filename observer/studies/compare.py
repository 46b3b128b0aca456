"""Results of one trough at several orientations or dates: what its weight does to it, and what has changed."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from heliogauge.doubts import Doubt, gather_doubts
from heliogauge.errors import EstimationError, InputError
from heliogauge.reporting.notation import number_text
from heliogauge.results.arrays import LabelledArray, read_arrays, write_arrays
from heliogauge.results.folder import Summary, hash_files, read_summary, unit_of, write_table_csv
from heliogauge.results.frame import InstrumentResult
from heliogauge.results.slope_map_file import read_slope_map
from heliogauge.results.tables import read_table_csv
from heliogauge.results.used_results import doubted_results, shared_files
from heliogauge.slopes.grid import resample
from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import FloatArray
from observer.files import (
    ANGLES,
    CHANGED_NUMBERS,
    CHANGED_PANELS,
    COLLECTOR,
    ORIENTATION_CHANGES,
    ORIENTATION_PROFILES,
    ORIENTATION_SAGS,
    OVERVIEW_TABLE,
    is_field,
    read_collector,
    write_collector,
)
from observer.product.changes import NumberChange, PanelChanges, PanelState, number_changes, panel_changes
from observer.product.orientation_study import (
    LEAST_TURN_RAD,
    SpanSags,
    WeightSag,
    change_sigma,
    mirror_change,
    sag_by_weight,
    theta_r_change,
)
from observer.report.figures_modules import CHANGES_TITLE, OneMap, maps_sheet
from observer.report.orientations import Profile, orientation_sheet
from observer.trough.collector import Collector

KIND = "observer-compare"
FIGURE = "orientations.svg"
CHANGES_FIGURE = "theta_r_change.svg"
#: Spans whose supports, and panels whose edges differ by less are the same ones [m].
_SAME_M = 0.05
#: Angles are against the design: another focal length by so much changes them by 5 urad at the rim of a trough [m].
_SAME_FOCAL_M = 1e-5
#: A sag that departs from weight and bend by more than so many sigma is reported.
_DOUBT_TIMES = 3.5


@dataclass(frozen=True, slots=True, eq=False)
class OneOrientation:
    """What the study takes from a result.

    collector: The design.
    profile: The absorber along the trough.
    spans: Columns of ``absorber_spans.csv``.
    slope_map: The mirror; None where only the absorber was measured.
    panels: Angles of its panels; None likewise.
    """

    folder: Path
    summary: Summary
    collector: Collector
    profile: Profile
    spans: dict[str, FloatArray]
    slope_map: SlopeMap | None
    panels: PanelState | None


@dataclass(frozen=True, slots=True, eq=False)
class Comparison(InstrumentResult):
    """Results compared, ready to be written.

    orientations: In the order given; the first is what the others are compared with.
    sags: For each span; None where fewer than two orientations show it.
    maps: All mirrors on the first one's grid.
    changed: Of each other result, how its numbers differ from the first one's.
    turned: Of each other result, how its panels turned; None where one of both has none.
    """

    kind: ClassVar[str] = KIND
    orientations: tuple[OneOrientation, ...]
    sags: tuple[WeightSag | None, ...]
    maps: tuple[SlopeMap | None, ...]
    changed: tuple[tuple[NumberChange, ...], ...]
    turned: tuple[PanelChanges | None, ...]

    @property
    def others(self) -> tuple[str, ...]:
        """What the results are called that are held against the first."""
        return tuple(one.profile.label for one in self.orientations[1:])

    def summarise(self) -> Summary:
        """Collect the headline numbers with their sigmas, doubts and provenance."""
        numbers: dict[str, float | int | None] = {"orientations_count": len(self.orientations)}
        for number, sag in enumerate(self.sags, start=1):
            if sag is not None:
                numbers[f"span_{number}_sag_by_weight_m"] = sag.by_weight_m
                numbers[f"sigma_span_{number}_sag_by_weight_m"] = sag.sigma_by_weight_m
        known = [one for one in self.turned if one is not None]
        if known:
            numbers["panels_turned_count"] = int(np.any([one.is_sure for one in known], axis=0).sum())
        return self._summary(numbers, {"results": ", ".join(one.profile.label for one in self.orientations)})

    def write_files(self, folder: Path) -> None:
        """Write tables and figures into an existing folder."""
        write_table_csv(folder / "orientations.csv", _table(self))
        spans = self.orientations[0].spans
        known = [(k, sag) for k, sag in enumerate(self.sags) if sag is not None]
        columns = {name: [float(spans[name][k]) for k, _ in known] for name in ("from_y_m", "to_y_m")}
        columns |= {name: [getattr(sag, name) for _, sag in known] for name in WeightSag.__slots__}
        write_table_csv(folder / "sag_by_weight.csv", columns)
        sags = [_sags_of(self.orientations, k) for k, _ in known]
        profiles = [one.profile for one in self.orientations]
        changes = mirror_changes(self)
        names = [one.label for one in profiles]
        write_table_csv(folder / ORIENTATION_PROFILES, long_table(profiles, Profile, "y_m", names))
        write_table_csv(
            folder / ORIENTATION_SAGS, long_table(sags, SpanSags, "orientation_rad", [k + 1 for k, _ in known])
        )
        write_table_csv(folder / CHANGED_NUMBERS, number_table(zip(self.others, self.changed, strict=True)))
        turned = [(name, one) for name, one in zip(self.others, self.turned, strict=True) if one is not None]
        parts = [one for _, one in turned]
        write_table_csv(folder / CHANGED_PANELS, long_table(parts, PanelChanges, "panel", [name for name, _ in turned]))
        write_changes(folder / ORIENTATION_CHANGES, changes)
        write_collector(folder / COLLECTOR, self.orientations[0].collector)
        (folder / FIGURE).write_text(orientation_sheet(profiles, sags).svg(), encoding="utf-8")
        if changes:
            (folder / CHANGES_FIGURE).write_text(maps_sheet(changes, CHANGES_TITLE).svg(), encoding="utf-8")

    def headline(self) -> str:
        """Return the most important numbers in a few lines for the terminal."""
        turns = ", ".join(f"{np.degrees(one.profile.orientation_rad):g}" for one in self.orientations)
        lines = [f"{len(self.orientations)} results at {turns} degrees from zenith"]
        for name, changed, turned in zip(self.others, self.changed, self.turned, strict=True):
            lines.append(f"  {name} against {self.orientations[0].profile.label}")
            lines += [f"    {_said(one)}" for one in changed]
            lines += [] if turned is None else [f"    {turned_text(turned)}"]
        for number, sag in enumerate(self.sags, start=1):
            if sag is not None:
                lines.append(
                    f"  span {number}   sag by weight {1e3 * sag.by_weight_m:.2f} "
                    f"+- {1e3 * sag.sigma_by_weight_m:.2f} mm, "
                    f"bend x {1e3 * sag.bend_x_m:.2f} +- {1e3 * sag.sigma_bend_x_m:.2f} mm, "
                    f"z {1e3 * sag.bend_z_m:.2f} +- {1e3 * sag.sigma_bend_z_m:.2f} mm"
                )
        return "\n".join(lines)


def _said(one: NumberChange) -> str:
    name, unit = unit_of(one.key)
    texts = [number_text(value, None, unit, one.key) for value in (one.before, one.after)]
    change = number_text(one.change, one.sigma_change, unit, one.key)
    return f"{name.replace('_', ' ')}: {texts[0]}, then {texts[1]}: changed by {change}"


def turned_text(turned: PanelChanges) -> str:
    """Say which panels turned."""
    numbers = ", ".join(map(str, turned.panel[turned.is_sure]))
    known = int(np.isfinite(turned.theta_r_change_rad).sum())
    if not known:
        return f"no panel of {turned.panel.size} is measured by half in both"
    rest = turned.panel.size - known
    unsaid = f"; of {rest} nothing is known, less than half of each is measured in both" if rest else ""
    if not numbers:
        return f"none of {known} panels surely turned{unsaid}"
    return f"{turned.is_sure.sum()} of {known} panels turned: {numbers}{unsaid}"


def run(folders: Sequence[Path]) -> Comparison:
    """Compare results of one trough, at several orientations or dates.

    folders: Results of ``heliogauge observer measure`` or ``heliogauge observer absorber``, two at least.
    Returns: Sags by weight, profiles, maps on one grid.
    InputError: Fewer than two results, one of them twice, a folder that holds none, or results of different collectors.
    """
    if len(folders) < 2:
        raise InputError(f"observer compare: {len(folders)} result given, two are needed")
    refuse_same(folders)
    found = _with_own_labels([_read(folder) for folder in folders])
    for one in found[1:]:
        refuse_other_collector((found[0].folder, one.folder), (found[0].collector, one.collector))
    sags: list[WeightSag | None] = []
    doubts: list[Doubt] = []
    # Results at one orientation are compared for what changed; of weight they say nothing.
    turned = np.ptp([one.profile.orientation_rad for one in found]) >= LEAST_TURN_RAD
    for number in range(len(found[0].spans["from_y_m"]) if turned else 0):
        try:
            sag = sag_by_weight(_sags_of(found, number))
        except EstimationError as error:
            doubts.append(Doubt("sag_not_determined", f"span {number + 1}: {error}", {"span_number": number + 1}))
            sags.append(None)
            continue
        sags.append(sag)
        if sag.worst_residual > _DOUBT_TIMES:
            text = (
                f"span {number + 1}: a sag is {sag.worst_residual:.1f} sigma beside weight and bend; did the tube move "
                "in its supports, or is an orientation_deg wrong?"
            )
            numbers = {"span_number": number + 1, "residual_over_sigma_ratio": sag.worst_residual}
            doubts.append(Doubt("sag_contradicts_weight", text, numbers))
    first = found[0].slope_map
    maps = tuple(
        one.slope_map if one.slope_map is None or first is None else resample(one.slope_map, first.x_m, first.y_m)
        for one in found
    )
    # All files are called absorber.csv: the number distinguishes them.
    inputs = enumerate((one.folder / "absorber.csv" for one in found), start=1)
    return Comparison(
        found,
        tuple(sags),
        maps,
        tuple(number_changes(found[0].summary.numbers, one.summary.numbers) for one in found[1:]),
        tuple(
            None if found[0].panels is None or one.panels is None else panel_changes(found[0].panels, one.panels)
            for one in found[1:]
        ),
        name=found[0].summary.name,
        doubts=gather_doubts(
            doubted_results({str(one.folder): one.summary for one in found}),
            *(shared_files(found[0].summary, one.summary) for one in found[1:]),
            doubts,
        ),
        input_sha256={f"{k}/{one.name}": next(iter(hash_files([one]).values())) for k, one in inputs},
    )


def refuse_same(folders: Sequence[Path]) -> None:
    """Refuse a result that is given twice: nothing of it could have changed."""
    known: dict[Path, Path] = {}
    for folder in folders:
        if (whole := folder.resolve()) in known:
            raise InputError(
                f"observer compare: {known[whole]} and {folder} are the same result; give results of two measurements"
            )
        known[whole] = folder


def refuse_other_collector(folders: Sequence[Path], collectors: Sequence[Collector]) -> None:
    """Refuse two results whose panels and angles are not of the same things."""
    limits = dict.fromkeys(("aperture_width_m", "length_m", "panel_edges_x_m", "panel_edges_y_m"), _SAME_M)
    for name, limit in {"focal_length_m": _SAME_FOCAL_M, **limits}.items():
        sizes = [np.atleast_1d(getattr(each, name)) for each in collectors]
        if sizes[0].shape != sizes[1].shape or np.abs(sizes[0] - sizes[1]).max() > limit:
            was, now = (", ".join(f"{value:g}" for value in each) for each in sizes)
            raise InputError(
                f"observer compare: results of different collectors: {name} is {was} in {folders[0]} and {now} in "
                f"{folders[1]}; measure both with one design"
            )


def _read(folder: Path) -> OneOrientation:
    if not (folder / "absorber_spans.csv").is_file():
        if is_field(folder):
            raise InputError(_several_modules(folder))
        raise InputError(
            f"{folder}: no absorber_spans.csv; give results of `heliogauge observer measure` or "
            "`heliogauge observer absorber`"
        )
    summary = read_summary(folder / "summary.json")
    if "orientation_rad" not in summary.numbers:
        raise InputError(f"{folder / 'summary.json'}: no orientation_rad; set [collector] orientation_deg, run again")
    names = ("y_m", "x_a_m", "z_a_m", "sigma_x_a_m", "sigma_z_a_m")
    table = _numbers(folder / "absorber.csv", names)
    turn = float(summary.numbers["orientation_rad"] or 0.0)
    label = f"{summary.name} ({np.degrees(turn):g} deg)"
    spans = _numbers(
        folder / "absorber_spans.csv", ("from_y_m", "to_y_m", "sag_x_m", "sag_z_m", "sigma_sag_x_m", "sigma_sag_z_m")
    )
    slopes = folder / "slope_map.nc"
    profile = Profile(label, turn, *(table[name] for name in names))
    collector = read_collector(folder / COLLECTOR)
    return OneOrientation(
        folder,
        summary,
        collector,
        profile,
        spans,
        read_slope_map(slopes) if slopes.is_file() else None,
        read_panels(folder, collector) if (folder / ANGLES).is_file() else None,
    )


def _several_modules(folder: Path) -> str:
    """Say what to give in place of the results of a flight over several modules."""
    table = read_table_csv(folder / OVERVIEW_TABLE, ("result",))
    failed = table.get("failed", [""] * len(table["result"]))
    names = [name for name, reason in zip(table["result"], failed, strict=True) if not reason]
    if not names:
        return f"{folder}: results of several modules, none of which was measured; there is nothing to compare"
    return (
        f"{folder}: results of several modules; compare each with itself: give {folder / names[0]} and the same "
        "module's folder of the other date, or all modules of both dates"
    )


def read_panels(folder: Path, collector: Collector) -> PanelState:
    """Read what a result says of its panels."""
    found, _ = read_arrays(folder / ANGLES, ("x", "y", "theta_r", "theta_ra"))
    sigmas = {name: _sigma_of_measured(folder / "panels.csv", name) for name in ("theta_r", "theta_ra")}
    return PanelState(
        x_m=found["x"],
        y_m=found["y"],
        theta_r_rad=found["theta_r"].astype(np.float64),
        theta_ra_rad=found["theta_ra"].astype(np.float64),
        panel=collector.panel_index(*np.meshgrid(found["x"], found["y"])),
        sigma_theta_r_rad=sigmas["theta_r"],
        sigma_theta_ra_rad=sigmas["theta_ra"],
    )


def _sigma_of_measured(path: Path, angle: str) -> FloatArray:
    """Return the sigma of the mean of what was measured of each panel: both results are compared at the same nodes."""
    mean, unmeasured = f"sigma_mean_{angle}_rad", f"sigma_unmeasured_{angle}_rad"
    sigma = _numbers(path, (mean,))[mean]
    # Results of before had no such share.
    if unmeasured not in read_table_csv(path, (mean,)):
        return sigma
    return np.sqrt(np.maximum(sigma**2 - _numbers(path, (unmeasured,))[unmeasured] ** 2, 0.0))


def _with_own_labels(found: Sequence[OneOrientation]) -> tuple[OneOrientation, ...]:
    """Return results with labels that tell them apart: with their folders where name and orientation are the same."""
    labels = [one.profile.label for one in found]
    if len(set(labels)) == len(labels):
        return tuple(found)
    return tuple(
        replace(
            one, profile=replace(one.profile, label=f"{one.folder} ({np.degrees(one.profile.orientation_rad):g} deg)")
        )
        for one in found
    )


def _numbers(path: Path, names: Sequence[str]) -> dict[str, FloatArray]:
    table = read_table_csv(path, names)
    try:
        return {name: np.array([float(cell) if cell else np.nan for cell in table[name]]) for name in names}
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None


def _sags_of(found: Sequence[OneOrientation], number: int) -> SpanSags:
    """Collect the sags of one span of the first result from all results that have it."""
    ends = [found[0].spans[name][number] for name in ("from_y_m", "to_y_m")]
    rows = []
    for one in found:
        if not one.spans["from_y_m"].size:
            continue
        apart = np.hypot(one.spans["from_y_m"] - ends[0], one.spans["to_y_m"] - ends[1])
        same = int(np.argmin(apart))
        values = [one.spans[name][same] for name in ("sag_x_m", "sag_z_m", "sigma_sag_x_m", "sigma_sag_z_m")]
        if apart[same] < _SAME_M and np.isfinite(values).all():
            rows.append([one.profile.orientation_rad, *values])
    return SpanSags(*np.array(rows).reshape(-1, 5).T)


def mirror_changes(result: Comparison) -> list[OneMap]:
    """Return how theta_r changes from the first orientation to the others, without its mean.

    Returns: One for each other orientation whose mirror was measured.
    """
    found, first = [], result.maps[0]
    for one, other in zip(result.orientations[1:], result.maps[1:], strict=True):
        if first is not None and other is not None:
            change = theta_r_change(first, other)
            mean = np.nanmean(change) if np.isfinite(change).any() else 0.0
            sigma = np.where(np.isfinite(change), change_sigma(first, other), np.nan)
            found.append(OneMap(one.profile.label, other.x_m, other.y_m, np.asarray(change - mean), sigma))
    return found


def long_table(parts: Sequence[Any], kind: type, size: str, names: Sequence[str | int]) -> dict[str, list[Any]]:
    """Return values of several dataclasses of a kind below each other; the first column says whose they are."""
    own = [one.name for one in fields(kind) if one.name != "label"]
    columns: dict[str, list[Any]] = {"of": [], **{name: [] for name in own}}
    for label, part in zip(names, parts, strict=True):
        n = getattr(part, size).size
        columns["of"] += [label] * n
        for name in own:
            value = getattr(part, name)
            values = value.astype(int) if isinstance(value, np.ndarray) and value.dtype == bool else value
            columns[name].extend(np.broadcast_to(values, n).tolist())
    return columns


def number_table(parts: Iterable[tuple[str, Sequence[NumberChange]]]) -> dict[str, list[Any]]:
    """Return the changes of numbers below each other; the first column says whose they are."""
    rows = [(name, one) for name, changes in parts for one in changes]
    columns: dict[str, list[Any]] = {"of": [name for name, _ in rows]}
    return columns | {field.name: [getattr(one, field.name) for _, one in rows] for field in fields(NumberChange)}


def write_changes(path: Path, changes: Sequence[OneMap]) -> None:
    """Write maps of the mirror's change."""
    if not changes:
        return
    arrays = [
        LabelledArray("y", ("y",), changes[0].y_m, "m", "along the trough"),
        LabelledArray("x", ("x",), changes[0].x_m, "m", "across the aperture"),
    ]
    for k, one in enumerate(changes, start=1):
        text = f"theta_r minus that of the first orientation, without its mean: {one.name}"
        arrays.append(LabelledArray(f"theta_r_change_{k}", ("y", "x"), one.angle_rad.astype(np.float32), "rad", text))
        if one.sigma_rad is not None:
            words = f"standard deviation of theta_r_change_{k} from the noise of both maps"
            name = f"sigma_theta_r_change_{k}"
            arrays.append(LabelledArray(name, ("y", "x"), one.sigma_rad.astype(np.float32), "rad", words))
    write_arrays(path, arrays, {"orientations": [one.name for one in changes]})


def _table(result: Comparison) -> dict[str, list[float | str]]:
    """Return one row for each orientation: the absorber's numbers, and the mirror's change against the first."""
    names = (
        "absorber_mean_x_m",
        "sigma_absorber_mean_x_m",
        "absorber_mean_z_offset_m",
        "sigma_absorber_mean_z_offset_m",
        "absorber_tilt_x_rad",
        "absorber_tilt_z_rad",
        "absorber_sag_down_m",
        "sigma_absorber_sag_down_m",
    )
    rows: list[dict[str, float | str]] = []
    for one, other in zip(result.orientations, result.maps, strict=True):
        numbers = one.summary.numbers
        row: dict[str, float | str] = {
            "result": one.folder.name,
            "orientation_deg": round(float(np.degrees(one.profile.orientation_rad)), 6),
        }
        values = {name: numbers.get(name) for name in names}
        row |= {name: np.nan if value is None else float(value) for name, value in values.items()}
        change = None if other is None or result.maps[0] is None else mirror_change(result.maps[0], other)
        row["theta_r_turned_rad"] = np.nan if change is None else change.tilt_rad
        row["theta_r_change_rms_rad"] = np.nan if change is None else change.rms_rad
        row["theta_r_change_noise_rad"] = np.nan if change is None else change.noise_rad
        rows.append(row)
    return {name: [row[name] for row in rows] for name in rows[0]}
