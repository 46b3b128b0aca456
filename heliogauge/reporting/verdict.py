"""What a reader needs first: whether a result can be used, what is doubtful, and what is missing."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from heliogauge.doubts import Severity
from heliogauge.flags import REJECTED, SampleFlag
from heliogauge.results.folder import Summary
from heliogauge.slopes.map import SlopeMap

#: A smaller share without a value is dust: the headline says it, the verdict does not.
SMALLEST_HOLE_SHARE = 0.005
#: More than the strip along the edge that an image of 100 x 100 px of a mirror loses, three pixels wide.
WIDEST_EDGE_SHARE = 0.12

#: A clause of a doubt that is longer than this loses what is in brackets, then what follows a colon, and is cut at a
#: word only then; the full text stands below.
_MOST_LETTERS = 110
#: Fewer words before a colon name what the doubt is about, and say nothing of it.
_FEWEST_WORDS = 4


class State(StrEnum):
    """How a result stands.

    SOUND: Nothing is doubtful, nothing is missing.
    DOUBTFUL: Usable; numbers may be off by more than their sigma.
    INCOMPLETE: Something that was asked for is not there.
    FAILED: Something is wrong; numbers it concerns are not to be used.
    """

    SOUND = "sound"
    DOUBTFUL = "doubtful"
    INCOMPLETE = "incomplete"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Remark:
    """One line of a verdict.

    text: One short clause.
    mark: Place in the page where the whole text is.
    severity: How much it weighs.
    """

    text: str
    mark: str
    severity: Severity


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether a result can be used.

    passed: What was checked and found right.
    doubtful: What is doubtful, the heaviest first, then the shortest.
    missing: What was asked for and is not there.
    notes: Number of remarks that change nothing.
    """

    state: State
    passed: tuple[str, ...] = ()
    doubtful: tuple[Remark, ...] = ()
    missing: tuple[str, ...] = ()
    notes: int = 0


def verdict_of(summary: Summary, missing: Sequence[str] = (), passed: Sequence[str] = ()) -> Verdict:
    """Return the verdict on a result.

    summary: Gives the doubts.
    missing: What is not there, such as "36.7 % of the mirror not measured".
    passed: What was checked and found right.
    """
    heavy = [
        (doubt, Remark(first_clause(doubt.text), doubt_mark(number), doubt.severity))
        for number, doubt in enumerate(summary.doubts, start=1)
        if doubt.severity is not Severity.NOTE
    ]
    heavy.sort(key=lambda one: (one[0].severity is not Severity.SERIOUS, len(one[1].text)))
    if any(doubt.severity is Severity.SERIOUS for doubt, _ in heavy):
        state = State.FAILED
    elif missing:
        state = State.INCOMPLETE
    else:
        state = State.DOUBTFUL if heavy else State.SOUND
    return Verdict(
        state,
        tuple(sorted(passed, key=len)),
        tuple(remark for _, remark in heavy),
        tuple(sorted(missing, key=len)),
        len(summary.doubts) - len(heavy),
    )


def doubt_mark(number: int) -> str:
    """Return the place in a page where a doubt stands with all its words, counted from 1."""
    return f"doubt-{number}"


def first_clause(text: str) -> str:
    """Return the first clause of a doubt: up to a semicolon or the end of its first sentence.

    >>> first_clause("3 photos only; 12 are better")
    '3 photos only'
    >>> first_clause(f"no sigma is given for the camera ([camera] {'x' * 90}): counted as exact")
    'no sigma is given for the camera: counted as exact'
    >>> first_clause(f"camera: its focal length contradicts {'the targets ' * 12}")[:42]
    'camera: its focal length contradicts the t'
    """
    for end in ("; ", ". "):
        text = text.partition(end)[0]
    if len(text) > _MOST_LETTERS:
        text = re.sub(r" \([^()]*\)", "", text)
    before = text.partition(": ")[0]
    if len(text) > _MOST_LETTERS and len(before.split()) >= _FEWEST_WORDS:
        text = before
    if len(text) <= _MOST_LETTERS:
        return text
    return text[:_MOST_LETTERS].rpartition(" ")[0].rstrip(",:") + " \u2026"


def unmeasured(share: float, of: str = "the mirror") -> tuple[str, ...]:
    """Say how much was not measured, as `verdict_of` takes it.

    share: Measured share, from 0 to 1.

    >>> unmeasured(0.633)
    ('36.7 % of the mirror not measured',)
    """
    return (f"{100 * (1 - share):.1f} % of {of} not measured",) if 1 - share >= SMALLEST_HOLE_SHARE else ()


def holes(slope_map: SlopeMap, of: str = "the mirror") -> tuple[str, ...]:
    """Say how much of a mirror has no value, as `verdict_of` takes it.

    Pixels that mix the mirror with its surroundings are lost to every camera: the strip along the edge is no hole,
    unless it takes more than `WIDEST_EDGE_SHARE`.
    """
    missing = slope_map.aperture & ~slope_map.valid
    edge = missing & ((slope_map.flags & np.uint32(REJECTED)) == np.uint32(SampleFlag.MIRROR_EDGE))
    count = int(np.count_nonzero(slope_map.aperture))
    if not count:
        return unmeasured(0.0, of)
    kept_edge = int(np.count_nonzero(edge))
    if kept_edge > WIDEST_EDGE_SHARE * count:
        kept_edge = 0
    hole = int(np.count_nonzero(missing)) - kept_edge
    return unmeasured(1 - hole / count, of)
