"""Poses from panels' corners: errors over sigma of many flights, image points and mounting drawn without the estimator.

Corners of drawn mirrors, projected by the drawing's own camera; no photo is drawn.
"""

from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from data_synth.troughs import TroughChoice, trough_scene
from data_synth.troughs.mirror import corner_points_m
from data_synth.troughs.scene import TroughScene
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.measurement.models import PhotosSection
from observer.corners.lattice import PanelLattice
from observer.pipeline.rolling_shutter import Shutter, adjust_rolling
from photogrammetry.bundle import constraints
from photogrammetry.detection import Detections
from photogrammetry.keys import (
    DatumSection,
    NaturalSection,
    NetworkCameraSection,
    PhotogrammetryMeasurement,
    PhotogrammetryModel,
)
from photogrammetry.pipeline import MeasuredPhotos, OnePhoto, Options, Result, collect_photos, run
from photogrammetry.start_values import StartValues

NOISE_PX, MOUNTING_M, CORNER_M = 0.05, 2e-3, 0.3e-3
SEEDS, PHOTOS = 16, 8
READOUT_S, FLIGHTS = 0.02, 12


def drawn(seed: int) -> TroughScene:
    """Return a mirror with panels off their places, and a flight past it."""
    return trough_scene("ls2", TroughChoice(seed, n_photos=PHOTOS, dictionary="none", mounting_m=MOUNTING_M))


def flight(
    scene: TroughScene, seed: int, mounting_m: float
) -> tuple[Callable[[MeasuredPhotos], Result], MeasuredPhotos]:
    """Return how the network is adjusted whose corners were stated with ``mounting_m``, and the image points of it."""
    rng = np.random.default_rng([seed, 77])
    lattice = PanelLattice(scene.collector, mounting_m, CORNER_M)
    true = corner_points_m(scene.world.mirror)
    # Corners of panels are off besides; four of them meet in a corner inside, two on rims, one at the ends.
    inner = [(0 < i < 4) + (0 < j < 5) for i, j in lattice.corners]
    shifts = CORNER_M * rng.standard_normal((len(lattice.names), 3)) / np.sqrt(2.0 ** np.array(inner))[:, None]
    places = np.array([true[name] for name in lattice.names]) + shifts
    found, poses = [], {}
    camera = scene.camera
    for view in scene.views:
        pixels = view.project(places) + NOISE_PX * rng.standard_normal((len(places), 2))
        inside = ((pixels > 0) & (pixels < (camera.width_px - 1, camera.height_px - 1))).all(axis=1)
        table = Detections(
            view.name,
            lattice.names,
            pixels,
            np.repeat(NOISE_PX**2 * np.eye(2)[None], len(places), axis=0),
            np.full(len(places), np.nan),
            np.zeros(len(places), dtype=np.uint32),
        ).chosen(inside)
        none = table.chosen(np.zeros(0, dtype=np.intp))
        shapes = np.full((len(table), 2, 2), np.nan)
        found.append(OnePhoto(table, shapes, (camera.width_px, camera.height_px), (), none, np.zeros((0, 2, 2))))
        poses[view.name] = view.cam_from_trough.moved(np.r_[2e-3, -1e-3, 1e-3, 0.01, 0.01, -0.02])
    section = NetworkCameraSection(
        width_px=camera.width_px,
        height_px=camera.height_px,
        focal_px=camera.focal_x_px,
        center_x_px=camera.center_x_px,
        center_y_px=camera.center_y_px,
    )
    model = PhotogrammetryModel(
        kind="photogrammetry",
        name="corners",
        camera=(section,),
        images=PhotosSection(photos=tuple(poses)),
        natural=NaturalSection(),
        datum=DatumSection(kind="inner"),
    )
    known = constraints.KnownPlaces(lattice.names, lattice.points_m, lattice.covariance_m2)
    survey = PhotogrammetryMeasurement(Path(), model, (), (known,))
    return partial(_adjusted, survey, StartValues(poses)), collect_photos(found)


def _adjusted(survey: PhotogrammetryMeasurement, start: StartValues, measured: MeasuredPhotos) -> Result:
    return run(survey, Options(jobs=1), measured=measured, start=start)


@cache
def pose_errors(seed: int, mounting_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Return errors and covariance of all poses of one flight whose corners were stated with ``mounting_m``."""
    scene = drawn(seed)
    adjust, measured = flight(scene, seed, mounting_m)
    bundle, steps = adjust(measured).solved.bundle, []
    by_name = {view.name: view.cam_from_trough for view in scene.views}
    for name, pose in zip(bundle.problem.observations.photos, bundle.cam_from_world, strict=True):
        turn = RigidTransform(pose.rotation @ by_name[name].rotation.T, np.zeros(3)).rotation_vector_rad
        steps.append(np.concatenate([turn, pose.translation_m - by_name[name].translation_m]))
    covariance = bundle.covariance.joint((), np.arange(len(steps)))
    return np.concatenate(steps), covariance


def mean_square(mounting_m: float, photos: int) -> float:
    """Return the mean chi-square of the poses of the first photos over their number of coordinates."""
    squares = []
    for seed in range(SEEDS):
        error, covariance = pose_errors(seed, mounting_m)
        error, covariance = error[: 6 * photos], covariance[: 6 * photos, : 6 * photos]
        squares.append(float(error @ np.linalg.solve(covariance, error)) / error.size)
    return float(np.mean(squares))


def spread(photos: int) -> float:
    """Return the standard deviation of that mean where all is right."""
    return float(np.sqrt(2 / (SEEDS * photos * 6)))


@pytest.mark.slow
@pytest.mark.parametrize("photos", [1, PHOTOS])
def test_poses_scatter_as_their_joint_covariance_says(photos: int) -> None:
    """One photo has the frame's error, which all have in common; all together have mostly what image points bring."""
    assert abs(mean_square(MOUNTING_M, photos) - 1) < 3.5 * spread(photos)


@pytest.mark.slow
def test_mounting_that_is_stated_too_small_is_noticed_by_the_test_above() -> None:
    assert mean_square(0.4 * MOUNTING_M, 1) > 1 + 3.5 * spread(1)


def readout_squares(mounting_m: float) -> np.ndarray:
    """Return the squares of readouts' errors over their sigmas, of flights whose corners were stated with it."""
    squares = []
    for seed in range(FLIGHTS):
        scene = drawn(seed).with_rolling_shutter(READOUT_S)
        found = adjust_rolling(*flight(scene, seed, mounting_m), Shutter(speed_m_s=2.0)).motions
        squares.append(((found.readout - READOUT_S) / found.sigma_readout) ** 2)
    return np.array(squares)


def is_honest(squares: np.ndarray) -> bool:
    """Return whether their sum is neither as large nor as small as by chance in one of 250 cases each."""
    low, high = chi2.ppf([0.004, 0.996], squares.size)
    return bool(low < squares.sum() < high)


@pytest.mark.slow
def test_a_readout_that_corners_tell_scatters_as_its_sigma_says() -> None:
    """Where panels are mounted looks like a readout, alike in all photos: of four drawn flights one is 2 sigma off."""
    squares = readout_squares(MOUNTING_M)
    assert is_honest(squares)
    # Twice the sigma is noticed.
    assert not is_honest(squares / 4)


@pytest.mark.slow
def test_mounting_that_is_stated_too_small_makes_the_readouts_sigma_too_small() -> None:
    assert not is_honest(readout_squares(0.3 * MOUNTING_M))
