"""Where a facet shows the stars of a catalogue, by its design."""

import numpy as np

from deflectometry.stars.facet_stars import FacetLight, seen_directions
from heliogauge.validate import FloatArray, IntArray

#: Newton's method from the facet's middle ends at round-off after four or five steps.
_STEPS = 12
#: Stars are at infinity: their images are found to so much of their direction [rad].
_FOUND_RAD = 1e-9
#: Step of the derivatives on the facet [m].
_STEP_M = 1e-5


def star_images(light: FacetLight, directions: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return which stars a facet reflects into the camera, and where on its design.

    light: Says facet and camera; its points of light do not matter.
    directions (n, 3): To the stars, in the facet's frame.
    Returns: Numbers of the stars that are shown (k,), and their points in the facet's frame (k, 3) [m].
    """
    corners = light.facet.corners_m
    middle = corners.mean(axis=0)
    rim = _seen_from(light, corners[:, :2])
    centre = rim.mean(axis=0) / np.linalg.norm(rim.mean(axis=0))
    # Half as far again as the farthest corner: an outline bulges less than that.
    near = np.flatnonzero(np.arccos(np.clip(directions @ centre, -1, 1)) < 1.5 * np.arccos((rim @ centre).min()))
    places = np.tile(middle[:2], (near.size, 1))
    radius = float(np.linalg.norm(corners - middle, axis=1).max())
    for _ in range(_STEPS):
        miss = _seen_from(light, places) - directions[near]
        columns = [
            (_seen_from(light, places + step) - _seen_from(light, places - step)) / (2 * _STEP_M)
            for step in _STEP_M * np.eye(2)
        ]
        by_place = np.stack(columns, axis=-1)
        square = np.einsum("nki,nkj->nij", by_place, by_place)
        right = np.einsum("nki,nk->ni", by_place, miss)
        change = np.linalg.solve(square, right[..., None])[..., 0]
        # Beyond twice the facet no star is shown: there the design may not even be defined.
        places = middle[:2] + np.clip(places - change - middle[:2], -2 * radius, 2 * radius)
    miss = np.linalg.norm(_seen_from(light, places) - directions[near], axis=1)
    shown = light.facet.contains(*places.T) & (miss < _FOUND_RAD)
    return near[shown], np.column_stack([places, light.facet.design.height(*places.T)])[shown]


def _seen_from(light: FacetLight, places_m: FloatArray) -> FloatArray:
    """Return the directions that the camera sees at places on the facet, shape (n, 3)."""
    points = np.column_stack([places_m, light.facet.design.height(*places_m.T)])
    sights = points - light.eye_m
    return seen_directions(light, np.zeros(5), sights / np.linalg.norm(sights, axis=1, keepdims=True))
