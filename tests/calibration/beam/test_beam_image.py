"""Centroids of beams: exact where there is no noise, honest where there is, and a flag where there is no answer."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.beam.light.background import TargetSurface, empty_target
from calibration.beam.light.beam_centroids import CENTROID_METHODS
from calibration.beam.light.beam_flags import BEAM_FLAG_TEXTS, BeamFlag, beam_reason
from calibration.beam.light.beam_image import BeamSettings, measure_beam
from calibration.beam.target.view import whole_image
from heliogauge.errors import InputError
from tests.calibration.beam_pictures import CORNERS_M, gaussian, grid_m, picture, sky_light

PIXEL_M = 8 / 256


@pytest.mark.parametrize("method", CENTROID_METHODS)
@pytest.mark.parametrize("center", [(0.0, 0.0), (1.013, -0.627)])
def test_exact_without_noise(method: str, center: tuple[float, float]) -> None:
    beam = measure_beam(picture(sky_light() + 90 * gaussian(center), bits=None), settings=BeamSettings(method=method))
    assert beam.flags == 0
    # A tenth of a pixel is asked; panels and sky light are subtracted, so more is reached.
    assert np.abs(beam.spot.position_m - center).max() < 0.05 * PIXEL_M
    assert beam.moments.widths_m == pytest.approx([0.9, 0.5], rel=0.13)


def test_flat_topped_beam_has_a_large_exponent() -> None:
    beam = measure_beam(picture(sky_light() + 90 * gaussian((0.3, 0.2), exponent=2.5), bits=None))
    assert beam.estimates["super_gaussian"].exponent == pytest.approx(2.5, rel=0.05)
    assert beam.estimates["super_gaussian"].position_m == pytest.approx([0.3, 0.2], abs=1e-3)


@pytest.mark.parametrize("direction_px", [(1, 0), (0, 1), (-1, 1)], ids=["right", "down", "left and down"])
def test_orientation(direction_px: tuple[int, int]) -> None:
    """A beam that moves to the right in the picture moves to +x, one that moves down moves to -y."""
    values = sky_light() + 90 * gaussian((0.0, 0.0))
    moved = sky_light() + 90 * np.roll(gaussian((0.0, 0.0)), (10 * direction_px[1], 10 * direction_px[0]), (0, 1))
    shift = measure_beam(picture(moved)).spot.position_m - measure_beam(picture(values)).spot.position_m
    assert shift == pytest.approx(np.multiply(direction_px, [1, -1]) * 10 * PIXEL_M, abs=0.003)


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["plain", "weak"])
def test_sigma_is_the_scatter(scene: str) -> None:
    """Each method's sigma, against the scatter of 40 pictures with noise."""
    height, noise = (90.0, 3.0) if scene == "plain" else (25.0, 2.0)
    clean = sky_light() + height * gaussian((0.41, -0.33))
    beams = [measure_beam(picture(clean, noise_dn=noise, seed=k)) for k in range(40)]
    assert all(beam.flags == 0 for beam in beams)
    for method in CENTROID_METHODS:
        places = np.array([beam.estimates[method].position_m for beam in beams])
        predicted = np.sqrt(np.mean([beam.estimates[method].sigma_m ** 2 for beam in beams], axis=0))
        # 40 draws know a scatter to 11 %; the background's own errors are estimated on the safe side.
        assert (places.std(axis=0) / predicted > 0.7).all(), method
        assert (places.std(axis=0) / predicted < 1.2).all(), method


