"""Bright regions, polygons, sub-pixel edges and masks, against drawings with exact pixel areas."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deflectometry.pose.mirrors_in_image import (
    enclosing_polygon,
    find_mirrors,
    image_noise,
    measure_edges,
    polygon_mask,
)
from heliogauge.errors import EstimationError, InputError

SQUARE = np.array([[60.3, 40.2], [150.7, 45.4], [145.1, 120.6], [55.9, 118.8]])


def _coverage(shape: tuple[int, int], corners: np.ndarray, over: int = 16) -> np.ndarray:
    """Share of each pixel inside a polygon, by brute force over sub-pixels."""
    height, width = shape
    x = (np.arange(width * over) + 0.5) / over - 0.5
    y = (np.arange(height * over) + 0.5) / over - 0.5
    inside = np.ones((y.size, x.size), dtype=bool)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        inside &= (b[0] - a[0]) * (y[:, None] - a[1]) - (b[1] - a[1]) * (x[None, :] - a[0]) >= 0
    return np.asarray(inside.reshape(height, over, width, over).mean(axis=(1, 3)))


def _image(corners: np.ndarray = SQUARE, *, noise: float = 1.0, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    covered = _coverage((154, 203), corners)
    return np.asarray(10 + 170 * covered + rng.normal(0, noise, covered.shape), dtype=np.float32)


def test_one_mirror_is_found_without_levels_or_sizes() -> None:
    found = find_mirrors(_image())
    assert len(found.regions) == 1
    area = 0.5 * abs(np.cross(SQUARE - SQUARE[0], np.roll(SQUARE, -1, axis=0) - SQUARE[0]).sum())
    assert found.mask.sum() == pytest.approx(area, rel=0.02)
    assert found.regions[0].borders == ()
    assert found.noise_dn == pytest.approx(1.0, rel=0.1)


@pytest.mark.parametrize("scale", [0.02, 1.0, 50.0])
def test_level_follows_the_brightness_of_the_image(scale: float) -> None:
    image = _image()
    plain, scaled = find_mirrors(image), find_mirrors(image * np.float32(scale) + 3)
    assert (plain.mask == scaled.mask).mean() > 0.999


def test_small_mirror_in_a_room_of_several_grey_levels() -> None:
    image = _image(np.array([[100.2, 70.1], [112.4, 70.5], [112.1, 82.3], [100.6, 82.0]]))
    image[20:140, 10:90] += 40
    image[0:15, :] += 25
    found = find_mirrors(image)
    assert len(found.regions) == 1
    np.testing.assert_allclose(found.regions[0].centroid_px, [106.3, 76.2], atol=0.3)


def test_small_dim_mirror_in_a_large_noisy_image() -> None:
    image = np.random.default_rng(6).normal(10, 1.5, (600, 800)).astype(np.float32)
    image[300:318, 400:420] += 18
    found = find_mirrors(image)
    assert len(found.regions) == 1
    np.testing.assert_allclose(found.regions[0].centroid_px, [409.5, 308.5], atol=0.5)


def test_hot_pixels_do_not_move_the_level() -> None:
    image = _image()
    image[::29, ::31] = 4000
    assert len(find_mirrors(image).regions) == 1


def test_several_regions_largest_first_and_dust_dropped() -> None:
    image = np.full((120, 200), 5.0, dtype=np.float32)
    image[20:100, 20:80] = 100
    image[30:90, 100:150] = 100
    image[50:54, 170:174] = 100
    image += np.random.default_rng(2).normal(0, 0.5, image.shape).astype(np.float32)
    found = find_mirrors(image)
    assert [round(region.area_px, -2) for region in found.regions] == [4700, 2900]


def test_no_mirror_is_said_with_numbers() -> None:
    noise = np.random.default_rng(3).normal(20, 2, (154, 203))
    with pytest.raises(EstimationError, match=r"no mirror in view.*noise \(\d\.\d\d DN\)"):
        find_mirrors(noise)
    with pytest.raises(EstimationError, match="no mirror in view"):
        find_mirrors(np.full((50, 50), 7.0))
    with pytest.raises(InputError, match="at least 8 x 8"):
        find_mirrors(np.zeros((3, 50)))


@pytest.mark.parametrize(
    ("shift", "side"), [((-60, 0), "left"), ((60, 0), "right"), ((0, -45), "top"), ((0, 40), "bottom")]
)
def test_a_mirror_cut_by_the_border_is_marked(shift: tuple[float, float], side: str) -> None:
    assert find_mirrors(_image(SQUARE + shift)).regions[0].borders == (side,)


def test_not_finite_pixels_count_as_dark() -> None:
    image = _image()
    image[:5] = np.nan
    assert len(find_mirrors(image).regions) == 1


def test_noise_is_measured_beside_edges() -> None:
    assert image_noise(_image(noise=2.5)) == pytest.approx(2.5, rel=0.05)


@given(st.integers(3, 8), st.floats(0, 6.28), st.floats(0.5, 1.0))
def test_enclosing_polygon_of_a_polygon_is_itself(n_corners: int, turn: float, squash: float) -> None:
    angles = turn + 2 * np.pi * np.arange(n_corners) / n_corners
    corners = np.column_stack([100 + 80 * np.cos(angles), 90 + 80 * squash * np.sin(angles)])
    share = np.linspace(0, 1, 20, endpoint=False)[:, None, None]
    points = (corners + share * (np.roll(corners, -1, axis=0) - corners)).reshape(-1, 2)
    found = enclosing_polygon(points, n_corners)
    distances = np.linalg.norm(found[:, None] - corners, axis=-1)
    assert distances.min(axis=1).max() < 1e-3
    assert distances.min(axis=0).max() < 1e-3


def test_enclosing_polygon_restores_a_cut_corner() -> None:
    cut = np.array([[0.0, 0.0], [10, 0], [10, 7], [7, 10], [0, 10]])
    found = enclosing_polygon(cut, 4)
    assert np.linalg.norm(found - [10, 10], axis=1).min() < 1e-5
    with pytest.raises(EstimationError, match="has 3 corners, 4 are needed"):
        enclosing_polygon(cut[:3], 4)


@pytest.mark.parametrize("blur_px", [0.0, 0.7, 2.0])
@pytest.mark.parametrize("angle", [0.0, 0.17, 0.5, 1.1])
def test_edge_of_a_half_plane_is_measured_without_bias(blur_px: float, angle: float) -> None:
    rng = np.random.default_rng(4)
    normal = np.array([np.cos(angle), np.sin(angle)])
    errors = []
    for offset in np.linspace(-0.5, 0.5, 7):
        through = np.array([32.0, 32.0]) + offset * normal
        x = (np.arange(65 * 16) + 0.5) / 16 - 0.5
        inside = (x[None, :] - through[0]) * normal[0] + (x[:, None] - through[1]) * normal[1] < 0
        image = (10 + 100 * inside.reshape(65, 16, 65, 16).mean(axis=(1, 3))).astype(np.float32)
        if blur_px:
            image = np.asarray(cv2.GaussianBlur(image, (0, 0), blur_px))
        along = np.arange(-10, 11)[:, None] * np.array([-normal[1], normal[0]])
        points = np.array([32.0, 32.0]) + along + rng.uniform(-1.5, 1.5, (21, 1)) * normal
        edges = measure_edges(image, points, np.tile(normal, (21, 1)), reach_px=4, noise_dn=0.1)
        errors.append(edges.offset_px - (through - points) @ normal)
    # The drawing itself samples the edge every 1/16 px.
    assert np.abs(np.mean(errors)) < 0.004
    assert np.abs(errors).max() < 0.08


def test_sigma_of_edges_is_that_of_their_scatter() -> None:
    rng = np.random.default_rng(5)
    clean = np.full((400, 40), 10.0)
    clean[:, :20] = 110
    clean[:, 20] = 10 + 100 * 0.3
    image = (clean + rng.normal(0, 2, clean.shape)).astype(np.float32)
    points = np.column_stack([np.full(99, 20.0), 4.0 * np.arange(99) + 2.5])
    edges = measure_edges(image, points, np.tile([1.0, 0.0], (99, 1)), reach_px=3, noise_dn=2.0)
    assert np.nanmean(edges.offset_px) == pytest.approx(-0.2, abs=0.02)
    assert np.nanstd(edges.offset_px) == pytest.approx(np.nanmedian(edges.sigma_px), rel=0.35)


def test_no_edge_and_points_outside_the_image_give_nan() -> None:
    image = _image()
    points = np.array([[100.0, 80.0], [1.0, 1.0], [500.0, 80.0]])
    edges = measure_edges(image, points, np.tile([1.0, 0.0], (3, 1)), reach_px=5, noise_dn=1.0)
    assert np.isnan(edges.offset_px).all()


@given(st.floats(-3, 3), st.floats(-3, 3), st.booleans())
def test_polygon_mask_is_the_pixel_centres_inside(shift_x: float, shift_y: float, reverse: bool) -> None:
    corners = np.array([[3.2, 2.1], [14.3, 4.0], [9.7, 8.2], [15.1, 13.9], [2.4, 11.7]]) + [shift_x, shift_y]
    mask = polygon_mask((16, 18), corners[::-1] if reverse else corners)
    grid = np.stack(np.meshgrid(np.arange(18), np.arange(16)), axis=-1).reshape(-1, 2)
    contour = corners.astype(np.float32).reshape(-1, 1, 2)
    signed = np.array([cv2.pointPolygonTest(contour, (float(x), float(y)), True) for x, y in grid])
    sure = np.abs(signed) > 1e-4
    np.testing.assert_array_equal(mask.ravel()[sure], signed[sure] > 0)


def test_reference_facet_is_found_in_modulation_and_brightness(shared_data: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(shared_data / "opencsp" / "fringe" / "measurement_facet.h5") as file:
        group = file["MeasurementSofastFringe"]
        dark, bright = np.moveaxis(group["mask_images"][()].astype(np.float32), -1, 0)
        frames = group["fringe_images"][()].astype(np.float32)
    modulation = np.hypot(frames[..., 0] - frames[..., 2], frames[..., 1] - frames[..., 3])
    for image in (bright - dark, modulation):
        found = find_mirrors(image)
        assert found.regions[0].borders == ()
        # The publisher's corners enclose 7065 px.
        assert found.regions[0].area_px == pytest.approx(7065, rel=0.02)
