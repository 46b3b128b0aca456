"""Start values without any from the user, and what happens where there are none."""

import numpy as np
import pytest

from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError
from photogrammetry.bundle.adjustment import adjust
from photogrammetry.bundle.alignment import aligned_to_control
from photogrammetry.bundle.problem import BundleProblem, CameraModel
from photogrammetry.bundle.state import BundleState
from photogrammetry.image_points import ImagePoints
from photogrammetry.start_values.network import StartValues, build_network, guessed_camera
from tests.photogrammetry.bundle_networks import camera_of, look_at, network, observe


def agrees(found, truth, tolerance_m):
    """Compare a network with the truth after a similarity."""
    names = found.observations.targets
    control = {name: truth.points_m[int(name[1:])] for name in names}
    moved = aligned_to_control(found.state, names, control)
    # The control was put in place: poses tell.
    centers = np.array([truth.centers_m[int(name[5:])] for name in found.observations.photos])
    np.testing.assert_allclose(moved.centers_m, centers, atol=tolerance_m)


@pytest.mark.parametrize("height", [0.6, 0.0], ids=["uneven", "plane"])
def test_known_camera(height):
    rng = np.random.default_rng(4)
    truth, _ = network(rng, 12, 40)
    truth = BundleState.from_poses(
        truth.cameras, [truth.cam_from_world(i) for i in range(12)], truth.points_m * [1, 1, height]
    )
    found = build_network(observe(truth, rng, 0.1), truth.cameras)
    assert len(found.observations.photos) == 12
    assert len(found.observations.targets) == 40
    assert found.photos_left_out == found.targets_left_out == found.suspicious == ()
    agrees(found, truth, 0.01)


def test_start_values_are_gone_on_from_in_their_own_frame():
    rng = np.random.default_rng(4)
    truth, _ = network(rng, 10, 40)
    points = observe(truth, rng, 0.1)
    # Three photos and half of the targets have start values, a little off; the rest is tied in.
    poses = {f"photo{i}": truth.cam_from_world(i).moved(rng.normal(0, 3e-3, 6)) for i in (0, 4, 7)}
    near = {f"t{i}": truth.points_m[i] + rng.normal(0, 5e-3, 3) for i in range(20)}
    found = build_network(points, truth.cameras, start=StartValues(poses, near))
    assert len(found.observations.photos) == 10
    assert len(found.observations.targets) == 40
    order = [int(name[1:]) for name in found.observations.targets]
    np.testing.assert_allclose(found.state.points_m, truth.points_m[order], atol=0.02)
    alone = build_network(points, truth.cameras)
    assert np.abs(alone.state.points_m - truth.points_m[order]).max() > 0.5


def test_start_values_the_wrong_way_round_are_refused():
    rng = np.random.default_rng(4)
    truth, points = network(rng, 6, 40)
    poses = {f"photo{i}": truth.cam_from_world(i).inverse() for i in range(6)}
    near = {f"t{i}": truth.points_m[i] for i in range(40)}
    with pytest.raises(EstimationError, match="cam_from_world"):
        build_network(points, truth.cameras, start=StartValues(poses, near))


def test_guessed_camera_calibrates_itself():
    rng = np.random.default_rng(5)
    truth, points = network(rng, 20, 60)
    free = ("focal_px", "center_x_px", "center_y_px", "k1", "k2", "p1", "p2")
    guess = guessed_camera(6000, 4000, focal_length_35mm=35.0)
    assert abs(guess.focal_x_px / truth.cameras[0].focal_x_px - 1) > 0.03
    found = build_network(points, [guess], models=[CameraModel("c", free)])
    assert len(found.observations.photos) == 20
    result = adjust(BundleProblem(found.observations, (CameraModel("c", free),)), found.state).require()
    sigma = result.cameras[0].sigma_parameters[0]
    assert abs(result.cameras[0].focal_y_px - 6103.0) < max(5 * sigma, 3.0)


def test_false_targets_and_lonely_photos_are_left_out_by_name():
    rng = np.random.default_rng(6)
    truth, points = network(rng, 12, 40)
    pixels = points.pixels_px.copy()
    bad = rng.choice(points.n, 10, replace=False)
    pixels[bad] += rng.choice([-1, 1], (10, 2)) * rng.uniform(50, 400, (10, 2))
    # Two false codes, one seen in one photo, one at two unrelated places; a photo with one target, one with none.
    extra_photo, extra_target = [0, 3, 7, 12], [40, 41, 41, 0]
    mixed = ImagePoints(
        (*points.photos, "lonely", "empty"),
        (*points.targets, "false once", "false twice"),
        np.concatenate([points.photo_index, extra_photo]),
        np.concatenate([points.target_index, extra_target]),
        np.concatenate([pixels, [[100, 100], [500, 900], [5000, 300], [3000, 2000]]]),
        np.concatenate([points.covariance_px2, points.covariance_px2[:4]]),
    )
    found = build_network(mixed, truth.cameras)
    left = {one.name: one.reason for one in found.photos_left_out}
    assert set(left) == {"lonely", "empty"}
    assert "1 targets, 4 are needed" in left["lonely"]
    lost = {one.name: one.reason for one in found.targets_left_out}
    assert set(lost) == {"false once", "false twice"}
    assert "photo0" in lost["false once"]
    assert {one.name for one in found.suspicious} == {points.label(int(i)) for i in bad}
    agrees(found, truth, 0.01)


