"""A measured mirror as a whole system of SolTrace: facets with measured slopes, sun, optics, tube or target."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from heliogauge.errors import InputError
from heliogauge.measurement.writer import write_text
from heliogauge.results.slope_export import soltrace_text, words_of_design_along
from heliogauge.results.slope_map_file import read_slope_map, slope_map_in
from heliogauge.results.soltrace_files import write_system
from heliogauge.results.sun_tables import read_sun
from heliogauge.results.used_results import serious_result
from heliogauge.slopes.map import SlopeMap, monomials
from heliogauge.slopes.normal_angles import normal_angles
from heliogauge.sunlight.soltrace_system import Optic, OpticPair, SolTraceSystem, SystemElement, SystemStage, SystemSun
from heliogauge.sunlight.sun_shapes import GaussianSun, PillboxSun, SunShape
from heliogauge.validate import BoolArray, FloatArray

MIRROR, ABSORBER = "mirror", "absorber"
#: SolTrace looks through all points of a surface for each ray: files of real VSHOT scans have some thousand.
USUAL_POINTS = 4000
#: An outline that fills less of the rectangle around it is not one.
_RECTANGLE_SHARE, _CIRCLE_SHARE = 0.98, 0.02
#: Parts of a map with fewer nodes are specks beside a mirror.
_FEWEST_NODES = 30


@dataclass(frozen=True, slots=True, eq=False)
class SystemChoices:
    """What a system needs beside the measured mirror.

    sun: "pillbox:4.65", "gaussian:2.73" [mrad], or a ``.sun`` file.
    sun_direction (3,): Direction to the sun in the frame of the map.
    reflectance: Of the mirror.
    specularity_rad: RMS of the reflected beam in one direction [rad].
    tube_diameter_m, tube_height_m: Absorber tube along y at this height over the vertex; 0 without one [m].
    target_distance_m, target_size_m: Square target across z; 0 without one [m].
    points: Most points of each slope file.
    """

    sun: str = "pillbox:4.65"
    sun_direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    reflectance: float = 1.0
    specularity_rad: float = 0.0
    tube_diameter_m: float = 0.0
    tube_height_m: float = 0.0
    target_distance_m: float = 0.0
    target_size_m: float = 0.0
    points: int = USUAL_POINTS


def export_system(result: Path, out: Path, choices: SystemChoices, *, force: bool = False) -> list[str]:
    """Write the mirror of a folder of results as a system of SolTrace, with a slope file for each facet beside it.

    result: Folder with ``slope_map.nc``.
    out: The ``.stinput`` file.
    Returns: What was written, and what SolTrace cannot express, in sentences.
    InputError: No slope map, nothing in it, a choice that cannot be meant, or a file that is there.
    """
    file = slope_map_in(result)
    if out.suffix.lower() != ".stinput":
        raise InputError(f"{out}: SolTrace knows a system by its ending; name it {out.with_suffix('.stinput').name}")
    slope_map = read_slope_map(file)
    parts = list(facet_maps(slope_map))
    if not parts:
        raise InputError(f"{file}: no node has a slope, so there is nothing to export")
    names = [f"{out.stem}_{number}.sht" for number in range(1, len(parts) + 1)]
    there = [name for name in (out.name, *names) if (out.parent / name).exists()]
    if there and not force:
        raise InputError(f"{out.parent / there[0]}: the file exists already; give force=True to replace it")
    sun = SystemSun(sun_of_words(choices.sun), _direction(choices.sun_direction))
    found = [
        _facet(part, name, number, choices) for number, (part, name) in enumerate(zip(parts, names, strict=True), 1)
    ]
    extra = list(_catchers(choices))
    dark = Optic(0.0)
    optics = [OpticPair(one.optics.name, one.optics.front, one.optics.back) for one in found]
    optics += [OpticPair(ABSORBER, dark, dark)] if extra else []
    elements = (*(one.element for one in found), *extra)
    system = SolTraceSystem(sun, tuple(optics), (SystemStage("measured mirror", elements),))
    serious = serious_result(result)
    out.parent.mkdir(parents=True, exist_ok=True)
    for name, one in zip(names, found, strict=True):
        write_text(out.parent / name, one.text)
    write_system(out, system)
    said = [
        f"{len(found)} facets with measured slopes ({', '.join(names[:3])}{', ...' if len(names) > 3 else ''}): {out}"
    ]
    said += [f"{one.element.comment}: {reason}" for one in found for reason in one.reasons]
    said += list(_what_is_left_out(slope_map, choices))
    if serious is not None:
        said.append(f"serious: {serious}")
    return said


def facet_maps(slope_map: SlopeMap) -> Iterator[SlopeMap]:
    """Yield the parts of a map's mirror that do not touch each other, from below to above, then from left to right."""
    count, labels = cv2.connectedComponents(slope_map.aperture.astype(np.uint8), connectivity=4)
    parts: list[tuple[float, float, SlopeMap]] = []
    for number in range(1, count):
        mine = labels == number
        rows, columns = np.nonzero(mine)
        if np.count_nonzero(mine & slope_map.valid) < _FEWEST_NODES:
            continue
        parts.append(
            (
                round(float(slope_map.y_m[rows].mean()), 2),
                float(slope_map.x_m[columns].mean()),
                replace(slope_map, aperture=mine),
            )
        )
    yield from (part for _, _, part in sorted(parts, key=lambda one: one[:2]))


