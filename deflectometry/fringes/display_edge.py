"""Where a mirror sees the edge of the display: pixels that mix it with what is beside the screen."""

from dataclasses import dataclass, replace

import numpy as np

from deflectometry.fringes.screen_map import ScreenMap
from heliogauge.doubts import Doubt
from heliogauge.flags import SampleFlag
from heliogauge.validate import BoolArray, Float32Array

#: Share of the region's pixels, in lengths of its side, from which a line of edge pixels is no accident: a tenth.
_LEAST_LINE = 0.1


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
    at_edge = np.zeros(region.shape, dtype=np.bool_)
    names, count = [], max(int(np.count_nonzero(region)), 1)
    for place, low, high in ((screen_map.u, "left", "right"), (screen_map.v, "upper", "lower")):
        reach = margin_px * _per_pixel(place)
        good = region & (screen_map.flags == 0)
        # An outline that was put where the screen ends keeps its own margin: a line beyond that is seen as well.
        line = 2 * reach + _per_pixel(place)
        for name, off in ((low, place), (high, 1 - place)):
            at_edge |= good & (off < reach)
            if np.count_nonzero(good & (off < line)) > _LEAST_LINE * np.sqrt(count):
                names.append(name)
    flags = screen_map.flags | np.where(at_edge, np.uint32(SampleFlag.OFF_SCREEN), np.uint32(0))
    u, v, sigma_u, sigma_v = (
        np.where(at_edge, np.float32(np.nan), one)
        for one in (screen_map.u, screen_map.v, screen_map.sigma_u, screen_map.sigma_v)
    )
    flagged = replace(screen_map, u=u, v=v, sigma_u=sigma_u, sigma_v=sigma_v, flags=flags.astype(np.uint32))
    return DisplayEdge(flagged if at_edge.any() else screen_map, tuple(names), int(np.count_nonzero(at_edge)))


def _per_pixel(values: Float32Array) -> float:
    """Return how far the display point moves from pixel to pixel, the median over the image."""
    across, down = np.diff(values, axis=1), np.diff(values, axis=0)
    steps = [np.abs(one[np.isfinite(one)]) for one in (across, down)]
    usual = [float(np.median(one)) if one.size else 0.0 for one in steps]
    return float(np.hypot(usual[0], usual[1]))
