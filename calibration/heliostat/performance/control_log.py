"""Logs of a heliostat's controller against what was to happen (Stage-STE 12.6, 1.2.4.2 and tests 1 and 2).

A command or a fault that was provoked is answered when the state that is due is reached within a time; each is to be
tried three times.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from heliogauge.errors import InputError
from heliogauge.validate import BoolArray, FloatArray, float_array

#: What is due after a command (test 1) or a provoked fault (test 2), as the report has it.
DUE: dict[str, str] = {
    "stow": "stow",
    "maintenance": "maintenance",
    "cleaning": "cleaning",
    "standby": "standby",
    "tracking": "tracking",
    "bcs": "bcs",
    "reference_search": "initialisation",
    "reset": "reset",
    "defocus": "standby",
    "power_loss": "stow",
    "communication_loss": "stow",
    "high_wind": "stow",
    "emergency_defocus": "standby",
    "emergency_stop": "hold",
    "axis_limit": "standby",
    "controller_fault": "fault_message",
    "component_fault": "fault_message",
}
#: Those of them that are faults.
FAULTS = frozenset(
    {
        "power_loss",
        "communication_loss",
        "high_wind",
        "emergency_defocus",
        "emergency_stop",
        "axis_limit",
        "controller_fault",
        "component_fault",
    }
)
#: How often each is to be tried.
TIMES_EACH = 3


@dataclass(frozen=True, slots=True, eq=False)
class Answers:
    """How a controller answered one command or fault.

    event: What was commanded or provoked.
    due: The state that was to follow.
    passed (n,): Whether it followed in time.
    delay_s (n,): Time to it; NaN where it never came [s].
    """

    event: str
    due: str
    passed: BoolArray
    delay_s: FloatArray

    @property
    def tried(self) -> int:
        """How often it was tried."""
        return int(self.passed.size)


def answers(times_s: FloatArray, events: Sequence[str], states: Sequence[str], within_s: float) -> tuple[Answers, ...]:
    """Find how each command and fault of a log was answered.

    times_s (n,): Ascending [s].
    events: Command or fault of each row; empty: none.
    states: State of each row; empty: not said.
    within_s: Time in which the state that is due must be reached [s].
    Returns: One for each event, in the order in which they came.
    InputError: An event that is not known, or times that do not ascend.

    The next command ends the time for an answer.
    """
    times = float_array("times_s", times_s, (None,))
    if (np.diff(times) < 0).any():
        raise InputError("times_s: a log in the order of time is needed")
    unknown = sorted({one for one in events if one and one not in DUE})
    if unknown:
        raise InputError(f"event {unknown[0]!r} is not known; there are: {', '.join(DUE)}")
    starts = [row for row, event in enumerate(events) if event]
    found: dict[str, list[tuple[bool, float]]] = {}
    for start, following in pairwise([*starts, len(events)]):
        due = DUE[events[start]]
        reached = [row for row in range(start, following) if states[row] == due]
        delay = float(times[reached[0]] - times[start]) if reached else float("nan")
        found.setdefault(events[start], []).append((bool(reached) and delay <= within_s, delay))
    return tuple(
        Answers(event, DUE[event], np.array([p for p, _ in tries]), np.array([d for _, d in tries]))
        for event, tries in found.items()
    )
