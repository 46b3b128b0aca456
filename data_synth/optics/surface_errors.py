"""Analytic deviations of a mirror from its design: height and slope of each are exact, so the truth is integrable."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from math import factorial
from typing import Any, ClassVar, Protocol

import numpy as np

from heliogauge.errors import InputError
from heliogauge.geometry.surfaces import HeightAndSlopes
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, float_array, positive


class ErrorTerm(Protocol):
    """One analytic deviation of the surface: height and both slopes at points of the facet."""

    KIND: ClassVar[str]

    def evaluate(self, x_m: FloatArray, y_m: FloatArray) -> HeightAndSlopes:
        """Return height [m], slope_x and slope_y [rad] at points (x, y) [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Polynomial:
    """Sum of ``coefficient * x**i * y**j``: tilt, defocus, astigmatism, coma.

    terms: Powers i, j and the coefficient [m**(1 - i - j)].
    """

    KIND: ClassVar[str] = "polynomial"
    terms: Sequence[tuple[int, int, float]]

    def __post_init__(self) -> None:
        terms = tuple((int(i), int(j), float(coefficient)) for i, j, coefficient in self.terms)
        if any(i < 0 or j < 0 for i, j, _ in terms):
            raise InputError("polynomial: powers of x and y must not be negative")
        object.__setattr__(self, "terms", terms)

    def evaluate(self, x_m: FloatArray, y_m: FloatArray) -> HeightAndSlopes:
        """Return height [m], slope_x and slope_y [rad] at points (x, y) [m]."""
        height, slope_x, slope_y = np.zeros((3, *np.shape(x_m)))
        for i, j, coefficient in self.terms:
            height += coefficient * x_m**i * y_m**j
            if i:
                slope_x += coefficient * i * x_m ** (i - 1) * y_m**j
            if j:
                slope_y += coefficient * j * x_m**i * y_m ** (j - 1)
        return HeightAndSlopes(height, slope_x, slope_y)


@dataclass(frozen=True, slots=True, eq=False)
class Zernike:
    """One Zernike polynomial on a circle, amplitude 1 at its rim (Born and Wolf); continued smoothly outside.

    n, m: Radial order and azimuthal frequency; negative m is the sine. ``n >= |m|``, ``n - |m|`` even.
    amplitude_m: Height at the rim where the azimuthal factor is 1 [m].
    """

    KIND: ClassVar[str] = "zernike"
    n: int
    m: int
    amplitude_m: float
    radius_m: float

    def __post_init__(self) -> None:
        if self.n < abs(self.m) or (self.n - abs(self.m)) % 2:
            raise InputError(f"zernike n = {self.n}, m = {self.m}: n >= |m| and n - |m| even are needed")
        positive("zernike radius_m", self.radius_m, "metres")

    def evaluate(self, x_m: FloatArray, y_m: FloatArray) -> HeightAndSlopes:
        """Return height [m], slope_x and slope_y [rad] at points (x, y) [m].

        ``R(rho) cos(m phi) = Re[(x + i y)^m] Q(x^2 + y^2)`` with a polynomial Q, so there is no singular point.
        """
        order, half = abs(self.m), (self.n - abs(self.m)) // 2
        x, y = np.asarray(x_m) / self.radius_m, np.asarray(y_m) / self.radius_m
        square = x * x + y * y
        # Coefficients of R in rho^(n - 2 k) (Born and Wolf, 9.2.1 eq. 5), lowest power of rho^2 first.
        radial = [
            (-1) ** k * factorial(self.n - k) / (factorial(k) * factorial(half + order - k) * factorial(half - k))
            for k in range(half, -1, -1)
        ]
        polynomial = np.polynomial.Polynomial(radial)
        q, dq = polynomial(square), polynomial.deriv()(square)
        z = x + 1j * y
        power, lower = z**order, order * z ** max(order - 1, 0)
        # d/dx z^m = m z^(m-1); d/dy z^m = i m z^(m-1).
        angular, angular_x, angular_y = (
            (power.real, lower.real, -lower.imag) if self.m >= 0 else (power.imag, lower.imag, lower.real)
        )
        scale = self.amplitude_m / self.radius_m
        return HeightAndSlopes(
            self.amplitude_m * angular * q,
            scale * (angular_x * q + angular * dq * 2 * x),
            scale * (angular_y * q + angular * dq * 2 * y),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Ripple:
    """A plane wave of the surface, as from rolling or a rib pattern.

    slope_amplitude_rad: Largest slope of the wave [rad].
    period_m: Wavelength [m].
    direction_rad: Direction in which the surface varies, from x towards y [rad].
    phase_rad: Phase of the slope's cosine at the origin [rad].
    """

    KIND: ClassVar[str] = "ripple"
    slope_amplitude_rad: float
    period_m: float
    direction_rad: float = 0.0
    phase_rad: float = 0.0

    def __post_init__(self) -> None:
        positive("ripple period_m", self.period_m, "metres")

    def evaluate(self, x_m: FloatArray, y_m: FloatArray) -> HeightAndSlopes:
        """Return height [m], slope_x and slope_y [rad] at points (x, y) [m]."""
        wave_number = 2 * np.pi / self.period_m
        along_x, along_y = np.cos(self.direction_rad), np.sin(self.direction_rad)
        phase = wave_number * (along_x * np.asarray(x_m) + along_y * np.asarray(y_m)) + self.phase_rad
        slope = self.slope_amplitude_rad * np.cos(phase)
        height = self.slope_amplitude_rad / wave_number * np.sin(phase)
        return HeightAndSlopes(height, along_x * slope, along_y * slope)


@dataclass(frozen=True, slots=True, eq=False)
class Dimple:
    """A Gaussian bump (positive) or dent (negative), as over a mounting pad.

    height_m: Height at the centre [m].
    sigma_m: Width of the Gaussian [m].
    """

    KIND: ClassVar[str] = "dimple"
    height_m: float
    sigma_m: float
    center_x_m: float = 0.0
    center_y_m: float = 0.0

    def __post_init__(self) -> None:
        positive("dimple sigma_m", self.sigma_m, "metres")

    def evaluate(self, x_m: FloatArray, y_m: FloatArray) -> HeightAndSlopes:
        """Return height [m], slope_x and slope_y [rad] at points (x, y) [m]."""
        dx, dy = np.asarray(x_m) - self.center_x_m, np.asarray(y_m) - self.center_y_m
        height = self.height_m * np.exp(-0.5 * (dx * dx + dy * dy) / self.sigma_m**2)
        return HeightAndSlopes(height, -height * dx / self.sigma_m**2, -height * dy / self.sigma_m**2)


@dataclass(frozen=True, slots=True, eq=False)
class EdgeTurnDown:
    """The rim of a rectangular facet bends back (negative slope amplitude: forward), decaying exponentially inwards.

    slope_rad: Outward slope at the middle of each edge; positive bends the rim back [rad].
    length_m: Distance over which the slope decays by e [m].
    half_width_m, half_height_m: Half the size of the facet [m].
    """

    KIND: ClassVar[str] = "edge_turn_down"
    slope_rad: float
    length_m: float
    half_width_m: float
    half_height_m: float

    def __post_init__(self) -> None:
        for name in ("length_m", "half_width_m", "half_height_m"):
            positive(f"edge_turn_down {name}", getattr(self, name), "metres")

    def evaluate(self, x_m: FloatArray, y_m: FloatArray) -> HeightAndSlopes:
        """Return height [m], slope_x and slope_y [rad] at points (x, y) [m]."""
        height_x, slope_x = self._profile(np.asarray(x_m), self.half_width_m)
        height_y, slope_y = self._profile(np.asarray(y_m), self.half_height_m)
        return HeightAndSlopes(height_x + height_y, slope_x, slope_y)

    def _profile(self, position: FloatArray, half: float) -> tuple[FloatArray, FloatArray]:
        right = np.exp((position - half) / self.length_m)
        left = np.exp((-position - half) / self.length_m)
        return -self.slope_rad * self.length_m * (right + left), -self.slope_rad * (right - left)


@dataclass(frozen=True, slots=True, eq=False)
class Kink:
    """A bend about a straight line: on both sides of it the surface is tilted, the rim forward where positive.

    slope_rad: Slope far from the line, away from it [rad].
    width_m: Distance over which the slope changes sign, as of a hyperbolic tangent [m].
    direction_rad: Direction across the line, from x towards y [rad].
    offset_m: Distance of the line from the origin, along that direction [m].
    """

    KIND: ClassVar[str] = "kink"
    slope_rad: float
    width_m: float
    direction_rad: float = 0.0
    offset_m: float = 0.0

    def __post_init__(self) -> None:
        positive("kink width_m", self.width_m, "metres")

    def evaluate(self, x_m: FloatArray, y_m: FloatArray) -> HeightAndSlopes:
        """Return height [m], slope_x and slope_y [rad] at points (x, y) [m]."""
        along_x, along_y = np.cos(self.direction_rad), np.sin(self.direction_rad)
        place = (along_x * np.asarray(x_m) + along_y * np.asarray(y_m) - self.offset_m) / self.width_m
        # log(2 cosh p) without overflow.
        height = self.slope_rad * self.width_m * np.logaddexp(place, -place)
        slope = self.slope_rad * np.tanh(place)
        return HeightAndSlopes(height, along_x * slope, along_y * slope)


@dataclass(frozen=True, slots=True, eq=False)
class HeightGrid:
    """Heights on a grid, as from a file, joined by a bicubic spline whose own gradient is the slope.

    x_m (n,): Ascending grid positions [m].
    y_m (m,): Ascending grid positions [m].
    height_m (m, n): Heights at the grid points [m].
    """

    KIND: ClassVar[str] = "height_grid"
    x_m: FloatArray
    y_m: FloatArray
    height_m: FloatArray
    _spline: Any = field(init=False, repr=False)

    def __post_init__(self) -> None:
        from scipy.interpolate import RectBivariateSpline

        for name in ("x_m", "y_m"):
            object.__setattr__(self, name, float_array(f"height_grid {name}", getattr(self, name), (None,)))
            if getattr(self, name).size < 4 or np.any(np.diff(getattr(self, name)) <= 0):
                raise InputError(f"height_grid {name}: at least 4 ascending positions are needed")
        shape = (self.y_m.size, self.x_m.size)
        object.__setattr__(self, "height_m", float_array("height_grid height_m", self.height_m, shape))
        object.__setattr__(self, "_spline", RectBivariateSpline(self.y_m, self.x_m, self.height_m))

    def evaluate(self, x_m: FloatArray, y_m: FloatArray) -> HeightAndSlopes:
        """Return height [m], slope_x and slope_y [rad] at points (x, y) [m]."""
        height, slope_x, slope_y = (self._spline.ev(y_m, x_m, dx=dy, dy=dx) for dx, dy in ((0, 0), (1, 0), (0, 1)))
        return HeightAndSlopes(height, slope_x, slope_y)


_KINDS: dict[str, type[Any]] = {
    term.KIND: term for term in (Polynomial, Zernike, Ripple, Dimple, EdgeTurnDown, Kink, HeightGrid)
}


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceErrors(ShortRepr):
    """Sum of analytic deviations of one facet.

    terms: What is added to the design; nothing: a perfect facet.

    >>> errors = SurfaceErrors((Polynomial([(1, 0, 1e-3)]),))
    >>> [float(value) for value in errors.evaluate(np.array(0.5), np.array(0.0))]
    [0.0005, 0.001, 0.0]
    """

    terms: tuple[ErrorTerm, ...] = ()

    def evaluate(self, x_m: FloatArray, y_m: FloatArray) -> HeightAndSlopes:
        """Return the deviation from the design.

        x_m, y_m (...): Points in the facet frame [m].
        Returns (...): Height [m], slope_x, slope_y [rad].
        """
        height, slope_x, slope_y = np.zeros((3, *np.shape(x_m)))
        for term in self.terms:
            term_height, term_x, term_y = term.evaluate(x_m, y_m)
            height += term_height
            slope_x += term_x
            slope_y += term_y
        return HeightAndSlopes(height, slope_x, slope_y)

    def to_json(self) -> list[dict[str, Any]]:
        """Return the terms as plain values for truth.json."""
        return [{"kind": term.KIND, **_plain(term)} for term in self.terms]

    @classmethod
    def from_json(cls, values: Sequence[Mapping[str, Any]]) -> "SurfaceErrors":
        """Rebuild the terms that `to_json` wrote.

        values: One entry per term with its kind and parameters.
        InputError: A kind that does not exist, or a missing parameter.
        """
        terms: list[ErrorTerm] = []
        for value in values:
            parameters = dict(value)
            kind = str(parameters.pop("kind", "?"))
            if kind not in _KINDS:
                raise InputError(f"surface error kind {kind!r}: one of {', '.join(_KINDS)} is needed")
            try:
                terms.append(_KINDS[kind](**parameters))
            except TypeError as error:
                raise InputError(f"surface error {kind!r}: {error}") from error
        return cls(tuple(terms))


def _plain(term: Any) -> dict[str, Any]:
    values = {one.name: getattr(term, one.name) for one in fields(term) if one.init}
    return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in values.items()}
