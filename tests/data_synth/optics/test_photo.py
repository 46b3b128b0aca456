"""Printed sheets in photos: areas against brute force and closed forms, orientation, exact centres."""

import cv2
import numpy as np
import pytest

from data_synth.optics.markers import charuco_print, chessboard_print, marker_cells, marker_print
from data_synth.optics.photo import View, draw_sheets
from data_synth.optics.pinhole import PinholeCamera
from data_synth.optics.prints import DotGridPrint, DotPrint, LatticePrint, Print, RingPrint
from data_synth.optics.sheets import Sheet, SheetShape
from data_synth.targets.isolated_target import IsolatedTarget, draw_isolated
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from photogrammetry.targets import RingCode
from photogrammetry.targets.coded_targets import aicon_dictionary
from photogrammetry.targets.ring_codes import ink_at

#: A camera 1 m in front of the world's origin; its x is the world's, its y points down.
FRONT = RigidTransform(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.0]))
LENS = PinholeCamera(80, 70, 900.0, 905.0, 38.0, 36.0, -0.1, 0.05, 0.0, 1e-4, -2e-4)
CHIRAL = RingCode("75", 0b1001011, 12)


def drawn(
    figure: Print, place: RigidTransform, *, camera: PinholeCamera = LENS, blur: float = 0.0, **more
) -> np.ndarray:
    light = np.zeros((camera.height_px, camera.width_px), dtype=np.float32)
    sheet = Sheet("s", figure, place, ink=1.0, paper=0.0, **more)
    draw_sheets(light, View("v", camera, FRONT), [sheet], blur)
    return light


def brute_force(sheet: Sheet, camera: PinholeCamera, inside, n: int = 16) -> np.ndarray:
    """Many exact rays per pixel, one after the other, through the sheet's plane."""
    offset = (np.arange(n) + 0.5) / n - 0.5
    x = np.arange(camera.width_px)[None, :, None, None] + offset[None, None, None, :]
    y = np.arange(camera.height_px)[:, None, None, None] + offset[None, None, :, None]
    world_from_cam = FRONT.inverse()
    rays = world_from_cam.rotate(camera.rays(*np.broadcast_arrays(x, y)))
    normal, origin = sheet.world_from_sheet.rotation[:, 2], sheet.world_from_sheet.translation_m
    path = ((origin - world_from_cam.translation_m) @ normal) / (rays @ normal)
    points = sheet.world_from_sheet.inverse().apply(world_from_cam.translation_m + path[..., None] * rays)
    return inside(points[..., 0], points[..., 1]).mean(axis=(2, 3))


@pytest.mark.slow
@pytest.mark.parametrize("tilt", [0.0, 1.0])
@pytest.mark.parametrize("diameter_px", [6, 14])
def test_ring_codes_against_brute_force(diameter_px: float, tilt: float) -> None:
    diameter = diameter_px / 900
    place = RigidTransform.from_rotation_vector([tilt, 0.2, 0.4], [0.003, -0.002, 0.0])
    sheet = Sheet("s", RingPrint(CHIRAL, diameter), place)
    wanted = brute_force(sheet, LENS, lambda x, y: ink_at(CHIRAL, 2 * x / diameter, 2 * y / diameter))
    found = drawn(sheet.figure, place)
    edges = (wanted > 0) & (wanted < 1)
    # 16 x 16 rays themselves are wrong by 0.005 in a pixel that an edge crosses.
    assert np.abs(found - wanted)[edges].mean() < 0.006
    assert np.abs(found - wanted).max() < 0.04
    assert found.sum() == pytest.approx(wanted.sum(), rel=1e-3)


def test_a_disc_has_its_area_and_its_place() -> None:
    """Closed form: fronto-parallel and without distortion the image is a circle."""
    camera = PinholeCamera(60, 60, 1000.0, 1000.0, 29.3, 30.1)
    light = drawn(
        DotPrint(0.012), RigidTransform(np.eye(3), np.array([0.00123, 0.00077, 0.0])), camera=camera, blur=0.7
    )
    y, x = np.mgrid[0:60, 0:60]
    assert light.sum() == pytest.approx(np.pi * 36, rel=1e-4)
    assert (light * x).sum() / light.sum() == pytest.approx(29.3 + 1.23, abs=2e-4)
    assert (light * y).sum() / light.sum() == pytest.approx(30.1 - 0.77, abs=2e-4)
    # The blur adds its variance to the circle's r^2 / 4 and the pixel's 1/12.
    variance = (light * (x - 30.53) ** 2).sum() / light.sum()
    assert variance == pytest.approx(36 / 4 + 1 / 12 + 0.49, rel=2e-3)


