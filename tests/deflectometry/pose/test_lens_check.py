"""Lens and aspect against the outline: the truth is not accused, what is wrong is named with its size."""

import importlib.util
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deflectometry.pose.adjust_pose import pose_from_outline
from deflectometry.pose.pose_observations import DistanceObservation, Knowledge
from heliogauge.camera.distortion import BrownDistortion, DistortionDirection
from heliogauge.camera.model import Camera
from heliogauge.doubts import Doubt
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet, paraboloid

_SPEC = importlib.util.spec_from_file_location("drawing", Path(__file__).parents[1] / "drawing.py")
assert _SPEC is not None
assert _SPEC.loader is not None
_DRAWING = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(_DRAWING)
draw_mirror: Any = _DRAWING.draw_mirror

CAMERA = Camera(203, 154, 690.0, 685.0, 101.0, 77.0, distortion=BrownDistortion(k1=-0.14))
FACET = Facet("facet", 0.6 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]), paraboloid(100.0))
SCREEN_M = np.array([4.0, 0.1, 0.3])


def scene(seed: int) -> tuple[np.ndarray, RigidTransform]:
    rng = np.random.default_rng(seed)
    front = RigidTransform.from_rotation_vector([np.pi, 0, 0], [0.1, 0.0, 9.7])
    pose = front.moved(np.concatenate([rng.normal(0, 0.1, 3), rng.normal(0, 0.1, 3)]))
    image = draw_mirror(CAMERA, pose, [FACET], blur_px=0.5)
    return image + rng.normal(0, 1.0, image.shape), pose


def doubts(seed: int, camera: Camera, distance_off_m: float | None = None) -> dict[str, Doubt]:
    image, pose = scene(seed)
    point = np.array([0.1, 0.0, 0.0])
    known = Knowledge()
    if distance_off_m is not None:
        distance_m = float(np.linalg.norm(pose.apply(point) - SCREEN_M)) + distance_off_m
        known = Knowledge((DistanceObservation(distance_m, 0.005, point, SCREEN_M),))
    return {one.code: one for one in pose_from_outline(image, camera, [FACET], known).doubts}


def test_the_true_lens_is_not_accused() -> None:
    # Two tests at 0.5 % each: one false alarm in ten scenes happens once in ten.
    accused = [
        seed
        for seed in range(10)
        if {"lens_contradicts_outline", "aspect_contradicts_outline"} & set(doubts(seed, CAMERA))
    ]
    assert len(accused) <= 1


@pytest.mark.parametrize("seed", [0, 1])
def test_distortion_left_out_or_in_the_other_direction_is_named_with_its_size(seed: int) -> None:
    none = doubts(seed, replace(CAMERA, distortion=BrownDistortion()))["lens_contradicts_outline"]
    found, sigma = (float(one) for one in re.findall(r"k1 = (-?[\d.]+) \+- ([\d.]+)", none.text)[0])
    assert abs(found + 0.14) < 3 * sigma
    assert none.numbers["distortion_missing_px"] / none.numbers["sigma_distortion_px"] == pytest.approx(
        found / sigma, rel=0.05
    )
    assert "distortion_direction =" not in none.text
    lens = replace(CAMERA.distortion, direction=DistortionDirection.MEASURED_TO_IDEAL)
    turned = doubts(seed, replace(CAMERA, distortion=lens))["lens_contradicts_outline"]
    assert "distortion_direction = 'ideal_to_measured'" in turned.text


def test_a_camera_whose_sigma_allows_it_is_not_accused() -> None:
    unsure = np.zeros((10, 10))
    unsure[5, 5] = 0.15**2
    assert "lens_contradicts_outline" not in doubts(0, replace(CAMERA, distortion=BrownDistortion(), covariance=unsure))


def test_one_wrong_focal_length_shows_as_aspect() -> None:
    doubt = doubts(0, replace(CAMERA, focal_x_px=690.0 * 1.01), 0.0)["aspect_contradicts_outline"]
    assert doubt.numbers["stretch_share"] == pytest.approx(-0.01, abs=3 * doubt.numbers["sigma_stretch_share"])
    assert "shorter along the image's x" in doubt.text


def test_a_wrong_distance_does_not_accuse_the_lens() -> None:
    assert set(doubts(0, CAMERA, 0.05)) == {"distance_contradicts_image"}
