"""Sequences with faults are used as far as they go: frames left out, put in order, moved back, steps as they were."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from deflectometry.frames.frame_content import fit_sets
from deflectometry.frames.frame_model import FrameModel, Oddity, OddityKind, estimate_frames
from deflectometry.frames.light_checks import FaultKind, FrameFault, saturation_limit
from deflectometry.frames.sequence_checks import SampledFrames, check_sampled
from deflectometry.frames.set_motion import moved_sets
from deflectometry.fringes.fringe_orders import search_orders
from deflectometry.fringes.phase import TURN_RAD, LightResponse, StepSolver, linear_light, solve_steps
from deflectometry.setup.patterns import Axis, FringePattern, FringeSet, determines_phase
from heliogauge.doubts import Doubt
from heliogauge.errors import EstimationError
from heliogauge.validate import FloatArray

#: Repairs after one another: each takes away what hid the next.
_MOST_REPAIRS = 8
#: Kinds of faults in one sequence that are mended: more have another cause than each repair supposes.
_MOST_KINDS = 3
#: Amplitude below which noise alone passes for fringes once in a million, over the noise of an amplitude.
_NO_FRINGES = 5.26
#: Misfit of a set, over the usual one, from which a single frame of it is looked for that moved; and pixels for it.
_MISFIT_OF_ONE, _MISFIT_PIXELS = 1.5, 20_000
#: Of that misfit at most this share is left with the right frame moved back; any other one makes it larger.
_MENDED_MISFIT = 0.75
#: Rounds in which a motion is found: each leaves a tenth of the last.
_MOTION_ROUNDS = 4
#: Sigma beyond which a set that stands elsewhere is said to have other periods; both are used in any case.
_OTHER_PERIODS = 3.0
#: What keeps the light the same from frame to frame.
_STEADY_LIGHT = "lock the exposure, let the display warm up, expose for whole refresh periods"
#: Faults that say where a frame's content belongs.
_MISPLACED = (FaultKind.REPEATED, FaultKind.STALE, FaultKind.SWAPPED, FaultKind.CORRUPT)


@dataclass(frozen=True, slots=True, eq=False)
class RepairedFrames:
    """A sequence as it can be used.

    frames (m, h, w): The frames kept, in the order of the pattern; the very ones given where nothing was changed [DN].
    pattern: What they show.
    faults: What is left that cannot be mended (severity "error"), or is only doubtful.
    repairs: What was done.
    sigma_periods (2,): Relative standard deviations of the scale of u and of v where periods were estimated.
    found: Errors before anything was mended.
    """

    frames: npt.NDArray[Any]
    pattern: FringePattern
    faults: tuple[FrameFault, ...]
    found: tuple[FrameFault, ...] = ()
    repairs: tuple[Doubt, ...] = ()
    sigma_periods: FloatArray = field(default_factory=lambda: np.zeros(2))

    @property
    def errors(self) -> tuple[FrameFault, ...]:
        """Faults that make the result wrong."""
        return tuple(fault for fault in self.faults if fault.severity == "error")


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """A sequence on the way: frames with their sample, pattern, and which image each frame was."""

    pattern: FringePattern
    numbers: tuple[int, ...]
    original: FringePattern
    sampled: SampledFrames
    repairs: tuple[Doubt, ...] = ()
    sigma_periods: FloatArray = field(default_factory=lambda: np.zeros(2))
    stands_still: bool = False

    @property
    def frames(self) -> npt.NDArray[Any]:
        """The frames, shape (n, h, w) [DN]."""
        return self.sampled.frames

    @property
    def response(self) -> LightResponse | None:
        """Makes readings linear."""
        return self.sampled.response

    def with_frames(self, frames: npt.NDArray[Any], **changes: Any) -> "_State":
        """Return the sequence with other frames."""
        sampled = SampledFrames(frames, self.response, self.sampled.saturation_dn)
        return replace(self, sampled=sampled, **changes)

    def describe(self, frame: int) -> str:
        """Say which frame of the measurement this one is."""
        return self.original.describe_frame(self.numbers[frame])

    def listed(self, frames: Sequence[int]) -> str:
        """Name frames by their numbers in the measurement."""
        numbers = [self.numbers[frame] for frame in frames]
        if len(numbers) == 1:
            return self.describe(frames[0])
        if len(numbers) > 3 and numbers == list(range(numbers[0], numbers[-1] + 1)):
            return f"frames {numbers[0]} to {numbers[-1]}"
        return f"frames {', '.join(map(str, numbers))}"

    def in_whole_sets(self, frames: Sequence[int]) -> bool:
        """Return whether these are all frames of one set or more, which a wrong number of periods has in common."""
        wholes = [set(range(*one.indices(self.pattern.n_frames))) for one in self.pattern.frame_slices]
        return set(frames) == set().union(*(one for one in wholes if one <= set(frames)))

    def with_doubt(self, doubt: Doubt, **changes: Any) -> "_State":
        """Return the sequence after a repair."""
        return replace(self, repairs=(*self.repairs, doubt), **changes)


def repair_frames(
    frames: npt.NDArray[Any],
    pattern: FringePattern,
    *,
    response: LightResponse | None = None,
    saturation_dn: float = math.inf,
) -> RepairedFrames:
    """Find faults of a sequence and mend what can be mended without a guess.

    frames (n, h, w): Frames in the order of the pattern [DN].
    pattern: What should have been shown.
    response: Makes readings linear in the display's level.

    Frames that show nothing of use are left out while the rest determines all phases; frames in another order are put
    right where every frame names one place; steps, places and periods of a set, offsets, gains and shifts of frames are
    estimated (`deflectometry.frames.frame_model`) and used. Every repair is a doubt. What is left as an error is not
    mended, and then nothing is.
    """
    given = _State(pattern, tuple(range(len(frames))), pattern, SampledFrames(frames, response, saturation_dn))
    first = check_sampled(given.sampled, pattern)
    state = _without_unresolved(given)
    faults = first if state is given else check_sampled(state.sampled, state.pattern)
    for _ in range(_MOST_REPAIRS):
        errors = [fault for fault in faults if fault.severity == "error"]
        if any(fault.kind in (FaultKind.FRAME_COUNT, FaultKind.NOT_FINITE, FaultKind.SATURATION) for fault in errors):
            break
        mended = _mended(state, errors)
        if mended is None:
            break
        state = mended
        faults = check_sampled(state.sampled, state.pattern)
    else:
        faults = [*faults, _cascade(state)]
    if len({doubt.code for doubt in state.repairs}) > _MOST_KINDS:
        faults = [*faults, _cascade(state)]
    found = tuple(fault for fault in first if fault.severity == "error")
    if any(fault.severity == "error" for fault in faults):
        given_up = tuple(fault for fault in faults if fault.kind is FaultKind.CASCADE)
        return RepairedFrames(frames, pattern, given_up + (found or tuple(faults)), found)
    return RepairedFrames(state.frames, state.pattern, tuple(faults), found, state.repairs, state.sigma_periods)


def _cascade(state: _State) -> FrameFault:
    """Say that so much had to be mended that no repair can be believed."""
    said = "; ".join(doubt.text.split(". ")[0] for doubt in state.repairs[: _MOST_KINDS + 1])
    return FrameFault(
        FaultKind.CASCADE,
        (),
        f"more is wrong with the frames than can be told apart, and {len(state.repairs)} repairs one after another are "
        f"no measurement ({said}): take the sequence again, and check order, steps and periods of [[pattern.set]]",
    )


def _mended(state: _State, errors: list[FrameFault]) -> _State | None:
    """Return the sequence after the next repair; None where there is nothing to mend, or no way to."""
    shows: dict[int, int | None] = {}
    for fault in errors:
        if fault.kind in _MISPLACED and fault.remedy is not None:
            shows.update(fault.remedy.shows)
    if shows and state.stands_still:
        # What was moved back and then seems to be in another order was not moved by that.
        return None
    if shows:
        return _reordered(state, shows, [fault for fault in errors if fault.kind in _MISPLACED])
    pattern = next((fault.remedy.pattern for fault in errors if fault.remedy and fault.remedy.pattern), None)
    if pattern is not None:
        return state.with_doubt(_pattern_doubt(state, pattern, errors[0]), pattern=pattern)
    model = None
    spoilt = [frame for fault in errors if fault.kind is FaultKind.CORRUPT for frame in fault.frames]
    if not any(fault.kind is FaultKind.LOW_MODULATION for fault in errors):
        # A set that moved as a whole agrees with itself; a damaged frame spoils the mean light of its set alone.
        still = None if state.stands_still else _standing_still(state, knocked=bool(spoilt))
        if still is not None:
            return still
        model = _modelled(state)
    if model is not None and model.oddities:
        return _with_model(state, model)
    steps: dict[int, FloatArray] = {}
    for fault in errors:
        if fault.remedy is not None:
            steps.update(fault.remedy.steps_rad)
    if steps:
        return _with_steps(state, steps, errors)
    if spoilt:
        return _left_out(state, spoilt, "not as the other frames in a part of the pixels")
    return None


# --- frames left out, frames put in order ---------------------------------------------------------------------------


def _without_unresolved(state: _State) -> _State:
    """Leave out sets whose fringes are too fine for camera or display: noise makes as much modulation."""
    pattern = state.pattern
    if len(state.frames) != pattern.n_frames:
        return state
    sample = state.sampled.sample
    if sample.light.shape[1] < 30 or not np.isfinite(sample.light).all():
        return state
    light = state.sampled.unsaturated.light
    if light.shape[1] < 30:
        return state
    noise = state.sampled.noise(pattern)
    fit = fit_sets(light, pattern)
    weak = []
    for index, fringes in enumerate(pattern.sets):
        least = _NO_FRINGES * np.sqrt(2.0 / fringes.n_frames * noise.variance(fit.offset[index]))
        if float(np.mean(fit.modulation[index] < least)) > 0.5:
            weak.append(index)
    if not weak or len(weak) == len(pattern.sets):
        return state
    gone = [k for index in weak for k in range(pattern.frame_slices[index].start, pattern.frame_slices[index].stop)]
    left = _without_frames(state, gone)
    if left is None:
        return state
    words = ", ".join(f"{pattern.sets[i].axis} with {pattern.sets[i].periods:g} periods" for i in weak)
    doubt = Doubt(
        "fringes_unresolved",
        f"the fringes of {words} are not resolved: their modulation is what noise makes; left out, and the sigmas are "
        "those of the coarser fringes: focus the camera nearer to the display's image, or show fewer periods",
        {"sets_count": len(weak)},
    )
    return left.with_doubt(doubt)


def _without_frames(state: _State, frames: Sequence[int]) -> _State | None:
    """Leave frames out; None where the rest does not determine every phase and order."""
    gone = set(frames)
    sets, kept = [], []
    for fringes, where in zip(state.pattern.sets, state.pattern.frame_slices, strict=True):
        inside = [k for k in range(where.start, where.stop) if k not in gone]
        steps = fringes.steps_rad[[k - where.start for k in inside]]
        if len(inside) < fringes.n_frames and not _enough(steps):
            continue
        sets.append(replace(fringes, steps_rad=steps))
        kept.extend(inside)
    for axis in Axis:
        periods = [one.periods for one in sets if one.axis is axis]
        if not periods:
            return None
        try:
            search_orders(periods)
        except EstimationError:
            return None
    numbers = tuple(state.numbers[k] for k in kept)
    return state.with_frames(state.frames[kept], pattern=FringePattern(tuple(sets)), numbers=numbers)


def _enough(steps_rad: FloatArray) -> bool:
    return len(steps_rad) >= 3 and determines_phase(steps_rad)


def _left_out(state: _State, frames: Sequence[int], why: str) -> _State | None:
    left = _without_frames(state, frames)
    if left is None:
        return None
    doubt = Doubt(
        "frames_left_out",
        f"{state.listed(sorted(frames))} left out ({why}{_or_periods(state, frames)}); the result rests on "
        f"{len(left.numbers)} of {state.original.n_frames} frames, with the sigma they have. Take the sequence again "
        "for all of it",
        {"left_out_count": len(frames), "frames_count": state.original.n_frames},
    )
    return left.with_doubt(doubt)


def _or_periods(state: _State, frames: Sequence[int]) -> str:
    """Add what a whole set that contradicts the others may have as well."""
    if not state.in_whole_sets(frames):
        return ""
    return ", or shown with another number of periods than [[pattern.set]] says"


_WHY = {
    FaultKind.REPEATED: "another frame's image again",
    FaultKind.STALE: "another frame's fringes still",
    FaultKind.SWAPPED: "another frame's fringes",
    FaultKind.CORRUPT: "damaged or obstructed",
}


def _reordered(state: _State, shows: Mapping[int, int | None], faults: list[FrameFault]) -> _State | None:
    """Put frames where their content belongs; leave out what has no place, and what has two."""
    n = state.pattern.n_frames
    # Image of each frame's content; a frame that shows itself keeps its place, whoever else shows it too.
    source = {k: k for k in range(n) if k not in shows}
    claims: dict[int, list[int]] = {}
    for image, frame in shows.items():
        if frame is not None and frame not in source:
            claims.setdefault(frame, []).append(image)
    moved = {frame: images[0] for frame, images in claims.items() if len(images) == 1}
    lost = [k for k in range(n) if k not in source and k not in moved]
    order = [source.get(k, moved.get(k, k)) for k in range(n)]
    result = state
    if moved:
        frames = sorted(moved)
        doubt = Doubt(
            "frames_reordered",
            f"{state.listed(frames)} show each other's fringes (image {state.numbers[moved[frames[0]]]} belongs to "
            f"frame {state.numbers[frames[0]]}){_or_periods(state, frames)}: put into the order of the pattern; "
            "check how the images were named",
            {"moved_count": len(frames), "frames_count": state.original.n_frames},
        )
        # Names stay those of the frames that the content belongs to.
        result = state.with_frames(state.frames[order]).with_doubt(doubt)
    if lost:
        kind = next((one.kind for one in faults if set(one.frames) & set(lost)), FaultKind.CORRUPT)
        return _left_out(result, lost, _WHY.get(kind, "damaged"))
    return result


# --- steps ----------------------------------------------------------------------------------------------------------


def _steps_doubt(text: str, numbers: Mapping[str, float]) -> Doubt:
    return Doubt("fringe_steps_corrected", text, numbers)


def _light_doubt(text: str, numbers: Mapping[str, float]) -> Doubt:
    return Doubt("frame_light_corrected", text, numbers)


def _moved_doubt(text: str, shift_px: FloatArray) -> Doubt:
    return Doubt("frames_moved", text, {"shift_x_px": float(shift_px[0]), "shift_y_px": float(shift_px[1])})


def _pattern_doubt(state: _State, pattern: FringePattern, fault: FrameFault) -> Doubt:
    ratio = float(pattern.sets[0].steps_rad[1] / state.pattern.sets[0].steps_rad[1])
    return _steps_doubt(
        f"{fault.message}. That pattern was used",
        {"steps_ratio": ratio},
    )


def _with_steps(state: _State, steps: Mapping[int, FloatArray], errors: list[FrameFault]) -> _State:
    sets = [
        replace(one, steps_rad=steps[index]) if index in steps else one for index, one in enumerate(state.pattern.sets)
    ]
    said = next(fault.message for fault in errors if fault.remedy is not None and fault.remedy.steps_rad)
    ratio = max((float(steps[i][-1] / state.pattern.sets[i].steps_rad[-1]) for i in steps), key=lambda r: abs(r - 1))
    more = f"; so in {len(steps)} sets" if len(steps) > 1 else ""
    doubt = _steps_doubt(f"{said}{more}. The steps found were used", {"steps_ratio": ratio})
    return state.with_doubt(doubt, pattern=FringePattern(tuple(sets)))


# --- sets that moved ------------------------------------------------------------------------------------------------


def _standing_still(state: _State, *, knocked: bool) -> _State | None:
    """Move sets back to where the others are, by the edges of their mean light; None where none has moved.

    knocked: Only where several sets have moved alike.
    """
    first = moved_sets(state.frames, state.pattern)
    if not first or (knocked and not _alike(first)):
        return None
    single = _single_frame_moved(state, first)
    if single is not None:
        return single
    total, frames, found = np.zeros((len(state.pattern.sets), 2)), state.frames, first
    # The shift is found linearly, a tenth too long at half a pixel: from where that has put the sets, again.
    for _ in range(_MOTION_ROUNDS):
        for number, (shift, _) in found.items():
            total[number] += shift
        frames = state.frames.astype(np.float32)
        for number, where in enumerate(state.pattern.frame_slices):
            if total[number].any():
                for k in range(where.start, where.stop):
                    frames[k] = _moved(frames[k], -total[number])
        found = moved_sets(frames, state.pattern)
        if not found:
            break
    sets = sorted(first)
    farthest = max(sets, key=lambda number: float(np.hypot(*total[number])))
    frames_of = [k for number in sets for k in range(*state.pattern.frame_slices[number].indices(len(frames)))]
    text = (
        f"{state.listed(frames_of)}: the edges of the mirror are up to ({total[farthest][0]:+.3f}, "
        f"{total[farthest][1]:+.3f}) px from where the other sets have them; moved back. Camera or mirror moved "
        "between the sets: fix both, and take the sequence again"
    )
    doubt = _moved_doubt(text, total[farthest])
    return state.with_frames(frames).with_doubt(doubt, stands_still=True)


def _moved(frame_dn: npt.NDArray[np.float32], shift_px: FloatArray) -> npt.NDArray[np.float32]:
    """Move a frame (h, w) by a shift (2,), x and y [px], with splines of the fifth order."""
    # Few measurements have a frame that moved; loading ndimage takes a sixth of a small one's time.
    from scipy import ndimage

    moved: npt.NDArray[np.float32] = ndimage.shift(frame_dn, shift_px[::-1], order=5, mode="nearest")
    return moved


def _alike(moved: Mapping[int, FloatArray]) -> bool:
    """Return whether several sets have moved by the same, within a tenth of it."""
    shifts = np.array([one[0] for one in moved.values()])
    spread = np.abs(shifts - np.median(shifts, axis=0)).max()
    return len(shifts) > 1 and bool(spread < 0.1 * np.hypot(*np.median(shifts, axis=0)))


def _single_frame_moved(state: _State, moved: Mapping[int, FloatArray]) -> _State | None:
    """Move one frame back that alone has moved its set's mean light; None where the sets moved as a whole.

    The mean light of a set of n frames moves by an n-th of what one of its frames does, and that frame no longer fits
    the others: of all frames of the set, the one is moved back by n times as much that then fits best.
    """
    solvers = [solve_steps(one.steps_rad) for one in state.pattern.sets]
    places = state.pattern.frame_slices
    shares = [
        _misfit(state, state.frames[where].astype(np.float32), solver)
        for where, solver in zip(places, solvers, strict=True)
    ]
    usual = float(np.median(shares))
    for number in sorted(moved, key=lambda one: -shares[one]):
        where, solver = places[number], solvers[number]
        if solver.redundancy == 0 or shares[number] < _MISFIT_OF_ONE * usual:
            continue
        images = state.frames[where].astype(np.float32)

        def misfit(k: int, shift_px: FloatArray, images: npt.NDArray[np.float32], solver: StepSolver) -> float:
            back = images.copy()
            back[k] = _moved(images[k], -shift_px)
            return _misfit(state, back, solver)

        # The shift of mean light is found linearly, up to a quarter too long.
        total = 0.8 * len(images) * moved[number][0]
        tried = [misfit(k, total, images, solver) for k in range(len(images))]
        best = int(np.argmin(tried))
        if tried[best] > _MENDED_MISFIT * shares[number]:
            return None
        # The squared misfit is a parabola about the true shift.
        for axis in (0, 1, 0, 1):
            step = 0.1 * np.eye(2)[axis]
            low, here, high = (misfit(best, total + sign * step, images, solver) ** 2 for sign in (-1, 0, 1))
            total = total + step * float(np.clip(0.5 * (low - high) / max(low + high - 2 * here, 1e-12), -3, 3))
        frames = state.frames.astype(np.float32)
        frame = where.start + best
        frames[frame] = _moved(images[best], -total)
        text = (
            f"{state.describe(frame)}: moved by ({total[0]:+.3f}, {total[1]:+.3f}) px against the others; moved back. "
            "The camera or the mirror moved: fix both"
        )
        return state.with_frames(frames).with_doubt(_moved_doubt(text, total))
    return None


def _misfit(state: _State, frames: npt.NDArray[np.float32], solver: StepSolver) -> float:
    """Return the residual of a set over its modulation, RMS over pixels with fringes: edges show most of a motion."""
    stride = max(1, math.isqrt(frames[0].size // _MISFIT_PIXELS))
    light, _ = linear_light(frames[:, ::stride, ::stride].reshape(len(frames), -1).astype(np.float64), state.response)
    power = ((solver.estimate[1:] @ light) ** 2).sum(axis=0)
    lit = power > 0.1 * np.quantile(power, 0.99)
    left = ((solver.residual @ light[:, lit]) ** 2).sum(axis=0)
    return math.sqrt(float(np.mean(left)) / max(float(np.mean(power[lit])), 1e-12))


# --- what the frames have beside their fringes ----------------------------------------------------------------------


def _modelled(state: _State) -> FrameModel | None:
    """Estimate what frames have beside their fringes, if enough pixels show them."""
    if state.sampled.sample.light.shape[1] < 100:
        return None
    limit = saturation_limit(state.frames.dtype, state.sampled.saturation_dn)
    noise = state.sampled.noise(state.pattern)
    return estimate_frames(state.frames, state.pattern, noise, response=state.response, saturation_dn=limit)


def _with_model(state: _State, model: FrameModel) -> _State | None:
    """Apply what was found: light, shifts, steps, places, periods; frames of another contrast are left out."""
    kinds = {kind: [one for one in model.oddities if one.kind is kind] for kind in OddityKind}
    blurred = sorted({frame for one in kinds[OddityKind.CONTRAST] for frame in one.frames})
    if blurred:
        # Where single frames are of another sharpness, what else they seem to have is part of it.
        return _left_out(state, blurred, "another contrast or sharpness than the rest of the set")
    if kinds[OddityKind.SCALE_OF_SET]:
        return _with_places(state, model, kinds[OddityKind.SCALE_OF_SET])
    frames = state.frames
    odd_light = bool(model.offset_dn.any() or model.gain.any())
    if odd_light or model.shift_px.any():
        frames = frames.astype(np.float32)
        for k, frame in enumerate(frames):
            if odd_light:
                frames[k] = (frame - model.offset_dn[k]) / (1 + model.gain[k])
            if model.shift_px[k].any():
                frames[k] = _moved(frames[k], model.shift_px[k])
    sets = [
        replace(one, steps_rad=one.steps_rad + model.step_rad[where])
        for one, where in zip(state.pattern.sets, state.pattern.frame_slices, strict=True)
    ]
    same = [kinds[kind] for kind in (OddityKind.OFFSET, OddityKind.GAIN) if kinds[kind]]
    others = [one for one in model.oddities if one.kind not in (OddityKind.OFFSET, OddityKind.GAIN)]
    said = (*(_say_light(state, group) for group in same), *(_say(state, one) for one in others))
    doubts = (*state.repairs, *said)
    pattern = FringePattern(tuple(sets))
    if frames is state.frames:
        return replace(state, pattern=pattern, repairs=doubts)
    return state.with_frames(frames, pattern=pattern, repairs=doubts)


def _with_places(state: _State, model: FrameModel, moved: list[Oddity]) -> _State | None:
    """Use places and periods of sets as found, where most sets of the axis agree without that."""
    sets = list(state.pattern.sets)
    sigma, doubts = state.sigma_periods.copy(), list(state.repairs)
    starts = [where.start for where in state.pattern.frame_slices]
    odd = [starts.index(one.frames[0]) for one in moved]
    for axis in Axis:
        same = [i for i, one in enumerate(sets) if one.axis is axis]
        if 2 * len(set(odd) & set(same)) >= len(same):
            return None
    for index, one in zip(odd, moved, strict=True):
        fringes, where = sets[index], state.pattern.frame_slices[index]
        scale = float(model.periods[where][0])
        # cos(2 pi P (w + scale (w - 1/2)) - s - d) has the periods P (1 + scale) and a place of its own.
        steps = fringes.steps_rad + float(model.step_rad[where][0]) + 0.5 * scale * TURN_RAD * fringes.periods
        sets[index] = FringeSet(fringes.axis, fringes.periods * (1 + scale), steps)
        doubts.append(_say(state, one))
        finest = max(other.periods for other in state.pattern.sets if other.axis is fringes.axis)
        if fringes.periods == finest:
            number = 0 if fringes.axis is Axis.X else 1
            sigma[number] = math.hypot(sigma[number], float(one.sigma[0]))
    return replace(state, pattern=FringePattern(tuple(sets)), repairs=tuple(doubts), sigma_periods=sigma)


def _say_light(state: _State, group: list[Oddity]) -> Doubt:
    """Say in one sentence which frames have light of their own, or more or less of all light."""
    where = state.listed(sorted(frame for one in group for frame in one.frames))
    largest = max(group, key=lambda one: abs(one.value[0]))
    value, sigma = largest.value[0], largest.sigma[0]
    up_to = "up to " if len(group) > 1 else ""
    if largest.kind is OddityKind.OFFSET:
        text = f"{where}: {up_to}{value:+.2f} +- {sigma:.2f} DN of light beside the fringes; taken off"
        return _light_doubt(f"{text}. Switch room light and automatic exposure off", {"offset_dn": value})
    text = f"{where}: the light is off by {up_to}{value:+.2%} +- {sigma:.2%}; divided out"
    return _light_doubt(f"{text}. For the next time: {_STEADY_LIGHT}", {"change_share": value})


def _say(state: _State, one: Oddity) -> Doubt:
    """Say what was found and used."""
    where = state.listed(one.frames)
    index = next(i for i, part in enumerate(state.pattern.frame_slices) if part.start <= one.frames[0] < part.stop)
    fringes = state.pattern.sets[index]
    of_set = f"{fringes.axis} fringes with {fringes.periods:g} periods"
    value, sigma = one.value, one.sigma
    if one.kind is OddityKind.DRIFT:
        text = f"{where}: the light drifts by {value[0]:+.2%} +- {sigma[0]:.2%}; divided out"
        return _light_doubt(f"{text}. For the next time: {_STEADY_LIGHT}", {"change_share": value[0]})
    if one.kind is OddityKind.AMBIENT:
        text = f"{where}: light beside the fringes drifts by {value[0]:+.2f} +- {sigma[0]:.2f} DN; taken off"
        return _light_doubt(
            f"{text}. Switch room light off, or measure when daylight is steady", {"offset_dn": value[0]}
        )
    if one.kind is OddityKind.FLICKER:
        rms = float(np.std([0.0, *value]))
        text = f"{where}: the light differs by {rms:.2%} RMS from frame to frame; divided out"
        return _light_doubt(f"{text}. For the next time: {_STEADY_LIGHT}", {"change_share": rms})
    if one.kind in (OddityKind.SHIFT, OddityKind.KNOCK):
        text = (
            f"{where}: moved by ({value[0]:+.3f} +- {sigma[0]:.3f}, {value[1]:+.3f} +- {sigma[1]:.3f}) px against the "
            "others; moved back. The camera or the mirror moved: fix both"
        )
        return _moved_doubt(text, value)
    if one.kind is OddityKind.SCALE_OF_SET and abs(value[0]) > _OTHER_PERIODS * sigma[0]:
        found = fringes.periods * (1 + value[0])
        text = (
            f"{of_set}: the other sets of this direction say {found:.4g} +- {fringes.periods * sigma[0]:.2g} periods; "
            "that was used. Check [[pattern.set]] and that the display shows every pixel of the pattern"
        )
        return Doubt("fringe_periods_corrected", text, {"periods_count": found, "periods_ratio": 1 + value[0]})
    if one.kind is OddityKind.SCALE_OF_SET:
        share = value[1] / (TURN_RAD * fringes.periods)
        text = (
            f"{of_set}: displayed {share:+.3%} +- {sigma[1] / (TURN_RAD * fringes.periods):.3%} of the screen beside "
            f"their place, with {1 + value[0]:.6f} +- {sigma[0]:.6f} of their periods; moved back. Check that the "
            "display shows every pattern at the same place and size"
        )
        return Doubt("fringes_displaced", text, {"displaced_share": share, "periods_ratio": 1 + value[0]})
    if one.kind is OddityKind.STEP:
        text = f"{where}: its step is {np.degrees(value[0]):+.2f} +- {np.degrees(sigma[0]):.2f} deg off; that was used"
        return _steps_doubt(text, {"step_off_rad": value[0]})
    each = math.degrees(float(np.mean(np.diff(fringes.steps_rad)))) * (1 + value[0])
    of_all = "all sets" if one.kind is OddityKind.STEPS_OF_ALL else of_set
    text = (
        f"{of_all}: the steps are {1 + value[0]:.4f} +- {sigma[0]:.4f} of those in [[pattern.set]] ({each:.3f} deg); "
        "that was used. Write the true steps into measurement.toml"
    )
    return _steps_doubt(text, {"steps_ratio": 1 + value[0]})
