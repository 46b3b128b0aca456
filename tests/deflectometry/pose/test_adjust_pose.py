"""The pose of mirrors drawn with exact pixel areas: recovery, honest covariance, contradictions, refusals."""

import importlib.util
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deflectometry.pose.adjust_pose import MirrorPose, pose_from_outline, pose_from_points
from deflectometry.pose.mirror_outline import beside_another, mirror_masks, sample_outlines
from deflectometry.pose.mirrors_in_image import find_mirrors
from deflectometry.pose.outline_edges import correlation_points, edge_blur_px, edge_margin_px
from deflectometry.pose.pose_observations import DistanceObservation, Knowledge, KnownPoints
from deflectometry.pose.start_poses import point_poses, start_poses
from heliogauge.camera.distortion import BrownDistortion
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError, InputError
from heliogauge.flags import SampleFlag
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet, Quadric, paraboloid

_SPEC = importlib.util.spec_from_file_location("drawing", Path(__file__).parents[1] / "drawing.py")
assert _SPEC is not None
assert _SPEC.loader is not None
_DRAWING = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(_DRAWING)
draw_mirror: Any = _DRAWING.draw_mirror

CAMERA = Camera(203, 154, 690.0, 685.0, 101.0, 77.0, distortion=BrownDistortion(k1=-0.14, k2=1.6))
FRONT = RigidTransform.from_rotation_vector([np.pi, 0, 0], [0.1, 0.0, 9.7])
POSE = FRONT.moved([0.12, 0.2, 0.05, 0, 0, 0])
SCREEN_M = np.array([4.0, 0.1, 0.3])
#: Drawings have no rims: their sides have nothing in common that the design does not know.
IDEAL_SIDES = Knowledge(side_share=0.0)


def _rectangle(width_m: float = 1.2, height_m: float = 1.2, design: Quadric | None = None) -> Facet:
    x, y = width_m / 2, height_m / 2
    return Facet("facet", np.array([[-x, -y], [x, -y], [x, y], [-x, y]]), design or paraboloid(100.0))


def _draw(
    pose: RigidTransform,
    facets: list[Facet],
    *,
    camera: Camera = CAMERA,
    noise: float = 1.0,
    **keys: Any,
) -> np.ndarray:
    image = draw_mirror(camera, pose, facets, **keys)
    return np.asarray(image + np.random.default_rng(0).normal(0, noise, image.shape))


def _rolled(pose: RigidTransform, roll_rad: float) -> RigidTransform:
    """Turn the mirror in place; a positive roll is counter-clockwise as displayed: about the camera's -z."""
    turn = RigidTransform.from_rotation_vector([0, 0, -roll_rad], [0, 0, 0])
    return RigidTransform(turn.rotation @ pose.rotation, pose.translation_m)


def _off(found: RigidTransform, true: RigidTransform) -> np.ndarray:
    turn = RigidTransform(found.rotation @ true.rotation.T, np.zeros(3)).rotation_vector_rad
    return np.concatenate([turn, found.translation_m - true.translation_m])


def _chi_square(found: MirrorPose, true: RigidTransform) -> float:
    off = _off(found.cam_from_mirror, true)
    return float(off @ np.linalg.solve(found.covariance, off))


def _distance(pose: RigidTransform, extra_m: float = 0.0, sigma_m: float = 0.005) -> DistanceObservation:
    point = np.array([0.1, 0.0, 0.0])
    return DistanceObservation(float(np.linalg.norm(pose.apply(point) - SCREEN_M)) + extra_m, sigma_m, point, SCREEN_M)


def test_pose_of_a_single_facet_comes_back_without_start_values() -> None:
    found = pose_from_outline(_draw(POSE, [_rectangle()]), CAMERA, [_rectangle()], IDEAL_SIDES)
    assert _chi_square(found, POSE) < 22.5  # 99.9 % of chi-square with 6 degrees of freedom
    assert found.residual_rms_px < 0.03
    assert found.n_rejected < 0.05 * found.n_points
    assert found.facet_share.tolist() == [1.0]


