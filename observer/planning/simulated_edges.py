"""What photos of a known mirror would show of the tube's reflection: edges as numbers, without any image.

The edges lie where the touching lines of sight of `observer.trough.observation_equation` do touch, on the true mirror
from the true camera. What the evaluation makes of them, it makes with other poses and cameras: each point is seen
again through those.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from heliogauge.geometry.surfaces import Quadric
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, FloatArray, IntArray
from observer.photo_edges.reflection_edges import ReflectionEdges, is_on_panels, joined, sees_tube
from observer.photo_edges.views import View
from observer.trough.expectation import Expectation
from observer.trough.observation_equation import Sights, misfit
from observer.trough.typical_mirror import Mirror

#: Distance of the places across the trough between which an edge is looked for [m]; panels bend little on this way.
_STEP_M = 0.025
#: Edges are found to this angle [rad].
_CLOSE_RAD = 1e-9
#: Steps of false position; each gains about two digits.
_STEPS = 6
#: An edge nearer than this to a panel's edge or to the tube in front is spoilt, as in photos [px].
_SPOILT_PX = 3.0
#: Lines of sight that pass nearer to a support or to the tube's end are not used, as in photos [m].
END_MARGIN_M = 0.04


@dataclass(frozen=True, slots=True)
class EdgeNoise:
    """How well edges are found in photos.

    reflection_px: Standard deviation of an edge of the reflection [px].
    absorber_px: Standard deviation of the tube's middle [px].
    """

    reflection_px: float = 0.05
    absorber_px: float = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Scene(ShortRepr):
    """What is looked at, without error.

    truth: Collector, true axis of the tube, rows of the map.
    mirror: True slope errors.
    views: True camera and ``cam_from_frame`` of each photo.
    """

    truth: Expectation
    mirror: Mirror
    views: tuple[View, ...]


def true_edges(scene: Scene, noise: EdgeNoise) -> ReflectionEdges:
    """Return the edges of the reflection that photos of a scene show.

    noise: Gives the standard deviations that are stated with the edges.
    """
    collector, y = scene.truth.collector, scene.truth.y_m
    half = collector.aperture_width_m / 2
    x = np.linspace(-half, half, round(2 * half / _STEP_M) + 1)
    grid_x, grid_y = np.meshgrid(x, y)
    slopes = _slopes(scene, _on_mirror(collector.focal_length_m, grid_x.reshape(-1), grid_y.reshape(-1)))
    lattice = _Lattice(x, *(part.reshape(y.size, x.size) for part in slopes))
    return joined([_edges_of_photo(scene, lattice, photo, noise) for photo in range(len(scene.views))])


@dataclass(frozen=True, slots=True, eq=False)
class _Lattice:
    """Slopes of the true mirror at places across all rows, which all photos share."""

    x_m: FloatArray
    slope_x: FloatArray
    slope_y: FloatArray


def _edges_of_photo(scene: Scene, lattice: _Lattice, photo: int, noise: EdgeNoise) -> ReflectionEdges:
    camera, pose = scene.views[photo]
    eye = pose.inverse().translation_m
    truth, collector = scene.truth, scene.truth.collector
    pixel_m = float(np.linalg.norm(eye)) / max(camera.focal_x_px, camera.focal_y_px)
    margin = _SPOILT_PX * pixel_m
    row, side, place, turned = _touching(scene, lattice, eye)
    points = _on_mirror(collector.focal_length_m, place, truth.y_m[row])
    sights = Sights(points, np.tile(eye, (row.size, 1)), side)
    passing = misfit(sights, _slopes(scene, points), truth.absorber, collector.absorber_diameter_m / 2)
    keep = is_on_panels(collector, points[:, 0], points[:, 1], margin)
    keep &= sees_tube(passing.passing_y_m, collector, margin + END_MARGIN_M)
    keep &= ~_behind_receiver(sights, truth, margin)
    keep &= in_image(scene.views[photo], points)
    sigma = np.full(row.size, noise.reflection_px * pixel_m)
    step = np.where(turned, 0.5, -0.5) * side
    return ReflectionEdges(np.full(row.size, photo), row, side, points, sigma, step, 0 * side, side == 0).chosen(keep)


def _near(eye_m: FloatArray, x_m: FloatArray, truth: Expectation) -> BoolArray:
    """Return which places across the aperture are near enough to the camera's foot to show the tube."""
    collector = truth.collector
    z = x_m**2 / (4 * collector.focal_length_m)
    axis_x, axis_z = (float(np.mean(part)) for part in (truth.absorber.x_m, truth.absorber.z_m))
    to_axis = np.hypot(x_m - axis_x, axis_z - z)
    shift = np.arctan2(-x_m, collector.focal_length_m - z) - np.arctan2(axis_x - x_m, axis_z - z)
    reach = np.arcsin(collector.absorber_diameter_m / 2 / to_axis) + 2 * truth.slope_error_rad
    return np.asarray(np.abs(np.arctan2(eye_m[0] - x_m, eye_m[2] - z) - shift) < reach)


