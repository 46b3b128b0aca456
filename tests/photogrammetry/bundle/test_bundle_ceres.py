"""The bundle adjustment against Ceres through pycolmap: the same minimum, and what each calls covariance."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.bundle import FREE, SIGMA_PX, ceres_adjuster, ceres_scene, network
from heliogauge.adjust.gauss_newton import Options
from photogrammetry.bundle.adjustment import BundleOptions, adjust
from photogrammetry.bundle.datum import Datum, DatumKind
from photogrammetry.bundle.problem import BundleProblem, CameraModel

pycolmap = pytest.importorskip("pycolmap", reason="pip install heliogauge[natural]")
#: fx, fy, cx, cy, k1, k2, p1, p2 among the ten parameters of a camera.
COLUMNS = [0, 1, 2, 3, 5, 6, 7, 8]


@pytest.fixture(scope="module")
def both():
    _, start, points = network(12, 60)
    options = BundleOptions(descent=Options(tolerance=1e-10, initial_damping=1e-4))
    own = adjust(BundleProblem(points, (CameraModel("camera", FREE),)), start, options=options)
    scene = ceres_scene(start, points)
    adjuster = ceres_adjuster(scene, 1e-12)
    adjuster.solve()
    covariance = pycolmap.estimate_ba_covariance(pycolmap.BACovarianceOptions(), scene, adjuster)
    return own, scene, covariance


def similarity(own, scene):
    """Rotation, scale and shift from our frame to that of the other, which holds two cameras instead."""
    theirs = np.array([scene.points3D[i + 1].xyz for i in range(len(own.points_m))])
    near, far = own.points_m - own.points_m.mean(axis=0), theirs - theirs.mean(axis=0)
    left, singular, right = np.linalg.svd(far.T @ near)
    assert np.linalg.det(left @ right) > 0
    scale = float(singular.sum() / (near**2).sum())
    return left @ right, scale, theirs.mean(axis=0) - scale * left @ right @ own.points_m.mean(axis=0), theirs


def test_the_same_minimum(both):
    own, scene, _ = both
    ours, theirs = own.cameras[0].parameters[COLUMNS], np.array(scene.cameras[1].params)
    theirs[2:4] -= 0.5
    # In units of their sigma: far less than anybody can notice; then as plain numbers.
    assert np.abs((ours - theirs) / own.cameras[0].sigma_parameters[COLUMNS]).max() < 1e-6
    np.testing.assert_allclose(ours[:4], theirs[:4], rtol=1e-9)
    turn, scale, shift, points = similarity(own, scene)
    np.testing.assert_allclose(scale * own.points_m @ turn.T + shift, points, atol=1e-9 * 8)
    for i, pose in enumerate(own.cam_from_world):
        other = scene.images[i + 1].cam_from_world().matrix()
        np.testing.assert_allclose(pose.rotation @ turn.T, other[:, :3], atol=1e-9)
    scene.update_point_3d_errors()
    lengths = np.linalg.norm(own.residuals_px, axis=1)
    target = own.problem.observations.target_index
    means = np.bincount(target, weights=lengths) / np.bincount(target)
    np.testing.assert_allclose([scene.points3D[i + 1].error for i in range(means.size)], means, rtol=1e-7)


def test_intrinsics_have_the_same_covariance(both):
    """Joint with everything else, in both programs, and no matter of the datum."""
    own, scene, covariance = both
    ours = own.cameras[0].covariance[np.ix_(COLUMNS, COLUMNS)]
    theirs = SIGMA_PX**2 * np.array(covariance.get_other_params_cov(scene.cameras[1].params))
    sigma = np.sqrt(np.diag(theirs))
    np.testing.assert_allclose(ours / sigma[:, None] / sigma, theirs / sigma[:, None] / sigma, atol=1e-5)


def test_its_covariance_of_points_is_conditional(both):
    """It holds cameras and poses to be true: our own block without them agrees, our joint covariance is far larger."""
    own, scene, covariance = both
    turn, scale, _, _ = similarity(own, scene)
    ratios = []
    for i in range(len(own.points_m)):
        theirs = SIGMA_PX**2 * np.array(covariance.get_point_cov(i + 1))
        conditional = np.linalg.inv(own.system.normal.targets[own.system.layout.slot[i]])
        np.testing.assert_allclose(
            scale**2 * turn @ conditional @ turn.T, theirs, atol=1e-6 * np.trace(theirs), err_msg=str(i)
        )
        ratios.append(np.sqrt(scale**2 * np.trace(own.covariance.points[i]) / np.trace(theirs)))
    # With inner constraints, the datum that makes the joint covariance smallest; never less than the conditional one.
    assert min(ratios) > 1.0
    assert np.median(ratios) > 1.05
    # With the two cameras held, as the other program has them, the points' own uncertainty is many times that.
    held = Datum(DatumKind.PHOTOS, photos=("0", "1"))
    elsewhere = adjust(replace(own.problem, datum=held), own.state)
    assert np.median(np.linalg.norm(elsewhere.sigma_points_m, axis=1) / np.linalg.norm(own.sigma_points_m, axis=1)) > 3
