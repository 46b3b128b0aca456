"""Name what is wrong with a sequence of frames before anything is computed from it."""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from deflectometry.frames.frame_content import (
    FrameContent,
    FrameSample,
    SetFit,
    StepEstimate,
    agreeing_sets,
    contradicts,
    estimate_steps,
    fit_sets,
    frame_content,
    sample_frames,
)
from deflectometry.frames.light_checks import (
    SIGNIFICANT,
    FaultKind,
    FrameFault,
    Remedy,
    check_exposure,
    check_finite,
    check_gamma,
    check_modulation,
    check_response,
    check_response_range,
    check_saturation,
    response_helps,
    saturation_limit,
)
from deflectometry.fringes.phase import (
    QUANTISATION_VARIANCE_DN2,
    LightResponse,
    estimate_noise,
    solve_steps,
    wrap_phase,
)
from deflectometry.setup.patterns import Axis, FringePattern, FringeSet
from deflectometry.sources.noise_model import NoiseModel
from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.validate import BoolArray, FloatArray

__all__ = ["FaultKind", "FrameFault", "SampledFrames", "check_frames", "check_sampled", "shorten_faults"]

#: A step error of this size moves the phase by as much as 1 DN of noise at a modulation of 100 DN with 4 frames.
_STEP_TOLERANCE_RAD = math.radians(0.5)

#: Departure of one frame's contrast from its set's, with at least two fringes in view: good frames of the published
#: facet are within 0.013 (a response that misfits included), drawn ones within 0.003.
_CONTRAST_TOLERANCE = 0.04

#: Noise of all sets together over that of the usual set, from which single sets are spoilt.
_SPOILT_POOL = 3.0


def check_frames(
    frames: npt.NDArray[Any],
    pattern: FringePattern,
    *,
    response: LightResponse | None = None,
    region: BoolArray | None = None,
    saturation_dn: float = math.inf,
) -> list[FrameFault]:
    """Look for faults of the frames on a sample of pixels: every one, see `shorten_faults`.

    frames (n, h, w): Frames in the order of the pattern [DN].
    pattern: What should have been shown.
    response: Makes readings linear in the display's level.
    region (h, w): Where to look; pixels that vary between frames are found without it.
    saturation_dn: Reading that counts as saturated; infinite takes the largest value of integer frames [DN].

    What can be seen depends on the steps. Harmonics: three frames show none; four equal steps show the second
    (harmless to the phase, but the sign of a gamma) and not the third (which disturbs it); five or more show what
    matters. Wrong steps: from five frames within a set; with three or four frames only where a finer set of the axis
    gives the position. With one set for an axis its frames can only be compared with each other.
    """
    return check_sampled(SampledFrames(frames, response, saturation_dn, region), pattern)


class SampledFrames:
    """Pixels of a sequence that the checks look at, and their noise, each found once.

    frames (n, h, w): Frames in the order of a pattern [DN].
    response: Makes readings linear.
    saturation_dn: Reading that counts as saturated.
    region (h, w): Where to look.
    """

    def __init__(
        self,
        frames: npt.NDArray[Any],
        response: LightResponse | None,
        saturation_dn: float,
        region: BoolArray | None = None,
    ) -> None:
        self.frames = frames
        self.response = response
        self.saturation_dn = saturation_dn
        self._region = region
        self._noise: tuple[FringePattern, NoiseModel] | None = None

    @cached_property
    def sample(self) -> FrameSample:
        """Pixels that show fringes, thinned out."""
        return sample_frames(self.frames, self._region, self.response)

    @cached_property
    def unsaturated(self) -> FrameSample:
        """The same without saturated pixels: their clipped sinusoids would pass for other faults."""
        sample = self.sample
        good = sample.readings.max(axis=0) < saturation_limit(self.frames.dtype, self.saturation_dn)
        return FrameSample(sample.readings[:, good], sample.light[:, good], sample.raw)

    def noise(self, pattern: FringePattern) -> NoiseModel:
        """Return the noise of linear light in unsaturated pixels."""
        if self._noise is None or self._noise[0] is not pattern:
            self._noise = pattern, light_noise(self.unsaturated, pattern, self.frames.dtype, self.response)
        return self._noise[1]


