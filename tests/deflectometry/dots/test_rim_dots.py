"""Dots beside the edges of a mirror: all of them, where hardly any is away from an edge."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr

from deflectometry.dots import cut_dots
from deflectometry.dots.cut_dots import fit_cut_dot
from deflectometry.dots.found_dots import FoundDots
from deflectometry.dots.rim import Rim
from deflectometry.dots.rim_dots import find_rim, with_rim_dots
from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet, plane
from heliogauge.validate import FloatArray
from photogrammetry.centers import Ellipse

PITCH_PX, RADIUS_PX, BLUR_PX = 18.0, 4.0, 1.0


def strip_of_dots(columns: int, rows: int) -> tuple[FoundDots, Rim]:
    """Return dark dots, as found 0.1 px aside, on a mirror that ends 3 px beside them."""
    column, row = (one.ravel() for one in np.meshgrid(np.arange(columns), np.arange(rows)))
    places = PITCH_PX * (np.stack([column, row], axis=1) + 1.0)
    high, wide = int(PITCH_PX * (rows + 1)), int(PITCH_PX * (columns + 1))
    x, y = np.meshgrid(np.arange(wide), np.arange(high))
    share = np.zeros((high, wide))
    for place in places:
        share = np.maximum(share, np.clip(RADIUS_PX + 0.5 - np.hypot(x - place[0], y - place[1]), 0, 1))
    photo = 150 - 100 * gaussian_filter(share, BLUR_PX)
    margin = PITCH_PX - RADIUS_PX - 3.0
    inside = np.min([x - margin, wide - margin - x, y - margin, high - margin - y], axis=0)
    count = len(places)
    dots = FoundDots(
        places + 0.1,
        np.tile(1e-2 * np.eye(2), (count, 1, 1)),
        np.stack([column, row], axis=1),
        np.full(count, 100.0),
        1.0,
        shapes_px2=np.tile(RADIUS_PX**2 * np.eye(2), (count, 1, 1)),
        blur_px=BLUR_PX,
    )
    ground = np.full(photo.shape, 150.0)
    return dots, Rim(photo.astype(np.float32), inside, np.full(photo.shape, 100.0), BLUR_PX, 0.1, ground)


def sorted_places(dots: FoundDots) -> FloatArray:
    return np.asarray(dots.centers_px[np.lexsort(dots.number.T)])


@pytest.mark.parametrize("columns", [2, 3, 5])
def test_dots_are_measured_though_all_are_at_an_edge(columns: int) -> None:
    dots, rim = strip_of_dots(columns, 13)
    found = with_rim_dots(dots, rim)
    assert not found.is_cut.any()
    near = np.abs(sorted_places(found) - sorted_places(dots)).max(axis=1) > 1e-9
    # All but those inside: none of two columns.
    assert np.count_nonzero(near) == 13 * columns - 11 * max(columns - 2, 0)
    assert np.abs(sorted_places(found) - (sorted_places(dots) - 0.1))[near].max() < 0.02


def cut_dot(pitch_px: float, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return error and covariance of the middle of a dot of 4 px radius that the mirror's edge cuts 2 px beside it."""
    fine, size, tilt = 7, 44, 0.3
    y, x = (np.mgrid[: size * fine, : size * fine] + 0.5) / fine - 0.5
    middle = np.array([0.55 * size, 0.5 * size]) + rng.uniform(-0.5, 0.5, 2)
    away, outwards = np.stack([x, y], axis=-1) - middle, np.array([np.cos(tilt), np.sin(tilt)])
    covered = np.zeros(x.shape)
    for step in np.ndindex(4, 5):
        place = pitch_px * (np.array(step) - (1, 2))
        # Its size differs from its neighbours' by as much as theirs scatter.
        radii = RADIUS_PX * (np.exp(rng.normal(0, 0.01, 2)) if step == (1, 2) else np.ones(2))
        covered = np.maximum(covered, np.linalg.norm((away - place) / radii, axis=-1) < 1.0)
    inside = away @ outwards + 2.0
    blurred = gaussian_filter(covered * (inside > 0), fine * np.sqrt(BLUR_PX**2 - 1 / 12))
    photo = 150 - 100 * blurred.reshape(size, fine, size, fine).mean(axis=(1, 3)) + rng.normal(0, 1.0, (size, size))
    centre = slice(fine // 2, None, fine)
    off = rng.normal(0, 0.03)
    stated = inside[centre, centre] + off
    photo += 100 * (ndtr(-stated / BLUR_PX) - ndtr((off - stated) / BLUR_PX))
    dots, _ = strip_of_dots(5, 5)
    scatter = np.exp(rng.normal(0, 0.02, (25, 2)))
    alike = replace(dots, shapes_px2=RADIUS_PX**2 * scatter[:, None] * np.eye(2))
    whole = np.full(photo.shape, 150.0)
    rim = Rim(photo.astype(np.float32), stated, np.full(photo.shape, 100.0), BLUR_PX, 0.03, whole)
    start = Ellipse(middle + rng.normal(0, 0.3, 2), RADIUS_PX**2 * np.eye(2))
    found = fit_cut_dot(rim, start, 100.0, alike)
    assert found is not None
    return found.center_px - middle, found.covariance_px2


@pytest.mark.parametrize("pitch_px", [12.0, 14.0, 18.0])
def test_a_cut_dot_is_where_it_is_said_to_be_however_close_its_neighbours_stand(pitch_px: float) -> None:
    """With the median of a window that holds neighbours they would be 0.15 to 0.4 px off."""
    rng = np.random.default_rng(4)
    found = [cut_dot(pitch_px, rng) for _ in range(24)]
    errors = np.array([one for one, _ in found])
    chi_square = np.mean([error @ np.linalg.solve(covariance, error) / 2 for error, covariance in found])
    assert np.abs(errors.mean(axis=0)).max() < 0.03
    # The mean of 48 squares is right to 0.2; light of neighbours that reaches into its pixels counts as noise.
    assert 0.6 < chi_square < 1.6


def test_a_cut_dot_whose_steps_do_not_end_has_no_place(monkeypatch: pytest.MonkeyPatch) -> None:
    """Starts are 0.3 px off: one step leaves some hundredths, which counted as no error at all."""
    dots, rim = strip_of_dots(5, 5)
    start = Ellipse(dots.centers_px[2] + 0.3, RADIUS_PX**2 * np.eye(2))
    found = fit_cut_dot(rim, start, 100.0, dots)
    assert found is not None
    assert np.linalg.norm(found.center_px - (dots.centers_px[2] - 0.1)) < 0.05
    monkeypatch.setattr(cut_dots, "_STEPS", 1)
    assert fit_cut_dot(rim, start, 100.0, dots) is None


@pytest.mark.parametrize(("pitch_px", "blur_px"), [(18.0, 1.0), (15.0, 2.0), (12.0, 1.5)])
def test_the_ground_is_known_between_dots_that_blur_brings_together(pitch_px: float, blur_px: float) -> None:
    """A mirror of 144 x 108 px; where no place counted as free of dots the ground was 0, and dots 0.4 px off."""
    camera = Camera(300, 240, 900.0, 900.0, 149.5, 119.5)
    facet = Facet("facet", np.array([[-0.4, -0.3], [0.4, -0.3], [0.4, 0.3], [-0.4, 0.3]]), plane())
    pose = RigidTransform(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 5.0]))
    count, fine = (np.array([144, 108]) // pitch_px).astype(int), 4
    number = np.stack(np.meshgrid(*map(np.arange, count)), axis=-1).reshape(-1, 2)
    places = np.array([149.5, 119.5]) + pitch_px * (number - 0.5 * (count - 1))
    y, x = (np.mgrid[: 240 * fine, : 300 * fine] + 0.5) / fine - 0.5
    light = np.where((np.abs(x - 149.5) < 72) & (np.abs(y - 119.5) < 54), 150.0, 20.0)
    for place in places:
        part = tuple(slice(int(fine * (one - 6)), int(fine * (one + 7))) for one in place[::-1])
        light[part] -= 100.0 * (np.hypot(x[part] - place[0], y[part] - place[1]) < RADIUS_PX)
    blurred = (
        gaussian_filter(light, fine * np.sqrt(blur_px**2 - 1 / 12)).reshape(240, fine, 300, fine).mean(axis=(1, 3))
    )
    photo = np.rint(blurred + np.random.default_rng(0).normal(0, 1, blurred.shape)).astype(np.uint8)
    size = len(places)
    dots = FoundDots(
        places + 0.1,
        np.tile(1e-2 * np.eye(2), (size, 1, 1)),
        number,
        np.full(size, 100.0),
        1.0,
        shapes_px2=np.tile(RADIUS_PX**2 * np.eye(2), (size, 1, 1)),
        blur_px=blur_px,
    )
    width_px = float(np.sqrt(2 * np.pi * blur_px**2 + 1.6**2))
    rim = find_rim(photo, [dots], camera, pose, [facet], width_px, 0.03)
    assert np.abs(rim.ground_dn[60:180, 70:230] - 150).max() < 2.0
    found = with_rim_dots(dots, rim)
    errors = found.centers_px[np.lexsort(found.number.T)] - places[np.lexsort(number.T)]
    near = (np.abs(errors - 0.1).max(axis=1) > 1e-9) & ~found.is_cut[np.lexsort(found.number.T)]
    assert np.count_nonzero(near) >= 18
    assert np.abs(errors[near]).max() < 0.08
