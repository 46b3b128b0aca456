"""Slopes at points of a mirror, in any order, and whether they can be those of one."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from heliogauge.errors import InputError
from heliogauge.validate import BoolArray, FloatArray

# Beyond every mirror, and where squares are still far from what a number can hold: 10 km, and 89.94 deg.
_FARTHEST_M, _STEEPEST = 1e4, 1e3


@dataclass(frozen=True, slots=True, eq=False)
class SlopePoints:
    """Slopes of a mirror at points, in any order.

    x_m, y_m (n,): Where they were measured, right and up seen from the front [m].
    slope_x, slope_y (n,): dz/dx and dz/dy; NaN where the mirror was looked at and nothing was found.
    sigma_x, sigma_y (n,): Their standard deviations, NaN where they are not known [rad].
    """

    x_m: FloatArray
    y_m: FloatArray
    slope_x: FloatArray
    slope_y: FloatArray
    sigma_x: FloatArray
    sigma_y: FloatArray

    @property
    def measured(self) -> BoolArray:
        """Points that have both slopes, shape (n,)."""
        return np.asarray(np.isfinite(self.slope_x) & np.isfinite(self.slope_y))


def refuse_implausible(file: Path, points: SlopePoints) -> SlopePoints:
    """Check that numbers can be those of a mirror.

    file: For messages.
    Returns: The same points.
    InputError: Places or slopes beyond all mirrors, or a sigma that is none.
    """
    rows = (
        ("x", points.x_m, -_FARTHEST_M, _FARTHEST_M, "metres"),
        ("y", points.y_m, -_FARTHEST_M, _FARTHEST_M, "metres"),
        ("slope_x", points.slope_x, -_STEEPEST, _STEEPEST, "dz/dx"),
        ("slope_y", points.slope_y, -_STEEPEST, _STEEPEST, "dz/dy"),
        ("sigma_slope_x", points.sigma_x, 0.0, _STEEPEST, "standard deviations of slopes"),
        ("sigma_slope_y", points.sigma_y, 0.0, _STEEPEST, "standard deviations of slopes"),
    )
    for name, values, least, most, what in rows:
        odd = values[(values < least) | (values > most)]
        if odd.size:
            raise InputError(
                f"{file}: {name} = {odd[0]:.6g} ({odd.size} such values); {what} from {least:g} to {most:g} are "
                "needed: correct the unit or the rows"
            )
    return points


def points_words(points: SlopePoints) -> str:
    """Say how many points there are and how far they reach."""
    missing = int(np.count_nonzero(~points.measured))
    without = f" ({missing} without slopes)" if missing else ""
    return f"{points.x_m.size} points{without} over {np.ptp(points.x_m):.4g} x {np.ptp(points.y_m):.4g} m"
