"""The tables of a laser scan: of beams, or of lines that were swept over the mirror."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from deflectometry.laser.line_sweep import CrossedLines, Sweep, cross_lines, is_in_order
from deflectometry.laser.scan import LaserScan, single_beams
from heliogauge.errors import InputError
from heliogauge.results.tables import read_columns_csv, read_table_csv
from heliogauge.validate import FloatArray, IntArray

DIRECTIONS = ("direction_x", "direction_y", "direction_z")
SPOTS = ("spot_x_m", "spot_y_m")
#: Where the target is no plane through the laser.
SPOT_HEIGHT = "spot_z_m"
#: Normal of the sheet of light of a line.
NORMALS = ("normal_x", "normal_y", "normal_z")
#: Fewer beams determine no shape of degree 4.
FEWEST_BEAMS = 60
# Beyond every target: 1 km.
_FARTHEST_M = 1e3
# Normals are one when they agree to the digits of a table.
_SAME_SHEET = 1e-6


def read_scan(file: Path) -> LaserScan:
    """Read the table of a scan.

    file: CSV with columns direction_x, direction_y, direction_z (of any length), spot_x_m, spot_y_m, and spot_z_m where
        the target is no plane through the laser; a spot that was not seen is left empty.
    Returns: All beams with a direction.
    InputError: A column is missing, beams run away from the mirror, spots are nowhere, or there are too few.
    """
    names: tuple[str, ...] = (*DIRECTIONS, *SPOTS)
    if SPOT_HEIGHT in read_table_csv(file, names):
        names = (*names, SPOT_HEIGHT)
    _, table = read_columns_csv(file, (), names)
    directions = np.stack([table[name] for name in DIRECTIONS])
    spots_m = np.stack([table[name] for name in SPOTS] + [table.get(SPOT_HEIGHT, np.zeros(directions.shape[1]))])
    aimed = np.isfinite(directions).all(axis=0) & (np.abs(directions).max(axis=0, initial=0.0) > 0)
    directions, spots_m = directions[:, aimed], spots_m[:, aimed]
    away = int(np.count_nonzero(directions[2] >= 0))
    if away:
        raise InputError(
            f"{file}: direction_z of {away} of {directions.shape[1]} beams is not negative: they run away from the "
            "mirror; z points from the mirror to the laser"
        )
    _refuse_far(file, spots_m)
    first = _first_of_each(np.vstack([directions, spots_m]))
    repeated = directions.shape[1] - first.size
    directions, spots_m = directions[:, first], spots_m[:, first]
    scan = single_beams(directions, np.where(np.isfinite(spots_m).all(0), spots_m, np.nan))
    scan = replace(scan, repeated=repeated)
    _refuse_few(file, scan, "beams have a spot")
    return scan


def read_lines(file: Path, sigma_spot_m: float) -> CrossedLines:
    """Read the table of two sweeps of a line laser.

    file: CSV with columns sweep (two names), line (a number of each sweep's own), normal_x, normal_y, normal_z (of any
        length, of the sheet of light, which contains the laser), spot_x_m, spot_y_m; a row for each point of a line, in
        their order on the line; an empty spot is a gap.
    sigma_spot_m: Standard deviation of each point of a line across it [m].
    Returns: The beams in which the sheets cut each other, with the spots where their lines cross.
    InputError: A column is missing, not two sweeps, a line with several sheets, points of a line out of their order,
        spots nowhere, or too few crossings.
    EstimationError: Sheets of both sweeps are nearly parallel.
    """
    texts, table = read_columns_csv(file, ("sweep", "line"), (*NORMALS, *SPOTS))
    names = list(dict.fromkeys(texts["sweep"]))
    if len(names) != 2:
        raise InputError(
            f"{file}: the column sweep has {len(names)} names ({', '.join(names[:4])}); two sweeps are needed, one "
            "across and one along the mirror"
        )
    normals, spots_m = np.stack([table[name] for name in NORMALS]), np.stack([table[name] for name in SPOTS])
    _refuse_far(file, spots_m)
    sweep, line = np.array(texts["sweep"]), np.array(texts["line"])
    number = np.unique(np.char.add(np.char.add(sweep, "/"), line), return_inverse=True)[1]
    seen = np.flatnonzero(np.isfinite(spots_m).all(axis=0))
    kept = np.ones(number.size, dtype=bool)
    kept[seen] = False
    kept[seen[_first_of_each(np.vstack([number, spots_m])[:, seen])]] = True
    # Points of a line follow each other, whatever stands between them in the table.
    order = np.flatnonzero(kept)[np.argsort(number[kept], kind="stable")]
    sweep, line, normals, spots_m = sweep[order], line[order], normals[:, order], spots_m[:, order]
    sweeps = [
        _sweep(file, name, line[own], normals[:, own], spots_m[:, own])
        for name, own in ((name, sweep == name) for name in names)
    ]
    for name, one in zip(names, sweeps, strict=True):
        _refuse_disorder(file, name, one, sigma_spot_m)
    found = cross_lines(sweeps[0], sweeps[1], sigma_spot_m)
    found = replace(found, scan=replace(found.scan, repeated=number.size - order.size))
    _refuse_few(file, found.scan, "pairs of lines cross once on the target")
    return found


def _first_of_each(columns: FloatArray) -> IntArray:
    """Return the columns that say something new, in their order; not seen is a value like others."""
    return np.sort(np.unique(np.nan_to_num(columns, nan=np.inf), axis=1, return_index=True)[1])


def _refuse_disorder(file: Path, name: str, sweep: Sweep, sigma_spot_m: float) -> None:
    """Refuse lines whose next point is mostly not the nearest."""
    lines = np.unique(sweep.line)
    wrong = sum(not is_in_order(sweep.points_m[sweep.line == one], sigma_spot_m) for one in lines)
    if 2 * wrong > lines.size:
        raise InputError(
            f"{file}: the points of a line are not in their order in {wrong} of {lines.size} lines of sweep {name}: "
            "the next one is not beside the last; sort the rows of each line as its points follow each other on it"
        )


def _sweep(file: Path, name: str, line: npt.NDArray[np.str_], normals: FloatArray, spots_m: FloatArray) -> Sweep:
    length = np.linalg.norm(normals, axis=0)
    unclear = np.flatnonzero(~(length > 0))
    if unclear.size:
        raise InputError(f"{file}: line {line[unclear[0]]} of sweep {name} has no normal of its sheet of light")
    unit = normals / length
    _, first, number = np.unique(line, return_index=True, return_inverse=True)
    turned = np.flatnonzero(np.abs(unit - unit[:, first[number]]).max(axis=0) > _SAME_SHEET)
    if turned.size:
        raise InputError(
            f"{file}: line {line[turned[0]]} of sweep {name} has several normals; a line is one sheet of light"
        )
    return Sweep(unit[:, first].T, number, spots_m.T)


def _refuse_far(file: Path, spots_m: FloatArray) -> None:
    far = np.abs(spots_m) > _FARTHEST_M
    if far.any():
        raise InputError(
            f"{file}: {int(far.any(axis=0).sum())} spots farther than {_FARTHEST_M:g} m from the laser, the first at "
            f"{spots_m[far][0]:.6g}; spots are in metres"
        )


def _refuse_few(file: Path, scan: LaserScan, what: str) -> None:
    count = int(np.count_nonzero(scan.seen))
    if count < FEWEST_BEAMS:
        raise InputError(f"{file}: {count} of {scan.seen.size} {what}; {FEWEST_BEAMS} are needed for a mirror's shape")
