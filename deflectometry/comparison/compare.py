"""Compare two results of one mirror: aligned, differenced, with the uncertainty of the difference and a verdict."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import ClassVar

import numpy as np

from deflectometry.comparison.in_plane import (
    SAME_CORRELATION,
    FoundMotion,
    Likeness,
    find_motion,
    likeness,
    quarter_turns,
)
from deflectometry.comparison.judgement import (
    SIGNIFICANCE,
    Agreement,
    Judgement,
    SelfCheck,
    as_stated,
    focal_words,
    judge,
    self_check,
)
from deflectometry.comparison.linear_terms import (
    ExpectedRest,
    LinearTerms,
    expected_rest,
    has_both,
    linear_terms,
    measured,
)
from deflectometry.comparison.moved_map import PlaneMotion, cell_area_m2, moved_map
from heliogauge.adjust.chi_square import chi_square_cdf
from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import EstimationError, InputError
from heliogauge.files.regular import read_regular
from heliogauge.reporting.notation import number_text
from heliogauge.results.folder import SUMMARY_FILE, Summary, hash_files, read_summary, write_slope_map, write_table_csv
from heliogauge.results.frame import InstrumentResult
from heliogauge.results.opened import SLOPE_MAP_FILE
from heliogauge.results.slope_map_file import read_slope_map
from heliogauge.slopes.grid import difference
from heliogauge.slopes.map import CommonModes, SlopeMap
from heliogauge.validate import BoolArray, FloatArray

KIND = "deflectometry-compare"
MAPS_FILE, TERMS_FILE, CHECKS_FILE = "maps.nc", "terms.csv", "own_data.csv"
#: Groups of `MAPS_FILE`.
FIRST, SECOND, DIFFERENCE, REST = "first", "second", "difference", "difference without linear terms"


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """One of the two results.

    name: What the reader calls it.
    folder, summary, slope_map: Where it is, its numbers, its map.
    """

    name: str
    folder: Path
    summary: Summary
    slope_map: SlopeMap


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """How the second map was placed in the frame of the first.

    motion: From the second's frame to the first's.
    found: The motion that the fine structure gives, with its sigma; None where it gives none.
    likeness: Of the fine structures as placed.
    is_moved: Whether the second map was moved.
    """

    motion: PlaneMotion
    found: FoundMotion | None
    likeness: Likeness
    is_moved: bool


@dataclass(frozen=True, slots=True, eq=False)
class Comparison(InstrumentResult):
    """Two results of one mirror against each other.

    sides: The first and the second.
    placed: How the second was placed.
    maps: The first, the second on its grid, first minus second, and that without its linear terms.
    own_terms: Linear terms of either map's slopes.
    terms, stated: Linear terms of the difference, with all sigmas and with those as stated.
    rest: What the sigmas leave beside the linear terms.
    checks: What their own data say.
    judgement: Whether they agree.
    """

    kind: ClassVar[str] = KIND
    sides: tuple[Side, Side]
    placed: Placed
    maps: Mapping[str, SlopeMap]
    own_terms: tuple[LinearTerms, LinearTerms]
    terms: LinearTerms
    stated: LinearTerms
    rest: ExpectedRest
    checks: tuple[SelfCheck, SelfCheck]
    judgement: Judgement

    @property
    def agrees(self) -> bool:
        """Whether the two results agree within their sigmas."""
        return self.judgement.agreement in (Agreement.WITHIN, Agreement.WITHIN_ENLARGED)

    def summarise(self) -> Summary:
        """Collect the numbers of the difference with their sigmas."""
        numbers: dict[str, float | int | None] = {}
        axes = "xy"[: len(self.terms.rest)]
        for axis, rms in zip(axes, self._difference_rms(), strict=True):
            numbers[f"difference_{axis}_rms_rad"] = rms
        expected = np.sqrt(self.rest.mean_square)
        for axis, rms, one in zip(axes, self.terms.rest_rms_rad, expected, strict=True):
            numbers[f"rest_{axis}_rms_rad"] = float(rms)
            numbers[f"rest_{axis}_expected_rms_rad"] = float(one)
        for name, value, sigma, bare in zip(
            self.terms.names, self.terms.values, self.terms.sigmas, self.stated.sigmas, strict=True
        ):
            unit = unit_of_term(name)
            numbers[f"{name}_difference{unit}"] = float(value)
            numbers[f"sigma_{name}_difference{unit}"] = float(sigma)
            numbers[f"sigma_as_stated_{name}_difference{unit}"] = float(bare)
        reasons = {}
        judged = self.judgement
        for key, value in (
            ("terms_agreement_probability", judged.terms_probability),
            ("terms_as_stated_agreement_probability", judged.stated_probability),
            ("rest_agreement_probability", judged.rest_probability),
            ("fine_structure_correlation_ratio", self.placed.likeness.correlation),
        ):
            numbers[key] = value if np.isfinite(value) else None
            if not np.isfinite(value):
                reasons[key] = "no sigma" if "agreement" in key else "the fine structure is below the noise"
        if self.placed.found is not None:
            found = self.placed.found
            for name, value, sigma in zip(
                ("turn_rad", "shift_x_m", "shift_y_m"),
                (found.motion.turn_rad, *found.motion.shift_m),
                found.sigmas,
                strict=True,
            ):
                numbers[f"in_plane_{name}"], numbers[f"sigma_in_plane_{name}"] = float(value), float(sigma)
        numbers["nodes_count"] = self.terms.rest.shape[1]
        texts = {
            "first": f"{self.sides[0].name} ({self.sides[0].summary.kind})",
            "second": f"{self.sides[1].name} ({self.sides[1].summary.kind})",
            "verdict": self.verdict(),
            "placed": self.placed_words(),
            "difference": "first minus second; slopes of the normal, a beam turns by twice as much",
        }
        return self._summary(numbers, texts, reasons)

    def _difference_rms(self) -> list[float]:
        change = self.maps[DIFFERENCE]
        known = change.valid
        return [
            float(np.sqrt(np.mean(one[known] ** 2))) for one in (change.slope_x, change.slope_y)[: len(self.terms.rest)]
        ]

    def placed_words(self) -> str:
        """Say how the second map was placed in the frame of the first."""
        found = self.placed.found
        motion = self.placed.motion
        if not self.placed.is_moved:
            if found is None:
                return "both frames as they are: the slopes have no fine structure to place them by"
            offs = [
                f"{name} {number_text(value, sigma, unit)}"
                for name, value, sigma, unit in zip(
                    ("turn", "x", "y"),
                    (found.motion.turn_rad, *found.motion.shift_m),
                    found.sigmas,
                    ("rad", "m", "m"),
                    strict=True,
                )
            ]
            return f"both frames as they are (by the slopes: {', '.join(offs)})"
        sigmas = np.full(3, np.nan) if found is None else found.sigmas
        turn = np.degrees(motion.turn_rad)
        return (
            f"second map turned by {turn:.3f} +- {np.degrees(sigmas[0]):.3f} deg and moved by "
            f"{1e3 * motion.shift_m[0]:.1f} +- {1e3 * sigmas[1]:.1f} mm in x, {1e3 * motion.shift_m[1]:.1f} +- "
            f"{1e3 * sigmas[2]:.1f} mm in y, as the fine structure of the slopes has it"
        )

    def verdict(self) -> str:
        """Say in words whether the two agree, which terms contradict, and which result contradicts its own data."""
        judged, (first, second) = self.judgement, (one.name for one in self.sides)
        if judged.agreement is Agreement.UNKNOWN:
            return "neither result has a sigma: the difference is known, whether it is too large is not"
        if judged.agreement is Agreement.WITHIN:
            return f"{first} and {second} agree within their sigmas"
        said = [
            f"{first} and {second} contradict each other"
            if judged.agreement is Agreement.CONTRADICT
            else f"{first} and {second} agree only because sigmas were enlarged where data contradict themselves"
        ]
        if judged.contradicting:
            parts = ", ".join(f"{_spoken(name)} ({factor:.3g})" for name, factor in judged.contradicting.items())
            said.append(f"beyond the sigmas as stated (times sigma): {parts}")
        if (opposite := self._opposite()) != "":
            said.append(opposite)
        if judged.rest_probability < 0.5 * SIGNIFICANCE:
            said.append("what is left beside linear terms is more than the sigmas make, too")
        if judged.blamed:
            check = next(one for one in self.checks if one.name == judged.blamed)
            share = f" ({100 * judged.share:.3g} % of the squared curl of both)" if np.isfinite(judged.share) else ""
            said.append(f"{check.name} contradicts its own data{share}: {check.words()}")
        elif all(one.contradicts_itself for one in self.checks):
            said.append("both contradict their own data")
        else:
            said.append("neither contradicts its own data so that the other could be believed")
        return "; ".join(said)

    def _opposite(self) -> str:
        names = self.terms.names
        signs = [
            (one, two)
            for name, one, two in zip(names, self.own_terms[0].values, self.own_terms[1].values, strict=True)
            if name.startswith("curvature") and name in self.judgement.contradicting and one * two < 0
        ]
        if not signs:
            return ""
        focal = (focal_words(one.values, names) for one in self.own_terms)
        return "focal lengths of opposite sign: " + " against ".join(focal)

    def write_files(self, folder: Path) -> None:
        """Write maps and tables into an existing folder."""
        write_slope_map(folder / MAPS_FILE, {"": self.maps[DIFFERENCE], **self.maps}, {"name": self.name})
        write_table_csv(
            folder / TERMS_FILE,
            {
                "term": self.terms.names,
                "unit": ["rad" if unit_of_term(name) == "_rad" else "1/m" for name in self.terms.names],
                "first": self.own_terms[0].values,
                "sigma_first": self.own_terms[0].sigmas,
                "second": self.own_terms[1].values,
                "sigma_second": self.own_terms[1].sigmas,
                "difference": self.terms.values,
                "sigma_difference": self.terms.sigmas,
                "sigma_difference_as_stated": self.stated.sigmas,
                "contradicts": ["yes" if name in self.judgement.contradicting else "" for name in self.terms.names],
            },
        )
        fields = ("curl_per_m", "sigma_curl_per_m", "smooth_curl_per_m", "smooth_curl_ratio", "turn_rad")
        columns: dict[str, Sequence[object]] = {"result": [one.name for one in self.checks]}
        columns |= {name: [getattr(one, name) for one in self.checks] for name in fields}
        columns["serious_doubts"] = [" / ".join(one.serious) for one in self.checks]
        write_table_csv(folder / CHECKS_FILE, columns)

    def headline(self) -> str:
        """Return the most important numbers in a few lines for the terminal."""
        first, second = (one.name for one in self.sides)
        rms = "   ".join(f"{axis} {1e3 * one:.3f}" for axis, one in zip("xy", self._difference_rms(), strict=False))
        rest = "   ".join(
            f"{axis} {1e3 * one:.3f} (sigmas make {1e3 * two:.3f})"
            for axis, one, two in zip("xy", self.terms.rest_rms_rad, np.sqrt(self.rest.mean_square), strict=False)
        )
        lines = [
            f"{first} minus {second}, slopes of the normal at {self.terms.rest.shape[1]} nodes",
            f"  as they are        RMS {rms} mrad",
            f"  beside linear terms RMS {rest} mrad",
        ]
        for name, value, sigma, bare in zip(
            self.terms.names, self.terms.values, self.terms.sigmas, self.stated.sigmas, strict=True
        ):
            unit = "mrad" if unit_of_term(name) == "_rad" else "mrad/m"
            own = [float(one.values[self.terms.names.index(name)]) * 1e3 for one in self.own_terms]
            lines.append(
                f"  {_spoken(name):18s} {own[0]:.3f} against {own[1]:.3f}: {1e3 * value:.3f} +- {1e3 * sigma:.3f} "
                f"{unit} (+- {1e3 * bare:.3f} as stated)"
            )
        lines += [f"  own data of {one.name}: {one.words()}" for one in self.checks]
        lines += [f"  {self.placed_words()}", f"  verdict: {self.verdict()}"]
        return "\n".join(lines)


def _spoken(name: str) -> str:
    return name.replace("_", " ")


def unit_of_term(name: str) -> str:
    """Return the ending of the key of a linear term."""
    return "_rad" if name.startswith("tilt") else "_per_m"


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
    placed, doubts = _place(map_a, map_b, both=both, as_placed=as_placed)
    moved = moved_map(map_b, placed.motion, map_a.x_m, map_a.y_m)
    change = _difference(map_a, moved, shared)
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
    fine = _fine_square(map_a, moved, known, count) + _motion_square(moved, placed, known, count)
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
    every = (*doubts, *_doubts(sides, shared, judged, checks))
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
        doubts=every,
        input_sha256={
            f"{number}/{SLOPE_MAP_FILE}": next(iter(hash_files([one.folder / SLOPE_MAP_FILE]).values()))
            for number, one in enumerate(sides, start=1)
        },
    )


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


def _place(map_a: SlopeMap, map_b: SlopeMap, *, both: bool, as_placed: bool) -> tuple[Placed, tuple[Doubt, ...]]:
    """Find where the second map stands in the frame of the first."""
    unknown = Likeness(float("nan"), float("nan"), float("nan"))
    if not both:
        note = Doubt(
            "frames_not_compared",
            "one of the maps has slopes in x only: both frames are taken as they are",
            severity=Severity.NOTE,
        )
        return Placed(PlaneMotion.none(), None, unknown, is_moved=False), (note,)
    start, here, doubts = PlaneMotion.none(), unknown, []
    try:
        here = likeness(map_a, map_b, start)
    except EstimationError:
        # Frames with origins far apart.
        here = unknown
    if not as_placed and not here.correlation > SAME_CORRELATION:
        candidates = [(one, _likeness_or_none(map_a, map_b, one)) for one in quarter_turns(map_a, map_b)]
        known = [(one, like) for one, like in candidates if like is not None and like.correlation > SAME_CORRELATION]
        if known:
            start, here = max(known, key=lambda one: one[1].correlation)
    if np.isfinite(here.correlation) and not here.correlation > SAME_CORRELATION:
        doubts.append(_unlike(map_a, map_b, here))
    if not here.correlation > SAME_CORRELATION:
        if not doubts:
            doubts.append(
                Doubt(
                    "frames_not_compared",
                    "the fine structure of the slopes is below its noise: both frames are taken as they are, and "
                    "whether the maps are of one mirror is not checked",
                    severity=Severity.NOTE,
                )
            )
        return Placed(start, None, here, is_moved=start.turn_rad != 0), tuple(doubts)
    try:
        found = find_motion(map_a, map_b, start)
    except EstimationError:
        found = None
    if found is None or as_placed:
        return Placed(start, found, here, is_moved=start.turn_rad != 0), tuple(doubts)
    step = np.array([found.motion.turn_rad - start.turn_rad, *(found.motion.shift_m - start.shift_m)])
    chi_square = float(step @ np.linalg.solve(found.covariance, step))
    moves = 1 - chi_square_cdf(chi_square, 3) < SIGNIFICANCE
    if not moves and start.turn_rad == 0 and not start.shift_m.any():
        return Placed(start, found, here, is_moved=False), tuple(doubts)
    placed = Placed(found.motion, found, found.likeness, is_moved=True)
    doubts.append(
        Doubt(
            "frames_differ",
            f"the frames of the two maps differ by {np.degrees(found.motion.turn_rad):.3f} deg, "
            f"{1e3 * found.motion.shift_m[0]:.1f} mm in x and {1e3 * found.motion.shift_m[1]:.1f} mm in y, by the fine "
            "structure of their slopes: the second was moved by that (--as-placed leaves it)",
            {
                "turn_rad": found.motion.turn_rad,
                "shift_x_m": float(found.motion.shift_m[0]),
                "shift_y_m": float(found.motion.shift_m[1]),
            },
            Severity.NOTE,
        )
    )
    return placed, tuple(doubts)


def _likeness_or_none(map_a: SlopeMap, map_b: SlopeMap, motion: PlaneMotion) -> Likeness | None:
    try:
        return likeness(map_a, map_b, motion)
    except EstimationError:
        return None


def _unlike(map_a: SlopeMap, map_b: SlopeMap, here: Likeness) -> Doubt:
    """Say that the fine structures have nothing in common, or only when one map is mirrored."""
    mirrored = replace(
        map_b,
        x_m=-map_b.x_m[::-1],
        **{
            name: getattr(map_b, name)[:, ::-1] * (-1 if name in ("slope_x", "design_slope_x") else 1)
            for name in ("slope_x", "slope_y", "design_slope_x", "design_slope_y", "sigma_random_x", "sigma_random_y")
        },
        flags=map_b.flags[:, ::-1],
        aperture=map_b.aperture[:, ::-1],
        height_m=map_b.height_m[:, ::-1],
    )
    found = [_likeness_or_none(map_a, mirrored, one) for one in quarter_turns(map_a, mirrored)]
    best = max((one.correlation for one in found if one is not None and np.isfinite(one.correlation)), default=0.0)
    if best > SAME_CORRELATION:
        return Doubt(
            "map_is_mirrored",
            f"the fine structures agree (correlation {best:.2f}) only where one of the maps is mirrored: one was seen "
            "from behind, or one of its axes has the other sign; put that right and compare again",
            {"correlation_ratio": best},
            Severity.SERIOUS,
        )
    return Doubt(
        "different_mirrors",
        f"the fine structures of the slopes have nothing in common (correlation {here.correlation:.2f}, 1 for one "
        f"mirror), though each is above its noise ({1e3 * here.structure_a_rad:.3g} and "
        f"{1e3 * here.structure_b_rad:.3g} mrad RMS): are these results of one mirror?",
        {"correlation_ratio": here.correlation},
        Severity.SERIOUS,
    )


def _difference(map_a: SlopeMap, map_b: SlopeMap, shared: Sequence[str]) -> SlopeMap:
    """Return a minus b with both common shares; those of shared sources are subtracted."""
    change = difference(map_a, map_b)
    sources_a, sources_b = map_a.common.sources, map_b.common.sources
    if not shared:
        return change
    coefficients, kept, names = change.common.coefficients, [], []
    taken: set[int] = set()
    for source in dict.fromkeys(shared):
        of_a = [k for k, name in enumerate(sources_a) if name == source]
        of_b = [k + len(sources_a) for k, name in enumerate(sources_b) if name == source]
        if len(of_a) != len(of_b) or not of_a:
            known = ", ".join(sorted({*sources_a} & {*sources_b})) or "none"
            raise InputError(
                f"--shared {source!r}: the first map has {len(of_a)} common errors of this source, the second "
                f"{len(of_b)}; sources of both: {known}"
            )
        for one, other in zip(of_a, of_b, strict=True):
            kept.append(coefficients[one] - coefficients[other])
            names.append(source)
        taken |= {*of_a, *of_b}
    for k, name in enumerate(change.common.sources):
        if k not in taken:
            kept.append(coefficients[k])
            names.append(name)
    common = CommonModes(tuple(names), np.stack(kept), change.common.center_m, change.common.scale_m)
    return replace(change, common=common)


def _fine_square(map_a: SlopeMap, map_b: SlopeMap, known: BoolArray, count: int) -> FloatArray:
    """Return what the relative errors of both fine structures add to the difference, mean square of each component."""
    found = np.zeros(count)
    for one in (map_a, map_b):
        values = np.stack([one.slope_x, one.slope_y])[:count]
        rest = linear_terms(one, values, known, as_stated(one.common)).rest
        found += one.fine_share[:count] ** 2 * np.mean(rest**2, axis=1)
    return found


def _motion_square(map_b: SlopeMap, placed: Placed, known: BoolArray, count: int) -> FloatArray:
    """Return what the uncertain place of the second map adds, mean square of each component."""
    if placed.found is None or not placed.is_moved:
        return np.zeros(count)
    found = np.zeros(count)
    for k, values in enumerate((map_b.slope_x, map_b.slope_y)[:count]):
        for axis, grid, sigma in ((1, map_b.x_m, placed.found.sigmas[1]), (0, map_b.y_m, placed.found.sigmas[2])):
            slope = np.gradient(np.where(known, values, np.nan), grid, axis=axis)
            found[k] += float(np.nanmean(slope**2)) * sigma**2
    return found


def _doubts(
    sides: tuple[Side, Side], shared: Sequence[str], judged: Judgement, checks: tuple[SelfCheck, ...]
) -> Iterator[Doubt]:
    hashes = [one.summary.input_sha256 for one in sides]
    common = sorted({name for name, digest in hashes[0].items() if digest in set(hashes[1].values())})
    if common and {*hashes[0].values()} == {*hashes[1].values()}:
        yield Doubt(
            "same_measurement_twice",
            "both results were evaluated from the same files: their noise is the same, and no sigma here applies; "
            "compare results of two measurements",
        )
    elif common and not shared:
        names = ", ".join(common[:3]) + (f" and {len(common) - 3} more" if len(common) > 3 else "")
        yield Doubt(
            "inputs_shared",
            f"both results read {names}: what is wrong with that is in both and partly cancels, so that sigmas of the "
            "difference are upper bounds; name the sources that both share with --shared",
            {"files_count": len(common)},
            Severity.NOTE,
        )
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
            {"probability": judged.stated_probability},
        )
    elif judged.agreement is Agreement.CONTRADICT:
        yield Doubt(
            "results_contradict",
            "the two results contradict each other: their sigmas make this difference with a probability of "
            f"{min(one for one in (judged.terms_probability, judged.rest_probability) if np.isfinite(one)):.2g}",
            {"terms_probability": judged.terms_probability, "rest_probability": judged.rest_probability},
            Severity.SERIOUS,
        )


def _extent(slope_map: SlopeMap, axis: int) -> FloatArray:
    places = np.nonzero(slope_map.aperture.any(axis=axis))[0]
    grid = (slope_map.x_m, slope_map.y_m)[axis]
    return grid[places]