def check_sampled(sampled: SampledFrames, pattern: FringePattern) -> list[FrameFault]:
    """Look for faults of the frames as `check_frames` does, where their sample is at hand."""
    frames, response, saturation_dn = sampled.frames, sampled.response, sampled.saturation_dn
    if len(frames) != pattern.n_frames:
        return [_frame_count(len(frames), pattern)]
    sample = sampled.sample
    faults = list(check_finite(sample))
    if _errors(faults):
        return faults
    if sample.readings.shape[1] < 30:
        return [*faults, _no_fringes("no pixel varies between the frames")]
    faults += list(check_saturation(sample, frames.dtype, saturation_dn))
    if response is not None:
        faults += check_response_range(sample, response)
    if _errors(faults):
        return faults
    sample, noise = sampled.unsaturated, sampled.noise(pattern)
    fit = fit_sets(sample.light, pattern)
    scatter = [math.sqrt(2.0 / fringes.n_frames) for fringes in pattern.sets]
    strength = float(np.median(np.median(fit.modulation / np.sqrt(noise.variance(fit.offset)), axis=1) / scatter))
    # Noise alone gives 1.2 (the median of a Rayleigh distribution), up to 1.6 for the pixels that vary most.
    if strength < 2.0:
        return [*faults, _no_fringes(f"the modulation is {strength:.2g} times what the noise of a reading makes")]
    sequence = _sequence_faults(sample, pattern, noise)
    if _errors(sequence):
        known = _all_late(sample, pattern, noise, sequence) or _other_pattern(sample, pattern, noise, sequence)
        return [*faults, *(known or sequence)]
    gamma = list(check_gamma(sample, fit, pattern, noise))
    # Harmonics change a frame's mean light by a few per cent, which is no flicker.
    faults += ([] if response_helps(sample, fit, pattern, noise) else gamma) if gamma else sequence
    faults += check_modulation(fit, pattern, noise)
    if response is not None:
        faults += check_response(sample, pattern)
    return faults


def _errors(faults: list[FrameFault]) -> list[FrameFault]:
    return [fault for fault in faults if fault.severity == "error"]


def _sequence_faults(sample: FrameSample, pattern: FringePattern, noise: NoiseModel) -> list[FrameFault]:
    """Check the steps and what each frame shows."""
    wrong_steps, true_pattern = _steps_within_sets(sample, pattern)
    content = _check_content(sample, fit_sets(sample.light, true_pattern), true_pattern, noise)
    return [*wrong_steps, *content]


def _frame_count(given: int, pattern: FringePattern) -> FrameFault:
    return FrameFault(
        FaultKind.FRAME_COUNT,
        (),
        f"{given} frames were given, the pattern has {pattern.n_frames} in {len(pattern.sets)} sets; "
        "check that no image is missing and that [[pattern.set]] lists all periods and steps",
    )


def _no_fringes(seen: str) -> FrameFault:
    return FrameFault(
        FaultKind.LOW_MODULATION,
        (),
        f"no fringes found: {seen}; check that the mirror is in view, that it shows the display, the exposure, and the "
        "order of the images against [[pattern.set]]",
    )


def _rounding_variance(sample: FrameSample, dtype: np.dtype[Any], response: LightResponse | None) -> float:
    """Return the variance that rounding to whole DN leaves in linear light."""
    if dtype.kind not in "ui":
        return 1e-12
    slope = 1.0 if response is None else float(np.median(response.slope(sample.readings)))
    return QUANTISATION_VARIANCE_DN2 * slope**2


