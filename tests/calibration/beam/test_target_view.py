"""From the camera's picture to the target's plane: exact mapping, lens, wrong corners, marks, the real frame."""

from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.beam.light.beam_image import measure_beam
from calibration.beam.target.marks import (
    CORNERS,
    MarkTemplate,
    dark_corners,
    mark_corner,
    template_corners,
)
from calibration.beam.target.view import Rectifier, TargetImage, view_from_points, whole_image
from heliogauge.camera.distortion import BrownDistortion
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform
from tests.calibration.beam_pictures import CORNERS_M

LENS = Camera(800, 600, 900.0, 900.0, 399.5, 299.5, distortion=BrownDistortion(k1=-0.15, k2=0.05, p1=0.001, p2=-0.002))
PINHOLE = Camera(800, 600, 900.0, 900.0, 399.5, 299.5)
# The camera stands below and to the left of the target's axis, 16 m in front; its y points down.
POSE = RigidTransform.from_rotation_vector([0.25, -0.2, 0.03], [-1.0, 0.5, 16.0])


def seen(points_m: np.ndarray, camera: Camera) -> np.ndarray:
    """Pixels of points of the plane (x right, y up)."""
    points = np.asarray(points_m)
    return camera.project(POSE.apply(np.stack([points[..., 0], -points[..., 1], 0 * points[..., 0]], axis=-1)))


@cache
def photo(camera: Camera, center_m: tuple[float, float]) -> np.ndarray:
    """Draw what the camera sees: the target, a round beam, dark angles at the corners; 2 x 2 samples per pixel."""
    finer = 2
    rows, columns = np.mgrid[: 600 * finer, : 800 * finer]
    pixels = np.stack([(columns + 0.5) / finer - 0.5, (rows + 0.5) / finer - 0.5], axis=-1)
    rays = camera.cast_rays(pixels)
    # Intersection of the lines of sight with the plane z = 0 of the target.
    frame_from_cam = POSE.inverse()
    directions, origin = frame_from_cam.rotate(rays), frame_from_cam.translation_m
    hit = origin[:2] - directions[..., :2] / directions[..., 2:] * origin[2]
    x, y = hit[..., 0], -hit[..., 1]
    values = np.where((np.abs(x) < 4.4) & (np.abs(y) < 3.9), 110.0, 40.0)
    values += 100 * np.exp(-((x - center_m[0]) ** 2 + (y - center_m[1]) ** 2) / (2 * 0.5**2))
    for corner_x, corner_y in CORNERS_M:
        inwards_x, inwards_y = (corner_x - x) * np.sign(corner_x), (corner_y - y) * np.sign(corner_y)
        long_x = (inwards_x > 0) & (inwards_x < 0.9) & (inwards_y > 0) & (inwards_y < 0.25)
        long_y = (inwards_y > 0) & (inwards_y < 0.9) & (inwards_x > 0) & (inwards_x < 0.25)
        values[long_x | long_y] = 15.0
    small = cv2.resize(values, (800, 600), interpolation=cv2.INTER_AREA)
    noise = np.random.default_rng(1).normal(0, 1.0, small.shape)
    return np.clip(np.rint(small + noise), 0, 255).astype(np.uint8)


@given(st.floats(-4, 4), st.floats(-3.5, 3.5))
def test_mapping_there_and_back(x: float, y: float) -> None:
    view = view_from_points(seen(CORNERS_M, LENS), CORNERS_M, camera=LENS)
    assert view.pixels_px([x, y]) == pytest.approx(seen(np.array([x, y]), LENS), abs=1e-6)
    image = whole_image(np.zeros((300, 400)), CORNERS_M)
    assert image.points_m(image.pixels_px([x, y])) == pytest.approx([x, y], abs=1e-9)


@pytest.mark.parametrize("camera", [PINHOLE, LENS], ids=["pinhole", "lens"])
def test_beam_through_perspective_and_lens(camera: Camera) -> None:
    view = view_from_points(seen(CORNERS_M, camera), CORNERS_M, camera=camera)
    image = Rectifier(view, [-4, 4, -3.5, 3.5]).rectify(photo(camera, (0.6, -0.4)))
    beam = measure_beam(image)
    assert beam.flags == 0
    assert beam.spot.position_m == pytest.approx([0.6, -0.4], abs=0.003)
    assert beam.moments.widths_m == pytest.approx([0.5, 0.5], rel=0.06)


def test_forgetting_the_lens_costs() -> None:
    """Control: with the lens left out, the place is off by many times what it is with it."""
    view = view_from_points(seen(CORNERS_M, LENS), CORNERS_M)
    beam = measure_beam(Rectifier(view, [-4, 4, -3.5, 3.5]).rectify(photo(LENS, (0.6, -0.4))))
    assert np.abs(beam.spot.position_m - [0.6, -0.4]).max() > 0.01


