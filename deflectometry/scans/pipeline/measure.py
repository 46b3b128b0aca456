"""A scan of the surface to its slope map: the stages follow each other in `run`."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from deflectometry.exchange.measure_slopes import grid_points
from deflectometry.exchange.slope_points import SlopePoints
from deflectometry.pipeline.choices import Options
from deflectometry.pipeline.design_check import doubts_of_amount, other_design
from deflectometry.pipeline.headline import Numbers, facet_numbers, headline_text, reasons
from deflectometry.scans.keys import SurfaceScanMeasurement, SurfaceScanModel
from deflectometry.scans.patch_slopes import (
    Deviations,
    PatchSlopes,
    best_patch,
    deviations_of,
    ladder,
    noise_of_points,
    patch_of_side,
    slopes_of_patch,
)
from deflectometry.scans.pipeline.read_points import ScannedPoints, read_points
from deflectometry.scans.registration import Registration, common_modes, given_place, register
from deflectometry.scans.stray_points import stray_points
from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import EstimationError, InputError
from heliogauge.flags import SampleFlag
from heliogauge.geometry.surfaces import Quadric
from heliogauge.measurement.designs import build_design, build_design_family
from heliogauge.results.folder import Summary, hash_files, write_slope_map
from heliogauge.results.frame import InstrumentResult
from heliogauge.results.tables import write_table_csv
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.slopes.map import SlopeMap
from heliogauge.slopes.removal import Removal, remove
from heliogauge.validate import BoolArray, FloatArray
from photogrammetry.surface import DesignSurface

PATCHES_FILE = "patches.csv"
#: Before anything is known of the noise: so much for the pose.
_FIRST_SIGMA_M = 1e-4
#: The chi-square of thousands of points knows the noise to a per cent; a stated sigma off by half is not that of these.
_SAME_SIGMA = 1.5
_MOST_NODES = 60_000
#: Stray points move the mirror's middle: without them it is placed again, and what it is compared with moves.
_PLACINGS = 4
#: Medians of neighbours stand while fewer than half are stray; in places there are twice as many as on the whole.
_LEAST_GOOD = 0.75


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceScanResult(InstrumentResult):
    """The slope map of a mirror from points of its surface.

    slope_map: After what was to be removed.
    numbers: Headline numbers.
    place: Where the mirror stands among the points.
    patches: What patches of each size give; empty for slopes from normals.
    points: How many points were used.
    """

    kind: ClassVar[str] = "surface-scan"
    slope_map: SlopeMap
    numbers: Numbers
    place: Registration
    patches: tuple[PatchSlopes, ...]
    points: int

    def summarise(self) -> Summary:
        """Collect the headline numbers with their sigmas, doubts and provenance."""
        one, place = self.slope_map, self.place
        held = ", ".join(place.held)
        texts = {
            "design": one.design,
            "removed": one.removed,
            "frame": one.frame,
            "points": f"{self.points} points, {one.x_m.size} x {one.y_m.size} nodes",
            "left free by the shape": held or "nothing",
            "measured share of": "the area that was scanned; the mirror's size is not known",
            "sigma": "1 standard deviation; slopes are those of the normal, a beam turns by twice as much",
        }
        return self._summary(self.numbers, texts, reasons(self.numbers))

    def write_files(self, folder: Path) -> None:
        """Write the map and what patches of each size give into an existing folder."""
        write_slope_map(folder / "slope_map.nc", {"": self.slope_map}, {"name": self.name})
        rows = [
            {
                "points": one.points,
                "degree": one.degree,
                "side_m": one.side_m,
                "noise_x_rad": float(one.noise_rad[0]),
                "noise_y_rad": float(one.noise_rad[1]),
                "lost_x_rad": float(one.lost_rad[0]),
                "lost_y_rad": float(one.lost_rad[1]),
            }
            for one in self.patches
        ]
        if rows:
            write_table_csv(folder / PATCHES_FILE, {name: [row[name] for row in rows] for name in rows[0]})

    def headline(self) -> str:
        """Return the most important numbers in a few lines for the terminal."""
        lines = [headline_text(self.summarise())]
        if (pair := self.numbers.get("neighbour_slope_noise_rad")) is not None:
            lines.append(f"  two neighbouring points: noise {1e3 * pair:.3f} mrad in one direction")
        for one in self.patches:
            lost = "" if not np.isfinite(one.total_rad) else f", lost {1e3 * np.hypot(*one.lost_rad):.3f}"
            lines.append(
                f"  patch of {one.points:3d} points ({1e3 * one.side_m:.0f} mm), degree {one.degree}: noise "
                f"{1e3 * np.hypot(*one.noise_rad):.3f}{lost} mrad"
            )
        return "\n".join(lines)


def run(
    measurement: SurfaceScanMeasurement, options: Options | None = None, progress: Progress | None = None
) -> SurfaceScanResult:
    """Find the slopes of a mirror from points of its surface and compare them with the design.

    options: Choices that override the file's; strict refuses points that would be left out.
    InputError: Points that cannot be read, or a grid that is too fine.
    EstimationError: Points that are not of the design.
    """
    options, progress, model = options or Options(), progress or SilentProgress(), measurement.model
    if options.align is not None:
        raise InputError(f"{measurement.folder}: a scan has no alignment; see place in [evaluation]; leave it out")
    with progress.stage("read points"):
        scanned = read_points(measurement.points_file, model.points.unit)
    found = evaluate_points(model, scanned, str(measurement.points_file), options, progress)
    return SurfaceScanResult(
        name=model.name,
        slope_map=found.slope_map,
        numbers=found.numbers,
        place=found.place,
        patches=found.patches,
        points=int(np.count_nonzero(~found.odd)),
        doubts=found.doubts,
        durations_s=dict(progress.durations_s),
        input_sha256=hash_files(measurement.input_files, measurement.folder),
    )


@dataclass(frozen=True, slots=True, eq=False)
class EvaluatedPoints:
    """What points of the surface say of the mirror.

    slope_map: After what was to be removed.
    numbers, place, patches, doubts: As in `SurfaceScanResult`.
    odd (n,): Points that were left out.
    """

    slope_map: SlopeMap
    numbers: Numbers
    place: Registration
    patches: tuple[PatchSlopes, ...]
    odd: BoolArray
    doubts: tuple[Doubt, ...]


def evaluate_points(
    model: SurfaceScanModel, scanned: ScannedPoints, where: str, options: Options, progress: Progress
) -> EvaluatedPoints:
    """Find the slopes of a mirror from points of its surface.

    where: What the points are called in messages.
    InputError, EstimationError: As for `run`.
    """
    design = build_design(model.mirror)
    doubts: list[Doubt] = []
    with progress.stage("find mirror"):
        place, points, normals, sigma, odd = _placed(model, scanned, design, doubts)
        if options.strict and odd.any():
            raise EstimationError(f"{np.count_nonzero(odd)} points do not fit those around them, with --strict")
    patches: list[PatchSlopes] = []
    with progress.stage("slopes"):
        step_mm = model.evaluation.grid_step_mm if options.grid_step_mm is None else options.grid_step_mm
        step_m = None if step_mm is None else 1e-3 * step_mm
        if model.points.slopes_from == "normals":
            normals = None if normals is None else normals[~odd]
            as_measured = _from_normals(model, where, points[~odd], normals, design, step_m, doubts)
        else:
            as_measured, patches = _from_points(model, points[~odd], design, sigma, step_m)
        scale = 1e-6 * (model.points.sigma_scale_ppm or 0.0)
        common = common_modes(design, place, points[~odd, :2], scale)
        words = "nothing" if model.evaluation.place == "given" else "place and turn, by the fit to the design"
        as_measured = replace(as_measured, common=common, frame=_FRAME, removed=words)
    with progress.stage("statistics"):
        slope_map = remove(as_measured, options.remove or Removal(model.evaluation.remove))
        numbers = facet_numbers(slope_map, as_measured) | _own_numbers(place, sigma, patches, points)
    doubts += doubts_of_amount(numbers, scanned.repeated, "point")
    doubts += _doubts(model, place, odd, as_measured, numbers)
    if scanned.without_place:
        text = f"{scanned.without_place} rows of the points are without a place (empty, or no number): left out"
        doubts.append(Doubt("points_without_place", text, {"points_count": scanned.without_place}, Severity.NOTE))
    return EvaluatedPoints(slope_map, numbers, place, tuple(patches), odd, tuple(doubts))


_FRAME = "mirror frame of the design: x across, y up, seen from the front, z out of the mirror [m]"


def _placed(
    model: SurfaceScanModel, scanned: ScannedPoints, design: Quadric, doubts: list[Doubt]
) -> tuple[Registration, FloatArray, FloatArray | None, float, BoolArray]:
    """Return the place of the mirror, points and normals in its frame, the noise of a point, and points left out."""
    stated = None if model.points.sigma_point_mm is None else 1e-3 * model.points.sigma_point_mm
    viewer = np.asarray(model.points.scanner_m)
    if scanned.normals is not None:
        viewer = _in_front(scanned, viewer, doubts)
    family = build_design_family(model.mirror)
    surface = DesignSurface(family.make, 1 / family.lengths_m, family.names, family.facet_from_optic)
    sigma, place = stated or _FIRST_SIGMA_M, given_place(len(scanned.points_m))
    good = np.ones(len(scanned.points_m), dtype=np.bool_)
    for _ in range(_PLACINGS):
        if model.evaluation.place == "fit":
            axis = None if model.points.x_axis is None else np.asarray(model.points.x_axis)
            place = register(scanned.points_m[good], surface, viewer, sigma, axis)
        points = place.mirror_from_points.apply(scanned.points_m)
        stray = stray_points(_deviations(points[good], design))
        good[np.flatnonzero(good)[stray]] = False
        if not stray.any():
            break
        if np.count_nonzero(good) < _LEAST_GOOD * good.size:
            raise EstimationError(
                f"{np.count_nonzero(~good)} of {good.size} points are far from the surface of their neighbours: what "
                f"stands before or behind the mirror is in the scan, or {design.describe()} is not its design; cut the "
                "points to the mirror, or correct [mirror]"
            )
    found, noisy = noise_of_points(_deviations(points[good], design))
    odd = ~good
    odd[np.flatnonzero(good)[noisy]] = True
    # The covariance of the pose grows with the square of the noise, which is known when the pose is.
    place = replace(place, covariance=place.covariance * (max(stated or 0.0, found) / sigma) ** 2)
    sigma = max(stated or 0.0, found)
    if stated is not None and not stated / _SAME_SIGMA < found < stated * _SAME_SIGMA:
        doubts.append(
            Doubt(
                "sigma_of_points_differs",
                f"neighbouring points scatter by {1e3 * found:.3g} mm, sigma_point_mm says {1e3 * stated:.3g} mm: the "
                "larger one counts; of a scanner that smooths, points share their noise, and slopes are less sure",
                {"found_m": found, "stated_m": stated},
            )
        )
    normals = scanned.normals
    turned = None if normals is None else normals @ place.mirror_from_points.rotation.T
    if turned is not None and np.median(turned[:, 2]) < 0:
        turned = -turned
    return place, points, turned, sigma, odd


def _in_front(scanned: ScannedPoints, scanner_m: FloatArray, doubts: list[Doubt]) -> FloatArray:
    """Return a point in front of the mirror; normals that point away from the scanner are turned."""
    middle = scanned.points_m.mean(axis=0)
    towards = np.median(scanned.normals, axis=0) if scanned.normals is not None else scanner_m - middle
    if towards @ (scanner_m - middle) < 0:
        doubts.append(
            Doubt(
                "normals_turned",
                "the normals point away from the scanner: they were turned round; if the scanner was not at scanner_m, "
                "say where it stood in [points]",
                severity=Severity.NOTE,
            )
        )
    return scanner_m


def _deviations(points_m: FloatArray, design: Quadric) -> Deviations:
    height = design.height(points_m[:, 0], points_m[:, 1])
    if not np.isfinite(height).all():
        raise EstimationError(
            f"{np.count_nonzero(~np.isfinite(height))} of {len(points_m)} points lie beyond the end of the design "
            f"({design.describe()}); is that the design of this mirror?"
        )
    gradient = np.stack(design.gradient(points_m[:, 0], points_m[:, 1]))
    return deviations_of(points_m[:, :2], points_m[:, 2] - height, gradient)


def _from_points(
    model: SurfaceScanModel, points_m: FloatArray, design: Quadric, sigma_m: float, step_m: float | None
) -> tuple[SlopeMap, list[PatchSlopes]]:
    deviations = _deviations(points_m, design)
    step = step_m or deviations.spacing_m
    axes = [_axis(deviations.places_m[:, k], step) for k in (0, 1)]
    if axes[0].size * axes[1].size > _MOST_NODES:
        raise InputError(
            f"a map of {axes[0].size} x {axes[1].size} nodes from patches of points; give a larger grid_step_mm"
        )
    x, y = np.meshgrid(*axes)
    nodes = np.column_stack([x.ravel(), y.ravel()])
    patch_mm = model.evaluation.patch_mm
    found = ladder(deviations, nodes, sigma_m)
    patch = best_patch(found) if patch_mm is None else patch_of_side(deviations, 1e-3 * patch_mm, found)
    chosen = slopes_of_patch(deviations, nodes, sigma_m, patch)
    lost = np.nan_to_num(chosen.lost_rad)
    slopes = chosen.slopes.reshape(2, *x.shape)
    sigmas = np.hypot(chosen.noise, lost[:, None]).reshape(2, *x.shape)
    seen = np.asarray(np.isfinite(slopes).all(axis=0))
    own = np.stack(design.gradient(x, y))
    return (
        SlopeMap(
            axes[0],
            axes[1],
            slopes[0] + own[0],
            slopes[1] + own[1],
            own[0],
            own[1],
            sigmas[0],
            sigmas[1],
            chosen.noise_correlation,
            common_modes(design, given_place(0), deviations.places_m, 0.0),
            np.full(x.shape, np.nan),
            np.where(seen, 0, SampleFlag.NOT_SEEN).astype(np.uint32),
            seen,
            design.describe(),
            "",
            "nothing",
        ),
        found,
    )


def _axis(values: FloatArray, step: float) -> FloatArray:
    count = int(np.ptp(values) / step) + 1
    return np.asarray(values.min() + 0.5 * (np.ptp(values) - (count - 1) * step) + step * np.arange(count))


def _from_normals(
    model: SurfaceScanModel,
    where: str,
    points_m: FloatArray,
    normals: FloatArray | None,
    design: Quadric,
    step_m: float | None,
    doubts: list[Doubt],
) -> SlopeMap:
    section = model.points
    if normals is None:
        raise InputError(
            f'{where}: slopes_from = "normals", but the points have none (nx, ny, nz; in CSV '
            "normal_x, normal_y, normal_z); leave slopes_from out to take them from the points"
        )
    if not (normals[:, 2] > 0).all():
        count = int((normals[:, 2] <= 0).sum())
        raise InputError(f"{where}: {count} of {len(normals)} normals point the other way than the rest; turn them")
    sigma = 1e-3 * (section.sigma_normal_mrad or 0.0)
    if section.sigma_normal_mrad is None:
        doubts.append(
            Doubt(
                "sigma_of_normals_missing",
                "no sigma is given for the normals (sigma_normal_mrad in [points]): they count as exact, and every "
                "sigma here is too small",
            )
        )
    slopes = -normals[:, :2].T / normals[:, 2]
    stretch = 1 + slopes**2
    return grid_points(SlopePoints(points_m[:, 0], points_m[:, 1], *slopes, *(sigma * stretch)), design, step_m)


def _own_numbers(place: Registration, sigma_m: float, patches: list[PatchSlopes], points_m: FloatArray) -> Numbers:
    numbers: dict[str, float | int | None] = {"point_noise_m": sigma_m, "points_count": len(points_m)}
    if np.isfinite(place.rms_m):
        numbers["design_distance_rms_m"] = place.rms_m
        tilts = np.sqrt(np.maximum(np.diag(place.covariance)[:3], 0.0))
        for axis, one in zip("xyz", tilts, strict=True):
            numbers[f"sigma_pose_turn_{axis}_rad"] = float(one)
    if patches:
        # Two neighbours, as the published estimate has it (STAGE-STE 12.6, section 3.1.1.2).
        spacing = patches[0].side_m / np.sqrt(patches[0].points)
        numbers["point_spacing_m"] = float(spacing)
        numbers["neighbour_slope_noise_rad"] = float(np.sqrt(2) * sigma_m / spacing)
        chosen = best_patch(patches)
        numbers["patch_side_m"] = chosen.side_m
    return numbers


def _doubts(
    model: SurfaceScanModel, place: Registration, odd: BoolArray, as_measured: SlopeMap, numbers: Numbers
) -> Iterator[Doubt]:
    if place.held:
        yield Doubt(
            "motions_left_free",
            f"the shape of the mirror leaves free: {', '.join(place.held)}; there the frame is where the points' own "
            "middle and axes put it",
            {"motions_count": len(place.held)},
            Severity.NOTE,
        )
    if place.open_words:
        yield Doubt("scan_orientation_open", place.open_words, severity=Severity.NOTE)
    count = int(np.count_nonzero(odd))
    if count:
        yield Doubt(
            "points_odd",
            f"{count} of {odd.size} points are farther from the surface of their neighbours than noise puts one in "
            "twenty scans: left out",
            {"odd_count": count, "points_count": odd.size},
            Severity.NOTE if count < 0.01 * odd.size else Severity.DOUBT,
        )
    yield from other_design(numbers, as_measured, "its place, and that x is across")