def light_noise(
    sample: FrameSample, pattern: FringePattern, dtype: np.dtype[Any], response: LightResponse | None
) -> NoiseModel:
    """Estimate the noise of linear light, pooled; a few spoilt sets do not move it."""
    floor = _rounding_variance(sample, dtype, response)
    solvers = [solve_steps(fringes.steps_rad) for fringes in pattern.sets]
    if all(solver.redundancy == 0 for solver in solvers):
        # Three frames leave nothing: the spread of the sets' offsets stands in (its median resists spoilt sets).
        offsets = fit_sets(sample.light, pattern).offset
        spread = robust_scale(offsets - np.median(offsets, axis=0))
        return NoiseModel(max(math.sqrt(3.0) * spread, math.sqrt(floor)))
    pooled = estimate_noise(sample.light, solvers, floor_dn2=floor)
    # A frame of noise spoils the pool: the usual set stands for all where most are quieter by far.
    level = np.full(1, float(np.median(sample.light)))
    single = [
        estimate_noise(sample.light[position], [solver], floor_dn2=floor)
        for solver, position in zip(solvers, pattern.frame_slices, strict=True)
        if solver.redundancy
    ]
    usual = sorted(single, key=lambda one: float(one.variance(level)[0]))[len(single) // 2]
    return usual if float(pooled.variance(level)[0]) > _SPOILT_POOL**2 * float(usual.variance(level)[0]) else pooled


def _check_content(sample: FrameSample, fit: SetFit, pattern: FringePattern, noise: NoiseModel) -> Iterator[FrameFault]:
    """Check what each frame shows against what it should."""
    groups, confused = {}, []
    for axis in Axis:
        groups[axis], contradiction = agreeing_sets(fit, pattern, axis, noise)
        if contradicts(contradiction):
            confused.append((axis, contradiction))
    repeated = dict(_repeated(sample, pattern))
    if confused:
        for first, later in repeated.items():
            yield _repeated_fault(pattern, later, first)
        axes = " and ".join(f"{axis} ({turns:.2f} turns)" for axis, turns in confused)
        yield FrameFault(
            FaultKind.SETS_DISAGREE,
            (),
            f"no two fringe sets agree on the position along {axes}; check the order of the images, the periods and "
            "the steps against what was displayed",
        )
        return
    content = frame_content(sample.light, fit, pattern, groups, noise)
    lost = tuple(frame for frame in range(pattern.n_frames) if _shown(content, pattern, frame) is None)
    if len(lost) > max(2, pattern.n_frames // 6):
        yield FrameFault(
            FaultKind.SETS_DISAGREE,
            lost,
            f"frames {', '.join(map(str, lost))} do not show the fringes that the others lead to expect; check their "
            "periods and steps, and that the camera resolves the finest fringes; with three steps also the linearity "
            "of the display (a gamma disturbs their phase)",
        )
        return
    named: set[int] = set()
    for fault in _misplaced(content, pattern, repeated):
        named.update(fault.frames)
        yield fault
    for fault in _corrupt(content, pattern, named):
        named.update(fault.frames)
        yield fault
    for fault in _blurred(content, pattern, named):
        named.update(fault.frames)
        yield fault
    yield from _wrong_steps(content, fit, pattern, groups, named)
    if not named:
        yield from check_exposure(content, pattern)


def _repeated(sample: FrameSample, pattern: FringePattern) -> Iterator[tuple[int, int]]:
    """Yield (later, earlier) frames whose readings are the same in every pixel looked at."""
    seen: dict[bytes, int] = {}
    for index, frame in enumerate(sample.raw):
        key = np.ascontiguousarray(frame).tobytes()
        if key in seen and _label(pattern, index) != _label(pattern, seen[key]):
            yield index, seen[key]
        seen.setdefault(key, index)


def _label(pattern: FringePattern, index: int) -> str:
    """Return what a frame should show; the same for frames that are meant to be the same."""
    for fringes, position in zip(pattern.sets, pattern.frame_slices, strict=True):
        if position.start <= index < position.stop:
            step = float(fringes.steps_rad[index - position.start] % (2 * np.pi))
            return f"{fringes.axis} {fringes.periods} {round(step, 6)}"
    return ""


def _repeated_fault(pattern: FringePattern, earlier: int, later: int, wrong: int | None = None) -> FrameFault:
    """Say that two images are one; `wrong` is the frame that it is not of."""
    remedy = None if wrong is None else Remedy(shows={wrong: earlier if wrong == later else later})
    return FrameFault(
        FaultKind.REPEATED,
        (earlier, later),
        f"{pattern.describe_frame(later)} is identical to frame {earlier} in every pixel looked at: the same image was "
        "stored twice; take the sequence again",
        remedy=remedy,
    )


def _all_late(
    sample: FrameSample, pattern: FringePattern, noise: NoiseModel, seen: list[FrameFault]
) -> list[FrameFault]:
    """Return one fault instead of many if the sequence fits once it is moved by one frame."""
    if len({frame for fault in seen for frame in fault.frames}) < 3 and seen[-1].frames:
        return []
    last = pattern.n_frames - 1
    for shift, edge, word in ((-1, last, "late"), (1, 0, "early")):
        light, raw = np.roll(sample.light, shift, axis=0), np.roll(sample.raw, shift, axis=0)
        moved = _sequence_faults(FrameSample(sample.readings, light, raw), pattern, noise)
        errors = _errors(moved)
        shows: dict[int, int | None] = {k: (k + shift) % (last + 1) for k in range(last + 1)}
        if errors:
            shows[last - edge] = None
        # The frame that the move brings round from the other end is wrong for sure; nothing else may be.
        if all(edge in fault.frames and len(fault.frames) <= 2 for fault in errors):
            return [
                FrameFault(
                    FaultKind.STALE,
                    tuple(range(pattern.n_frames)),
                    f"every frame comes one step too {word}: the sequence fits the pattern when moved by one frame; "
                    "wait longer between display and exposure, or check for a missing first image",
                    remedy=Remedy(shows=shows),
                )
            ]
    return []


def _other_pattern(
    sample: FrameSample, pattern: FringePattern, noise: NoiseModel, seen: list[FrameFault]
) -> list[FrameFault]:
    """Return one fault instead of many if the sequence fits a pattern that is often displayed by mistake."""
    if len({frame for fault in seen for frame in fault.frames}) < 3 and seen[-1].frames:
        return []
    if all(fault.kind is FaultKind.WRONG_STEP for fault in seen):
        # Each set has its measured steps already.
        return []
    for name, sets in _mistaken_patterns(pattern):
        moved = _sequence_faults(sample, FringePattern(sets), noise)
        if _errors(moved):
            continue
        frames = tuple(range(pattern.n_frames))
        exchanged = any(one.axis is not other.axis for one, other in zip(sets, pattern.sets, strict=True))
        steps = ", ".join(f"{math.degrees(value):g}" for value in sets[0].steps_rad)
        return [
            FrameFault(
                FaultKind.WRONG_STEP,
                frames,
                f"frames 0 to {frames[-1]} do not show the pattern of measurement.toml, but fit one with {name} (first "
                f"set: {sets[0].axis} fringes, {sets[0].periods:g} periods, steps {steps} deg); write into "
                "[[pattern.set]] what was displayed",
                # Whether axes are exchanged is for the user to say: both give a surface.
                remedy=None if exchanged else Remedy(pattern=FringePattern(sets)),
            )
        ]
    return []


def _mistaken_patterns(pattern: FringePattern) -> Iterator[tuple[str, tuple[FringeSet, ...]]]:
    """Yield patterns that are easily taken for the planned one, and what differs in them."""
    other = {Axis.X: Axis.Y, Axis.Y: Axis.X}
    yield "x and y fringes exchanged", tuple(replace(one, axis=other[one.axis]) for one in pattern.sets)
    yield "steps of the opposite sign", tuple(replace(one, steps_rad=-one.steps_rad) for one in pattern.sets)
    # n steps made n - 1 or n + 1 of a turn: the fence-post error.
    for off in (-1, 1):
        scaled = [one.steps_rad * (one.n_frames / (one.n_frames + off)) for one in pattern.sets]
        name = f"steps {'larger' if off < 0 else 'smaller'} than planned"
        sets = zip(pattern.sets, scaled, strict=True)
        yield name, tuple(replace(one, steps_rad=steps) for one, steps in sets)


def shorten_faults(faults: list[FrameFault], most: int = 4) -> list[FrameFault]:
    """Return the first faults and one for all the others: so many have a common cause."""
    errors = _errors(faults)
    if len(errors) <= most or all(fault.kind is FaultKind.WRONG_STEP for fault in errors):
        return faults
    frames = tuple(sorted({frame for fault in errors for frame in fault.frames}))
    listed = ", ".join(map(str, frames))
    rest = FrameFault(
        FaultKind.SETS_DISAGREE,
        frames,
        f"in all frames {listed} are concerned: probably the order of the images, or the axes, periods and steps of "
        "[[pattern.set]], are not what was displayed",
    )
    return [*(fault for fault in faults if fault.severity != "error"), *errors[:most], rest]


def _misplaced(content: FrameContent, pattern: FringePattern, repeated: dict[int, int]) -> Iterator[FrameFault]:
    """Yield faults of frames that show another frame's content."""
    shown = {k: found for k in range(pattern.n_frames) if (found := _shown(content, pattern, k)) != k}
    usual = float(np.median(content.spoilt_share))
    done: set[int] = set()
    for frame, source in shown.items():
        if frame in done or source is None:
            continue
        same_set = any(one.start <= frame < one.stop and one.start <= source < one.stop for one in pattern.frame_slices)
        # Whatever its step, fringes of its own set would fit everywhere: a part of this frame is damaged.
        if same_set and frame not in repeated and content.spoilt_share[frame] > usual + 0.1:
            continue
        own, other = pattern.describe_frame(frame), pattern.describe_frame(source)
        if frame in repeated:
            yield _repeated_fault(pattern, repeated[frame], frame, frame)
        elif repeated.get(source) == frame:
            # The earlier of two identical frames shows the later one's content: the later image overwrote it.
            yield _repeated_fault(pattern, frame, source, frame)
        elif shown.get(source) == frame:
            done.add(source)
            text = f"{own} and {other} show each other's fringes; exchange them"
            remedy = Remedy(shows={frame: source, source: frame})
            yield FrameFault(FaultKind.SWAPPED, (frame, source), text, remedy=remedy)
        elif source < frame:
            text = f"{own} still shows {other}; wait longer between display and exposure and take the sequence again"
            yield FrameFault(FaultKind.STALE, (frame,), text, remedy=Remedy(shows={frame: source}))
        else:
            text = f"{own} shows what belongs to {other}; check the order of the images"
            yield FrameFault(FaultKind.SWAPPED, (frame, source), text, remedy=Remedy(shows={frame: source}))
        done.add(frame)


def _shown(content: FrameContent, pattern: FringePattern, frame: int) -> int | None:
    """Return the frame whose fringes a frame shows: itself when all is well, None when nothing fits."""
    own = next(j for j, position in enumerate(pattern.frame_slices) if position.start <= frame < position.stop)
    steps = pattern.sets[own].steps_rad
    nearest = (np.abs(wrap_phase(steps[:, None] - steps[None, :])) + 10 * np.eye(len(steps))).min()
    # Half of the misfit that the nearest other step would have.
    if content.planned_misfit[frame] < min(0.35, math.sin(min(nearest, math.pi) / 2)):
        return frame
    places = enumerate(pattern.frame_slices)
    usual = float(np.median([content.explained[k, j] for j, place in places for k in range(place.start, place.stop)]))
    best = int(np.argmax(content.explained[frame]))
    if content.explained[frame, own] > content.explained[frame, best] - 0.1:
        best = own
    if content.explained[frame, best] < 0.35 * usual:
        return None
    steps = pattern.sets[best].steps_rad
    away = np.abs(wrap_phase(content.step_rad[frame, best] - steps))
    gaps = np.abs(wrap_phase(steps[:, None] - steps[None, :])) + 10 * np.eye(len(steps))
    tolerance = 0.4 * gaps.min() + 4 * content.sigma_step_rad[frame, own]
    if best == own and away[frame - pattern.frame_slices[own].start] < tolerance:
        return frame
    return int(pattern.frame_slices[best].start + np.argmin(away))


def _corrupt(content: FrameContent, pattern: FringePattern, named: set[int]) -> Iterator[FrameFault]:
    """Yield faults of frames that fit nothing, wholly or in part."""
    usual = float(np.median(content.spoilt_share))
    # Exchanged frames spoil the positions by which their neighbours are judged: then only whole misfits are named.
    misplaced = bool(named)
    for frame in range(pattern.n_frames):
        if frame in named:
            continue
        whole = _shown(content, pattern, frame) is None
        if whole:
            seen = f"shows no fringes of this pattern (best match explains {content.explained[frame].max():.0%} of it)"
        elif not misplaced and content.spoilt_share[frame] > usual + 0.03:
            seen = f"does not fit in {content.spoilt_share[frame]:.0%} of the pixels ({usual:.1%} is usual here)"
        else:
            continue
        text = f"{pattern.describe_frame(frame)} {seen}: a damaged or obstructed image; take it again"
        remedy = Remedy(shows={frame: None}) if whole else None
        yield FrameFault(FaultKind.CORRUPT, (frame,), text, remedy=remedy)


def _blurred(content: FrameContent, pattern: FringePattern, named: set[int]) -> Iterator[FrameFault]:
    """Yield faults of frames whose fringes are weaker or stronger than those of the rest of their set."""
    for position in pattern.frame_slices:
        frames = list(range(position.start, position.stop))
        if named.intersection(frames):
            continue
        # More or less of all light is no blur: the mean light follows it.
        for against in (np.ones(len(content.contrast)), content.exposure):
            ratio = content.contrast[position] / against[position]
            ratio = ratio / np.median(ratio)
            odd = np.abs(ratio - 1) > _CONTRAST_TOLERANCE
            frames = [k for k in frames if odd[k - position.start]]
        for frame in frames:
            share = float(ratio[frame - position.start])
            text = (
                f"{pattern.describe_frame(frame)} has {share:.0%} of the contrast of the other frames of its set: "
                "blurred by a movement or a change of focus, or shown at another level; take it again"
            )
            yield FrameFault(FaultKind.CORRUPT, (frame,), text, remedy=Remedy(shows={frame: None}))


def _differs(found: StepEstimate, planned: FloatArray, *, flicker: float = 0.0) -> bool:
    """Return whether steps differ from the planned ones by more than noise and more than matters."""
    limit = _STEP_TOLERANCE_RAD + flicker + SIGNIFICANT * found.sigma_rad
    return bool((np.abs(found.steps_rad - planned) > limit).any())


def _even(found: StepEstimate) -> bool:
    """Return whether steps are as far apart as displays show them: evenly, but for noise and what does not matter."""
    order = np.arange(len(found.steps_rad))
    uneven = np.abs(found.steps_rad - np.polyval(np.polyfit(order, found.steps_rad, 1), order)).max()
    return bool(uneven < _STEP_TOLERANCE_RAD + SIGNIFICANT * found.sigma_rad.max())


def _steps_within_sets(sample: FrameSample, pattern: FringePattern) -> tuple[list[FrameFault], FringePattern]:
    """Find steps that are wrong but even, in sets of five frames and more; return the faults and the true pattern."""
    faults, sets = [], list(pattern.sets)
    for index, (fringes, position) in enumerate(zip(pattern.sets, pattern.frame_slices, strict=True)):
        planned = fringes.steps_rad
        if len(planned) < 5:
            continue
        found = estimate_steps(sample.light[position], planned)
        away = found.steps_rad - planned
        uneven = np.abs(away - np.polyval(np.polyfit(planned, away, 1), planned)).max()
        # Swapped or spoilt frames make uneven steps; what they show is found later and named for each frame.
        even = uneven < max(0.1 * np.abs(away).max(), SIGNIFICANT * found.sigma_rad.max())
        if even and _differs(found, planned):
            faults.append(_step_fault(pattern, index, tuple(range(position.start, position.stop)), found))
            sets[index] = FringeSet(fringes.axis, fringes.periods, found.steps_rad)
    return faults, FringePattern(tuple(sets))


def _wrong_steps(
    content: FrameContent,
    fit: SetFit,
    pattern: FringePattern,
    groups: dict[Axis, tuple[int, ...]],
    named: set[int],
) -> Iterator[FrameFault]:
    """Yield faults of sets whose steps differ from the planned ones, judged by the finer sets of the axis."""
    for index, (fringes, position) in enumerate(zip(pattern.sets, pattern.frame_slices, strict=True)):
        frames = tuple(range(position.start, position.stop))
        if named.intersection(frames):
            continue
        planned = fringes.steps_rad
        finest = max(pattern.sets[i].periods for i in groups[fringes.axis])
        if fringes.periods >= finest:
            continue
        away = wrap_phase(content.step_rad[position, index] - planned)
        found = StepEstimate(planned + away - away[0], np.sqrt(2.0) * content.sigma_step_rad[position, index])
        # A change of light by a share e moves a step by up to e a / b: that much is flicker, named elsewhere.
        contrast = float(np.median(fit.offset[index]) / np.median(fit.modulation[index]))
        if _differs(found, planned, flicker=float(np.ptp(content.exposure[position])) * contrast):
            yield _step_fault(pattern, index, frames, found)


def _step_fault(pattern: FringePattern, index: int, frames: tuple[int, ...], found: StepEstimate) -> FrameFault:
    """Say which steps were found."""
    fringes, steps, sigma = pattern.sets[index], found.steps_rad, found.sigma_rad
    order = np.arange(len(steps)) - (len(steps) - 1) / 2
    per_step = math.degrees(float(order @ steps / (order @ order)))
    planned = math.degrees(float(order @ fringes.steps_rad / (order @ order)))
    error = math.degrees(float(np.max(sigma)) / math.sqrt(2.0 * float(order @ order)))
    worst = int(np.argmax(np.abs(steps - fringes.steps_rad)))
    listed = ", ".join(f"{value:.2f}" for value in np.degrees(steps))
    return FrameFault(
        FaultKind.WRONG_STEP,
        frames,
        f"frames {frames[0]} to {frames[-1]} ({fringes.axis} fringes, {fringes.periods:g} periods): the steps are "
        f"{per_step:.3f} +- {max(error, 5e-4):.3f} deg (360 deg / {360 / per_step:.3f}), not {planned:.3f} deg; frame "
        f"{frames[worst]} is {math.degrees(float(steps[worst] - fringes.steps_rad[worst])):+.2f} deg off; "
        + (
            f"write the true steps into [[pattern.set]]: steps_deg = [{listed}]"
            if _even(found)
            else f"these steps ({listed} deg) are uneven, which displays hardly show: light that changes from frame to "
            "frame makes such; switch room light and automatic exposure off, and take the sequence again"
        ),
        # Five frames and more tell their steps alone; fewer lean on a finer set, which may be wrong itself.
        remedy=Remedy(steps_rad={index: found.steps_rad}) if len(steps) >= 5 else None,
    )
