"""The table of a laser scan."""

from pathlib import Path

import numpy as np

from deflectometry.laser.scan import LaserScan
from heliogauge.errors import InputError
from heliogauge.results.tables import read_columns_csv, read_table_csv

DIRECTIONS = ("direction_x", "direction_y", "direction_z")
SPOTS = ("spot_x_m", "spot_y_m")
#: Where the target is no plane through the laser.
SPOT_HEIGHT = "spot_z_m"
#: Fewer beams determine no shape of degree 4.
FEWEST_BEAMS = 60
# Beyond every target: 1 km.
_FARTHEST_M = 1e3


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
    far = np.abs(spots_m) > _FARTHEST_M
    if far.any():
        raise InputError(
            f"{file}: {int(far.any(axis=0).sum())} spots farther than {_FARTHEST_M:g} m from the laser, the first at "
            f"{spots_m[far][0]:.6g}; spots are in metres"
        )
    scan = LaserScan(
        directions / np.linalg.norm(directions, axis=0), np.where(np.isfinite(spots_m).all(0), spots_m, np.nan)
    )
    count = int(np.count_nonzero(scan.seen))
    if count < FEWEST_BEAMS:
        raise InputError(
            f"{file}: {count} of {scan.seen.size} beams have a spot; {FEWEST_BEAMS} are needed for a mirror's shape"
        )
    return scan
