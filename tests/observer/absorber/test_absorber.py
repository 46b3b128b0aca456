"""The absorber's axis: the bisector, derivatives, scatter against sigma, what hides or imitates the tube."""

from dataclasses import replace

import numpy as np
import pytest

from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from observer.absorber.other_diameter import other_diameter_m
from observer.absorber.position import AbsorberSolution, StationFate, bearing_derivatives, sag_of_tube_m, solve_absorber
from observer.photo_edges.edges import Edges
from observer.photo_edges.tube_bearings import Bearings, bearing, paired_edges, tube_bearings
from observer.photo_edges.views import Shot, View
from observer.slopes.pose_modes import Photos
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector, ls2
from observer.trough.expectation import Expectation
from observer.trough.glass import count_receivers
from tests.observer.drawn_tube import Axis, drawn_tube, looking

LS2 = ls2()
RADIUS_M = LS2.absorber_diameter_m / 2
CAMERA = Camera(320, 240, 900.0, 900.0, 161.3, 118.2)
SHORT = Collector(5.0, 1.6, 1.49, 0.070)
ROWS_M = (np.arange(80) + 0.5) * 0.02 - 0.8
STATIONS_M = np.linspace(-0.8, 0.8, 9)
POSE_SIGMA = np.array([1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1e-3])


