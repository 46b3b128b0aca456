"""Phase of fringes with its uncertainty: least squares over any steps, and the pixel noise pooled over an image."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from deflectometry.setup.patterns import design_matrix, determines_phase
from deflectometry.sources.noise_model import NoiseModel
from heliogauge.errors import EstimationError
from heliogauge.validate import BoolArray, FloatArray, float_array, freeze

TURN_RAD = 2 * np.pi

#: Variance of rounding to whole digital numbers [DN^2]; no integer frame can have less noise.
QUANTISATION_VARIANCE_DN2 = 1.0 / 12.0

#: Where the response is three times steeper than usual it bends within the noise, and first order overstates it.
_STEEP = 9.0


class LightResponse(Protocol):
    """What turns camera readings into quantities linear in the display's level."""

    def linearise(self, camera_dn: FloatArray) -> FloatArray:
        """Return the linear quantity for camera readings [DN]."""

    def slope(self, camera_dn: FloatArray) -> FloatArray:
        """Return its derivative with respect to the camera reading."""


@dataclass(frozen=True, slots=True, eq=False)
class StepSolver:
    """Least-squares solution for one set of steps, as matrices that act on the readings.

    steps_rad (n,): Phase steps [rad].
    estimate (3, n): Readings to (a, b cos(phi), b sin(phi)).
    residual (n - 3, n): Readings to the n - 3 orthonormal combinations that any sinusoid leaves zero.
    variance (4, n): Variances of the readings to the variances of b cos(phi) and b sin(phi), their covariance, and
        the mean variance of the residuals (the last row is zero for n = 3).
    balanced: Whether the phase's variance needs only the mean reading: equal steps, n >= 4.
    """

    steps_rad: FloatArray
    estimate: FloatArray
    residual: FloatArray
    variance: FloatArray
    balanced: bool

    @property
    def redundancy(self) -> int:
        """Readings beyond the three unknowns."""
        return len(self.residual)


def solve_steps(steps_rad: npt.ArrayLike) -> StepSolver:
    """Prepare the least-squares solution for one set of steps.

    Shapes: steps_rad (n,).
    Returns: Matrices to apply to readings.
    EstimationError: The steps do not determine the phase.
    """
    steps = float_array("steps_rad", steps_rad, (None,))
    if not determines_phase(steps):
        raise EstimationError(
            f"phase: the steps {np.degrees(steps).round(4).tolist()} deg do not determine offset, modulation and "
            "phase; at least three steps that differ modulo 360 deg are needed"
        )
    matrix = design_matrix(steps)
    n = len(steps)
    basis = np.linalg.svd(matrix, full_matrices=True)[0]
    estimate, residual = np.linalg.pinv(matrix), basis[:, 3:].T
    spread = (residual**2).sum(axis=0) / max(n - 3, 1)
    variance = np.stack([estimate[1] ** 2, estimate[2] ** 2, estimate[1] * estimate[2], spread])
    # With n >= 4 equal steps the photon share's harmonics 1 and 3 of the phase cancel: the mean reading is enough.
    angle = np.linspace(0, TURN_RAD, 24, endpoint=False)[:, None]
    weights = (np.cos(angle) * estimate[2] - np.sin(angle) * estimate[1]) ** 2
    uneven = max(np.abs(weights.sum(axis=1) - 2 / n).max(), np.abs((weights * np.cos(angle - steps)).sum(axis=1)).max())
    return StepSolver(steps, freeze(estimate), freeze(residual), freeze(variance), bool(n > 3 and uneven < 1e-9))


def wrap_phase(phase_rad: FloatArray) -> FloatArray:
    """Wrap angles into (-pi, pi].

    Shapes: phase_rad (...).
    Returns (...): The same angles within (-pi, pi] [rad].

    >>> wrap_phase(np.array([3 * np.pi, -np.pi]))
    array([3.14159265, 3.14159265])
    """
    return np.asarray(phase_rad - TURN_RAD * np.ceil((phase_rad - np.pi) / TURN_RAD), dtype=np.float64)