@dataclass(frozen=True, slots=True, eq=False)
class _WrittenFacet:
    """A facet as it is written: element, optics, slope file, and what it cannot say."""

    element: SystemElement
    optics: OpticPair
    text: str
    reasons: tuple[str, ...]


def _facet(slope_map: SlopeMap, file: str, number: int, choices: SystemChoices) -> _WrittenFacet:
    rows, columns = np.nonzero(slope_map.aperture)
    x, y = slope_map.x_m[columns], slope_map.y_m[rows]
    steps = [float(np.ptp(grid)) / max(grid.size - 1, 1) for grid in (slope_map.x_m, slope_map.y_m)]
    middle = np.array([0.5 * (x.min() + x.max()), 0.5 * (y.min() + y.max())])
    width, height = float(np.ptp(x)) + steps[0], float(np.ptp(y)) + steps[1]
    aperture, sizes, reason = _outline(slope_map.aperture, x - middle[0], y - middle[1], width, height, steps)
    # A canted facet of an ensemble hangs on the height of its middle; slopes hold how it is canted.
    across_only = words_of_design_along(slope_map)
    slope_map = slope_map.with_both_slopes()
    level = _height_at(slope_map, middle)
    points, scatter = _averaged(slope_map, middle, choices.points)
    text, surface = soltrace_text(*points, across_only)
    reasons = [reason] if reason else []
    heights = _off_heights(slope_map, middle, level, surface)
    if heights > 1e-4:
        reasons.append(
            f"SolTrace's height is a polynomial of degree 4; the map's is {1e3 * heights:.2g} mm RMS beside it"
        )
    if slope_map.measured_share < 0.999:
        hole = 100 * (1 - slope_map.measured_share)
        reasons.append(f"{hole:.1f} % was not measured; SolTrace takes the slopes of the nearest points")
    if scatter > 0:
        reasons.append(
            f"{int(np.count_nonzero(slope_map.valid))} nodes became {len(points[0])} points; what the means took out, "
            f"{1e3 * scatter:.3g} mrad RMS, is the slope error of its optics"
        )
    name = f"{MIRROR} {number}"
    front = Optic(choices.reflectance, 0.0, scatter, choices.specularity_rad)
    element = SystemElement(
        np.array([*middle, level]),
        np.array([*middle, level + 1.0]),
        0.0,
        aperture,
        sizes,
        "v",
        (),
        file,
        name,
        comment=f"facet {number}",
    )
    return _WrittenFacet(element, OpticPair(name, front, Optic(0.0)), text, tuple(reasons))


def _outline(
    inside: BoolArray, x: FloatArray, y: FloatArray, width: float, height: float, steps: list[float]
) -> tuple[str, tuple[float, ...], str]:
    share = float(np.count_nonzero(inside)) * steps[0] * steps[1] / (width * height)
    if share >= _RECTANGLE_SHARE:
        return "r", (width, height), ""
    diameter = 2 * float(np.hypot(x, y).max())
    if abs(share * width * height / (0.25 * np.pi * diameter**2) - 1) < _CIRCLE_SHARE:
        return "c", (diameter,), ""
    words = f"its outline fills {100 * share:.0f} % of the rectangle around it, which SolTrace has instead"
    return "r", (width, height), words


def _height_at(slope_map: SlopeMap, place_m: FloatArray) -> float:
    """Return the map's height at the measured node nearest to a place, carried there by its slopes; 0 without one."""
    known = slope_map.valid & np.isfinite(slope_map.height_m)
    if not known.any():
        return 0.0
    x, y = np.meshgrid(slope_map.x_m, slope_map.y_m)
    away = np.where(known, np.hypot(x - place_m[0], y - place_m[1]), np.inf)
    row, column = np.unravel_index(int(away.argmin()), away.shape)
    step = place_m - np.array([slope_map.x_m[column], slope_map.y_m[row]])
    slopes = slope_map.slope_x[row, column], slope_map.slope_y[row, column]
    return float(slope_map.height_m[row, column] + step @ slopes)


