"""A short trough, a camera's pass over it and poses that are known to some millimetres: for tests of simulations."""

from dataclasses import replace

import numpy as np

from heliogauge.camera.model import Camera
from observer.photo_edges.views import View
from observer.planning.photo_network import Believed
from observer.planning.planned_flight import Pass
from observer.planning.simulated_edges import Scene
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector, ls2
from observer.trough.expectation import Expectation
from observer.trough.typical_mirror import Mirror

CAMERA = Camera(480, 640, 1030.0, 1030.0, 239.5, 319.5)


def short_trough() -> Collector:
    edges = np.array([-2.5, -1.34, 0.0, 1.34, 2.5])
    ends = np.array([-1.58, 0.0, 1.58])
    return replace(ls2(), length_m=3.16, panel_edges_x_m=edges, panel_edges_y_m=ends, panel_gap_m=0.01)


def short_scene(mirror: Mirror, *, photos: int = 24, rows: int = 8, collector: Collector | None = None) -> Scene:
    collector = collector or short_trough()
    y = (np.arange(rows) + 0.5) * (collector.length_m / rows) - collector.length_m / 2
    absorber = AbsorberPath.straight(0.003, collector.focal_length_m - 0.005, collector.length_m / 2)
    poses = Pass(12.0, 2.9, photos).poses()
    return Scene(Expectation(collector, absorber, y), mirror, tuple(View(CAMERA, pose) for pose in poses))


def believed_with_errors(scene: Scene, rng: np.random.Generator, *, position_m: float = 2e-3) -> Believed:
    """Draw poses as a photo network finds them: independent errors of place and direction."""
    sigma = np.array([2e-4, 2e-4, 2e-4, position_m, position_m, position_m])
    views = tuple(View(camera, pose.moved(sigma * rng.standard_normal(6))) for camera, pose in scene.views)
    return Believed(views, np.diag(np.tile(sigma**2, len(views))))
