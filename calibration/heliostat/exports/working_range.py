"""Where a heliostat works: its readings over a year of suns on the plant's targets, and how far two models differ."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calibration.heliostat.fitting.prediction import sun_positions_of_year
from calibration.heliostat.kinematic_model.aiming import aim
from calibration.heliostat.kinematic_model.design import HeliostatDesign
from calibration.heliostat.kinematic_model.kinematics import mirror_poses
from heliogauge.errors import InputError
from heliogauge.geometry.rays import reflect
from heliogauge.geometry.sun import Site
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray

#: The year whose suns stand for every year: the sun's path of one day differs by 0.1 degree from year to year.
_YEAR = 2025
#: Lowest sun at which a heliostat works: below it there are neighbours' shadows and no heat.
_LOWEST_RAD = float(np.radians(5.0))


@dataclass(frozen=True, slots=True, eq=False)
class WorkingRange(ShortRepr):
    """Positions at which a heliostat works.

    readings (n, 2): Readings of both drives in the design's unit.
    approach (n, 2): Direction of each drive's last move; 0 for drives without backlash.
    suns (n, 3): Directions to the sun.
    aim_points_m (n, 3): Where the beam goes [m].
    """

    readings: FloatArray
    approach: FloatArray
    suns: FloatArray
    aim_points_m: FloatArray

    @classmethod
    def of(
        cls,
        design: HeliostatDesign,
        site: Site,
        aim_points_m: Sequence[npt.ArrayLike],
        *,
        day_of_month: int = 10,
        per_day: int = 15,
    ) -> "WorkingRange":
        """Collect the readings of a year.

        design: The calibrated heliostat.
        aim_points_m: Centres of the targets [m].
        day_of_month, per_day: Which day of each month, and how many suns of it.
        InputError: The heliostat can serve no target.
        """
        suns, _ = sun_positions_of_year(
            site, _YEAR, day_of_month=day_of_month, per_day=per_day, least_elevation_rad=_LOWEST_RAD
        )
        # Nobody knows from which side a drive will come: both are asked for.
        sides = (-1.0, 1.0) if any(drive.terms.backlash for drive in design.drives) else (0.0,)
        parts = []
        for point in aim_points_m:
            aimed = aim(design, design.parameters.values, suns, np.asarray(point, dtype=np.float64))
            good = aimed.converged & aimed.within_limits
            count = int(np.count_nonzero(good))
            for side in sides:
                moves, points = np.full((count, 2), side), np.broadcast_to(point, (count, 3))
                parts.append((aimed.readings[good], moves, suns[good], points))
        readings, approach, directions, points = (
            (np.concatenate(columns) for columns in zip(*parts, strict=True)) if parts else np.empty((4, 0, 3))
        )
        if not len(readings):
            raise InputError(
                f"{design.name}: no target can be served over a year, so nothing says what an export would lose"
            )
        return cls(readings, approach, directions, np.asarray(points))

    def beams(self, design: HeliostatDesign, values: npt.ArrayLike) -> "Beams":
        """Return where a model sends the beam at these readings.

        design: A heliostat with the same readings.
        values (p,): Its numbers.
        Returns: NaN where the model cannot have such readings.
        """
        poses = mirror_poses(design, values, self.readings, self.approach, outside="nan")
        return Beams(reflect(-self.suns, poses.normals(design)), poses.centre_m)

    def difference(self, one: "Beams", other: "Beams") -> FloatArray:
        """Return by how much two beams miss each other at the aim points, shape (n, 3) [rad of the beam]."""
        apart = one.centre_m - other.centre_m
        along = np.einsum("ij,ij->i", apart, other.directions)
        distance = np.linalg.norm(self.aim_points_m - other.centre_m, axis=1)
        across = apart - along[:, None] * other.directions
        return np.asarray(one.directions - other.directions + across / distance[:, None])


@dataclass(frozen=True, slots=True, eq=False)
class Beams:
    """Reflected beams.

    directions (n, 3): Unit directions.
    centre_m (n, 3): Where they leave the mirror [m].
    """

    directions: FloatArray
    centre_m: FloatArray


@dataclass(frozen=True, slots=True)
class Loss:
    """By how much the beam of an exported model differs from that of the calibrated one over the working range.

    rms_rad, largest_rad: Root of the mean square, and the largest [rad of the beam]; inf where the exported model has
        no such position.
    """

    rms_rad: float
    largest_rad: float

    @classmethod
    def of(cls, difference_rad: FloatArray) -> "Loss":
        """Summarise differences (n, 3) [rad of the beam]."""
        lengths = np.linalg.norm(difference_rad, axis=1)
        if not np.isfinite(lengths).all():
            return cls(float("inf"), float("inf"))
        return cls(float(np.sqrt(np.mean(lengths**2))), float(lengths.max()))
