"""A result of the Observer to a prescription: how far each mount of each panel is to be moved."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.doubts import Doubt, gather_doubts
from heliogauge.errors import InputError
from heliogauge.files.faults import explain_faults
from heliogauge.reporting.notation import light_text
from heliogauge.results.arrays import read_arrays
from heliogauge.results.folder import SUMMARY_FILE, PhotoPose, Summary, hash_files, read_summary, write_table_csv
from heliogauge.results.frame import InstrumentResult
from heliogauge.results.slope_map_file import read_slope_map, slope_map_in
from heliogauge.results.tables import read_cameras_json, read_table_csv
from heliogauge.results.used_results import doubted_results
from heliogauge.slopes.map import SlopeMap
from heliogauge.slopes.mounts import LEAST_SHARE
from heliogauge.validate import BoolArray, FloatArray, IntArray
from heliogauge.view.contours import zero_lines
from heliogauge.view.stills import Sheet
from observer.files import (
    ALIGNMENT_MOVES,
    ALIGNMENT_OVERLAY,
    ANGLES,
    COLLECTOR,
    OVERLAY,
    OVERLAY_PHOTO,
    OVERLAY_STEM,
    read_absorber,
    read_collector,
    read_overlay,
    write_collector,
)
from observer.product.panel_alignment import MOUNT_INSET_M, PanelTilts, image_edges, mount_moves, panel_tilts
from observer.product.panel_turns import TurnAdvice, turn_advice
from observer.report.figures_alignment import moves_sheet, theory_sheet
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector

KIND = "observer-alignment"
#: Number of the first panel in all files and texts, as in the panels.csv of the measurement: with a prescription that
#: counted from 0 the neighbour of the panel that the report shows was shimmed.
_FIRST_PANEL = 1


@dataclass(frozen=True, eq=False)
class TurnGains:
    """What turning each panel to mean theta_ra zero gains.

    gain_ratio, sigma_gain_ratio (k,): Share of the trough's light with its standard deviation; NaN where not known.
    sure (k,): Which panels surely gain.
    """

    gain_ratio: FloatArray
    sigma_gain_ratio: FloatArray
    sure: BoolArray

    @cached_property
    def advice(self) -> tuple[TurnAdvice, ...]:
        """What to do with each panel."""
        return turn_advice(self.gain_ratio, self.sigma_gain_ratio, self.sure)

    def columns(self, panel: IntArray) -> dict[str, Any]:
        """Return columns of a table whose rows belong to these panels."""
        return {
            "gain_ratio": self.gain_ratio[panel],
            "sigma_gain_ratio": self.sigma_gain_ratio[panel],
            "gain_is_sure": self.sure[panel].astype(int),
            "turn": [str(self.advice[one]) for one in panel],
        }


@dataclass(frozen=True, slots=True, eq=False)
class Result(InstrumentResult):
    """A prescription.

    collector: The design with its panels.
    to_absorber, to_design: Mean angles of the panels against the absorber as it is, and against the design's focal
        line.
    mounts_m (n, 2): x and y of the mounts [m].
    absorber: The tube's axis.
    cameras: Photos on which the theoretical image is laid.
    gains: What turning each panel gains, as the measurement has it; None where it did not compute that.
    picture: The theoretical image over the photo that the result holds; None where it holds none.
    pictures: The same over each photo, by its name, where the panels were measured in them alone.
    """

    kind: ClassVar[str] = KIND
    collector: Collector
    to_absorber: PanelTilts
    to_design: PanelTilts
    mounts_m: FloatArray
    absorber: AbsorberPath
    cameras: dict[str, tuple[Camera, PhotoPose]]
    gains: TurnGains | None = None
    picture: Sheet | None = None
    pictures: Mapping[str, Sheet] = field(default_factory=dict)

    def summarise(self) -> Summary:
        """Collect the headline numbers with their sigmas, doubts and provenance."""
        tilt = self.to_absorber.tilt_rad
        known = tilt[np.isfinite(tilt)]
        move = mount_moves(self.to_absorber, self.mounts_m, self.collector).move_m
        largest = 1e3 * float(np.nanmax(np.abs(move))) if np.isfinite(move).any() else None
        numbers = {
            "panels_count": tilt.size,
            "panels_prescribed_count": known.size,
            "rms_panel_theta_ra_rad": float(np.sqrt(np.mean(known**2))) if known.size else None,
            "largest_move_mm": largest,
        }
        reasons = {key: "no panel is measured well enough" for key, value in numbers.items() if value is None}
        texts = {
            "sign": "moves along the mirror's normal, positive towards the absorber; panels turn about their middles"
        }
        return self._summary(numbers, texts, reasons)

    def write_files(self, folder: Path) -> None:
        """Write panels.csv, mounts.csv, overlay.csv and two figures into an existing folder."""
        absorber, design = self.to_absorber, self.to_design
        write_table_csv(
            folder / "panels.csv",
            {
                "panel": _FIRST_PANEL + np.arange(absorber.tilt_rad.size),
                "x_m": absorber.centre_x_m,
                "y_m": absorber.centre_y_m,
                "theta_ra_rad": absorber.tilt_rad,
                "sigma_theta_ra_rad": absorber.sigma_rad,
                "theta_r_rad": design.tilt_rad,
                "sigma_theta_r_rad": design.sigma_rad,
                "measured_share": absorber.measured_share,
                **({} if self.gains is None else self.gains.columns(np.arange(absorber.tilt_rad.size))),
            },
        )
        moves = mount_moves(absorber, self.mounts_m, self.collector)
        to_design = mount_moves(design, self.mounts_m, self.collector)
        write_table_csv(
            folder / "mounts.csv",
            {
                "panel": _FIRST_PANEL + moves.panel,
                "x_m": self.mounts_m[:, 0],
                "y_m": self.mounts_m[:, 1],
                "move_mm": 1e3 * moves.move_m,
                "sigma_move_mm": 1e3 * moves.sigma_m,
                "move_to_design_mm": 1e3 * to_design.move_m,
                "sigma_move_to_design_mm": 1e3 * to_design.sigma_m,
                **({} if self.gains is None else self.gains.columns(moves.panel)),
            },
        )
        write_table_csv(folder / "overlay.csv", _overlay(self))
        write_collector(folder / COLLECTOR, self.collector)
        if self.picture is not None:
            (folder / ALIGNMENT_OVERLAY).write_text(self.picture.svg(), encoding="utf-8")
        for name, sheet in self.pictures.items():
            (folder / f"{OVERLAY_STEM}{Path(name).stem}.svg").write_text(sheet.svg(), encoding="utf-8")
        drawn = moves_sheet(
            self.collector,
            absorber.tilt_rad,
            self.mounts_m,
            (moves.move_m, moves.sigma_m),
            None if self.gains is None else self.gains.advice,
        )
        (folder / ALIGNMENT_MOVES).write_text(drawn.svg(), encoding="utf-8")

    def headline(self) -> str:
        """Return the most important numbers in a few lines for the terminal."""
        tilt, sigma = self.to_absorber.tilt_rad, self.to_absorber.sigma_rad
        known = np.isfinite(tilt)
        if not known.any():
            return "no panel is measured well enough for a prescription"
        rms = 1e3 * float(np.sqrt(np.mean(tilt[known] ** 2)))
        worst = int(np.nanargmax(np.abs(tilt)))
        move = mount_moves(self.to_absorber, self.mounts_m, self.collector).move_m
        said, spread = 1e3 * tilt[worst], 1e3 * sigma[worst]
        largest = 1e3 * float(np.nanmax(np.abs(move)))
        return (
            f"{known.sum()} of {tilt.size} panels: mean angle to the absorber {rms:.2f} mrad RMS\n"
            f"  worst            panel {_FIRST_PANEL + worst}: {said:+.2f} +- {spread:.2f} mrad\n"
            f"  largest move     {largest:.2f} mm (mounts.csv; positive towards the absorber)"
            + ("" if self.gains is None else f"\n  worth a turn     {_worth_text(self.gains)}")
        )


def _worth_text(gains: TurnGains) -> str:
    """Say which panels to turn, the largest gain first, and how many not."""
    best = [int(k) for k in np.argsort(-np.nan_to_num(gains.gain_ratio)) if gains.advice[k] is TurnAdvice.TURN]
    named = ", ".join(
        f"{_FIRST_PANEL + k} ({light_text(float(gains.gain_ratio[k]), float(gains.sigma_gain_ratio[k]))})" for k in best
    )
    counts = Counter(gains.advice)
    others = ", ".join(f"{counts[kind]} {kind}" for kind in list(TurnAdvice)[1:] if counts[kind])
    return "; ".join(text for text in (f"panel {named}" if best else "no panel", others) if text)


def run(folder: Path, mounts: Path | None = None) -> Result:
    """Prescribe how the panels of a measured trough are to be aligned.

    mounts: Table with the columns x_m, y_m of all mounts; without it four mounts are assumed near the corners of
        each panel.
    Returns: Mean angles of the panels, and what the mounts need.
    """
    names = (ANGLES, COLLECTOR, "absorber.csv", "cameras.json", "panels.csv")
    files = [slope_map_in(folder), *(folder / name for name in names)]
    missing = [file.name for file in files if not file.is_file()]
    if missing:
        raise InputError(
            f"{folder}: there is no {missing[0]}; give the folder that `heliogauge observer measure` wrote"
        )
    slope_map, collector = read_slope_map(files[0]), read_collector(files[2])
    angles, _ = read_arrays(files[1], ("theta_ra", "theta_r"))
    theta_ra, theta_r = (np.asarray(angles[name], dtype=np.float64) for name in ("theta_ra", "theta_r"))
    sigma_ra, sigma_r = _read_sigmas(files[5], collector.n_panels)
    gains = _read_gains(files[5])
    cameras, poses = read_cameras_json(files[4])
    to_absorber = panel_tilts(theta_ra, slope_map, collector, sigma_ra)
    places = mount_places(collector, mounts)
    absorber = read_absorber(files[3])
    picture = None
    if (folder / OVERLAY).is_file() and (folder / OVERLAY_PHOTO).is_file():
        picture = _picture(folder, slope_map, collector, absorber, poses)
    return Result(
        collector,
        to_absorber,
        panel_tilts(theta_r, slope_map, collector, sigma_r),
        places,
        absorber,
        {name: (cameras[pose.camera], pose) for name, pose in poses.items()},
        gains,
        picture,
        name="panel alignment",
        doubts=gather_doubts(_handed_on(folder), _doubts(slope_map, to_absorber, mounts is None)),
        input_sha256=hash_files([*files, *([] if mounts is None else [mounts])]),
    )


def _picture(
    folder: Path, slope_map: SlopeMap, collector: Collector, absorber: AbsorberPath, poses: dict[str, PhotoPose]
) -> Sheet | None:
    """Draw the theoretical image over the photo that the result holds."""
    from scipy.interpolate import RegularGridInterpolator

    image, nodes, name = read_overlay(folder)
    if name not in poses:
        return None
    x, y = (
        axis[np.unique(np.linspace(0, axis.size - 1, count).round().astype(int))]
        for axis, count in zip((slope_map.x_m, slope_map.y_m), nodes["x_px"].shape[::-1], strict=True)
    )
    pixels = np.stack([nodes["x_px"], nodes["y_px"]], axis=-1)
    with explain_faults(folder / OVERLAY, "a grid over the map of slopes"):
        where = RegularGridInterpolator((y, x), pixels, bounds_error=False)
    gap = collector.panel_gap_m / 2
    ends = np.stack([collector.panel_edges_y_m[:-1] + gap, collector.panel_edges_y_m[1:] - gap], axis=1)
    lines = []
    for low, high in ends:
        along = np.clip(np.linspace(low, high, 9), y[0], y[-1])
        eye = poses[name].cam_from_world.inverse().translation_m
        found = image_edges(eye, along, collector, absorber)
        columns = found.reshape(along.size, -1).T
        lines += [where(np.stack([along, column], axis=1)) for column in columns if np.isfinite(column).all()]
    measured = zero_lines(nodes["x_px"], nodes["y_px"], nodes["beside_measured"])
    return theory_sheet(image, name, lines, measured)


def mount_places(collector: Collector, mounts: Path | None) -> FloatArray:
    """Return the places of all mounts, shape (n, 2): of a table, or assumed near the corners of each panel [m].

    InputError: A table that cannot be read.
    """
    return _corners(collector) if mounts is None else _read_mounts(mounts)


def _corners(collector: Collector) -> FloatArray:
    x, y = collector.panel_edges_x_m, collector.panel_edges_y_m
    inset_x, inset_y = np.minimum(MOUNT_INSET_M, np.diff(x) / 4), np.minimum(MOUNT_INSET_M, np.diff(y) / 4)
    across = np.sort(np.concatenate([x[:-1] + inset_x, x[1:] - inset_x]))
    along = np.sort(np.concatenate([y[:-1] + inset_y, y[1:] - inset_y]))
    grid = np.meshgrid(across, along)
    return np.stack([grid[0].ravel(), grid[1].ravel()], axis=1)


def _read_sigmas(path: Path, n_panels: int) -> tuple[FloatArray, FloatArray]:
    """Return the sigmas of the panels' mean theta_ra and theta_r: with the noise that neighbouring nodes share."""
    names = ("sigma_mean_theta_ra_rad", "sigma_mean_theta_r_rad")
    table = read_table_csv(path, ("panel", *names))
    first, second = (np.array([float(cell) if cell else np.nan for cell in table[name]]) for name in names)
    if first.size != n_panels:
        raise InputError(f"{path}: {first.size} panels, but {COLLECTOR} has {n_panels}; measure again")
    return first, second


