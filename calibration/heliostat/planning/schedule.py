"""Which heliostats to calibrate when: the worst first, suns spread, one beam at a time on each target."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.geometry.sun import Site, sun_directions
from heliogauge.validate import FloatArray, TimeArray, positive

_DAY = np.timedelta64(1, "D")
_MINUTE = np.timedelta64(60_000, "ms")


@dataclass(frozen=True, slots=True)
class Need:
    """How urgent a heliostat's calibration is.

    error_rad: Its expected error of the beam now [rad]; inf for one that was never calibrated.
    measurements: Beams that are to be looked at.
    targets: Targets that it can serve.
    drift_rad_per_year: How fast the error grows until its turn comes [rad per year].
    reason: Why it is on the list.
    """

    name: str
    error_rad: float
    measurements: int
    targets: tuple[str, ...]
    drift_rad_per_year: float = 0.0
    reason: str = ""


@dataclass(frozen=True, slots=True)
class ScheduleOptions:
    """How measurements are spread.

    slot_minutes: Time that a beam takes a target: sent there, photographed, sent back [min].
    per_day: Heliostats (not beams) a day at most; 0 for any number.
    apart_rad: Suns of one heliostat's beams are at least so far from each other [rad].
    lowest_sun_rad: No measurements with a lower sun [rad].
    InputError: A number out of its range.
    """

    slot_minutes: float = 3.0
    per_day: int = 0
    apart_rad: float = np.radians(12.0)
    lowest_sun_rad: float = np.radians(10.0)

    def __post_init__(self) -> None:
        positive("slot_minutes", self.slot_minutes, "minutes")
        if self.per_day < 0 or not 0 <= self.apart_rad < np.pi:
            raise InputError(f"schedule: 0 or more heliostats a day, suns less than 180 degrees apart: {self}")


@dataclass(frozen=True, slots=True, eq=False)
class Slot:
    """One beam of one heliostat on one target.

    time: When its slot begins (UTC).
    target: Which target it has to itself.
    number: Which of its beams this is, from 1.
    sun (3,): Direction to the sun.
    reason: Why it is on the list.
    """

    time: np.datetime64
    target: str
    heliostat: str
    number: int
    sun: FloatArray
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Schedule:
    """A proposal.

    slots: In the order of time.
    unserved: Beams of heliostats for which there was no slot.
    """

    slots: tuple[Slot, ...]
    unserved: dict[str, int]


def propose_schedule(
    needs: Sequence[Need], site: Site, days: npt.ArrayLike, options: ScheduleOptions | None = None
) -> Schedule:
    """Propose when which heliostat is looked at.

    days (d,): Days on which there may be measurements, ascending.
    Returns: A slot for each beam as far as there is room, and what there was no room for.
    InputError: No heliostat, a name twice, or no day.

    Slot by slot, each target goes to the heliostat with the largest expected error among those that still need a
    beam, have no other beam at that time, and whose earlier beams had suns far enough away. A heliostat's error
    counts as divided by the root of one more than its beams so far: the first beams bring most, so that no bad
    heliostat keeps all others waiting.
    """
    options = options or ScheduleOptions()
    names = [need.name for need in needs]
    if not names or len(set(names)) != len(names):
        raise InputError(
            f"schedule: heliostats with names of their own are needed, not {len(names)} with {len(set(names))} names"
        )
    dates = np.unique(np.asarray(days, dtype="datetime64[D]"))
    if not dates.size:
        raise InputError("schedule: at least one day is needed")
    state = _State(needs, options, dates[0])
    slots: list[Slot] = []
    targets = tuple(dict.fromkeys(target for need in needs for target in need.targets))
    for day in dates:
        times, suns = _slots_of(day, site, options)
        state.begin(day)
        for time, sun in zip(times, suns, strict=True):
            busy: set[int] = set()
            for target in targets:
                chosen = state.next(target, sun, busy)
                if chosen is None:
                    continue
                busy.add(chosen)
                number = state.take(chosen, sun)
                slots.append(Slot(time, target, names[chosen], number, sun, needs[chosen].reason))
        if not state.left.any():
            break
    unserved = {name: int(count) for name, count in zip(names, state.left.tolist(), strict=True) if count}
    return Schedule(tuple(slots), unserved)


class _State:
    """Who still needs how many beams, and from which suns it has had some."""

    def __init__(self, needs: Sequence[Need], options: ScheduleOptions, first: np.datetime64) -> None:
        self.options, self.first = options, first
        self.error = np.array([need.error_rad for need in needs], dtype=np.float64)
        self.drift = np.array([need.drift_rad_per_year for need in needs], dtype=np.float64)
        self.left = np.array([need.measurements for need in needs], dtype=np.int64)
        self.taken = np.zeros(len(needs), dtype=np.int64)
        self.can = {t: np.array([t in need.targets for need in needs]) for need in needs for t in need.targets}
        most = int(self.left.max(initial=0))
        self.suns = np.full((len(needs), most, 3), np.nan)
        self.urgency = self.error
        self.today: set[int] = set()

    def begin(self, day: np.datetime64) -> None:
        """Begin a day: errors have grown."""
        self.urgency = self.error + self.drift * float((day - self.first) / _DAY) / 365.25
        self.today = set()

    def next(self, target: str, sun: FloatArray, busy: set[int]) -> int | None:
        """Return who comes next on a target."""
        near = np.nanmax(self.suns @ sun, axis=1, initial=-1.0) > np.cos(self.options.apart_rad)
        free = self.can[target] & (self.left > 0) & ~near
        if busy:
            free[list(busy)] = False
        if self.options.per_day and len(self.today) >= self.options.per_day:
            known = np.zeros(free.size, dtype=np.bool_)
            known[list(self.today)] = True
            free &= known
        if not free.any():
            return None
        # Never calibrated comes before all; among these, and among equals, the order of the list.
        urgency = np.where(np.isinf(self.urgency), 1e9, self.urgency) / np.sqrt(1.0 + self.taken)
        return int(np.argmax(np.where(free, urgency, -np.inf)))

    def take(self, chosen: int, sun: FloatArray) -> int:
        """Give a slot to a heliostat; return the number of its beam."""
        self.suns[chosen, self.taken[chosen]] = sun
        self.taken[chosen] += 1
        self.left[chosen] -= 1
        self.today.add(chosen)
        return int(self.taken[chosen])


def _slots_of(day: np.datetime64, site: Site, options: ScheduleOptions) -> tuple[TimeArray, FloatArray]:
    """Return times of the slots of a day, and the suns, as long as the sun is high enough."""
    # The place's own day: no slot is lost to midnight of UTC.
    midnight = day.astype("datetime64[ms]") - round(4 * site.longitude_deg) * _MINUTE
    count = int(1440 / options.slot_minutes)
    steps = (np.arange(count) * options.slot_minutes * 60_000).round().astype("timedelta64[ms]")
    times = midnight + steps
    suns = sun_directions(times, site)
    up = suns[:, 2] > np.sin(options.lowest_sun_rad)
    return times[up], np.asarray(suns[up])