def linear_light(readings: FloatArray, response: LightResponse | None) -> tuple[FloatArray, FloatArray]:
    """Return linear light and the squared slope by which a variance of readings becomes one of it."""
    if response is None:
        return readings, np.ones_like(readings)
    return response.linearise(readings), response.slope(readings) ** 2


def estimate_noise(
    readings: FloatArray,
    solvers: Sequence[StepSolver],
    *,
    response: LightResponse | None = None,
    floor_dn2: float = 1e-12,
) -> NoiseModel:
    """Estimate read and photon noise from what sinusoids leave over, pooled over pixels and sets.

    readings (n_frames, n_pixels): Readings of all sets after one another [DN].
    solvers: One for each set, in the order of the frames.
    response: Makes readings linear.
    floor_dn2: Smallest variance; `QUANTISATION_VARIANCE_DN2` for integer frames [DN^2].
    Returns: Of camera readings, whether or not there is a response.
    EstimationError: No set has more than three frames, or no pixel is finite.

    Each residual r of weights q has the expected square ``sum_k q_k**2 slope_k**2 (read**2 + gain I_k)``, linear in
    both unknowns: weighted regression of the squares, readings beyond 4 sigma left out (they hold 0.1 % of a normal
    variance). Pixels that show fringes decide where there are enough: dark pixels clip at zero and would look quiet.
    What harmonics of the display leave (`residual_distortion`) is taken out first: it is no noise.
    """
    squares = _squared_residuals(readings, solvers, response)
    if squares.value.size == 0:
        raise EstimationError(
            "pixel noise: sets of three frames leave no residual to estimate it from; give pixel_noise_dn, "
            "or take four or more steps"
        )
    ratio = squares.value / np.maximum(squares.constant, 1e-300)
    # 0.4549 is the median of a chi-square with one degree of freedom; whole numbers can put the median at zero.
    start = max(float(np.median(ratio)) / 0.4549 or float(np.mean(ratio)), floor_dn2)
    # b above 7.4 sigma of one reading: what a pixel without fringes reaches with 4 frames once in 1e12.
    bright = squares.power > 55.0 * start * squares.constant
    for better in (bright & (squares.steepness < _STEEP), bright):
        if np.count_nonzero(better) >= 200:
            squares = squares.chosen(better)
            break
    read, gain = start, 0.0
    for _ in range(6):
        expected = read * squares.constant + gain * squares.linear
        kept = (squares.value < 16.0 * expected) & (expected > 0)
        if not kept.any():
            break
        read, gain = _regress(squares.chosen(kept), expected[kept], floor_dn2)
    return NoiseModel(math.sqrt(read), gain)


class _Squares(NamedTuple):
    """Squared residuals of all sets and pixels, with what goes with each.

    value (k,): Squared residuals.
    constant, linear (k,): Their expected values for 1 DN^2 of read noise and for a gain of 1 DN.
    power (k,): Squared modulation of the pixel.
    steepness (k,): Largest squared slope of the response among the readings, over the median.
    """

    value: FloatArray
    constant: FloatArray
    linear: FloatArray
    power: FloatArray
    steepness: FloatArray

    def chosen(self, where: BoolArray) -> "_Squares":
        """Return some of them."""
        return _Squares(*(part[where] for part in self))


