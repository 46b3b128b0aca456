"""Numbers that still come out of damaged files, against those of the undamaged ones."""

import json
import math
from collections import Counter
from pathlib import Path
from typing import Any

#: A difference beyond so many joint sigmas is one; the files are the same but for the damage, so chance adds little.
_MOST_SIGMAS = 3.0


class SilentChangeError(Exception):
    """A headline number became another one, and no doubt says that something is wrong."""


def silent_changes(before: Path, after: Path) -> list[str]:
    """Return which headline numbers changed beyond their sigma although no doubt joined those that were there.

    before, after: Folders of results of the undamaged and of the damaged files. What has no summary says no numbers.
    """
    try:
        first, second = (json.loads((one / "summary.json").read_text(encoding="utf-8")) for one in (before, after))
    except FileNotFoundError:
        return []
    if first["name"] != second["name"] or Counter(_doubts(second)) - Counter(_doubts(first)):
        return []
    return [
        f"{key} {value:.6g} -> {second['numbers'][key]:.6g} (sigma {sigma:.2g})"
        for key, value in first["numbers"].items()
        if (sigma := _joint_sigma(key, first["numbers"], second["numbers"])) is not None
        and abs(second["numbers"][key] - value) > _MOST_SIGMAS * sigma
    ]


def _doubts(summary: dict[str, Any]) -> list[tuple[str, str]]:
    return [(one["code"], one["severity"]) for one in summary["doubts"]]


def _joint_sigma(key: str, first: dict[str, Any], second: dict[str, Any]) -> float | None:
    """Return the sigma of the difference of a number; None where it has none, or is not determined now."""
    sigmas = [numbers.get(f"sigma_{key}") for numbers in (first, second)]
    if second.get(key) is None or first.get(key) is None or None in sigmas:
        return None
    return math.hypot(*(float(one) for one in sigmas))
