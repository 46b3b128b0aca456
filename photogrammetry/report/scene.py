"""The network in space for its report: points with error ellipsoids, cameras as pyramids, scale bars."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.reporting.canvas import (
    FAINT,
    INK,
    LINE_Y,
    SEQUENTIAL,
    WIDTH_IN,
    add_title,
    axes_in_inches,
    new_figure,
    nice_ceiling,
    set_equal_limits,
)
from heliogauge.validate import FloatArray
from heliogauge.view.scenes import SceneGroup, SceneView
from photogrammetry.report.network import NetworkResults

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Points up to which ellipsoids have three full sections, and up to which they have axes; of more points the least
#: certain ones have ellipsoids.
_MOST_FULL, _MOST_AXES = 400, 4000
#: The largest ellipsoid's longest half axis, and the cameras' pyramids, as shares of the network's extent.
_ELLIPSOID_SHARE = 0.05
_CAMERA_SHARE = 0.03
#: Points in a still picture.
_MOST_STILL = 20_000
_BAR = "#2f8f5b"
_COLORS = 64


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
    """Return the network as a scene that the reader can turn, with still pictures along two axes.

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
    groups = [
        SceneGroup("points, coloured by sigma", points, hex_colors(sigma_mm), labels=labels, size_px=3 if many else 6),
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
    return SceneView(
        name, tuple(one for one in groups if len(one.xyz_m)), note, height_px=480, figures=still_figures(results)
    )


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


def still_figures(results: NetworkResults) -> "list[Figure]":
    """Draw the network seen along z and along y."""
    return [network_figure(results, 0, 1), network_figure(results, 0, 2)]


def network_figure(results: NetworkResults, first: int, second: int) -> "Figure":
    """Draw points coloured by sigma, known lengths and cameras, seen along one axis.

    first, second: Axes to the right and up: 0 x, 1 y, 2 z.
    """
    from matplotlib.collections import LineCollection

    across = (first, second)
    points, sigma_mm = results.points.xyz_m[results.known][:, across], results.sigma_mm
    pyramids = _pyramids(results)
    figure = new_figure(4.3)
    axes = axes_in_inches(figure, 0.6, 0.5, WIDTH_IN - 1.5, 3.1)
    axes.set_xlabel(f"{'xyz'[first]} [m]", fontsize=8.5, color=INK)
    axes.set_ylabel(f"{'xyz'[second]} [m]", fontsize=8.5, color=INK)
    strokes = [lines[part][:, across] for lines, _ in pyramids for part in (slice(9), slice(9, None))]
    axes.add_collection(LineCollection(strokes, colors=FAINT, linewidths=0.5))
    for group in _bar_groups(results):
        axes.add_collection(LineCollection(list(group.xyz_m[:, across].reshape(-1, 2, 2)), colors=_BAR, linewidths=1.2))
    # Every n-th of very many, the least certain on top: 90,000 take 0.7 s and look the same.
    order = np.argsort(sigma_mm, kind="stable")[:: -(-len(points) // _MOST_STILL) or 1]
    size = 9.0 if len(points) < 5000 else 1.0
    dots = axes.scatter(
        points[order, 0], points[order, 1], c=sigma_mm[order], cmap=SEQUENTIAL, s=size, linewidths=0, zorder=3
    )
    bar = figure.colorbar(dots, cax=axes_in_inches(figure, WIDTH_IN - 0.78, 0.5, 0.13, 3.1), format="%.3g")
    bar.ax.tick_params(labelsize=8, colors=INK)
    everything = np.concatenate([points, *strokes])
    if len(everything):
        set_equal_limits(axes, everything[:, 0], everything[:, 1])
    add_title(
        figure,
        f"Network in {'xyz'[first]} and {'xyz'[second]}",
        f"{len(points)} points, colour: sigma [mm]; {len(pyramids)} photos",
    )
    return figure


def grouped(number: float) -> str:
    """Return a whole number with its digits in threes."""
    return f"{number:,.0f}".replace(",", "\u202f")


def hex_colors(values: FloatArray) -> list[str]:
    """Return colours from dark to yellow for values, shape (n,); the largest hundredth shares the last colour."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    if not values.size:
        return []
    low, high = float(values.min()), float(np.percentile(values, 99)) if values.size > 100 else float(values.max())
    shares = np.clip((values - low) / (high - low), 0, 1) if high > low else np.zeros(values.shape)
    colors = [to_hex(color) for color in colormaps[SEQUENTIAL](np.linspace(0, 0.95, _COLORS))]
    return [colors[i] for i in np.rint(shares * (_COLORS - 1)).astype(int)]
