"""From fringe frames to the display point that each pixel sees, in blocks of rows that stay in the cache."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from deflectometry.fringes.fringe_orders import OrderSearch, combine_orders, estimate_systematic_phase, search_orders
from deflectometry.fringes.phase import (
    QUANTISATION_VARIANCE_DN2,
    TURN_RAD,
    LightResponse,
    StepSolver,
    estimate_noise,
    residual_distortion,
    solve_steps,
)
from deflectometry.setup.patterns import Axis, FringePattern, FringeSet
from deflectometry.sources.noise_model import NoiseModel
from deflectometry.sources.screen_map import ScreenMap
from heliogauge.adjust.chi_square import chi_square_limit
from heliogauge.errors import EstimationError, InputError
from heliogauge.flags import SampleFlag
from heliogauge.validate import BoolArray, FlagArray, Float32Array, FloatArray, freeze

#: Pixels of one block: 32 frames of float32 are then 2 MB, the second-level cache of one core.
_BLOCK_PIXELS = 16384
#: Periods of a set that stands for counted positions, so few that it covers the display twice; and their sigma in
#: periods of the coarsest set: enough to decide its order, a hundredth of its information.
_COUNTED_PERIODS, _COUNTED_SIGMA = 0.5, 0.15
#: Pixels from which the noise is estimated: 8 sets of 4 frames then give it to 0.3 %.
_NOISE_PIXELS = 8000


@dataclass(frozen=True, slots=True, eq=False)
class ScreenMapLimits:
    """Error probabilities for one pixel from which every threshold follows, and the saturation level.

    no_fringe_probability: Chance that a pixel without fringes passes as one with fringes, for each set.
    wrong_order_probability: Chance of a wrong fringe order up to which a pixel is accepted.
    disagree_probability: Chance that a good pixel is flagged because its frames disagree.
    saturation_dn: Reading that counts as saturated; infinite takes the largest value of integer frames [DN].
    InputError: A probability outside (0, 0.5), a saturation that is not positive.
    """

    no_fringe_probability: float = 1e-6
    wrong_order_probability: float = 1e-6
    disagree_probability: float = 1e-6
    saturation_dn: float = math.inf

    def __post_init__(self) -> None:
        for name in ("no_fringe_probability", "wrong_order_probability", "disagree_probability"):
            if not 0 < getattr(self, name) < 0.5:
                raise InputError(f"{name}: a probability between 0 and 0.5 is needed, not {getattr(self, name)}")
        if not self.saturation_dn > 0:
            raise InputError(f"saturation_dn: a positive number is needed, not {self.saturation_dn}")


@dataclass(frozen=True, slots=True, eq=False)
class _SetPlan:
    """One set of frames, ready for blocks: its place, its matrices in float32, its limits."""

    position: slice
    solver: StepSolver
    estimate: Float32Array
    residual: Float32Array
    variance: Float32Array
    information_scale: float
    least_information: float
    systematic_variance: float = 0.0
    distortion_share: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class _AxisPlan:
    """The sets of one axis, coarsest first.

    counted: Positions from known orders come first in the search.
    """

    search: OrderSearch
    sets: tuple[_SetPlan, ...]
    counted: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class _Plan:
    """Everything that is the same for all blocks."""

    axes: tuple[_AxisPlan, ...]
    noise: NoiseModel
    response: LightResponse | None
    light_table: Float32Array
    variance_table: Float32Array
    saturation_dn: float
    disagree_limit: float
    least_log_odds: float
    off_screen_sigmas: float


def measure_screen_map(
    frames: npt.NDArray[Any],
    pattern: FringePattern,
    *,
    response: LightResponse | None = None,
    region: BoolArray | None = None,
    noise: NoiseModel | None = None,
    limits: ScreenMapLimits | None = None,
    counted: Mapping[Axis, FloatArray] | None = None,
) -> ScreenMap:
    """Measure the display point that each pixel sees.

    frames (n, h, w): Frames in the order of the pattern; any strides [DN].
    pattern: What was shown.
    response: Makes readings linear in the display's level.
    region (h, w): Pixels to measure; the others are flagged as outside the mirror.
    noise: Noise of a reading; estimated from the fit's residuals without it.
    limits: Error probabilities and saturation.
    counted (h, w): Position of each pixel for axes whose fringes have no order of their own
        (`deflectometry.fringes.known_point.counted_positions`); it decides the order.
    Returns: Positions with sigmas; every doubtful pixel is NaN, with its reason in the flags.
    InputError: Frames, region or noise that do not fit the pattern.
    EstimationError: No region, three-step sets without a given noise, or periods whose order cannot be searched.

    For each pixel and set: sinusoid by least squares (`deflectometry.fringes.phase.solve_steps`), its variance that
    of the noise model times the squared slope of the response; the sets of an axis are combined by
    `deflectometry.fringes.fringe_orders`. A set is left out where its amplitude is below what noise alone reaches
    with `no_fringe_probability` p, which is ``sigma_phi > 1 / sqrt(2 ln(1 / p))`` (0.19 rad at 1e-6: the amplitude
    of noise is Rayleigh distributed); the coarsest set must be above it.
    """
    _check_frames(frames, pattern, region)
    chosen = limits if limits is not None else ScreenMapLimits()
    window = _bounding_window(region, frames.shape[1:])
    sample = _sample(frames, region, _saturation(frames.dtype, chosen))
    model = noise if noise is not None else _estimate_noise(sample, pattern, response)
    by_axis = counted or {}
    plan = _make_plan(frames.dtype, pattern, response, model, chosen, frozenset(by_axis))
    systematic = _systematic_phases(plan, sample)
    plan = _with_systematic(plan, systematic, sample)
    shape = frames.shape[1:]
    values = [np.empty(shape, dtype=np.float32) for _ in range(5)]
    flags = np.empty(shape, dtype=np.uint32)
    if region is not None:
        for value in values:
            value.fill(np.nan)
        flags.fill(SampleFlag.OUTSIDE_MIRROR)
    for block in _blocks(window):
        orders = [by_axis[axis][block].ravel() if axis in by_axis else None for axis in Axis]
        part, part_flags = _measure_block(plan, frames[:, block[0], block[1]], orders)
        if region is not None:
            part_flags[~region[block]] = SampleFlag.OUTSIDE_MIRROR
        rejected = part_flags != 0
        if rejected.any():
            for value in part[:4]:
                value[rejected] = np.nan
        for target, value in zip(values, part, strict=True):
            target[block] = value
        flags[block] = part_flags
    u, v, sigma_u, sigma_v, modulation = (freeze(value) for value in values)
    return ScreenMap(u, v, sigma_u, sigma_v, modulation, freeze(flags), model, freeze(systematic))


def modulation_image(
    frames: npt.NDArray[Any], pattern: FringePattern, *, response: LightResponse | None = None
) -> Float32Array:
    """Return the fringes' mean amplitude, cheaply and before any region is known (a mirror stands out by it).

    frames (n, h, w): Frames in the order of the pattern; any strides [DN].
    pattern: What was shown.
    response: Makes readings linear in the display's level.
    Returns (h, w): Root of the mean squared amplitude of the coarsest set of each axis, which blur weakens least
        [DN, or the response's unit].
    InputError: Frames that do not fit the pattern.
    """
    _check_frames(frames, pattern, None)
    light_table, _ = _tables(frames.dtype, response, NoiseModel(1.0))
    coarsest = [min(pattern.sets_of(axis), key=lambda pair: pair[0].periods) for axis in Axis]
    solved = [
        (position, solve_steps(fringes.steps_rad).estimate[1:].astype(np.float32)) for fringes, position in coarsest
    ]
    image = np.zeros(frames.shape[1:], dtype=np.float32)
    for block in _blocks(_bounding_window(None, image.shape)):
        power = np.zeros(image[block].shape, dtype=np.float32)
        for position, matrix in solved:
            raw = frames[position, block[0], block[1]]
            light = _light(raw, raw.astype(np.float32), response, light_table)
            components = matrix @ light.reshape(len(light), -1)
            power += (components[0] ** 2 + components[1] ** 2).reshape(power.shape)
        image[block] = np.sqrt(0.5 * power)
    return freeze(image)


def _check_frames(frames: npt.NDArray[Any], pattern: FringePattern, region: BoolArray | None) -> None:
    if frames.ndim != 3 or frames.dtype.kind not in "uif":
        raise InputError(f"frames: numbers of shape (n, h, w) are needed, not {frames.dtype} {frames.shape}")
    if len(frames) != pattern.n_frames:
        raise InputError(
            f"frames: the pattern has {pattern.n_frames} frames ({len(pattern.sets)} sets), but {len(frames)} were "
            "given; check that no image is missing and that [[pattern.set]] lists all periods and steps"
        )
    if region is not None and (region.dtype != np.bool_ or region.shape != frames.shape[1:]):
        raise InputError(
            f"region: a bool image of shape {frames.shape[1:]} is needed, not {region.dtype} {region.shape}"
        )


def _bounding_window(region: BoolArray | None, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Return the rows and columns that hold the region."""
    if region is None:
        return slice(0, shape[0]), slice(0, shape[1])
    rows, columns = np.flatnonzero(region.any(axis=1)), np.flatnonzero(region.any(axis=0))
    if rows.size == 0:
        raise EstimationError("region: it has no pixel; is the mirror in view?")
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def _blocks(window: tuple[slice, slice]) -> Iterator[tuple[slice, slice]]:
    """Cut a window into blocks of rows."""
    rows, columns = window
    height = max(1, _BLOCK_PIXELS // max(columns.stop - columns.start, 1))
    for start in range(rows.start, rows.stop, height):
        yield slice(start, min(start + height, rows.stop)), columns


def _saturation(dtype: np.dtype[Any], limits: ScreenMapLimits) -> float:
    """Return the reading that counts as saturated."""
    return min(limits.saturation_dn, float(np.iinfo(dtype).max)) if dtype.kind in "ui" else limits.saturation_dn


def _sample(frames: npt.NDArray[Any], region: BoolArray | None, saturation_dn: float) -> npt.NDArray[Any]:
    """Return finite, unsaturated pixels spread over the region, shape (n, pixels), in the frames' own type."""
    rows, columns = _bounding_window(region, frames.shape[1:])
    pixels = (rows.stop - rows.start) * (columns.stop - columns.start)
    stride = max(1, math.isqrt(pixels // _NOISE_PIXELS))
    chosen = (slice(rows.start, rows.stop, stride), slice(columns.start, columns.stop, stride))
    readings = frames[:, chosen[0], chosen[1]].reshape(len(frames), -1)
    usable = np.isfinite(readings).all(axis=0) & (readings.max(axis=0) < saturation_dn)
    if region is not None:
        usable &= region[chosen].ravel()
    return np.asarray(readings[:, usable])


def _estimate_noise(sample: npt.NDArray[Any], pattern: FringePattern, response: LightResponse | None) -> NoiseModel:
    """Estimate the noise from a sample of pixels."""
    floor = QUANTISATION_VARIANCE_DN2
    if sample.dtype.kind == "f":
        # float32 keeps 6e-8 of the reading; less noise than that cannot be meant.
        floor = (1e-7 * max(float(np.abs(sample).max(initial=0.0)), 1e-6)) ** 2
    solvers = [solve_steps(fringes.steps_rad) for fringes in pattern.sets]
    if sample.shape[1] == 0:
        return NoiseModel(math.sqrt(floor))
    return estimate_noise(sample.astype(np.float64), solvers, response=response, floor_dn2=floor)


def _systematic_phases(plan: _Plan, sample: npt.NDArray[Any]) -> FloatArray:
    """Estimate the phase error beyond noise of each axis from a sample of pixels [rad]."""
    readings = sample.astype(np.float32)
    light = _light(sample, readings, plan.response, plan.light_table)
    variance = _reading_variance(plan, sample, readings)
    unused = np.zeros((2, sample.shape[1]), dtype=np.float32)
    found = []
    with np.errstate(divide="ignore", invalid="ignore"):
        for axis in plan.axes:
            fits = [_fit_set(plan, fringes, light, variance, unused[0], unused[1]) for fringes in axis.sets]
            cycles = [turns.astype(np.float64) for turns, _ in fits]
            weights = [weight.astype(np.float64) for _, weight in fits]
            # Sets among each other: counted positions are made of the coarsest one.
            search = search_orders(axis.search.periods[1:]) if axis.counted and len(fits) > 1 else axis.search
            found.append(estimate_systematic_phase(search, cycles, weights) if len(fits) > 1 else 0.0)
    return np.array(found)


def _with_systematic(plan: _Plan, systematic_rad: FloatArray, sample: npt.NDArray[Any]) -> _Plan:
    """Return the plan with each axis's systematic phase and each set's harmonics in the variances."""
    light = _light(sample, sample.astype(np.float32), plan.response, plan.light_table).astype(np.float64)
    axes = []
    for axis, phase in zip(plan.axes, systematic_rad, strict=True):
        known = []
        for one in axis.sets:
            distortion = residual_distortion(light[one.position], one.solver)
            # Mean square over the phase of a residual, for each squared DN of modulation.
            share = 0.5 * float((distortion**2).sum()) / max(one.solver.redundancy, 1)
            variance = float(phase) ** 2 / one.information_scale
            known.append(replace(one, systematic_variance=variance, distortion_share=share))
        axes.append(replace(axis, sets=tuple(known)))
    return replace(plan, axes=tuple(axes))


def _tables(
    dtype: np.dtype[Any], response: LightResponse | None, noise: NoiseModel
) -> tuple[Float32Array, Float32Array]:
    """Return light and its variance for each possible integer reading; empty where there is nothing to look up."""
    if response is None or dtype.kind == "f":
        return np.zeros(0, dtype=np.float32), np.zeros(0, dtype=np.float32)
    readings: FloatArray = np.arange(np.iinfo(dtype).max + 1 if dtype.itemsize <= 2 else 65536, dtype=np.float64)
    variance = response.slope(readings) ** 2 * noise.variance(readings)
    return response.linearise(readings).astype(np.float32), variance.astype(np.float32)


def _light(
    raw: npt.NDArray[Any], readings: Float32Array, response: LightResponse | None, table: Float32Array
) -> Float32Array:
    """Return linear light for a block of readings."""
    if response is None:
        return readings
    if table.size:
        # mode="wrap" spares the check of each index that plain indexing makes, which costs 20 times the look-up.
        return np.take(table, raw, mode="wrap")
    return response.linearise(readings.astype(np.float64)).astype(np.float32)


def _make_plan(
    dtype: np.dtype[Any],
    pattern: FringePattern,
    response: LightResponse | None,
    noise: NoiseModel,
    limits: ScreenMapLimits,
    counted: frozenset[Axis],
) -> _Plan:
    """Prepare matrices, tables and thresholds."""
    axes = []
    redundancy = 0
    for axis in Axis:
        sets = pattern.sets_of(axis)
        first = int(axis in counted)
        search = search_orders([_COUNTED_PERIODS] * first + [fringes.periods for fringes, _ in sets])
        plans = tuple(_plan_set(*sets[position - first], limits) for position in search.positions[first:])
        redundancy += sum(plan.solver.redundancy for plan in plans)
        axes.append(_AxisPlan(search, plans, bool(first)))
    light_table, variance_table = _tables(dtype, response, noise)
    return _Plan(
        axes=tuple(axes),
        noise=noise,
        response=response,
        light_table=light_table,
        variance_table=variance_table,
        saturation_dn=_saturation(dtype, limits),
        disagree_limit=chi_square_limit(limits.disagree_probability, redundancy) if redundancy else math.inf,
        least_log_odds=math.log(1 / limits.wrong_order_probability - 1),
        off_screen_sigmas=math.sqrt(chi_square_limit(limits.wrong_order_probability, 1)),
    )


def _plan_set(fringes: FringeSet, position: slice, limits: ScreenMapLimits) -> _SetPlan:
    solver = solve_steps(fringes.steps_rad)
    scale = (TURN_RAD * fringes.periods) ** 2
    return _SetPlan(
        position,
        solver,
        solver.estimate.astype(np.float32),
        solver.residual.astype(np.float32),
        solver.variance.astype(np.float32),
        scale,
        scale * 2.0 * math.log(1 / limits.no_fringe_probability),
    )


def _measure_block(
    plan: _Plan, raw: npt.NDArray[Any], counted: list[FloatArray | None]
) -> tuple[list[Float32Array], FlagArray]:
    """Measure one block; return u, v, sigma_u, sigma_v, modulation and the flags, each of shape (rows, columns).

    counted: Positions (pixels,) from counted orders for each axis, where it has some.
    """
    n, *shape = raw.shape
    readings = np.empty((n, *shape), dtype=np.float32)
    np.copyto(readings, raw, casting="unsafe")
    light = _light(raw, readings, plan.response, plan.light_table).reshape(n, -1)
    variance = _reading_variance(plan, raw, readings)
    pixels = light.shape[1]
    flags = np.zeros(pixels, dtype=np.uint32)
    modulation, disagreement = np.zeros(pixels, dtype=np.float32), np.zeros(pixels, dtype=np.float32)
    positions: list[Float32Array] = []
    sigmas: list[Float32Array] = []
    with np.errstate(divide="ignore", invalid="ignore"):
        for axis, known in zip(plan.axes, counted, strict=True):
            cycles, information = [], []
            for fringes in axis.sets:
                turns, weight = _fit_set(plan, fringes, light, variance, modulation, disagreement)
                cycles.append(turns)
                information.append(weight)
            seen = information[0] > 0
            if known is not None:
                weight = np.where(np.isfinite(known), (axis.search.periods[1] / _COUNTED_SIGMA) ** 2, 0.0)
                cycles.insert(0, (_COUNTED_PERIODS * np.nan_to_num(known)).astype(np.float32))
                information.insert(0, weight.astype(np.float32))
            position, total, odds = combine_orders(axis.search, cycles, information)
            sigma = 1.0 / np.sqrt(total)
            beyond = np.abs(position - 0.5) - 0.5 > plan.off_screen_sigmas * sigma
            if known is not None:
                # To a pixel that was not counted no order belongs: where it looks, on the display or past it, is open.
                odds = np.where(np.isfinite(known), odds, -np.inf)
                beyond &= np.isfinite(known)
            flags |= np.where(seen, np.uint32(0), np.uint32(SampleFlag.LOW_MODULATION))
            flags |= np.where(seen & ~(odds >= plan.least_log_odds), np.uint32(SampleFlag.FRINGE_ORDER_UNCERTAIN), 0)
            flags |= np.where(seen & beyond, np.uint32(SampleFlag.OFF_SCREEN), np.uint32(0))
            positions.append(position)
            sigmas.append(sigma)
        flags |= np.where(disagreement > plan.disagree_limit, np.uint32(SampleFlag.FRAMES_DISAGREE), np.uint32(0))
    if math.isfinite(plan.saturation_dn):
        saturated = readings.reshape(n, -1).max(axis=0) >= plan.saturation_dn
        flags |= np.where(saturated, np.uint32(SampleFlag.SATURATED), np.uint32(0))
    if raw.dtype.kind == "f":
        flags[~np.isfinite(readings).reshape(n, -1).all(axis=0)] = SampleFlag.INPUT_NOT_FINITE
    modulation *= np.float32(1.0 / sum(len(axis.sets) for axis in plan.axes))
    return [part.reshape(shape) for part in (*positions, *sigmas, modulation)], flags.reshape(shape)


def _reading_variance(plan: _Plan, raw: npt.NDArray[Any], readings: Float32Array) -> Float32Array:
    """Return the variance of the light of each reading, shape (n, pixels); empty where the mean reading is enough."""
    n = len(raw)
    if plan.response is not None:
        if plan.variance_table.size:
            return np.take(plan.variance_table, raw, mode="wrap").reshape(n, -1)
        wide = readings.astype(np.float64)
        return (plan.response.slope(wide) ** 2 * plan.noise.variance(wide)).astype(np.float32).reshape(n, -1)
    if all(fringes.solver.balanced for axis in plan.axes for fringes in axis.sets):
        return np.zeros((0, 0), dtype=np.float32)
    constant, gain = np.float32(plan.noise.sigma_read_dn**2), np.float32(plan.noise.gain_dn)
    return (constant + gain * np.maximum(readings, np.float32(0))).reshape(n, -1)


def _fit_set(
    plan: _Plan,
    fringes: _SetPlan,
    light: Float32Array,
    variance: Float32Array,
    modulation: Float32Array,
    disagreement: Float32Array,
) -> tuple[Float32Array, Float32Array]:
    """Fit one set; add to modulation and disagreement in place; return turns and information on the position."""
    chosen = light[fringes.position]
    offset, cosine, sine = fringes.estimate @ chosen
    power = cosine * cosine + sine * sine
    modulation += np.sqrt(power)
    if variance.size == 0:
        constant, gain = np.float32(plan.noise.sigma_read_dn**2), np.float32(plan.noise.gain_dn)
        single = constant + gain * np.maximum(offset, np.float32(0)) if gain else constant
        information = power * (np.float32(fringes.information_scale * 0.5 * len(chosen)) / single)
    else:
        var_cc, var_ss, var_cs, single = fringes.variance @ variance[fringes.position]
        across = cosine * cosine * var_ss + sine * sine * var_cc - np.float32(2) * cosine * sine * var_cs
        information = np.float32(fringes.information_scale) * power * (power / across)
    if fringes.solver.redundancy:
        left = fringes.residual @ chosen
        disagreement += np.einsum("ij,ij->j", left, left) / (single + power * np.float32(fringes.distortion_share))
    # Not (>=) rather than <: a pixel that is not finite is left out too.
    information[~(information >= fringes.least_information)] = 0.0
    if fringes.systematic_variance > 0:
        information /= np.float32(1.0) + information * np.float32(fringes.systematic_variance)
    return np.arctan2(sine, cosine) * np.float32(1 / TURN_RAD), information
