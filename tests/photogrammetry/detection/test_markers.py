"""Square markers: corners against a drawing by area, covariance, refusals, the real photos."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from data_synth.targets.presets import target_scene
from data_synth.targets.scene import render_photo
from heliogauge.errors import InputError
from heliogauge.images.photos import read_image
from heliogauge.validate import FloatArray
from photogrammetry.detection.markers import MarkerLimits, find_markers
from photogrammetry.detection.square_edges import square_corners

DICTIONARY = "DICT_4X4_100"


def drawn(
    number: int,
    corners: FloatArray,
    *,
    noise_dn: float = 1.0,
    seed: int = 0,
    fine: int = 8,
    dictionary: str = DICTIONARY,
) -> FloatArray:
    """A marker on white paper; each pixel the mean of fine x fine samples, slightly blurred."""
    table = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    side = table.markerSize + 2
    cells = np.pad(cv2.aruco.generateImageMarker(table, number, side, borderBits=1), 30, constant_values=255)
    big = np.kron(cells, np.ones((16, 16), dtype=np.uint8))
    # Corners of the marker in the pattern's pixels: edges lie half a pixel before its first pixel.
    at = ((30 + side * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])) * 16 - 0.5).astype(np.float32)
    to_fine = ((corners + 0.5) * fine - 0.5).astype(np.float32)
    size = (120 * fine, 100 * fine)
    image = cv2.warpPerspective(
        big, cv2.getPerspectiveTransform(at, to_fine), size, flags=cv2.INTER_LINEAR, borderValue=255
    )
    image = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 0.5 * fine)
    image = image.reshape(100, fine, 120, fine).mean(axis=(1, 3)) * 0.7 + 30
    return image + np.random.default_rng(seed).normal(0, noise_dn, image.shape)


SQUARE = np.array([[40.3, 30.2], [78.1, 34.7], [74.9, 71.3], [37.2, 66.8]])


def test_corners_are_sub_pixel_and_their_covariance_is_honest() -> None:
    errors, squares = [], []
    for seed in range(12):
        found = find_markers(drawn(7, SQUARE, seed=seed), "a", DICTIONARY).detections
        assert found.names == ("7.0", "7.1", "7.2", "7.3")
        error = found.pixels_px - SQUARE
        errors.append(error)
        squares.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.covariance_px2), error))
    assert np.abs(np.mean(errors, axis=0)).max() < 0.02
    assert np.std(errors, axis=0).max() < 0.02
    # The drawing's own grid leaves 0.01 px; beyond that the scatter is what the covariance says.
    scatter = np.sqrt(np.mean(np.var(errors, axis=0)))
    sigma = np.sqrt(np.mean(np.diagonal(found.covariance_px2, axis1=1, axis2=2)))
    assert 0.6 < scatter / sigma < 1.6


@pytest.mark.parametrize("turn", range(4))
def test_corners_are_named_in_the_marker_s_own_order(turn: int) -> None:
    turned = np.roll(SQUARE, turn, axis=0)
    found = find_markers(drawn(23, turned), "a", DICTIONARY).detections
    assert found.pixels_px == pytest.approx(turned, abs=0.05)


def test_depths_give_the_same_corners() -> None:
    image = drawn(5, SQUARE)
    deep = find_markers((image * 257).astype(np.uint16), "a", DICTIONARY).detections
    flat = find_markers(np.rint(image).astype(np.uint8), "a", DICTIONARY).detections
    assert deep.pixels_px == pytest.approx(flat.pixels_px, abs=0.02)


def test_weak_markers_are_refused_with_the_number() -> None:
    weak = find_markers(drawn(5, SQUARE), "a", DICTIONARY, MarkerLimits(least_contrast_dn=200.0))
    assert len(weak.detections) == 0
    assert weak.rejected[0].number == 5
    assert "contrast 17" in weak.rejected[0].reason


def test_duplicates_are_named() -> None:
    both = np.hstack([drawn(9, SQUARE), drawn(9, SQUARE, seed=1)])
    found = find_markers(both, "a", DICTIONARY)
    assert found.duplicated == (9,)
    assert len(found.detections) == 8


def test_nothing_found_is_no_error() -> None:
    assert len(find_markers(np.full((80, 80), 128, dtype=np.uint8), "a", DICTIONARY).detections) == 0


def test_unknown_dictionaries_are_refused() -> None:
    with pytest.raises(InputError, match="OpenCV's name"):
        find_markers(np.zeros((20, 20), dtype=np.uint8), "a", "4X4")


def test_real_photo(shared_data) -> None:  # type: ignore[no-untyped-def]
    image = read_image(shared_data / "opencsp" / "scene_reconstruction" / "aruco_marker_images" / "DSC03660.JPG")
    found = find_markers(image, "DSC03660", "DICT_4X4_1000")
    assert len(found.numbers) >= 10
    assert np.median([square.straightness_px for square in found.squares]) < 0.04
    assert np.median(found.detections.sigma_px) < 0.09


@pytest.mark.parametrize(("smooth_px", "low", "high"), [(0.0, 0.8, 1.4), (1.2, 2.0, 8.0)])
def test_neighbours_that_err_alike_are_noticed(smooth_px: float, low: float, high: float) -> None:
    """Sections of the sides scatter as independent pixels make them, or more: then the covariance grows."""
    excess, squares = [], []
    for seed in range(16):
        noise = np.random.default_rng(seed).normal(0, 3.0, (100, 120))
        if smooth_px:
            noise = cv2.GaussianBlur(noise, (0, 0), smooth_px) * (2 * np.sqrt(np.pi) * smooth_px)
        found = find_markers(drawn(7, SQUARE, noise_dn=0.0) + noise, "a", DICTIONARY)
        error = found.detections.pixels_px - SQUARE
        excess.append(found.squares[0].section_excess)
        squares.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.detections.covariance_px2), error))
    assert low < np.median(excess) < high
    # Chi-squares of two degrees of freedom: errors of whole sides, which this noise has not, are allowed for.
    assert 0.1 < np.mean(squares) / 2 < 1.5


def test_white_cells_behind_the_border_do_not_enlarge_small_markers() -> None:
    small = SQUARE.mean(axis=0) + 0.42 * (SQUARE - SQUARE.mean(axis=0))
    # All sides of number 17 border on white cells; the side is 16 px, a cell 2.7 px.
    found = find_markers(drawn(17, small, noise_dn=0.3), "a", DICTIONARY).detections
    outward = (small - small.mean(axis=0)) / np.linalg.norm(small - small.mean(axis=0), axis=1)[:, None]
    assert abs(np.mean(np.sum((found.pixels_px - small) * outward, axis=1))) < 0.05


@pytest.mark.parametrize("name", ["DICT_APRILTAG_36h11", "DICT_APRILTAG_16h5", "DICT_ARUCO_ORIGINAL"])
def test_other_families_have_sub_pixel_corners(name: str) -> None:
    found = find_markers(drawn(11, SQUARE, dictionary=name), "a", name).detections
    assert found.names == ("11.0", "11.1", "11.2", "11.3")
    assert found.pixels_px == pytest.approx(SQUARE, abs=0.05)


@pytest.mark.parametrize("name", ["DICT_APRILTAG_16h5", "DICT_4X4_1000"])
def test_clutter_has_no_markers(name: str) -> None:
    """Dictionaries of few bits, or of many numbers, are those that clutter is read as."""
    scene = replace(target_scene("busy", 0), sheets=())
    for seed in range(2):
        image = render_photo(scene, scene.views[seed], np.random.default_rng(seed))
        assert find_markers(image, "a", name).numbers == ()


@pytest.mark.parametrize("sharpening", [0.5, 1.0])
def test_sharpened_edges_give_one_corner_from_any_start(sharpening: float) -> None:
    """Edges that a camera has sharpened are steeper than a pixel; undamped steps swung there and ended 1 px off."""
    errors, apart = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        middle, turn, half, fine = 27.0 + rng.uniform(-0.5, 0.5, 2), 0.02 + 0.05 * seed, 15.0, 16
        axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        corners = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) @ axes + middle
        places = np.stack(np.meshgrid(*[(np.arange(54 * fine) + 0.5) / fine - 0.5] * 2), axis=-1) - middle
        inside = (np.abs(places @ axes.T) < half).all(axis=-1)
        image = np.where(inside, 10.0, 130.0).reshape(54, fine, 54, fine).mean(axis=(1, 3))
        image += sharpening * (image - cv2.GaussianBlur(image, (0, 0), 1.0))
        image = np.clip(np.rint(image + 0.5 * rng.standard_normal(image.shape)), 0, 255)
        starts = corners + rng.uniform(-1, 1, (2, 4, 2))
        found = [square_corners(image, start, np.zeros((6, 6), dtype=np.bool_)).corners_px for start in starts]
        apart.append(found[1] - found[0])
        errors += [one - corners for one in found]
    # Sigmas are 0.03 to 0.04 px.
    assert np.sqrt(np.mean(np.square(errors))) < 0.03
    assert np.abs(apart).max() < 0.04
