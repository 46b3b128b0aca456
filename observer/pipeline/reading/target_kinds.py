"""What each listed target looks like, and by which name photos show it: one list for coded, plain and square ones."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from heliogauge.errors import InputError
from heliogauge.validate import FloatArray
from photogrammetry.detection import Detections
from photogrammetry.pipeline import OnePhoto

Kind = Literal["coded", "plain", "square"]
#: Columns of the list that say it; each may be left out.
KIND_COLUMNS = ("code", "kind", "diameter_mm")


@dataclass(frozen=True, slots=True)
class TargetKinds:
    """Targets of a list by what they look like.

    plain: Names of dots without a code.
    name_of: Name in the list of what a photo shows under another name, as its code or a marker's corner.
    middle_of: Name in the list of a square marker whose middle is listed, by the marker's number.
    diameter_m: Diameter of each listed dot, by name; None where the list says none [m].
    """

    plain: frozenset[str] = frozenset()
    name_of: Mapping[str, str] = field(default_factory=dict)
    middle_of: Mapping[str, str] = field(default_factory=dict)
    diameter_m: Mapping[str, float | None] = field(default_factory=dict)

    @property
    def common_diameter_m(self) -> float | None:
        """Diameter of all listed dots, where each has the same one [m]."""
        sizes = set(self.diameter_m.values())
        return sizes.pop() if len(sizes) == 1 else None

    def named(self, one: OnePhoto) -> OnePhoto:
        """Return what a photo shows under the names of the list, with the middles of markers that are listed."""
        found, shapes = one.detections, one.ellipses_px2
        middles = [made for number in self.middle_of if (made := _middle(found, number)) is not None]
        for made in middles:
            found, shapes = found.joined(made), np.concatenate([shapes, np.full((1, 2, 2), np.nan)])
        # A code that is the name of a plain target is not that one.
        names = {**{name: f"code {name}" for name in self.plain}, **self.name_of, **self.middle_of}
        if not names:
            return one
        return replace(
            one, detections=found.renamed([names.get(name, name) for name in found.names]), ellipses_px2=shapes
        )


def target_kinds(table: Mapping[str, Sequence[str]], path: Path) -> TargetKinds:
    """Return what the list says of the looks of its targets.

    table: The list; columns ``kind`` (coded, plain, square), ``code`` (what is printed on it where its name is another)
        and ``diameter_mm`` may be there, and cells of them empty.
    path: Where the list was read, for messages.
    InputError: A kind that does not exist, a plain dot with a code, a code of two targets, or no diameter above 0.
    """
    count = len(table["target"])
    codes, kinds, sizes = ([cell.strip() for cell in table.get(name, [""] * count)] for name in KIND_COLUMNS)
    plain: set[str] = set()
    diameter_m: dict[str, float | None] = {}
    names: dict[str, str] = {}
    middles: dict[str, str] = {}
    lines: dict[str, int] = {}
    for line, (target, kind, code, size) in enumerate(zip(table["target"], kinds, codes, sizes, strict=True), start=2):
        if kind and kind not in get_args(Kind):
            raise InputError(f"{path}, line {line}: kind = {kind!r}: one of {', '.join(get_args(Kind))} is needed")
        if kind == "plain":
            if code:
                raise InputError(f"{path}, line {line}: {target} is plain and has the code {code}; leave one out")
            plain.add(target)
        shown = code or target
        if kind != "plain" and shown in lines:
            raise InputError(f"{path}, line {line}: code {shown} stands in line {lines[shown]} already")
        lines[shown] = line
        if kind == "square" and "." not in shown:
            middles[shown] = target
        elif shown != target:
            names[shown] = target
        # `7.2` is a corner of a square marker.
        if kind != "square" and "." not in shown:
            where = f"{path}, line {line}: diameter_mm"
            diameter_m[target] = 1e-3 * _positive(size, where) if size else None
    # A name that is another target's code would be taken for that one.
    doubled = sorted(set(names) & (set(table["target"]) - set(names.values())))
    if doubled:
        raise InputError(
            f"{path}: {doubled[0]} is the name of a target and the code of another one, {names[doubled[0]]}"
        )
    return TargetKinds(frozenset(plain), names, middles, diameter_m)


def _positive(cell: str, where: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = float("nan")
    if not 0 < value < np.inf:
        raise InputError(f"{where} = {cell}: a number above 0 is needed, in millimetres")
    return value


def _middle(found: Detections, number: str) -> Detections | None:
    """Return where the diagonals of a square marker cross: its middle, whatever the perspective."""
    place = {name: k for k, name in enumerate(found.names)}
    rows = [place.get(f"{number}.{corner}", -1) for corner in range(4)]
    if min(rows) < 0 or not found.usable[rows].all():
        return None
    corners = found.pixels_px[rows]
    crossing = _crossing(corners)
    moved = np.empty((2, 4, 2))
    step = 1e-3
    for corner in range(4):
        for axis in range(2):
            aside = corners.copy()
            aside[corner, axis] += step
            moved[:, corner, axis] = (_crossing(aside) - crossing) / step
    covariance = np.einsum("ica,cab,jcb->ij", moved, found.covariance_px2[rows], moved)
    one = found.chosen(rows[:1]).renamed([number])
    return replace(one, pixels_px=crossing[None], covariance_px2=0.5 * (covariance + covariance.T)[None])


def _crossing(corners: FloatArray) -> FloatArray:
    first, second = corners[2] - corners[0], corners[3] - corners[1]
    along = np.linalg.solve(np.stack([first, -second], axis=1), corners[1] - corners[0])
    return np.asarray(corners[0] + along[0] * first)
