"""Slopes that were measured otherwise: on a grid, against a design, with statistics and report."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from deflectometry.exchange.nearest_design import are_of_surface, curvatures, nearest_design, rms_off
from deflectometry.exchange.slope_files import MAP_SUFFIXES, read_slopes
from deflectometry.exchange.slope_points import SlopePoints
from deflectometry.pipeline.design_check import is_other_shape, other_design
from deflectometry.pipeline.headline import Numbers, facet_numbers, headline_text, reasons
from heliogauge.doubts import Doubt
from heliogauge.errors import EstimationError, InputError
from heliogauge.flags import SampleFlag
from heliogauge.geometry.surfaces import Quadric
from heliogauge.measurement.designs import build_design
from heliogauge.measurement.load import MEASUREMENT_FILE, read_measurement, refuse_missing
from heliogauge.measurement.models import DesignKeys, MeasurementModel, Positive, Section, Text
from heliogauge.results.folder import Summary, hash_files, write_slope_map
from heliogauge.results.frame import InstrumentResult
from heliogauge.results.slope_map_file import read_slope_map
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.slopes.map import SlopeMap, no_common_modes
from heliogauge.slopes.removal import Removal, remove
from heliogauge.validate import BoolArray, FloatArray

#: A node farther from every point than this many spacings was not measured.
_GAP = 1.5
#: Points whose coordinates agree to this share of their spacing stand in one row.
_ON_GRID = 1e-3
#: Lines of a grid depart from equal steps by less than this share of a step, and are at most so many for each spacing
#: of the points: numbers that were rounded stand on a grid, too, of a thousand.
_OFF_LINE, _MOST_LINES = 0.02, 10
#: The nearest other point is at most two steps of a grid away where no more than every other node is left out. Means
#: over cells that are smaller at the rim stand on a grid, too, of which they are one node in sixteen.
_MOST_STEPS = 2.5
_MOST_NODES = 4_000_000


class SlopesSection(Section):
    """The slopes: a table with columns x_m, y_m, slope_x, slope_y, and sigma_slope_x, sigma_slope_y if known."""

    file: Text = Field(description="Table of the slopes (CSV), or a slope map (NetCDF).")
    sigma_slope_mrad: Positive | None = Field(
        None, description="Standard deviation of a slope, where the table has none; default: unknown [mrad]."
    )


class SlopesMirrorSection(DesignKeys):
    """The design that the slopes are compared with."""

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.design is None:
            raise ValueError("design is missing; say which shape the slopes are compared with")
        return self


class SlopesEvaluationSection(Section):
    """Choices of the evaluation."""

    grid_step_mm: Positive | None = Field(None, description="Step of the map; default: the spacing of the points [mm].")
    remove: Literal["nothing", "tilt", "focus", "quadratic"] = Field(
        "nothing", description="What is taken out of the map and headline numbers."
    )


class SlopesModel(MeasurementModel):
    """The whole measurement.toml of ``kind = "slopes"``."""

    kind: Literal["slopes"] = Field(description="Slopes of a mirror that were measured otherwise.")
    slopes: SlopesSection = Field(description="The slopes.")
    mirror: SlopesMirrorSection = Field(description="The design of the mirror.")
    evaluation: SlopesEvaluationSection = Field(SlopesEvaluationSection(), description="Choices of the evaluation.")


@dataclass(frozen=True, slots=True, eq=False)
class SlopesMeasurement:
    """Checked slopes of a mirror: the content of measurement.toml, and where its files are."""

    folder: Path
    model: SlopesModel

    @property
    def input_files(self) -> tuple[Path, ...]:
        """All files the measurement consists of, measurement.toml first."""
        return (self.folder / MEASUREMENT_FILE, self.folder / self.model.slopes.file)


def load_slopes(folder: Path) -> SlopesMeasurement:
    """Read and check a folder with slopes that were measured otherwise.

    Returns: The measurement; its table exists.
    InputError: As for `heliogauge.measurement.load.read_measurement`.
    """
    file, model = read_measurement(folder, SlopesModel)
    found = SlopesMeasurement(folder, model)
    refuse_missing(file, found.input_files)
    return found


@dataclass(frozen=True, slots=True, eq=False)
class SlopesResult(InstrumentResult):
    """The map of slopes that were measured otherwise.

    slope_map: After what was to be removed.
    numbers: Headline numbers.
    points: Number of points that were given.
    """

    kind: ClassVar[str] = "slopes"
    slope_map: SlopeMap
    numbers: Numbers
    points: int

    def summarise(self) -> Summary:
        """Collect the headline numbers with their sigmas, doubts and provenance."""
        one = self.slope_map
        texts = {
            "design": one.design,
            "removed": one.removed,
            "frame": one.frame,
            "points": f"{self.points} points, interpolated to {one.x_m.size} x {one.y_m.size} nodes",
            "sigma": "1 standard deviation; slopes are those of the normal, a beam turns by twice as much",
        }
        return self._summary(self.numbers, texts, reasons(self.numbers))

    def write_files(self, folder: Path) -> None:
        """Write the map into an existing folder."""
        write_slope_map(folder / "slope_map.nc", {"": self.slope_map}, {"name": self.name})

    def headline(self) -> str:
        """Return the most important numbers in a few lines for the terminal."""
        return headline_text(self.summarise())


def run(
    measurement: SlopesMeasurement, progress: Progress | None = None, removal: Removal | None = None
) -> SlopesResult:
    """Put slopes on a grid and compare them with the design.

    removal: What is taken out of map and headline numbers; None as measurement.toml says.
    InputError: A table that cannot be read, or a grid that is too fine.
    EstimationError: Points on one line.
    """
    progress = progress or SilentProgress()
    model = measurement.model
    with progress.stage("read slopes"):
        points = read_slopes(measurement.folder / model.slopes.file)
    with progress.stage("grid"):
        step_mm = model.evaluation.grid_step_mm
        points, doubts_of_sigma = _with_sigmas(points, model.slopes.sigma_slope_mrad)
        as_measured = grid_points(points, build_design(model.mirror), None if step_mm is None else 1e-3 * step_mm)
    with progress.stage("statistics"):
        slope_map = remove(as_measured, removal or Removal(model.evaluation.remove))
        numbers = facet_numbers(slope_map, as_measured)
    doubts = [*_doubts_of_map(measurement.folder / model.slopes.file, as_measured.design), *doubts_of_sigma]
    if not any(one.code == "design_is_not_that_of_the_map" for one in doubts):
        doubts = [*_doubts_of_design(points, numbers, as_measured, build_design(model.mirror)), *doubts]
    return SlopesResult(
        name=model.name,
        slope_map=slope_map,
        numbers=numbers,
        points=int(np.count_nonzero(points.measured)),
        doubts=tuple(doubts),
        durations_s=dict(progress.durations_s),
        input_sha256=hash_files(measurement.input_files, measurement.folder),
    )


def _doubts_of_map(file: Path, design: str) -> Iterator[Doubt]:
    """Yield what a slope map of ours says that its slopes alone do not: another design, a common share of sigma."""
    if file.suffix.lower() not in MAP_SUFFIXES:
        return
    stored = read_slope_map(file)
    if stored.design != design:
        yield Doubt(
            "design_is_not_that_of_the_map",
            f"the map's own design is {stored.design}, here its slopes are compared with {design}; if that is not "
            "meant, correct [mirror] in measurement.toml",
        )
    if stored.common.sources:
        yield Doubt(
            "common_share_counts_as_random",
            f"what {', '.join(dict.fromkeys(stored.common.sources))} may have done to the whole map counts as noise of "
            "each node here: sigmas of SDx, SDy and focal lengths are too small; those of the original result hold",
        )


def _doubts_of_design(points: SlopePoints, numbers: Numbers, as_measured: SlopeMap, design: Quadric) -> Iterator[Doubt]:
    """Yield that slopes are of another shape than the design, with the nearest one where that is nearer."""
    to_check = "the unit of the slopes and that x is across"
    if are_of_surface(points):
        nearest = nearest_design(points, curvatures(points))
        if is_other_shape(rms_off(points, design), nearest.rms_rad):
            off_mrad = 1e3 * nearest.rms_rad
            to_check += f"; nearest is {nearest.describe()}, {off_mrad:.3g} mrad off: {nearest.options}"
        else:
            to_check += "; no simple surface has these slopes: are slope_x and slope_y exchanged?"
    yield from other_design(numbers, as_measured, to_check)


def grid_points(points: SlopePoints, design: Quadric, step_m: float | None = None) -> SlopeMap:
    """Put slopes on a regular grid: as they are where they stand on one, else by linear interpolation.

    step_m: Step of the grid; the spacing of the points if None [m].
    Returns: The map; random sigmas are those of the points (NaN where they are not known).
    InputError: A grid of too many nodes.
    EstimationError: Points on one line.
    """
    from scipy.interpolate import LinearNDInterpolator
    from scipy.spatial import ConvexHull, QhullError, cKDTree

    place = np.column_stack([points.x_m, points.y_m])
    tree = cKDTree(place)
    try:
        area = float(ConvexHull(place).volume)
    except QhullError as error:
        raise EstimationError(f"{len(place)} points on one line; slopes of a surface are needed") from error
    spacing = float(np.sqrt(area / len(place)))
    if not 0 < spacing < np.inf:
        raise EstimationError(f"{len(place)} points at the same place; slopes of a surface are needed")
    apart = float(np.median(cKDTree(np.unique(place, axis=0)).query(place, k=2)[0][:, 1]))
    x_m, y_m = (_axis(values, spacing, apart, step_m) for values in (points.x_m, points.y_m))
    if x_m.size * y_m.size > _MOST_NODES:
        raise InputError(f"a map of {x_m.size} x {y_m.size} nodes; give a larger grid_step_mm")
    x, y = np.meshgrid(x_m, y_m)
    # The last column is known wherever there is mirror: a point without slopes takes its surroundings out.
    whole = np.ones(len(place))
    columns = np.column_stack([points.slope_x, points.slope_y, points.sigma_x, points.sigma_y, whole])
    distance, nearest = tree.query(np.column_stack([x.ravel(), y.ravel()]))
    values = LinearNDInterpolator(place, columns)(x, y)
    # At the rim rounding puts nodes outside the triangles: a node that is a point has its values.
    same = (distance < _ON_GRID * spacing).reshape(x.shape)
    values[same] = columns[nearest.reshape(x.shape)[same]]
    near = (distance < _GAP * spacing).reshape(x.shape)
    aperture: BoolArray = same | np.isfinite(values[..., 4])
    # Where all points are nodes, a node without a point was left out by whoever measured: it is not filled in.
    is_grid = step_m is None and np.count_nonzero(same) >= len(np.unique(place, axis=0))
    seen = (same if is_grid else aperture & near) & np.isfinite(values[..., :2]).all(axis=-1)
    slope_x, slope_y, sigma_x, sigma_y = (np.where(seen, values[..., k], np.nan) for k in range(4))
    design_x, design_y = design.gradient(x, y)
    return SlopeMap(
        x_m,
        y_m,
        slope_x,
        slope_y,
        design_x,
        design_y,
        sigma_x,
        sigma_y,
        1.0,
        no_common_modes(),
        np.full(x.shape, np.nan),
        np.where(seen, 0, SampleFlag.NOT_SEEN).astype(np.uint32),
        aperture,
        design.describe(),
        "as in the table: x to the right, y up, z out of the mirror",
        "nothing",
    )


def _axis(values: FloatArray, spacing: float, apart_m: float, step_m: float | None) -> FloatArray:
    """Return the lines of a grid: those on which the points stand, or lines of equal distance.

    apart_m: How far the nearest other point is, for the median of the points.
    """
    lines = np.unique(np.round(values / (_ON_GRID * spacing))) * (_ON_GRID * spacing)
    if step_m is None and lines.size > 1:
        steps = np.diff(lines)
        # Whole lines may be missing: the others still stand at multiples of the smallest step.
        count = int(np.rint(np.ptp(lines) / steps[steps < 1.5 * steps.min()].mean()))
        number = (lines - lines[0]) * (count / np.ptp(lines))
        on_lines = np.abs(number - np.rint(number)).max() < _OFF_LINE
        most = min(_MOST_LINES / spacing, _MOST_STEPS / apart_m) * np.ptp(lines)
        if on_lines and count < most:
            return np.linspace(values.min(), values.max(), count + 1)
    step = spacing if step_m is None else step_m
    # Multiplied: divided by a step of 1e-300 mm it would overflow.
    if np.ptp(values) > _MOST_NODES * step:
        raise InputError(
            f"grid_step_mm = {1e3 * step:.3g}: too fine for {np.ptp(values):.4g} m; give a larger grid_step_mm"
        )
    count = int(np.ptp(values) / step) + 1
    return np.asarray(values.min() + 0.5 * (np.ptp(values) - (count - 1) * step) + step * np.arange(count))


def _with_sigmas(points: SlopePoints, stated_mrad: float | None) -> tuple[SlopePoints, tuple[Doubt, ...]]:
    """Fill in sigmas that are missing: by what measurement.toml says, else by the RMS of the others, else zero."""
    missing = points.measured & ~(np.isfinite(points.sigma_x) & np.isfinite(points.sigma_y))
    count, total = int(np.count_nonzero(missing)), int(np.count_nonzero(points.measured))
    if not count:
        return points, ()
    known = points.measured & ~missing
    filled = []
    for sigma in (points.sigma_x, points.sigma_y):
        usual = float(np.sqrt(np.mean(sigma[known] ** 2))) if count < total else 0.0
        filled.append(np.where(missing, usual if stated_mrad is None else 1e-3 * stated_mrad, sigma))
    points = replace(points, sigma_x=filled[0], sigma_y=filled[1])
    if stated_mrad is not None:
        return points, ()
    if count < total:
        text = (
            f"{count} of {total} slopes come without sigma: they count with the RMS of the others; give "
            "sigma_slope_mrad in [slopes] if it is known"
        )
        return points, (Doubt("sigma_of_some_slopes_missing", text, {"missing_count": count, "slopes_count": total}),)
    return points, (
        Doubt(
            "sigma_of_slopes_missing",
            "the slopes come without sigmas: they count as exact, and every sigma here is too small; give "
            "sigma_slope_mrad in [slopes], or columns sigma_slope_x and sigma_slope_y",
        ),
    )
