"""Dots beside the edges of a mirror: all of them, where hardly any is away from an edge."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from deflectometry.dots.cut_dots import fit_cut_dot
from deflectometry.dots.found_dots import FoundDots
from deflectometry.dots.rim import Rim
from deflectometry.dots.rim_dots import with_rim_dots
from heliogauge.validate import FloatArray
from photogrammetry.centers import Ellipse

PITCH_PX, RADIUS_PX, BLUR_PX = 18.0, 4.0, 1.0


def strip_of_dots(columns: int, rows: int) -> tuple[FoundDots, Rim]:
    """Return dark dots, as found 0.1 px aside, on a mirror that ends 3 px beside them."""
    column, row = (one.ravel() for one in np.meshgrid(np.arange(columns), np.arange(rows)))
    places = PITCH_PX * (np.stack([column, row], axis=1) + 1.0)
    high, wide = int(PITCH_PX * (rows + 1)), int(PITCH_PX * (columns + 1))
    x, y = np.meshgrid(np.arange(wide), np.arange(high))
    share = np.zeros((high, wide))
    for place in places:
        share = np.maximum(share, np.clip(RADIUS_PX + 0.5 - np.hypot(x - place[0], y - place[1]), 0, 1))
    photo = 150 - 100 * gaussian_filter(share, BLUR_PX)
    margin = PITCH_PX - RADIUS_PX - 3.0
    inside = np.min([x - margin, wide - margin - x, y - margin, high - margin - y], axis=0)
    count = len(places)
    dots = FoundDots(
        places + 0.1,
        np.tile(1e-2 * np.eye(2), (count, 1, 1)),
        np.stack([column, row], axis=1),
        np.full(count, 100.0),
        1.0,
        shapes_px2=np.tile(RADIUS_PX**2 * np.eye(2), (count, 1, 1)),
        blur_px=BLUR_PX,
    )
    return dots, Rim(photo.astype(np.float32), inside, np.full(photo.shape, 100.0), BLUR_PX, 0.1)


def sorted_places(dots: FoundDots) -> FloatArray:
    return np.asarray(dots.centers_px[np.lexsort(dots.number.T)])


@pytest.mark.parametrize("columns", [2, 3, 5])
def test_dots_are_measured_though_all_are_at_an_edge(columns: int) -> None:
    dots, rim = strip_of_dots(columns, 13)
    found = with_rim_dots(dots, rim)
    assert not found.is_cut.any()
    near = np.abs(sorted_places(found) - sorted_places(dots)).max(axis=1) > 1e-9
    # All but those inside: none of two columns.
    assert np.count_nonzero(near) == 13 * columns - 11 * max(columns - 2, 0)
    assert np.abs(sorted_places(found) - (sorted_places(dots) - 0.1))[near].max() < 0.02


def test_a_cut_dot_without_free_ground_has_no_centre() -> None:
    dots, rim = strip_of_dots(2, 13)
    # No pixel of the strip is three blurs away from its edges.
    narrow = Rim(rim.photo_dn, np.minimum(rim.inside_px, 2.5), rim.step_dn, BLUR_PX, 0.1)
    assert fit_cut_dot(narrow, Ellipse(dots.centers_px[4], dots.outlines_px2[4]), 100.0, dots) is None