def test_sigma_holds_what_a_centroid_leaves_open() -> None:
    """A share of the width along each axis, and for a lopsided beam the scatter of the methods, in both directions."""
    plain = measure_beam(picture(sky_light() + 90 * gaussian((0.2, 0.1)), noise_dn=1.0))
    width = np.sqrt(np.diag(plain.moments.covariance_m2))
    assert (plain.spot.sigma_m >= 0.008 * width).all()
    assert (plain.spot.sigma_m < 0.012 * width).all()
    skirt = 90 * gaussian((0.2, 0.1), (0.5, 0.5)) + 45 * gaussian((1.0, 0.1), (0.7, 0.5))
    lopsided = measure_beam(picture(sky_light() + skirt, noise_dn=1.0))
    places = np.array([one.position_m for one in lopsided.estimates.values()])
    assert not lopsided.rejected
    assert np.ptp(places, axis=0)[0] > 5 * np.ptp(places, axis=0)[1]
    # What the methods agree on in one direction by chance says nothing of it.
    scatter = np.sqrt(places.var(axis=0, ddof=1).mean())
    assert lopsided.spot.sigma_m == pytest.approx([scatter] * 2, rel=0.1)


def _thesis_beam(center_px: tuple[float, float]) -> np.ndarray:
    """Footprint 0.30 m x 0.26 m convolved with a disc of 0.355 m, 6.667 mm/px (Malan 2014, as simulated for C10)."""
    finer = 2
    y, x = (np.mgrid[: 300 * finer, : 300 * finer] + 0.5) / finer - 0.5
    # Convolution of a rectangle with a disc: sum of the disc's chords over the rectangle, drawn pixel by pixel.
    mirror = (np.abs((x - center_px[0]) * 6.667e-3) < 0.15) & (np.abs((y - center_px[1]) * 6.667e-3) < 0.13)
    radius = 0.355 / 2 / 6.667e-3 * finer
    k = int(np.ceil(radius))
    ky, kx = np.mgrid[-k : k + 1, -k : k + 1]
    disc = (kx**2 + ky**2 <= radius**2).astype(np.float64)
    light = cv2.filter2D(mirror.astype(np.float64), -1, disc / disc.sum(), borderType=cv2.BORDER_CONSTANT)
    return np.asarray(cv2.resize(light, (300, 300), interpolation=cv2.INTER_AREA))


@pytest.mark.parametrize(("noise", "gradient", "most_px"), [(0.0, 0.0, 0.10), (3.0, 0.0, 0.14), (3.0, 20.0, 0.14)])
def test_better_than_the_thesis(noise: float, gradient: float, most_px: float) -> None:
    """Spec 001 C10: 0.10 px without noise, 0.14 px with 3 DN, 0.43-0.50 px with a slope of 20 DN across."""
    rng = np.random.default_rng(3)
    errors = []
    corners = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]])
    for _ in range(8):
        center = rng.uniform(110, 190, 2)
        light = _thesis_beam((float(center[0]), float(center[1])))
        true_px = [
            float((light.sum(axis=0) @ np.arange(300)) / light.sum()),
            float((light.sum(axis=1) @ np.arange(300)) / light.sum()),
        ]
        values = (
            60 + 135 * light / light.max() + gradient * np.linspace(0, 1, 300) + noise * rng.normal(size=(300, 300))
        )
        image = whole_image(np.clip(np.rint(values), 0, 255).astype(np.uint8), corners)
        # V-16: 2 m on 300 px, 0.175 mrad of the beam per pixel at 38.2 m.
        assert image.jacobian([150, 150]) == pytest.approx(np.diag([6.667e-3, -6.667e-3]), abs=1e-6)
        errors.append(image.pixels_px(measure_beam(image).spot.position_m) - true_px)
    assert np.sqrt(np.mean(np.square(errors))) < most_px


# --- flags ----------------------------------------------------------------------------------------------------------


def test_no_beam() -> None:
    for values in (np.zeros((224, 256)), sky_light(), np.full((224, 256), 255.0)):
        beam = measure_beam(picture(values, noise_dn=2.0 if values.max() < 255 and values.max() > 0 else 0.0))
        assert beam.flags == BeamFlag.NO_BEAM
        assert np.isnan(beam.spot.position_m).all()
        assert "no beam" in beam.reason


def test_panels_and_clouds_are_no_beam() -> None:
    """Panels of slightly different brightness: nothing is called a beam that may be used."""
    rng = np.random.default_rng(6)
    for _ in range(4):
        panels = cv2.resize(rng.uniform(0.97, 1.03, (3, 4)), (256, 224), interpolation=cv2.INTER_NEAREST)
        beam = measure_beam(picture(sky_light() * panels, noise_dn=1.0))
        assert beam.rejected


