"""Two results beside each other, and their difference."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from heliogauge.errors import InputError
from heliogauge.reporting.html import Html, Shown, join
from heliogauge.reporting.notation import number_text
from heliogauge.reporting.page import headline_numbers, name_and_line
from heliogauge.results.folder import Summary, read_slope_map, unit_of
from heliogauge.slopes.grid import difference, resample
from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import FloatArray
from heliogauge.view.arrays import ServedStore
from heliogauge.view.maps import MapView, slope_map_view
from heliogauge.view.server.pages import label_of, pieces_page
from heliogauge.view.tables import TableColumn, TableView

#: Layers of a map of differences by what they are called there; the others repeat these.
LAYERS: dict[str, str] = {
    "slope_error_x": "Difference of dz/dx",
    "slope_error_y": "Difference of dz/dy",
    "slope_error": "Difference, magnitude",
    "height": "Difference of height",
    "sigma_slope_x": "Joint sigma of dz/dx",
    "sigma_slope_y": "Joint sigma of dz/dy",
}


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """One of two results that are compared.

    name: What was measured, and the folder: before and after have one name.
    address: Where its own page is.
    summary: Its numbers; None for a slope map alone.
    map_file: Its slope map; None where it has none.
    files: All files that it is read from.
    """

    name: str
    address: str
    summary: Summary | None
    map_file: Path | None
    files: tuple[Path, ...]


def check_sides(before: Side, after: Side) -> None:
    """Check that two results can be compared.

    InputError: They are of different kinds, designs or frames; the message says which.
    """
    if before.map_file is not None and after.map_file is not None:
        _change(read_slope_map(before.map_file), read_slope_map(after.map_file))
        return
    kinds = [side.summary.kind if side.summary else "slope map" for side in (before, after)]
    if kinds[0] != kinds[1]:
        raise InputError(
            f"{before.name} is of the kind {kinds[0]!r}, {after.name} of {kinds[1]!r}: there is no difference of "
            "these; look at each by itself"
        )


def difference_page(before: Side, after: Side, store: ServedStore) -> str:
    """Return the page of two results: the difference, their numbers side by side, their maps.

    InputError: They cannot be compared.
    """
    check_sides(before, after)
    pieces: list[Shown] = [
        name_and_line(f"{after.name} minus {before.name}", "after minus before; sigmas of both add in squares"),
    ]
    if before.map_file is not None and after.map_file is not None:
        maps = read_slope_map(before.map_file), read_slope_map(after.map_file)
        change = _change(*maps)
        pieces += [_numbers_of(change), _view_of(change, before, after)]
        pieces += [numbers] if (numbers := _both(before, after)) is not None else []
        pieces += [Html("<h2>Before</h2>"), slope_map_view(maps[0], before.name)]
        pieces += [Html("<h2>After</h2>"), slope_map_view(maps[1], after.name)]
    elif (numbers := _both(before, after)) is not None:
        pieces.append(numbers)
    up = ((f"\u2191 before: {before.name}", before.address), (f"\u2191 after: {after.name}", after.address))
    return pieces_page(f"{after.name} minus {before.name}", pieces, store, up)


def _change(before: SlopeMap, after: SlopeMap) -> SlopeMap:
    """Return after minus before, on the coarser of the two grids."""
    for what in ("frame", "design"):
        words = getattr(before, what), getattr(after, what)
        if words[0] != words[1]:
            raise InputError(
                f"the two maps have different {what}s, so their difference would say nothing about the mirror; "
                f"before: {words[0]}; after: {words[1]}"
            )
    coarse = max((before, after), key=_spacing_m)
    change = difference(*(one if one is coarse else _onto(one, coarse) for one in (after, before)))
    if not change.valid.any():
        raise InputError("no node of the mirror was measured in both results, so they have no difference")
    return change


def _onto(slope_map: SlopeMap, other: SlopeMap) -> SlopeMap:
    same = slope_map.shape == other.shape and all(
        np.allclose(a, b, rtol=0, atol=1e-9) for a, b in ((slope_map.x_m, other.x_m), (slope_map.y_m, other.y_m))
    )
    return slope_map if same else resample(slope_map, other.x_m, other.y_m)


def _spacing_m(slope_map: SlopeMap) -> float:
    return max(float(np.ptp(grid)) / max(grid.size - 1, 1) for grid in (slope_map.x_m, slope_map.y_m))


def _numbers_of(change: SlopeMap) -> Html:
    """Return the RMS of the difference, and the RMS that the errors of measurement alone would show."""
    valid = change.valid
    count = int(np.count_nonzero(valid))
    sigmas = change.sigma_slope()
    rows: list[tuple[str, ...]] = []
    for name, error, sigma in zip(
        ("dz/dx", "dz/dy"), (change.slope_error_x, change.slope_error_y), sigmas, strict=True
    ):
        rms, joint = _rms(error[valid]), _rms(sigma[valid])
        note = f"errors of measurement alone: {number_text(joint, None, 'rad')}; mean {_signed(error[valid])}"
        rows.append((f"RMS difference of {name}", number_text(rms, None, "rad"), note))
    share = count / max(int(np.count_nonzero(change.aperture)), 1)
    rows.append(("Share of the mirror compared", f"{share:.1%}", f"{count} nodes"))
    return headline_numbers(rows)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _signed(values: FloatArray) -> str:
    return number_text(float(values.mean()), None, "rad")


def _view_of(change: SlopeMap, before: Side, after: Side) -> MapView:
    view = slope_map_view(change, f"{after.name} minus {before.name}")
    layers = tuple(replace(one, name=LAYERS[one.key]) for one in view.layers if one.key in LAYERS)
    return replace(view, layers=layers, note=f"After: {after.name}. Before: {before.name}. {change.removed}.")


def _both(before: Side, after: Side) -> Shown | None:
    """Return the numbers that both results have, with their difference in sigmas."""
    if before.summary is None or after.summary is None:
        return None
    first, second = before.summary.numbers, after.summary.numbers
    rows = []
    for key, a in first.items():
        b = second.get(key)
        if a is None or b is None or key.startswith("sigma_"):
            continue
        name, unit = unit_of(key)
        sigmas = [numbers.get(f"sigma_{key}") for numbers in (first, second)]
        known = [sigma for sigma in sigmas if sigma is not None]
        joint = math.hypot(*known) if len(known) == 2 else None
        times = abs(b - a) / joint if joint else float("nan")
        texts = [number_text(value, sigma, unit, name) for value, sigma in zip((a, b), sigmas, strict=True)]
        rows.append((label_of(key), *texts, number_text(b - a, joint, unit, name), times))
    if not rows:
        return None
    columns = tuple(zip(*rows, strict=True))
    table = TableView(
        "Numbers of both results",
        (
            TableColumn("number", columns[0]),
            TableColumn("before", columns[1]),
            TableColumn("after", columns[2]),
            TableColumn("after minus before", columns[3]),
            TableColumn("in sigmas", [_times(one) for one in columns[4]], numbers=columns[4]),
        ),
    )
    return join(Html("<h2>Numbers of both</h2>"), table)


def _times(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.1f}"
