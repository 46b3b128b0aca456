"""Panels that are mounted too high or too low: their heights come out of the reflection's width within their sigma."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from observer.doubts.stated_dimensions import heights_doubt
from observer.photo_edges.reflection_edges import ReflectionEdges, joined
from observer.photo_edges.views import View
from observer.pipeline.headline import _height_columns
from observer.planning.simulated_edges import EdgeNoise, Scene, measured_edges, seen_again, true_edges
from observer.selection.solve_and_refuse import Reflector, _Nominal, solve_reflector
from observer.slopes.panel_places import PanelPlaces
from observer.slopes.pose_modes import Photos
from observer.slopes.row_spline import Roughness
from observer.trough.collector import ls2
from observer.trough.typical_mirror import TypicalMirror
from tests.observer.simulated_trough import short_scene, short_trough

SIGMA_M = 1.5e-3
NOISE = EdgeNoise(reflection_px=0.01)


@cache
def raised_scene() -> tuple[Scene, np.ndarray, ReflectionEdges]:
    """Return a pass over panels of other heights, these heights, and the exact edges where the design surface is.

    A panel that is higher by h shows what it would if cameras and tube were lower by h: nothing of the derivatives that
    are tested is used.
    """
    mirror = TypicalMirror.drawn(short_trough(), np.random.default_rng(3), 1e-3, 0.0)
    scene = short_scene(mirror, photos=60, rows=24)
    collector, path = scene.truth.collector, scene.truth.absorber
    heights = SIGMA_M * np.random.default_rng(5).standard_normal(collector.n_panels)
    parts = []
    for panel, height in enumerate(heights):
        down = np.array([0.0, 0.0, height])
        views = tuple(
            View(camera, RigidTransform(pose.rotation, pose.translation_m + pose.rotation @ down))
            for camera, pose in scene.views
        )
        lower = replace(scene.truth, absorber=replace(path, z_m=path.z_m - height))
        edges = true_edges(replace(scene, truth=lower, views=views), NOISE)
        edges = edges.chosen(collector.panel_index(edges.points_m[:, 0], edges.points_m[:, 1]) == panel)
        points = edges.points_m + down
        for photo, view in enumerate(scene.views):
            own = edges.photo == photo
            points[own] = seen_again(view, view, points[own], collector.surface)
        parts.append(replace(edges, points_m=points))
    return scene, heights, joined(parts)


def solved(sigma_m: float, seed: int, panels: PanelPlaces | None = None) -> Reflector:
    scene, _, edges = raised_scene()
    rng = np.random.default_rng(seed)
    found = measured_edges(scene, edges, scene.views, rng)
    photos = Photos(tuple(pose for _, pose in scene.views), np.eye(6 * len(scene.views)) * 1e-12, panels=panels)
    truth = scene.truth
    stated = replace(truth, collector=replace(truth.collector, panel_height_sigma_m=sigma_m))
    return solve_reflector(found, photos, stated, 0.05, Roughness(1e-3, 0.2e-3))


def with_edges(off_m: float) -> tuple[Reflector, Reflector]:
    """Solve with heights that the panels' edges say, right within 0.1 mm or off by so much, and with the mounting's."""
    scene, heights, _ = raised_scene()
    n, count = heights.size, len(scene.views)
    value = np.concatenate([heights + off_m, np.zeros(n)])
    sigma = np.repeat([0.1e-3, 0.05e-3], n)
    nothing = np.zeros((2 * n, 6 * count))
    panels = PanelPlaces(value, np.diag(sigma**2), nothing, nothing, 1e-3)
    return solved(SIGMA_M, 0, panels), solved(SIGMA_M, 0)


def heights_of(found: Reflector) -> tuple[np.ndarray, np.ndarray]:
    return found.unknowns.panel_heights_m(found.errors.common, found.errors.covariance_common)


@pytest.mark.slow
def test_heights_come_out_within_their_sigma_and_slopes_with_them():
    scene, heights, _ = raised_scene()
    ratios, gains = [], []
    for seed in range(3):
        found = solved(SIGMA_M, seed)
        height, sigma = heights_of(found)
        assert (sigma < 0.6 * SIGMA_M).all()
        ratios.append((height - heights) / sigma)
        held = solved(0.0, seed)
        x, y = np.meshgrid(found.grid.x_m, found.y_m)
        true = scene.mirror.errors(x.ravel(), y.ravel())[0].reshape(x.shape)
        errors = [(one.errors.slopes[..., 0] - true)[one.measured] for one in (found, held)]
        gains.append(np.std(errors[0]) / np.std(errors[1]))
    assert 0.6 < np.sqrt(np.mean(np.square(ratios))) < 1.4
    assert np.mean(gains) < 0.7


def _slope_error(found: Reflector) -> float:
    scene = raised_scene()[0]
    x, y = np.meshgrid(found.grid.x_m, found.y_m)
    true = scene.mirror.errors(x.ravel(), y.ravel())[0].reshape(x.shape)
    return float(np.std((found.errors.slopes[..., 0] - true)[found.measured]))


@pytest.mark.slow
def test_heights_by_the_panels_edges_are_where_the_solution_starts():
    heights = raised_scene()[1]
    found, mounted = with_edges(0.0)
    height, sigma = heights_of(found)
    assert np.abs(height - heights).max() < 0.2e-3
    assert (sigma < 0.11e-3).all()
    assert height.size == heights.size
    assert _slope_error(found) < 0.8 * _slope_error(mounted)
    # Wrong ones make wrong slopes.
    assert _slope_error(with_edges(1e-3)[0]) > 1.5 * _slope_error(found)


@pytest.mark.slow
def test_what_the_unknowns_are_expected_to_be_counts_once():
    found, _ = with_edges(0.0)
    lines, before = found.lines, np.searchsorted(found.grid.x_m, found.lines.x_m) - 1
    before = np.clip(before, 0, found.grid.x_m.size - 2)
    share = ((lines.x_m - found.grid.x_m[before]) / found.grid.step_m)[:, None]
    slopes = (1 - share) * found.errors.slopes[lines.row, before] + share * found.errors.slopes[lines.row, before + 1]
    left = lines.misfit_rad + lines.d_slope_x * slopes[:, 0] + lines.d_slope_y * slopes[:, 1]
    left += np.einsum("mc,mc->m", lines.d_common, found.errors.common[lines.common_index])
    inner = (before > 0) & found.grid.joined[before]
    assert np.median(np.abs(left[inner])) < 1.2 * np.median(np.abs(found.residuals_rad[found.fate == 0]))


def test_a_panel_that_leans_is_higher_towards_one_end():
    scene, heights, edges = raised_scene()
    n, count = heights.size, len(scene.views)
    nothing = np.zeros((2 * n, 6 * count))
    panels = PanelPlaces(np.zeros(2 * n), np.eye(2 * n) * 1e-8, nothing, nothing, 2e-3)
    photos = Photos(tuple(pose for _, pose in scene.views), np.eye(6 * count) * 1e-12, panels=panels)
    truth = replace(scene.truth, collector=replace(scene.truth.collector, panel_height_sigma_m=SIGMA_M))
    unknowns = _Nominal(edges, photos, truth, 0.0).unknowns
    by_height, by_lean = unknowns.derivative[:, -2:].T
    row = unknowns.index[:, -1] - unknowns.radius - unknowns.units.size - n
    ends = truth.collector.panel_edges_y_m
    middle = (0.5 * (ends[1:] + ends[:-1]))[row // (truth.collector.panel_edges_x_m.size - 1)]
    assert np.allclose(by_lean * SIGMA_M, by_height * 2e-3 * (edges.points_m[:, 1] - middle))
    assert np.abs(by_lean).max() > 0
    assert (unknowns.index[:, -1] - unknowns.index[:, -2] == n).all()


@pytest.mark.slow
def test_held_heights_are_no_unknowns():
    found = solved(0.0, 0)
    assert heights_of(found)[0].size == 0
    assert heights_doubt(found) is None


def test_heights_stand_in_the_table_of_panels():
    n = short_trough().n_panels
    table = _height_columns(solved(SIGMA_M, 0), n)
    assert len(table["height_m"]) == len(table["sigma_height_m"]) == n
    assert (table["sigma_height_m"] > 0).all()
    assert np.isnan(_height_columns(solved(0.0, 0), n)["height_m"]).all()


def test_panels_far_from_the_design_are_told():
    assert heights_doubt(solved(SIGMA_M, 0)) is None
    said = str(heights_doubt(solved(0.2e-3, 0)))
    assert "collector.panel_height_sigma_mm = 0.2 does not fit" in said


@pytest.mark.parametrize(("mean_m", "is_named"), [(0.0, False), (4e-3, True)])
def test_panels_that_all_stand_too_high_are_the_lists_fault_first(mean_m, is_named):
    height = mean_m + 2e-3 * np.random.default_rng(3).standard_normal(16)
    unknowns = SimpleNamespace(panel_heights_m=lambda *_: (height, np.full(16, 1e-4)), height_unit_m=0.5e-3)
    errors = SimpleNamespace(common=None, covariance_common=None)
    said = str(heights_doubt(SimpleNamespace(unknowns=unknowns, errors=errors)))
    assert "state" in said
    assert ("too high on average, as wrong heights in the list of targets" in said) == is_named


def test_a_sigma_in_other_units_is_refused():
    with pytest.raises(InputError, match="panel_height_sigma_m: 5 m"):
        replace(ls2(), panel_height_sigma_m=5.0)
