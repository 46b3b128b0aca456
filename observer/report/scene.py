"""A trough, its targets and the cameras' way in space, for its report."""

from collections.abc import Sequence

import numpy as np

from heliogauge.reporting.html import Html, join
from heliogauge.reporting.look import FAINT, INK, LINE_X, LINE_Y
from heliogauge.results.folder import PhotoPose
from heliogauge.validate import FloatArray
from heliogauge.view.scenes import SceneGroup, SceneView
from observer.report.results import TroughResults, numbers
from observer.trough.collector import Collector


def network(results: TroughResults) -> Html:
    """Return mirror, absorber, targets and cameras as a scene that the reader can turn."""
    eyes, names = results.eyes_m, results.photos
    counts = np.bincount(results.edges.photo[results.edges.used], minlength=len(names))
    sigma, by_targets = (
        np.array([place_sigma_m(poses[name]) for name in names]) for poses in (results.poses, results.poses_by_targets)
    )
    moved = np.linalg.norm(eyes - eyes_of(results.poses_by_targets, names), axis=1)
    labels = [
        f"{name}: {count} edges of the reflection, position known to {1e3 * one:.1f} mm"
        for name, count, one in zip(names, counts, sigma, strict=True)
    ]
    mirror, lengths = mirror_lines(results.collector)
    targets = results.targets
    known = np.isfinite(targets.xyz_m).all(axis=1)
    groups = [
        SceneGroup("mirror", mirror, [FAINT], lengths=lengths, size_px=0.8),
        SceneGroup("absorber", absorber_line(results), [LINE_Y], lengths=(len(absorber_line(results)),), size_px=3.0),
        SceneGroup(
            "targets", targets.xyz_m[known], [INK], labels=[targets.ids[k] for k in np.flatnonzero(known)], size_px=5
        ),
        SceneGroup("way of the camera", eyes, [FAINT], lengths=(len(eyes),), size_px=0.8),
        SceneGroup("cameras", eyes, [LINE_X if count else "#c9cdd2" for count in counts], labels=labels, size_px=6),
    ]
    words = (
        f"<p>{len(names)} photos, {int(known.sum())} targets. Median sigma of a camera's position: "
        f"{1e3 * float(np.median(by_targets)):.2f} mm from the targets alone, {1e3 * float(np.median(sigma)):.2f} mm "
        f"with the reflection, which moved it by {1e3 * float(np.median(moved)):.2f} mm and ties the cameras to each "
        "other (cameras.json). The adjustment of cameras and targets has its own report: <code>heliogauge report "
        "network</code> in this folder.</p>"
    )
    note = "Grey cameras: none of their edges was used."
    return join(Html(words), SceneView("Trough, targets and cameras", tuple(groups), note))


def eyes_of(poses: dict[str, PhotoPose], names: Sequence[str]) -> FloatArray:
    """Return the centres of cameras.

    Shapes: result (k, 3).
    """
    return np.array([poses[name].cam_from_world.inverse().translation_m for name in names])


def place_sigma_m(pose: PhotoPose) -> float:
    """Return the standard deviation of a camera's place, its three coordinates together [m]."""
    return float(np.sqrt(np.trace(pose.cam_from_world.origin_covariance(pose.covariance))))


def mirror_lines(collector: Collector) -> tuple[FloatArray, tuple[int, ...]]:
    """Return the panels' edges on the design parabola as lines.

    Returns (v, 3): Vertices [m] and the number of each line.
    """
    fine = np.linspace(collector.panel_edges_x_m[0], collector.panel_edges_x_m[-1], 41)
    lines = [
        np.stack([fine, np.full_like(fine, y), collector.surface.height(fine, np.full_like(fine, y))], axis=1)
        for y in collector.panel_edges_y_m
    ]
    ends = collector.panel_edges_y_m[[0, -1]]
    for x in collector.panel_edges_x_m:
        across = np.full(2, x)
        lines.append(np.stack([across, ends, collector.surface.height(across, ends)], axis=1))
    return np.concatenate(lines), tuple(len(line) for line in lines)


def absorber_line(results: TroughResults) -> FloatArray:
    """Return the absorber's axis where it was measured.

    Shapes: result (n, 3).
    """
    columns = results.table("absorber.csv") or {}
    line = np.stack([numbers(columns, name) for name in ("x_a_m", "y_m", "z_a_m")], axis=1)
    known = line[np.isfinite(line).all(axis=1)]
    if len(known) >= 2:
        return known
    half = results.collector.length_m / 2
    return np.array([[0.0, -half, results.collector.focal_length_m], [0.0, half, results.collector.focal_length_m]])