def test_cut_by_the_edge() -> None:
    beam = measure_beam(picture(sky_light() + 90 * gaussian((3.6, 0.0)), noise_dn=1.0))
    assert beam.flags & BeamFlag.CUT_BY_EDGE
    assert beam.rejected
    near = measure_beam(picture(sky_light() + 90 * gaussian((2.0, 0.0)), noise_dn=1.0))
    assert not near.flags & BeamFlag.CUT_BY_EDGE


@pytest.mark.parametrize("distance_m", [1.6, 3.5])
def test_two_beams(distance_m: float) -> None:
    """Overlapping, and apart from each other."""
    both = gaussian((-distance_m / 2, 0.3), (0.5, 0.4)) + 0.8 * gaussian((distance_m / 2, -0.3), (0.5, 0.4))
    beam = measure_beam(picture(sky_light() + 70 * both, noise_dn=1.0))
    assert beam.flags & BeamFlag.TWO_BEAMS
    assert beam.rejected


def test_streaks_of_facets_are_one_beam() -> None:
    streaks = sum(gaussian((0.18 * k, -0.12 * k), (0.9, 0.12), 0.6) for k in range(-2, 3))
    beam = measure_beam(picture(sky_light() + 60 * np.asarray(streaks), noise_dn=1.0))
    assert not beam.flags & BeamFlag.TWO_BEAMS


def test_saturated() -> None:
    beam = measure_beam(picture(sky_light() + 300 * gaussian((0.2, 0.1))))
    assert beam.flags == BeamFlag.SATURATED
    assert beam.saturated_share > 0.1
    assert beam.spot.position_m == pytest.approx([0.2, 0.1], abs=0.01)


def test_sunlit_target() -> None:
    beam = measure_beam(picture(200 + 0.2 * sky_light() + 15 * gaussian((0.2, 0.1)), noise_dn=0.5))
    assert beam.flags == BeamFlag.SUNLIT_TARGET
    assert not beam.rejected


def test_target_partly_outside_the_picture() -> None:
    values = sky_light() + 90 * gaussian((0.2, 0.1))
    values[:, :20] = np.nan
    few = measure_beam(whole_image(values, CORNERS_M))
    assert few.flags == 0
    assert few.spot.position_m == pytest.approx([0.2, 0.1], abs=0.003)
    values[:, :80] = np.nan
    assert measure_beam(whole_image(values, CORNERS_M)).flags == BeamFlag.NOT_FINITE


def test_every_flag_has_a_text() -> None:
    assert set(BEAM_FLAG_TEXTS) == set(BeamFlag)
    assert beam_reason(0) == ""


# --- backgrounds ----------------------------------------------------------------------------------------------------


def test_shadow_under_the_beam() -> None:
    """The border of a shadow runs under the beam; without the step in the background, the place is off by 0.3 m."""
    x, y = grid_m()
    values = sky_light() + 25 * (y - 0.5 * x < 0.3) + 60 * gaussian((0.4, 0.2))
    beam = measure_beam(picture(values, noise_dn=1.0))
    assert np.abs(beam.spot.position_m - [0.4, 0.2]).max() < 0.04


def test_marks_under_the_beam() -> None:
    values = sky_light() + 90 * gaussian((0.4, 0.2))
    values[100:104, :] *= 0.5
    values[:, 150:153] *= 0.5
    beam = measure_beam(picture(values, noise_dn=1.0))
    assert np.abs(beam.spot.position_m - [0.4, 0.2]).max() < 0.03


