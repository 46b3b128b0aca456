"""Targets without a code in the pipeline: the list of names, the dots of the photos, the extended network."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from heliogauge.errors import InputError
from heliogauge.results.folder import read_table_csv
from photogrammetry.keys.targets import TargetsSection
from photogrammetry.matching.uncoded_names import ListedTargets
from photogrammetry.networks.solve_network import Knowledge, NetworkCameras, Solved, SolveOptions
from photogrammetry.networks.solve_uncoded import add_dots
from photogrammetry.pipeline.photos import MeasuredPhotos, Refused
from photogrammetry.start_values.network import StartValues

_COLUMNS = ("id", "x_m", "y_m", "z_m", "sigma_mm")


def with_uncoded(
    measured: MeasuredPhotos,
    solved: Solved,
    listed: ListedTargets | None,
    cameras: NetworkCameras,
    knowledge: Knowledge,
    options: SolveOptions,
) -> tuple[MeasuredPhotos, Solved]:
    """Extend a network by the targets without a code.

    measured: All image points, and the dots.
    listed: Names and rough places.
    knowledge: Scale bars, control points, constraints and datum.
    Returns: The image points with those of matched dots, and the network adjusted with them; what could not be
        matched or named is among the refused.
    EstimationError: The network with its points is not determined.
    """
    if measured.loose is None or not len(measured.loose.dots):
        missing = () if listed is None else (f"{len(listed)} targets without a code are listed, but no dot was found",)
        return replace(measured, doubts=(*measured.doubts, *missing)), solved
    loose = replace(measured.loose, listed=listed)
    found = add_dots(solved, (measured.points, measured.ellipses_px2), loose, cameras, knowledge, options)
    refused = tuple(Refused(one.name, one.reason) for one in found.left)
    extended = replace(
        measured,
        points=found.points,
        ellipses_px2=found.ellipses_px2,
        refused=(*measured.refused, *refused),
        doubts=(*measured.doubts, *found.doubts),
    )
    return extended, found.solved


def start_with_list(start: StartValues, section: TargetsSection | None, listed: ListedTargets | None) -> StartValues:
    """Take listed places as start values where the list alone tells the targets: its frame and scale become those.

    start: What measurement.toml gives to start from.
    listed: Names and rough places.
    """
    if listed is None or section is None or section.dictionary is not None:
        return start
    places = dict(zip(listed.names, listed.points_m, strict=True))
    return StartValues(start.cam_from_world, {**places, **start.points_m})


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
        table = read_table_csv(path, _COLUMNS)
        for line, cells in enumerate(zip(*(table[name] for name in _COLUMNS), strict=True), start=2):
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
