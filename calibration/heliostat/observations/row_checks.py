"""What is wrong with a heliostat's rows: units, sun, repeats, columns that never change.

What is wrong with single rows makes them flagged rows; what is wrong with a whole column is one `InputError`, because
no number that comes of it would be true.
"""

from dataclasses import replace

import numpy as np

from calibration.heliostat.kinematic_model.design import HeliostatDesign, LinearActuator
from calibration.heliostat.observations.rows import ColumnError, Rows, Verdicts
from heliogauge.errors import InputError
from heliogauge.geometry.sun import Site, direction_from_angles, sun_directions
from heliogauge.validate import BoolArray, FloatArray, TimeArray

#: Rows from which on a column can be judged as a whole.
_ENOUGH = 5
#: Share of rows that must be wrong in the same way before the column is.
_MOST = 0.9
#: A sun farther than this from where its time puts it is another sun: 10 mrad are 2.3 minutes.
_SUN_LIMIT_RAD = 0.010
#: As a whole the plant's sun and SPA agree to 0.02 mrad; conventions are wrong by degrees.
_CONVENTION_LIMIT_RAD = 0.020
_TURN = 2 * np.pi


def readings_of(rows: Rows, design: HeliostatDesign, verdicts: Verdicts) -> FloatArray:
    """Return the readings of both drives in the design's unit.

    design: Says the unit and the limits.
    verdicts: Takes rows whose readings are missing or cannot be.
    Returns (n, 2): Readings; NaN where there are none.
    InputError: Readings in a unit that the design has no use for, or a whole column that is in another unit than it
        says.
    """
    unit = next((one for one in ("counts", "deg", "rad") if f"axis_1_{one}" in rows.numbers), "rad")
    names = [f"axis_{axis}_{unit}" for axis in (1, 2)]
    values = rows.vector(*names)
    if (unit == "counts") != (design.reading_unit == "counts"):
        raise InputError(_wrong_kind(design, unit))
    if unit != "counts":
        _check_angles(values, names, unit, verdicts)
        values = np.deg2rad(values) if unit == "deg" else values
    verdicts.refuse(~np.isfinite(values).all(axis=1), "not_finite", f"{' or '.join(names)} is missing or not finite")
    low, high = design.limits.T
    outside: BoolArray = np.asarray((values < low) | (values > high))
    verdicts.refuse(outside.any(axis=1), "reading", lambda row: _outside_text(design, names, values[row], outside[row]))
    return values


def _wrong_kind(design: HeliostatDesign, unit: str) -> str:
    if unit == "counts":
        return f"{design.name}: readings are counts, which mean no angle yet; give counts_per_turn in [kinematics]"
    if isinstance(design.drives[0], LinearActuator):
        return f"{design.name}: linear actuators are read in counts (axis_1_counts, axis_2_counts), not in {unit}"
    return f"{design.name}: counts_per_turn belongs to readings in counts; the table has axis_1_{unit}"


def _check_angles(values: FloatArray, names: list[str], unit: str, verdicts: Verdicts) -> None:
    known = values[verdicts.usable & np.isfinite(values).all(axis=1)]
    enough = len(known) >= _ENOUGH
    if unit == "rad":
        beyond: BoolArray = np.asarray(np.isfinite(values) & (np.abs(values) > 1.05 * _TURN))
        if enough and (np.abs(known) > 1.05 * _TURN).any(axis=1).mean() > _MOST:
            worst = names[int(np.argmax(np.abs(known).max(axis=0)))]
            raise ColumnError(
                "units",
                f"{worst}: values such as {np.abs(known).max():g} are no radians; name the columns axis_1_deg, "
                "axis_2_deg, and let both be degrees",
            )
        verdicts.refuse(
            beyond.any(axis=1), "units", lambda row: f"{names[int(np.argmax(beyond[row]))]}: degrees among radians?"
        )
        return
    if not enough:
        return
    if (np.abs(known) < 1.05 * _TURN).all() and np.ptp(known, axis=0).max() < _TURN:
        raise ColumnError(
            "units",
            f"{names[0]}, {names[1]}: all values lie within {np.abs(known).max():.2f}: they look like radians; name "
            "the columns axis_1_rad, axis_2_rad",
        )
    # Both axes of one row within a radian's range, where others are far beyond it: taken over in another unit.
    small = (np.abs(values) < 1.6).all(axis=1) & (values != 0).all(axis=1)
    if (np.abs(known).min(axis=1) > 5).mean() > _MOST:
        verdicts.refuse(small, "units", "both readings are below 1.6 degrees: radians among degrees?")


