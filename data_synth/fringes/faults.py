"""What goes wrong in fringe measurements, on purpose: faults that the frame checks must name."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from data_synth.optics.sensor import UnsignedArray
from deflectometry.setup import FringePattern, FringeSet
from heliogauge.errors import InputError


class FaultKind(StrEnum):
    """Faults of a fringe measurement."""

    REPEATED = "repeated"
    STALE = "stale"
    SWAPPED = "swapped"
    CORRUPT = "corrupt"
    WRONG_STEP = "wrong-step"
    SATURATED = "saturated"
    GAMMA = "gamma"
    DRIFT = "drift"


#: Frame faults take the number of a frame (its default), the others an amount.
_DEFAULTS: dict[FaultKind, float] = {
    FaultKind.REPEATED: 5,
    FaultKind.STALE: 5,
    FaultKind.SWAPPED: 5,
    FaultKind.CORRUPT: 5,
    FaultKind.WRONG_STEP: 0,
    FaultKind.SATURATED: 1.6,
    FaultKind.GAMMA: 2.2,
    FaultKind.DRIFT: 0.05,
}
_FRAME_FAULTS = (FaultKind.REPEATED, FaultKind.STALE, FaultKind.SWAPPED, FaultKind.CORRUPT)


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault.

    kind: What happens. repeated: the frame is a copy of the one before; stale: the display still showed the one
        before (the noise is new); swapped: the frame and the next changed places; corrupt: its lower third is
        missing; wrong-step: the n steps of each set were 2 pi / (n - 1) apart instead of 2 pi / n; saturated:
        exposure times the amount; gamma: the display's exponent; drift: relative change of the exposure from the
        first to the last frame.
    amount: Number of the frame (repeated, stale, swapped, corrupt) or size of the fault.
    """

    kind: FaultKind
    amount: float

    @classmethod
    def parse(cls, text: str) -> "Fault":
        """Read a fault as typed on the command line.

        text: Kind, optionally with a frame or amount: ``swapped:7``, ``gamma:1.8``.
        InputError: An unknown kind, or an amount that is not a number.

        >>> Fault.parse("swapped:7")
        Fault(kind=<FaultKind.SWAPPED: 'swapped'>, amount=7.0)
        """
        name, _, amount = text.partition(":")
        if name not in {str(kind) for kind in FaultKind}:
            raise InputError(f"fault {text!r}: one of {', '.join(FaultKind)} is needed, with :frame or :amount")
        kind = FaultKind(name)
        try:
            value = float(amount) if amount else float(_DEFAULTS[kind])
        except ValueError as error:
            raise InputError(f"fault {text!r}: a number is needed after the colon") from error
        if not math.isfinite(value) or (kind in _FRAME_FAULTS and value != int(value)):
            raise InputError(f"fault {text!r}: a {'frame' if kind in _FRAME_FAULTS else 'finite number'} is needed")
        if kind in (FaultKind.SATURATED, FaultKind.GAMMA) and not value > 0:
            raise InputError(f"fault {text!r}: a positive number is needed")
        if kind is FaultKind.DRIFT and not value > -1:
            raise InputError(f"fault {text!r}: the light cannot fall by more than all of it; more than -1 is needed")
        return cls(kind, value)


def shown_pattern(pattern: FringePattern, faults: Sequence[Fault]) -> FringePattern:
    """Return the pattern that was really shown.

    faults: All faults; only a wrong step changes the pattern.
    Returns: The declared pattern, or the one with wrong steps.
    """
    if not any(fault.kind is FaultKind.WRONG_STEP for fault in faults):
        return pattern
    return FringePattern(
        tuple(
            FringeSet(fringes.axis, fringes.periods, fringes.steps_rad * fringes.n_frames / (fringes.n_frames - 1))
            for fringes in pattern.sets
        )
    )


def frame_sources(n_frames: int, faults: Sequence[Fault]) -> list[int]:
    """Return which expected image each frame shows.

    faults: All faults; stale and swapped ones count here.
    InputError: A fault names a frame that does not exist.
    """
    sources = list(range(n_frames))
    for fault in faults:
        if fault.kind not in _FRAME_FAULTS:
            continue
        frame = int(fault.amount)
        needs_next, needs_last = fault.kind is FaultKind.SWAPPED, fault.kind in (FaultKind.REPEATED, FaultKind.STALE)
        if not needs_last <= frame < n_frames - needs_next:
            raise InputError(f"fault {fault.kind}:{frame}: frames go from 0 to {n_frames - 1}")
        if fault.kind is FaultKind.STALE:
            sources[frame] = sources[frame - 1]
        elif fault.kind is FaultKind.SWAPPED:
            sources[frame], sources[frame + 1] = sources[frame + 1], sources[frame]
    return sources


def damage_frames(frames: UnsignedArray, faults: Sequence[Fault]) -> None:
    """Apply the faults that happen after the exposure.

    frames (n, h, w): Frames, changed in place.
    faults: All faults; repeated and corrupt frames count here.
    """
    for fault in faults:
        if fault.kind not in _FRAME_FAULTS:
            continue
        frame = int(fault.amount)
        if fault.kind is FaultKind.REPEATED:
            frames[frame] = frames[frame - 1]
        elif fault.kind is FaultKind.CORRUPT:
            # A transfer that broke off: the rest of the frame is what the buffer held before, here nothing.
            frames[frame, 2 * frames.shape[1] // 3 :] = 0