def _averaged(
    slope_map: SlopeMap, middle_m: FloatArray, most: int
) -> tuple[tuple[FloatArray, FloatArray, FloatArray, FloatArray], float]:
    """Return means of slopes over blocks of nodes, at most so many, and the RMS in one direction that they take out."""
    known = slope_map.valid
    rows, columns = np.nonzero(known)
    x, y = slope_map.x_m[columns] - middle_m[0], slope_map.y_m[rows] - middle_m[1]
    slopes = np.stack([slope_map.slope_x[known], slope_map.slope_y[known]])
    side = int(np.ceil(np.sqrt(rows.size / most)))
    if side <= 1:
        return (x, y, slopes[0], slopes[1]), 0.0
    block = (rows // side) * (slope_map.x_m.size // side + 1) + columns // side
    _, number, counts = np.unique(block, return_inverse=True, return_counts=True)

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(number, values) / counts)

    means = [mean(one) for one in (x, y, slopes[0], slopes[1])]
    # The angle of the normal, as SolTrace's slope error is one; the design's own change within a block is no scatter.
    design = np.stack([slope_map.design_slope_x[known], slope_map.design_slope_y[known]])
    errors = normal_angles(slopes[0], slopes[1], design[0], design[1])
    left = errors - np.stack([mean(one)[number] for one in errors])
    return (means[0], means[1], means[2], means[3]), float(np.sqrt(np.mean(left**2)))


def _off_heights(slope_map: SlopeMap, middle_m: FloatArray, level_m: float, surface: FloatArray) -> float:
    known = slope_map.valid & np.isfinite(slope_map.height_m)
    if not known.any():
        return 0.0
    rows, columns = np.nonzero(known)
    degree = int((np.sqrt(8 * surface.size + 1) - 3) / 2)
    terms = monomials(slope_map.x_m[columns] - middle_m[0], slope_map.y_m[rows] - middle_m[1], degree)
    return float(np.sqrt(np.mean((surface @ terms + level_m - slope_map.height_m[known]) ** 2)))


def _catchers(choices: SystemChoices) -> Iterator[SystemElement]:
    if choices.tube_diameter_m > 0:
        radius, top = 0.5 * choices.tube_diameter_m, choices.tube_height_m + 0.5 * choices.tube_diameter_m
        if not choices.tube_height_m > 0:
            raise InputError("tube_height_m: the height of the tube's axis over the vertex is needed")
        # SolTrace's cylinder goes through its origin and lies on the side of its z axis.
        yield SystemElement(
            np.array([0.0, 0.0, top]),
            np.zeros(3),
            0.0,
            "l",
            (0.0, 0.0, _TUBE_LENGTH_M),
            "t",
            (1 / radius,),
            "",
            ABSORBER,
            comment="absorber tube",
        )
    if choices.target_distance_m > 0:
        if not choices.target_size_m > 0:
            raise InputError("target_size_m: the side of the square target is needed")
        size = choices.target_size_m
        place = np.array([0.0, 0.0, choices.target_distance_m])
        yield SystemElement(place, np.zeros(3), 0.0, "r", (size, size), "f", (), "", ABSORBER, comment="target")


#: Longer than every module, so that no ray leaves beside its end.
_TUBE_LENGTH_M = 200.0


def sun_of_words(words: str) -> SunShape:
    """Return the sun shape that a choice names.

    words: "pillbox:4.65", "gaussian:2.73" [mrad], or a ``.sun`` file.
    InputError: None of them.
    """
    kind, found, number = words.partition(":")
    if found and kind in ("pillbox", "gaussian"):
        try:
            size = 1e-3 * float(number)
        except ValueError:
            raise InputError(f"sun={words}: a number of mrad is needed after the colon") from None
        return PillboxSun(size) if kind == "pillbox" else GaussianSun(size)
    if words.lower().endswith(".sun"):
        return read_sun(Path(words))
    raise InputError(f"sun={words}: pillbox:MRAD, gaussian:MRAD or a file .sun is needed")


def _direction(values: tuple[float, float, float]) -> FloatArray:
    direction = np.asarray(values, dtype=np.float64)
    if not (np.isfinite(direction).all() and direction[2] > 0):
        raise InputError("sun_direction: a direction in front of the mirror (z above zero) is needed")
    return 100 * direction / float(np.linalg.norm(direction))


def _what_is_left_out(slope_map: SlopeMap, choices: SystemChoices) -> Iterator[str]:
    yield "not in the file: sigmas of the slopes, for which SolTrace has no place; slope_map.nc keeps them"
    if along := words_of_design_along(slope_map):
        yield along
    noise = float(np.sqrt(np.nanmean(slope_map.sigma_random_x[slope_map.valid] ** 2)))
    if noise > 0:
        yield f"in the file: the noise of the slopes, {1e3 * noise:.3g} mrad RMS; it widens the beam as slope errors do"
    if choices.tube_diameter_m > 0:
        yield "not in the file: glass envelope, bellows and bends of the absorber; the tube is straight and black"
    if not (choices.tube_diameter_m > 0 or choices.target_distance_m > 0):
        yield "neither tube nor target was asked for (tube_diameter_mm, target_distance_m): rays end at the mirror"
