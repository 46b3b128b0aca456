"""Poses and heights of panels by the panels' edges: errors against the joint sigmas, over drawn panels and poses."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform, rotation_from_vector, vector_from_rotation
from observer.corners.lattice import PanelLattice
from observer.corners.panel_lines import FoundLine, normal_at
from observer.corners.placed_panels import (
    END_SHARES,
    EdgeEnds,
    EdgeSights,
    PlacedByEdges,
    edge_sights,
    joined_sights,
    place_by_edges,
)
from observer.photo_edges.views import View
from observer.planning.planned_flight import Pass
from observer.slopes.pose_modes import Photos
from tests.observer.simulated_trough import short_trough

CAMERA = Camera(960, 1280, 2060.0, 2060.0, 479.5, 639.5)
HEIGHT_M, LEAN, OWN_M, NOISE_PX = 0.8e-3, 1e-3, 0.2e-3, 0.02
#: The list of targets lets the whole frame be turned and moved by this [rad, m]; each pose errs by less besides.
FRAME = np.array([3e-4, 3e-4, 3e-4, 1e-3, 1e-3, 1e-3])
OWN_POSE = np.array([5e-5, 5e-5, 5e-5, 7e-4, 7e-4, 2e-4])


def lattice(height_m: float = HEIGHT_M) -> PanelLattice:
    return PanelLattice(replace(short_trough(), panel_height_sigma_m=height_m), 2e-3, 0.5e-3)


@dataclass(frozen=True)
class Drawn:
    """What is drawn: true poses, those believed, panels, and what photos show of their edges."""

    lattice: PanelLattice
    true: tuple[RigidTransform, ...]
    photos: Photos
    panels: np.ndarray
    shape_m: np.ndarray
    sights: EdgeSights

    def solve(self) -> PlacedByEdges:
        return place_by_edges(self.sights, EdgeEnds.of(self.lattice), self.shape_m, self.photos, self.lattice, LEAN)

    def rest(self, found: PlacedByEdges) -> np.ndarray:
        """Return the steps from the poses found to the true ones, (6 n,)."""
        steps = []
        for own, true in zip(found.photos.poses, self.true, strict=True):
            turn = vector_from_rotation(true.rotation @ own.rotation.T)
            steps.append(np.concatenate([turn, true.translation_m - own.translation_m]))
        return np.concatenate(steps)


@cache
def drawn(
    seed: int, photos: int = 14, shape_m: float = 0.7e-3, seen_share: float = 1.0, wrong: tuple[float, ...] = (0, 0, 0)
) -> Drawn:
    """Draw poses, panels and edges; offsets are differences of whole projections, nothing of the estimator's model."""
    rng, own = np.random.default_rng([seed, 12]), lattice()
    believed = Pass(12.0, 2.9, photos).poses()
    aside, up, lean = wrong
    # Listed places are true ones turned about the rims, and shifted.
    planted = np.array([0, -lean, 0, aside + lean * own.collector.rim_height_m, 0, up])
    frame = FRAME * rng.standard_normal(6) + planted
    in_frame = RigidTransform(rotation_from_vector(frame[:3]), frame[3:])
    by_frame = np.array([_step(pose, lambda p: p @ in_frame) for pose in believed])
    covariance = np.zeros((6 * photos, 6 * photos))
    for k in range(6):
        unit = np.zeros(6)
        unit[k] = FRAME[k]
        turned = RigidTransform(rotation_from_vector(unit[:3]), unit[3:])
        column = np.concatenate([_step(pose, lambda p, t=turned: p @ t) for pose in believed])
        covariance += np.outer(column, column)
    covariance += np.diag(np.tile(OWN_POSE**2, photos))
    moves = by_frame + OWN_POSE * rng.standard_normal((photos, 6))
    true = tuple(pose.moved(move) for pose, move in zip(believed, moves, strict=True))
    collector, ends = own.collector, EdgeEnds.of(own)
    n, columns = collector.n_panels, len(own.edges_m[0]) - 1
    height, lean = HEIGHT_M * rng.standard_normal(n), LEAN * rng.standard_normal(n)
    aside = own.mounting_sigma_m * rng.standard_normal(n)
    shape = shape_m * rng.standard_normal(len(ends.panel))
    middle_y = 0.5 * (own.edges_m[1][1:] + own.edges_m[1][:-1])
    points = []
    for k, (place, beside) in enumerate(zip(ends.points_m, ends.panel, strict=True)):
        sides = []
        for panel in beside[beside >= 0]:
            along = np.array([1.0, 0.0, place[0] / (2 * collector.focal_length_m)])
            up = height[panel] + lean[panel] * (place[1] - middle_y[panel // columns]) + OWN_M * rng.standard_normal()
            off = own.corner_sigma_m * rng.standard_normal()
            sides.append(aside[panel] * along / np.linalg.norm(along) + [off, 0.0, up])
        points.append(place + np.mean(sides, axis=0) + [0.0, 0.0, shape[k]])
    parts = []
    for number, (pose, real) in enumerate(zip(believed, true, strict=True)):
        view, found = View(CAMERA, pose), []
        for k, line in enumerate(own.along_trough):
            if rng.random() > seen_share:
                found.append(None)
                continue
            _, normals = normal_at(view, own, line, np.array(END_SHARES))
            seen = CAMERA.project(real.apply(np.array(points[2 * k : 2 * k + 2])))
            expected = CAMERA.project(pose.apply(own.along(line, np.array(END_SHARES))))
            offset = np.einsum("ei,ei->e", normals, seen - expected) + NOISE_PX * rng.standard_normal(2)
            span = END_SHARES[1] - END_SHARES[0]
            both = NOISE_PX**2 * np.diag([0.5, 2 / span**2])
            found.append(FoundLine(line, float(offset.mean()), float(np.diff(offset)[0]) / span, 0.5, both, 1.0))
        parts.append(edge_sights(number, view, own, tuple(found)))
    photos_ = Photos(believed, covariance)
    return Drawn(own, true, photos_, np.concatenate([height, lean]), shape, joined_sights(parts))


def _step(pose, change):
    moved = change(pose)
    return np.concatenate(
        [vector_from_rotation(moved.rotation @ pose.rotation.T), moved.translation_m - pose.translation_m]
    )


def test_errors_of_poses_and_panels_are_what_their_joint_covariance_says():
    squares, size = [], 0
    for seed in range(12):
        # Not all photos show all edges.
        scene = drawn(seed, seen_share=1.0 if seed % 2 else 0.7)
        found = scene.solve()
        panels = found.photos.panels
        error = np.concatenate([scene.rest(found), scene.panels - panels.value])
        joint = np.block([[found.photos.covariance, panels.with_poses.T], [panels.with_poses, panels.covariance]])
        root = np.linalg.cholesky(joint)
        squares.append(float(np.sum(np.linalg.solve(root, error) ** 2)))
        size += error.size
    # Chi-square of 12 times 100: 1 +- 0.12 at three sigma.
    assert 0.88 < sum(squares) / size < 1.12


def test_heights_and_leans_are_measured_not_taken_from_the_mounting():
    errors = np.array([drawn(seed).solve().photos.panels.value - drawn(seed).panels for seed in range(6)])
    n = drawn(0).lattice.collector.n_panels
    sigma = np.sqrt(np.diag(drawn(0).solve().photos.panels.covariance))
    # 0.8 mm and 1 mrad by the mounting.
    assert np.sqrt(np.mean(errors[:, :n] ** 2)) < 0.55 * HEIGHT_M
    assert np.sqrt(np.mean(errors[:, n:] ** 2)) < 0.5 * LEAN
    assert (sigma[:n] < 0.7 * HEIGHT_M).all()


def test_the_frame_of_the_list_is_moved_to_the_mirror():
    before, after = [], []
    for seed in range(6):
        scene = drawn(seed)
        true = np.array([pose.inverse().translation_m for pose in scene.true])
        for poses, errors in ((scene.photos.poses, before), (scene.solve().photos.poses, after)):
            eyes = np.array([pose.inverse().translation_m for pose in poses])
            errors.append((eyes - true).mean(axis=0)[0])
    assert np.std(after) < 0.6 * np.std(before)


def test_panels_err_with_what_errs_with_the_poses():
    found = drawn(0).solve()
    panels = found.photos.panels
    assert np.allclose(panels.by_poses @ found.photos.covariance, panels.with_poses, atol=1e-4 * HEIGHT_M * 1e-3)
    assert np.abs(panels.with_poses).max() > 1e-7 * HEIGHT_M


def test_photos_that_were_not_looked_at_follow_the_others():
    scene = drawn(1)
    found, all_photos = replace(scene, sights=_of_photos(scene.sights, range(0, 14, 2))).solve(), scene.solve()
    eyes = [np.array([p.inverse().translation_m for p in one]) for one in (scene.true, found.photos.poses)]
    started = np.array([p.inverse().translation_m for p in scene.photos.poses])
    left = np.arange(1, 14, 2)
    assert np.abs((eyes[1] - eyes[0])[left].mean(0)[0]) < 0.5 * np.abs((started - eyes[0])[left].mean(0)[0])
    diagonal = [np.diag(one.photos.covariance).reshape(-1, 6)[left].sum(0) for one in (found, all_photos)]
    # Height and direction follow; what a photo's place errs by along the trough no edge tells.
    assert (diagonal[0] > 1.05 * diagonal[1])[[0, 1, 4, 5]].all()


def _of_photos(sights: EdgeSights, chosen: range) -> EdgeSights:
    keep = np.isin(sights.photo, list(chosen))
    return EdgeSights(*(part[keep] for part in sights))


def test_a_line_that_is_something_else_in_a_photo_is_not_used():
    scene = drawn(2)
    offset = scene.sights.offset_px.copy()
    wrong = (scene.sights.photo == 5) & (scene.sights.end < 2)
    offset[wrong] += 1.0
    found = replace(scene, sights=scene.sights._replace(offset_px=offset)).solve()
    assert not found.used[wrong].any()
    assert found.used[~wrong].mean() > 0.99
    assert np.abs(found.photos.panels.value - scene.solve().photos.panels.value).max() < 0.1e-3


def test_noise_that_is_larger_than_stated_makes_sigma_larger():
    scene = drawn(3)
    loud = scene.sights._replace(sigma_px=scene.sights.sigma_px / 3)
    quiet, told = (np.diag(one.solve().photos.panels.covariance) for one in (scene, replace(scene, sights=loud)))
    assert np.median(np.sqrt(told / quiet)) == pytest.approx(1.0, abs=0.15)


def test_heights_that_are_held_stay_and_the_poses_are_refined():
    scene = replace(drawn(4, shape_m=0.0), lattice=lattice(0.0))
    found = scene.solve()
    assert found.photos.panels is None
    assert np.trace(found.photos.covariance) < 0.8 * np.trace(scene.photos.covariance)


def test_an_edge_far_beside_the_drawing_stands_out():
    scene = drawn(5)
    ends = EdgeEnds.of(scene.lattice)
    beside = np.isin(scene.sights.end, [4, 5])
    offset = scene.sights.offset_px + np.where(beside, 0.012 * scene.sights.by_place[:, 0], 0.0)
    found = replace(scene, sights=scene.sights._replace(offset_px=offset)).solve()
    assert int(np.argmax(found.over_sigma)) in (4, 5)
    assert found.over_sigma.max() > 4.0
    assert found.ends_m[4:6, 0].mean() - scene.solve().ends_m[4:6, 0].mean() == pytest.approx(0.012, abs=2e-3)
    assert scene.solve().over_sigma.max() < 4.0
    assert ends.points_m.shape == (20, 3)


def test_how_a_right_list_stands_beside_the_mirror_is_what_its_sigma_says():
    scaled = [found.value / found.sigma for found in (drawn(seed).solve().listed for seed in range(12))]
    # Chi-square of 36 over 36: 1 +- 0.24, at three sigma.
    assert 0.3 < np.mean(np.square(scaled)) < 1.7
    assert not [1 for seed in range(12) if drawn(seed).solve().listed.contradicting().any()]


@pytest.mark.parametrize("wrong", [(0.012, 0, 0), (0, -0.012, 0), (0, 0, 4e-3), (-0.012, 0.012, -4e-3)])
def test_a_list_that_is_wrong_as_a_whole_is_told_by_how_much(wrong):
    for seed in range(3):
        found = drawn(seed, wrong=wrong).solve().listed
        assert ((found.contradicting() != 0) == (np.array(wrong) != 0)).all()
        np.testing.assert_array_less(np.abs(found.value - wrong), 4 * found.sigma)


def test_another_focal_length_is_no_other_height_of_the_list():
    scene = drawn(1)
    ends = EdgeEnds.of(scene.lattice)
    # Higher edges at the rims, as of a focal length shorter by 1 %.
    higher = 0.01 * ends.points_m[:, 0] ** 2 / (4 * scene.lattice.collector.focal_length_m)
    offset = scene.sights.offset_px + scene.sights.by_place[:, 1] * higher[scene.sights.end]
    found = replace(scene, sights=scene.sights._replace(offset_px=offset)).solve().listed
    before = scene.solve().listed
    assert np.abs(found.value - before.value)[1] < 0.5 * before.sigma[1]


@pytest.mark.parametrize("seen_x_m", [(0.0,), (1.34,), (-2.5,), (-1.34, 1.34)])
def test_what_edges_in_too_few_places_do_not_tell_of_the_list_stays_unknown(seen_x_m):
    scene = drawn(1)
    x = EdgeEnds.of(scene.lattice).points_m[:, 0]
    seen = np.isclose(x[:, None], seen_x_m).any(axis=1)[scene.sights.end]
    found = replace(scene, sights=EdgeSights(*(one[seen] for one in scene.sights))).solve().listed
    assert not found.contradicting().any()
    # Two lines as far from the middle do not part the focal length from the height; one line tells no lean.
    assert found.sigma.max() > 0.1
    assert (np.abs(found.value) < 3 * found.sigma).all()
