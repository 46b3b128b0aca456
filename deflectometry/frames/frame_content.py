"""What each frame really shows, judged against the display positions that the other frames agree on."""

from dataclasses import dataclass
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from deflectometry.fringes.fringe_orders import combine_orders, search_orders
from deflectometry.fringes.phase import TURN_RAD, LightResponse, solve_steps, wrap_phase
from deflectometry.setup.patterns import Axis, FringePattern
from deflectometry.sources.noise_model import NoiseModel
from heliogauge.adjust.robust_scale import robust_scale_of_rows
from heliogauge.validate import BoolArray, FloatArray

#: Pixels that the checks look at: 2000 give a frame's step to 0.1 deg at a signal to noise of 20.
_PIXELS = 2000
#: Median misfit of one period against the next, in turns, above which two sets contradict; chance gives 0.25.
_CONTRADICTION_TURNS = 0.12
#: Fringes in view from which a frame's amplitude is told from harmonics and offset.
_LEAST_VIEW_RAD = 2 * TURN_RAD


#: Standard deviations of what is expected before: light of a frame, its wave (unknown), the wave's first harmonic.
_SIGMA_PRIORS = np.array([0.1, np.inf, np.inf, 0.3, 0.3])
_HAS_PRIOR = np.isfinite(_SIGMA_PRIORS)


@dataclass(frozen=True, slots=True, eq=False)
class FrameSample:
    """Pixels that show fringes, thinned out.

    readings (n, m): Readings of all frames [DN].
    light (n, m): The same made linear.
    raw (n, k): Readings of all pixels looked at, lit or not, as they came.
    """

    readings: FloatArray
    light: FloatArray
    raw: npt.NDArray[Any]


