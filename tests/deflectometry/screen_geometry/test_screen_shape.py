"""Shape and frame of a screen from points with joint errors: sigmas are the scatter, wrong inputs are refused."""

from dataclasses import replace

import numpy as np
import pytest

from deflectometry.screen_geometry.screen_shape import ScreenPoints, describe_display, describe_dots
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import FloatArray

_WORLD_FROM_SCREEN = RigidTransform.from_rotation_vector([0.3, -0.2, 1.1], [0.4, 0.1, 3.0])
_CAM_FROM_WORLD = RigidTransform.from_rotation_vector([2.9, 0.1, 0.2], [0.1, -0.3, 2.5])


def _true_m(u: FloatArray, v: FloatArray) -> FloatArray:
    """A screen of 1.2 m x 0.8 m, bent by 7 mm."""
    x, y = 1.2 * (u - 0.5), 0.8 * (0.5 - v)
    return np.stack([x, y, 0.02 * x**2 - 0.01 * x * y], axis=-1)


def _points(rng: np.random.Generator, u: FloatArray, v: FloatArray, *, bent: bool = True) -> ScreenPoints:
    """Points with own and shared errors drawn; the shared ones move the camera too."""
    truth = _true_m(u, v)
    if not bent:
        truth[:, 2] = 0.0
    world = _WORLD_FROM_SCREEN.apply(truth)
    own = np.diag(np.array([3e-5, 3e-5, 8e-5]) ** 2)
    # Shared: a stretch, a turn of everything, a bend, each with what it does to the camera's pose.
    turn = np.array([0.0, 0.0, 1e-3])
    shared = np.stack(
        [2e-4 * (world - world.mean(axis=0)), np.cross(turn, world), 1e-4 * np.outer((u - 0.5) ** 2, [0.2, 0.3, 0.9])]
    )
    # A turn w of the world is one of -R w of the pose; a stretch moves it along with its translation.
    steps = np.zeros((3, 6))
    steps[0, 3:] = [1e-4, 0.0, 2e-4]
    steps[1, :3] = -_CAM_FROM_WORLD.rotation @ turn
    amounts = rng.standard_normal(3)
    noise = rng.standard_normal((len(world), 3)) * np.sqrt(np.diag(own))
    return ScreenPoints(
        u=u,
        v=v,
        points_m=world + noise + np.einsum("k,kni->ni", amounts, shared),
        shared_m=shared,
        own_m2=np.tile(own, (len(world), 1, 1)),
        cam_from_world=_CAM_FROM_WORLD.moved(amounts @ steps),
        pose_steps=steps,
        viewer_m=_WORLD_FROM_SCREEN.apply(np.array([0.3, 0.2, 3.0])),
    )


def _aligned(points_m: FloatArray, truth_m: FloatArray) -> RigidTransform:
    """The rigid motion that takes true points to measured ones."""
    a, b = truth_m.mean(axis=0), points_m.mean(axis=0)
    u, _, v = np.linalg.svd((truth_m - a).T @ (points_m - b))
    turn = (u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v).T
    return RigidTransform(turn, b - turn @ a)


def test_errors_of_display_and_camera_are_their_joint_sigmas() -> None:
    u, v = (one.ravel() for one in np.meshgrid(np.linspace(-0.05, 1.05, 5), np.linspace(-0.05, 1.05, 4)))
    nodes_u, nodes_v = (one.ravel() for one in np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9)))
    truth = _true_m(nodes_u, nodes_v)
    squares, count = 0.0, 0
    for seed in range(20):
        measured, tests = describe_display(_points(np.random.default_rng(seed), u, v), "auto", own_frame=True)
        assert tests[-1].form == "bent"
        assert measured.cam_from_screen is not None
        found = measured.screen.points_m(nodes_u, nodes_v)
        place = _aligned(found, truth)
        cam_from_true = _CAM_FROM_WORLD @ _WORLD_FROM_SCREEN @ place.inverse()
        pose = measured.cam_from_screen
        turn = RigidTransform(pose.rotation @ cam_from_true.rotation.T, np.zeros(3)).rotation_vector_rad
        error = np.concatenate(
            [(found - place.apply(truth)).ravel(), turn, pose.translation_m - cam_from_true.translation_m]
        )
        steps = np.array(
            [
                np.concatenate([one.warp.shifts_m(nodes_u, nodes_v).ravel(), one.cam_from_screen])
                for one in measured.shared
            ]
        )
        _, values, vectors = np.linalg.svd(steps, full_matrices=False)
        whitened = (vectors @ error) / values
        held = values > 1e-3 * values[0]
        squares += float(whitened[held] @ whitened[held])
        count += int(np.count_nonzero(held))
        # What no error moves must not be off.
        assert np.linalg.norm(error - vectors.T @ (vectors @ error)) < 0.02 * np.linalg.norm(error)
    assert 0.8 < squares / count < 1.25