def test_a_projected_centre_is_not_the_centre_of_the_ellipse() -> None:
    """The truth is the projection of the centre; a tilted circle's image lies towards its near side... by theory."""
    target = IsolatedTarget(50.0, tilt_rad=0.8, signal_to_noise=1e9)
    drawn_one = draw_isolated(target, np.random.default_rng(0))
    ink = (218.0 - drawn_one.image_dn) / 180
    y, x = np.mgrid[0 : ink.shape[0], 0 : ink.shape[1]]
    gravity = np.array([(ink * x).sum(), (ink * y).sum()]) / ink.sum()
    radius, focal, depth = 25 / 3000 * 5, 3000.0, 5.0
    # Area-weighted mean of the projection to second order: the nearer half is larger.
    expected = focal * radius**2 * np.sin(0.8) * np.cos(0.8) / depth**2
    assert np.abs(gravity - drawn_one.center_px).max() == pytest.approx(0.75 * expected, rel=0.4)
    assert np.abs(gravity - drawn_one.center_px).max() > 0.03


@pytest.mark.parametrize("mirrored", [False, True])
def test_reading_sense_in_the_image(mirrored: bool) -> None:
    """The sectors of the image, clockwise, are the dictionary's word; those of a mirrored print are not."""
    camera = PinholeCamera(201, 201, 1000.0, 1000.0, 100.0, 100.0)
    light = drawn(RingPrint(CHIRAL, 0.05, mirrored), RigidTransform.identity(), camera=camera)
    angle = (np.arange(12) + 0.5) * np.pi / 6
    # y runs down in the image: growing angles are clockwise.
    x, y = np.rint(100 + 62.5 * np.cos(angle)).astype(int), np.rint(100 + 62.5 * np.sin(angle)).astype(int)
    reading = aicon_dictionary(12).read((light[y, x] > 0.5).tolist())
    assert reading.code is not None
    assert reading.mirrored is not None
    assert (reading.mirrored if mirrored else reading.code).word == CHIRAL.word
    assert (reading.code if mirrored else reading.mirrored).word != CHIRAL.word


def test_opencv_reads_the_markers_and_their_corners_in_order() -> None:
    camera = PinholeCamera(200, 200, 1000.0, 1000.0, 99.5, 99.5)
    figure = marker_print("DICT_4X4_100", 23, 0.08)
    light = 0.9 - 0.8 * drawn(figure, RigidTransform.from_rotation_vector([0, 0, 0.4], [0, 0, 0]), camera=camera)
    image = np.pad((light * 255).astype(np.uint8), 20, constant_values=220)
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_100))
    corners, numbers, _ = detector.detectMarkers(image)
    assert np.ravel(numbers).tolist() == [23]
    turn = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    true = np.array(list(figure.points_m.values())) @ turn.T * (1000, -1000) + 99.5 + 20
    assert np.abs(np.reshape(corners[0], (4, 2)) - true).max() < 1.5


def test_charuco_is_opencvs_layout() -> None:
    table = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    # 40 px a square, 28 px a marker: 4 px a cell, and a pixel of the drawing never lies on an edge.
    wanted = cv2.aruco.CharucoBoard((5, 4), 0.040, 0.028, table).generateImage((200, 160)) < 128
    camera = PinholeCamera(200, 160, 1000.0, 1000.0, 99.5, 79.5)
    found = drawn(charuco_print(5, 4, 0.040, 0.028, "DICT_5X5_100"), RigidTransform.identity(), camera=camera) > 0.5
    assert (found == wanted).all()


def test_chessboard_corners_are_where_four_squares_meet() -> None:
    camera = PinholeCamera(200, 160, 1000.0, 1000.0, 99.5, 79.5)
    board = chessboard_print(5, 4, 0.03)
    light = drawn(board, RigidTransform.identity(), camera=camera)
    assert len(board.points_m) == 12
    for x, y in board.points_m.values():
        column, row = 99.5 + 1000 * x, 79.5 - 1000 * y
        around = light[int(row) - 2 : int(row) + 4, int(column) - 2 : int(column) + 4]
        assert around.mean() == pytest.approx(0.5, abs=1e-3)
        assert around[0, 0] == around[-1, -1] != around[0, -1]


def test_asymmetric_circles_are_found_in_opencvs_order() -> None:
    camera = PinholeCamera(260, 320, 1000.0, 1000.0, 129.5, 159.5)
    grid = DotGridPrint(4, 11, 0.04, 0.013, asymmetric=True)
    light = 0.9 - 0.8 * drawn(grid, RigidTransform.identity(), camera=camera)
    found, centers = cv2.findCirclesGrid((light * 255).astype(np.uint8), (4, 11), flags=cv2.CALIB_CB_ASYMMETRIC_GRID)
    assert found
    true = grid.centers_m * (1000, -1000) + (129.5, 159.5)
    assert np.abs(np.reshape(centers, (-1, 2)) - true).max() < 0.1


