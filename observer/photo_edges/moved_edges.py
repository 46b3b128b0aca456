"""Edges and bearings found with a provisional pose, moved to the adjusted one: the pixel is what was measured."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from heliogauge.validate import FloatArray, IntArray
from observer.photo_edges.reflection_edges import ReflectionEdges
from observer.photo_edges.tube_bearings import Bearings, bearing
from observer.photo_edges.views import View
from observer.trough.expectation import Expectation


def edges_in_poses(
    edges: ReflectionEdges, before: Sequence[View], after: Sequence[View], expected: Expectation
) -> ReflectionEdges:
    """Move edges on the mirror to where their pixels' lines of sight meet it with other poses.

    before, after: Camera and ``cam_from_frame`` of each photo: those that they were found with, and the adjusted
        ones.
    expected: Collector and rows.
    Returns: The same edges in the rows that they come to lie in; those that leave the mirror are left out.
    """
    focal = expected.collector.focal_length_m
    origins, directions = _lines(edges.points_m, edges.photo, before, after)
    # (x + t u)^2 = 4 f (z + t w), the root that is finite for u = 0.
    (x, z), (u, w) = origins[:, [0, 2]].T, directions[:, [0, 2]].T
    square, half, rest = u * u, x * u - 2 * focal * w, x * x - 4 * focal * z
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(half * half - square * rest)
        way = rest / (-half + np.where(half < 0, root, -root))
    points = origins + way[:, None] * directions
    first, step = float(expected.y_m[0]), float(expected.y_m[1] - expected.y_m[0]) if expected.y_m.size > 1 else 1.0
    row = np.nan_to_num((points[:, 1] - first) / step, nan=-1.0).round().astype(np.intp)
    inside = np.isfinite(points).all(axis=1) & (row >= 0) & (row < expected.y_m.size)
    return replace(edges, row=row, points_m=points).chosen(inside)


def bearings_in_poses(
    bearings: Bearings, before: Sequence[View], after: Sequence[View], expected: Expectation
) -> Bearings:
    """Turn directions of the tube into those that the same pixels have with other poses.

    before, after: Camera and ``cam_from_frame`` of each photo: those that they were found with, and the adjusted
        ones.
    expected: The absorber as it was expected.
    Returns: The same directions, seen from the adjusted places.
    """
    level = float(np.mean(expected.absorber.z_m))
    eyes = _eyes(before)[bearings.photo]
    across = eyes[:, 0] + np.tan(bearings.angle_rad) * (eyes[:, 2] - level)
    points = np.stack([across, bearings.y_m, np.full_like(across, level)], axis=1)
    origins, directions = _lines(points, bearings.photo, before, after)
    points = origins + ((level - origins[:, 2]) / directions[:, 2])[:, None] * directions
    # From where the camera was in the middle of a frame: a tube 10 mm off its place shifts that by 0.003 mrad where the
    # row was read 20 mm aside.
    middle = _eyes(after)[bearings.photo]
    return replace(bearings, y_m=points[:, 1], angle_rad=bearing(points[:, 0], points[:, 2], middle))


def _eyes(views: Sequence[View]) -> FloatArray:
    return np.array([one.eye_m for one in views]).reshape(-1, 3)


def _lines(
    points_m: FloatArray, photo: IntArray, before: Sequence[View], after: Sequence[View]
) -> tuple[FloatArray, FloatArray]:
    """Return origins and directions of the lines of sight, with adjusted poses, of points seen with others."""
    origins, directions = np.empty_like(points_m), np.empty_like(points_m)
    order = np.argsort(photo, kind="stable")
    bounds = np.searchsorted(photo[order], np.arange(len(before) + 1))
    for k, (one, other) in enumerate(zip(before, after, strict=True)):
        rows = order[bounds[k] : bounds[k + 1]]
        if rows.size == 0:
            continue
        back = other.cam_from_frame.inverse()
        origins[rows] = back.translation_m
        if other.camera is one.camera and not (one.moves or other.moves):
            # With a camera that is known the pixel need not be computed.
            rays = one.cam_from_frame.apply(points_m[rows])
        else:
            pixels = one.project(points_m[rows])
            origins[rows], rays = other.eyes_at(pixels), other.camera.cast_rays(pixels)
        directions[rows] = back.rotate(rays)
    return origins, directions
