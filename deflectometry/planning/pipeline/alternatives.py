"""What might be done otherwise: each change tried as a whole, by how much it betters each sigma, the best in words."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from deflectometry.planning.prospect import Alternative, Change, Promise
from heliogauge.errors import EstimationError, InputError
from heliogauge.results.folder import write_table_csv
from heliogauge.running.progress import Progress

#: Table of the alternatives.
ALTERNATIVES_FILE = "alternatives.csv"
#: So many gains of one alternative are put into words; the table has all.
_MOST_GAINS = 3
#: Changes of less than 5 % are not worth a word.
WORTH_A_WORD = 1.05


def try_changes(changes: Sequence[Change], before: Promise, progress: Progress) -> tuple[Alternative, ...]:
    """Return what each change brings, that of the largest gain first; impossible ones last."""
    found = []
    with progress.stage("alternatives", steps=len(changes)) as stage:
        for change in changes:
            found.append(_tried(change, before))
            stage.advance()
    return tuple(sorted(found, key=lambda one: -one.best_gain))


def _tried(change: Change, before: Promise) -> Alternative:
    try:
        after = change.planned.prospect()
    except (InputError, EstimationError) as error:
        return Alternative(change, {}, {}, {}, str(error))
    sigmas = after.sigmas()
    compares = before.known_facets() <= after.known_facets()
    gains = {
        name: one / sigmas[name] if compares and sigmas.get(name, 0.0) > 0 else np.nan
        for name, one in before.sigmas().items()
    }
    return Alternative(change, sigmas, gains, after.beside())


def words_of_best(
    alternatives: Sequence[Alternative], labels: Mapping[str, str], costs: Callable[[Alternative], Sequence[str]]
) -> str:
    """Say which three alternatives bring most, and what they cost.

    labels: Words of each sigma.
    costs: Says what an alternative costs beside sigmas.
    """
    useful = [one for one in alternatives if one.best_gain > WORTH_A_WORD]
    if not useful:
        return "none of the alternatives that were tried makes a sigma smaller by more than 5 %"
    said = []
    for one in useful[:3]:
        rows = [(labels[name], gain) for name, gain in one.gains.items() if np.isfinite(gain)]
        most = sorted((gain for _, gain in rows), reverse=True)[:_MOST_GAINS]
        words = [f"{label} {gain:.2f} times better" for label, gain in rows if gain > WORTH_A_WORD and gain in most]
        # What nobody states is counted as better known than it is: a larger sigma is the true one.
        less = "larger, as is true then" if one.change.states_sigma else "worse"
        words += [f"{label} {1 / gain:.2f} times {less}" for label, gain in rows if gain < 1 / WORTH_A_WORD]
        said.append(f"{one.change.words}: {', '.join([*words, *costs(one)])}")
    return "; ".join(said)


def write_alternatives(
    folder: Path, before: Promise, alternatives: Sequence[Alternative], sigma_key: Callable[[str], str]
) -> None:
    """Write the table of the alternatives into an existing folder.

    sigma_key: Returns the key of a sigma, with its unit.
    """
    sigmas, beside = before.sigmas(), before.beside()
    table: dict[str, list[object]] = {
        "change": ["as planned", *(one.change.words for one in alternatives)],
        "key": ["", *(one.change.key for one in alternatives)],
        "before": ["", *(one.change.before for one in alternatives)],
        "after": ["", *(one.change.after for one in alternatives)],
    }
    for name, value in sigmas.items():
        table[sigma_key(name)] = [value, *(one.sigmas.get(name, np.nan) for one in alternatives)]
    for name in sigmas:
        table[f"gain_{name}"] = [1.0, *(one.gains.get(name, np.nan) for one in alternatives)]
    for name, value in beside.items():
        table[name] = [value, *(one.beside.get(name, np.nan) for one in alternatives)]
    table["states_sigma"] = ["", *("yes" if one.change.states_sigma else "" for one in alternatives)]
    table["reason"] = ["", *(one.reason for one in alternatives)]
    write_table_csv(folder / ALTERNATIVES_FILE, table)
