"""The focal length from images of targets in one plane, of cameras that are known."""

from dataclasses import replace

import numpy as np
import pytest

from heliogauge.camera.distortion import BrownDistortion
from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform, looking_at, rotation_from_vector
from observer.targets.list_focal import FocalOfList, focal_of_list, refuse_other_focal

CAMERA = Camera(940, 940, 1750.0, 1750.0, 469.5, 469.5, 0.0, BrownDistortion())
RIMS = np.array([[x, y, 1.21] for x in (-3.06, 3.06) for y in np.linspace(-3.28, 3.28, 6)])


def photos(
    turns_rad: list[float], places: np.ndarray = RIMS, noise_px: float = 0.02
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Photos from 13 m over the rims, the camera turned about y as it flies across."""
    rng = np.random.default_rng(0)
    shown = []
    for turn in turns_rad:
        down = np.diag([1.0, -1.0, -1.0]) @ rotation_from_vector(np.array([0.0, turn, 0.0]))
        pose = RigidTransform(down, np.array([0.1, -0.1, 14.0]))
        shown.append((places, CAMERA.project(pose.apply(places)) + noise_px * rng.standard_normal((len(places), 2))))
    return shown


def test_it_is_that_of_the_camera_whatever_is_stated() -> None:
    stated = Camera(940, 940, 3500.0, 3500.0, 469.5, 469.5, 0.0, BrownDistortion())
    found = focal_of_list(photos([-0.25, -0.15, 0.1, 0.2]), stated)
    assert found is not None
    assert found.focal_px == pytest.approx(1750, rel=0.01)
    assert abs(found.focal_px - 1750) < 5 * found.sigma_px
    with pytest.raises(InputError, match=r"focal_px = 3500 does not fit: .* 0.50 times as much, in 4 photos"):
        refuse_other_focal(found, stated)
    # A few per cent are left to the adjustment, which says them with their sigma.
    refuse_other_focal(found, Camera(940, 940, 1840.0, 1840.0, 469.5, 469.5, 0.0, BrownDistortion()))


def test_exchanged_targets_do_not_change_it() -> None:
    shown = [(places[[1, 0, *range(2, 12)]], pixels) for places, pixels in photos([-0.25, -0.15, 0.1, 0.2])]
    found = focal_of_list(shown, CAMERA)
    assert found is not None
    assert found.focal_px == pytest.approx(1750, rel=0.01)


def test_what_does_not_show_it_gives_none() -> None:
    assert focal_of_list(photos([0.0, 0.0, 0.0, 0.0], noise_px=0.2), CAMERA) is None
    assert focal_of_list(photos([-0.2, 0.2]), CAMERA) is None
    deep = RIMS + np.array([0.0, 0.0, 0.3]) * (np.arange(12) % 2)[:, None]
    assert focal_of_list(photos([-0.25, -0.15, 0.1, 0.2], deep), CAMERA) is None
    refuse_other_focal(None, CAMERA)


def test_rims_that_are_bowed_do_not_refuse_a_right_camera() -> None:
    # As images of a plane these photos say 0.78 of the focal length, with a sigma of 4 %.
    y = np.linspace(-4, 4, 6)
    rims = np.array([[x, one, 1.05 + 0.06 * (1 - (one / 4) ** 2)] for x in (-2.5, 2.5) for one in y])
    camera, rng = Camera(1920, 1080, 2400.0, 2400.0, 959.5, 539.5), np.random.default_rng(1)
    shown = []
    for x in (-1.2, -0.5, 0.5, 1.2):
        pose = looking_at(np.array([x, 0.0, 15.0]), np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
        pixels = camera.project(pose.apply(rims))
        shown.append((rims, pixels + 0.05 * rng.standard_normal(pixels.shape)))
    found = focal_of_list(shown, camera)
    assert found is not None
    assert abs(found.focal_px - 2400) < 3 * found.sigma_px
    refuse_other_focal(found, camera)
    half = replace(camera, focal_x_px=1200.0, focal_y_px=1200.0)
    with pytest.raises(InputError, match="focal_px = 1200 does not fit"):
        refuse_other_focal(focal_of_list(shown, half), half)


def test_a_lens_that_is_not_stated_refuses_nothing() -> None:
    found = FocalOfList(1200.0, 10.0, miss_px=0.7, stated_sigmas=11.0, n_photos=8)
    refuse_other_focal(found, CAMERA)
    with pytest.raises(InputError, match="does not fit"):
        refuse_other_focal(replace(found, miss_px=0.1), CAMERA)


def test_a_lens_that_is_not_stated_does_not_refuse_a_right_camera() -> None:
    # Six targets of one rim a photo: 0.55 of the focal length makes up for the lens to 0.04 px.
    rims = np.array([[x, y, 1.05 + 0.05 * (1 - (y / 4) ** 2)] for x in (-2.5, 2.5) for y in np.linspace(-4, 4, 6)])
    stated, rng = Camera(1920, 1080, 2400.0, 2400.0, 959.5, 539.5), np.random.default_rng(1)
    camera, shown = replace(stated, distortion=BrownDistortion(k1=-0.03)), []
    for x in np.linspace(-1.5, 1.5, 6):
        eye = np.array([x, 0.3 * np.sin(9 * x), 13.0])
        aim = eye + [0.3 * np.cos(5 * x), 0.3 * np.sin(7 * x), -13.0]
        pixels = camera.project(looking_at(eye, aim, np.array([1.0, 0.0, 0.0])).apply(rims))
        seen = ((pixels > 0) & (pixels < [1920, 1080])).all(axis=1)
        shown.append((rims[seen], pixels[seen] + 0.05 * rng.standard_normal((np.count_nonzero(seen), 2))))
    found = focal_of_list(shown, stated)
    assert found is not None
    assert found.stated_sigmas < 5
    refuse_other_focal(found, stated)