def _outside_text(design: HeliostatDesign, names: list[str], values: FloatArray, outside: BoolArray) -> str:
    axis = int(np.argmax(outside))
    low, high = design.limits[axis]
    return f"{names[axis]}: {values[axis]:g} {design.reading_unit} is beyond the drive's limits {low:g} to {high:g}"


# --- the sun ----------------------------------------------------------------------------------------------------------


def suns_of(rows: Rows, site: Site, verdicts: Verdicts, needed: BoolArray) -> tuple[FloatArray, float]:
    """Return the direction to the sun of each row: as recorded, else from its time.

    verdicts: Takes rows without a sun, with one below the horizon, and with one that contradicts its time.
    needed (n,): Rows that are nothing without the sun.
    Returns (n, 3): Unit vectors to the apparent sun; NaN where there is none.
    Returns: Median angle between the sun as recorded and as SPA has it [rad]; NaN where not both are there.
    InputError: The suns as recorded are in radians, or counted by another convention, or the times are of another zone.
    """
    recorded = np.deg2rad(rows.vector("sun_azimuth_deg", "sun_elevation_deg"))
    is_recorded: BoolArray = np.asarray(np.isfinite(recorded).all(axis=1))
    _refuse_radians(np.rad2deg(recorded[is_recorded & verdicts.usable]))
    timed = ~np.isnat(rows.times)
    suns, computed = np.full((len(rows), 3), np.nan), np.full((len(rows), 3), np.nan)
    suns[is_recorded] = direction_from_angles(recorded[is_recorded, 0], recorded[is_recorded, 1])
    if timed.any():
        computed[timed] = sun_directions(rows.times[timed], site)
    both = is_recorded & timed & verdicts.usable & needed
    apart = _angle(suns, computed)
    median = float(np.median(apart[both])) if both.any() else float("nan")
    if np.count_nonzero(both) >= _ENOUGH and median > _CONVENTION_LIMIT_RAD:
        raise _convention(recorded[both], rows.times[both], site, median)

    def aside(row: int) -> str:
        return f"the sun as recorded is {1e3 * apart[row]:.0f} mrad from where {rows.times[row]}Z puts it"

    with np.errstate(invalid="ignore"):
        verdicts.refuse(both & (apart > _SUN_LIMIT_RAD), "sun", aside)
    suns = np.where(is_recorded[:, None], suns, computed)
    verdicts.refuse(needed & ~np.isfinite(suns).all(axis=1), "time", "neither a time nor the sun's angles")
    verdicts.refuse(
        needed & (suns[:, 2] <= 0),
        "sun",
        lambda row: f"the sun is {-np.rad2deg(np.arcsin(suns[row, 2])):.1f} degrees below the horizon",
    )
    return suns, median


def _angle(one: FloatArray, other: FloatArray) -> FloatArray:
    return np.asarray(2 * np.arcsin(np.clip(np.linalg.norm(one - other, axis=1) / 2, 0, 1)))


def _refuse_radians(angles_deg: FloatArray) -> None:
    azimuth, elevation = angles_deg.T
    if len(angles_deg) >= _ENOUGH and elevation.max() < 1.6 and np.abs(azimuth).max() < 1.05 * _TURN:
        raise ColumnError(
            "units",
            f"sun_elevation_deg: no value is above {elevation.max():.2f}, and azimuths lie within "
            f"{np.abs(azimuth).max():.2f}: they look like radians",
        )


