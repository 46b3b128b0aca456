"""Where a drone's antenna or camera was at each photo: tags of the photos, ``.MRK`` logs of DJI, tables."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from heliogauge.errors import InputError
from heliogauge.files.regular import open_regular
from heliogauge.files.texts import read_text
from heliogauge.geometry.geodesy import enu_from_geodetic
from heliogauge.geometry.rigid import rotation_from_vector
from heliogauge.images.drone_tags import drone_tag
from heliogauge.images.exif import EXIF_BYTES
from heliogauge.results.tables import read_table_csv
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray

GEODETIC_COLUMNS = ("image", "latitude_deg", "longitude_deg", "altitude_m")
LOCAL_COLUMNS = ("image", "east_m", "north_m", "up_m")
SIGMA_COLUMNS = ("sigma_east_mm", "sigma_north_mm", "sigma_up_mm")
TURN_COLUMNS = ("yaw_deg", "pitch_deg", "roll_deg")
_ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
#: A line of a ``.MRK`` file: number, time, week, antenna to sensor [mm], place of the sensor ("after compensation"; DJI
#: Matrice 4 user manual, p. 92), sigmas north, east, up [m], status 50 (fixed), 34 (float), 16 (single).
_NUMBER = r"([-+]?(?:\d+\.?\d*|\.\d+))"
_MRK = re.compile(
    rf"^(\d+)\s+{_NUMBER}\s+\[\d+\]\s+{_NUMBER},N\s+{_NUMBER},E\s+{_NUMBER},V\s+{_NUMBER},Lat\s+{_NUMBER},Lon\s+"
    rf"{_NUMBER},Ellh\s+{_NUMBER},\s*{_NUMBER},\s*{_NUMBER}\s+(\d+),Q"
)
#: Status of a line without a position.
_NO_POSITION = 0
#: DJI numbers the photos of a flight in their names.
_NUMBER_IN_NAME = re.compile(r"_(\d{4})(?:_\w*)?\.\w+$")


@dataclass(frozen=True, slots=True, eq=False)
class DronePositions(ShortRepr):
    """Places of photos, east, north and up.

    photos length n: Names of the photos.
    enu_m (n, 3): Places about some origin [m].
    sigma_m (n, 3): Their standard deviations [m].
    turns_deg (n, 3): Yaw, pitch and roll of the camera, in this order about down, right and forward axes that start
        north, east and down; NaN where nobody says [deg].
    """

    photos: tuple[str, ...]
    enu_m: FloatArray
    sigma_m: FloatArray
    turns_deg: FloatArray

    def enu_from_camera(self, number: int) -> FloatArray | None:
        """Return the rotation of a photo's camera (x right, y down, z forward), shape (3, 3); None where unknown."""
        if not np.isfinite(self.turns_deg[number]).all():
            return None
        yaw, pitch, roll = (
            rotation_from_vector(np.radians(angle) * axis)
            for angle, axis in zip(self.turns_deg[number], np.eye(3)[::-1], strict=True)
        )
        ned_from_body = yaw @ pitch @ roll
        return np.asarray(_ENU_FROM_NED @ ned_from_body[:, [1, 2, 0]])


def positions_of_photos(files: Sequence[Path], default_sigma_m: float) -> DronePositions:
    """Read positions from the tags of photos.

    default_sigma_m: Standard deviation where the tags say none [m].
    Returns: Of the photos that have a position.
    InputError: No photo has one.
    """
    rows: dict[str, tuple[float, ...]] = {}
    for file in files:
        with open_regular(file) as stream:
            tag = drone_tag(stream.read(EXIF_BYTES))
        if tag is not None:
            sigma = tag.sigma_m or (default_sigma_m,) * 3
            turns = tag.turns_deg or (np.nan,) * 3
            rows[file.name] = (tag.latitude_deg, tag.longitude_deg, tag.altitude_m, *sigma, *turns)
    if not rows:
        raise InputError(
            "positions: no photo says in EXIF or XMP where it was taken; name the drone's log: [positions] file = ..."
        )
    return _of_degrees(rows)


