"""Brown's lens distortion in both directions: one closed form, the other solved to round-off, never nonsense."""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from heliogauge.camera import brown_polynomial as brown
from heliogauge.camera.brown_polynomial import BLOCK, BrownCoefficients, InverseStart
from heliogauge.errors import InputError
from heliogauge.validate import FloatArray

#: Order of the coefficients in arrays, Jacobians and covariances (OpenCV's).
COEFFICIENT_NAMES = ("k1", "k2", "p1", "p2", "k3")


class MappedCoordinates(NamedTuple):
    """Coordinates after a map, with its derivatives.

    xy (..., 2): Coordinates.
    d_xy (..., 2, 2): Derivative with respect to the coordinates before.
    d_coefficients (..., 2, 5): Derivative with respect to the coefficients in the order of `COEFFICIENT_NAMES`.
    """

    xy: FloatArray
    d_xy: FloatArray
    d_coefficients: FloatArray


class DistortionDirection(StrEnum):
    """Which way the polynomial goes: OpenCV and COLMAP distort with it, photogrammetry corrects with it."""

    IDEAL_TO_MEASURED = "ideal_to_measured"
    MEASURED_TO_IDEAL = "measured_to_ideal"


@dataclass(frozen=True, slots=True, eq=False)
class BrownDistortion:
    """Brown's distortion of normalised image coordinates (x/z, y/z of a ray).

    k1, k2, k3: Radial coefficients.
    p1, p2: Tangential coefficients as OpenCV names them: p1 goes with y, p2 with x.
    direction: Way of the polynomial.
    invertible_radius: Radius of the disc on which the polynomial is one-to-one, in normalised coordinates of its
        argument: ideal coordinates for IDEAL_TO_MEASURED, measured ones for MEASURED_TO_IDEAL. Infinite when it
        never folds.
    InputError: A coefficient is not finite or the direction has no such name.

    With ``s = x^2 + y^2``::

        X = x (1 + k1 s + k2 s^2 + k3 s^3) + 2 p1 x y + p2 (s + 2 x^2)
        Y = y (1 + k1 s + k2 s^2 + k3 s^3) + p1 (s + 2 y^2) + 2 p2 x y

    Outside ``invertible_radius`` the polynomial folds back: two ideal points would share one measured point. Both
    methods give NaN there. The photogrammetric equation (Owkes 2012, eq. 5.22) is the same polynomial from measured
    to ideal with its P1 and P2 swapped and in mm; `heliogauge.camera.formats` converts.

    >>> lens = BrownDistortion(k1=-0.2, k2=0.05)
    >>> lens.undistort(lens.distort([[0.4, 0.3]])).round(12)
    array([[0.4, 0.3]])
    """

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    direction: DistortionDirection = DistortionDirection.IDEAL_TO_MEASURED
    invertible_radius: float = field(init=False)

    def __post_init__(self) -> None:
        for name in COEFFICIENT_NAMES:
            value = getattr(self, name)
            if not np.isfinite(value):
                raise InputError(f"{name}: a finite distortion coefficient is needed, not {value}")
            object.__setattr__(self, name, float(value))
        try:
            object.__setattr__(self, "direction", DistortionDirection(self.direction))
        except ValueError as error:
            names = ", ".join(DistortionDirection)
            raise InputError(f"distortion direction: one of {names} is needed, not {self.direction!r}") from error
        object.__setattr__(self, "invertible_radius", brown.invertible_radius(self.polynomial))

    @property
    def polynomial(self) -> BrownCoefficients:
        """The coefficients alone, in the order of `COEFFICIENT_NAMES`."""
        return BrownCoefficients(self.k1, self.k2, self.p1, self.p2, self.k3)

    @property
    def coefficients(self) -> FloatArray:
        """The coefficients in the order of `COEFFICIENT_NAMES`, shape (5,)."""
        return np.array(self.polynomial)

    @property
    def is_zero(self) -> bool:
        """Whether the lens is free of distortion."""
        return not any(self.polynomial)

    @property
    def distorts_in_closed_form(self) -> bool:
        """Whether the polynomial goes from ideal to measured coordinates."""
        return self.direction is DistortionDirection.IDEAL_TO_MEASURED

    def with_coefficients(self, coefficients: npt.ArrayLike) -> "BrownDistortion":
        """Return a distortion of the same direction with other coefficients, shape (5,), `COEFFICIENT_NAMES` order."""
        k1, k2, p1, p2, k3 = np.asarray(coefficients, dtype=np.float64)
        return BrownDistortion(k1=k1, k2=k2, k3=k3, p1=p1, p2=p2, direction=self.direction)

    def distort(self, ideal_xy: npt.ArrayLike) -> FloatArray:
        """Map ideal to measured normalised coordinates.

        Shapes: ideal_xy (..., 2).
        Returns (..., 2): Measured coordinates; NaN where the distortion is not one-to-one.
        InputError: The last axis does not have two elements.
        """
        return _in_blocks(coordinates("ideal_xy", ideal_xy, 2), self.distort_components, self._start_of)

    def undistort(self, measured_xy: npt.ArrayLike) -> FloatArray:
        """Map measured to ideal normalised coordinates.

        Shapes: measured_xy (..., 2).
        Returns (..., 2): Ideal coordinates; NaN where the distortion is not one-to-one.
        InputError: The last axis does not have two elements.
        """
        return _in_blocks(coordinates("measured_xy", measured_xy, 2), self.undistort_components, self._start_of)

    def distort_with_jacobians(self, ideal_xy: npt.ArrayLike) -> MappedCoordinates:
        """Map ideal to measured coordinates, with derivatives.

        Shapes: ideal_xy (..., 2).
        InputError: The last axis does not have two elements.
        """
        ideal = coordinates("ideal_xy", ideal_xy, 2)
        if self.distorts_in_closed_form:
            return MappedCoordinates(self.distort(ideal), *self._forward_jacobians(ideal))
        measured = self.distort(ideal)
        return MappedCoordinates(measured, *self._inverse_jacobians(measured))

    def undistort_with_jacobians(self, measured_xy: npt.ArrayLike) -> MappedCoordinates:
        """Map measured to ideal coordinates, with derivatives.

        Shapes: measured_xy (..., 2).
        InputError: The last axis does not have two elements.
        """
        measured = coordinates("measured_xy", measured_xy, 2)
        if not self.distorts_in_closed_form:
            return MappedCoordinates(self.undistort(measured), *self._forward_jacobians(measured))
        ideal = self.undistort(measured)
        return MappedCoordinates(ideal, *self._inverse_jacobians(ideal))

    def distort_components(
        self, x: FloatArray, y: FloatArray, start: InverseStart | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Map ideal x and y, shape (n,) each, to measured ones at once (the caller makes the blocks)."""
        return self._forward(x, y) if self.distorts_in_closed_form else self._inverse(x, y, start)

    def undistort_components(
        self, x: FloatArray, y: FloatArray, start: InverseStart | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Map measured x and y, shape (n,) each, to ideal ones at once (the caller makes the blocks)."""
        return self._inverse(x, y, start) if self.distorts_in_closed_form else self._forward(x, y)

    def inverse_start(self, largest_radius: float) -> InverseStart:
        """Prepare start values of the inverse for coordinates up to a radius, to share between blocks."""
        finite = largest_radius if 0 < largest_radius < np.inf else 1.0
        return brown.start_polynomial(self.polynomial, self.invertible_radius, finite)

    def _start_of(self, xy: FloatArray) -> InverseStart:
        return self.inverse_start(float(np.fmax.reduce(np.hypot(xy[:, 0], xy[:, 1]), initial=0.0)))

    def _forward(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        if self.is_zero:
            return x, y
        with np.errstate(over="ignore", invalid="ignore"):
            x_out, y_out = brown.evaluate(self.polynomial, x, y)
        if np.isfinite(self.invertible_radius):
            outside = ~(x * x + y * y < self.invertible_radius**2)
            x_out[outside] = y_out[outside] = np.nan
        return x_out, y_out

    def _inverse(self, x: FloatArray, y: FloatArray, start: InverseStart | None) -> tuple[FloatArray, FloatArray]:
        if self.is_zero or x.size == 0:
            return x, y
        if start is None:
            start = self.inverse_start(float(np.fmax.reduce(np.hypot(x, y), initial=0.0)))
        return brown.solve(self.polynomial, self.invertible_radius, x, y, start)

    def _forward_jacobians(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return dP/dx and dP/dc at arguments of the polynomial; NaN outside the invertible disc."""
        x, y = xy[..., 0], xy[..., 1]
        x = np.where(x * x + y * y < self.invertible_radius**2, x, np.nan)
        d_xy = np.empty((*xy.shape, 2))
        d_xy[..., 0, 0], d_xy[..., 0, 1], d_xy[..., 1, 1] = brown.derivatives(self.polynomial, x, y)
        d_xy[..., 1, 0] = d_xy[..., 0, 1]
        return d_xy, brown.coefficient_derivatives(x, y)

    def _inverse_jacobians(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the derivatives of the solution ``xy`` of ``P(xy; c) = target``: ``P_x^-1`` and ``-P_x^-1 P_c``."""
        forward, d_coefficients = self._forward_jacobians(xy)
        inverse = np.empty_like(forward)
        determinant = forward[..., 0, 0] * forward[..., 1, 1] - forward[..., 0, 1] ** 2
        inverse[..., 0, 0] = forward[..., 1, 1] / determinant
        inverse[..., 1, 1] = forward[..., 0, 0] / determinant
        inverse[..., 0, 1] = inverse[..., 1, 0] = -forward[..., 0, 1] / determinant
        return inverse, -inverse @ d_coefficients


def coordinates(name: str, values: npt.ArrayLike, size: int) -> FloatArray:
    """Return values as a float64 array (no copy if it is one) whose last axis must have a given length.

    Shapes: result (..., size).
    name: Name of the argument, used in the message.
    values (..., size): What the caller gave.
    InputError: Not numbers or another last axis.
    """
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: numbers of shape (..., {size}) are needed, not {values!r:.80}") from error
    if array.ndim == 0 or array.shape[-1] != size:
        raise InputError(f"{name}: shape (..., {size}) is needed, not {array.shape}")
    return array


def _in_blocks(
    xy: FloatArray,
    map_components: Callable[[FloatArray, FloatArray, InverseStart], tuple[FloatArray, FloatArray]],
    start_of: Callable[[FloatArray], InverseStart],
) -> FloatArray:
    flat = xy.reshape(-1, 2)
    result = np.empty_like(flat)
    start = start_of(flat)
    for first in range(0, flat.shape[0], BLOCK):
        rows = slice(first, first + BLOCK)
        x, y = np.ascontiguousarray(flat[rows, 0]), np.ascontiguousarray(flat[rows, 1])
        result[rows, 0], result[rows, 1] = map_components(x, y, start)
    return result.reshape(xy.shape)
