import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from heliogauge.errors import EstimationError
from heliogauge.geometry.alignment import align_points
from heliogauge.geometry.rigid import RigidTransform, nearest_rotation

RNG = np.random.default_rng(11)
POINTS = RNG.normal(size=(7, 3)) * [3.0, 1.0, 0.4] + [20.0, -4.0, 1.0]
MOTION = RigidTransform.from_rotation_vector([0.4, -1.9, 0.8], [5.0, -2.0, 30.0])


def test_a_motion_is_found_again() -> None:
    found = align_points(POINTS, MOTION.apply(POINTS))
    np.testing.assert_allclose(found.b_from_a.rotation, MOTION.rotation, atol=1e-13)
    np.testing.assert_allclose(found.b_from_a.translation_m, MOTION.translation_m, atol=1e-11)
    assert found.scale == 1.0
    assert found.misfit_m < 1e-13


def test_a_similarity_is_found_again() -> None:
    found = align_points(POINTS, 0.31 * MOTION.apply(POINTS), with_scale=True)
    assert found.scale == pytest.approx(0.31, rel=1e-13)
    np.testing.assert_allclose(found.b_from_a.rotation, MOTION.rotation, atol=1e-13)
    np.testing.assert_allclose(found.b_from_a.translation_m, 0.31 * MOTION.translation_m, atol=1e-11)


def test_noisy_points_against_scipy() -> None:
    moved = MOTION.apply(POINTS) + 0.02 * RNG.normal(size=POINTS.shape)
    found = align_points(POINTS, moved)
    wanted = Rotation.align_vectors(moved - moved.mean(axis=0), POINTS - POINTS.mean(axis=0))[0].as_matrix()
    np.testing.assert_allclose(found.b_from_a.rotation, wanted, atol=1e-12)


def test_no_mirror_image_is_ever_taken() -> None:
    found = align_points(POINTS, POINTS * [1.0, 1.0, -1.0])
    assert np.linalg.det(found.b_from_a.rotation) == pytest.approx(1.0)
    assert found.misfit_m > 0.1


def test_stated_misfit_and_turn_are_honest() -> None:
    base = RNG.normal(size=(6, 3)) * [2.0, 0.1, 0.1]
    axis = np.linalg.svd(base - base.mean(axis=0))[2][0]
    turns, stated, misfits = [], [], []
    for _ in range(400):
        found = align_points(base, base + 0.01 * RNG.normal(size=base.shape))
        turns.append(Rotation.from_matrix(found.b_from_a.rotation).as_rotvec() @ axis)
        stated.append(found.sigma_turn_rad)
        misfits.append(found.misfit_m)
    assert np.sqrt(np.mean(np.square(misfits))) == pytest.approx(0.01, rel=0.05)
    assert np.std(turns) == pytest.approx(np.sqrt(np.mean(np.square(stated))), rel=0.12)


def _narrow(width_m: float, misfit_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Corners of a rectangle, and the same twisted out of its plane, which no motion follows."""
    corners = np.array([[-1.0, -width_m, 0], [-1.0, width_m, 0], [1.0, -width_m, 0], [1.0, width_m, 0]])
    return corners, corners + misfit_m * np.array([[0, 0, 1.0], [0, 0, -1.0], [0, 0, -1.0], [0, 0, 1.0]])


def test_a_turn_of_a_third_of_a_radian_is_open() -> None:
    # s = sqrt(4 e^2 / 6), the squared distances from the line are 4 d^2 in sum: s / sqrt(4 d^2) = 1/3 at d = 1.2247 e.
    misfit = 1e-3
    limit = 3 / np.sqrt(6) * misfit
    assert align_points(*_narrow(1.4 * limit, misfit)).sigma_turn_rad == pytest.approx(1 / 4.2, rel=1e-4)
    with pytest.raises(EstimationError, match=r"on one line.* uncertain by 0\.48 rad"):
        align_points(*_narrow(0.7 * limit, misfit))


def test_a_contradiction_of_a_tenth_of_the_size_is_no_line() -> None:
    # The misfit is sqrt(4 e^2 / 6) in a set of size 1: 0.07 may be noise, 0.14 is not.
    with pytest.raises(EstimationError, match="on one line"):
        align_points(*_narrow(0.05, 0.07 * np.sqrt(1.5)))
    assert align_points(*_narrow(0.1, 0.14 * np.sqrt(1.5))).misfit_m == pytest.approx(0.14, rel=0.02)


def test_two_points_exchanged_are_aligned_as_far_as_they_go() -> None:
    wrong = POINTS[[1, 0, 2, 3, 4, 5, 6]]
    found = align_points(POINTS, MOTION.apply(wrong))
    assert found.misfit_m > 0.1


@pytest.mark.parametrize("with_scale", [False, True])
def test_points_exactly_on_a_line_are_refused(with_scale: bool) -> None:
    for _ in range(50):
        line = RNG.normal(size=3) * 10 + RNG.normal(size=(5, 1)) * RNG.normal(size=3)
        with pytest.raises(EstimationError, match=r"on one line.*\(A, B, C, D, E\)"):
            align_points(line, MOTION.apply(line), with_scale=with_scale, names="ABCDE")


def test_a_narrow_exact_set_is_not_refused() -> None:
    # 0.1 mm beside a line of 2 m at 1 km from the origin, without a misfit.
    points = _narrow(1e-4, 0.0)[0] + [1000.0, -300.0, 20.0]
    found = align_points(points, MOTION.apply(points))
    np.testing.assert_allclose(found.b_from_a.rotation, MOTION.rotation, atol=1e-6)


def test_a_set_that_fits_its_mirror_image_is_refused() -> None:
    cube = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    with pytest.raises(EstimationError, match=r"contradict each other.* mirror image"):
        align_points(cube, -cube)


def test_two_points_are_too_few() -> None:
    with pytest.raises(EstimationError, match="three common points are needed, not 2"):
        align_points(POINTS[:2], POINTS[:2])


def test_nearest_rotation_turns_a_reflection_back() -> None:
    assert np.linalg.det(nearest_rotation(np.diag([3.0, 2.0, -1.0]))) == pytest.approx(1.0)
    np.testing.assert_allclose(nearest_rotation(2.5 * MOTION.rotation), MOTION.rotation, atol=1e-14)