def test_all_photos_from_one_spot():
    rng = np.random.default_rng(7)
    truth, _ = network(rng, 3, 40)
    center = np.array([0.0, 6.0, 6.0])
    poses = [look_at(center, [x, 0.0, 0.0], roll) for x, roll in ((-1, 0.0), (0, 1.0), (1, 2.0), (0.5, 0.5))]
    spot = BundleState.from_poses(truth.cameras, poses, truth.points_m)
    with pytest.raises(EstimationError, match="one place"):
        build_network(observe(spot, rng, 0.1), truth.cameras)


def test_photos_without_overlap():
    rng = np.random.default_rng(8)
    truth, points = network(rng, 4, 40)
    alone = points.subset(points.target_index % 4 == points.photo_index)
    with pytest.raises(EstimationError, match="the most is 0"):
        build_network(alone, truth.cameras)


def test_two_groups_leave_one_out_with_the_reason():
    rng = np.random.default_rng(9)
    truth, points = network(rng, 9, 40)
    group = np.where(points.photo_index < 6, points.target_index < 25, points.target_index >= 23)
    found = build_network(points.subset(group), truth.cameras)
    assert set(found.observations.photos) == {f"photo{i}" for i in range(6)}
    assert {one.name for one in found.photos_left_out} == {"photo6", "photo7", "photo8"}
    assert all("2 targets with the network" in one.reason for one in found.photos_left_out)


@pytest.mark.slow
def test_real_photos_of_square_markers(shared_data):
    """54 photos of a room; false markers are left out by name."""
    cv2 = pytest.importorskip("cv2")
    folder = shared_data / "opencsp" / "scene_reconstruction" / "aruco_marker_images"
    files = sorted(folder.glob("*.JPG"))
    if not files:
        pytest.skip("the photos are not on this machine")
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_1000))
    photos, targets, pixels = [], [], []
    for file in files:
        image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        corners, ids, _ = detector.detectMarkers(image)
        for quad, marker in zip(corners, ids.ravel(), strict=True):
            side = np.linalg.norm(quad[0] - np.roll(quad[0], 1, axis=0), axis=1).min()
            half = int(np.clip(0.12 * side, 2, 6))
            stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-3)
            fine = cv2.cornerSubPix(image, quad.reshape(-1, 1, 2), (half, half), (-1, -1), stop)
            photos += [file.stem] * 4
            targets += [f"{marker}.{k}" for k in range(4)]
            pixels.append(fine.reshape(4, 2))
    # Four markers that are not there, each in one photo.
    rng = np.random.default_rng(0)
    for k, marker in enumerate((501, 733, 850, 999)):
        photos += [files[5 * k].stem] * 4
        targets += [f"{marker}.{i}" for i in range(4)]
        corner = rng.uniform([100, 100], [1500, 1000])
        pixels.append(corner + np.array([[0, 0], [40, 0], [40, 40], [0, 40]]))
    names = tuple(dict.fromkeys(photos)), tuple(dict.fromkeys(targets))
    points = ImagePoints(
        *names,
        [names[0].index(name) for name in photos],
        [names[1].index(name) for name in targets],
        np.concatenate(pixels).astype(np.float64),
        np.broadcast_to(np.eye(2) * 0.15**2, (len(photos), 2, 2)),
    )
    # camera.h5, whose matrix is divided by 5; all but the element (3, 3) is as meant.
    lens = camera_of().distortion.with_coefficients([-0.05576391, 0.03966674, -0.00055473, 0.00049181, 0.0])
    camera = Camera(1728, 1152, 937.474756, 935.571561, 869.741631, 576.088437, distortion=lens)
    found = build_network(points, [camera])
    assert len(found.observations.photos) == 54
    assert {one.name.split(".")[0] for one in found.targets_left_out} == {"501", "733", "850", "999"}
    result = adjust(BundleProblem(found.observations, (CameraModel("room"),)), found.state).require()
    assert np.sqrt((result.residuals_px**2).mean()) < 0.16
    assert np.isfinite(result.sigma_points_m).all()


@pytest.mark.slow
def test_a_guess_three_times_too_long_is_tried_again():
    truth, points = network(np.random.default_rng(1), 10, 30, size_m=1.0)
    guess = guessed_camera(6000, 4000, focal_length_35mm=100.0)
    free = ("focal_px", "aspect", "center_x_px", "center_y_px", "k1", "k2", "p1", "p2", "k3")
    found = build_network(points, [guess], models=[CameraModel("c", free)])
    assert found.observations.n > 0.98 * points.n
    assert found.state.cameras[0].focal_y_px == pytest.approx(truth.cameras[0].focal_y_px, rel=2e-3)
    assert found.noise < 1.5


def test_a_single_photo_is_said_to_be_one() -> None:
    _, table = network(np.random.default_rng(1), 4, 12)
    one = table.subset(np.nonzero(table.photo_index == 0)[0]).compacted()
    with pytest.raises(EstimationError, match=r"only .* shows targets; take photos from two places or more"):
        build_network(one, [guessed_camera(6000, 4000)])
