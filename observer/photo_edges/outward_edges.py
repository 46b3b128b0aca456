"""Edges of the reflection that lie further outward, towards the brighter side, by an angle at the camera.

Blur that is not even, or numbers that are not proportional to light, displace all edges of a photo towards their
brighter or their darker side by about the same angle.
"""

from dataclasses import replace

import numpy as np

from heliogauge.validate import FloatArray
from observer.photo_edges.reflection_edges import ReflectionEdges

#: Edges of one curve that are further apart are not the same one [rad]: ten pixels of a usual camera.
_SAME_RAD = 5e-3


def looks_rad_per_m(points_m: FloatArray, eyes_m: FloatArray, focal_length_m: float) -> FloatArray:
    """Return how long a step across on the mirror looks: its part across the line of sight.

    Shapes: points_m (m, 3), eyes_m (m, 3), result (m,).
    """
    away = eyes_m - points_m
    distance = np.linalg.norm(away, axis=1)
    slope = points_m[:, 0] / (2 * focal_length_m)
    along = (away[:, 0] + slope * away[:, 2]) / distance
    return np.asarray(np.sqrt(np.maximum(1 + slope**2 - along**2, 1e-6)) / distance)


def outward_between(
    first: ReflectionEdges, second: ReflectionEdges, eyes_m: FloatArray, focal_length_m: float
) -> FloatArray:
    """Return by how much edges lie further outward in the second finding than in the first.

    Shapes: eyes_m (n, 3), result (k,).
    first, second: Edges of the same photos, found in two ways with the same poses.
    Returns: Of each edge of the second for which the first has one that steps the same way nearby, lesser steps of
        both left out [rad].
    """
    # Of four hundred photos a few were looked at in the second way.
    first = first.chosen(np.isin(first.photo, second.photo) & ~first.is_lesser)
    second = second.chosen(~second.is_lesser)
    looks = looks_rad_per_m(first.points_m, eyes_m[first.photo], focal_length_m)
    curves: dict[tuple[int, int, bool], list[int]] = {}
    for number, key in enumerate(_curves(first)):
        curves.setdefault(key, []).append(number)
    outward = []
    for number, key in enumerate(_curves(second)):
        own = np.array(curves.get(key, []), dtype=np.intp)
        if own.size:
            apart = second.points_m[number, 0] - first.points_m[own, 0]
            k = int(np.abs(apart).argmin())
            outward.append(float(apart[k] * looks[own[k]] * np.sign(first.contrast[own[k]])))
    angles = np.array(outward)
    return np.asarray(angles[np.abs(angles) < _SAME_RAD])


def moved_outward(
    edges: ReflectionEdges, by_rad: FloatArray, eyes_m: FloatArray, focal_length_m: float
) -> ReflectionEdges:
    """Return edges that lie further outward, in their rows of the design's surface.

    Shapes: by_rad (n,), eyes_m (n, 3).
    by_rad: By how much in each photo [rad].
    """
    looks = looks_rad_per_m(edges.points_m, eyes_m[edges.photo], focal_length_m)
    x = edges.points_m[:, 0] + np.sign(edges.contrast) * by_rad[edges.photo] / looks
    return replace(edges, points_m=np.column_stack([x, edges.points_m[:, 1], x**2 / (4 * focal_length_m)]))


def _curves(edges: ReflectionEdges) -> list[tuple[int, int, bool]]:
    """Return photo, row and way in which brightness steps of each edge."""
    return list(zip(edges.photo.tolist(), edges.row.tolist(), (edges.contrast > 0).tolist(), strict=True))
