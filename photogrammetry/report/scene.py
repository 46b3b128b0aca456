"""The network in space for its report: points with error ellipsoids, cameras as pyramids."""

import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.reporting.canvas import FAINT, LINE_Y, SEQUENTIAL, nice_ceiling
from heliogauge.reporting.html import Html
from heliogauge.reporting.scene import SceneGroup, scene
from heliogauge.validate import FloatArray
from photogrammetry.report.network import NetworkResults

#: Points up to which ellipsoids have three full sections; beyond, their axes are enough to see.
_MOST_FULL = 400
#: The largest ellipsoid's longest half axis, and the cameras' pyramids, as shares of the network's extent.
_ELLIPSOID_SHARE = 0.05
_CAMERA_SHARE = 0.03


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


def network_scene(results: NetworkResults) -> Html:
    """Return the network as a scene that the reader can turn.

    Returns: Points coloured by sigma, ellipsoids, cameras.
    """
    points, covariances = results.points.xyz_m[results.known], results.covariances_m2
    extent = float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 1.0
    sigma_mm = 1e3 * np.sqrt(np.maximum(np.einsum("nii->n", covariances), 0.0))
    labels = [
        f"{results.points.ids[i]}: sigma {s:.3g} mm, {results.points.n_rays[i]} rays"
        for i, s in zip(results.known, sigma_mm, strict=True)
    ]
    factor = magnification(covariances, extent)
    vertices, counts = ellipsoid_lines(points, covariances, factor)
    groups = [
        SceneGroup("points", points, hex_colors(sigma_mm), labels=labels, size_px=6),
        SceneGroup(
            f"error ellipsoids (1 sigma, {grouped(factor)} times)", vertices, [LINE_Y], lengths=counts, size_px=0.7
        ),
        *camera_groups(results, _CAMERA_SHARE * extent),
    ]
    note = (
        f"Points coloured from {sigma_mm.min():.3g} mm (dark) to {sigma_mm.max():.3g} mm (yellow), "
        "square root of the trace of the covariance. A camera's roof is over the top edge of its image."
    )
    return scene(groups, name="network", note=note)


def camera_groups(results: NetworkResults, depth_m: float) -> list[SceneGroup]:
    """Return the cameras as pyramids with their names at the projection centres."""
    vertices: list[FloatArray] = []
    counts: list[int] = []
    centers, names = [], []
    for name, pose in results.poses.items():
        lines, lengths = pyramid_lines(results.cameras[pose.camera], pose.cam_from_world, depth_m)
        vertices.append(lines)
        counts += lengths
        centers.append(-pose.cam_from_world.rotation.T @ pose.cam_from_world.translation_m)
        names.append(f"{name}: {len(results.photo_rows[name])} image points, RMS {pose.residual_rms_px or 0.0:.3f} px")
    if not centers:
        return []
    return [
        SceneGroup("cameras", np.concatenate(vertices), [FAINT], lengths=counts, size_px=1.0),
        SceneGroup("projection centres", np.array(centers), [FAINT], labels=names, size_px=4),
    ]


def grouped(number: float) -> str:
    """Return a whole number with its digits in threes."""
    return f"{number:,.0f}".replace(",", "\u202f")


def hex_colors(values: FloatArray) -> list[str]:
    """Return colours from dark to yellow for values, shape (n,)."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    span = float(np.ptp(values)) if values.size else 0.0
    shares = (values - values.min()) / span if span > 0 else np.zeros(values.shape)
    return [to_hex(color) for color in colormaps[SEQUENTIAL](0.95 * shares)]
