"""What makes a result doubtful, as values: made where it is found, part of the result, shown by terminal and report."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import isfinite, nan
from typing import Any

from heliogauge.short_repr import ShortRepr

# Parts of a result that a doubt of several names.
_MOST_NAMES = 5


class Severity(StrEnum):
    """How much a doubt weighs; the order is that of the weights.

    NOTE: Good to know; every number is what its sigma says.
    DOUBT: The result is usable, but numbers may be off by more than their sigma: look at what the text names first.
    SERIOUS: Something is wrong (mirror, set-up or files); numbers it concerns are not to be used before it is set
        right or explained.
    """

    NOTE = "note"
    DOUBT = "doubt"
    SERIOUS = "serious"


@dataclass(frozen=True, slots=True)
class Doubt(ShortRepr):
    """A finding that makes a result doubtful.

    Decisions are taken on `code` and `numbers`, never on the words of `text`.

    Parameters
    ----------
    code : str
        Which finding, in snake_case: the same in every version and language, one for each kind of finding.
    text : str
        The finding as a sentence with its numbers, and what can be done about it.
    numbers : mapping of str to float
        What the sentence says in numbers; the names end with their units (`heliogauge.results.folder.UNITS`).
    severity : Severity
        How much it weighs.

    Examples
    --------
    >>> doubt = Doubt("photos_few", "3 photos only; 12 are better", {"photos_count": 3})
    >>> print(doubt)
    3 photos only; 12 are better
    >>> doubt.severity.value
    'doubt'
    """

    code: str
    text: str
    numbers: Mapping[str, float] = field(default_factory=dict, hash=False)
    severity: Severity = Severity.DOUBT

    def __str__(self) -> str:
        """Return the sentence."""
        return self.text

    def prefixed(self, where: str) -> "Doubt":
        """Return the doubt with where it was found in front of the sentence."""
        return replace(self, text=f"{where}: {self.text}")


def gather_doubts(*doubts: Doubt | Iterable[Doubt] | None) -> tuple[Doubt, ...]:
    """Put together what several checks found, each finding once.

    doubts: What each check returned: a doubt, None for nothing found, or several doubts.
    """
    every: dict[Doubt, None] = {}
    for one in doubts:
        if one is not None:
            every.update(dict.fromkeys((one,) if isinstance(one, Doubt) else one))
    return tuple(every)


def doubts_of_parts(parts: Mapping[str, Iterable[Doubt]], what: str) -> tuple[Doubt, ...]:
    """Return what the parts of a result have to say, for each code the heaviest doubt; notes are passed over.

    parts: The doubts of every part by its name, none too.
    what: What the parts are, such as "heliostats".

    >>> few = Doubt("photos_few", "3 photos only")
    >>> print(*doubts_of_parts({"A1": [few], "A2": [], "A3": [few]}, "heliostats"))
    2 of 3 heliostats, photos few (A1, A3): 3 photos only
    """
    groups: dict[str, dict[str, Doubt]] = {}
    for name, doubts in parts.items():
        for _, one in heaviest_first(doubts):
            if one.severity is not Severity.NOTE:
                groups.setdefault(one.code, {}).setdefault(name, one)
    found = []
    for members in groups.values():
        worst = heaviest_first(members.values())[0][1]
        shown = ", ".join(list(members)[:_MOST_NAMES]) + (", ..." if len(members) > _MOST_NAMES else "")
        text = f"{len(members)} of {len(parts)} {what}, {worst.code.replace('_', ' ')} ({shown}): {worst.text}"
        found.append(replace(worst, text=text, numbers={"parts_count": len(members)}))
    return tuple(found)


def heaviest_first(doubts: Iterable[Doubt]) -> list[tuple[int, Doubt]]:
    """Return doubts with their numbers, from 1, the heaviest first; of one weight in the order given."""
    return sorted(enumerate(doubts, start=1), key=lambda one: -list(Severity).index(one[1].severity))


def doubt_content(doubt: Doubt) -> dict[str, Any]:
    """Return a doubt as JSON has it; a number that is not finite is null."""
    numbers = {name: float(value) if isfinite(value) else None for name, value in doubt.numbers.items()}
    return {"code": doubt.code, "text": doubt.text, "numbers": numbers, "severity": doubt.severity.value}


def read_doubt(content: Mapping[str, Any]) -> Doubt:
    """Return the doubt that `doubt_content` made JSON of.

    KeyError, TypeError, ValueError: It is none.
    """
    numbers = {str(name): nan if value is None else float(value) for name, value in content["numbers"].items()}
    return Doubt(str(content["code"]), str(content["text"]), numbers, Severity(content["severity"]))
