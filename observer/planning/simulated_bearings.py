"""What photos of a known trough would show of the tube itself: bearings as numbers, without any image."""

import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.geometry.surfaces import quadric
from heliogauge.validate import FloatArray
from observer.photo_edges.reflection_edges import sees_tube
from observer.photo_edges.tube_bearings import Bearings, bearing
from observer.photo_edges.views import View
from observer.planning.simulated_edges import END_MARGIN_M, EdgeNoise, Scene, in_image, seen_again

#: Rows of one photo whose bearings share their error of pixel grid and background.
_ROWS_ALIKE = 3


def measured_bearings(scene: Scene, believed: tuple[View, ...], noise: EdgeNoise, rng: np.random.Generator) -> Bearings:
    """Return the directions of the tube itself as they are measured.

    believed: Camera and pose of each photo as the evaluation has them.
    noise: How well the tube's middle is found.
    Returns: One for each photo and row where the tube is in the image and no support hides it.
    """
    truth = scene.truth
    y = truth.y_m[sees_tube(truth.y_m, truth.collector, END_MARGIN_M)]
    axis_x, axis_z = truth.absorber.at(y)
    points = np.stack([axis_x, y, axis_z], axis=1)
    level = quadric([0, 0, 0, 0, 0, float(np.mean(axis_z))], name="plane of the absorber") if y.size else None
    wide = truth.collector.absorber_diameter_m
    parts: list[tuple[FloatArray, ...]] = []
    for photo, (true, mine) in enumerate(zip(scene.views, believed, strict=True)):
        inside = in_image(true, points)
        if level is None or not inside.any():
            continue
        eye = true.eye_m
        sigma = noise.absorber_px * _per_pixel(true.camera)
        drawn = rng.standard_normal(-(-y.size // _ROWS_ALIKE)).repeat(_ROWS_ALIKE)[: y.size]
        away = bearing(axis_x, axis_z, np.tile(eye, (y.size, 1))) + sigma * drawn
        at = points.copy()
        # The same line of sight where it meets the level of the tube.
        at[:, 2] = float(np.mean(axis_z))
        at[:, 0] = eye[0] + (eye[2] - at[:, 2]) * np.tan(away)
        again = seen_again(true, mine, at[inside], level)
        theirs = np.tile(mine.eye_m, (len(again), 1))
        value = bearing(again[:, 0], again[:, 2], theirs)
        parts.append(
            (np.full(len(again), photo), y[inside], value, np.full(len(again), sigma), np.full(len(again), wide))
        )
    if not parts:
        return Bearings(np.zeros(0, dtype=np.intp), *np.zeros((4, 0)))
    return Bearings(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _per_pixel(camera: Camera) -> float:
    return 1.0 / max(camera.focal_x_px, camera.focal_y_px)
