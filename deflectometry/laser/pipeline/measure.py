"""A laser scan to its slope map: the stages follow each other in `run`."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from deflectometry.exchange.measure_slopes import grid_points
from deflectometry.exchange.slope_points import SlopePoints
from deflectometry.laser.instrument_by_curl import InstrumentByCurl, hear_curl
from deflectometry.laser.keys import LaserMeasurement, LaserModel
from deflectometry.laser.line_sweep import CrossedLines
from deflectometry.laser.pipeline.scan_file import read_lines, read_scan
from deflectometry.laser.scan import LaserScan
from deflectometry.laser.scan_slopes import LaserSigmas, ScanSlopes, solve_scan
from deflectometry.pipeline.choices import Options
from deflectometry.pipeline.design_check import doubts_of_amount, other_design
from deflectometry.pipeline.headline import Numbers, facet_numbers, headline_text, reasons
from deflectometry.shape.smooth_shape import Align, alignment_words
from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import EstimationError
from heliogauge.flags import SampleFlag
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Quadric
from heliogauge.measurement.designs import build_design
from heliogauge.results.folder import Summary, hash_files, write_slope_map
from heliogauge.results.frame import InstrumentResult
from heliogauge.results.tables import write_table_csv
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.slopes.map import SlopeMap
from heliogauge.slopes.removal import Removal, remove
from heliogauge.validate import FlagArray

#: Table of the beams as they were evaluated.
BEAMS_FILE = "beams.csv"
#: Why a beam gives no slope.
_REASONS = {
    SampleFlag.NOT_SEEN: "no spot was seen",
    SampleFlag.NO_INTERSECTION: "the beam does not meet the mirror's surface",
    SampleFlag.OUTLIER: "its slope would be 20 sigma and more from those around it",
}
#: What is common to all spots, and its key in measurement.toml.
_COMMON = {
    "the mirror's distance": "[mirror] sigma_distance_mm",
    "its place": "[mirror] sigma_offset_mm",
    "the laser's place on the target": "[scan] sigma_laser_place_mm",
    "the target's scale": "[scan] sigma_target_scale_permille",
    "the scale of the beams' angles": "[scan] sigma_angle_scale_permille",
    "the roll between both": "[scan] sigma_roll_mrad",
}


#: As for scans of the surface: a stated sigma off by half is not that of these spots.
_SAME_SIGMA = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class LaserResult(InstrumentResult):
    """The slope map of a mirror from a laser scan.

    slope_map: After what was to be removed.
    numbers: Headline numbers.
    scan, found: The beams, and the slopes where they met the mirror.
    instrument: What the curl of the slopes says of the instrument, in words; empty where it says nothing.
    """

    kind: ClassVar[str] = "laser-scan"
    slope_map: SlopeMap
    numbers: Numbers
    scan: LaserScan
    found: ScanSlopes
    instrument: str

    @property
    def flags(self) -> FlagArray:
        """Why a beam gives no slope, shape (n,)."""
        flags = np.where(self.scan.seen, 0, SampleFlag.NOT_SEEN).astype(np.uint32)
        flags[np.isnan(self.found.points_m[0])] |= np.uint32(SampleFlag.NO_INTERSECTION)
        flags[self.found.odd] |= np.uint32(SampleFlag.OUTLIER)
        return flags

    def summarise(self) -> Summary:
        """Collect the headline numbers with their sigmas, doubts and provenance."""
        one, seen = self.slope_map, int(np.count_nonzero(self.flags == 0))
        turn = self.found.solution.cam_from_mirror.rotation_vector_rad
        texts = {
            "design": one.design,
            "removed": one.removed,
            "frame": one.frame,
            "points": f"{seen} of {self.flags.size} beams, interpolated to {one.x_m.size} x {one.y_m.size} nodes",
            "measured share of": f"what {seen} of {self.flags.size} beams came back from; the mirror's size is "
            "not known",
            "turn of the mirror": f"{1e3 * turn[0]:.2f} and {1e3 * turn[1]:.2f} mrad about x and y out of the laser's "
            "frame; a mirror that leans and spots that are all off to one side are one to the slopes",
            "sigma": "1 standard deviation; slopes are those of the normal, a beam turns by twice as much",
        }
        if self.instrument:
            texts["instrument"] = self.instrument
        return self._summary(self.numbers, texts, reasons(self.numbers))

    def write_files(self, folder: Path) -> None:
        """Write map and table of the beams into an existing folder."""
        write_slope_map(folder / "slope_map.nc", {"": self.slope_map}, {"name": self.name})
        found = self.found
        columns = dict(zip(("x_m", "y_m"), found.points_m, strict=True))
        columns |= dict(zip(("slope_x", "slope_y"), found.slopes, strict=True))
        columns |= dict(zip(("sigma_slope_x", "sigma_slope_y"), found.sigmas, strict=True))
        reason = [next((text for flag, text in _REASONS.items() if one & flag), "") for one in self.flags.tolist()]
        write_table_csv(folder / BEAMS_FILE, columns | {"reason": reason})

    def headline(self) -> str:
        """Return the most important numbers in a few lines for the terminal."""
        return headline_text(self.summarise())


def run(measurement: LaserMeasurement, options: Options | None = None, progress: Progress | None = None) -> LaserResult:
    """Find the slopes of a mirror from a laser scan and compare them with the design.

    options: Choices that override the file's; strict refuses spots that would be left out.
    InputError: A table that cannot be read, or a grid that is too fine.
    EstimationError: Beams that miss the mirror, or spots that are not theirs.
    """
    options, progress, model = options or Options(), progress or SilentProgress(), measurement.model
    with progress.stage("read scan"):
        sigma_spot_m = 1e-3 * model.scan.sigma_spot_mm
        lines = None if model.scan.lines_file is None else read_lines(measurement.scan_file, sigma_spot_m)
        scan = read_scan(measurement.scan_file) if lines is None else lines.scan
    one = evaluate_scan(model, scan, options, progress)
    return LaserResult(
        name=model.name,
        slope_map=one.slope_map,
        numbers=one.numbers,
        scan=scan,
        found=one.found,
        instrument="" if one.heard is None else one.heard.words(one.sources),
        doubts=(
            *_doubts(model, scan, one.found, one.heard),
            *_doubts_of_lines(lines),
            *doubts_of_amount(one.numbers, scan.repeated, "beam"),
            *other_design(one.numbers, one.as_measured, "distance and offset of the mirror, and whether x is across"),
        ),
        durations_s=dict(progress.durations_s),
        input_sha256=hash_files(measurement.input_files, measurement.folder),
    )


@dataclass(frozen=True, slots=True, eq=False)
class EvaluatedScan:
    """A scan after its evaluation.

    found: Slopes where the beams met the mirror. heard: What their curl says of the instrument; sources: Names of its
        errors before. as_measured, slope_map: The map with nothing removed, and after what was to be removed.
    """

    found: ScanSlopes
    heard: InstrumentByCurl | None
    sources: tuple[str, ...]
    as_measured: SlopeMap
    slope_map: SlopeMap
    numbers: Numbers


def evaluate_scan(model: LaserModel, scan: LaserScan, options: Options, progress: Progress) -> EvaluatedScan:
    """Find slopes, map and headline numbers of beams and spots.

    InputError, EstimationError: As for `run`.
    """
    section = model.evaluation
    align = options.align or Align(section.align)
    with progress.stage("slopes"):
        place = RigidTransform(np.eye(3), np.array([*model.mirror.offset_m, -model.mirror.distance_m]))
        design = build_design(model.mirror)
        found = solve_scan(scan, design, place, _sigmas(model), align=align is Align.NORMAL)
        if options.strict and found.odd.any():
            raise EstimationError(f"{np.count_nonzero(found.odd)} spots do not fit those around them, with --strict")
    with progress.stage("grid"):
        step_mm = section.grid_step_mm if options.grid_step_mm is None else options.grid_step_mm
        step_m = None if step_mm is None else 1e-3 * step_mm
        sources = found.common.sources
        heard = hear_curl(found, _gridded(found, design, step_m))
        found = found if heard is None else heard.found
        frame = "x to the right, y up seen from the laser, z from the mirror to it"
        as_measured = replace(_gridded(found, design, step_m), frame=frame, removed=alignment_words(align, 1))
    with progress.stage("statistics"):
        slope_map = remove(as_measured, options.remove or Removal(section.remove))
        numbers = facet_numbers(slope_map, as_measured)
    return EvaluatedScan(found, heard, sources, as_measured, slope_map, numbers)


def _sigmas(model: LaserModel) -> LaserSigmas:
    scan, mirror = model.scan, model.mirror
    return LaserSigmas(
        spot_m=1e-3 * scan.sigma_spot_mm,
        direction_rad=1e-3 * scan.sigma_direction_mrad,
        distance_m=1e-3 * (mirror.sigma_distance_mm or 0.0),
        offset_m=1e-3 * (mirror.sigma_offset_mm or 0.0),
        laser_place_m=1e-3 * (scan.sigma_laser_place_mm or 0.0),
        target_scale=1e-3 * (scan.sigma_target_scale_permille or 0.0),
        angle_scale=1e-3 * (scan.sigma_angle_scale_permille or 0.0),
        roll_rad=1e-3 * (scan.sigma_roll_mrad or 0.0),
    )


def _gridded(found: ScanSlopes, design: Quadric, step_m: float | None) -> SlopeMap:
    one = grid_points(_points(found), design, step_m)
    return replace(one, common=found.common, noise_correlation=found.noise_correlation)


def _points(found: ScanSlopes) -> SlopePoints:
    """Return the slopes as points: between seen beams one whose spot is missing or odd is mirror without slopes."""
    met = np.isfinite(found.slopes[0]) | found.facet.contains(*found.points_m)
    values = np.where(found.odd, np.nan, np.vstack([found.slopes, found.sigmas]))
    return SlopePoints(*found.points_m[:, met], *values[:, met])


def _doubts(model: LaserModel, scan: LaserScan, found: ScanSlopes, heard: InstrumentByCurl | None) -> Iterator[Doubt]:
    if heard is not None and heard.contradicts:
        yield Doubt(
            "scan_contradicts_itself",
            "the slopes have more smooth curl, which no surface has, than noise and the stated sigmas of the "
            f"instrument make (probability {heard.probability:.1g}); nothing was corrected by it: check roll, scales "
            "and places, whether each row has its own beam's spot, and state the sigmas as they are",
            {"agreement_probability": heard.probability},
        )
    yield from doubts_of_sigmas(model)
    unseen = int(np.count_nonzero(~scan.seen))
    if unseen:
        yield Doubt(
            "spots_not_seen",
            f"{unseen} of {scan.seen.size} beams have no spot: they missed the mirror, or their spot the target; where "
            "that is mirror it is not measured",
            {"unseen_count": unseen, "beams_count": scan.seen.size},
            Severity.NOTE,
        )
    if not 1 / _SAME_SIGMA < found.scatter < _SAME_SIGMA:
        yield Doubt(
            "sigma_of_spots_differs",
            f"slopes scatter beside their neighbours by {found.scatter:.3g} times what sigma_spot_mm = "
            f"{model.scan.sigma_spot_mm:g} and sigma_direction_mrad = {model.scan.sigma_direction_mrad:g} make: random "
            "sigmas are wrong by that, unless the mirror itself is rough from beam to beam",
            {"scatter_ratio": found.scatter},
        )
    odd = int(np.count_nonzero(found.odd))
    if odd:
        yield Doubt(
            "spots_odd",
            f"{odd} of {scan.seen.size} spots would make slopes 20 sigma and more from those around them: left out "
            f"(reasons in {BEAMS_FILE})",
            {"odd_count": odd, "beams_count": scan.seen.size},
        )


def doubts_of_sigmas(model: LaserModel) -> Iterator[Doubt]:
    """Name errors common to all spots of which nobody says how large they may be."""
    scan, mirror = model.scan, model.mirror
    stated = (
        mirror.sigma_distance_mm,
        mirror.sigma_offset_mm,
        scan.sigma_laser_place_mm,
        scan.sigma_target_scale_permille,
        scan.sigma_angle_scale_permille,
        scan.sigma_roll_mrad,
    )
    missing = {what: key for (what, key), one in zip(_COMMON.items(), stated, strict=True) if one is None}
    if missing:
        yield Doubt(
            "laser_sigmas_missing",
            f"no sigma is given for {', '.join(missing)} ({', '.join(missing.values())}): they count as exact, and "
            "sigmas of focal length and of slopes near the rim are too small",
            {"inputs_count": len(missing)},
        )


def _doubts_of_lines(lines: CrossedLines | None) -> Iterator[Doubt]:
    twice = 0 if lines is None else int(np.count_nonzero(lines.unclear))
    if lines is not None and twice:
        yield Doubt(
            "lines_cross_twice",
            f"{twice} of {lines.unclear.size} pairs of lines cross more than once on the target, or where a line is no "
            "longer than its noise: the mirror sends several beams to one point there, as near twice the focal length. "
            "They are left out; others may have a wrong crossing where their own was not seen: measure from nearer to "
            "the mirror",
            {"twice_count": twice, "pairs_count": int(lines.unclear.size)},
        )
