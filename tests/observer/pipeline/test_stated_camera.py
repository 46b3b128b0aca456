"""An adjustment that does not settle says what is usually wrong; a wrong focal length is named however well it fits."""

from pathlib import Path

import numpy as np
import pytest

from heliogauge.camera.model import Camera
from heliogauge.doubts import Doubt
from heliogauge.errors import EstimationError, NotConvergedError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.measurement.models import PhotosSection
from heliogauge.validate import FloatArray
from observer.pipeline.reading.photos import FirstLook
from observer.pipeline.stated_camera import explained, stated_camera_doubt
from observer.product.pictures import empty_slices
from observer.trough.collector import ls2
from photogrammetry import pipeline as photogrammetry_pipeline
from photogrammetry.detection import Detections
from photogrammetry.keys import (
    CoordinateSection,
    DatumSection,
    NetworkCameraSection,
    PhotogrammetryMeasurement,
    PhotogrammetryModel,
    TargetsSection,
)
from photogrammetry.pipeline import OnePhoto, collect_photos
from photogrammetry.start_values import StartValues

#: Twelve targets in one plane, beside both rims of a short trough, and 24 photos across it from 12 m.
TARGETS = np.array([[side * 2.7, y, 1.05] for side in (-1, 1) for y in (-1.4, -0.84, -0.28, 0.28, 0.84, 1.4)])
#: Every second one on a stand.
STAGGERED = TARGETS + np.array([[0, 0, 0.35 * (k % 2)] for k in range(12)])
EYES_X = np.linspace(-3.0, 3.0, 24)
TRUE_PX = 1030.0


def first_look(sigma_px: float, rng: np.random.Generator, targets_m: FloatArray) -> FirstLook:
    camera = Camera(480, 640, TRUE_PX, TRUE_PX, 239.5, 319.5)
    # The camera's x is the trough's y; it looks at the middle of the plane of the targets.
    names = tuple(str(k + 1) for k in range(len(TARGETS)))
    targets, poses = [], {}
    for number, x in enumerate(EYES_X):
        tilt = np.arctan2(x, 11.0)
        across = np.array([0.0, 1.0, 0.0]), np.array([np.cos(tilt), 0.0, np.sin(tilt)])
        turn = np.array([*across, np.cross(*across)])
        pose = RigidTransform(turn, -turn @ np.array([x, rng.normal(0, 0.05), 12.0]))
        photo = f"photo_{number:03d}.png"
        pixels = camera.project(pose.apply(targets_m)) + rng.normal(0, sigma_px, (len(TARGETS), 2))
        covariance = np.tile(sigma_px**2 * np.eye(2), (len(TARGETS), 1, 1))
        flags = np.zeros(len(TARGETS), dtype=np.uint32)
        seen = Detections(photo, names, pixels, covariance, np.full(len(TARGETS), 4.0), flags)
        none = seen.chosen(np.zeros(0, dtype=np.intp))
        shapes = np.tile(16.0 * np.eye(2), (len(TARGETS), 1, 1))
        targets.append(OnePhoto(seen, shapes, (480, 640), (), none, np.zeros((0, 2, 2))))
        poses[photo] = pose
    photos = tuple(poses)
    return FirstLook(photos, tuple(targets), poses, {}, {}, empty_slices(ls2(), np.linspace(-1, 1, 4), len(photos)))


