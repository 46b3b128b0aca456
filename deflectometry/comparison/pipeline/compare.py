"""Compare two results of one mirror: aligned, differenced, with the uncertainty of the difference and a verdict."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np

from deflectometry.comparison.canting_difference import (
    CantingDifference,
    FacetPartner,
    canting_difference,
    facets_left_out,
    partners,
)
from deflectometry.comparison.judgement import (
    SIGNIFICANCE,
    Agreement,
    Judgement,
    SelfCheck,
    as_stated,
    judge,
    self_check,
)
from deflectometry.comparison.linear_terms import (
    expected_rest,
    has_both,
    linear_terms,
    measured,
)
from deflectometry.comparison.map_difference import difference_of, fine_square, motion_square, with_place_errors
from deflectometry.comparison.moved_map import PlaneMotion, cell_area_m2, moved_map
from deflectometry.comparison.pipeline.result import DIFFERENCE, FIRST, REST, SECOND, Comparison, Side
from deflectometry.comparison.placing import Placed, place_maps
from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import EstimationError, InputError
from heliogauge.files.regular import read_regular
from heliogauge.results.facet_frames import facet_frames
from heliogauge.results.folder import SUMMARY_FILE, hash_files, read_summary
from heliogauge.results.opened import SLOPE_MAP_FILE
from heliogauge.results.slope_map_file import facet_names, read_slope_map
from heliogauge.results.used_results import shared_files
from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import FloatArray

#: A smaller probability is a matter of the far tail of a distribution that nobody knows there.
_LEAST_CHANCE = 1e-12


def compare_results(first: Path, second: Path, *, shared: Sequence[str] = (), as_placed: bool = False) -> Comparison:
    """Compare two results of one mirror.

    Parameters
    ----------
    first, second : Path
        Folders of results with a slope map, of any instrument.
    shared : sequence of str
        Common sources whose errors are the same in both ("mirror pose"): they are subtracted, not added.
    as_placed : bool
        Take both frames as they are; otherwise shift and turn follow from the slopes.

    Returns
    -------
    Comparison
        First minus second with its uncertainty, and a verdict.

    Raises
    ------
    InputError
        No slope map, a result compared with itself, or a shared source that is not common to both.
    EstimationError
        The two share too few measured nodes.
    """
    sides = _read_sides(Path(first), Path(second))
    _refuse_itself(sides)
    map_a, map_b = (one.slope_map for one in sides)
    if cell_area_m2(map_a.x_m, map_a.y_m) < cell_area_m2(map_b.x_m, map_b.y_m):
        # The coarser grid is that of both.
        grid = map_b.x_m, map_b.y_m
        map_a = moved_map(map_a, PlaneMotion.none(), *_cut(grid, map_a))
    both = has_both(map_a) and has_both(map_b)
    placed, doubts = place_maps(map_a, map_b, both=both, as_placed=as_placed)
    moved = moved_map(map_b, placed.motion, map_a.x_m, map_a.y_m)
    # Where neither has a sigma, that of the place is no sigma of the difference.
    found = placed.found if not as_placed and (_has_sigma(map_a) or _has_sigma(map_b)) else None
    if found is not None:
        moved = with_place_errors(moved, map_b, placed.motion, found.covariance)
    change = difference_of(map_a, moved, shared)
    known = measured(change, both=both)
    count = 2 if both else 1
    if int(np.count_nonzero(known)) < 200:
        raise EstimationError(
            f"{sides[0].name} and {sides[1].name} share {np.count_nonzero(known)} measured nodes, 200 are needed: are "
            "they of one mirror?"
        )
    stated_modes = as_stated(change.common)
    values = np.stack([change.slope_x, change.slope_y])[:count]
    terms = linear_terms(change, values, known, change.common)
    stated = linear_terms(change, values, known, stated_modes)
    own = tuple(
        linear_terms(one, np.stack([one.slope_x, one.slope_y])[:count], known, one.common) for one in (map_a, moved)
    )
    fine = fine_square(map_a, moved, known, count)
    if found is not None:
        fine = fine + motion_square(moved, found.sigmas, known, count)
    rest = expected_rest(change, known, change.common, fine, count)
    checks = tuple(
        self_check(
            one.name,
            one.slope_map,
            one.summary.numbers,
            one.summary.doubts,
            measured(one.slope_map, both=has_both(one.slope_map)),
        )
        for one in sides
    )
    judged = judge(terms, stated, rest, (checks[0], checks[1]))
    left = np.full((2, *known.shape), np.nan)
    left[:count, known] = terms.rest
    maps = {
        FIRST: map_a,
        SECOND: moved,
        DIFFERENCE: change,
        REST: replace(change, slope_x=left[0], slope_y=left[1], removed="linear terms of the difference"),
    }
    cantings, of_facets = _canting_difference(sides, placed)
    every = (*doubts, *_doubts(sides, shared, judged, checks), *_doubts_of_canting(cantings), *of_facets)
    return Comparison(
        name=f"{sides[0].name} against {sides[1].name}",
        sides=sides,
        placed=placed,
        maps=maps,
        own_terms=(own[0], own[1]),
        terms=terms,
        stated=stated,
        rest=rest,
        checks=(checks[0], checks[1]),
        judgement=judged,
        cantings=cantings,
        doubts=every,
        input_sha256={
            f"{number}/{SLOPE_MAP_FILE}": next(iter(hash_files([one.folder / SLOPE_MAP_FILE]).values()))
            for number, one in enumerate(sides, start=1)
        },
    )


def _has_sigma(slope_map: SlopeMap) -> bool:
    return bool(slope_map.common.sources or (slope_map.sigma_random_x > 0).any())


def _read_sides(first: Path, second: Path) -> tuple[Side, Side]:
    folders = first, second
    for folder in folders:
        if not (folder / SUMMARY_FILE).is_file():
            raise InputError(f"{folder}: no folder of results (no {SUMMARY_FILE}); measure first")
        if not (folder / SLOPE_MAP_FILE).is_file():
            kind = read_summary(folder / SUMMARY_FILE).kind
            raise InputError(f"{folder}: results of the kind {kind!r} have no slope map ({SLOPE_MAP_FILE})")
    summaries = [read_summary(folder / SUMMARY_FILE) for folder in folders]
    # Both are of one mirror: what tells them apart is the folder.
    names = [one.resolve().name for one in folders]
    if names[0] == names[1]:
        names = [str(one) for one in folders]
    found = [
        Side(name, folder, summary, read_slope_map(folder / SLOPE_MAP_FILE))
        for name, folder, summary in zip(names, folders, summaries, strict=True)
    ]
    return found[0], found[1]


def _facet_maps(side: Side) -> dict[str, SlopeMap]:
    """Return the map of each facet of an ensemble; empty for a mirror of one."""
    file = side.folder / SLOPE_MAP_FILE
    return {name: read_slope_map(file, name) for name in facet_names(file)}


def _canting_difference(sides: tuple[Side, Side], placed: Placed) -> tuple[CantingDifference | None, tuple[Doubt, ...]]:
    """Compare the canting of facets: by their names, or where one map was moved by their places.

    Returns: The difference, and the facets of ensembles that have no part in it.
    """
    first, second = (_facet_maps(one) for one in sides)
    if not (first and second):
        return None, ()
    pairs: tuple[FacetPartner, ...] | None = None
    sigma_turn_rad, nowhere = 0.0, list[str]()
    if placed.is_moved:
        frames_a, frames_b = (facet_frames(one.summary) for one in sides)
        sigma_turn_rad = 0.0 if placed.found is None else float(placed.found.sigmas[0])
        pairs = partners(frames_a, frames_b, placed.motion)
        nowhere = [one.name for one, frames in zip(sides, (frames_a, frames_b), strict=True) if not frames]
    if nowhere:
        reasons = dict.fromkeys(first, f"{' and '.join(nowhere)} does not say where its facets stand")
    else:
        reasons = facets_left_out(first, second, pairs, sigma_turn_rad)
    cantings = canting_difference(first, second, reasons, pairs, sigma_turn_rad)
    return cantings, tuple(_doubts_of_left_out(first, cantings, reasons))


def _doubts_of_left_out(
    first: Mapping[str, SlopeMap], cantings: CantingDifference | None, reasons: Mapping[str, str]
) -> Iterator[Doubt]:
    if not reasons:
        return
    compared = 0 if cantings is None else len(cantings.names)
    said = [
        f"{sum(one == reason for one in reasons.values())} because {reason}"
        for reason in dict.fromkeys(reasons.values())
    ]
    if compared == 0 and len(reasons) < len(first):
        said.append("one alone has no others to be compared against")
    yield Doubt(
        "facets_not_compared",
        f"the canting of {compared} of {len(first)} facets is compared, of others not: {'; '.join(said)}",
        {"compared_count": compared, "facets_count": len(first)},
        Severity.NOTE,
    )


def _doubts_of_canting(cantings: CantingDifference | None) -> Iterator[Doubt]:
    if cantings is None or not cantings.probability < SIGNIFICANCE:
        return
    sigmas = np.abs(cantings.difference_rad / cantings.sigma_rad).max(axis=1)
    worst = int(np.argmax(sigmas))
    yield Doubt(
        "cantings_contradict",
        f"canting of facets contradicts: their sigmas make these differences with a probability "
        f"{f'of {cantings.probability:.2g}' if cantings.probability > _LEAST_CHANCE else f'below {_LEAST_CHANCE:g}'}, "
        f"{cantings.names[worst]} differs most ({sigmas[worst]:.3g} sigma)",
        {"canting_agreement_probability": cantings.probability, "largest_over_sigma_ratio": float(sigmas[worst])},
        Severity.SERIOUS,
    )


def _refuse_itself(sides: tuple[Side, Side]) -> None:
    same = sides[0].folder.resolve() == sides[1].folder.resolve()
    if not same:
        digests = [
            sha256(read_regular(one.folder / SLOPE_MAP_FILE, "a slope map", 4_000_000_000)).digest() for one in sides
        ]
        same = digests[0] == digests[1]
    if same:
        raise InputError(
            f"{sides[0].folder} and {sides[1].folder} are the same result; give results of two measurements"
        )


def _cut(grid: tuple[FloatArray, FloatArray], slope_map: SlopeMap) -> tuple[FloatArray, FloatArray]:
    """Return a grid with the steps of another map over the extent of this one."""
    axes = []
    for other, own in zip(grid, (slope_map.x_m, slope_map.y_m), strict=True):
        step = float(np.ptp(other)) / max(other.size - 1, 1)
        first = other[0] + step * np.ceil((own[0] - other[0]) / step - 1e-6)
        axes.append(first + step * np.arange(max(int((own[-1] - first) / step + 1e-6) + 1, 1)))
    return axes[0], axes[1]


def _doubts(
    sides: tuple[Side, Side], shared: Sequence[str], judged: Judgement, checks: tuple[SelfCheck, ...]
) -> Iterator[Doubt]:
    advice = "; name the sources that both share with --shared"
    same = shared_files(sides[0].summary, sides[1].summary, advice)
    # What they share was named where --shared says it.
    if same is not None and (same.code == "same_measurement_twice" or not shared):
        yield same
    for axis in (0, 1):
        extents = [float(np.ptp(_extent(one.slope_map, axis))) for one in sides]
        step = max(
            float(np.ptp(grid)) / max(grid.size - 1, 1)
            for grid in ((one.slope_map.x_m, one.slope_map.y_m)[axis] for one in sides)
        )
        if abs(extents[0] - extents[1]) > 2 * step:
            yield Doubt(
                "outlines_differ",
                f"the mirror is {extents[0]:.4g} m {'wide' if axis == 0 else 'high'} in {sides[0].name} and "
                f"{extents[1]:.4g} m in {sides[1].name}; compared is what both have",
                {"first_m": extents[0], "second_m": extents[1]},
                Severity.NOTE,
            )
    if judged.agreement is Agreement.UNKNOWN:
        yield Doubt(
            "no_sigma_to_compare", "neither result has a sigma: whether the difference is too large is not known"
        )
    elif judged.agreement is Agreement.WITHIN_ENLARGED:
        yield Doubt(
            "agree_within_enlarged_sigmas",
            "the two results agree only within sigmas that were enlarged because data contradict themselves; with the "
            f"sigmas as stated chance makes this difference with a probability of {judged.stated_probability:.2g}",
            {"agreement_probability": judged.stated_probability},
        )
    elif judged.agreement is Agreement.CONTRADICT:
        chance = min(one for one in (judged.terms_probability, judged.rest_probability) if np.isfinite(one))
        yield Doubt(
            "results_contradict",
            "the two results contradict each other: their sigmas make this difference with a probability "
            f"{f'of {chance:.2g}' if chance > _LEAST_CHANCE else f'below {_LEAST_CHANCE:g}'}",
            {"terms_probability": judged.terms_probability, "rest_probability": judged.rest_probability},
            Severity.SERIOUS,
        )


def _extent(slope_map: SlopeMap, axis: int) -> FloatArray:
    places = np.nonzero(slope_map.aperture.any(axis=axis))[0]
    grid = (slope_map.x_m, slope_map.y_m)[axis]
    return grid[places]
