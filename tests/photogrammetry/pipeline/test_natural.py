"""Photos without targets: tracks, sigmas of several kinds, recovery of rendered and real scenes, bad input."""

import json
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from data_synth.optics.prints import DotPrint
from data_synth.targets.dataset import PhotoOptions, photogrammetry_content, write_target_dataset
from data_synth.targets.presets import PrintChoice, target_scene
from data_synth.targets.scene import Sheet
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform, vector_from_rotation
from heliogauge.measurement.load import parse_measurement
from heliogauge.measurement.writer import dump_toml
from heliogauge.validate import IntArray
from photogrammetry.bundle.adjustment import BundleResult
from photogrammetry.bundle.datum import Datum, similarity_movements
from photogrammetry.bundle.problem import CameraModel
from photogrammetry.bundle.state import BundleState
from photogrammetry.detection import natural
from photogrammetry.detection.feature_tracks import Keypoints, PairMatch, TrackChoice, follow_tracks
from photogrammetry.image_points import ImagePoints
from photogrammetry.keys.load import load_photogrammetry
from photogrammetry.keys.natural import NaturalSection
from photogrammetry.matching.uncertain_rays import Dots
from photogrammetry.networks import solve_network as networks
from photogrammetry.networks.group_sigmas import Weighed, solve_weighed
from photogrammetry.networks.solve_network import Knowledge, NetworkCameras, SolveOptions
from photogrammetry.networks.solve_uncoded import LooseDots
from photogrammetry.pipeline import measure as pipeline
from photogrammetry.pipeline.measure import run
from photogrammetry.pipeline.photos import MeasuredPhotos
from photogrammetry.pipeline.result import Result
from photogrammetry.start_values.network import StartValues
from tests.photogrammetry.bundle_networks import network
from tests.photogrammetry.network_jobs import write_job


def photos_of(counts: list[int]) -> list[Keypoints]:
    rng = np.random.default_rng(0)
    return [Keypoints(f"p{i}", (600, 400), rng.uniform(0, 400, (n, 2)), np.full(n, 2.0)) for i, n in enumerate(counts)]


def pairs(*rows: tuple[int, int]) -> np.ndarray:
    return np.array(rows, dtype=np.intp).reshape(-1, 2)


def test_tracks_are_what_matches_join() -> None:
    photos = photos_of([4, 4, 4])
    # 0-1-2 a track of three; (1, 1, 1) too; keypoint 2 of photo 0 reaches two places of photo 2; 3 is seen twice only.
    matches = [
        PairMatch(0, 1, pairs((0, 0), (1, 1), (2, 2), (3, 3))),
        PairMatch(1, 2, pairs((0, 0), (2, 2))),
        PairMatch(0, 2, pairs((1, 1), (2, 3))),
    ]
    tracks = follow_tracks(photos, matches)
    assert (len(tracks.points.targets), tracks.ambiguous, tracks.short) == (2, 1, 1)
    assert tracks.points.n_rays.tolist() == [3, 3]
    np.testing.assert_array_equal(
        np.sort(tracks.points.pixels_px, axis=0),
        np.sort(np.concatenate([one.pixels_px[:2] for one in photos]), axis=0),
    )
    sigma = np.sqrt(tracks.points.covariance_px2[:, 0, 0])
    np.testing.assert_allclose(sigma, 0.24)
    assert follow_tracks(photos, matches, TrackChoice(min_photos=2)).points.n == 8


def test_few_points_are_the_longest_and_spread() -> None:
    photos = photos_of([60, 60, 60, 60])
    every = np.repeat(np.arange(60)[:, None], 2, axis=1)
    # Twenty points in four photos, forty in three; all of the twenty crowd in one corner of the photos.
    crowded = [
        Keypoints(one.photo, one.size_px, np.where(np.arange(60)[:, None] < 20, 3.0, one.pixels_px), one.scale_px)
        for one in photos
    ]
    matches = [PairMatch(0, 1, every), PairMatch(1, 2, every), PairMatch(2, 3, every[:20])]
    tracks = follow_tracks(crowded, matches, TrackChoice(max_points=30))
    assert len(tracks.points.targets) == 30
    in_corner = int((tracks.points.n_rays == 4).sum())
    assert 1 <= in_corner < 15
    assert np.count_nonzero(tracks.points.n_rays == 3) > 15


def test_no_track_is_said() -> None:
    with pytest.raises(EstimationError, match="no feature was followed through 3 photos \\(1 through fewer"):
        follow_tracks(photos_of([4, 4, 4]), [PairMatch(0, 1, pairs((0, 0)))])


