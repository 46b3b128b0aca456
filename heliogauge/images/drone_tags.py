"""Where a drone was when it took a JPEG, as the file says: EXIF, and the XMP tags of DJI's drones."""

import re
import struct
from dataclasses import dataclass

import numpy as np

from heliogauge.images.exif import exif_block

#: Tags of the first directory and of that of the positions (EXIF 2.32, table 15), and kinds of values.
_GPS_POINTER = 0x8825
_SOUTH_OR_NORTH, _LATITUDE, _EAST_OR_WEST, _LONGITUDE, _BELOW, _ALTITUDE = 1, 2, 3, 4, 5, 6
_RATIONAL = 5
#: Names of DJI's numbers in XMP, as an attribute or an element.
_XMP = re.compile(rb'drone-dji:(\w+)\s*(?:=\s*"\s*([-+.\deE]+)\s*"|>\s*([-+.\deE]+)\s*<)')
_PLACE = ("GpsLatitude", "GpsLongitude", "AbsoluteAltitude")
_OTHER_SPELLING = {"GpsLongtitude": "GpsLongitude", "Latitude": "GpsLatitude", "Longitude": "GpsLongitude"}
_TURNS = ("GimbalYawDegree", "GimbalPitchDegree", "GimbalRollDegree")
_SIGMAS = ("RtkStdLon", "RtkStdLat", "RtkStdHgt")


@dataclass(frozen=True, slots=True)
class DroneTag:
    """Where a photo was taken.

    latitude_deg, longitude_deg: Geodetic, north and east positive [deg].
    altitude_m: Above whatever the drone counts from [m].
    sigma_m: Standard deviations east, north, up by the receiver; None where the file says none [m].
    turns_deg: Yaw, pitch and roll of the camera by the gimbal; None where the file says none [deg].
    """

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    sigma_m: tuple[float, float, float] | None = None
    turns_deg: tuple[float, float, float] | None = None


def drone_tag(content: bytes) -> DroneTag | None:
    """Return where a photo was taken from the beginning of its file.

    content: The first `heliogauge.images.exif.EXIF_BYTES`, or more.
    Returns: By XMP where it is there, which has more digits than EXIF; None where the file says nothing, or latitude
        and longitude 0, as drones write before they have a position.
    """
    said = {}
    for name, attribute, element in _XMP.findall(content):
        try:
            said[_OTHER_SPELLING.get(name.decode("ascii"), name.decode("ascii"))] = float(attribute or element)
        except ValueError:
            continue
    place = [said.get(name, np.nan) for name in _PLACE]
    if not np.isfinite(place).all():
        found = _of_exif(content)
        if found is None:
            return None
        place = list(found)
    if place[0] == place[1] == 0:
        return None
    sigmas = tuple(said.get(name, np.nan) for name in _SIGMAS)
    is_known = np.isfinite(sigmas).all() and min(sigmas) > 0
    turns = tuple(said.get(name, np.nan) for name in _TURNS)
    return DroneTag(
        place[0],
        place[1],
        place[2],
        (sigmas[0], sigmas[1], sigmas[2]) if is_known else None,
        (turns[0], turns[1], turns[2]) if np.isfinite(turns).all() else None,
    )


def _of_exif(content: bytes) -> tuple[float, float, float] | None:
    block = exif_block(content)
    if block is None:
        return None
    tiff, order = block
    try:
        (first,) = struct.unpack_from(order + "I", tiff, 4)
        start = _entries(tiff, order, first).get(_GPS_POINTER)
        if start is None:
            return None
        (gps,) = struct.unpack_from(order + "I", tiff, start[1] + 8)
        entries = _entries(tiff, order, gps)
        latitude, longitude = (_angle(tiff, order, entries, tag) for tag in (_LATITUDE, _LONGITUDE))
        height = _rationals(tiff, order, entries, _ALTITUDE, 1)
        is_south = tiff[entries[_SOUTH_OR_NORTH][1] + 8 : entries[_SOUTH_OR_NORTH][1] + 9] == b"S"
        is_west = tiff[entries[_EAST_OR_WEST][1] + 8 : entries[_EAST_OR_WEST][1] + 9] == b"W"
        is_below = _BELOW in entries and tiff[entries[_BELOW][1] + 8] == 1
    except (struct.error, KeyError, ZeroDivisionError, IndexError):
        # A damaged or incomplete tag block says nothing.
        return None
    return (
        -latitude if is_south else latitude,
        -longitude if is_west else longitude,
        -height[0] if is_below else height[0],
    )


def _entries(tiff: bytes, order: str, start: int) -> dict[int, tuple[int, int]]:
    """Return kind of value and place of each tag of a directory."""
    (count,) = struct.unpack_from(order + "H", tiff, start)
    found = {}
    for k in range(count):
        place = start + 2 + 12 * k
        tag, kind = struct.unpack_from(order + "HH", tiff, place)
        found[tag] = (kind, place)
    return found


def _angle(tiff: bytes, order: str, entries: dict[int, tuple[int, int]], tag: int) -> float:
    degrees, minutes, seconds = _rationals(tiff, order, entries, tag, 3)
    return degrees + minutes / 60 + seconds / 3600


def _rationals(tiff: bytes, order: str, entries: dict[int, tuple[int, int]], tag: int, count: int) -> list[float]:
    kind, place = entries[tag]
    if kind != _RATIONAL:
        raise KeyError(tag)
    (at,) = struct.unpack_from(order + "I", tiff, place + 8)
    parts = struct.unpack_from(order + 2 * count * "I", tiff, at)
    return [top / bottom for top, bottom in zip(parts[::2], parts[1::2], strict=True)]