def test_frames_without_a_beam() -> None:
    """A target with a pattern that no smooth surface follows; the light has changed since the frames were taken."""
    rng = np.random.default_rng(5)
    pattern = cv2.resize(rng.uniform(0.6, 1.3, (9, 11)), (256, 224), interpolation=cv2.INTER_NEAREST)
    x, _ = grid_m()
    empty = empty_target([sky_light() * pattern + rng.normal(0, 1, pattern.shape) for _ in range(4)])
    values = 1.3 * (1 + 0.03 * x) * sky_light() * pattern + 8 + 40 * gaussian((0.4, 0.2))
    image = picture(values, noise_dn=1.0)
    beam = measure_beam(image, empty=empty)
    assert beam.flags == 0
    assert np.abs(beam.spot.position_m - [0.4, 0.2]).max() < 0.01
    blind = measure_beam(image)
    assert np.abs(blind.spot.position_m - [0.4, 0.2]).max() > 3 * np.abs(beam.spot.position_m - [0.4, 0.2]).max()


def test_bad_frames_without_a_beam() -> None:
    with pytest.raises(InputError, match="at least one"):
        empty_target([])
    with pytest.raises(InputError, match="one size"):
        empty_target([np.ones((9, 9)), np.ones((9, 10))])
    with pytest.raises(InputError, match="frame 2 is black"):
        empty_target([np.ones((9, 9)), np.zeros((9, 9))])
    with pytest.raises(InputError, match="pixels"):
        measure_beam(picture(sky_light()), empty=TargetSurface(np.ones((10, 10)), 1))


@pytest.mark.parametrize("shape", [(224, 256), (112, 128), (896, 1024)])
def test_resolution_and_depth_do_not_matter(shape: tuple[int, int]) -> None:
    values = sky_light(shape) + 90 * gaussian((0.4, 0.2), shape=shape)
    for scale, bits in ((1, 8), (200, 16)):
        beam = measure_beam(picture(scale * values, bits=bits))
        assert beam.flags == 0
        assert beam.spot.position_m == pytest.approx([0.4, 0.2], abs=0.002)
        assert beam.peak_dn == pytest.approx(90 * scale, rel=0.03)


def test_bad_settings() -> None:
    with pytest.raises(InputError, match="method"):
        BeamSettings(method="peak")
    with pytest.raises(InputError, match="most_edge_share"):
        BeamSettings(most_edge_share=0.0)


# --- real pictures --------------------------------------------------------------------------------------------------

REAL = ("106293", "137608", "152144", "194228", "203718")


def _real_target(folder: Path, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the target and the label on its plane (east, up about the corners' mean), both [m]."""
    tower = json.loads((folder / "tower-measurements.json").read_text())
    record = json.loads((folder / f"{name}-calibration-properties.json").read_text())
    corners = tower[record["target_name"]]["coordinates"]
    geodetic = [corners[k] for k in ("upper_left", "upper_right", "lower_right", "lower_left")]
    geodetic.append(record["focal_spot"]["UTIS"])
    latitude, longitude, altitude = np.array(geodetic).T
    # The target faces north: seen from the field, east is on the left. Curvature over 9 m is nothing.
    across = -np.radians(longitude - longitude[0]) * 6.3906e6 * np.cos(np.radians(latitude))
    plane = np.stack([across, altitude - altitude[:4].mean()], axis=1)
    return plane[:4], plane[4]


@pytest.mark.parametrize("name", REAL)
def test_real_beams_agree_with_their_labels(shared_data: Path, name: str) -> None:
    """UTIS labels of the PAINT data base: within one pixel where the background is gone, within 0.1 m where not."""
    folder = shared_data / "csp" / "juelich_beam_images"
    corners, label = _real_target(folder, name)
    pixel = np.ptp(corners, axis=0) / 256
    plain = cv2.imread(str(folder / f"{name}-flux.png"), cv2.IMREAD_UNCHANGED)
    raw = cv2.imread(str(folder / f"{name}-cropped.png"), cv2.IMREAD_UNCHANGED)
    flux = measure_beam(whole_image(plain, corners, by_index=True))
    assert (np.abs(flux.spot.position_m - label) < pixel).all()
    beam = measure_beam(whole_image(raw, corners, by_index=True))
    # Without a frame of the empty target, its own brightness may hold light of so large a beam.
    assert beam.flags & ~BeamFlag.BACKGROUND_MAY_HOLD_LIGHT == 0
    assert np.linalg.norm(beam.spot.position_m - label) < 0.1