def test_curved_and_distorted_sides_leave_no_residual() -> None:
    # f = 1.5 m: the middles of the sides lie 60 mm deeper than the corners, 1 px in this image.
    deep = _rectangle(design=paraboloid(1.5))
    found = pose_from_outline(_draw(POSE, [deep]), CAMERA, [deep], IDEAL_SIDES)
    assert found.residual_rms_px < 0.03
    assert _chi_square(found, POSE) < 22.5
    flat = pose_from_outline(_draw(POSE, [deep]), CAMERA, [_rectangle()], Knowledge((_distance(POSE),), side_share=0.0))
    assert flat.doubts
    assert flat.residual_rms_px > 2 * found.residual_rms_px


@pytest.mark.slow
def test_covariance_is_honest() -> None:
    rng = np.random.default_rng(7)
    total, runs = 0.0, 0
    for scene in range(20):
        pose = FRONT.moved(np.concatenate([rng.normal(0, 0.15, 3), rng.normal(0, 0.05, 3)]))
        clean = draw_mirror(CAMERA, pose, [_rectangle()], blur_px=(0.0, 0.6, 1.5)[scene % 3])
        for _ in range(3):
            image = clean + rng.normal(0, 1.5, clean.shape)
            total += _chi_square(pose_from_outline(image, CAMERA, [_rectangle()], IDEAL_SIDES), pose)
            runs += 1
    # 99.9 % band of chi-square over its 360 degrees of freedom, with a tenth for the fixed part of pixel sampling.
    assert 0.70 < total / (6 * runs) < 1.27 * 1.1


def test_what_a_side_has_in_common_widens_the_covariance() -> None:
    image = _draw(POSE, [_rectangle()])
    ideal = pose_from_outline(image, CAMERA, [_rectangle()], IDEAL_SIDES)
    wide = pose_from_outline(image, CAMERA, [_rectangle()], Knowledge(side_share=0.0, sigma_outline_m=0.001))
    # The outline 1 mm off on each side is 1 mm / 1.2 m * sqrt(2) of size: 11 mm of distance.
    assert ideal.covariance[5, 5] < 0.002**2
    assert np.sqrt(wide.covariance[5, 5]) == pytest.approx(0.011, rel=0.5)


def test_measured_distance_is_weighted_not_forced() -> None:
    image = _draw(POSE, [_rectangle()])
    alone = pose_from_outline(image, CAMERA, [_rectangle()], IDEAL_SIDES)
    loose = pose_from_outline(image, CAMERA, [_rectangle()], Knowledge((_distance(POSE, 0.003, 0.01),), side_share=0.0))
    (test,) = loose.distance_tests
    assert test.probability > 0.05
    assert test.image_only_m == pytest.approx(_distance(POSE).distance_m, abs=4 * test.sigma_image_only_m)
    assert loose.covariance[5, 5] < alone.covariance[5, 5]
    # One of two observations with sigma: the pose moves by their share, not onto the distance.
    share = test.sigma_image_only_m**2 / (test.sigma_image_only_m**2 + 0.01**2)
    moved = test.residual_m + test.measured_m - test.image_only_m
    assert moved == pytest.approx(share * (test.measured_m - test.image_only_m), rel=0.05)


def test_wrong_distance_is_doubted_with_both_residuals() -> None:
    image = _draw(POSE, [_rectangle()])
    found = pose_from_outline(image, CAMERA, [_rectangle()], Knowledge((_distance(POSE, 0.08, 0.002),)))
    (doubt,) = found.doubts
    assert doubt.code == "distance_contradicts_image"
    assert re.search(r"contradicts the image.*mm and .* px", doubt.text)
    assert doubt.numbers["measured_m"] - doubt.numbers["image_only_m"] == pytest.approx(0.08, abs=0.03)
    assert found.distance_tests[0].probability < 1e-4
    assert found.residual_rms_px > found.image_only_rms_px
    assert abs(found.distance_tests[0].residual_m) > 0.0005


def test_without_a_distance_there_is_no_test() -> None:
    assert pose_from_outline(_draw(POSE, [_rectangle()]), CAMERA, [_rectangle()]).distance_tests == ()


@pytest.mark.parametrize("roll", [0.0, 0.5, np.pi / 2, -np.pi / 2, np.pi])
def test_expected_roll_decides_which_corner_is_which(roll: float) -> None:
    pose = _rolled(POSE, roll)
    found = pose_from_outline(
        _draw(pose, [_rectangle()]), CAMERA, [_rectangle()], Knowledge(roll_rad=roll + 0.1, side_share=0.0)
    )
    assert np.abs(_off(found.cam_from_mirror, pose)).max() < 0.01


