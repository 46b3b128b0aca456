"""The network in space for its report: points with error ellipsoids, cameras as pyramids, scale bars."""

from collections.abc import Sequence

import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.reporting.look import LINE_Y, nice_ceiling
from heliogauge.validate import FloatArray
from heliogauge.view.scenes import ColorScale, SceneGroup, SceneView
from photogrammetry.report.network import NetworkResults

#: Points up to which ellipsoids have three full sections, and up to which they have axes; of more points the least
#: certain ones have ellipsoids.
_MOST_FULL, _MOST_AXES = 400, 4000
#: The largest ellipsoid's longest half axis, and the cameras' pyramids, as shares of the network's extent.
_ELLIPSOID_SHARE = 0.05
_CAMERA_SHARE = 0.03
_BAR = "#2f8f5b"


def magnification(covariances_m2: FloatArray, extent_m: float) -> float:
    """Return the round number that makes the largest error ellipsoid visible.

    Shapes: covariances_m2 (n, 3, 3).
    extent_m: Size of the network [m].
    """
    largest = float(np.sqrt(np.nanmax(np.linalg.eigvalsh(covariances_m2), initial=0.0)))
    return nice_ceiling(_ELLIPSOID_SHARE * extent_m / largest) if largest > 0 else 1.0


def ellipsoid_lines(
    centers_m: FloatArray, covariances_m2: FloatArray, factor: float
) -> tuple[FloatArray, tuple[int, ...]]:
    """Return the principal sections of error ellipsoids as closed lines.

    Shapes: centers_m (n, 3).
    covariances_m2 (n, 3, 3): Covariances; one standard deviation along each axis [m^2].
    Returns (v, 3): Vertices [m] and the number of each line; only the axes where there are more than 400 points.
    """
    values, vectors = np.linalg.eigh(covariances_m2)
    axes = factor * np.sqrt(np.maximum(values, 0.0))[:, None, :] * vectors
    if len(centers_m) > _MOST_FULL:
        ends = centers_m[:, None, None] + np.array([-1.0, 1.0])[:, None] * np.swapaxes(axes, 1, 2)[:, :, None]
        return ends.reshape(-1, 3), (2,) * (3 * len(centers_m))
    angle = np.linspace(0, 2 * np.pi, 19)
    first, second = np.cos(angle)[:, None], np.sin(angle)[:, None]
    rings = [
        centers_m[:, None] + first * axes[:, None, :, i] + second * axes[:, None, :, j]
        for i, j in ((0, 1), (0, 2), (1, 2))
    ]
    return np.concatenate(rings).reshape(-1, 3), (angle.size,) * (3 * len(centers_m))


def pyramid_lines(camera: Camera, cam_from_world: RigidTransform, depth_m: float) -> tuple[FloatArray, tuple[int, ...]]:
    """Return a camera as a pyramid over its image, with a roof over the image's top edge.

    depth_m: How far before the projection centre the image is drawn [m].
    Returns (v, 3): Vertices in the world [m] and the number of each line.
    """
    x, y = depth_m * camera.width_px / camera.focal_x_px / 2, depth_m * camera.height_px / camera.focal_y_px / 2
    corners = np.array([[-x, -y, depth_m], [x, -y, depth_m], [x, y, depth_m], [-x, y, depth_m]])
    zero, roof = np.zeros(3), np.array([0.0, -1.5 * y, depth_m])
    outline = [*corners, corners[0], zero, corners[1], roof, corners[0]]
    vertices = np.array([*outline, corners[2], zero, corners[3]])
    return cam_from_world.inverse().apply(vertices), (9, 3)


