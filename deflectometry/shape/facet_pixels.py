"""The pixels of each facet that find its smooth shape: which facets show fringes, some of their pixels, their rays."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from deflectometry.setup.camera_and_screen import Setup
from deflectometry.shape.smooth_shape import FacetSamples, RoundLimits, ShapeSolution, solve_shape
from deflectometry.sources.screen_map import ScreenMap
from heliogauge.doubts import Doubt
from heliogauge.errors import EstimationError
from heliogauge.flags import FLAG_TEXTS, SampleFlag, count_flags
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet
from heliogauge.validate import BoolArray, Float32Array, FloatArray, IntArray

#: Pixels that find the smooth shape of a facet: with 2000 the coefficients of degree 4 are known 30 times better than
#: a single pixel.
SHAPE_PIXELS = 2000
#: Pixels that decide the tilt at last: it is the mean of a rough surface, 2000 pixels of 0.5 mrad leave 0.011 mrad.
ALIGN_PIXELS = 16000
#: A facet with fewer usable pixels than this determines no shape of degree 4.
FEWEST_PIXELS = 60


@dataclass(frozen=True, slots=True, eq=False)
class PixelSamples:
    """Some pixels of one facet as they were measured.

    pixels_px (n, 2): Pixel positions (x, y) [px].
    u, v (n,): Display coordinates seen there.
    """

    facet: Facet
    pixels_px: FloatArray
    u: Float32Array | FloatArray
    v: Float32Array | FloatArray


def spread_indices(count: int, most: int) -> IntArray:
    """Pick indices spread evenly over all, but not in step with any row length.

    One from each of `most` equal parts, its place within the part from the golden ratio. Every k-th pixel would do
    for a round mirror; of one that fills 800 x 1000 px exactly it takes pixels of two columns only.
    """
    if count <= most:
        return np.arange(count)
    part = np.arange(most)
    return np.unique(((part + part * 0.6180339887498949 % 1.0) * (count / most)).astype(np.intp))


@dataclass(frozen=True, slots=True, eq=False)
class UsableFacets:
    """Facets that show fringes: their numbers, some of their pixels, and why others were left out."""

    numbers: list[int]
    samples: list[PixelSamples]
    doubts: list[Doubt]


def usable_facets(facets: Sequence[Facet], screen_map: ScreenMap, facet_index: npt.NDArray[np.int16]) -> UsableFacets:
    """Pick the facets that show fringes, with some of their pixels."""
    found = UsableFacets([], [], [])
    for index, facet in enumerate(facets):
        region = facet_index == index
        usable = np.flatnonzero(region & (screen_map.flags == 0))
        if usable.size < FEWEST_PIXELS:
            numbers = {"usable_pixels_count": usable.size, "pixels_count": int(np.count_nonzero(region))}
            found.doubts.append(Doubt("facet_not_measured", _why_not(facet, region, screen_map), numbers))
            continue
        most = max(ALIGN_PIXELS // len(facets), SHAPE_PIXELS)
        chosen = usable[spread_indices(usable.size, most)]
        row, column = np.divmod(chosen, facet_index.shape[1])
        pixels = screen_map.grid.pixels_px(row, column)
        found.numbers.append(index)
        found.samples.append(PixelSamples(facet, pixels, screen_map.u.flat[chosen], screen_map.v.flat[chosen]))
    if not found.samples:
        raise EstimationError(_why_not(facets[0], facet_index == 0, screen_map))
    return found


def _why_not(facet: Facet, region: BoolArray, screen_map: ScreenMap) -> str:
    total = int(np.count_nonzero(region))
    if total == 0:
        return f"facet {facet.name} fills no pixel of the image; check the mirror's pose"
    counts = count_flags(screen_map.flags, region)
    if not counts:
        return f"facet {facet.name} has {total} px, {FEWEST_PIXELS} are needed: come nearer, or take a longer lens"
    reasons = ", ".join(f"{FLAG_TEXTS[flag]} ({count} px)" for flag, count in counts.items())
    remedy = "check screen, exposure and pattern"
    if SampleFlag.OFF_SCREEN in counts:
        remedy = "show the pattern over a larger screen or move the mirror"
    elif max(counts, key=lambda flag: counts[flag]) is SampleFlag.FRINGE_ORDER_UNCERTAIN:
        remedy = (
            "add fringes of fewer periods: one set below 1, each next at most about six times finer; or, for images "
            "taken already, say which point of the display one pixel of this facet sees ([pattern.known_point])"
        )
    return f"facet {facet.name} was not measured: of its {total} px {reasons}; {remedy}"


def solve_shape_of_pixels(
    setup: Setup, samples: Sequence[PixelSamples], start: RigidTransform, *, align: bool
) -> ShapeSolution:
    """Find shape and tilt with a part of the pixels, then with all that were picked."""
    part = trace_samples(setup, [thinned(sample, SHAPE_PIXELS) for sample in samples])
    solution = solve_shape(part, start, align=align)
    # Two rounds from there: what the further pixels change is small, and its square is nothing.
    rest = RoundLimits(outer=2, must_settle=False)
    return solve_shape(
        trace_samples(setup, samples), solution.cam_from_mirror, align=align, start=solution, rounds=rest
    )


def thinned(sample: PixelSamples, most: int) -> PixelSamples:
    """Return at most so many of the pixels, spread evenly."""
    chosen = spread_indices(len(sample.pixels_px), most)
    return replace(sample, pixels_px=sample.pixels_px[chosen], u=sample.u[chosen], v=sample.v[chosen])


def trace_samples(setup: Setup, samples: Sequence[PixelSamples]) -> list[FacetSamples]:
    """Turn pixels and display coordinates into lines of sight and screen points, in the camera frame."""
    traced = []
    for sample in samples:
        points = setup.screen.points_m(sample.u, sample.v)
        rays = setup.camera.cast_rays(sample.pixels_px)
        traced.append(
            FacetSamples(sample.facet, np.ascontiguousarray(rays.T), setup.cam_from_screen.apply(points).T.copy())
        )
    return traced
