"""Phase and position of single pixels, one set and one axis at a time: what `measure_screen_map` is compared with."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from deflectometry.fringes.fringe_orders import combine_orders, search_orders
from deflectometry.fringes.phase import (
    QUANTISATION_VARIANCE_DN2,
    TURN_RAD,
    LightResponse,
    estimate_noise,
    linear_light,
    solve_steps,
    wrap_phase,
)
from deflectometry.sources.noise_model import NoiseModel
from heliogauge.errors import InputError
from heliogauge.validate import FloatArray, freeze


@dataclass(frozen=True, slots=True, eq=False)
class PhaseFit:
    """Sinusoid fitted to each pixel of one set of frames.

    phase_rad (...): Phase in (-pi, pi] [rad].
    sigma_rad (...): Its standard deviation [rad]; infinite without modulation.
    modulation_dn (...): Amplitude b of the sinusoid [DN, or the response's unit].
    offset_dn (...): Mean a [DN, or the response's unit].
    residual_dn (...): Root of the sum of squared residuals per degree of freedom; NaN for three frames [DN, or the
        response's unit].
    """

    phase_rad: FloatArray
    sigma_rad: FloatArray
    modulation_dn: FloatArray
    offset_dn: FloatArray
    residual_dn: FloatArray


def fit_phase(
    frames: npt.ArrayLike,
    steps_rad: npt.ArrayLike,
    *,
    noise: NoiseModel | None = None,
    response: LightResponse | None = None,
) -> PhaseFit:
    """Fit ``I_k = a + b cos(phi - step_k)`` to each pixel by least squares.

    frames (n, ...): Readings in the order of the steps [DN].
    steps_rad (n,): Phase steps, any values that determine the phase [rad].
    noise: Noise of the readings; estimated from the residuals of all pixels without it.
    response: Makes readings linear first; the noise is carried through its slope.
    Returns: Float64 arrays of the pixels' shape; NaN where a reading is not finite.
    InputError: Number of frames and of steps differ.
    EstimationError: The steps do not determine the phase, or three frames without a noise model.

    Unweighted least squares. With the rows c, s of the solution that give b cos(phi) and b sin(phi), ``sigma_phi**2 =
    sum_k (cos(phi) s_k - sin(phi) c_k)**2 var(I_k) / b**2``; n equal steps and constant noise give the Cramer-Rao
    bound ``sigma_phi = sqrt(2 / n) sigma / b``. First order: it holds for sigma_phi below about 0.3 rad. Model: spec
    003 C-31 (Ulmer et al. 2011 for four steps), with steps of any value instead of 2 pi / n.

    >>> fit = fit_phase([3.0, 2.0, 1.0, 2.0], [0, np.pi / 2, np.pi, 3 * np.pi / 2], noise=NoiseModel(0.01))
    >>> round(float(fit.modulation_dn), 6), round(float(fit.sigma_rad), 6)
    (1.0, 0.007071)
    """
    given = np.asarray(frames)
    floor = QUANTISATION_VARIANCE_DN2 if given.dtype.kind in "ui" else 1e-12
    readings = given.astype(np.float64)
    solver = solve_steps(steps_rad)
    if readings.ndim < 1 or len(readings) != len(solver.steps_rad):
        raise InputError(f"phase: {len(solver.steps_rad)} steps need as many frames, not {readings.shape}")
    shape = readings.shape[1:]
    readings = readings.reshape(len(readings), -1)
    model = noise if noise is not None else estimate_noise(readings, [solver], response=response, floor_dn2=floor)
    light, slope_squared = linear_light(readings, response)
    offset, cosine, sine = solver.estimate @ light
    modulation = np.hypot(cosine, sine)
    var_cc, var_ss, var_cs, _ = solver.variance @ (slope_squared * model.variance(readings))
    across = cosine**2 * var_ss + sine**2 * var_cc - 2 * cosine * sine * var_cs
    with np.errstate(divide="ignore", invalid="ignore"):
        sigma = np.where(modulation == 0, np.inf, np.sqrt(np.maximum(across, 0.0)) / modulation**2)
    squares = ((solver.residual @ light) ** 2).sum(axis=0)
    residual = np.sqrt(squares / solver.redundancy) if solver.redundancy else np.full_like(offset, np.nan)
    phase = wrap_phase(np.arctan2(sine, cosine))
    return PhaseFit(*(freeze(part.reshape(shape)) for part in (phase, sigma, modulation, offset, residual)))


@dataclass(frozen=True, slots=True, eq=False)
class UnwrappedFraction:
    """Position on the display along one axis.

    fraction (...): Fraction of the displayed image, 0 to 1; noise may carry it a little beyond. NaN where no set is
        usable.
    sigma (...): Standard deviation of the fraction, given that the order is right.
    wrong_order_probability (...): Probability that the order of any of the sets is wrong, from the sigmas; 1 where
        no set is usable.
    """

    fraction: FloatArray
    sigma: FloatArray
    wrong_order_probability: FloatArray


def unwrap_temporal(
    phases_rad: npt.ArrayLike, sigmas_rad: npt.ArrayLike, periods: Sequence[float]
) -> UnwrappedFraction:
    """Find absolute positions from the phases of several periods, pixel by pixel.

    phases_rad (m, ...): Wrapped phase of each set, ``2 pi periods w`` [rad].
    sigmas_rad (m, ...): Their standard deviations; infinite leaves a set out at that pixel [rad].
    periods length m: Periods of each set over the display, in any order, any ratios.
    Returns: Mean of all sets weighted by inverse variance, its sigma, and the probability of a wrong order.
    InputError: Shapes or periods that do not fit.
    EstimationError: Too many periods in the coarsest set.

    The coarsest set gives one candidate for each of its periods that may lie on the display (exactly one below 1
    period: its window is centred on the display, so that noise at an edge stays there instead of jumping by 1 /
    periods). Each candidate is refined by the next sets in turn: order = nearest whole number, then the mean by
    inverse variance. A candidate costs the chi-square of its misfits plus that of lying outside [0, 1]; the best
    wins, and the odds against the next (and against the neighbouring order at each step) are ``exp(difference of
    chi-square / 2)``. With whole periods everywhere w and w + 1 cannot be told apart at the edges; such samples carry
    a probability near 0.5. Sets like (15, 16) without a coarse one work the same way.

    >>> phases = 2 * np.pi * np.array([0.9, 7.0])[:, None] * np.array([0.0, 0.25, 1.0])
    >>> found = unwrap_temporal(phases, np.full((2, 3), 0.01), [0.9, 7.0])
    >>> found.fraction.round(9) + 0.0
    array([0.  , 0.25, 1.  ])
    """
    search = search_orders(periods)
    phases = np.asarray(phases_rad, dtype=np.float64)
    sigmas = np.asarray(sigmas_rad, dtype=np.float64)
    if phases.shape != sigmas.shape or phases.ndim < 1 or len(phases) != len(search.periods):
        raise InputError(
            f"unwrapping: phases {phases.shape} and sigmas {sigmas.shape} of {len(search.periods)} sets are needed"
        )
    cycles = [phases[i] / TURN_RAD for i in search.positions]
    with np.errstate(divide="ignore", invalid="ignore"):
        information = [
            np.nan_to_num((TURN_RAD * p / sigmas[i]) ** 2, nan=0.0, posinf=1e30)
            for p, i in zip(search.periods, search.positions, strict=True)
        ]
    fraction, total, log_odds = combine_orders(search, cycles, information)
    with np.errstate(divide="ignore", over="ignore"):
        sigma = 1.0 / np.sqrt(total)
        probability = np.where(total > 0, 1.0 / (1.0 + np.exp(log_odds)), 1.0)
    return UnwrappedFraction(
        freeze(np.where(total > 0, fraction, np.nan)), freeze(sigma), freeze(np.asarray(probability, dtype=np.float64))
    )
