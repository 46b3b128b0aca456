"""Brown's distortion polynomial, the region where it is one-to-one, and its inverse to round-off."""

import math
from typing import NamedTuple

import numpy as np

from heliogauge.validate import BoolArray, FloatArray

#: Points handled at once: some twenty temporaries of 64 KiB stay in a 1 MiB level-2 cache.
BLOCK = 8192
#: Newton stops when the last step is below this share of the image radius. What is left is its square over the smallest
#: derivative: a tenth of round-off, which the same derivative amplifies.
_STEP_LIMIT = 5e-9
_FAST_ITERATIONS = 6
_SAFE_ITERATIONS = 100
_START_DEGREE = 7
_LARGEST_RADIUS = 1e6


class BrownCoefficients(NamedTuple):
    """Coefficients in OpenCV's order and meaning (p1 goes with y, p2 with x), for normalised coordinates."""

    k1: float
    k2: float
    p1: float
    p2: float
    k3: float


class Gradient(NamedTuple):
    """Derivatives of the polynomial, each of shape (...); dP_y/dx equals dP_x/dy."""

    dx_dx: FloatArray
    dx_dy: FloatArray
    dy_dy: FloatArray


class InverseStart(NamedTuple):
    """Polynomial that starts the inversion near its answer.

    coefficients (degree + 1,): Ascending powers of ``|P|^2 / scale``.
    scale: What makes the argument 1 at the largest radius.
    """

    coefficients: FloatArray
    scale: float


