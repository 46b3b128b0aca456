"""Slopes along the trough of a mirror that is one surface, from photos beside it; drawn by plain vectors."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from observer.photo_edges.views import View
from observer.planning.planned_flight import Pass
from observer.planning.simulated_edges import Scene
from observer.selection import solve_and_refuse
from observer.selection.solve_and_refuse import Reflector, solve_reflector
from observer.slopes.pose_modes import Photos
from observer.slopes.row_spline import Roughness
from observer.trough.typical_mirror import Mirror
from tests.observer.own_trough import own_edges, own_measurement
from tests.observer.simulated_trough import CAMERA, short_scene, short_trough

LEAN_RAD = 4e-3


@dataclass(frozen=True)
class TurnedWaves:
    """Waves of 1 m across and 1 m along: what the slope across changes along, the slope along changes across."""

    def errors(self, x_m: np.ndarray, y_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        slope = 0.5e-3 * np.cos(2 * np.pi * (x_m + y_m))
        return slope, slope


@dataclass(frozen=True)
class Leaning:
    """A mirror that leans along the trough."""

    def errors(self, x_m: np.ndarray, y_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(x_m.shape), np.full(y_m.shape, LEAN_RAD)


def solved(mirror: Mirror, y_m: float, *, shaped: bool) -> Reflector:
    """Solve from one pass beside the middle of the trough."""
    collector = replace(short_trough(), length_m=1.6, panel_edges_y_m=np.array([-0.8, 0.8]))
    poses = Pass(12.0, 2.9, 16, y_m=y_m).poses()
    scene: Scene = replace(
        short_scene(mirror, rows=10, collector=collector), views=tuple(View(CAMERA, pose) for pose in poses)
    )
    edges = own_measurement(scene, own_edges(scene, 0.05), scene.views, np.random.default_rng(1))
    photos = Photos(poses, np.diag(np.tile(np.repeat([1e-10, 1e-8], 3), len(poses))))
    return solve_reflector(edges, photos, scene.truth, 0.04, Roughness(1e-3, 2e-3), shaped=shaped)


@pytest.mark.parametrize(("shaped", "low", "high"), [(True, 0.5, 1.1), (False, -0.1, 0.1)])
def test_slopes_across_of_a_surface_tell_those_along(shaped: bool, low: float, high: float) -> None:
    """Rows around leave 0.9 of such waves, and a row's mean over a panel is not told; turned normals tell nothing."""
    found = solved(TurnedWaves(), 2.0, shaped=shaped)
    along = found.errors.slopes[..., 1][found.measured]
    true = TurnedWaves().errors(*np.meshgrid(found.grid.x_m, found.y_m))[1][found.measured]
    assert low < along @ true / (true @ true) < high


def test_slopes_along_that_are_told_turn_none_across(monkeypatch: pytest.MonkeyPatch) -> None:
    def across(told_rad: float) -> float:
        monkeypatch.setattr(solve_and_refuse, "slopes_by_twist", lambda across, *_: np.full(across.shape, told_rad))
        found = solved(Leaning(), 3.0, shaped=True)
        return float(np.sqrt(np.mean(found.errors.slopes[..., 0][found.measured] ** 2)))

    assert across(LEAN_RAD) < 0.3 * across(0.0)