def test_more_points_give_a_residual_and_a_sigma() -> None:
    rng = np.random.default_rng(2)
    points = np.stack(np.meshgrid([-4, -1, 1, 4], [-3.5, 0, 3.5]), axis=-1).reshape(-1, 2).astype(float)
    errors, predicted = [], []
    for _ in range(200):
        pixels = seen(points, PINHOLE) + rng.normal(0, 0.3, points.shape)
        view = view_from_points(pixels, points)
        errors.append(seen(np.array([1.0, 1.0]), PINHOLE) - view.pixels_px([1.0, 1.0]))
        jacobian = view.pixels_px([[1.001, 1], [1, 1.001]]) - view.pixels_px([1, 1])
        predicted.append(np.diag(1e6 * jacobian.T @ view.covariance_m2([1.0, 1.0]) @ jacobian))
    ratio = np.std(errors, axis=0) / np.sqrt(np.mean(predicted, axis=0))
    assert ratio == pytest.approx([1, 1], abs=0.15)
    assert view.sigma_px == pytest.approx(0.3, rel=0.5)


def test_wrong_corners() -> None:
    pixels = seen(CORNERS_M, PINHOLE)
    with pytest.raises(InputError, match="mirrored"):
        view_from_points(pixels[[1, 0, 3, 2]], CORNERS_M)
    with pytest.raises(InputError, match="cross over"):
        view_from_points(pixels[[0, 2, 1, 3]], CORNERS_M)
    with pytest.raises(InputError, match="one line"):
        view_from_points([[0, 0], [1, 1], [2, 2], [3, 3]], CORNERS_M)
    with pytest.raises(InputError, match="four points"):
        view_from_points(pixels[:3], CORNERS_M[:3])
    with pytest.raises(InputError, match="mirrored"):
        TargetImage(np.zeros((20, 20)), np.diag([0.1, 0.1, 1.0]))
    with pytest.raises(InputError, match="grey"):
        whole_image(np.zeros((20, 20, 3)), CORNERS_M)
    with pytest.raises(EstimationError, match="miss a plane"):
        grid = np.stack(np.meshgrid([-4.0, 0, 4], [-3.0, 0, 3]), axis=-1).reshape(-1, 2)
        swapped = seen(grid, PINHOLE)
        swapped[4] += 30
        view_from_points(swapped, grid)


def test_target_beside_the_picture() -> None:
    view = view_from_points(seen(CORNERS_M, PINHOLE) + 5000, CORNERS_M)
    with pytest.raises(InputError, match="outside the picture"):
        Rectifier(view, [-4, 4, -3.5, 3.5]).rectify(np.zeros((600, 800), np.uint8))
    with pytest.raises(InputError, match="extent"):
        Rectifier(view, [4, -4, -3.5, 3.5])


# --- marks ----------------------------------------------------------------------------------------------------------


def test_dark_angles_and_templates() -> None:
    """Corners of L-shaped marks within 0.15 px, directly and by templates that another camera took."""
    picture, true = photo(PINHOLE, (0.0, 0.0)), seen(CORNERS_M, PINHOLE)
    found = dark_corners(picture, near_px=true + [[20, 20], [-20, 20], [-20, -20], [20, -20]], reach_px=45, outer=True)
    assert np.abs(found.pixels_px - true).max() < 0.15
    assert found.sigma_px < 0.15
    templates = []
    larger = cv2.resize(picture, None, fx=1.3, fy=1.3, interpolation=cv2.INTER_CUBIC)
    for name, place in zip(CORNERS, (true + 0.5) * 1.3 - 0.5, strict=True):
        # The mark lies towards the middle of the target.
        first = np.floor(place - 20 - 40 * (np.sign(place - [520, 390]) > 0)).astype(int)
        window = larger[first[1] : first[1] + 80, first[0] : first[0] + 80]
        templates.append(MarkTemplate(window, mark_corner(window, name)[0]))
    moved = cv2.warpAffine(
        picture, np.array([[1.0, 0, 7.3], [0, 1.0, -4.6]]), (800, 600), borderMode=cv2.BORDER_REPLICATE
    )
    again = template_corners(moved, templates)
    assert np.abs(again.pixels_px - (true + [7.3, -4.6])).max() < 0.25
    with pytest.raises(EstimationError, match="correlates"):
        template_corners(np.random.default_rng(1).integers(0, 255, (300, 400)).astype(np.uint8), templates)
    with pytest.raises(InputError, match="four are needed"):
        template_corners(picture, templates[:3])


def test_filled_marks_as_in_the_thesis() -> None:
    """Spec 001 C10: inside corners of dark rectangles near the corners of a picture of 300 px."""
    finer = 4
    y, x = (np.mgrid[: 300 * finer, : 300 * finer] + 0.5) / finer - 0.5
    dark = (np.abs(np.abs(x - 149.5) - 118.3) < 8.2) & (np.abs(np.abs(y - 149.5) - 121.6) < 7.1)
    picture = cv2.resize(np.where(dark, 20.0, 140.0), (300, 300), interpolation=cv2.INTER_AREA)
    found = dark_corners(np.rint(picture).astype(np.uint8))
    inner = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [118.3 - 8.2, 121.6 - 7.1] + 149.5
    # The drawing itself knows its edges to an eighth of a pixel.
    assert np.abs(found.pixels_px - inner).max() < 0.15
    with pytest.raises(EstimationError, match="no dark mark"):
        dark_corners(np.full((300, 300), 100, np.uint8))