def evaluate(c: BrownCoefficients, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Evaluate the polynomial.

    x, y (...): Normalised coordinates.
    Returns: The polynomial's two components, shape (...).

    ``P(x) = x (1 + k1 s + k2 s^2 + k3 s^3) + s q + 2 x (q . x)`` with ``s = x . x`` and ``q = (p2, p1)``: the usual
    two lines of Brown's model in vector form.
    """
    s = x * x
    s += y * y
    factor = s * c.k3
    factor += c.k2
    factor *= s
    factor += c.k1
    factor *= s
    factor += 1.0
    if c.p1 == 0.0 and c.p2 == 0.0:
        return x * factor, y * factor
    factor += (2 * c.p2) * x
    factor += (2 * c.p1) * y
    return x * factor + c.p2 * s, y * factor + c.p1 * s


def derivatives(c: BrownCoefficients, x: FloatArray, y: FloatArray) -> Gradient:
    """Return dP_x/dx, dP_x/dy (= dP_y/dx, the map is a gradient) and dP_y/dy, each of shape (...)."""
    xx, yy, xy = x * x, y * y, x * y
    s = xx + yy
    diagonal = 1 + s * (c.k1 + s * (c.k2 + s * c.k3)) + (2 * c.p2) * x + (2 * c.p1) * y
    slope = 2 * c.k1 + s * (4 * c.k2 + (6 * c.k3) * s)
    return Gradient(
        diagonal + slope * xx + (4 * c.p2) * x,
        slope * xy + (2 * c.p2) * y + (2 * c.p1) * x,
        diagonal + slope * yy + (4 * c.p1) * y,
    )


def coefficient_derivatives(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the derivative of P with respect to (k1, k2, p1, p2, k3), shape (..., 2, 5)."""
    s = x * x + y * y
    jacobian = np.empty((*np.shape(x), 2, 5))
    for row, value in enumerate((x, y)):
        for column, power in ((0, s), (1, s * s), (4, s * s * s)):
            jacobian[..., row, column] = value * power
    jacobian[..., 0, 2] = jacobian[..., 1, 3] = 2 * x * y
    jacobian[..., 0, 3], jacobian[..., 1, 2] = s + 2 * x * x, s + 2 * y * y
    return jacobian


def invertible_radius(c: BrownCoefficients) -> float:
    """Return the radius of the largest disc on which the polynomial is one-to-one with a positive derivative.

    Returns: Radius in normalised coordinates of the polynomial's argument; infinite when it never folds below 1e6
        (0.0001 degrees from a right angle to the axis).

    P is the gradient of a scalar, so its derivative is symmetric; where that is positive definite on a convex region,
    P is one-to-one there. In polar directions the derivative is ``[[a + 3 u cos, u sin], [u sin, b + u cos]]`` with
    ``b = 1 + k1 s + k2 s^2 + k3 s^3``, ``a = b + 2 s db/ds``, ``u = 2 r sqrt(p1^2 + p2^2)``. Its smallest eigenvalue
    over all directions is the minimum over ``w`` in [1, 3] of ``b + (a - b) (w^2 - 1)/8 - u w``, met at
    ``w = 4 u / (a - b)`` or at an end; each of the three cases vanishes at the roots of a polynomial in r.
    """
    tangential = 2 * math.hypot(c.p1, c.p2)
    # Powers of r, ascending.
    b = np.array([1, 0, c.k1, 0, c.k2, 0, c.k3])
    a_minus_b = np.array([0, 0, 2 * c.k1, 0, 4 * c.k2, 0, 6 * c.k3])
    u = np.array([0, tangential, 0, 0, 0, 0, 0])
    cases = [b + a_minus_b - 3 * u, b - u]
    if tangential:
        cases.append(np.convolve(b - a_minus_b / 8, a_minus_b) - 2 * np.convolve(u, u))
    for radius in sorted(root for case in cases for root in _positive_roots(case)):
        powers = radius ** np.arange(7)
        at_b, difference, at_u = powers @ b, powers @ a_minus_b, powers @ u
        w = min(max(4 * at_u / difference, 1.0), 3.0) if difference > 0 else 3.0
        smallest = at_b + difference * (w * w - 1) / 8 - at_u * w
        if smallest <= 1e-9 * np.abs(powers) @ np.abs(b):
            return radius
    return math.inf


def _positive_roots(ascending: FloatArray) -> list[float]:
    # Solved for 1/r: the companion matrix then has 1 as its leading coefficient and is most accurate for small r.
    # Solved for r, a k3 of 1e-53 spoils every root.
    # Terms 1e-100 times smaller than the largest matter only for r < 1e-8, where nothing folds, and would overflow.
    used = np.where(np.abs(ascending) > 1e-100 * np.abs(ascending).max(), ascending, 0.0)
    reciprocals = np.roots(np.trim_zeros(used, "f"))
    # A double root comes out as a pair some 1e-8 off the real axis.
    straight = np.abs(reciprocals.imag) <= 1e-7 * np.abs(reciprocals)
    real = 1 / reciprocals.real[straight & (reciprocals.real > 1 / _LARGEST_RADIUS)]
    return [float(root) for root in real]


def largest_image_radius(c: BrownCoefficients, radius: float) -> float:
    """Return an upper bound of ``|P(x)|`` on the disc ``|x| <= radius`` where P is one-to-one."""
    return radial(c, radius) + 3 * math.hypot(c.p1, c.p2) * radius * radius


def radial(c: BrownCoefficients, radius: float) -> float:
    """Return the radial part of the polynomial at a radius."""
    s = radius * radius
    return radius * (1 + s * (c.k1 + s * (c.k2 + s * c.k3)))


def start_polynomial(c: BrownCoefficients, limit: float, image_radius: float) -> InverseStart:
    """Fit the factor ``|x| / |P|`` of the radial part as a polynomial in ``|P|^2``, to start Newton near the answer.

    limit: Radius of the disc where P is one-to-one.
    image_radius: Largest ``|P|`` wanted.
    """
    high = min(limit, image_radius)
    while high < limit and radial(c, high) < image_radius and high < 1e9:
        high = min(2 * high, limit)
    low = 0.0
    # Bisection: 40 halvings leave 1e-12 of the radius, far more than a start value needs.
    for _ in range(40 if radial(c, high) > image_radius else 0):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if radial(c, middle) > image_radius else (middle, high)
    angle = np.linspace(0, np.pi / 2, 3 * _START_DEGREE)
    r = high * np.sin(angle[1:])
    s = r * r
    factor = 1 + s * (c.k1 + s * (c.k2 + s * c.k3))
    image = s * factor * factor
    scale = float(image.max())
    powers = np.vander(image / scale, _START_DEGREE + 1, increasing=True)
    coefficients: FloatArray = np.linalg.lstsq(powers, 1 / factor, rcond=None)[0].astype(np.float64)
    return InverseStart(coefficients, scale)


# Points far outside the disc may run off to infinity on their way to NaN: that is no news.
@np.errstate(divide="ignore", over="ignore", invalid="ignore")
def solve(
    c: BrownCoefficients, limit: float, x: FloatArray, y: FloatArray, start: InverseStart
) -> tuple[FloatArray, FloatArray]:
    """Solve ``P(solution) = (x, y)`` by Newton to round-off.

    limit: Radius of the disc where P is one-to-one.
    x, y (n,): Right-hand sides.
    Returns: The solution inside the disc, shape (n,) each; NaN where there is none.
    """
    coefficients, scale = start
    s = x * x
    s += y * y
    s *= 1 / scale
    np.minimum(s, 1.0, out=s)
    factor = np.full_like(s, coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        factor *= s
        factor += coefficient
    x_now, y_now = x * factor, y * factor
    step_limit = (_STEP_LIMIT**2) * scale
    for _ in range(_FAST_ITERATIONS):
        step_x, step_y = _newton_step(c, x_now, y_now, x, y)
        x_now -= step_x
        y_now -= step_y
        step_x *= step_x
        step_y *= step_y
        step_x += step_y
        # fmax passes over NaN: one bad point does not hold up the block.
        if np.fmax.reduce(step_x) <= step_limit:
            break
    inside = np.fmax.reduce(x_now * x_now + y_now * y_now) < limit * limit
    settled = step_x <= step_limit
    if not (inside and settled.all()):
        settled &= x_now * x_now + y_now * y_now < limit * limit
        hard = np.flatnonzero(~settled)
        x_now[hard], y_now[hard] = _solve_safely(c, limit, x[hard], y[hard])
    return x_now, y_now


def _newton_step(
    c: BrownCoefficients, x: FloatArray, y: FloatArray, target_x: FloatArray, target_y: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the Newton step (to be subtracted) of ``P(x, y) = target``."""
    s = x * x
    s += y * y
    diagonal = s * c.k3
    slope = diagonal * 6
    diagonal += c.k2
    slope += 4 * c.k2
    diagonal *= s
    slope *= s
    diagonal += c.k1
    slope += 2 * c.k1
    diagonal *= s
    diagonal += 1.0
    slope_x = slope * x
    slope *= y
    if c.p1 == 0.0 and c.p2 == 0.0:
        residual_x, residual_y = x * diagonal, y * diagonal
        j_xy = slope * x
        slope_x *= x
        slope *= y
    else:
        diagonal += (2 * c.p2) * x
        diagonal += (2 * c.p1) * y
        residual_x, residual_y = x * diagonal, y * diagonal
        residual_x += c.p2 * s
        residual_y += c.p1 * s
        # dP = diagonal I + slope x x^T + 2 (q x^T + x q^T)
        slope_x += 2 * c.p2
        j_xy = slope_x * y
        j_xy += (2 * c.p1) * x
        slope_x += 2 * c.p2
        slope_x *= x
        slope += 4 * c.p1
        slope *= y
    residual_x -= target_x
    residual_y -= target_y
    j_xx, j_yy = slope_x, slope
    j_xx += diagonal
    j_yy += diagonal
    determinant = j_xx * j_yy
    determinant -= j_xy * j_xy
    np.divide(1.0, determinant, out=determinant)
    step_x = j_yy * residual_x
    step_x -= j_xy * residual_y
    step_x *= determinant
    j_xx *= residual_y
    j_xy *= residual_x
    j_xx -= j_xy
    j_xx *= determinant
    return step_x, j_xx


def _solve_safely(c: BrownCoefficients, limit: float, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solve the points that plain Newton left: near the fold, or outside the image of the disc (NaN)."""
    found_x, found_y = np.full_like(x, np.nan), np.full_like(y, np.nan)
    possible = np.isfinite(x) & np.isfinite(y)
    if math.isfinite(limit):
        possible &= np.hypot(x, y) < largest_image_radius(c, limit)
    index = np.flatnonzero(possible)
    target_x, target_y = x[index], y[index]
    shrink = np.minimum(1.0, 0.5 * limit / np.maximum(np.hypot(target_x, target_y), 1e-300))
    x_now, y_now = target_x * shrink, target_y * shrink
    done: BoolArray = np.zeros(index.size, dtype=np.bool_)
    for _ in range(_SAFE_ITERATIONS):
        step_x, step_y = _newton_step(c, x_now, y_now, target_x, target_y)
        # Stay where the derivative is positive definite: go at most half way to the edge of the disc.
        room = 0.5 * (limit - np.hypot(x_now, y_now)) if math.isfinite(limit) else np.hypot(x_now, y_now) + 1.0
        size = np.hypot(step_x, step_y)
        share = np.minimum(1.0, room / np.maximum(size, 1e-300))
        x_now = x_now - share * step_x
        y_now = y_now - share * step_y
        done = (share == 1.0) & (size <= 4e-16 * np.hypot(x_now, y_now) + 1e-300)
        if done.all():
            break
    residual_x, residual_y = evaluate(c, x_now, y_now)
    error = np.hypot(residual_x - target_x, residual_y - target_y)
    # Close to the fold the steps stay above round-off; then the residual decides, with room for the cancellation
    # between the terms of a polynomial that folds.
    done |= error <= 4e-15 * np.maximum(np.hypot(target_x, target_y), np.hypot(x_now, y_now))
    done &= np.hypot(x_now, y_now) < limit
    found_x[index[done]], found_y[index[done]] = x_now[done], y_now[done]
    return found_x, found_y
