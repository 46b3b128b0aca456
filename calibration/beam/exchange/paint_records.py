"""Records of beams of the PAINT database: a JSON file for each photo.

Several generations of keys are about. The sun's azimuth is 0 in the south and positive to the east, its elevation as
seen; older records have neither sun nor time.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calibration.beam.exchange.tower import Targets
from calibration.beam.keys import PAINT_RECORDS
from heliogauge.errors import InputError
from heliogauge.geometry.geodesy import enu_from_geodetic
from heliogauge.geometry.sun import azimuth_from_south_east, direction_from_angles
from heliogauge.measurement.files import natural_order
from heliogauge.results.json_file import read_json
from heliogauge.validate import FloatArray

__all__ = ["PaintRecord", "read_records"]


@dataclass(frozen=True, slots=True, eq=False)
class PaintRecord:
    """One beam as the plant recorded it.

    number: Number of the record.
    picture: The photo; None where there is none.
    target: Name of the target.
    label_m (2,): Centre of the beam on the target by the plant's own method (UTIS); NaN without one [m].
    to_sun (3,): Direction to the sun: east, north, up; NaN without one.
    readings: Positions of the two motors; NaN without one.
    fault: What is wrong with the record; empty where nothing is.
    """

    number: str
    picture: Path | None
    target: str
    label_m: FloatArray
    to_sun: FloatArray
    readings: tuple[float, float]
    fault: str = ""


def read_records(folder: Path, targets: Targets, pictures: str) -> tuple[PaintRecord, ...]:
    """Read the records of a folder, in the order of their numbers.

    pictures: Which pictures: "cropped" or "flux".
    InputError: No record.
    """
    files = sorted(folder.glob(PAINT_RECORDS), key=lambda file: natural_order(file.name))
    if not files:
        raise InputError(f"{folder}: there is no record ({PAINT_RECORDS})")
    return tuple(_record(file, targets, pictures) for file in files)


def _record(file: Path, targets: Targets, pictures: str) -> PaintRecord:
    number = file.name.replace("_", "-").split("-")[0]
    found = [one for sign in "-_" if (one := file.with_name(f"{number}{sign}{pictures}.png")).is_file()]
    picture = found[0] if found else None
    nowhere, nobody = np.full(2, np.nan), np.full(3, np.nan)
    faults = []
    try:
        content = read_json(file)
        target = str(content["target_name"])
    except (InputError, KeyError, TypeError) as error:
        text = f"record {file.name}: {error}"
        return PaintRecord(number, picture, "", nowhere, nobody, (float("nan"), float("nan")), text)
    if target not in targets.planes:
        faults.append(f"record {file.name}: target {target!r} is not a flat target of the tower")
    if picture is None:
        faults.append(f"record {file.name}: there is no picture {number}-{pictures}.png")
    label = nowhere
    spot = _numbers(content.get("focal_spot", {}), "UTIS", 3)
    if spot is not None and target in targets.planes:
        label = targets.planes[target].coordinates(
            enu_from_geodetic(spot[0], spot[1], spot[2], targets.origin)[None, :]
        )[0]
    sun = nobody
    angles = [_number(content, key) for key in ("sun_azimuth", "sun_elevation")]
    if np.isfinite(angles).all():
        azimuth, elevation = np.radians(angles)
        sun = direction_from_angles(azimuth_from_south_east(azimuth), elevation)
    motors = content.get("motor_position", {})
    readings = tuple(
        next((_number(motors, key) for key in keys if key in motors), float("nan"))
        for keys in (("axis_1_motor_position", "Axis1MotorPosition"), ("axis_2_motor_position", "Axis2MotorPosition"))
    )
    return PaintRecord(number, picture, target, label, sun, (readings[0], readings[1]), "; ".join(faults))


def _number(content: Mapping[str, Any], key: str) -> float:
    try:
        return float(content[key])
    except (KeyError, TypeError, ValueError):
        return float("nan")


def _numbers(content: Any, key: str, count: int) -> FloatArray | None:
    try:
        values = np.array(content[key], dtype=np.float64)
    except (KeyError, TypeError, ValueError):
        return None
    return values if values.shape == (count,) and np.isfinite(values).all() else None