def network_view(results: NetworkResults, notes_of_photos: Sequence[str], *, name: str = "Network") -> SceneView:
    """Return the network as a scene that the reader can turn.

    notes_of_photos: What is shown at each projection centre.
    Returns: Points coloured by sigma, ellipsoids, cameras, known lengths.
    """
    points, sigma_mm = results.points.xyz_m[results.known], results.sigma_mm
    covariances = results.covariance_m2[results.known]
    rays = results.points.n_rays[results.known]
    labels = [
        f"{results.points.ids[i]}: {s:.3g} mm, {n} rays" for i, s, n in zip(results.known, sigma_mm, rays, strict=True)
    ]
    many = len(points) > _MOST_AXES
    shown = np.argsort(-sigma_mm, kind="stable")[:_MOST_FULL] if many else np.arange(len(points))
    factor = magnification(covariances, results.extent_m)
    vertices, counts = ellipsoid_lines(points[shown], covariances[shown], factor)
    whose = f" of the {len(shown)} least certain points" if many else ""
    scale = sigma_scale(sigma_mm)
    groups = [
        SceneGroup(
            "points, coloured by sigma",
            points,
            scale.colors(sigma_mm),
            labels=labels,
            size_px=3 if many else 6,
            scale=scale,
        ),
        SceneGroup(
            f"error ellipsoids{whose} (1 sigma, {grouped(factor)} times)",
            vertices,
            [LINE_Y],
            lengths=counts,
            size_px=0.7,
        ),
        *_camera_groups(results, notes_of_photos),
        *_bar_groups(results),
    ]
    note = (
        f"Sigma of the points (square root of the covariance's trace): {_span(sigma_mm)}. "
        "A camera's roof is over the top edge of its image."
    )
    return SceneView(name, tuple(one for one in groups if len(one.xyz_m)), note, height_px=480)


def _span(sigma_mm: FloatArray) -> str:
    if not sigma_mm.size:
        return "not known"
    return f"{sigma_mm.min():.3g} mm (dark) to {sigma_mm.max():.3g} mm (yellow)"


def _camera_groups(results: NetworkResults, notes: Sequence[str]) -> list[SceneGroup]:
    """Return the cameras as pyramids with a note at each projection centre."""
    poses = results.poses.values()
    if not poses:
        return []
    pyramids = _pyramids(results)
    centers = np.array([-one.cam_from_world.rotation.T @ one.cam_from_world.translation_m for one in poses])
    lines = np.concatenate([vertices for vertices, _ in pyramids])
    lengths = [count for _, counts in pyramids for count in counts]
    return [
        SceneGroup("cameras", lines, ["#7d8894"], lengths=lengths, size_px=1.0),
        SceneGroup("projection centres", centers, ["#7d8894"], labels=list(notes), size_px=5),
    ]


def _bar_groups(results: NetworkResults) -> list[SceneGroup]:
    """Return known lengths between targets as lines."""
    table = results.tables.get("constraints", {})
    place = {results.points.ids[i]: i for i in results.known}
    ends = [
        (place[a], place[b])
        for a, b in zip(table.get("target_a", ()), table.get("target_b", ()), strict=True)
        if a in place and b in place
    ]
    if not ends:
        return []
    vertices = results.points.xyz_m[np.array(ends).ravel()]
    return [SceneGroup("known lengths", vertices, [_BAR], lengths=(2,) * len(ends), size_px=3.0)]


def _pyramids(results: NetworkResults) -> list[tuple[FloatArray, tuple[int, ...]]]:
    depth = _CAMERA_SHARE * results.extent_m
    return [
        pyramid_lines(results.cameras[one.camera], one.cam_from_world, depth)
        for one in results.poses.values()
        if one.camera in results.cameras
    ]


def grouped(number: float) -> str:
    """Return a whole number with its digits in threes."""
    return f"{number:,.0f}".replace(",", "\u202f")


def sigma_scale(sigma_mm: FloatArray) -> ColorScale:
    """Return colours for standard deviations, shape (n,); the largest hundredth shares the last colour."""
    if not sigma_mm.size:
        return ColorScale(0.0, 1.0, "mm")
    high = np.percentile(sigma_mm, 99) if sigma_mm.size > 100 else sigma_mm.max()
    return ColorScale(float(sigma_mm.min()), float(high), "mm")