def _convention(recorded: FloatArray, times: TimeArray, site: Site, median: float) -> ColumnError:
    """Find the convention by which the suns as recorded would be those of their times."""
    truth = sun_directions(times, site)
    azimuth, elevation = recorded.T
    azimuths = {
        "the azimuth is 0 in the south and positive to the east: write 180 - azimuth": np.pi - azimuth,
        "the azimuth is 0 in the south and positive to the west: write 180 + azimuth": np.pi + azimuth,
        "the azimuth is counter-clockwise from the north: write -azimuth": -azimuth,
        "the azimuth is counter-clockwise from the east: write 90 - azimuth": np.pi / 2 - azimuth,
    }
    for text, form in azimuths.items():
        if _is_same(direction_from_angles(form, elevation), truth):
            return ColumnError("sun_convention", f"sun_azimuth_deg: {text}")
    if _is_same(direction_from_angles(azimuth, np.pi / 2 - elevation), truth):
        return ColumnError("sun_convention", "sun_elevation_deg: it is the zenith angle; write 90 - angle")
    # Azimuths from the south were brought to the north as degrees before.
    for half in (0.0, np.pi):
        turned = np.rad2deg(azimuth - half) + half
        if _is_same(direction_from_angles(turned, np.rad2deg(elevation)), truth):
            return ColumnError("units", "sun_azimuth_deg, sun_elevation_deg: they are in radians; write degrees")
    suns = direction_from_angles(azimuth, elevation)
    for text, other in _other_sites(site).items():
        if _is_same(suns, sun_directions(times, other)):
            place = f"{site.latitude_deg:g}, {site.longitude_deg:g} deg"
            return ColumnError("site", f"site at {place}: the sun as recorded is that of {text}")
    for minutes in range(-14 * 60, 14 * 60 + 1, 15):
        if _is_same(suns, sun_directions(times - np.timedelta64(minutes, "m"), site)):
            return ColumnError(
                "time_offset",
                f"time_utc: the recorded sun is that of a zone {minutes / 60:+.4g} h from UTC; write it with the times",
            )
    return ColumnError(
        "sun_convention",
        f"the sun as recorded is {1e3 * median:.0f} mrad (median) from where its times put it; azimuths from the south "
        "or the east or counter-clockwise, zenith angles, radians, signs and order of the site's latitude and "
        "longitude, and zones of the times were tried, and none explains it; azimuth must be "
        "0 in the north and clockwise, elevation from the horizon",
    )


def _is_same(one: FloatArray, other: FloatArray) -> bool:
    return bool(np.median(_angle(one, other)) < _CONVENTION_LIMIT_RAD)


def _other_sites(site: Site) -> dict[str, Site]:
    """Return the site with signs and order of its coordinates read otherwise."""
    latitude, longitude = site.latitude_deg, site.longitude_deg
    found = {
        "a latitude of the other sign": (-latitude, longitude),
        "a longitude of the other sign": (latitude, -longitude),
        "a latitude and a longitude of the other sign": (-latitude, -longitude),
        "latitude and longitude exchanged": (longitude, latitude),
    }
    return {
        text: replace(site, latitude_deg=one, longitude_deg=other)
        for text, (one, other) in found.items()
        if abs(one) <= 90
    }


# --- repeats and constants --------------------------------------------------------------------------------------------


def refuse_repeats(rows: Rows, verdicts: Verdicts) -> None:
    """Refuse rows that repeat an earlier one: they would count twice.

    verdicts: Takes the repeats.
    """
    numbers = np.column_stack([*rows.numbers.values(), np.zeros(len(rows))])
    texts = list(zip(*(rows.texts[name] for name in rows.texts if name not in ("split", "time_utc")), strict=True))
    seen: dict[bytes, list[int]] = {}
    # A row without a time is no other measurement for that, and the one to leave out.
    for row in np.argsort(np.isnat(rows.times), kind="stable").tolist():
        if verdicts.flags[row] == "unreadable":
            continue
        key = numbers[row].tobytes() + repr(texts[row] if texts else ()).encode()
        before, time = seen.setdefault(key, []), rows.times[row]
        alike = (one for one in before if np.isnat(time) or rows.times[one] == time)
        first = next(alike, None)
        if first is None:
            before.append(row)
        else:
            verdicts.refuse(np.arange(len(rows)) == row, "duplicate", f"the same as {rows.ids[first]}")


def refuse_constants(readings: FloatArray, suns: FloatArray, where: BoolArray, name: str) -> None:
    """Refuse columns that never change although the sun moved.

    Shapes: suns (n, 3).
    readings (n, 2): Readings of both drives.
    where (n,): Usable rows that need the sun.
    name: The heliostat, for the message.
    InputError: A drive, or the sun, is the same in all rows.
    """
    count = int(np.count_nonzero(where))
    if count < _ENOUGH:
        return
    if np.ptp(suns[where], axis=0).max() == 0:
        raise ColumnError(
            "constant_column",
            f"{name}: the sun stands at the same place in all {count} rows; are its columns recorded?",
        )
    for axis in (0, 1):
        if np.ptp(readings[where, axis]) == 0:
            raise ColumnError(
                "constant_column",
                f"{name}: axis {axis + 1} reads {readings[where, axis][0]:g} in all {count} rows, although the sun "
                "moved; is its column recorded?",
            )