def test_bent_and_sheared_sheet_is_met_where_it_is() -> None:
    shape = SheetShape([[1.0, 0.02], [0.0, 1.01]], [0.3, 0.1, -0.2], [1.0, -0.5])
    sheet = Sheet(
        "b", DotPrint(0.1), RigidTransform.from_rotation_vector([0.5, -0.3, 0.2], [0.01, 0.02, 0.0]), shape=shape
    )
    print_m = np.random.default_rng(0).uniform(-0.1, 0.1, (50, 2))
    cam = (FRONT @ sheet.world_from_sheet).apply(shape.points_m(print_m))
    sheet_from_cam = (FRONT @ sheet.world_from_sheet).inverse()
    x, y = sheet.hit(sheet_from_cam, cam[:, 0] / cam[:, 2], cam[:, 1] / cam[:, 2])
    np.testing.assert_allclose(np.stack([x, y], axis=1), print_m, atol=1e-9)


def test_interpolated_meeting_points_draw_what_exact_ones_draw(monkeypatch: pytest.MonkeyPatch) -> None:
    shape = SheetShape([[1.0, 0.02], [0.0, 1.01]], [0.8, 0.3, -0.5], [2.0, -1.5])
    place = RigidTransform.from_rotation_vector([0.6, -0.4, 0.2], [0.005, 0.004, 0.0])
    board = chessboard_print(6, 5, 0.006)
    near = drawn(board, place, shape=shape)
    with monkeypatch.context() as patched:
        patched.setattr(Sheet, "is_near", lambda *_: False)
        exact = drawn(board, place, shape=shape)
    assert near.max() > 0.99
    assert np.abs(near - exact).max() < 1e-5


def test_the_back_of_a_sheet_shows_nothing() -> None:
    assert not drawn(DotPrint(0.02), RigidTransform.from_rotation_vector([np.pi, 0, 0], [0, 0, 0])).any()


def test_a_sticker_leaves_its_ground() -> None:
    light = np.full((70, 80), 0.4, dtype=np.float32)
    sheet = Sheet("s", DotPrint(0.01), RigidTransform.identity(), ink=1.0, paper=0.0, transparent=True)
    draw_sheets(light, View("v", LENS, FRONT), [sheet], 0.5)
    assert light.min() > 0.399
    assert light.max() == pytest.approx(1.0, abs=1e-3)


def test_nearer_sheets_hide_farther_ones() -> None:
    light = np.zeros((70, 80), dtype=np.float32)
    near = Sheet("near", DotPrint(0.02), RigidTransform(np.eye(3), np.array([0, 0, 0.1])), ink=0.2, paper=0.3)
    far = Sheet("far", DotPrint(0.02), RigidTransform.identity(), ink=0.8, paper=0.9)
    draw_sheets(light, View("v", LENS, FRONT), [near, far])
    assert light[36, 38] == pytest.approx(0.2, abs=1e-3)


def test_isolated_target_has_the_noise_and_slope_it_says() -> None:
    target = IsolatedTarget(12.0, signal_to_noise=90.0, slope_dn_per_px=(1.0, -0.5), contrast_dn=-180.0)
    one = draw_isolated(target, np.random.default_rng(1))
    assert one.noise_dn == 2.0
    border = np.ones(one.image_dn.shape, dtype=bool)
    border[4:-4, 4:-4] = False
    y, x = np.nonzero(border)
    design = np.stack([np.ones(x.size), x, y], axis=1)
    plane, residual, *_ = np.linalg.lstsq(design, one.image_dn[border].astype(float), rcond=None)
    assert plane[1:] == pytest.approx([1.0, -0.5], abs=0.03)
    assert np.sqrt(residual[0] / x.size) == pytest.approx(2.0, rel=0.15)
    assert one.image_dn[round(one.center_px[1]), round(one.center_px[0])] > 190


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: marker_cells("DICT_9X9", 0), "OpenCV's name"),
        (lambda: marker_cells("DICT_4X4_50", 50), "goes from 0 to 49"),
        (lambda: chessboard_print(2, 5, 0.03), "3 x 3 squares"),
        (lambda: charuco_print(5, 4, 0.03, 0.03, "DICT_4X4_50"), "do not fit"),
        (lambda: LatticePrint([0, 1, 2], [1, 0], [[1]], 0.1), "do not fit the edges"),
        (lambda: LatticePrint([0, 1], [0, 1], [[1]], 0.1), "y edges decrease"),
        (lambda: SheetShape([[-1, 0], [0, 1]]), "near 1"),
    ],
)
def test_impossible_prints(make, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()
