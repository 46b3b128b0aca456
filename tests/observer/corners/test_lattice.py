"""The drawing's corners: their places, and how errors of panels move them, by another route."""

import numpy as np
import pytest

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


def test_gaps_of_no_width_leave_too_few_corners() -> None:
    with pytest.raises(InputError, match="panel_gap_mm"):
        PanelLattice(collector(0.0), MOUNTING_M, CORNER_M)
    with pytest.raises(InputError, match="mark targets"):
        PanelLattice(ls2(), MOUNTING_M, CORNER_M)
