"""Backlash of a heliostat's drives: by a laser on the mirror, and by the normals that spots of both ends give."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heliogauge.errors import EstimationError, InputError
from heliogauge.validate import FloatArray, float_array, freeze, positive

__all__ = ["Backlash", "backlash_from_marks", "backlash_from_normals", "normals_from_spots"]


@dataclass(frozen=True, slots=True)
class Backlash:
    """Play of one axis.

    full_rad: Angle of the axis (and of the normal) between both ends of the play [rad].
    sigma_full_rad: Its standard deviation; NaN where it cannot be known [rad].
    """

    full_rad: float
    sigma_full_rad: float

    @property
    def half_rad(self) -> float:
        """Half the play, as data sheets of drives give it (plus or minus) [rad]."""
        return self.full_rad / 2


def backlash_from_marks(marks_m: npt.ArrayLike, distance_m: float, *, sigma_mark_m: float | None = None) -> Backlash:
    """Evaluate marks of a laser that is fixed to the mirror (Stage-STE 12.6, 1.3.5.2).

    marks_m (n, 2): Marks on the wall after coming from one side and from the other, along the axis' motion; one row
        for each repetition [m].
    distance_m: From the axis to the wall [m].
    sigma_mark_m: Uncertainty of one mark; from the scatter of the repetitions if absent [m].
    Returns: ``2 alpha = A A' / d``: the laser's beam is direct, so there is no further factor of two.
    InputError: No rows, or a distance that is not positive.
    """
    marks = float_array("marks_m", marks_m, (None, 2))
    distance = positive("distance_m", distance_m, "metres")
    if marks.shape[0] == 0:
        raise InputError("marks_m: at least one pair of marks is needed")
    separations = marks[:, 1] - marks[:, 0]
    n = separations.size
    if sigma_mark_m is not None:
        sigma = np.sqrt(2 / n) * positive("sigma_mark_m", sigma_mark_m, "metres")
    else:
        sigma = float(separations.std(ddof=1)) / np.sqrt(n) if n > 1 else float("nan")
    return Backlash(abs(float(separations.mean())) / distance, float(sigma) / distance)


def normals_from_spots(spots_m: npt.ArrayLike, sun_directions: npt.ArrayLike, mirror_m: npt.ArrayLike) -> FloatArray:
    """Return the mirror normals that send the sun to given spots.

    Shapes: mirror_m (3,).
    spots_m (n, 3): Centroids of the beam in the field's frame [m].
    sun_directions (n, 3): Directions to the sun at the same times, of any length.
    Returns (n, 3): Unit normals: the bisectors of the directions to spot and sun.
    InputError: Shapes do not fit, or a spot in the mirror.
    EstimationError: The sun stands exactly behind the mirror as seen from a spot.
    """
    spots = float_array("spots_m", spots_m, (None, 3))
    sun = float_array("sun_directions", sun_directions, (spots.shape[0], 3))
    away = spots - float_array("mirror_m", mirror_m, (3,))
    lengths = np.linalg.norm(away, axis=1), np.linalg.norm(sun, axis=1)
    if not (np.min(lengths[0], initial=1.0) > 0 and np.min(lengths[1], initial=1.0) > 0):
        raise InputError("spots_m, sun_directions: a spot in the mirror, or a direction of length zero")
    middle = away / lengths[0][:, None] + sun / lengths[1][:, None]
    size = np.linalg.norm(middle, axis=1, keepdims=True)
    if size.size and size.min() < 1e-9:
        raise EstimationError("the sun stands opposite to a spot: no mirror reflects it there")
    return freeze(middle / size)


def backlash_from_normals(
    one_end: npt.ArrayLike,
    other_end: npt.ArrayLike,
    *,
    axis: npt.ArrayLike = (0.0, 0.0, 1.0),
    sigma_normal_rad: float | None = None,
) -> Backlash:
    """Evaluate normals of a mirror that was pushed to both ends of its play (Stage-STE 12.6, 2.4).

    one_end, other_end (n, 3): Normals at the ends, one row for each repetition.
    axis (3,): Axis whose play is meant; the vertical one if absent.
    sigma_normal_rad: Uncertainty of a normal in each direction; from the scatter of the repetitions if absent
        [rad].
    Returns: Angle between the projections of both normals on the plane across the axis.
    InputError: Shapes do not fit.
    EstimationError: A normal along the axis: turning about it does not move the normal.
    """
    first = float_array("one_end", one_end, (None, 3))
    second = float_array("other_end", other_end, (first.shape[0], 3))
    direction = float_array("axis", axis, (3,))
    length = float(np.linalg.norm(direction))
    if first.shape[0] == 0 or length == 0:
        raise InputError("backlash: at least one pair of normals, and an axis with a direction, are needed")
    direction = direction / length
    flat = [each - (each @ direction)[:, None] * direction for each in (first, second)]
    sines = [np.linalg.norm(f, axis=1) / np.linalg.norm(n, axis=1) for f, n in zip(flat, (first, second), strict=True)]
    if min(float(s.min()) for s in sines) < 1e-3:
        raise EstimationError("backlash: a normal along the axis does not show how far the axis turned")
    cross = np.einsum("ij,j->i", np.cross(flat[0], flat[1]), direction)
    angles = np.arctan2(cross, np.einsum("ij,ij->i", flat[0], flat[1]))
    n = angles.size
    if sigma_normal_rad is not None:
        sigma = float(np.sqrt(np.mean(1 / sines[0] ** 2 + 1 / sines[1] ** 2) / n)) * positive(
            "sigma_normal_rad", sigma_normal_rad, "radians"
        )
    else:
        sigma = float(angles.std(ddof=1) / np.sqrt(n)) if n > 1 else float("nan")
    return Backlash(abs(float(angles.mean())), sigma)
