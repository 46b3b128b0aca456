"""The tower's file of the PAINT database: flat targets of beams."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from heliogauge.errors import InputError
from heliogauge.geometry.geodesy import enu_from_geodetic
from heliogauge.geometry.target_planes import PlaneTarget
from heliogauge.results.json_file import read_json
from heliogauge.validate import FloatArray

__all__ = ["Targets", "find_tower", "read_targets"]

_TOWER_FILES = ("*tower-measurements.json", "*tower_measurements.json", "tower.json")
_CORNERS = ("upper_left", "upper_right", "lower_right", "lower_left")


@dataclass(frozen=True, slots=True, eq=False)
class Targets:
    """Flat targets of a tower.

    origin: Latitude [deg], longitude [deg], altitude [m] of the field's frame.
    planes: Targets by name.
    corners_m (4, 2): Corners of each on its plane: upper left, upper right, lower right, lower left [m].
    """

    origin: tuple[float, float, float]
    planes: dict[str, PlaneTarget]
    corners_m: dict[str, FloatArray]


def find_tower(folder: Path) -> Path:
    """Find the tower's file in a folder, in ``tower`` beside it, or in one of the three folders above.

    InputError: There is none.
    """
    start = folder.resolve()
    for home in (start, *list(start.parents)[:3]):
        for place in (home, home / "tower"):
            for pattern in _TOWER_FILES:
                if found := sorted(place.glob(pattern)):
                    return found[0]
    raise InputError(
        f"{folder}: the tower's file ({_TOWER_FILES[0]}) is neither here nor in a folder above; name it as [paint] "
        f"tower "
        "in measurement.toml"
    )


def read_targets(file: Path) -> Targets:
    """Read the flat targets of a tower.

    InputError: Not JSON, or a key is missing.
    """
    content = read_json(file)
    try:
        latitude, longitude, altitude = (float(one) for one in content["power_plant_properties"]["coordinates"])
        origin = (latitude, longitude, altitude)
        planes, corners = {}, {}
        for name, target in content.items():
            if name == "power_plant_properties" or target.get("type", "planar") != "planar":
                continue
            measured = np.array([target["coordinates"][corner] for corner in _CORNERS], dtype=np.float64)
            places = enu_from_geodetic(measured[:, 0], measured[:, 1], measured[:, 2], origin)
            planes[name] = PlaneTarget.from_corners(name, places)
            corners[name] = planes[name].coordinates(places)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"{file}: not a tower's file of the PAINT database ({type(error).__name__}: {error})"
        ) from error
    return Targets(origin, planes, corners)
