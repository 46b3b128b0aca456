"""What follows from an uncertain pose, against finite steps."""

import numpy as np

from heliogauge.geometry.rigid import RigidTransform


def test_the_place_of_a_camera_is_known_as_small_steps_of_its_pose_say() -> None:
    rng = np.random.default_rng(0)
    pose = RigidTransform.from_rotation_vector([0.4, -1.1, 0.7], [0.5, -2.0, 14.0])
    root = rng.standard_normal((6, 6)) * 1e-3
    steps = 1e-6 * np.eye(6)
    by_step = np.stack(
        [(pose.moved(s).inverse().translation_m - pose.moved(-s).inverse().translation_m) / 2e-6 for s in steps], axis=1
    )
    expected = by_step @ root @ root.T @ by_step.T
    np.testing.assert_allclose(pose.origin_covariance(root @ root.T), expected, rtol=1e-6, atol=1e-12)
    # Turned alone it swings by its distance.
    swing = pose.origin_covariance(np.diag([1e-6, 1e-6, 1e-6, 0, 0, 0]))
    np.testing.assert_allclose(np.trace(swing), 2e-6 * np.sum(pose.translation_m**2))