@pytest.mark.parametrize("roll", [0.0, np.pi / 2, np.pi, -np.pi / 2])
def test_a_square_exactly_in_front_of_the_camera_is_found(roll: float) -> None:
    """Nothing tilts its outline: the mirror's frame is an exact half turn from the camera's."""
    camera = Camera(161, 161, 690.0, 690.0, 80.0, 80.0)
    facet, front = _rectangle(), RigidTransform(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 9.7]))
    pose = _rolled(front, roll)
    starts = start_poses(camera, find_mirrors(draw_mirror(camera, pose, [facet])).regions, [facet], roll)
    assert np.abs(_off(starts[0].cam_from_mirror, pose)).max() < 0.1
    # Which distances a solver loses is up to rounding.
    corners = np.column_stack([facet.outline_m, np.zeros(4)])
    for distance in np.linspace(8.5, 30.0, 50):
        pose = _rolled(RigidTransform(front.rotation, np.array([0.0, 0.0, distance])), roll)
        known = point_poses(camera, corners, camera.project(pose.apply(corners)))
        assert np.abs(_off(known[0].cam_from_mirror, pose)).max() < 1e-3


def test_a_shape_without_symmetry_needs_no_roll() -> None:
    corners = np.array([[-0.6, -0.5], [0.6, -0.5], [0.3, 0.5], [-0.6, 0.4]])
    facet = Facet("odd", corners, paraboloid(50.0))
    pose = _rolled(POSE, -2.0)
    found = pose_from_outline(_draw(pose, [facet]), CAMERA, [facet], IDEAL_SIDES)
    assert np.abs(_off(found.cam_from_mirror, pose)).max() < 0.01


def test_round_mirror_is_followed_by_its_many_sides() -> None:
    angles = 2 * np.pi * np.arange(48) / 48
    facet = Facet("round", 0.6 * np.column_stack([np.cos(angles), np.sin(angles)]), paraboloid(20.0))
    found = pose_from_outline(_draw(POSE, [facet]), CAMERA, [facet], IDEAL_SIDES)
    np.testing.assert_allclose(found.cam_from_mirror.translation_m, POSE.translation_m, atol=0.02)
    assert found.residual_rms_px < 0.05


def test_two_tilts_that_look_alike_are_told_apart_by_the_screen() -> None:
    # From 2 km with a long lens there is no perspective.
    camera = Camera(203, 154, 140_000.0, 140_000.0, 101.0, 77.0)
    far = RigidTransform.from_rotation_vector([np.pi, 0, 0], [0, 0, 2000.0]).moved([0, 0.15, 0, 0, 0, 0])
    facet = _rectangle(design=paraboloid(1000.0))
    bisector = far.rotation[:, 2]
    line = -far.translation_m / 2000.0
    screen = far.translation_m + 2000 * (2 * (bisector @ line) * bisector - line)
    image = _draw(far, [facet], camera=camera, noise=3.0)
    distance = DistanceObservation(float(np.linalg.norm(far.translation_m - screen)), 20.0, np.zeros(3), screen)
    found = pose_from_outline(image, camera, [facet], Knowledge((distance,)))
    assert "mirror_tilt_ambiguous" in [one.code for one in found.doubts]
    assert found.cam_from_mirror.rotation[:, 2] @ bisector > np.cos(0.1)


def test_clips_and_stains_on_the_edge_are_rejected() -> None:
    image = _draw(POSE, [_rectangle()])
    clean = pose_from_outline(image, CAMERA, [_rectangle()], IDEAL_SIDES)
    columns = [int(x) for x in CAMERA.project(POSE.apply([[-0.2, -0.6, 0], [0.1, -0.6, 0]]))[:, 0]]
    row = int(CAMERA.project(POSE.apply([0.0, -0.6, 0]))[1])
    for column in columns:
        image[row - 3 : row + 3, column : column + 4] = 10
    clipped = pose_from_outline(image, CAMERA, [_rectangle()], IDEAL_SIDES)
    assert clipped.n_points <= clean.n_points - 8
    assert _chi_square(clipped, POSE) < 22.5


