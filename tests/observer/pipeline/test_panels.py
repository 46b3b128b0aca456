"""Panels' edges in photos with marked targets: from drawn photos to heights of panels, and drawings that do not fit."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from data_synth.troughs import TroughChoice, TroughOptions, read_trough_truth, trough_scene, write_trough_dataset
from heliogauge.doubts import Doubt
from heliogauge.errors import EstimationError
from heliogauge.measurement.load import load
from heliogauge.running.progress import SilentProgress
from observer import Options, Result, run
from observer.corners.list_beside import ListBeside
from observer.pipeline import panels
from observer.pipeline.cameras import Cameras
from observer.pipeline.panels import PlacedPanels, place_panels
from observer.planning.planned_flight import Pass
from observer.slopes.pose_modes import Photos
from tests.observer.simulated_trough import short_trough

HEIGHT_M = 2e-3


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("panels") / "flight"
    scene = trough_scene("small", TroughChoice(5, n_photos=24, is_shaped=True, panel_height_m=HEIGHT_M))
    write_trough_dataset(place, scene, TroughOptions(5))
    return place


def measured(folder: Path, **changes: str) -> Result:
    """Measure with other lines of the collector."""
    text = (folder / "measurement.toml").read_text()
    for key, value in changes.items():
        lines = [f"{key} = {value}" if line.startswith(f"{key} =") else line for line in text.splitlines()]
        text = "\n".join(lines)
    (folder / "measurement.toml").write_text(text)
    return run(load(folder), Options(jobs=1))


@pytest.fixture(scope="module")
def result(folder: Path) -> Result:
    return measured(folder)


def heights(result: Result) -> tuple[np.ndarray, np.ndarray]:
    errors = result.reflector.errors
    return result.reflector.unknowns.panel_heights_m(errors.common, errors.covariance_common)


@pytest.mark.slow
def test_heights_of_panels_are_measured(folder: Path, result: Result) -> None:
    found, sigma = heights(result)
    scene = trough_scene("small", TroughChoice(5, n_photos=24, is_shaped=True, panel_height_m=HEIGHT_M))
    collector = scene.world.mirror.collector
    x, y = np.meshgrid(np.linspace(-2.5, 2.5, 400), collector.rows_m(0.01))
    panel, height = collector.panel_index(x, y), scene.world.mirror.deviation(x, y)[0]
    # With the waves of metres that run across the panels.
    true = np.array([np.mean(height[panel == number]) for number in range(collector.n_panels)])
    middles = [0.5 * (edges[1:] + edges[:-1]) for edges in (collector.panel_edges_x_m, collector.panel_edges_y_m)]
    across, along = (one.ravel() for one in np.meshgrid(*middles))
    # Height and tilt of the whole mirror are those of the frame, which the list of targets knows to a millimetre.
    frame = np.stack([np.ones(true.size), across, along], axis=1)
    beside = np.linalg.svd(np.eye(true.size) - frame @ np.linalg.pinv(frame))[0][:, : true.size - 3].T
    unknowns = result.reflector.unknowns
    own = slice(unknowns.radius + unknowns.units.size, unknowns.radius + unknowns.units.size + true.size)
    joint = unknowns.height_unit_m**2 * result.reflector.errors.covariance_common[own, own]
    error, covariance = beside @ (found - true), beside @ joint @ beside.T
    # Chi-square of five and of eight: by chance beyond once in a thousand times.
    assert float(error @ np.linalg.solve(covariance, error)) < 20.5
    assert float((found - true) @ np.linalg.solve(joint, found - true)) < 26
    # Mounting alone says them to HEIGHT_M each.
    assert np.sqrt(np.trace(covariance) / len(beside)) < 0.5 * HEIGHT_M < np.sqrt(np.mean((beside @ true) ** 2))
    assert np.allclose(sigma, np.sqrt(np.diag(joint)))


@pytest.mark.slow
def test_places_of_cameras_are_moved_with_the_edges(folder: Path, result: Result) -> None:
    truth = read_trough_truth(folder).parameters["photos"]
    bundle = result.network.solved.bundle
    true = np.array([truth[name]["position_m"] for name in bundle.problem.observations.photos])
    photos = result.photos
    assert not np.allclose(photos.eyes_m, [pose.inverse().translation_m for pose in bundle.cam_from_world])
    # What all cameras share, across the trough and in height, is what edges of panels say beside the targets.
    by_step = np.zeros((3, 6 * len(photos.poses)))
    for k, pose in enumerate(photos.poses):
        for i, step in enumerate(1e-6 * np.eye(6)):
            moved = pose.moved(step).inverse().translation_m - pose.inverse().translation_m
            by_step[:, 6 * k + i] = 1e6 * moved / len(photos.poses)
    covariance = (by_step @ photos.covariance @ by_step.T)[np.ix_([0, 2], [0, 2])]
    error = (photos.eyes_m - true).mean(axis=0)[[0, 2]]
    # By chance beyond once in a thousand times.
    assert float(error @ np.linalg.solve(covariance, error)) < 13.8
    assert not [one for one in result.doubts if one.code.startswith("panel_edge")]


def test_a_list_is_put_right_by_poses_to_which_true_places_lie_as_listed_ones_did(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    poses, collector = tuple(Pass(12.0, 2.9, 3).poses()), short_trough()
    cameras = Cameras(None, Photos(poses, np.eye(18)), (), ())
    wrong, left, sigma = np.array([0.01, -0.02, 1e-3]), np.array([1e-3, 0.0, 0.0]), np.array([5e-4, 5e-4, 1e-4])
    listed, drawn = [ListBeside(wrong, sigma), ListBeside(left, sigma)], [Doubt("drawing", "beside"), Doubt("none", "")]
    asked = []

    def placed(_inputs: object, cameras: Cameras, seen: object, **_: object) -> PlacedPanels:
        asked.append(cameras.photos.poses)
        return PlacedPanels(cameras, seen, (drawn[len(asked) - 1],), listed[len(asked) - 1])

    monkeypatch.setattr(panels, "_placed", placed)
    monkeypatch.setattr(
        panels, "_in_poses", lambda _inputs, cameras, seen, photos: (replace(cameras, photos=photos), seen)
    )
    monkeypatch.setattr(panels, "_moved_rad", lambda _inputs, *both: float(both[0].cameras is cameras))
    found = place_panels(
        SimpleNamespace(collector=collector, n_modules=1), cameras, SimpleNamespace(), 1, SilentProgress()
    )

    true = np.random.default_rng(1).uniform(-1, 1, (20, 3)) * [2.5, 1.5, 0.5]
    # Too far in x, too high, and leaning about the height of the rims: z rises with x.
    turned = np.stack([-(true[:, 2] - collector.rim_height_m), np.zeros(20), true[:, 0]], axis=1)
    places = true + [wrong[0], 0, wrong[1]] + wrong[2] * turned
    for pose, moved in zip(poses, asked[1], strict=True):
        # To the square of the lean.
        np.testing.assert_allclose(moved.apply(true), pose.apply(places), atol=5e-6)
    # The result is that of the list as it is; what is said, that of the list put right.
    assert found.cameras is cameras
    assert found.doubts == (drawn[1],)
    np.testing.assert_allclose(found.listed.value, wrong + left)
    assert found.moved_rad == 1.0


def test_a_list_put_right_with_which_too_little_is_seen_ends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The photos are measured with the list as it is, and what is said of the list does not need the other solution."""
    cameras = Cameras(None, Photos(tuple(Pass(12.0, 2.9, 3).poses()), np.eye(18)), (), ())
    one, other = (PlacedPanels(cameras, SimpleNamespace(number=number)) for number in range(2))
    some = np.array([[True, True, False], [False, False, False]])
    slopes = SimpleNamespace(slopes=np.zeros((2, 3, 2)))

    def apart(*seen: np.ndarray | None) -> float:
        def solution(_inputs: object, _photos: object, of: SimpleNamespace, _chosen: object) -> SimpleNamespace:
            if seen[of.number] is None:
                raise EstimationError("too few edges")
            return SimpleNamespace(errors=slopes, measured=seen[of.number])

        monkeypatch.setattr(panels, "_first_solution", solution)
        return panels._moved_rad(SimpleNamespace(), one, other)

    assert np.isnan(apart(some, None))
    assert np.isnan(apart(some, ~some))
    assert apart(some, some) == 0.0