def _on_mirror(focal_length_m: float, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
    return np.stack([x_m, y_m, x_m**2 / (4 * focal_length_m)], axis=1)


def _slopes(scene: Scene, points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    error_x, error_y = scene.mirror.errors(points_m[:, 0], points_m[:, 1])
    return points_m[:, 0] / (2 * scene.truth.collector.focal_length_m) + error_x, error_y


class _Touching(NamedTuple):
    """Where lines of sight touch the tube: rows, sides, places [m].

    turned: Where the mirror bends so much that the tube lies on the edge's other side.
    """

    row: IntArray
    side: FloatArray
    place_m: FloatArray
    turned: BoolArray


def _touching(scene: Scene, lattice: _Lattice, eye_m: FloatArray) -> _Touching:
    """Solve for the places of all rows where lines of sight touch the tube."""
    truth, collector = scene.truth, scene.truth.collector
    radius, focal = collector.absorber_diameter_m / 2, collector.focal_length_m
    near = np.nonzero(_near(eye_m, lattice.x_m, truth))[0]
    x = lattice.x_m[near]
    grid_x, grid_y = (part.reshape(-1) for part in np.meshgrid(x, truth.y_m))
    sights = Sights(_on_mirror(focal, grid_x, grid_y), np.tile(eye_m, (grid_x.size, 1)), np.zeros(grid_x.size))
    slopes = (lattice.slope_x[:, near].reshape(-1), lattice.slope_y[:, near].reshape(-1))
    middle = misfit(sights, slopes, truth.absorber, radius)
    axis_x, axis_z = truth.absorber.at(middle.passing_y_m)
    half = np.arcsin(radius / np.hypot(axis_x - grid_x, axis_z - sights.points_m[:, 2]))
    found = []
    for side in (-1.0, 1.0):
        coarse = (middle.angle_rad + side * half).reshape(truth.y_m.size, x.size)
        with np.errstate(invalid="ignore"):
            row, column = np.nonzero(coarse[:, :-1] * coarse[:, 1:] < 0)
        ends = (x[column], coarse[row, column]), (x[column + 1], coarse[row, column + 1])
        found.append((row, np.full(row.size, side), *ends[0], *ends[1]))
    row, sides, low, at_low, high, at_high = (np.concatenate(part) for part in zip(*found, strict=True))
    eyes = np.tile(eye_m, (row.size, 1))
    turned = at_low > 0
    place, rest = low, at_low
    for _ in range(_STEPS):
        place = low - at_low * (high - low) / (at_high - at_low)
        points = _on_mirror(focal, place, truth.y_m[row])
        rest = misfit(Sights(points, eyes, sides), _slopes(scene, points), truth.absorber, radius).angle_rad
        before = at_low * rest > 0
        at_low, at_high = np.where(before, rest, at_low), np.where(before, at_high, rest)
        low, high = np.where(before, place, low), np.where(before, high, place)
        if (np.abs(rest) < _CLOSE_RAD).all():
            break
    # What does not close is a step of the slope at a panel's edge.
    closed = np.abs(rest) < 1e3 * _CLOSE_RAD
    return _Touching(row[closed], sides[closed], place[closed], turned[closed])


def _behind_receiver(sights: Sights, truth: Expectation, margin_m: float) -> BoolArray:
    """Return which lines of sight the receiver, glass and all, hides on their way to the mirror."""
    collector = truth.collector
    axis_x, axis_z = truth.absorber.at(sights.points_m[:, 1])
    way = sights.eyes_m - sights.points_m
    beside = (axis_x - sights.points_m[:, 0]) * way[:, 2] - (axis_z - sights.points_m[:, 2]) * way[:, 0]
    return np.asarray(np.abs(beside) / np.hypot(way[:, 0], way[:, 2]) < collector.receiver_diameter_m / 2 + margin_m)


def in_image(view: View, points_m: FloatArray) -> BoolArray:
    """Return which points a photo shows, shape (m,), whatever hides them.

    Shapes: points_m (m, 3).
    view: Camera and ``cam_from_frame``.
    Returns (m,): Whether they lie within the image.
    """
    camera, pose = view
    pixels = camera.project(pose.apply(points_m))
    size = np.array([camera.width_px, camera.height_px])
    with np.errstate(invalid="ignore"):
        return np.asarray(((pixels > _SPOILT_PX) & (pixels < size - 1 - _SPOILT_PX)).all(axis=1))


def seen_again(true: View, believed: View, points_m: FloatArray, surface: Quadric) -> FloatArray:
    """Return where points that a true camera sees are taken to be by someone who believes in another one.

    Shapes: points_m (m, 3).
    true, believed: Camera and ``cam_from_frame``.
    surface: On which surface they are thought to lie.
    Returns (m, 3): Points on the surface; NaN where the line of sight misses it [m].
    """
    pixels = true.camera.project(true.cam_from_frame.apply(points_m))
    frame_from_cam = believed.cam_from_frame.inverse()
    rays = frame_from_cam.rotate(believed.camera.cast_rays(pixels))
    origins = np.broadcast_to(frame_from_cam.translation_m, rays.shape)
    distance = surface.intersect(origins, rays)
    return np.asarray(origins + distance[:, None] * rays)


def measured_edges(
    scene: Scene, edges: ReflectionEdges, believed: tuple[View, ...], rng: np.random.Generator
) -> ReflectionEdges:
    """Return edges as they are measured: with noise, and placed on the mirror by the poses that are believed.

    believed: Camera and pose of each photo as the evaluation has them.
    """
    surface = scene.truth.collector.surface
    points = np.array(edges.points_m)
    points[:, 0] += edges.sigma_x_m * rng.standard_normal(edges.sigma_x_m.size)
    points[:, 2] = surface.height(points[:, 0], points[:, 1])
    for photo, (true, mine) in enumerate(zip(scene.views, believed, strict=True)):
        own = edges.photo == photo
        points[own] = seen_again(true, mine, points[own], surface)
    return replace(edges, points_m=points).chosen(np.asarray(np.isfinite(points).all(axis=1)))