@pytest.mark.parametrize(("shift", "side"), [([0.9, 0, 0], "right"), ([0, -0.8, 0], "top")])
def test_a_facet_on_the_border_is_refused(shift: list[float], side: str) -> None:
    cut = RigidTransform(POSE.rotation, POSE.translation_m + shift)
    with pytest.raises(EstimationError, match=f"touches the {side} border.*mirror.pose"):
        pose_from_outline(_draw(cut, [_rectangle()]), CAMERA, [_rectangle()])


def test_an_outline_of_another_shape_is_refused() -> None:
    angles = 2 * np.pi * np.arange(48) / 48
    disc = Facet("round", 0.6 * np.column_stack([np.cos(angles), np.sin(angles)]), paraboloid(20.0))
    with pytest.raises(EstimationError, match="does not fit the mirror's outline"):
        pose_from_outline(_draw(POSE, [disc]), CAMERA, [_rectangle()])


def test_no_mirror_and_wrong_size_are_refused() -> None:
    with pytest.raises(EstimationError, match="no mirror in view"):
        pose_from_outline(np.random.default_rng(1).normal(10, 1, (154, 203)), CAMERA, [_rectangle()])
    with pytest.raises(InputError, match="203 x 154 px"):
        pose_from_outline(np.zeros((100, 100)), CAMERA, [_rectangle()])
    with pytest.raises(InputError, match="side_share"):
        Knowledge(side_share=-1.0)


# --- ensembles ------------------------------------------------------------------------------------------------------