def test_kinds_get_their_own_sigmas() -> None:
    """Targets stated three times too rough and features twice too sure, in one network."""
    rng = np.random.default_rng(3)
    truth, points = network(rng, 10, 60, sigma_px=0.1)
    kinds = (points.target_index >= 30).astype(np.intp)
    stated = np.where(kinds == 0, 0.3, 0.05)[:, None, None] ** 2 * np.eye(2)
    points = replace(points, covariance_px2=stated)
    model = CameraModel("c", ())
    cameras = NetworkCameras(truth.cameras, (model,), dict.fromkeys(points.photos, 0))
    shapes = np.full((points.n, 2, 2), np.nan)
    start = StartValues({name: truth.cam_from_world(i) for i, name in enumerate(points.photos)})
    knowledge = Knowledge((), {}, Datum(), start)
    found = solve_weighed(points, shapes, kinds, cameras, knowledge, SolveOptions(True, 0.05, True))
    sigma = found.factors * found.solved.image_sigma_factor * [0.3, 0.05]
    # 300 to spare in each kind: a sigma is known to 4 %.
    np.testing.assert_allclose(sigma, 0.1, rtol=0.12)


def weighed(truth: BundleState, points: ImagePoints, kinds: IntArray) -> Weighed:
    """A network of one fixed camera, started from the truth."""
    cameras = NetworkCameras(truth.cameras, (CameraModel("c", ()),), dict.fromkeys(points.photos, 0))
    start = StartValues({name: truth.cam_from_world(i) for i, name in enumerate(points.photos)})
    shapes = np.full((points.n, 2, 2), np.nan)
    return solve_weighed(points, shapes, kinds, cameras, Knowledge((), {}, Datum(), start), SolveOptions())


def with_two_rays(points: ImagePoints, first: int) -> ImagePoints:
    """The same without all but two image points of the targets from `first` on."""
    later = [np.flatnonzero(points.target_index == k)[2:] for k in range(first, len(points.targets))]
    return points.subset(np.delete(np.arange(points.n), np.concatenate(later)))


@pytest.mark.parametrize("only_two_rays", [False, True])
def test_kinds_are_weighed_before_anything_is_rejected(monkeypatch: pytest.MonkeyPatch, only_two_rays: bool) -> None:
    """A kind stated three times too sure does not lose good image points that later rounds would bring back."""
    truth, points = network(np.random.default_rng(3), 10, 160 if only_two_rays else 60, sigma_px=0.1)
    if only_two_rays:
        points = with_two_rays(points, 40)
    kinds = (points.target_index >= 40).astype(np.intp)
    stated = np.where(kinds == 0, 0.1, 0.1 / 3)[:, None, None] ** 2 * np.eye(2)
    reject, rejected = networks.adjust_and_reject, []

    def rejecting(*given: Any, **more: Any) -> Any:
        found = reject(*given, **more)
        rejected.append(len(found[1]))
        return found

    monkeypatch.setattr(networks, "adjust_and_reject", rejecting)
    weighed(truth, replace(points, covariance_px2=stated), kinds)
    assert rejected[0] == 0


def test_a_kind_with_little_redundancy_keeps_its_sigma() -> None:
    """Twenty targets of two rays have twenty to spare."""
    truth, points = network(np.random.default_rng(3), 10, 50, sigma_px=0.1)
    points = with_two_rays(points, 30)
    assert weighed(truth, points, (points.target_index >= 30).astype(np.intp)).factors[1] == 1.0


