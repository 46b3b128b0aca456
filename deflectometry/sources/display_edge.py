"""Where a mirror sees the edge of the display: pixels that mix it with what is beside the screen."""

from dataclasses import dataclass, replace

import numpy as np

from deflectometry.sources.screen_map import ScreenMap
from heliogauge.doubts import Doubt
from heliogauge.flags import SampleFlag
from heliogauge.validate import BoolArray, Float32Array

#: Share of the region's pixels, in lengths of its side, from which a line of edge pixels is no accident: a tenth.
_LEAST_LINE = 0.1
#: Differences of neighbours whose median is taken: 50,000 give it to half a per cent.
_MEDIAN_PIXELS = 50_000


@dataclass(frozen=True, slots=True, eq=False)
class DisplayEdge:
    """Pixels at the edge of the display, and which edges they see.

    screen_map: With these pixels flagged as off the screen.
    edges: Names of the edges that a line of pixels sees.
    pixels_count: Pixels that were flagged.
    """

    screen_map: ScreenMap
    edges: tuple[str, ...]
    pixels_count: int

    @property
    def words(self) -> str:
        """What it means and what to do."""
        return (
            f"part of the mirror looks past the {' and the '.join(self.edges)} edge of the display: its image ends "
            "where the screen ends, not where the mirror does. Show the pattern over a larger screen, bring the screen "
            "nearer or turn the mirror towards its middle; or give [mirror.pose], with which the rest is measured"
        )

    @property
    def doubt(self) -> Doubt | None:
        """The finding as a doubt, where there is one."""
        if not self.edges:
            return None
        return Doubt("mirror_sees_past_display", self.words, {"edge_pixels_count": self.pixels_count})


def flag_display_edge(screen_map: ScreenMap, region: BoolArray, margin_px: float) -> DisplayEdge:
    """Flag pixels that see the display's edge within a margin: they mix it with what is beside it.

    Shapes: region (h, w).
    margin_px: Half a pixel's diagonal and the blur of an edge [px].

    How far a display point moves from pixel to pixel follows from the measured points themselves.
    """
    box = _box(region)
    inside, at_edge = region[box], np.zeros(region[box].shape, dtype=np.bool_)
    good = inside & (screen_map.flags[box] == 0)
    names, count = [], max(int(np.count_nonzero(inside)), 1)
    for place, low, high in ((screen_map.u[box], "left", "right"), (screen_map.v[box], "upper", "lower")):
        per_pixel = _per_pixel(place)
        reach = margin_px * per_pixel
        # An outline that was put where the screen ends keeps its own margin: a line beyond that is seen as well.
        line = 2 * reach + per_pixel
        for name, off in ((low, place), (high, 1 - place)):
            at_edge |= good & (off < reach)
            if np.count_nonzero(good & (off < line)) > _LEAST_LINE * np.sqrt(count):
                names.append(name)
    if not at_edge.any():
        return DisplayEdge(screen_map, tuple(names), 0)
    flags = screen_map.flags.copy()
    flags[box][at_edge] |= np.uint32(SampleFlag.OFF_SCREEN)
    values = []
    for one in (screen_map.u, screen_map.v, screen_map.sigma_u, screen_map.sigma_v):
        values.append(one.copy())
        values[-1][box][at_edge] = np.nan
    u, v, sigma_u, sigma_v = values
    flagged = replace(screen_map, u=u, v=v, sigma_u=sigma_u, sigma_v=sigma_v, flags=flags)
    return DisplayEdge(flagged, tuple(names), int(np.count_nonzero(at_edge)))


def _box(region: BoolArray) -> tuple[slice, slice]:
    """Return the rows and columns that hold the region; all of them where it is empty."""
    rows, columns = np.flatnonzero(region.any(axis=1)), np.flatnonzero(region.any(axis=0))
    if not rows.size:
        return slice(None), slice(None)
    return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)


def _per_pixel(values: Float32Array) -> float:
    """Return how far the display point moves from pixel to pixel, the median over some of the image's rows."""
    step = max(1, values.size // _MEDIAN_PIXELS)
    across, down = np.diff(values[::step], axis=1), values[1::step] - values[: values.shape[0] - 1 : step]
    steps = [np.abs(one[np.isfinite(one)]) for one in (across, down)]
    usual = [float(np.median(one)) if one.size else 0.0 for one in steps]
    return float(np.hypot(usual[0], usual[1]))
