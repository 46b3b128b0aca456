"""What photos of a trough with a straight tube show, by plain vectors: nothing here knows the estimator's equation.

A line of sight is reflected by ``d - 2 (d.n) n`` and passes the tube's axis, a line along y, at a signed distance; it
touches the tube where that is plus or minus its radius.
"""

from dataclasses import replace

import numpy as np

from observer.photo_edges.reflection_edges import ReflectionEdges
from observer.photo_edges.views import View
from observer.planning.simulated_edges import Scene

#: Places across the aperture between which an edge is looked for [m].
STEP_M = 0.004


def reflected(points_m: np.ndarray, eyes_m: np.ndarray, slopes: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    normal = np.stack([-slopes[0], -slopes[1], np.ones(len(points_m))], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    sight = points_m - eyes_m
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    return sight - 2 * (sight * normal).sum(axis=1, keepdims=True) * normal


def passing(points_m: np.ndarray, ways: np.ndarray, axis: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Signed distance from the tube's axis, positive where the axis is on the side of +x, and y where it passes."""
    across = np.cross(ways, [0.0, 1.0, 0.0])
    from_axis = points_m - np.array([axis[0], 0.0, axis[1]])
    distance = (from_axis * across).sum(axis=1) / np.linalg.norm(across, axis=1)
    flat = ways[:, [0, 2]]
    way = -(from_axis[:, [0, 2]] * flat).sum(axis=1) / (flat**2).sum(axis=1)
    return distance, points_m[:, 1] + way * ways[:, 1]


def true_slopes(scene: Scene, x_m: np.ndarray, y_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    error_x, error_y = scene.mirror.errors(x_m, y_m)
    return x_m / (2 * scene.truth.collector.focal_length_m) + error_x, error_y


def axis_of(scene: Scene) -> tuple[float, float]:
    return float(scene.truth.absorber.x_m[0]), float(scene.truth.absorber.z_m[0])


def own_edges(scene: Scene, edge_px: float) -> ReflectionEdges:
    """Edges of a dark tube before a bright sky that all photos show, with the sigma of their places."""
    collector, rows = scene.truth.collector, scene.truth.y_m
    focal, radius, half = collector.focal_length_m, collector.absorber_diameter_m / 2, collector.aperture_width_m / 2
    axis = axis_of(scene)
    x = np.arange(-half, half, STEP_M)
    found: dict[str, list[np.ndarray]] = {"photo": [], "row": [], "side": [], "points": [], "step": [], "sigma": []}
    for photo, (camera, pose) in enumerate(scene.views):
        eye = pose.inverse().translation_m

        def distance(x_m: np.ndarray, y_m: np.ndarray, eye: np.ndarray = eye) -> tuple[np.ndarray, ...]:
            points = np.stack([x_m, y_m, x_m**2 / (4 * focal)], axis=1)
            ways = reflected(points, np.broadcast_to(eye, points.shape), true_slopes(scene, x_m, y_m))
            return *passing(points, ways, axis), points

        grid_x, grid_y = (one.ravel() for one in np.meshgrid(x, rows))
        coarse = distance(grid_x, grid_y)[0].reshape(rows.size, x.size)
        for side in (-1.0, 1.0):
            off = coarse - side * radius
            row, column = np.nonzero(off[:, :-1] * off[:, 1:] < 0)
            low, high, rising = x[column], x[column + 1], off[row, column] < 0
            for _ in range(40):
                middle = (low + high) / 2
                below = (distance(middle, rows[row])[0] - side * radius < 0) == rising
                low, high = np.where(below, middle, low), np.where(below, high, middle)
            left, passed_y, points = distance(low, rows[row])
            # Nothing of panel edges, of the receiver before the mirror, of its ends, of the photo's border.
            edges_x = np.abs(points[:, :1] - collector.panel_edges_x_m).min(axis=1)
            edges_y = np.abs(points[:, 1:2] - collector.panel_edges_y_m).min(axis=1)
            before = np.abs(passing(points, eye - points, axis)[0])
            pixels = camera.project(pose.apply(points))
            size = np.array([camera.width_px, camera.height_px])
            keep = (np.abs(left - side * radius) < 1e-8) & (np.minimum(edges_x, edges_y) > 0.04)
            keep &= (np.abs(passed_y) < collector.length_m / 2 - 0.1) & (before > 0.11)
            keep &= ((pixels > 4) & (pixels < size - 5)).all(axis=1)
            found["photo"].append(np.full(row.size, photo)[keep])
            found["row"].append(row[keep])
            found["side"].append(np.full(row.size, side)[keep])
            found["points"].append(points[keep])
            # Towards larger x the tube is left at its side +1 where the distance rises, at -1 where it falls.
            found["step"].append((0.5 * side * np.where(rising, 1.0, -1.0))[keep])
            found["sigma"].append((edge_px * np.linalg.norm(points - eye, axis=1) / camera.focal_x_px)[keep])
    photo, row, side, points, step, sigma = (np.concatenate(one) for one in found.values())
    return ReflectionEdges(photo, row, side, points, sigma, step, np.zeros(row.size), row < 0)


def own_measurement(
    scene: Scene, edges: ReflectionEdges, believed: tuple[View, ...], rng: np.random.Generator
) -> ReflectionEdges:
    """Edges with noise across the trough, where someone with other poses takes them to be on the design's surface."""
    focal = scene.truth.collector.focal_length_m
    x = edges.points_m[:, 0] + edges.sigma_x_m * rng.standard_normal(edges.row.size)
    points = np.stack([x, edges.points_m[:, 1], x**2 / (4 * focal)], axis=1)
    for photo, (true, mine) in enumerate(zip(scene.views, believed, strict=True)):
        own = edges.photo == photo
        back = mine.cam_from_frame.inverse()
        way = back.rotate(mine.camera.cast_rays(true.camera.project(true.cam_from_frame.apply(points[own]))))
        eye = back.translation_m
        # z = x^2 / 4 f along eye + t way: a quadratic in t.
        a, b = way[:, 0] ** 2, 2 * eye[0] * way[:, 0] - 4 * focal * way[:, 2]
        c = eye[0] ** 2 - 4 * focal * eye[2]
        root = np.sqrt(b**2 - 4 * a * c)
        t = 2 * c / (-b + np.where(b < 0, root, -root))
        points[own] = eye + t[:, None] * way
    return replace(edges, points_m=points)