def read_positions(path: Path, files: Sequence[Path], default_sigma_m: float) -> DronePositions:
    """Read positions from a log of the drone or of the software that processed its raw data.

    path: ``.MRK`` file of DJI, or a table with the columns image, latitude_deg, longitude_deg, altitude_m or image,
        east_m, north_m, up_m; with sigma_east_mm, sigma_north_mm, sigma_up_mm, and yaw_deg, pitch_deg, roll_deg of the
        camera, where they are known.
    files: The photos; a ``.MRK`` file counts them by the numbers in their names, or else in their order.
    default_sigma_m: Standard deviation where the log says none, or 0 in a ``.MRK`` file [m].
    Returns: Of the photos that have a position.
    InputError: A file that is neither, a cell that is no number, a photo or a number given twice, or as many lines as
        no photos have.
    """
    if path.suffix.lower() == ".mrk":
        return _read_mrk(path, files, default_sigma_m)
    table = read_table_csv(path, ("image",))
    columns = next((one for one in (GEODETIC_COLUMNS, LOCAL_COLUMNS) if set(one) <= set(table)), None)
    if columns is None:
        raise InputError(f"{path}: columns {', '.join(GEODETIC_COLUMNS)} or {', '.join(LOCAL_COLUMNS)} are needed")
    has_turns = set(TURN_COLUMNS) <= set(table)
    has_sigmas = set(SIGMA_COLUMNS) <= set(table)
    rows: dict[str, tuple[float, ...]] = {}
    for line, name in enumerate(table["image"]):
        where = f"{path}, photo {name}"
        if name in rows:
            raise InputError(f"{where}: given twice; keep one line")
        place = [_number(table[column][line], f"{where}, {column}") for column in columns[1:]]
        sigma = [default_sigma_m] * 3
        if has_sigmas:
            sigma = [1e-3 * _number(table[column][line], f"{where}, {column}") for column in SIGMA_COLUMNS]
        if min(sigma) <= 0:
            raise InputError(f"{where}: a sigma above 0 is needed")
        turns = [np.nan] * 3
        if has_turns:
            turns = [_number(table[column][line], f"{where}, {column}") for column in TURN_COLUMNS]
        rows[name] = (*place, *sigma, *turns)
    if columns is GEODETIC_COLUMNS:
        return _of_degrees(rows)
    values = np.array(list(rows.values())).reshape(-1, 9)
    return DronePositions(tuple(rows), values[:, :3], values[:, 3:6], values[:, 6:])


def _read_mrk(path: Path, files: Sequence[Path], default_sigma_m: float) -> DronePositions:
    lines: dict[int, tuple[float, ...] | None] = {}
    for number, text in enumerate(read_text(path, "a .MRK file").splitlines(), start=1):
        if not text.strip():
            continue
        found = _MRK.match(text.strip())
        if found is None:
            raise InputError(f"{path}, line {number}: not a line of a .MRK file: {text[:60]!r}")
        count = int(found[1])
        if count in lines:
            raise InputError(f"{path}, line {number}: number {count} is given twice; give the log of one flight")
        sigma = [float(found[k]) or default_sigma_m for k in (10, 9, 11)]
        place = [float(found[k]) for k in (6, 7, 8)]
        lines[count] = None if int(found[12]) == _NO_POSITION else (*place, *sigma, *(np.nan,) * 3)
    named = {file.name: _NUMBER_IN_NAME.search(file.name) for file in files}
    found_lines: dict[str, tuple[float, ...] | None] = {}
    if all(named.values()):
        numbers = {name: int(hit[1]) for name, hit in named.items() if hit}
        # Lenses of one camera have letters of their own: DJI_0001_V.JPG, DJI_0001_W.JPG.
        ends = [hit[0] for hit in named.values() if hit]
        twice = [name for name, end in zip(numbers, ends, strict=True) if ends.count(end) > 1]
        if twice:
            raise InputError(
                f"{path}: {' and '.join(sorted(twice)[:2])} have one number, as photos of two flights: which is whose? "
                "Give a table with the column image instead"
            )
        found_lines = {name: lines.get(count) for name, count in numbers.items()}
    elif len(files) == len(lines):
        found_lines = dict(zip([file.name for file in files], [lines[key] for key in sorted(lines)], strict=True))
    else:
        raise InputError(
            f"{path}: {len(lines)} lines for {len(files)} photos whose names have no numbers like DJI_0001.JPG: which "
            "is whose? Give a table with the column image instead"
        )
    return _of_degrees({name: row for name, row in found_lines.items() if row is not None})


def _of_degrees(rows: Mapping[str, tuple[float, ...]]) -> DronePositions:
    values = np.array(list(rows.values())).reshape(-1, 9)
    if not len(values):
        return DronePositions((), values[:, :3], values[:, 3:6], values[:, 6:])
    origin = np.median(values[:, :3], axis=0).tolist()
    return DronePositions(
        tuple(rows),
        enu_from_geodetic(values[:, 0], values[:, 1], values[:, 2], origin),
        values[:, 3:6],
        values[:, 6:],
    )


def _number(cell: str, where: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(f"{where}: {cell!r} is not a number")
    return value
