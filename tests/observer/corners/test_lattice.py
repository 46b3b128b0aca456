"""The drawing's corners: their places, and how errors of panels move them, by another route."""

from dataclasses import replace

import numpy as np
import pytest

from data_synth.troughs import TroughChoice, trough_scene
from data_synth.troughs.mirror import corner_points_m
from heliogauge.errors import InputError
from observer.corners.lattice import PanelLattice
from observer.trough.collector import Collector, ls2

MOUNTING_M, CORNER_M, HEIGHT_M = 2e-3, 0.4e-3, 0.7e-3


def collector(gap_m: float = 0.01) -> Collector:
    edges = np.array([-2.5, -1.3, 0.0, 1.3, 2.5]), np.array([-1.5, 0.0, 1.5])
    return Collector(5.0, 3.0, 1.49, 0.07, None, *edges, gap_m, panel_height_sigma_m=HEIGHT_M)


def test_corners_are_on_the_parabola_and_named_by_their_edges() -> None:
    lattice = PanelLattice(collector(), MOUNTING_M, CORNER_M)
    assert len(lattice.names) == 15
    place = dict(zip(lattice.names, lattice.points_m, strict=True))
    np.testing.assert_allclose(place["corner-1-2"], [-1.3, 1.5, 1.3**2 / (4 * 1.49)], atol=1e-12)
    assert len(lattice.lines) == 5 * 2 + 3 * 4
    assert sum(line.is_rim for line in lattice.lines) == 2 * 2 + 2 * 4


def test_covariance_is_that_of_panels_that_are_mounted_wrongly() -> None:
    """Corners of drawn panels: each panel moved as a whole along its tangent, y and normal, its corners besides."""
    lattice = PanelLattice(collector(), MOUNTING_M, CORNER_M)
    x = lattice.edges_m[0]
    rng = np.random.default_rng(3)
    drawn = []
    for _ in range(600):
        met: dict[str, list[np.ndarray]] = {name: [] for name in lattice.names}
        for column in range(4):
            for row in range(2):
                along, across, up = rng.standard_normal(3) * [MOUNTING_M, MOUNTING_M, HEIGHT_M]
                for i in (column, column + 1):
                    angle = np.arctan(x[i] / (2 * 1.49))
                    shift = np.array([np.cos(angle), 0, np.sin(angle)]) * along
                    shift += np.array([-np.sin(angle), 0, np.cos(angle)]) * up + np.array([0, across, 0])
                    for j in (row, row + 1):
                        met[f"corner-{i}-{j}"].append(shift + CORNER_M * rng.standard_normal(3))
        drawn.append(np.concatenate([np.mean(met[name], axis=0) for name in lattice.names]))
    sampled = np.cov(np.array(drawn).T)
    sigma = np.sqrt(np.diag(sampled))
    # Correlations of 600 draws are good to 0.04, variances to 0.06; the largest of 1000 lies within four times that.
    apart = np.abs(sampled - lattice.covariance_m2) / np.outer(sigma, sigma)
    assert apart.max() < 0.24
    assert np.sqrt(np.mean(apart**2)) < 0.06


def frame_turn(seed: int) -> tuple[float, float]:
    """Return how far the frame of a shaped mirror is turned about the trough by its corners, over the stated sigma.

    First with what all rows of panels share, then as if each row erred by itself.
    """
    scene = trough_scene("far", TroughChoice(seed, n_photos=3, is_shaped=True))
    drawn, design = corner_points_m(scene.world.mirror), replace(scene.collector, panel_height_sigma_m=0.2e-3)
    lattice = PanelLattice(design, 0.2e-3, 0.2e-3)
    off = np.array([drawn[name] for name in lattice.names]) - lattice.points_m
    line = np.array(lattice.corners)[:, 0]
    shared = np.array([off[line == k, 2].mean() for k in line])
    own_m, shared_m = (float(np.sqrt(np.mean(part**2))) for part in (off[:, 2] - shared, shared))
    # Shifts and turns of the frame, as they move the corners.
    turns = np.stack([np.cross(axis, lattice.points_m) for axis in np.eye(3)], axis=2)
    moves = np.concatenate([np.broadcast_to(np.eye(3), turns.shape), turns], axis=2).reshape(-1, 6)
    found = []
    for stated in ((own_m, shared_m), (float(np.hypot(own_m, shared_m)), 0.0)):
        weight = np.linalg.inv(PanelLattice(design, 0.2e-3, *stated).covariance_m2)
        covariance = np.linalg.inv(moves.T @ weight @ moves)
        found.append(float((covariance @ moves.T @ weight @ off.ravel())[4] / np.sqrt(covariance[4, 4])))
    return found[0], found[1]


@pytest.mark.slow
def test_a_shape_that_all_rows_share_is_in_the_sigma_of_the_turn() -> None:
    """Ten mirrors: sigmas are 1.5 times too large (bound 2.6, chance of 1 in 200), else half of what they should be."""
    square = np.mean(np.square([frame_turn(seed) for seed in range(1, 11)]), axis=0)
    assert 0.1 < square[0] < 2.52
    assert square[1] > 2.52


def test_gaps_of_no_width_leave_too_few_corners() -> None:
    with pytest.raises(InputError, match="panel_gap_mm"):
        PanelLattice(collector(0.0), MOUNTING_M, CORNER_M)
    with pytest.raises(InputError, match="mark targets"):
        PanelLattice(ls2(), MOUNTING_M, CORNER_M)
