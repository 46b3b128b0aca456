"""What terms explain of heliostats that are sound: no rigid model is one, and smooth errors pass for many things.

Real heliostats keep about 1 mrad of the beam that no rigid model has. It is no scatter: it follows the angles of the
axes and the seasons, and any smooth term explains some of it with great significance. How much, is known from sound
heliostats: the gain of a term (what it explains over what it leaves) is there ``q m F(q, n)`` of its q coefficients,
with ``m = (1 + 2 ln(looks) / q) / spare + misfit * mean``: of white scatter first, of smooth errors second.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, log

from heliogauge.adjust.f_distribution import f_tail


@dataclass(frozen=True, slots=True)
class Gains:
    """Gains of terms of one class in sound heliostats.

    mean: What smooth errors give each coefficient.
    freedom: Of the F distribution: the fewer, the more heliostats differ in their smooth errors.
    """

    mean: float
    freedom: float


#: Largest likelihood over the six sound heliostats at Juelich of more than 20 rows, whole and in 24 parts of 20 to 80
#: rows each, and judged by the parts of each with the numbers of the others (`benchmarks/heliostat_misfit.py`).
GAINS: Mapping[str, Gains] = {
    "smooth": Gains(0.035, 17.0),
    "time": Gains(0.095, 17.0),
    # Which side an axis comes from changes from row to row, as no smooth error does.
    "approach": Gains(0.0, inf),
}
#: Of 31 heliostats at Juelich three have a fault. Where a tenth are faulty, a chance of so much times a level accuses
#: so few sound ones that the level is the share of them among the accused (false discoveries of a field).
ODDS_OF_A_FAULT = 0.1 / 0.9
_CLASSES = {"change_point": "time", "drift": "time", "episode": "time", "backlash": "approach"}


def class_of(kind: str) -> str:
    """Return to which class of `GAINS` a kind of term belongs."""
    return _CLASSES.get(kind, "smooth")


def chance_in_sound(kind: str, gain: float, freedom: int, *, spare: float, looks: int, misfit: float) -> float:
    """Return the probability that a term gains as much with a sound heliostat.

    kind: Of the term.
    gain: What it explains over what it leaves.
    freedom: Its coefficients that the observations determine.
    spare: Components that it is judged by.
    looks: Dates, spans or periods among which it was chosen.
    misfit: Share of what is left that is no scatter as stated; 0 where rows scatter as their sigmas say.
    """
    if freedom < 1:
        return 1.0
    sound = GAINS[class_of(kind)]
    white = (1 + 2 * log(looks) / freedom) / spare
    # How well the mean is known: scatter from the rows, smooth errors from the heliostats that were compared.
    unknown = misfit / sound.freedom + (1 - misfit) / spare
    return f_tail(gain / freedom / (white + misfit * sound.mean), freedom, min(1 / max(unknown, 1e-9), spare))


def effective_components(spare: float) -> float:
    """Return how many independent components smooth errors leave of so many."""
    return 1 / (1 / max(spare, 1.0) + GAINS["smooth"].mean)


def criterion(left: float, numbers: float, count: float) -> float:
    """Return the Bayesian information criterion of an explanation: the lower, the likelier.

    left: Share of the squares that it leaves.
    numbers: That it has of its own.
    count: Independent components that it is judged by.
    """
    return count * log(max(left, 1e-300)) + numbers * log(count)