def _squared_residuals(readings: FloatArray, solvers: Sequence[StepSolver], response: LightResponse | None) -> _Squares:
    """Return what sinusoids leave over in the pixels whose readings are all finite."""
    found: list[_Squares] = []
    finite = np.isfinite(readings).all(axis=0)
    start = 0
    for solver in solvers:
        stop = start + len(solver.steps_rad)
        chosen = readings[start:stop, finite]
        start = stop
        if solver.redundancy == 0 or chosen.size == 0:
            continue
        light, slope_squared = linear_light(chosen, response)
        weights = solver.residual**2
        _, cosine, sine = solver.estimate @ light
        constant = weights @ slope_squared
        usual = 1.0 if response is None else float(np.median(slope_squared)) or 1.0
        steepness = slope_squared.max(axis=0) / usual
        # Next to black a response can be steep and bent: such pixels must not shape the harmonics of all others.
        gentle = (
            (steepness < _STEEP)
            if np.count_nonzero(steepness < _STEEP) >= 50
            else np.ones(steepness.shape, dtype=np.bool_)
        )
        distortion = residual_distortion(light, solver, gentle / np.maximum(constant.mean(axis=0), 1e-300))
        squares = (solver.residual @ light - distortion @ _harmonics(cosine, sine)) ** 2
        linear = weights @ (slope_squared * np.maximum(chosen, 0.0))
        power, steepness = (np.broadcast_to(part, squares.shape) for part in (cosine**2 + sine**2, steepness))
        found.append(_Squares(*(part.ravel() for part in (squares, constant, linear, power, steepness))))
    if not found:
        return _Squares(*np.zeros((5, 0)))
    return _Squares(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def residual_distortion(light: FloatArray, solver: StepSolver, weights: FloatArray | None = None) -> FloatArray:
    """Fit what the second and third harmonic of the fringes leave in the residuals of one set, pooled over pixels.

    light (n, n_pixels): Linear readings of the set [DN, or the response's unit].
    solver: Solution for the set's steps.
    weights (n_pixels,): Inverse variance of the pixels' residuals, up to a factor; all the same without it.
    Returns (n - 3, 4): Residual for each DN of modulation, on the cosine and sine of twice and three times the
        phase.

    Four equal steps show the second harmonic only (the third falls on the fundamental), five or more show both;
    combinations that the steps cannot show come out as zero.
    """
    _, cosine, sine = solver.estimate @ light
    basis = _harmonics(cosine, sine)
    weighted = basis if weights is None else basis * weights
    scale = np.maximum(np.sqrt((basis * weighted).sum(axis=1)), 1e-100)
    normal = (basis / scale[:, None]) @ (weighted / scale[:, None]).T
    right = (weighted / scale[:, None]) @ (solver.residual @ light).T
    return np.asarray((np.linalg.lstsq(normal, right, rcond=1e-9)[0] / scale[:, None]).T)


def _harmonics(cosine: FloatArray, sine: FloatArray) -> FloatArray:
    """Return modulation times cos 2 phi, sin 2 phi, cos 3 phi, sin 3 phi, shape (4, n_pixels)."""
    cosine_squared, sine_squared = cosine * cosine, sine * sine
    power = np.maximum(cosine_squared + sine_squared, np.finfo(np.float64).tiny)
    modulation = np.sqrt(power)
    return np.stack(
        [
            (cosine_squared - sine_squared) / modulation,
            2 * cosine * sine / modulation,
            cosine * (cosine_squared - 3 * sine_squared) / power,
            sine * (3 * cosine_squared - sine_squared) / power,
        ]
    )


def _regress(squares: _Squares, expected: FloatArray, floor: float) -> tuple[float, float]:
    """Fit squares = read * constant + gain * linear, read at least the floor; sigma of a square is its expectation."""
    columns = np.stack([squares.constant, squares.linear], axis=1) / expected[:, None]
    wanted = squares.value / expected
    normal, right = columns.T @ columns, columns.T @ wanted
    scale = np.maximum(np.sqrt(np.diag(normal)), 1e-100)
    covariance = np.linalg.pinv(normal / np.outer(scale, scale), rcond=1e-10)
    read, gain = (covariance @ (right / scale)) / scale
    # A square scatters by sqrt(2) of its mean. Where the signal varies too little to separate the photon share
    # (4 sigma), all of the noise counts as read noise; the variance at that signal is the same.
    if gain < 4 * np.sqrt(2.0 * covariance[1, 1]) / scale[1]:
        return max(float(right[0] / scale[0] ** 2), floor), 0.0
    if read < floor:
        return floor, max(0.0, float((right[1] - floor * normal[0, 1]) / scale[1] ** 2))
    return float(read), float(gain)
