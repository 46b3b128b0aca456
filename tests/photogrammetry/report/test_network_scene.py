"""The scene of a network: ellipsoids and cameras are where the numbers say."""

import numpy as np
import pytest

from photogrammetry.report.scene import ellipsoid_lines, magnification, pyramid_lines
from tests.photogrammetry.bundle_networks import camera_of, look_at


def covariances(rng, count):
    roots = rng.normal(size=(count, 3, 3)) * 1e-4
    return roots @ np.swapaxes(roots, 1, 2)


@pytest.mark.parametrize("count", [5, 500])
def test_ellipsoids_lie_on_one_sigma(count) -> None:
    rng = np.random.default_rng(1)
    centers, matrices = rng.normal(size=(count, 3)), covariances(rng, count)
    vertices, lengths = ellipsoid_lines(centers, matrices, 100.0)
    assert sum(lengths) == len(vertices)
    # Three lines for each point; sections one after the other for few, axes together for many.
    owner = np.tile(np.arange(count), 3) if count < 400 else np.repeat(np.arange(count), 3)
    arms = (vertices - centers[np.repeat(owner, lengths)]) / 100.0
    inverse = np.linalg.inv(matrices)[np.repeat(owner, lengths)]
    np.testing.assert_allclose(np.einsum("vi,vij,vj->v", arms, inverse, arms), 1.0, rtol=1e-5)


def test_largest_ellipsoid_is_a_twentieth_of_the_network() -> None:
    matrices = covariances(np.random.default_rng(2), 30)
    largest = np.sqrt(np.linalg.eigvalsh(matrices).max())
    assert 0.05 <= magnification(matrices, 3.0) * largest / 3.0 <= 0.0651


def test_pyramid_is_what_the_camera_sees() -> None:
    camera, pose = camera_of(), look_at(np.array([1.0, 2.0, 3.0]), np.zeros(3), 0.4)
    vertices, lengths = pyramid_lines(camera, pose, 0.2)
    assert sum(lengths) == len(vertices) == 12
    seen = pose.apply(vertices)
    np.testing.assert_allclose(vertices[5], [1.0, 2.0, 3.0], atol=1e-12)
    # The first line's corners are the image's: left top, right top; the roof is above them (y of a camera is down).
    assert seen[0] == pytest.approx([-0.2 * 3000 / 6100, -0.2 * 2000 / 6103, 0.2])
    assert seen[7, 1] < seen[0, 1]
