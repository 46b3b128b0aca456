"""How good the frames are: light, contrast, linearity; and the words for what is wrong."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Literal

import numpy as np

from deflectometry.frames.frame_content import FrameContent, FrameSample, SetFit, fit_sets
from deflectometry.fringes.phase import LightResponse, residual_distortion, solve_steps
from deflectometry.setup.patterns import FringePattern
from deflectometry.sources.noise_model import NoiseModel
from heliogauge.doubts import Doubt
from heliogauge.validate import FloatArray

#: Standard errors that an effect must exceed to be named: once in 5e8 by chance.
SIGNIFICANT = 6.0


class FaultKind(StrEnum):
    """What can be wrong with frames."""

    FRAME_COUNT = "frames_count"
    NOT_FINITE = "frames_not_finite"
    LOW_MODULATION = "fringes_weak"
    REPEATED = "frame_repeated"
    STALE = "frame_stale"
    SWAPPED = "frames_swapped"
    CORRUPT = "frame_corrupt"
    WRONG_STEP = "fringe_steps_wrong"
    SETS_DISAGREE = "fringe_sets_disagree"
    CASCADE = "frames_beyond_repair"
    SATURATION = "frames_saturated"
    GAMMA = "fringes_not_sinusoidal"
    EXPOSURE = "light_changes"
    RESPONSE = "response_misfits_frames"


@dataclass(frozen=True, slots=True, eq=False)
class Remedy:
    """How a sequence with a fault can be used after all.

    shows: Frames that show another frame's fringes, and whose; None: nobody's.
    steps_rad: Sets (by their place in the pattern) whose steps are others than planned, and which.
    pattern: The pattern that the sequence fits.
    """

    shows: Mapping[int, int | None] = field(default_factory=dict)
    steps_rad: Mapping[int, FloatArray] = field(default_factory=dict)
    pattern: FringePattern | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FrameFault:
    """One fault found in the frames.

    frames: Frames concerned, from 0; empty where it concerns all.
    message: What was seen, in numbers, and what to do.
    severity: An error makes the result wrong; a doubt makes it worse.
    numbers: What was seen, by name with unit.
    remedy: How the sequence can be used after all, where it can.
    """

    kind: FaultKind
    frames: tuple[int, ...]
    message: str
    severity: Literal["error", "doubt"] = "error"
    numbers: Mapping[str, float] = field(default_factory=dict)
    remedy: Remedy | None = None

    @property
    def doubt(self) -> Doubt:
        """The fault as a doubt."""
        return Doubt(self.kind.value, self.message, self.numbers)


def saturation_limit(dtype: np.dtype[Any], saturation_dn: float) -> float:
    """Return the reading that counts as saturated."""
    return min(saturation_dn, float(np.iinfo(dtype).max)) if dtype.kind in "ui" else saturation_dn


def check_finite(sample: FrameSample) -> Iterator[FrameFault]:
    """Yield a fault of frames that hold values which are not finite."""
    if sample.raw.dtype.kind != "f" or np.isfinite(sample.raw).all():
        return
    share = (~np.isfinite(sample.raw)).mean(axis=1)
    frames = tuple(int(i) for i in np.flatnonzero(share))
    yield FrameFault(
        FaultKind.NOT_FINITE,
        frames,
        f"frames {_list(frames)} hold values that are not finite (up to {share.max():.1%} of one); export them again",
        # Single pixels are left out and flagged; a frame that is mostly nothing leaves nothing to evaluate.
        "error" if share.max() > 0.5 else "doubt",
        {"frames_count": len(frames), "largest_share": float(share.max())},
    )


def check_saturation(sample: FrameSample, dtype: np.dtype[Any], saturation_dn: float) -> Iterator[FrameFault]:
    """Yield a fault where more than 1 % of the pixels with fringes reach the limit."""
    limit = saturation_limit(dtype, saturation_dn)
    over = sample.readings >= limit
    share = float(over.any(axis=0).mean())
    if share > 0.01:
        frames = tuple(int(i) for i in np.flatnonzero(over.mean(axis=1) > 0.002))
        yield FrameFault(
            FaultKind.SATURATION,
            frames,
            f"{share:.1%} of the pixels with fringes reach {limit:g} DN in at least one frame; their phase is biased "
            "and they will be left out: shorten the exposure or lower the display's brightest level",
            "error" if share > 0.5 else "doubt",
            {"saturated_share": share, "saturation_dn": limit},
        )


def check_exposure(content: FrameContent, pattern: FringePattern) -> Iterator[FrameFault]:
    """Yield a fault where the light changes from frame to frame."""
    usual = float(np.median(content.exposure))
    change = content.exposure / usual - 1
    significant = np.abs(change) > 0.01 + SIGNIFICANT * content.sigma_exposure
    order = np.arange(len(change)) - (len(change) - 1) / 2
    slope = float(order @ change / (order @ order))
    left = change - slope * order - change.mean()
    total = slope * (len(change) - 1)
    # All frames together show a drift that no single one would: its sigma follows from the scatter about the line.
    sigma_total = float(np.sqrt(left @ left / max(len(change) - 2, 1) / (order @ order))) * (len(change) - 1)
    drifts = abs(total) > 0.01 + SIGNIFICANT * sigma_total
    if not (significant.any() or drifts):
        return
    frames = tuple(range(len(change))) if drifts else tuple(int(i) for i in np.flatnonzero(significant))
    if drifts:
        seen = f"the light drifts by {total:+.1%} from frame 0 to frame {len(change) - 1}"
        remedy = "let the light source and the display warm up, or lock the exposure"
        largest = total
    else:
        worst = int(np.argmax(np.abs(change)))
        largest = float(change[worst])
        seen = f"the light changes between frames, by {change[worst]:+.1%} in {pattern.describe_frame(worst)}"
        remedy = "use an exposure of whole display refresh periods, and switch automatic exposure and room light off"
    yield FrameFault(FaultKind.EXPOSURE, frames, f"{seen}; {remedy}", "doubt", {"change_share": largest})


def check_modulation(fit: SetFit, pattern: FringePattern, noise: NoiseModel) -> Iterator[FrameFault]:
    """Yield faults of sets that are too weak to find the fringe order by."""
    for index, (fringes, position) in enumerate(zip(pattern.sets, pattern.frame_slices, strict=True)):
        weak = fit.modulation[index] < 5.26 * np.sqrt(2.0 / fringes.n_frames * noise.variance(fit.offset[index]))
        share = float(weak.mean())
        if share > 0.2:
            yield FrameFault(
                FaultKind.LOW_MODULATION,
                tuple(range(position.start, position.stop)),
                f"{fringes.axis} fringes with {fringes.periods:g} periods: {share:.0%} of the pixels have less "
                f"modulation than noise can imitate (median {np.median(fit.modulation[index]):.2g} DN); focus nearer "
                "to the display, use fewer periods, or expose longer",
                "doubt",
                {"periods_count": fringes.periods, "weak_share": share},
            )


def check_gamma(sample: FrameSample, fit: SetFit, pattern: FringePattern, noise: NoiseModel) -> Iterator[FrameFault]:
    """Yield a fault where harmonics show that display or camera is not linear."""
    share, sigma = _second_harmonic(sample.light, fit, pattern, noise)
    if abs(share) > 0.02 + SIGNIFICANT * sigma:
        gamma = (1 + 2 * share) / (1 - share)
        yield FrameFault(
            FaultKind.GAMMA,
            (),
            f"the fringes are not sinusoidal: the second harmonic is {share:+.1%} of the modulation, as from a display "
            f"with light = level**{gamma:.2f} at full contrast; calibrate the response, or display compensated frames "
            "(with 3 or 4 steps the third harmonic goes straight into the phase)",
            "doubt",
            {"second_harmonic_share": share, "gamma_ratio": gamma},
        )


def response_helps(sample: FrameSample, fit: SetFit, pattern: FringePattern, noise: NoiseModel) -> bool:
    """Return whether the response takes away most of the second harmonic.

    What a right response leaves is the noise next to black: where 1 DN is many levels, the mean level of noisy
    readings lies below the level of their mean (13 % of second harmonic for a gamma of 2.2, 4 DN of offset and 1 DN
    of noise).
    """
    if sample.light is sample.readings:
        return False
    with_response, _ = _second_harmonic(sample.light, fit, pattern, noise)
    without, _ = _second_harmonic(sample.readings, fit_sets(sample.readings, pattern), pattern, noise)
    return abs(with_response) < 0.6 * abs(without)


def _second_harmonic(values: FloatArray, fit: SetFit, pattern: FringePattern, noise: NoiseModel) -> tuple[float, float]:
    """Return the largest second harmonic of a set as a share of its modulation, and its standard deviation."""
    seconds, sigmas = [0.0], [0.0]
    for index, (fringes, position) in enumerate(zip(pattern.sets, pattern.frame_slices, strict=True)):
        solver = solve_steps(fringes.steps_rad)
        if solver.redundancy == 0:
            continue
        found = residual_distortion(values[position], solver)[:, :2]
        # A second harmonic h cos(2 phi - 2 step) leaves h times these shares of cos 2 phi and sin 2 phi.
        twice = np.stack([np.cos(2 * fringes.steps_rad), np.sin(2 * fringes.steps_rad)])
        seen = solver.residual @ twice.T
        size = float((seen**2).sum())
        if size < 1e-6:
            continue
        seconds.append(float((found * seen).sum() / size))
        power = float((fit.modulation[index] ** 2).sum())
        variance = float(np.median(noise.variance(fit.offset[index])))
        sigmas.append(math.sqrt(2.0 * variance / max(power, 1e-12) / size))
    worst = int(np.argmax(np.abs(seconds)))
    return seconds[worst], sigmas[worst]


def check_response_range(sample: FrameSample, response: LightResponse) -> Iterator[FrameFault]:
    """Yield a fault where readings lie beyond the ends of the response."""
    # Beyond its ends a look-up stays where it is.
    above = response.linearise(sample.readings) >= response.linearise(np.full(1, np.inf))[0]
    share = float(above.mean())
    if share > 0.02:
        yield FrameFault(
            FaultKind.RESPONSE,
            (),
            f"{share:.0%} of the readings (up to {sample.readings.max():.0f} DN) lie above the brightest one of the "
            "response: it was measured for another exposure, or is cut off; measure it up to the brightest level",
            "error" if share > 0.1 else "doubt",
            {"beyond_response_share": share},
        )


def check_response(sample: FrameSample, pattern: FringePattern) -> Iterator[FrameFault]:
    """Yield a fault where linearising makes the fringes less sinusoidal."""
    shares = []
    for values in (sample.readings, sample.light):
        left, power = 0.0, 1e-12
        for fringes, position in zip(pattern.sets, pattern.frame_slices, strict=True):
            solver = solve_steps(fringes.steps_rad)
            left += float(((solver.residual @ values[position]) ** 2).sum()) / max(solver.redundancy, 1)
            power += float(((solver.estimate[1:] @ values[position]) ** 2).sum())
        shares.append(math.sqrt(left / power))
    if shares[1] > 1.5 * shares[0] + 0.01:
        yield FrameFault(
            FaultKind.RESPONSE,
            (),
            f"with the response the fringes depart from sinusoids by {shares[1]:.1%} of their modulation, without it "
            f"by {shares[0]:.1%}: it was measured for another display or exposure, or the frames were compensated "
            "already; leave response_file out or measure it again",
            "doubt",
            {"departure_share": shares[1], "departure_without_response_share": shares[0]},
        )


def _list(frames: tuple[int, ...]) -> str:
    return ", ".join(str(frame) for frame in frames[:8]) + (" ..." if len(frames) > 8 else "")