def doubt(
    stated_px: float,
    sigma_px: float,
    seed: int,
    *,
    targets: FloatArray = TARGETS,
    listed: FloatArray | None = None,
    aside_px: tuple[float, float] = (0.0, 0.0),
    list_sigma_m: float = 1e-3,
) -> tuple[Doubt | None, float]:
    """The doubt with a stated focal length and principal point, and how well image points fit with it."""
    rng = np.random.default_rng(seed)
    first = first_look(sigma_px, rng, targets)
    listed = (targets if listed is None else listed) + rng.normal(0, list_sigma_m, targets.shape)
    model = PhotogrammetryModel(
        kind="photogrammetry",
        name="coplanar",
        camera=(
            NetworkCameraSection(
                width_px=480,
                height_px=640,
                focal_px=stated_px,
                center_x_px=239.5 + aside_px[0],
                center_y_px=319.5 + aside_px[1],
            ),
        ),
        images=PhotosSection(photos=("photo_*.png",)),
        targets=TargetsSection(dictionary="aicon-12", diameter_mm=90.0),
        constraint=tuple(
            CoordinateSection(
                kind="coordinate", target=str(k + 1), axis=axis, value_m=float(value), sigma_mm=1e3 * list_sigma_m
            )
            for k, point in enumerate(listed)
            for axis, value in zip("xyz", point, strict=True)
        ),
        datum=DatumSection(kind="inner"),
    )
    survey = PhotogrammetryMeasurement(Path(), model, tuple(Path(name) for name in first.photos))
    network = photogrammetry_pipeline.run(
        survey,
        photogrammetry_pipeline.Options(jobs=1),
        measured=collect_photos(first.targets),
        start=StartValues(first.poses),
    )
    return stated_camera_doubt(network, survey, first), network.solved.image_sigma_factor


def test_focal_length_that_targets_in_one_plane_hide_is_named() -> None:
    said, factor = doubt(1.01 * TRUE_PX, 0.06, 1)
    assert factor < 1.3
    assert said is not None
    assert "camera: focal_px = 1040.3 does not fit" in said.text
    assert 'free = ["focal_px"]' in said.text


@pytest.mark.parametrize("seed", [2, 3, 4])
@pytest.mark.parametrize("sigma_px", [0.02, 0.06])
def test_focal_length_that_is_right_is_not_doubted(sigma_px: float, seed: int) -> None:
    assert doubt(TRUE_PX, sigma_px, seed)[0] is None


@pytest.mark.parametrize(("aside_px", "axis"), [((8.0, 0.0), "x"), ((0.0, -8.0), "y")])
def test_a_principal_point_that_is_aside_is_named(aside_px: tuple[float, float], axis: str) -> None:
    said, factor = doubt(TRUE_PX, 0.02, 1, targets=STAGGERED, aside_px=aside_px)
    assert factor < 1.3
    assert said is not None
    assert said.code == "principal_point_contradicts_targets"
    assert said.numbers[f"apart_{axis}_px"] == pytest.approx(-sum(aside_px), abs=3)
    assert f"center_{axis}_px" in said.text.split(";")[0]


@pytest.mark.parametrize(("aside_px", "is_named"), [(0.9, False), (1.8, True)])
def test_a_principal_point_is_named_from_where_it_matters(aside_px: float, is_named: bool) -> None:
    """With a list as good as 0.05 mm a fraction of a pixel is told; 1.2 px are what moves slopes by 0.05 mrad."""
    said, _ = doubt(TRUE_PX, 0.06, 1, targets=STAGGERED, aside_px=(aside_px, 0.0), list_sigma_m=5e-5)
    assert (said is not None and said.code == "principal_point_contradicts_targets") == is_named


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_principal_point_that_is_right_is_not_doubted(seed: int) -> None:
    assert doubt(TRUE_PX, 0.02, seed, targets=STAGGERED)[0] is None
    # A moved target is not taken for it.
    moved = STAGGERED + np.eye(12)[4][:, None] * [0.0, 0.012, 0.0]
    assert doubt(TRUE_PX, 0.02, seed, targets=STAGGERED, listed=moved)[0] is None


def test_an_adjustment_that_does_not_settle_names_the_usual_causes() -> None:
    with pytest.raises(EstimationError, match=r"200 iterations.*rolling shutter.*zoom.*\[camera\] free"), explained():
        raise NotConvergedError("bundle adjustment: not converged after 200 iterations")
    with pytest.raises(EstimationError, match=r"^other$"), explained():
        raise EstimationError("other")
    with (
        pytest.raises(EstimationError, match=r"^no camera is stated; so not"),
        explained(Doubt("a", "no camera is stated")),
    ):
        raise NotConvergedError("not converged")
