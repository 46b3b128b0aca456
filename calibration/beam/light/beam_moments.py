"""Size and shape of a beam on the target: moments, ellipse, widths (stage_ste 1.2.4.1, with the central moment)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from heliogauge.errors import EstimationError, InputError
from heliogauge.validate import FloatArray, float_array, freeze

__all__ = ["BeamMoments", "beam_moments", "encircled_diameters_m", "light_within"]


@dataclass(frozen=True, slots=True, eq=False)
class BeamMoments:
    """Moments of a brightness on a plane up to the second order.

    total: Sum of the brightness times the area of a pixel [DN m^2].
    centroid_m (2,): x and y of the centroid [m].
    covariance_m2 (2, 2): Central second moments over the total: the square of the beam's own width, not an
        uncertainty [m^2].

    Stage-STE 12.6, 1.2.4.1: ``sigma_x = sqrt(mu20/M00)``, ``cov = mu11/M00`` (the report prints the raw moment M11,
    with which the ellipse would depend on the origin), ``e = sqrt(lambda_u/lambda_v)``, ``alpha`` = direction of the
    eigenvector of the larger eigenvalue.
    """

    total: float
    centroid_m: FloatArray
    covariance_m2: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "centroid_m", float_array("centroid_m", self.centroid_m, (2,), finite=False))
        shape = float_array("covariance_m2", self.covariance_m2, (2, 2), finite=False)
        object.__setattr__(self, "covariance_m2", shape)

    @property
    def widths_m(self) -> FloatArray:
        """Standard deviations of the beam along its major and minor axis, shape (2,) [m]."""
        if not np.isfinite(self.covariance_m2).all():
            return np.full(2, np.nan)
        values = np.linalg.eigvalsh(self.covariance_m2)[::-1]
        return np.asarray(np.sqrt(np.maximum(values, 0.0)))

    @property
    def d4sigma_m(self) -> FloatArray:
        """Four times the standard deviation along the major and minor axis (ISO 11146), shape (2,) [m]."""
        return 4 * self.widths_m

    @property
    def ellipticity(self) -> float:
        """Major over minor width, at least 1."""
        major, minor = self.widths_m
        return float(major / minor) if minor > 0 else float("inf")

    @property
    def direction_rad(self) -> float:
        """Direction of the major axis from +x, counterclockwise, in (-pi/2, pi/2] [rad]."""
        if not np.isfinite(self.covariance_m2).all():
            return float("nan")
        (xx, xy), (_, yy) = self.covariance_m2
        return float(0.5 * np.arctan2(2 * xy, xx - yy))

    @property
    def angle_to_vertical_rad(self) -> float:
        """Angle of the major axis from +y, clockwise, in (-pi/2, pi/2] (CyI's ellipse, Stage-STE 2.2) [rad]."""
        angle = np.pi / 2 - self.direction_rad
        return float(angle - np.pi if angle > np.pi / 2 else angle)


def beam_moments(values_dn: npt.ArrayLike, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> BeamMoments:
    """Compute the moments of a brightness on a regular grid.

    values_dn (h, w): Brightness without its background; 0 where it is not to count [DN].
    x_m (w,): Position of each column, evenly spaced [m].
    y_m (h,): Position of each row, evenly spaced [m].
    Returns: Total, centroid, central second moments.
    InputError: Shapes do not fit, a value is not finite, fewer than two rows or columns.
    EstimationError: The total is not positive.

    >>> moments = beam_moments([[0, 1, 0], [1, 1, 1], [0, 1, 0]], [-1, 0, 1], [1, 0, -1])
    >>> moments.covariance_m2
    array([[0.4, 0. ],
           [0. , 0.4]])
    """
    values = float_array("values_dn", values_dn, (None, None))
    x, y = float_array("x_m", x_m, (values.shape[1],)), float_array("y_m", y_m, (values.shape[0],))
    if min(values.shape) < 2:
        raise InputError(f"values_dn: at least two rows and columns are needed, not {values.shape}")
    columns, rows = values.sum(axis=0), values.sum(axis=1)
    total = float(columns.sum())
    if not total > 0:
        raise EstimationError(f"the brightness adds up to {total:.4g} DN: there is no beam to take moments of")
    center_x, center_y = float(columns @ x) / total, float(rows @ y) / total
    dx, dy = x - center_x, y - center_y
    xx, yy = float(columns @ dx**2) / total, float(rows @ dy**2) / total
    xy = float(dy @ values @ dx) / total
    area = abs((x[1] - x[0]) * (y[1] - y[0]))
    return BeamMoments(total * float(area), np.array([center_x, center_y]), np.array([[xx, xy], [xy, yy]]))


def encircled_diameters_m(
    values_dn: npt.ArrayLike, x_m: FloatArray, y_m: FloatArray, center_m: npt.ArrayLike, shares: Sequence[float]
) -> FloatArray:
    """Return the diameters of the circles that hold given shares of a beam.

    Shapes: center_m (2,).
    values_dn (h, w): Brightness without its background; 0 where it is not to count [DN].
    x_m (w,): Position of each column [m].
    y_m (h,): Position of each row [m].
    shares: Shares of the total between 0 and 1.
    Returns (len(shares),): Diameters; NaN where the total is not positive [m].
    InputError: A share outside 0 to 1, or shapes that do not fit.

    The brightness is gathered in rings as wide as half a pixel and added up outwards; where noise makes the sum fall
    again, the first crossing counts.
    """
    values = float_array("values_dn", values_dn, (None, None))
    center = float_array("center_m", center_m, (2,))
    wanted = np.asarray(shares, dtype=np.float64)
    if not ((wanted > 0) & (wanted < 1)).all():
        raise InputError(f"shares: numbers between 0 and 1 are needed, not {tuple(shares)}")
    total = float(values.sum())
    if not total > 0:
        return np.full(wanted.size, np.nan)
    within = light_within(values, x_m, y_m, center)
    return freeze(2 * np.interp(wanted, within.light_dn / total, within.radius_m))


class LightWithin(NamedTuple):
    """Radii of circles [m] and the light in them, which never falls [DN]."""

    radius_m: FloatArray
    light_dn: FloatArray


def light_within(values_dn: FloatArray, x_m: FloatArray, y_m: FloatArray, center_m: FloatArray) -> LightWithin:
    """Add up brightness in circles about a centre; their radii grow by half a pixel.

    Shapes: center_m (2,).
    values_dn (h, w): Brightness without its background; 0 where it is not to count [DN].
    x_m (w,): Position of each column [m].
    y_m (h,): Position of each row [m].
    """
    # A ring as wide as a pixel holds too few of them near the middle; radii that matter are tens of pixels.
    step = 0.5 * float(np.sqrt(abs((x_m[1] - x_m[0]) * (y_m[1] - y_m[0]))))
    x, y = (((axis - middle) / step).astype(np.float32) for axis, middle in ((x_m, center_m[0]), (y_m, center_m[1])))
    squares = (x * x)[None, :] + (y * y)[:, None]
    rings = np.sqrt(squares, out=squares).astype(np.int32)
    sums = np.bincount(rings.ravel(), weights=values_dn.ravel())
    inside = np.concatenate(([0.0], np.cumsum(sums)))
    return LightWithin(np.arange(inside.size) * np.float64(step), np.maximum.accumulate(inside))