def _read_gains(path: Path) -> TurnGains | None:
    """Return what turning panels gains; None where the measurement did not compute it."""
    table = read_table_csv(path, ("panel",))
    if "gain_is_sure" not in table:
        return None
    gain, sigma = (
        np.array([float(cell) if cell else np.nan for cell in table[name]])
        for name in ("gain_ratio", "sigma_gain_ratio")
    )
    return TurnGains(gain, sigma, np.array(table["gain_is_sure"]) == "1")


def _read_mounts(path: Path) -> FloatArray:
    table = read_table_csv(path, ("x_m", "y_m"))
    try:
        places = np.array([table["x_m"], table["y_m"]], dtype=np.float64).T
    except ValueError as error:
        raise InputError(f"{path}: x_m and y_m must be numbers in every row ({error})") from None
    if places.size == 0 or not np.isfinite(places).all():
        raise InputError(f"{path}: every mount needs x_m and y_m, and there must be one at least")
    return places


def _doubts(slope_map: SlopeMap, tilts: PanelTilts, assumed: bool) -> Iterator[Doubt]:
    if tilts.tilt_rad.size == 1:
        yield Doubt(
            "panel_edges_missing",
            "collector.panel_edges_x_m and panel_edges_y_m are not given: the mirror is taken for one panel",
        )
    unknown = int(np.isnan(tilts.tilt_rad).sum())
    if unknown:
        yield Doubt(
            "panels_without_prescription",
            f"{unknown} of {tilts.tilt_rad.size} panels are measured on less than {100 * LEAST_SHARE:.0f} %: "
            "no prescription for them",
            {"unknown_count": unknown, "panels_count": tilts.tilt_rad.size},
        )
    if assumed:
        yield assumed_mounts()
    if slope_map.removed != "nothing":
        text = f"the slope map has {slope_map.removed} removed; the prescription lacks it"
        yield Doubt("slope_map_not_as_measured", text)