def test_false_image_points_of_a_kind_do_not_raise_its_sigma() -> None:
    """Three of ten of one kind are ten sigmas off."""
    rng = np.random.default_rng(3)
    truth, points = network(rng, 10, 90, sigma_px=0.1)
    kinds = (points.target_index >= 45).astype(np.intp)
    false, angle = (rng.random(points.n) < 0.3) & (kinds == 1), rng.uniform(0, 2 * np.pi, points.n)
    away = false[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    points = replace(points, pixels_px=points.pixels_px + away)
    found = weighed(truth, points, kinds)
    table = found.solved.bundle.problem.observations
    used = {table.label(row) for row in range(table.n)}
    assert sum(points.label(row) in used for row in np.flatnonzero(false)) < 0.1 * false.sum()
    # 350 to spare and a tenth of the false ones still in it: 4 % of noise, and what hides below four sigmas.
    assert found.factors[1] < 1.2


def test_one_kind_is_left_alone() -> None:
    rng = np.random.default_rng(3)
    truth, points = network(rng, 6, 30, sigma_px=0.1)
    cameras = NetworkCameras(truth.cameras, (CameraModel("c", ()),), dict.fromkeys(points.photos, 0))
    start = StartValues({name: truth.cam_from_world(i) for i, name in enumerate(points.photos)})
    knowledge = Knowledge((), {}, Datum(), start)
    shapes, kinds = np.full((points.n, 2, 2), np.nan), np.zeros(points.n, dtype=np.intp)
    found = solve_weighed(points, shapes, kinds, cameras, knowledge, SolveOptions(rescale=False))
    assert found.factors.tolist() == [1.0]
    assert found.points is points


def test_dots_take_what_residuals_say_of_coded_targets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The factor of the first kind is that of the dots, which are measured alike."""
    truth, points = network(np.random.default_rng(0), 6, 20)
    size = {"width_px": truth.cameras[0].width_px, "height_px": truth.cameras[0].height_px}
    job = write_job(tmp_path / "in", points, camera=size)
    dots = Dots([0], [[10.0, 20.0]], 0.01 * np.eye(2)[None], 9.0 * np.eye(2)[None])
    shapes = np.full((points.n, 2, 2), np.nan)
    measured = MeasuredPhotos(points, shapes, None, (), (), True, LooseDots(points.photos, dots))
    seen = []

    class EnoughError(Exception):
        pass

    def matching(given: MeasuredPhotos, *_: object) -> None:
        seen.append(given.loose)
        raise EnoughError

    monkeypatch.setattr(pipeline, "measure_points", lambda *_: measured)
    monkeypatch.setattr(pipeline, "solve_weighed", lambda *_: Weighed(None, points, np.array([5.0, 0.5])))
    monkeypatch.setattr(pipeline, "match_uncoded", matching)
    with pytest.raises(EnoughError):
        run(load_photogrammetry(job))
    np.testing.assert_allclose(seen[0].dots.covariance_px2, [0.25 * np.eye(2)])


def made(folder: Path, *, coded: bool, scale: float = 1.0, n_photos: int = 8) -> Path:
    scene = target_scene("natural", 0, PrintChoice(None, False, False))
    # Two dots without a code in gaps between the tiles.
    places = [RigidTransform(np.eye(3), np.array([side * 0.5, 0.0, 0.05])) for side in (-1, 1)]
    dots = tuple(Sheet(f"dot{k + 1}", DotPrint(0.028), place) for k, place in enumerate(places)) if coded else ()
    scene = replace(scene, sheets=(*scene.sheets, *dots), views=scene.views[:n_photos]).scaled(scale)
    content = photogrammetry_content(scene) | {"natural": {"max_points": 250, "max_features": 1500}}
    if not coded:
        del content["targets"], content["scale_bar"]
    write_target_dataset(folder, scene, content, PhotoOptions(2))
    return folder


def pose_errors(bundle: BundleResult, truth: dict[str, RigidTransform]) -> tuple[float, int]:
    """Chi-square of the poses at the truth, free of the seven movements no photo sees, and its degrees of freedom."""
    own, photos = bundle.state.centers_m, bundle.problem.observations.photos
    true = np.array([truth[name].inverse().translation_m for name in photos])
    far, near = true - true.mean(axis=0), own - own.mean(axis=0)
    left, singular, right = np.linalg.svd(near.T @ far)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    turn, scale = left @ np.diag(signs) @ right, float((singular * signs).sum() / (far**2).sum())
    steps = []
    for place, name in enumerate(photos):
        rotation = truth[name].rotation @ turn.T
        shift = -rotation @ (scale * turn @ far[place] + own.mean(axis=0))
        pose = bundle.cam_from_world[place]
        steps.append(np.concatenate([vector_from_rotation(rotation @ pose.rotation.T), shift - pose.translation_m]))
    errors, joint = np.concatenate(steps), bundle.covariance.joint(photos=np.arange(len(photos)))
    scale_of = np.sqrt(np.diag(joint))
    weight = np.linalg.pinv(joint / scale_of[:, None] / scale_of, rcond=1e-12, hermitian=True)
    movements = similarity_movements(bundle.state).poses.reshape(-1, 7) / scale_of[:, None]
    errors = errors / scale_of
    amounts = np.linalg.solve(movements.T @ weight @ movements, movements.T @ weight @ errors)
    rest = errors - movements @ amounts
    return float(rest @ weight @ rest), errors.size - 7


def true_poses(folder: Path) -> dict[str, RigidTransform]:
    content = json.loads((folder / "truth.json").read_text())["photos"]
    return {
        name: RigidTransform.from_rotation_vector(
            one["cam_from_world"]["rotation_vector_rad"], one["cam_from_world"]["translation_m"]
        )
        for name, one in content.items()
    }


pytest.importorskip("pycolmap", reason="pip install heliogauge[natural]")


def test_origin_is_the_centre_of_the_first_pixel() -> None:
    y, x = np.mgrid[:120, :160]
    centers = [(40.0, 50.0), (100.25, 60.6), (60.0, 90.0)]
    image = 40 + sum(180 * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / 18) for cx, cy in centers)
    found = natural.find_features(np.round(image).astype(np.uint8), "p", 100).keypoints
    for center in centers:
        distance = np.linalg.norm(found.pixels_px - center, axis=1)
        assert distance.min() < 0.06
    # The same photo with 16 bits.
    again = natural.find_features(np.round(image * 257).astype(np.uint16), "p", 100).keypoints
    np.testing.assert_allclose(again.pixels_px, found.pixels_px, atol=0.1)


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, Path]:
    folder = made(tmp_path_factory.mktemp("natural") / "m", coded=True, n_photos=5, scale=0.75)
    return run(load_photogrammetry(folder)), folder


@pytest.mark.slow
def test_features_beside_coded_targets(mixed: tuple[Result, Path]) -> None:
    result, folder = mixed
    bundle = result.solved.bundle
    names = bundle.problem.observations.targets
    assert {"1", "2", "3", "4", "5", "6"} <= set(names)
    assert sum(name.startswith("n") for name in names) > 200
    # Scale from the two bars, to what their sigmas and the image points allow.
    truth = json.loads((folder / "truth.json").read_text())["points_m"]
    place = {name: i for i, name in enumerate(names)}
    for a, b in (("1", "6"), ("3", "4"), ("2", "5")):
        own = np.linalg.norm(bundle.points_m[place[a]] - bundle.points_m[place[b]])
        sigma = np.hypot(*(np.linalg.norm(bundle.sigma_points_m[place[name]]) for name in (a, b)))
        assert abs(own - np.linalg.norm(np.subtract(truth[a], truth[b]))) < 4 * sigma
    # Coded targets are centred several times better than features, and are not dragged along.
    residuals = np.linalg.norm(bundle.residuals_px, axis=1)
    coded = np.array([not names[i].startswith("n") for i in bundle.problem.observations.target_index])
    assert np.median(residuals[coded]) < 0.5 * np.median(residuals[~coded])
    sigma = np.sqrt(bundle.problem.observations.covariance_px2[:, 0, 0])
    assert np.median(sigma[coded]) < 0.5 * np.median(sigma[~coded])
    assert "natural_features_not_independent" in [one.code for one in result.doubts]
    assert any(one.name == "natural features" for one in result.refused)


@pytest.mark.slow
def test_dots_without_a_code_beside_features(mixed: tuple[Result, Path]) -> None:
    """They are matched as without features, with the sigmas of the coded targets, and texture makes none of its own."""
    result, folder = mixed
    bundle = result.solved.bundle
    table = bundle.problem.observations
    dots = [i for i, name in enumerate(table.targets) if name.startswith("u")]
    assert [table.targets[i] for i in dots] == ["u1", "u2"]
    truth = json.loads((folder / "truth.json").read_text())["points_m"]
    own, sigma = np.linalg.norm(np.subtract(*bundle.points_m[dots])), np.linalg.norm(bundle.sigma_points_m[dots])
    assert abs(own - np.linalg.norm(np.subtract(truth["dot1"], truth["dot2"]))) < 4 * sigma
    assert 0.5 < share_of_sigma(result) < 2


def share_of_sigma(result: Result) -> float:
    """Sigma of the image points of dots without a code, in those of coded targets."""
    table = result.solved.bundle.problem.observations
    sigma = np.sqrt(table.covariance_px2[:, 0, 0])
    dots, coded = (
        np.array([name.startswith(first) for name in table.targets])[table.target_index]
        for first in ("u", tuple("0123456789"))
    )
    return float(np.median(sigma[dots]) / np.median(sigma[coded]))


@pytest.mark.slow
def test_poses_are_nearly_as_sure_as_said(mixed: tuple[Result, Path]) -> None:
    """Errors of features go together a little: up to 1.6 times the predicted sigma is what the page says."""
    result, folder = mixed
    square, freedom = pose_errors(result.solved.bundle, true_poses(folder))
    assert 0.3 < square / freedom < 1.6**2


@pytest.mark.slow
def test_no_targets_at_all(tmp_path: Path) -> None:
    folder = made(tmp_path / "m", coded=False)
    result = run(load_photogrammetry(folder))
    bundle = result.solved.bundle
    assert len(bundle.problem.observations.photos) == 8
    square, freedom = pose_errors(bundle, true_poses(folder))
    assert 0.3 < square / freedom < 1.6**2
    assert "scale_missing" in [one.code for one in result.doubts]
    camera = tomllib.loads((folder / "measurement.toml").read_text())["camera"]
    assert camera["width_px"] == 800
    own = bundle.cameras[0]
    np.testing.assert_allclose([own.focal_x_px, own.focal_y_px], [755.0, 754.0], atol=5 * own.sigma_parameters[0])


@pytest.mark.slow
def test_real_photos(shared_data: Path, tmp_path: Path) -> None:
    """Eight of the photos of a dish on gravel: the markers' corners give the scale, the ground the network."""
    source = shared_data / "opencsp" / "scene_reconstruction"
    if not source.is_dir():
        pytest.skip("the photos of markers are not on this machine")
    shutil.copytree(source / "aruco_marker_images", tmp_path / "photos")
    names = sorted(path.name for path in (source / "aruco_marker_images").iterdir())[:8]
    lens = {"k1": -0.05576391, "k2": 0.03966674, "p1": -0.00055473, "p2": 0.00049181}
    content = {
        "kind": "photogrammetry",
        "name": "dish",
        "camera": {"focal_px": 935.57, "center_x_px": 869.7, "center_y_px": 576.1, **lens},
        "images": {"photos": [f"photos/{name}" for name in names]},
        "targets": {"dictionary": "DICT_4X4_1000"},
        "natural": {"max_points": 400, "max_features": 1500},
    }
    (tmp_path / "measurement.toml").write_text(dump_toml(content))
    result = run(load_photogrammetry(tmp_path))
    bundle = result.solved.bundle
    table = bundle.problem.observations
    assert len(table.photos) == 8
    coded = np.array([not table.targets[i].startswith("n") for i in table.target_index])
    rms = np.sqrt((bundle.residuals_px**2).mean(axis=1))
    assert np.count_nonzero(~coded) > 500
    assert np.sqrt((rms[coded] ** 2).mean()) < 0.35
    assert np.sqrt((rms[~coded] ** 2).mean()) < 0.8


def test_template_has_the_keys() -> None:
    text = (Path(__file__).parents[3] / "photogrammetry" / "template.toml").read_text()
    own = text.split("#: [natural]\n")[1].split("\n\n")[0].replace("#: ", "")
    assert NaturalSection(**tomllib.loads(own)) == NaturalSection()


def test_without_pycolmap(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    folder = made(tmp_path / "m", coded=False, scale=0.1, n_photos=2)
    monkeypatch.setattr(natural, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install heliogauge\[natural\]"):
        run(load_photogrammetry(folder))


def test_photos_without_texture(tmp_path: Path) -> None:
    scene = target_scene("natural", 0)
    blank = replace(scene, sheets=(), lengths=(), views=scene.views[:3]).scaled(0.25)
    content = {"kind": "photogrammetry", "name": "blank", "natural": {}}
    write_target_dataset(tmp_path / "m", blank, content, PhotoOptions(2))
    with pytest.raises(EstimationError, match="no feature was followed"):
        run(load_photogrammetry(tmp_path / "m"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.pop("natural"), r"or \[natural\] for photos"),
        (lambda c: c.update(adjustment={"sigmas": "stated"}), "natural features have none"),
        (lambda c: c.update(natural={"min_photos": 1}), "min_photos"),
        (lambda c: (c.pop("images"), c.update(image_points={})), "is for photos"),
    ],
)
def test_mistakes_in_the_file(change, message: str) -> None:
    content = {
        "kind": "photogrammetry",
        "name": "a",
        "natural": {},
        "images": {"photos": "*.png"},
        "camera": {"width_px": 10, "height_px": 10},
    }
    change(content)
    with pytest.raises(InputError, match=message):
        parse_measurement(content, Path("measurement.toml"))