def test_dots_keep_their_own_errors() -> None:
    column, row = (one.ravel() for one in np.meshgrid(np.arange(24), np.arange(16)))
    u, v = column / 23, 1 - row / 15
    truth = _true_m(u, v)
    own, count = 0.0, 0
    for seed in range(6):
        points = _points(np.random.default_rng(seed), u, v)
        measured = describe_dots(points, np.stack([column - 4, row + 2], axis=1), own_frame=True)
        found = measured.screen.points_m(u, v)
        error = found - _aligned(found, truth).apply(truth)
        shared = np.array([one.warp.shifts_m(u, v).ravel() for one in measured.shared])
        basis = np.linalg.svd(shared, full_matrices=False)[2]
        left = error.ravel() - basis.T @ (basis @ error.ravel())
        own += float(np.sum((left / measured.screen.sigma_at(u, v).ravel()) ** 2))
        count += left.size - len(basis) - 6
    assert 0.9 < own / count < 1.1
    assert measured.screen.first == (-4, 17)


def test_a_flat_display_is_called_a_plane() -> None:
    u, v = (one.ravel() for one in np.meshgrid(np.linspace(0, 1, 5), np.linspace(0, 1, 5)))
    forms = []
    for seed in range(5):
        measured, tests = describe_display(
            _points(np.random.default_rng(seed), u, v, bent=False), "auto", own_frame=True
        )
        forms.append(tests[-1].form)
        assert measured.sigma_surface_m == 0.0
    # Shared error 3 bends it a little beyond a plane; with its sigma known, that is no contradiction.
    assert forms == ["plane"] * 5


def test_what_a_plane_cannot_explain_becomes_a_sigma() -> None:
    u, v = (one.ravel() for one in np.meshgrid(np.linspace(0, 1, 6), np.linspace(0, 1, 6)))
    measured, tests = describe_display(_points(np.random.default_rng(1), u, v), "plane", own_frame=True)
    assert tests[-1].probability < 1e-6
    assert 5e-4 < measured.sigma_surface_m < 3e-3


def test_exchanged_sides_are_refused() -> None:
    u, v = (one.ravel() for one in np.meshgrid(np.linspace(0, 1, 5), np.linspace(0, 1, 5)))
    points = _points(np.random.default_rng(0), u, v)
    mirrored = ScreenPoints(
        1 - u,
        v,
        points.points_m,
        points.shared_m,
        points.own_m2,
        points.cam_from_world,
        points.pose_steps,
        points.viewer_m,
    )
    with pytest.raises(EstimationError, match="left and right are exchanged"):
        describe_display(mirrored, "bent", own_frame=True)


def test_too_few_points_are_refused() -> None:
    u, v = np.array([0.0, 0.5, 1.0]), np.array([0.0, 0.5, 1.0])
    with pytest.raises(EstimationError, match="plane display needs"):
        describe_display(_points(np.random.default_rng(0), u, v), "plane", own_frame=True)


def test_the_test_of_a_shape_does_not_depend_on_how_well_the_scale_is_known() -> None:
    u, v = (one.ravel() for one in np.meshgrid(np.linspace(0, 1, 6), np.linspace(0, 1, 6)))
    points = _points(np.random.default_rng(1), u, v)
    larger = _WORLD_FROM_SCREEN.rotate(_true_m(u, v))[None]
    # A larger screen of this form has this form too: what is left of its points is the same.
    found = [
        describe_display(
            replace(
                points,
                shared_m=np.concatenate([points.shared_m, share * larger]),
                pose_steps=np.concatenate([points.pose_steps, np.zeros((1, 6))]),
            ),
            "bent",
            own_frame=True,
        )[1][0].chi_square
        for share in (1e-3, 0.1)
    ]
    assert found[1] == pytest.approx(found[0], rel=1e-3)