# --- crops whose places go by the index -----------------------------------------------------------------------------


def test_places_in_the_middle_of_a_crop_by_index_are_open_by_seven_tenths_of_a_pixel() -> None:
    """Where the diagonals cross: each corner moves the crossing by half of what it moves across its own diagonal."""
    crop = whole_image(np.zeros((200, 200), dtype=np.uint8), CORNERS_M, by_index=True)
    width_m, height_m = np.ptp(np.asarray(CORNERS_M), axis=0)
    assert crop.view is not None
    sigma_m = np.sqrt(np.diag(crop.view.covariance_m2(np.mean(np.asarray(CORNERS_M), axis=0))))
    np.testing.assert_allclose(sigma_m / [width_m / 200, height_m / 200], np.sqrt(0.5), rtol=1e-6)


# --- the real frame -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_real_frame_through_its_marks(shared_data: Path) -> None:
    """The raw 3072 x 1728 frame, rectified by the plant's own templates, against the plant's own crop."""
    folder = shared_data / "csp" / "juelich_beam_images"
    names = ("left_top", "right_top", "right_bottom", "left_bottom")
    templates = []
    for name, corner in zip(names, CORNERS, strict=True):
        values = cv2.imread(str(folder / "markers" / f"mft_{name}.png"), cv2.IMREAD_GRAYSCALE)
        templates.append(MarkTemplate(values, mark_corner(values, corner)[0]))
    # The plant's crops are the green channel: red is brighter, and the centroid of luminance lies 0.02 m elsewhere.
    raw = np.ascontiguousarray(cv2.imread(str(folder / "203718-raw.png"))[..., 1])
    found = template_corners(raw, templates)
    assert (found.quality > 0.97).all()
    corners = np.array([[-2.71, 3.19], [2.71, 3.19], [2.71, -3.19], [-2.71, -3.19]])
    view = view_from_points(found.pixels_px, corners, sigma_px=found.sigma_px)
    mine = measure_beam(Rectifier(view, [-2.71, 2.71, -3.19, 3.19], (256, 256)).rectify(raw))
    crop = cv2.imread(str(folder / "203718-cropped.png"), cv2.IMREAD_GRAYSCALE)
    theirs = measure_beam(whole_image(crop, corners, by_index=True))
    assert mine.flags == theirs.flags == 0
    # A pixel of the crop is 0.021 m x 0.025 m; sigma is 0.01 m.
    assert np.abs(mine.spot.position_m - theirs.spot.position_m).max() < 0.021
    assert mine.moments.widths_m == pytest.approx(theirs.moments.widths_m, rel=0.03)


@pytest.mark.parametrize("angle_deg", [-3.0, 0.0, 3.0])
@pytest.mark.parametrize("corner", CORNERS)
def test_a_mark_that_two_targets_share_is_refused(corner: str, angle_deg: float) -> None:
    """A bar goes on beyond the arm of a T: its outline has no corner of the target, and the bar's end is none."""
    window = np.full((160, 160), 150.0)
    window[20:140, 40:60] = 40.0
    bent, shared = window.copy(), window.copy()
    bent[20:40, 40:130] = 40.0
    shared[70:90, 40:130] = 40.0
    flips = {"upper left": (1, 1), "upper right": (1, -1), "lower right": (-1, -1), "lower left": (-1, 1)}[corner]

    def turned(picture: np.ndarray) -> np.ndarray:
        """Turn a picture a little, and lay its mark into this corner."""
        matrix = cv2.getRotationMatrix2D((79.5, 79.5), angle_deg, 1.0)
        whole = cv2.warpAffine(picture, matrix, (160, 160), borderMode=cv2.BORDER_REPLICATE)
        return np.ascontiguousarray(whole[:: flips[0], :: flips[1]])

    mark_corner(turned(bent), corner)
    with pytest.raises(EstimationError, match="T-shaped"):
        mark_corner(turned(shared), corner)
    # Lying on its side it is one as well.
    with pytest.raises(EstimationError, match="T-shaped"):
        mark_corner(
            np.ascontiguousarray(turned(shared).T),
            {"upper right": "lower left", "lower left": "upper right"}.get(corner, corner),
        )


def test_real_marks_between_two_targets_are_refused(shared_data: Path) -> None:
    """The tower's upper and lower target share their middle marks; those at the outside are corners."""
    folder = shared_data / "csp" / "juelich_beam_images" / "markers"
    for name, corner in (("left", "lower left"), ("right", "upper right")):
        window = cv2.imread(str(folder / f"stj_{name}_middle.png"), cv2.IMREAD_GRAYSCALE)
        with pytest.raises(EstimationError, match="T-shaped"):
            mark_corner(window, corner)
    for name, corner in (("stj_left_top", "upper left"), ("mft_right_bottom", "lower right")):
        mark_corner(cv2.imread(str(folder / f"{name}.png"), cv2.IMREAD_GRAYSCALE), corner)
