"""Panels that are mounted too high or too low: their heights come out of the reflection's width within their sigma."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from observer.doubts.stated_dimensions import heights_doubt
from observer.photo_edges.reflection_edges import ReflectionEdges, joined
from observer.photo_edges.views import View
from observer.pipeline.headline import _height_columns
from observer.planning.simulated_edges import EdgeNoise, Scene, measured_edges, seen_again, true_edges
from observer.selection.solve_and_refuse import Reflector, solve_reflector
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


def solved(sigma_m: float, seed: int) -> Reflector:
    scene, _, edges = raised_scene()
    rng = np.random.default_rng(seed)
    found = measured_edges(scene, edges, scene.views, rng)
    photos = Photos(tuple(pose for _, pose in scene.views), np.eye(6 * len(scene.views)) * 1e-12)
    truth = scene.truth
    stated = replace(truth, collector=replace(truth.collector, panel_height_sigma_m=sigma_m))
    return solve_reflector(found, photos, stated, 0.05, Roughness(1e-3, 0.2e-3))


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


def test_a_sigma_in_other_units_is_refused():
    with pytest.raises(InputError, match="panel_height_sigma_m: 5 m"):
        replace(ls2(), panel_height_sigma_m=5.0)