def _handed_on(folder: Path) -> tuple[Doubt, ...]:
    file = folder / SUMMARY_FILE
    return doubted_results({str(folder): read_summary(file)}) if file.is_file() else ()


def assumed_mounts() -> Doubt:
    """Say that nobody stated where the mounts are."""
    text = f"no table of mounts: they are assumed {1e3 * MOUNT_INSET_M:.0f} mm inside each panel's corners"
    return Doubt("mounts_assumed", text, {"inset_m": MOUNT_INSET_M})


def _overlay(result: Result) -> dict[str, list[Any]]:
    """Return the corners of the theoretical image in each panel and photo: both edges at both ends."""
    collector = result.collector
    low, high = collector.panel_edges_y_m[:-1], collector.panel_edges_y_m[1:]
    gap = collector.panel_gap_m / 2
    rows = np.stack([low + gap, high - gap], axis=1).ravel()
    n_columns = len(collector.panel_edges_x_m) - 1
    table: dict[str, list[Any]] = {name: [] for name in ("image", "panel", "edge", "x_m", "y_m", "column_px", "row_px")}
    for image, (camera, pose) in result.cameras.items():
        found = image_edges(pose.cam_from_world.inverse().translation_m, rows, collector, result.absorber)
        row, column, edge = np.nonzero(np.isfinite(found))
        x, y = found[row, column, edge], rows[row]
        points = np.stack([x, y, x**2 / (4 * collector.focal_length_m)], axis=1)
        pixels = camera.project(pose.cam_from_world.apply(points))
        panel = _FIRST_PANEL + row // 2 * n_columns + column
        values = (panel, 2 * edge - 1, x, y, pixels[:, 0], pixels[:, 1])
        table["image"].extend([image] * x.size)
        for name, part in zip(list(table)[1:], values, strict=True):
            table[name].extend(part.tolist())
    return table