def test_facets_beside_their_places_tell_no_tilts_apart() -> None:
    """Nine facets 201 m away, squarely before the camera, each 1 mm beside its place.

    The scatter that they make gives two tilts 4 degrees apart, of which neither is right.
    """
    camera = Camera(375, 275, 15125.0, 15125.0, 187.0, 137.5)
    square = RigidTransform.from_rotation_vector([np.pi, 0, 0], [0.1, 0.05, 201.0]).moved([0.012, 0, 0.02, 0, 0, 0])
    rng = np.random.default_rng(1)
    stated, true = [], []
    for number in range(9):
        place = np.array([(number % 3 - 1) * 1.53, (number // 3 - 1) * 1.03, 0.0])
        for facets, where in ((stated, place), (true, place + 1e-3 * rng.standard_normal(3))):
            pose = RigidTransform.from_rotation_vector([0, 0, 0], where)
            facets.append(Facet(str(number), _rectangle(1.5, 1.0).outline_m, paraboloid(200.0), pose))
    known = Knowledge(sigma_places_m=(np.full(3, 1e-3),) * 9)
    found = pose_from_outline(_draw(square, true, camera=camera), camera, stated, known)
    assert "mirror_tilt_ambiguous" in [one.code for one in found.doubts]
    # Half of the way to the other tilt is where the mirror is.
    off = _off(found.cam_from_mirror, square)[:3]
    covariance = found.covariance[:3, :3] + 0.25 * np.outer(found.other_tilt_rad, found.other_tilt_rad)
    assert np.linalg.norm(found.other_tilt_rad) > 0.03
    assert off @ np.linalg.solve(covariance, off) < 16.3
    # Turned by 6 degrees, they are known to be.
    turned = square.moved([0, 0.1, 0, 0, 0, 0])
    found = pose_from_outline(_draw(turned, true, camera=camera), camera, stated, known)
    assert "mirror_tilt_ambiguous" not in [one.code for one in found.doubts]
    assert found.cam_from_mirror.rotation[:, 2] @ turned.rotation[:, 2] > np.cos(0.02)


WIDE_CAMERA = Camera(300, 330, 840.0, 840.0, 150.0, 165.0)
WIDE_POSE = RigidTransform.from_rotation_vector([np.pi, 0, 0], [0.05, 0.02, 11.0]).moved([0.1, 0.2, 0.06, 0, 0, 0])


def _ensemble(gap_m: float = 0.08) -> list[Facet]:
    facets = []
    for row in range(6):
        for column in range(4):
            x, y = (column - 1.5) * (0.6 + gap_m), (row - 2.5) * (0.5 + gap_m)
            place = RigidTransform.from_rotation_vector([y / 60, -x / 60, 0], [x, y, (x * x + y * y) / 120])
            facet = _rectangle(0.6, 0.5, paraboloid(30.0))
            facets.append(Facet(f"{row}{column}", facet.outline_m, facet.design, place))
    return facets


@pytest.mark.parametrize("missing", [(), (0,), (9,)])
def test_ensemble_of_24_is_found_also_with_one_missing(missing: tuple[int, ...]) -> None:
    facets = _ensemble()
    seen = [facet for number, facet in enumerate(facets) if number not in missing]
    image = _draw(WIDE_POSE, seen, camera=WIDE_CAMERA)
    found = pose_from_outline(image, WIDE_CAMERA, facets, IDEAL_SIDES)
    assert _chi_square(found, WIDE_POSE) < 22.5
    assert np.flatnonzero(found.facet_share < 0.5).tolist() == list(missing)
    assert [one.code for one in found.doubts] == ["facets_dark"] * len(missing)
    assert all(f"numbers {missing[0]})" in one.text for one in found.doubts)


def test_ensemble_with_gaps_too_narrow_to_see_is_found_by_its_rim() -> None:
    facets = _ensemble(0.004)
    found = pose_from_outline(_draw(WIDE_POSE, facets, camera=WIDE_CAMERA), WIDE_CAMERA, facets, IDEAL_SIDES)
    assert _chi_square(found, WIDE_POSE) < 22.5
    assert found.facet_share.min() > 0.9


def test_sides_next_to_another_facet_are_known() -> None:
    facets = _ensemble(0.004)
    outline = sample_outlines(facets, 8)
    beside = beside_another(facets, outline, 0.02)
    # 4 x 6 facets have 2 * (4 + 6) free sides of 96.
    assert (~beside.all(axis=1)).sum() == 20
    assert not beside_another(facets, outline, 0.003).any()


def test_masks_give_each_facet_its_whole_pixels_and_flag_the_mixed_ones() -> None:
    facets = _ensemble()
    masks = mirror_masks(WIDE_CAMERA, WIDE_POSE, facets, margin_px=0.75)
    covered = (draw_mirror(WIDE_CAMERA, WIDE_POSE, facets, blur_px=1e-6) - 10) / 170
    assert set(np.unique(masks.facet_index)) == set(range(-1, 24))
    np.testing.assert_array_equal(masks.flags == 0, masks.facet_index >= 0)
    assert covered[masks.flags == 0].min() > 1 - 1e-9
    assert covered[masks.flags == SampleFlag.OUTSIDE_MIRROR].max() < 1e-9
    mixed = (covered > 1e-9) & (covered < 1 - 1e-9)
    assert (masks.flags[mixed] == SampleFlag.MIRROR_EDGE).all()
    with pytest.raises(InputError, match="margin_px"):
        mirror_masks(WIDE_CAMERA, WIDE_POSE, facets, margin_px=-1.0)
    behind = RigidTransform(WIDE_POSE.rotation, -WIDE_POSE.translation_m)
    with pytest.raises(InputError, match="not in front of the camera"):
        mirror_masks(WIDE_CAMERA, behind, facets, margin_px=1.0)


# --- known points ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("depth", [0.0, 0.3])
def test_known_points_alone_give_the_pose(depth: float) -> None:
    rng = np.random.default_rng(8)
    points = np.array([[-0.5, -0.5, 0], [0.5, -0.4, 0], [0.45, 0.5, 0], [-0.5, 0.4, depth], [0, 0.1, depth]])
    pixels = CAMERA.project(POSE.apply(points)) + rng.normal(0, 0.05, (5, 2))
    known = KnownPoints(points, pixels, np.full(5, 0.05))
    found = pose_from_points(CAMERA, Knowledge((_distance(POSE),), known))
    assert _chi_square(found, POSE) < 22.5
    assert found.distance_tests[0].probability > 0.01
    wrong = KnownPoints(points, pixels + [[5, 0], [0, 0], [0, 0], [0, 5], [0, 0]], np.full(5, 0.05))
    with pytest.raises(EstimationError, match="known points miss their places"):
        pose_from_points(CAMERA, Knowledge(points=wrong))


def test_too_few_or_collinear_points_are_refused() -> None:
    line = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [0.4, 0, 0]])
    pixels = CAMERA.project(POSE.apply(line))
    with pytest.raises(EstimationError, match="on one line"):
        pose_from_points(CAMERA, Knowledge(points=KnownPoints(line, pixels, np.ones(4))))
    with pytest.raises(EstimationError, match="4 that are not on one line"):
        pose_from_points(CAMERA, Knowledge(points=KnownPoints(line[:3], pixels[:3], np.ones(3))))


def test_known_points_join_the_outline() -> None:
    points = np.array([[0.0, 0.0, 0.4]])
    known = KnownPoints(points, CAMERA.project(POSE.apply(points)), np.array([0.01]))
    image = _draw(POSE, [_rectangle()], noise=4.0)
    alone = pose_from_outline(image, CAMERA, [_rectangle()], IDEAL_SIDES)
    joined = pose_from_outline(image, CAMERA, [_rectangle()], Knowledge(points=known, side_share=0.0))
    # A point 0.4 m before the mirror fixes the tilt.
    assert joined.covariance[0, 0] < 0.5 * alone.covariance[0, 0]
    assert _chi_square(joined, POSE) < 22.5


def test_distance_derivatives_are_those_of_differences() -> None:
    distance = _distance(POSE)
    derivatives = distance.predict(POSE)[1]
    for index in range(6):
        step = np.zeros(6)
        step[index] = 1e-6
        numeric = (distance.predict(POSE.moved(step))[0] - distance.predict(POSE.moved(-step))[0]) / 2e-6
        assert derivatives[index] == pytest.approx(numeric, abs=1e-8)


def test_correlation_of_a_moving_average_is_its_length() -> None:
    noise = np.random.default_rng(9).normal(size=(8, 2000))
    assert correlation_points(noise) == pytest.approx(1.0, abs=0.1)
    average = np.apply_along_axis(np.convolve, 1, noise, np.ones(6) / 6, mode="valid")
    assert correlation_points(average) == pytest.approx(6.0, rel=0.15)


# --- the reference measurement --------------------------------------------------------------------------------------


def test_reference_facet_agrees_with_its_measured_distance(shared_data: Path) -> None:
    h5py = pytest.importorskip("h5py")
    root = shared_data / "opencsp"
    with h5py.File(root / "fringe" / "measurement_facet.h5") as file:
        dark, bright = np.moveaxis(file["MeasurementSofastFringe/mask_images"][()].astype(np.float64), -1, 0)
    with h5py.File(root / "common" / "camera_sofast_downsampled.h5") as file:
        matrix, lens = file["Camera/intrinsic_mat"][()], file["Camera/distortion_coef"][()].ravel()
    with h5py.File(root / "common" / "spatial_orientation.h5") as file:
        screen = file["SpatialOrientation/v_cam_screen_cam"][()].ravel()
    camera = Camera(
        203,
        154,
        matrix[0, 0],
        matrix[1, 1],
        matrix[0, 2],
        matrix[1, 2],
        distortion=BrownDistortion(k1=lens[0], k2=lens[1], p1=lens[2], p2=lens[3], k3=lens[4]),
    )
    distance = DistanceObservation(10.232, 0.010, np.zeros(3), screen)
    found = pose_from_outline(bright - dark, camera, [_rectangle(1.212, 1.212)], Knowledge((distance,)))
    # The publisher's program: 0.34 px and 66 mm apart before, 0.57 px after forcing the distance.
    assert found.residual_rms_px < 0.05
    assert abs(found.distance_tests[0].image_only_m - 10.232) < 0.03
    assert found.distance_tests[0].probability > 0.01


@pytest.mark.parametrize(("blur_px", "margin_px"), [(0.42, 1.21), (0.9, 2.58), (1.43, 4.25)])
def test_pixels_beside_a_blurred_edge_see_the_mirror_where_they_are(blur_px: float, margin_px: float) -> None:
    width_px = float(np.sqrt(2 * np.pi * blur_px**2 + 1.6**2))
    assert edge_blur_px(width_px) == pytest.approx(blur_px, rel=1e-9)
    found = edge_margin_px(width_px, 0.0)
    assert found == pytest.approx(margin_px, abs=0.06)
    # The mean of a normal density over the mirror's side.
    at = np.linspace(-8, 8, 20001) * blur_px
    density = np.exp(-0.5 * (at / blur_px) ** 2) * (at > -found)
    assert float(at @ density / density.sum()) < 0.012