def sample_frames(frames: npt.NDArray[Any], region: BoolArray | None, response: LightResponse | None) -> FrameSample:
    """Choose pixels that vary from frame to frame, spread over the image.

    Shapes: frames (n, h, w), region (h, w).
    response: Makes readings linear.
    Returns: At most 2000 lit pixels.

    Lit: the spread over the frames (`spread_of_frames`) is above 0.3 of its 99th percentile. A mirror that fills 1 % of
    the image is found.
    """
    height, width = frames.shape[1:]
    stride = max(1, int(np.sqrt(height * width / (8 * _PIXELS))))
    raw = frames[:, stride // 2 :: stride, stride // 2 :: stride].reshape(len(frames), -1)
    if region is not None:
        raw = raw[:, region[stride // 2 :: stride, stride // 2 :: stride].ravel()]
    values = raw.astype(np.float32)
    finite = np.isfinite(values).all(axis=0)
    spread = spread_of_frames(np.where(finite, values, np.float32(0)))
    lit = np.flatnonzero(finite & (spread > 0.3 * np.quantile(spread, 0.99))) if spread.size else np.zeros(0, int)
    lit = lit[:: max(1, -(-lit.size // _PIXELS))]
    readings = values[:, lit].astype(np.float64)
    return FrameSample(readings, readings if response is None else response.linearise(readings), raw)


def spread_of_frames(values: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return how much each pixel varies from frame to frame, whatever a single frame shows.

    Shapes: values (n, m), result (m,): half the range of the middle three quarters.
    """
    low, high = len(values) // 8, len(values) - 1 - len(values) // 8
    ordered = np.partition(values, (low, high), axis=0)
    return np.asarray(0.5 * (ordered[high] - ordered[low]), dtype=np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class SetFit:
    """All sets fitted to the sample.

    turns (s, m): Phase of each set in turns.
    modulation, offset (s, m): Amplitude and mean of each set.
    residual_share (s,): Root mean square residual over modulation; 0 for three frames.
    """

    turns: FloatArray
    modulation: FloatArray
    offset: FloatArray
    residual_share: FloatArray


def fit_sets(light: FloatArray, pattern: FringePattern) -> SetFit:
    """Fit every set of the pattern to linear readings, shape (n, m)."""
    parts, shares = [], []
    for fringes, position in zip(pattern.sets, pattern.frame_slices, strict=True):
        solver = solve_steps(fringes.steps_rad)
        offset, cosine, sine = solver.estimate @ light[position]
        power = cosine**2 + sine**2
        parts.append((np.arctan2(sine, cosine) / TURN_RAD, np.sqrt(power), offset))
        left = float(((solver.residual @ light[position]) ** 2).sum()) / max(solver.redundancy, 1)
        shares.append(np.sqrt(left / max(float(power.sum()), 1e-12)))
    turns, modulation, offsets = (np.stack(column) for column in zip(*parts, strict=True))
    return SetFit(turns, modulation, offsets, np.array(shares))


class SetPosition(NamedTuple):
    """Position of each pixel of the sample from some sets of one axis.

    fraction (m,): Fraction of the displayed image.
    log_odds (m,): Logarithm of the odds that its order is right.
    contradiction_turns: Largest median misfit of one period against the next.
    """

    fraction: FloatArray
    log_odds: FloatArray
    contradiction_turns: float


class AgreeingSets(NamedTuple):
    """Sets of one axis that do not contradict each other, by their place in the pattern."""

    sets: tuple[int, ...]
    contradiction_turns: float


def position_from_sets(fit: SetFit, pattern: FringePattern, chosen: tuple[int, ...], noise: NoiseModel) -> SetPosition:
    """Find the position from some sets of one axis.

    pattern: What was shown.
    """
    search = search_orders([pattern.sets[i].periods for i in chosen])
    order = [chosen[position] for position in search.positions]
    cycles = [fit.turns[i] for i in order]
    information = []
    for i in order:
        ratio = noise.variance(fit.offset[i]) / np.maximum(fit.modulation[i], 1e-9) ** 2
        variance = 2.0 / pattern.sets[i].n_frames * ratio
        # 0.05 rad of systematic phase, as a gamma of 1.3 makes, keeps the odds from being more certain than the frames.
        information.append((TURN_RAD * pattern.sets[i].periods) ** 2 / (variance + 2.5e-3))
    fraction, _, odds = combine_orders(search, cycles, information)
    worst = 0.0
    for coarse, fine in zip(range(len(order)), range(1, len(order)), strict=False):
        period = search.periods[coarse]
        alone = (np.rint(period * fraction - cycles[coarse]) + cycles[coarse]) / period
        misfit = cycles[fine] - search.periods[fine] * alone
        worst = max(worst, float(np.median(np.abs(misfit - np.rint(misfit)))))
    return SetPosition(np.asarray(fraction, dtype=np.float64), np.asarray(odds, dtype=np.float64), worst)


def agreeing_sets(fit: SetFit, pattern: FringePattern, axis: Axis, noise: NoiseModel) -> AgreeingSets:
    """Return the largest group of sets of one axis that do not contradict each other.

    Sets whose own frames do not follow a sinusoid (four times the usual residual) are left out first: two swapped
    frames spoil two sets, and the pairs that remain are too few to contradict each other.
    """
    every = tuple(i for i, fringes in enumerate(pattern.sets) if fringes.axis is axis)
    limit = max(4.0 * float(np.median(fit.residual_share)), 0.1)
    members = tuple(i for i in every if fit.residual_share[i] < limit) or every

    def judge(group: tuple[int, ...]) -> AgreeingSets:
        return AgreeingSets(group, position_from_sets(fit, pattern, group, noise).contradiction_turns)

    every_set = judge(members)
    if every_set.contradiction_turns < _CONTRADICTION_TURNS:
        return every_set
    for size in range(len(members) - 1, 1, -1):
        found = min(map(judge, combinations(members, size)), key=lambda one: one.contradiction_turns)
        if found.contradiction_turns < _CONTRADICTION_TURNS:
            return found
    return every_set


def contradicts(turns: float) -> bool:
    """Return whether a contradiction returned by `agreeing_sets` is more than noise."""
    return turns >= _CONTRADICTION_TURNS


@dataclass(frozen=True, slots=True, eq=False)
class FrameContent:
    """Each frame fitted with the fringes of each set.

    explained (n, s): Share of the frame's variation that fringes of the set explain.
    step_rad, sigma_step_rad (n, s): Phase step of the frame if it shows that set, and its standard deviation [rad].
    exposure (n,): Mean light over the pixels' usual mean, as its own set has it.
    sigma_exposure (n,): Standard deviation of that.
    spoilt_share (n,): Share of pixels far (8 robust sigma) from the fit of its own set.
    contrast (n,): Amplitude of the fringes of the frame's own set, over that of all sets; NaN where less than two
        turns of them are in view, and harmonics take a share.
    planned_misfit (n,): Root mean square departure from what was planned over that of the fringes themselves.
    """

    explained: FloatArray
    step_rad: FloatArray
    sigma_step_rad: FloatArray
    exposure: FloatArray
    sigma_exposure: FloatArray
    spoilt_share: FloatArray
    contrast: FloatArray
    planned_misfit: FloatArray


def frame_content(
    light: FloatArray, fit: SetFit, pattern: FringePattern, groups: dict[Axis, tuple[int, ...]], noise: NoiseModel
) -> FrameContent:
    """Compare every frame with the fringes of every set.

    light (n, m): Linear readings.
    pattern: What should have been shown.
    groups: Sets that agree, from `agreeing_sets`.
    Returns: Shares, steps and exposures.

    The position that a set is judged by comes from the other agreeing sets, so a spoilt frame cannot vouch for
    itself; only where the others leave the order open (odds below 1000) the set itself takes part. Model of frame k
    and set j at a pixel: ``I = g a + b (c cos theta_j + s sin theta_j)``, a and b the pixel's median offset and
    modulation over all sets; step = atan2(s, c). Twice the angle is fitted too: a gamma would otherwise pass for
    wrong steps where less than whole periods are in view.
    """
    n, sets = len(light), len(pattern.sets)
    offset, modulation = np.median(fit.offset, axis=0), np.median(fit.modulation, axis=0)
    explained, step, sigma = np.zeros((n, sets)), np.zeros((n, sets)), np.zeros((n, sets))
    exposure, sigma_exposure, spoilt, misfit = np.ones(n), np.full(n, np.inf), np.zeros(n), np.zeros(n)
    contrast = np.ones(n)
    total = ((light - light.mean(axis=1, keepdims=True)) ** 2).sum(axis=1) + 1e-12
    everywhere = {axis: position_from_sets(fit, pattern, group, noise).fraction for axis, group in groups.items()}
    for j, (fringes, position) in enumerate(zip(pattern.sets, pattern.frame_slices, strict=True)):
        group = groups[fringes.axis]
        others = position_from_sets(fit, pattern, tuple(i for i in group if i != j) or group, noise)
        usable = others.log_odds > 6.9
        angle = TURN_RAD * fringes.periods * np.where(usable, others.fraction, everywhere[fringes.axis])
        # Blur weakens fine fringes: each set by its usual modulation.
        own = modulation * float(np.median(fit.modulation[j] / np.maximum(modulation, 1e-9)))
        waves = [own * wave(order * angle) for order in (1, 2) for wave in (np.cos, np.sin)]
        basis = np.stack([offset, *waves])
        # Weak priors: light 1 +- 0.1, harmonics 0 +- 0.3, against 2 % of systematic misfit. Where only a third of a
        # fringe is in view, the five waves are nearly dependent, and a misfit of 1 % turned a step by 90 deg.
        systematic = light.shape[1] * (0.02 * float(np.median(own))) ** 2
        weight = systematic / np.square(_SIGMA_PRIORS)
        inverse = np.linalg.pinv(basis @ basis.T + np.diag(weight))
        coefficients = (light @ basis.T + weight * np.array([1.0, 0, 0, 0, 0])) @ inverse
        left = light - coefficients @ basis
        variance = (left**2).mean(axis=1)
        explained[:, j] = 1 - variance * left.shape[1] / total
        step[:, j] = np.arctan2(coefficients[:, 2], coefficients[:, 1])
        size = np.hypot(coefficients[:, 1], coefficients[:, 2]) + 1e-12
        # A frame with a tenth of the usual modulation shows no fringes, however well noise and offset are explained.
        explained[size < 0.1, j] = 0.0
        # A fault needs six sigma; the systematic misfit shall count once.
        spread = variance + systematic / 36
        sigma[:, j] = np.sqrt(spread * 0.5 * (inverse[1, 1] + inverse[2, 2])) / size
        exposure[position] = coefficients[position, 0]
        contrast[position] = size[position] if np.ptp(angle) > _LEAST_VIEW_RAD else np.nan
        # Where the view does not tell light from waves (a bent facet shows two places of the display), the prior does,
        # and is as uncertain as it says.
        by_prior = ((inverse[0] * weight)[_HAS_PRIOR] * _SIGMA_PRIORS[_HAS_PRIOR]) ** 2
        sigma_exposure[position] = np.sqrt(spread[position] * inverse[0, 0] + by_prior.sum())
        planned = np.median(size[position]) * own * np.cos(angle - fringes.steps_rad[:, None])
        misfit[position] = (light[position] - offset - planned).std(axis=1) / (planned.std() + 1e-12)
        # The best frame of the set gives the usual misfit: where blur or the other sets limit it, all frames share it.
        usual = float(robust_scale_of_rows(left[position]).min()) + 0.02 * float(np.median(modulation))
        spoilt[position] = (np.abs(left[position]) > 8 * usual).mean(axis=1)
    return FrameContent(explained, wrap_phase(step), sigma, exposure, sigma_exposure, spoilt, contrast, misfit)


@dataclass(frozen=True, slots=True, eq=False)
class StepEstimate:
    """Phase steps found from the frames themselves.

    steps_rad, sigma_rad (n,): Steps with the first as given, and their standard deviations [rad].
    """

    steps_rad: FloatArray
    sigma_rad: FloatArray


def estimate_steps(light: FloatArray, steps_rad: FloatArray, *, iterations: int = 60) -> StepEstimate:
    """Find the true phase steps of one set by alternating least squares.

    light (n, m): Linear readings of the set.
    steps_rad (n,): Steps as planned; the first is kept [rad].
    iterations: Most alternations.

    In turn: offset and phase of each pixel from the steps; step of each frame from the pixels' phases, normalised to
    the unit circle (Wang and Han 2004). n points of an ellipse must show that it is a circle seen askew, so five
    frames are the least; four equal steps hide a common shift of the even against the odd frames.
    """
    steps = np.array(steps_rad, dtype=np.float64)
    for _ in range(iterations):
        solver = solve_steps(steps)
        offset, cosine, sine = solver.estimate @ light
        phase, modulation = np.arctan2(sine, cosine), np.hypot(cosine, sine)
        # The offset takes up flicker of the light, twice the phase takes up a gamma: neither is a wrong step.
        basis = np.stack([cosine, sine, offset, modulation * np.cos(2 * phase), modulation * np.sin(2 * phase)])
        inverse = np.linalg.pinv(basis @ basis.T)
        coefficients = light @ basis.T @ inverse
        found = np.arctan2(coefficients[:, 1], coefficients[:, 0])
        found += steps_rad[0] - found[0]
        found += TURN_RAD * np.rint((steps_rad - found) / TURN_RAD)
        change = float(np.abs(found - steps).max())
        steps = found
        if change < 1e-6:
            break
    return StepEstimate(steps, _step_sigmas(light, steps))


def _step_sigmas(light: FloatArray, steps_rad: FloatArray) -> FloatArray:
    """Return the standard deviations of steps against the first, with each pixel's own unknowns eliminated [rad]."""
    solver = solve_steps(steps_rad)
    _, cosine, sine = solver.estimate @ light
    left = solver.residual @ light
    # A pixel leaves n - 3 of its n readings as residual; the steps' own share of the freedom is 1 in thousands.
    variance = float((left**2).sum()) / max(left.size, 1)
    slopes = np.cos(steps_rad)[:, None] * sine - np.sin(steps_rad)[:, None] * cosine
    normal = (solver.residual.T @ solver.residual) * (slopes @ slopes.T)
    covariance = variance * np.linalg.pinv(normal[1:, 1:], rcond=1e-12)
    return np.concatenate([[0.0], np.sqrt(np.maximum(np.diag(covariance), 0.0))])