def line(x_m: float, z_m: float, slope_x: float = 0.0, sag_m: float = 0.0) -> Axis:
    """Return an axis beside the focal line that slopes to the side and sags in the middle."""

    def axis(y_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return x_m + slope_x * y_m, 1.49 + z_m - sag_m * (1 - (y_m / 0.8) ** 2)

    return axis


def photos_at(places_m: list[float], height_m: float = 6.0, sigma: float = 1e-3) -> Photos:
    poses = tuple(looking(np.array([x, 0.1, height_m]), np.array([0.0, 0.0, 1.49])) for x in places_m)
    return Photos(poses, np.diag(np.tile((sigma * POSE_SIGMA / 1e-3) ** 2, len(poses))))


def measured(photos: Photos, axis: Axis, collector: Collector = SHORT, **drawn: object) -> Bearings:
    start = AbsorberPath.straight(0.0, 1.49, 0.8)
    parts = []
    for number, pose in enumerate(photos.poses):
        image = drawn_tube(View(CAMERA, pose), axis, RADIUS_M, **drawn)
        parts += tube_bearings([Shot(image, number, View(CAMERA, pose))], Expectation(collector, start, ROWS_M))
    return together(parts)


def together(parts: list[Bearings]) -> Bearings:
    return Bearings(*(np.concatenate([getattr(part, name) for part in parts]) for name in Bearings.__slots__))


def simulated(photos: Photos, axis: Axis, rng: np.random.Generator, noise_rad: float = 2e-5) -> Bearings:
    """Return bearings of poses that are a little wrong, each row with its own noise."""
    parts = []
    for number, pose in enumerate(photos.poses):
        step = rng.multivariate_normal(np.zeros(6), photos.covariance[6 * number :][:6, 6 * number : 6 * number + 6])
        true = pose.moved(step)
        x, z = axis(ROWS_M)
        points = np.stack([x, ROWS_M, z], axis=1)
        rays = true.apply(points) @ pose.rotation
        angle = np.arctan2(rays[:, 0], -rays[:, 2]) + noise_rad * rng.standard_normal(ROWS_M.size)
        full = np.ones(ROWS_M.size)
        parts.append(Bearings(np.full(ROWS_M.size, number), ROWS_M, angle, noise_rad * full, 0.07 * full))
    return together(parts)


def solved(bearings: Bearings, photos: Photos) -> AbsorberSolution:
    return solve_absorber(bearings, photos, AbsorberPath.straight(0.0, 1.49, 0.8), STATIONS_M, SHORT)


def test_the_bisector_goes_through_the_axis_and_the_middle_on_the_plane_does_not() -> None:
    # Camera 7 m beside and 7 m above: w = asin(r / 9.9 m); the middle on the plane is off by w^2 h tan / cos^2.
    half = np.arcsin(RADIUS_M / np.hypot(7, 7))
    edges = 7.0 * np.tan(np.pi / 4 + np.array([-half, half]))
    np.testing.assert_allclose(edges.mean() - 7.0, 0.175e-3, atol=1e-6)
    # Each edge's line of sight passes the axis at the tube's radius.
    eye = np.array([[-7.0, 0.0, 7.0]])
    np.testing.assert_allclose(np.arctan2(edges, 7.0).mean(), bearing(np.zeros(1), np.zeros(1), eye)[0], atol=1e-15)
    # The pairing knows the width exactly: the two edges of 10 % of that width more or less are found, others not.
    for factor, pairs in ((1.0, 1), (1.1, 1), (0.9, 1), (1.15, 0), (0.85, 0)):
        seen = np.pi / 4 + factor * np.array([-half, half])
        found = Edges(np.zeros(2, dtype=np.intp), np.tan(seen), np.ones(2), np.array([-9.0, 9.0]), np.ones(2))
        assert paired_edges(found, seen, 7.0, RADIUS_M)[0].size == pairs


def test_derivatives_of_bearings() -> None:
    photos = photos_at([-4.0, 1.0, 5.0])
    photo = np.array([0, 1, 2, 2])
    points = np.array([[0.01, -0.5, 1.48], [0.0, 0.2, 1.49], [-0.01, 0.6, 1.5], [0.02, -0.7, 1.47]])
    place, pose = bearing_derivatives(points, photos, photo)
    eyes = photos.eyes_m[photo]
    for column, axis in ((0, 0), (1, 2)):
        step = 1e-5 * np.eye(3)[axis]
        ends = [bearing((points + way * step)[:, 0], (points + way * step)[:, 2], eyes) for way in (1, -1)]
        np.testing.assert_allclose(place[:, column], (ends[0] - ends[1]) / 2e-5, rtol=1e-8, atol=1e-10)

    def beside(k: int, moved: RigidTransform) -> float:
        """Return by what angle the line of sight of the pixel that showed the point misses it."""
        ray = photos.poses[photo[k]].apply(points[k]) @ moved.rotation
        seen = np.arctan2(ray[0], -ray[2])
        eye = moved.inverse().translation_m
        return float(seen - bearing(points[k : k + 1, 0], points[k : k + 1, 2], eye[None])[0])

    for k in range(4):
        for column in range(6):
            step = 1e-6 * np.eye(6)[column]
            ends = [beside(k, photos.poses[photo[k]].moved(way * step)) for way in (1, -1)]
            np.testing.assert_allclose(pose[k, column], -(ends[0] - ends[1]) / 2e-6, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("tones", [(20.0, 180.0), (200.0, 60.0)])
def test_a_drawn_tube_is_found_where_it_is(tones: tuple[float, float]) -> None:
    # 5 mm a pixel: 0.02 px are 0.1 mm; the tube is dark before sky, or bright before dark ground.
    photos = photos_at([-5.0, 5.0], sigma=1e-9)
    axis = line(3e-3, -5e-3, 1e-3, 4e-3)
    bearings = measured(photos, axis, tones=tones)
    assert np.bincount(bearings.photo).min() > 70
    solution = solved(bearings, photos)
    x, z = axis(STATIONS_M)
    assert (solution.fate == StationFate.MEASURED).all()
    np.testing.assert_allclose(solution.path.x_m, x, atol=1e-4)
    # A sag of 4 mm within 2 m is more than the prior likes: it straightens the ends by 0.3 mm, within the sigma of two
    # photos (0.3 mm in the middle, 0.4 mm at the ends): what is behind may change beside the tube.
    np.testing.assert_allclose(solution.path.z_m, z, atol=3e-4)
    sigma_z_m = np.sqrt(np.diag(solution.path.covariance_m2))[len(z) :]
    assert (np.abs(solution.path.z_m - z) < sigma_z_m).all()
    np.testing.assert_allclose(solution.diameter_m, 0.070, atol=4e-4)


@pytest.mark.slow
def test_scatter_is_the_sigma_stated() -> None:
    photos = photos_at([-5.0, -2.0, 0.0, 2.0, 5.0])
    axis = line(3e-3, -5e-3, 1e-3, 4e-3)
    x, z = axis(STATIONS_M)
    rng = np.random.default_rng(8)
    squares, normalised = [], []
    for _ in range(80):
        path = solved(simulated(photos, axis, rng), photos).path
        error = np.concatenate([path.x_m - x, path.z_m - z])
        squares.append(error**2 / np.diagonal(path.covariance_m2))
        # Offset and tilt of the whole tube, which hang on the poses alone.
        both = np.kron(np.eye(2), np.linalg.pinv(np.stack([np.ones(9), STATIONS_M], axis=1)))
        rest = both @ error
        normalised.append(rest @ np.linalg.solve(both @ path.covariance_m2 @ both.T, rest))
    # 320 squares of four numbers: chi-square of 320 within 99.9 %, and less by what the factor >= 1 adds.
    assert 0.70 < np.mean(squares) < 1.15
    assert 0.65 * 4 < np.mean(normalised) < 1.27 * 4


@pytest.mark.slow
def test_what_photos_of_one_side_have_in_common_is_in_the_sigma_of_the_height() -> None:
    photos = photos_at([*np.linspace(-3, -1.5, 20), *np.linspace(1.5, 3, 20)], height_m=14.0, sigma=1e-5)
    axis, shared = line(0.0, 0.0), 1e-5
    rng = np.random.default_rng(5)
    normalised = []
    for _ in range(30):
        bearings = simulated(photos, axis, rng)
        left, right = 0.5 * shared * rng.standard_normal(2)
        wrong = np.where(photos.eyes_m[bearings.photo, 0] < 0, left, right)
        bearings = replace(bearings, angle_rad=bearings.angle_rad + wrong, shared_rad=np.full(wrong.size, shared))
        path = solved(bearings, photos).path
        mean = np.concatenate([np.zeros(9), np.full(9, 1 / 9)])
        normalised.append((mean[9:] @ path.z_m - 1.49) / np.sqrt(mean @ path.covariance_m2 @ mean))
    # As independent errors of 40 photos they would scatter by 2.8 times the sigma stated.
    assert 0.5 < np.std(normalised) < 1.5


def test_a_photo_in_which_the_tube_looks_wider_counts_less() -> None:
    photos = photos_at([-3.0, -2.5, 2.5, 3.0], height_m=14.0, sigma=1e-5)
    rng = np.random.default_rng(6)
    bearings = simulated(photos, line(0.0, 0.0), rng)
    last = bearings.photo == 3
    pulled = replace(bearings, angle_rad=bearings.angle_rad + np.where(last, 5e-5, 0.0))
    seen = replace(pulled, diameter_m=pulled.diameter_m + np.where(last, 1.2e-3, 0.0))
    errors = [abs(float(np.mean(solved(one, photos).path.z_m)) - 1.49) for one in (pulled, seen)]
    assert errors[1] < 0.5 * errors[0]


def test_a_tube_that_looks_too_thin_in_all_photos_is_uncertain_in_height() -> None:
    photos = photos_at([-3.0, -2.5, 2.5, 3.0], height_m=14.0, sigma=1e-5)
    bearings = simulated(photos, line(0.0, 0.0), np.random.default_rng(6))
    thin = replace(bearings, diameter_m=np.full(bearings.photo.size, 0.070 - 1.2e-3))
    sigmas = [float(solved(one, photos).path.sigma_at([0.0])[1][0]) for one in (bearings, thin)]
    # A quarter of 1.2 mm towards one side, from 2.75 m beside the tube 12.5 m above it: 0.3 mm x 12.8 / 2.75.
    assert sigmas[0] < 0.3e-3
    assert sigmas[1] == pytest.approx(1.4e-3, rel=0.1)


def test_one_photo_or_one_side_is_refused_and_a_narrow_base_says_so() -> None:
    rng = np.random.default_rng(1)
    axis = line(0.0, 0.0)
    one = photos_at([5.0])
    with pytest.raises(EstimationError, match=r"1 photos show both edges.*two from different sides.*as bright as"):
        solved(simulated(one, axis, rng), one)
    same = photos_at([5.0, 5.02])
    with pytest.raises(EstimationError, match=r"from one side, within 0.. degrees.*add photos"):
        solved(simulated(same, axis, rng), same)
    narrow, wide = photos_at([0.0, 0.8]), photos_at([-4.5, 4.5])
    sigmas = [solved(simulated(photos, axis, rng), photos).path.sigma_at([0.0])[1][0] for photos in (narrow, wide)]
    assert sigmas[0] > 5 * sigmas[1]


def test_known_supports_and_what_the_photo_cuts_off_are_hidden_stations() -> None:
    collector = replace(SHORT, support_y_m=np.array([0.0]), support_width_m=0.06)
    photos = photos_at([-5.0, 5.0], sigma=1e-7)
    bearings = measured(photos, line(0.0, 0.0), collector)
    assert np.abs(bearings.y_m).min() > 0.28
    # The right end beyond the photos' border.
    cut = bearings.chosen(bearings.y_m < 0.45)
    solution = solved(cut, photos)
    assert (solution.fate[[4, 7, 8]] == StationFate.HIDDEN).all()
    assert (solution.fate[[0, 1, 2, 6]] == StationFate.MEASURED).all()
    sigma = np.hypot(*solution.path.sigma_at(STATIONS_M))
    assert sigma[8] > 3 * sigma[2]


def test_a_tube_clamped_at_its_supports_is_bridged_there() -> None:
    # A beam of even weight in clamps, by 7 mm lower in the middle of each span: between supports it bends most where
    # these hide it. As a path that bends alike everywhere it came out 2 mm too low there.
    supports = np.array([-3.5, 0.0, 3.5])
    collector = Collector(5.76, 7.0, 1.71, 0.070, support_y_m=supports)
    photos = photos_at([*np.linspace(-3.5, -1.5, 19), *np.linspace(1.5, 3.5, 19)], height_m=15.0, sigma=1e-6)
    stations = np.linspace(-3.5, 3.5, 29)

    def height(y_m: np.ndarray) -> np.ndarray:
        share = (y_m / 3.5) % 1.0
        return 1.71 - 7e-3 * 16 * (share * (1 - share)) ** 2

    rows = np.arange(-2.99, 3.0, 0.02)
    rows = rows[np.abs(rows) > 0.4]
    photo, y = np.repeat(np.arange(38), rows.size), np.tile(rows, 38)
    angle = bearing(np.zeros(y.size), height(y), photos.eyes_m[photo])
    bearings = Bearings(photo, y, angle, np.full(y.size, 1.4e-4), np.full(y.size, 0.07), np.full(y.size, 1e-5))
    path = solve_absorber(bearings, photos, AbsorberPath.straight(0.0, 1.71, 3.5), stations, collector).path
    np.testing.assert_allclose(path.z_m, height(stations), atol=0.5e-3)
    sigma_m = path.sigma_at(stations)[1]
    assert (np.abs(path.z_m - height(stations)) < sigma_m).all()
    assert sigma_m[np.abs(stations) < 3].max() < 1e-3


def sigma_of_a_long_tube_m(supports_m: list[float], width_m: float) -> float:
    """Return the largest sigma of the height within half a metre of the middle, where 0.7 m are hidden."""
    collector = Collector(5.76, 7.0, 1.71, 0.070, support_y_m=np.array(supports_m), support_width_m=width_m)
    photos = photos_at([*np.linspace(-3.5, -1.5, 5), *np.linspace(1.5, 3.5, 5)], height_m=15.0, sigma=1e-6)
    rows = np.arange(-3.3, 3.3, 0.05)
    rows = rows[np.abs(rows) > 0.35]
    photo, y = np.repeat(np.arange(10), rows.size), np.tile(rows, 10)
    angle = bearing(np.zeros(y.size), np.full(y.size, 1.71), photos.eyes_m[photo])
    bearings = Bearings(photo, y, angle, np.full(y.size, 1e-4), np.full(y.size, 0.07), np.full(y.size, 1e-5))
    stations = np.linspace(-3.5, 3.5, 29)
    found = solve_absorber(bearings, photos, AbsorberPath.straight(0.0, 1.71, 3.5), stations, collector)
    return float(found.path.sigma_at(np.linspace(-0.5, 0.5, 11))[1].max())


def test_between_supports_beside_each_other_the_tube_has_no_kink() -> None:
    """A tube that may hang by 10 mm between any two has 10 mm there, at 0.7 with one support."""
    one = sigma_of_a_long_tube_m([-3.5, 0.0, 3.5], 0.3)
    double = Collector(5.76, 7.0, 1.71, 0.070, support_y_m=np.array([3.5, -0.02, 0.02, -3.5]))
    np.testing.assert_allclose(double.held_y_m, [-3.5, 0.0, 3.5], atol=1e-12)
    assert count_receivers(double) == 2
    # Both of one bellows, told twice to a nanometre, and each with a bellows of its own.
    for apart, width in ((0.04, 0.3), (1e-9, 0.3), (0.04, 0.02)):
        two = sigma_of_a_long_tube_m([-3.5, -apart / 2, apart / 2, 3.5], width)
        assert two == pytest.approx(one, rel=0.1), (apart, width)


def test_a_tube_hangs_by_its_weight_with_the_fourth_power_of_the_span() -> None:
    # 70 x 2 mm of steel, 3.4 kg/m, with 2.4 of glass and 3.6 of oil on 4.06 m: 5 w L^4 / (384 E I) of 9.3 kg/m and
    # E I = 48.2 kN m^2 is 6.7 mm.
    assert sag_of_tube_m(LS2, 4.06) == pytest.approx(2 * 6.7e-3, rel=0.02)
    assert sag_of_tube_m(LS2, 2.03) == pytest.approx(sag_of_tube_m(LS2, 4.06) / 16)
    assert sag_of_tube_m(SHORT, 4.06) == pytest.approx(2 * 5.0e-3, rel=0.02)


def test_a_stripe_as_wide_as_the_tube_is_not_taken_for_it() -> None:
    pose = looking(np.array([5.0, 0.0, 6.0]), np.array([0.0, 0.0, 1.49]))
    view, start = View(CAMERA, pose), AbsorberPath.straight(0.0, 1.49, 0.8)
    image = drawn_tube(view, line(0.0, 0.0), RADIUS_M)
    # Beside the tube, as wide and darker, along 12 of 80 rows; and the tube itself is gone there in two of them.
    decoy = drawn_tube(view, line(0.058, 0.0), RADIUS_M, tones=(0.0, 180.0))
    ends = CAMERA.project(pose.apply(np.array([[0.0, -0.2, 1.49], [0.0, 0.04, 1.49], [0.0, 0.0, 1.49]])))[:, 1]
    first, last = sorted(np.round(ends[:2]).astype(int))
    image[first:last] = np.minimum(image[first:last], decoy[first:last])
    middle = round(float(ends[2]))
    image[middle - 2 : middle + 2] = decoy[middle - 2 : middle + 2]
    [bearings] = tube_bearings([Shot(image, 0, view)], Expectation(SHORT, start, ROWS_M))
    true = bearing(np.zeros(1), np.full(1, 1.49), pose.inverse().translation_m[None])[0]
    # 7.5 m away, the stripe 40 mm beside: rows that show a little of both are off by 2 mm, and fewer rows are missing
    # than were disturbed.
    assert 7.5 * np.abs(bearings.angle_rad - true).max() < 2.5e-3
    assert bearings.y_m.size >= 66


def test_a_few_rows_that_look_like_a_tube_are_no_tube() -> None:
    photos = photos_at([-5.0, 5.0])
    bearings = simulated(photos, line(0.0, 0.0), np.random.default_rng(5))
    with pytest.raises(EstimationError, match=r"only 1 of 9 places.*absorber_diameter_mm"):
        solved(bearings.chosen(np.abs(bearings.y_m) < 0.05), photos)


def test_a_photo_whose_pose_is_wrong_does_not_spoil_the_tube() -> None:
    photos = photos_at([-5.0, -3.0, -1.0, 1.0, 3.0, 5.0])
    bearings = simulated(photos, line(0.0, 0.0), np.random.default_rng(4))
    wrong = replace(bearings, angle_rad=bearings.angle_rad + np.where(bearings.photo == 2, 8e-3, 0.0))
    solution = solved(wrong, photos)
    assert solution.n_photos.max() == 5
    assert np.abs(solution.path.x_m).max() < 3 * solution.path.sigma_at(STATIONS_M)[0].max()


def test_photos_whose_camera_is_no_higher_than_the_tube_give_nothing() -> None:
    pose = looking(np.array([6.0, 0.0, 1.5]), np.array([0.0, 0.0, 1.49]))
    image = np.zeros((CAMERA.height_px, CAMERA.width_px), dtype=np.uint8)
    expected = Expectation(SHORT, AbsorberPath.straight(0.0, 1.49, 0.8), ROWS_M)
    assert tube_bearings([Shot(image, 0, View(CAMERA, pose))], expected)[0].y_m.size == 0


@pytest.mark.parametrize("stated_m", [0.050, 0.070, 0.090])
def test_a_tube_that_is_not_found_is_found_with_another_diameter(stated_m: float) -> None:
    shots = []
    for number, pose in enumerate(photos_at([-2.5, 2.0]).poses):
        view = View(CAMERA, pose)
        shots.append(Shot(drawn_tube(view, line(0.01, 0.0), RADIUS_M), number, view))
    expected = Expectation(replace(SHORT, absorber_diameter_m=stated_m), AbsorberPath.straight(0.0, 1.49, 0.8), ROWS_M)
    found = other_diameter_m(shots, expected)
    assert found == (None if stated_m == 0.070 else pytest.approx(0.070, abs=0.003))
