"""Pixels that see the edge of the display: which, at which edge, and none beside the mirror."""

import numpy as np
import pytest

from deflectometry.sources.display_edge import flag_display_edge
from deflectometry.sources.noise_model import NoiseModel
from deflectometry.sources.screen_map import ScreenMap
from heliogauge.flags import SampleFlag

ROWS, COLUMNS = 40, 60
#: The display moves by so much from pixel to pixel, along x for u and along y for v.
STEP_U, STEP_V = 0.006, 0.008
REGION = np.zeros((ROWS, COLUMNS), dtype=np.bool_)
REGION[5:36, 7:50] = True
INSIDE = np.s_[5:36, 7:50]


def map_from(low_u: float, low_v: float) -> ScreenMap:
    """A mirror whose first pixel (row 5, column 7) sees the fractions given, on a display of 1."""
    row, column = np.mgrid[:ROWS, :COLUMNS].astype(np.float32)
    u, v = low_u + STEP_U * (column - 7), low_v + STEP_V * (row - 5)
    flags = np.where(REGION, 0, int(SampleFlag.OUTSIDE_MIRROR)).astype(np.uint32)
    values = [
        np.where(REGION, one, np.nan).astype(np.float32) for one in (u, v, 0 * u + 1e-4, 0 * u + 1e-4, 0 * u + 50)
    ]
    return ScreenMap(*values, flags, NoiseModel(1.0))


def flagged(found: ScreenMap) -> np.ndarray:
    return (found.flags[INSIDE] & np.uint32(SampleFlag.OFF_SCREEN)) != 0


def test_in_the_middle_of_the_display_there_is_no_edge() -> None:
    seen = map_from(0.3, 0.3)
    found = flag_display_edge(seen, REGION, 1.0)
    assert found.screen_map is seen
    assert (found.edges, found.pixels_count, found.doubt) == ((), 0, None)


@pytest.mark.parametrize(
    ("low_u", "low_v", "edge", "lines"),
    [
        (0.0, 0.3, "left", np.s_[:, :2]),
        (1 - 42 * STEP_U, 0.3, "right", np.s_[:, -2:]),
        (0.3, 0.0, "upper", np.s_[:2]),
        (0.3, 1 - 30 * STEP_V, "lower", np.s_[-2:]),
    ],
)
def test_pixels_within_the_margin_of_an_edge(low_u: float, low_v: float, edge: str, lines: object) -> None:
    """Per pixel the place moves along u or v alone: within 1.5 px of the edge stand the first two lines."""
    found = flag_display_edge(map_from(low_u, low_v), REGION, 1.5)
    expected = np.zeros((31, 43), dtype=np.bool_)
    expected[lines] = True
    np.testing.assert_array_equal(flagged(found.screen_map), expected)
    assert found.edges == (edge,)
    assert found.pixels_count == np.count_nonzero(expected)
    assert edge in found.words
    assert found.doubt is not None
    assert found.doubt.numbers["edge_pixels_count"] == found.pixels_count
    for one in (found.screen_map.u, found.screen_map.v, found.screen_map.sigma_u, found.screen_map.sigma_v):
        np.testing.assert_array_equal(np.isnan(one[INSIDE]), expected)
    assert (found.screen_map.flags[~REGION] == SampleFlag.OUTSIDE_MIRROR).all()


@pytest.mark.parametrize(("off", "edges"), [(3.9, ("left",)), (4.1, ())])
def test_a_line_beyond_the_margin_says_that_the_mirror_looks_past(off: float, edges: tuple[str, ...]) -> None:
    """Twice the margin and a pixel: an outline that was put where the screen ends keeps its own margin."""
    found = flag_display_edge(map_from(off * STEP_U, 0.3), REGION, 1.5)
    assert found.edges == edges
    assert found.pixels_count == 0


def test_a_few_pixels_are_no_line() -> None:
    """A tenth of the side of the region's square: 3.6 of its 1333 pixels."""
    for count, edges in ((3, ()), (4, ("left",))):
        seen = map_from(0.3, 0.3)
        u = seen.u.copy()
        u[10 : 10 + count, 20] = 1e-3
        there = ScreenMap(u, seen.v, seen.sigma_u, seen.sigma_v, seen.modulation_dn, seen.flags, seen.noise)
        found = flag_display_edge(there, REGION, 1.5)
        assert (found.edges, found.pixels_count) == (edges, count)


def test_the_last_pixels_of_the_region_count() -> None:
    """The box about the region holds its last row and its last column."""
    seen = map_from(1 - 42 * STEP_U, 1 - 30 * STEP_V)
    found = flag_display_edge(seen, REGION, 0.5)
    assert found.edges == ("right", "lower")
    assert found.screen_map.flags[35, 20] & SampleFlag.OFF_SCREEN
    assert found.screen_map.flags[20, 49] & SampleFlag.OFF_SCREEN
    empty = flag_display_edge(seen, np.zeros_like(REGION), 0.5)
    assert (empty.edges, empty.pixels_count) == ((), 0)
