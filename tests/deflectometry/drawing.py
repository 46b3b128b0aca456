"""Mirrors drawn for the tests of outline and pose: exact pixel areas of projected outlines, blur, noise.

The areas come from clipping the outline at each pixel (Sutherland and Hodgman), not from anything under test.
"""

import numpy as np
import numpy.typing as npt

from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet

FloatArray = npt.NDArray[np.float64]


def _clip(polygon: list[tuple[float, float]], axis: int, bound: float, sign: float) -> list[tuple[float, float]]:
    kept: list[tuple[float, float]] = []
    for index, point in enumerate(polygon):
        before = polygon[index - 1]
        inside, was_inside = sign * (point[axis] - bound) >= 0, sign * (before[axis] - bound) >= 0
        if inside != was_inside:
            share = (bound - before[axis]) / (point[axis] - before[axis])
            crossing = [before[0] + share * (point[0] - before[0]), before[1] + share * (point[1] - before[1])]
            crossing[axis] = bound
            kept.append((crossing[0], crossing[1]))
        if inside:
            kept.append(point)
    return kept


def _area(polygon: list[tuple[float, float]]) -> float:
    return 0.5 * abs(sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(polygon, polygon[1:] + polygon[:1], strict=True)))


def coverage(shape: tuple[int, int], corners_px: FloatArray) -> FloatArray:
    """Share of each pixel's square that a convex polygon covers."""
    covered = np.zeros(shape)
    polygon = [(float(x), float(y)) for x, y in corners_px]
    low, high = np.floor(corners_px.min(axis=0) - 1).astype(int), np.ceil(corners_px.max(axis=0) + 1).astype(int)
    for row in range(max(low[1], 0), min(high[1] + 1, shape[0])):
        strip = _clip(_clip(polygon, 1, row - 0.5, 1.0), 1, row + 0.5, -1.0)
        if len(strip) < 3:
            continue
        xs = [point[0] for point in strip]
        # Columns that the whole strip spans are found from the crossings of its upper and lower border.
        upper = [x for x, y in strip if abs(y - (row - 0.5)) < 1e-12]
        lower = [x for x, y in strip if abs(y - (row + 0.5)) < 1e-12]
        first_full, last_full = 1, 0
        if len(upper) >= 2 and len(lower) >= 2:
            others = [x for x, y in strip if abs(abs(y - row) - 0.5) >= 1e-12]
            left = max(min(upper), min(lower), *[x for x in others if x < min(xs) + 0.5 * (max(xs) - min(xs))], -1e9)
            right = min(max(upper), max(lower), *[x for x in others if x >= min(xs) + 0.5 * (max(xs) - min(xs))], 1e9)
            first_full, last_full = int(np.ceil(left + 0.5)), int(np.floor(right - 0.5))
        for column in range(max(int(np.floor(min(xs))), 0), min(int(np.ceil(max(xs))) + 1, shape[1])):
            if first_full <= column <= last_full:
                covered[row, column] = 1.0
                continue
            cell = _clip(_clip(strip, 0, column - 0.5, 1.0), 0, column + 0.5, -1.0)
            if len(cell) >= 3:
                covered[row, column] = _area(cell)
    return covered


def outline_px(camera: Camera, cam_from_mirror: RigidTransform, facet: Facet, per_side: int = 24) -> FloatArray:
    """Projected outline with the design's curved sides, as a fine polygon."""
    share = (np.arange(per_side) / per_side)[:, None]
    start, end = facet.outline_m, np.roll(facet.outline_m, -1, axis=0)
    plane = (start[:, None] + share * (end - start)[:, None]).reshape(-1, 2)
    points = np.column_stack([plane, facet.design.height(plane[:, 0], plane[:, 1])])
    return camera.project((cam_from_mirror @ facet.ensemble_from_facet).apply(points))


def draw_mirror(
    camera: Camera,
    cam_from_mirror: RigidTransform,
    facets: list[Facet],
    *,
    bright_dn: float = 180.0,
    dark_dn: float = 10.0,
    blur_px: float = 0.6,
) -> FloatArray:
    """Image of bright facets before a dark room, blurred by a Gaussian, without noise."""
    image = np.zeros((camera.height_px, camera.width_px))
    for facet in facets:
        image += coverage(image.shape, outline_px(camera, cam_from_mirror, facet))
    reach = int(np.ceil(5 * blur_px))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / max(blur_px, 1e-9)) ** 2)
    kernel /= kernel.sum()
    for axis in (0, 1):
        image = np.apply_along_axis(np.convolve, axis, image, kernel, mode="same")
    return dark_dn + (bright_dn - dark_dn) * image
