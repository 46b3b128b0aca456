"""Constraints, start values, datum and search from measurement.toml."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from heliogauge.errors import InputError
from heliogauge.results.folder import read_cameras_json, read_table_csv
from heliogauge.validate import FloatArray
from photogrammetry.bundle.constraints import CommonPlane, Constraint, ControlPoint, Coordinate, Distance, KnownPlane
from photogrammetry.bundle.datum import Datum, DatumKind
from photogrammetry.detection.detect import SearchLimits
from photogrammetry.detection.photo_targets import TargetSearch
from photogrammetry.keys.load import PhotogrammetryMeasurement
from photogrammetry.keys.measurement import (
    CollectorSection,
    ControlPointSection,
    CoordinateSection,
    DistanceSection,
    PhotogrammetryModel,
)
from photogrammetry.keys.targets import TargetsSection
from photogrammetry.matching.uncoded_names import ListedTargets
from photogrammetry.networks.length_error import PermissibleError
from photogrammetry.networks.solve_network import Knowledge, SolveOptions
from photogrammetry.start_values.network import StartValues
from photogrammetry.targets.ring_codes import Polarity, Sense
from photogrammetry.targets.store_ring_codes import CodePrint, load_dictionary

_LIST_COLUMNS = ("id", "x_m", "y_m", "z_m", "sigma_mm")
_DATUMS = {
    "inner": DatumKind.INNER,
    "minimal": DatumKind.MINIMAL,
    "photos": DatumKind.PHOTOS,
    "control": DatumKind.CONTROL,
}


def build_search(section: TargetsSection, folder: Path) -> TargetSearch:
    """Say what circular targets are searched for.

    section: What measurement.toml says.
    folder: Where a file with ring codes of one's own is.
    InputError: No such dictionary, a file of ring codes with faults, or impossible sizes.
    """
    polarities = tuple(Polarity) if section.polarity == "both" else (Polarity(section.polarity),)
    limits = SearchLimits(section.smallest_px, section.largest_px, polarities=polarities)
    # Square markers are read by others; only dots are searched for beside them.
    dictionary, radii = None, None
    if section.dictionary is not None and not section.has_markers:
        sense = None if section.sense is None else Sense(section.sense)
        printed = CodePrint(sense, section.ring_inner_radius, section.ring_outer_radius)
        dictionary = load_dictionary(section.dictionary, folder, printed)
        is_known = section.ring_inner_radius is not None or section.ring_outer_radius is not None
        radii = dictionary.radii if is_known else None
    return TargetSearch(dictionary=dictionary, limits=limits, with_uncoded=section.searches_dots, radii=radii)


def build_constraints(model: PhotogrammetryModel) -> tuple[Constraint, ...]:
    """Collect scale bars, distances, coordinates, planes and weighted control points.

    model: What measurement.toml says.
    Returns: In the order of the file; scale bars for checks only are left out.
    """
    found: list[Constraint] = [
        Distance(bar.a, bar.b, bar.length_m, 1e-3 * bar.sigma_mm) for bar in model.scale_bar if not bar.check_only
    ]
    for one in model.constraint:
        sigma_m = 1e-3 * one.sigma_mm
        if isinstance(one, CoordinateSection):
            found.append(Coordinate(one.target, one.axis, one.value_m, sigma_m))
        elif isinstance(one, DistanceSection):
            found.append(Distance(one.a, one.b, one.distance_m, sigma_m))
        elif one.normal is None:
            found.append(CommonPlane(one.targets, sigma_m))
        else:
            found.append(KnownPlane(one.targets, np.array(one.normal), one.offset_m, sigma_m))
    return (*found, *_constrain_rim(model.collector), *_weigh_control_points(model.control_point))


def _constrain_rim(section: CollectorSection | None) -> list[Constraint]:
    """Return what the shape of a trough implies for targets on its rim (spec of the collector: z = w^2 / (16 f))."""
    if section is None:
        return []
    sigma_m, half_m = 1e-3 * section.sigma_mm, 0.5 * section.width_m
    long_m = 1e-3 * (section.length_sigma_mm or section.sigma_mm)
    found: list[Constraint] = []
    for side_m, names in ((-half_m, section.left), (half_m, section.right)):
        found += [Coordinate(name, "x", side_m, sigma_m) for name in names]
        found += [Coordinate(name, "z", section.rim_height_m, sigma_m) for name in names]
    found += [Coordinate(name, "y", 0.0, sigma_m) for name in section.end]
    found += [Distance(a, b, section.length_m, long_m) for a, b in section.along if section.length_m is not None]
    return found


def _weigh_control_points(points: Sequence[ControlPointSection]) -> list[Constraint]:
    return [
        ControlPoint(one.target, np.array(one.xyz_m), np.diag(np.square(one.sigma_mm)) * 1e-6)
        for one in points
        if any(one.sigma_mm)
    ]


def build_start(measurement: PhotogrammetryMeasurement) -> StartValues:
    """Read start values, where measurement.toml names some.

    Returns: Poses and points; empty without ``[start]``.
    InputError: A file that cannot be read.
    """
    section = measurement.model.start
    if section is None:
        return StartValues()
    poses = {} if section.cameras is None else read_cameras_json(measurement.folder / section.cameras)[1]
    points: dict[str, FloatArray] = {}
    if section.points is not None:
        points = _start_points(measurement.folder / section.points)
    return StartValues({name: one.cam_from_world for name, one in poses.items()}, points)


def _start_points(path: Path) -> dict[str, FloatArray]:
    """Read the columns id, x_m, y_m, z_m; points without numbers are left out."""
    columns = read_table_csv(path, ("id", "x_m", "y_m", "z_m"))
    try:
        rows = [[float(cell or "nan") for cell in columns[name]] for name in ("x_m", "y_m", "z_m")]
    except ValueError as error:
        raise InputError(f"{path}: x_m, y_m, z_m must be numbers ({error}); is the decimal sign a point?") from None
    xyz_m = np.array(rows).T
    return {name: one for name, one in zip(columns["id"], xyz_m, strict=True) if np.isfinite(one).all()}


def build_datum(model: PhotogrammetryModel) -> Datum:
    """Return the datum.

    model: What measurement.toml says.
    InputError: A minimal datum without three targets, or photos held without one or two.
    """
    return Datum(_DATUMS[model.datum.kind], model.datum.targets, model.datum.photos)


def build_knowledge(
    measurement: PhotogrammetryMeasurement, start: StartValues | None, listed: ListedTargets | None
) -> Knowledge:
    """Collect what is known of a network besides image points.

    start: Poses and targets to start from instead of those that measurement.toml names.
    listed: Targets without a code. Where the list alone names the targets, its frame and scale become the network's.
    InputError: Start values that cannot be read, or an impossible datum.
    """
    model = measurement.model
    start = start or build_start(measurement)
    if listed is not None and model.targets is not None and model.targets.dictionary is None:
        places = dict(zip(listed.names, listed.points_m, strict=True))
        start = StartValues(start.cam_from_world, {**places, **start.points_m})
    fixed = {one.target: np.array(one.xyz_m) for one in model.control_point if not any(one.sigma_mm)}
    one_size = stated_diameter_mm(model) is not None
    return Knowledge((*build_constraints(model), *measurement.known), fixed, build_datum(model), start, one_size)


def build_solve_options(model: PhotogrammetryModel, sigma_assumed: bool) -> SolveOptions:
    """Choose how to solve.

    sigma_assumed: Whether the sizes of the image points' sigmas are only assumed.
    """
    section = model.adjustment
    rescale = sigma_assumed if section.sigmas is None else section.sigmas == "from residuals"
    return SolveOptions(section.reject, section.family_significance, rescale)


def build_checks(model: PhotogrammetryModel) -> tuple[Distance, ...]:
    """Collect the scale bars that are kept apart as checks."""
    return tuple(Distance(bar.a, bar.b, bar.length_m, 1e-3 * bar.sigma_mm) for bar in model.scale_bar if bar.check_only)


def build_permissible_error(model: PhotogrammetryModel) -> PermissibleError | None:
    """Return the largest length error that is permissible, where one is stated."""
    limit = model.permissible_length_error
    return None if limit is None else PermissibleError(1e-3 * limit.a_mm, limit.k, 1e-3 * limit.b_mm)


def stated_diameter_mm(model: PhotogrammetryModel) -> float | None:
    """Return the diameter of all targets, where one is stated [mm]."""
    return None if model.targets is None else model.targets.diameter_mm


def listed_targets(section: TargetsSection | None, folder: Path) -> ListedTargets | None:
    """Collect the targets without a code that measurement.toml and its table list.

    InputError: A table with missing columns or cells that are no numbers (with the line), a name twice, or a sigma
        of 0.
    """
    if section is None or not (section.uncoded or section.uncoded_file):
        return None
    names = [one.target for one in section.uncoded]
    rows = [[*one.xyz_m, one.sigma_mm] for one in section.uncoded]
    if section.uncoded_file is not None:
        path = folder / section.uncoded_file
        table = read_table_csv(path, _LIST_COLUMNS)
        for line, cells in enumerate(zip(*(table[name] for name in _LIST_COLUMNS), strict=True), start=2):
            try:
                numbers = [float(cell) for cell in cells[1:]]
            except ValueError as error:
                raise InputError(f"{path}, line {line}: {error}; is the decimal sign a point?") from None
            if not (np.isfinite(numbers).all() and numbers[3] > 0):
                raise InputError(f"{path}, line {line}: finite coordinates and a positive sigma_mm are needed")
            if cells[0] in names or not cells[0]:
                raise InputError(f"{path}, line {line}: id {cells[0]!r} is empty or listed twice")
            names.append(cells[0])
            rows.append(numbers)
    values = np.array(rows, dtype=np.float64)
    return ListedTargets(tuple(names), values[:, :3], np.repeat(1e-3 * values[:, 3:], 3, axis=1))
