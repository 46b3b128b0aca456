"""A collector that turns before a fixed far camera: tables of tilts, poses tied to them, from folder to slopes."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from data_synth.troughs import TroughChoice, TroughOptions, read_trough_truth, trough_scene, write_trough_dataset
from heliogauge.doubts import Doubt
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform, rotation_from_vector
from heliogauge.measurement.load import load
from heliogauge.running.progress import SilentProgress
from observer import Options, Result, run
from observer.keys import ObserverMeasurement, load_observer
from observer.photo_edges.views import View
from observer.pipeline import cameras
from observer.pipeline.cameras import Cameras, adjust_turning
from observer.pipeline.reading.photos import FirstLook
from observer.pipeline.target_list import CheckedList
from observer.pipeline.tilts import Tilts, read_tilts
from observer.slopes.pose_modes import Photos
from observer.turning.far_camera import FarCamera, KnownFarCamera, TiltReadings
from observer.turning.tied_poses import compare_turning, tie_poses
from photogrammetry.detection import Detections
from photogrammetry.keys import PhotogrammetryMeasurement
from photogrammetry.pipeline import OnePhoto
from tests.observer.exif import exif

READING_RAD, FACING, DISTANCE_M = 0.3e-3, 1.57, 150.0
#: What tripod and bearings give way, 1 sigma [m].
PLAY_M = 1e-3
#: What corners know of a far camera's direction, of its place in the image, of its distance, 1 sigma [rad, rad, m].
TURN_RAD, IMAGE_RAD, AWAY_M = 0.4e-3, 2e-6, 0.05
KNOWN = KnownFarCamera(
    FarCamera(FACING + 4e-3, DISTANCE_M + 0.3, 0.0, 0.0, 0.0), np.array([0.03, 0.5, 1.0, 0.1, 0.3, 0.01])
)


def seen(direction_rad: float, place: np.ndarray, play_m: np.ndarray) -> RigidTransform:
    """Return the pose of a camera in that direction of a turning collector, without the estimator's equations.

    place (6,): The camera's unknowns: of these its place along, the axis of rotation and the distance.
    """
    eye = np.array([place[3], place[2], place[4]]) + play_m
    eye += place[1] * np.array([np.sin(direction_rad), 0, np.cos(direction_rad)])
    forward = -eye / np.linalg.norm(eye)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return RigidTransform(rotation, -rotation @ eye)


class Drawn:
    """True poses, poses as corners have them with their covariance, and readings."""

    def __init__(self, seed: int, count: int = 15) -> None:
        rng = np.random.default_rng([seed, 15])
        self.tilt_rad = np.linspace(FACING - 0.04, FACING + 0.04, count)
        place = KNOWN.camera.unknowns + KNOWN.sigma * rng.standard_normal(6)
        self.true = [seen(place[5] * (place[0] - t), place, PLAY_M * rng.standard_normal(3)) for t in self.tilt_rad]
        # All photos share the frame's turn about y and shift along the trough; each has its own besides.
        steps, covariance = [], np.zeros((6 * count, 6 * count))
        common = np.zeros((6 * count, 2))
        own = np.zeros((6 * count, 6 * count))
        for k, pose in enumerate(self.true):
            block = slice(6 * k, 6 * k + 6)
            # A turn w of the frame about its origin moves the pose by R w in rotation alone; t stays.
            common[block, 0] = np.r_[pose.rotation @ [0.0, 1.0, 0.0], np.zeros(3)]
            common[block, 1] = np.r_[np.zeros(3), pose.rotation @ [0.0, 1.0, 0.0]]
            about = np.zeros((6, 6))
            about[:3, :3] = pose.rotation @ np.diag([10 * TURN_RAD, TURN_RAD, TURN_RAD]) ** 2 @ pose.rotation.T
            # A shift across belongs to the pixels, one along the line of sight to the distance.
            about[3:, 3:] = np.diag([IMAGE_RAD * DISTANCE_M, IMAGE_RAD * DISTANCE_M, AWAY_M]) ** 2
            own[block, block] = about
        covariance = own + common @ np.diag([1e-3, 1e-3]) ** 2 @ common.T
        steps = np.linalg.cholesky(covariance + 1e-18 * np.eye(6 * count)) @ rng.standard_normal(6 * count)
        poses = tuple(pose.moved(step) for pose, step in zip(self.true, steps.reshape(-1, 6), strict=True))
        self.photos = Photos(poses, covariance)
        noise = READING_RAD * rng.standard_normal(count)
        self.readings = TiltReadings(self.tilt_rad + noise, np.full(count, READING_RAD))

    def misses(self, photos: Photos) -> np.ndarray:
        """Return steps from the poses found to the true ones, all in a row."""
        found = []
        for true, pose in zip(self.true, photos.poses, strict=True):
            turn = RigidTransform(true.rotation @ pose.rotation.T, np.zeros(3)).rotation_vector_rad
            found.append(np.r_[turn, true.translation_m - pose.translation_m])
        return np.concatenate(found)


def test_tied_poses_scatter_by_their_covariance() -> None:
    ratios, before, after = [], [], []
    for seed in range(24):
        drawn = Drawn(seed)
        turning = compare_turning(drawn.photos, drawn.readings, KNOWN.camera)
        tied = tie_poses(drawn.photos, drawn.readings, KNOWN, turning)
        miss = drawn.misses(tied.photos)
        covariance = tied.photos.covariance + 1e-16 * np.eye(miss.size)
        ratios.append(float(miss @ np.linalg.solve(covariance, miss)) / miss.size)
        turns = [[drawn.misses(one).reshape(-1, 6)[:, 0].std()] for one in (drawn.photos, tied.photos)]
        before.append(turns[0])
        after.append(turns[1])
    # 24 sums of 90 squares: their mean scatters by 3 %.
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.1)
    assert np.mean(after) < 0.9 * np.mean(before)


def test_a_reading_that_contradicts_is_named_and_turning_the_other_way_is_seen() -> None:
    drawn = Drawn(3)
    wrong = drawn.readings.tilt_rad.copy()
    wrong[4] += 8e-3
    turning = compare_turning(drawn.photos, TiltReadings(wrong, drawn.readings.sigma_rad), KNOWN.camera)
    assert np.flatnonzero(~turning.used).tolist() == [4]
    other = TiltReadings(2 * FACING - drawn.readings.tilt_rad, drawn.readings.sigma_rad)
    turning = compare_turning(drawn.photos, other, KNOWN.camera)
    assert turning.scale == pytest.approx(-1.0, abs=0.05)
    assert turning.used.all()


def looked_at(name: str) -> OnePhoto:
    """Return a photo with two corners."""
    covariance, flags = np.tile(np.eye(2), (2, 1, 1)), np.zeros(2, dtype=np.uint32)
    found = Detections(name, ("corner-0-0", "corner-1-0"), np.zeros((2, 2)), covariance, np.full(2, np.nan), flags)
    return OnePhoto(
        found, np.zeros((2, 2, 2)), (100, 100), (), found.chosen(np.zeros(0, dtype=int)), np.zeros((0, 2, 2))
    )


def test_a_photo_whose_reading_contradicts_it_is_left_out_and_the_others_are_adjusted_anew(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drawn, adjusted = Drawn(3), []
    wrong = drawn.readings.tilt_rad.copy()
    wrong[4] += 8e-3
    names = tuple(f"photo_{k:02d}.jpg" for k in range(wrong.size))
    readings = dict(zip(names, zip(wrong.tolist(), drawn.readings.sigma_rad.tolist(), strict=True), strict=True))
    none = (Doubt("drawn", "of the table", {}),)
    tilts = Tilts(readings, KNOWN, np.array([1.0, 0.0, 0.0]), 0.0, none, "tilts.csv", left_handed=False)

    def adjust(listed: CheckedList, *_: object) -> tuple[CheckedList, Cameras]:
        files = listed.survey.photo_files
        assert set(listed.first.poses) == {file.name for file in files}
        number = np.array([names.index(file.name) for file in files])
        adjusted.append(number.tolist())
        steps = (6 * number[:, None] + np.arange(6)).ravel()
        poses = tuple(drawn.photos.poses[k] for k in number)
        photos = Photos(poses, drawn.photos.covariance[np.ix_(steps, steps)])
        return listed, Cameras(None, photos, tuple(View(None, pose) for pose in poses), files)

    monkeypatch.setattr(cameras, "adjust_cameras", adjust)
    looks = tuple(looked_at(name) for name in names)
    first = FirstLook(names, looks, dict(zip(names, drawn.photos.poses, strict=True)), {}, {}, None)
    survey = PhotogrammetryMeasurement(Path(), None, tuple(Path(name) for name in names))
    listed, tied = adjust_turning(CheckedList(survey, first), SimpleNamespace(tilts=tilts), 1, SilentProgress())

    others = [k for k in range(wrong.size) if k != 4]
    assert adjusted == [list(range(wrong.size)), others]
    assert [file.name for file in tied.files] == [names[k] for k in others]
    assert [len(one.detections) for one in listed.first.targets] == [2 * (k != 4) for k in range(wrong.size)]
    [out] = listed.first.targets[4].refused
    doubt = {one.code: one for one in listed.doubts}["photos_contradict_tilts"]
    sigmas = compare_turning(drawn.photos, TiltReadings(wrong, drawn.readings.sigma_rad), KNOWN.camera).over_sigma
    assert out.name == names[4]
    assert out.reason.endswith(f"differ by {abs(sigmas[4]):.0f} sigmas")
    assert doubt.text.endswith(f"by {abs(sigmas[4]):.0f} sigmas: {names[4]}")
    assert doubt.numbers == {"photos_count": 1}
    assert "drawn" in {one.code for one in listed.doubts}
    # Tied to the readings of the others; the reading that is left out pulls none.
    drawn.true.pop(4)
    before, after = (
        drawn.misses(Photos(one, tied.photos.covariance))
        for one in ([drawn.photos.poses[k] for k in others], [view.cam_from_frame for view in tied.views])
    )
    assert after.reshape(-1, 6)[:, 0].std() < 0.9 * before.reshape(-1, 6)[:, 0].std()


def test_the_far_camera_is_where_the_turned_collector_sees_it() -> None:
    camera = FarCamera(1.5, 149.0, 0.7, 0.1, 0.3, 1.02)
    tilt = np.linspace(1.4, 1.6, 5)
    for eye, t in zip(camera.eyes_m(tilt), tilt, strict=True):
        # The collector turned back by its turn against the reading at which it faces the camera.
        turn = rotation_from_vector(np.array([0.0, 1.02 * (1.5 - t), 0.0]))
        np.testing.assert_allclose(eye, [0.1, 0.7, 0.3] + turn @ [0.0, 0.0, 149.0], atol=1e-9)
    steps = 1e-5 * np.eye(6)
    for k, step in enumerate(steps):
        sides = [FarCamera(*(camera.unknowns + sign * step)).eyes_m(tilt) for sign in (1, -1)]
        np.testing.assert_allclose(camera.derivatives(tilt)[..., k], (sides[0] - sides[1]) / 2e-5, atol=1e-5)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return drawn photos of a collector that turns before a far camera."""
    place = tmp_path_factory.mktemp("tilts") / "far"
    scene = trough_scene("far", TroughChoice(2, n_photos=14, is_shaped=True)).scaled(0.7)
    write_trough_dataset(place, scene, TroughOptions(2))
    return place


@pytest.fixture(scope="module")
def measured(folder: Path) -> Result:
    """Return what is found where it is stated that the files are linear, as drawn photos are."""
    toml = folder / "measurement.toml"
    said = toml.read_text()
    try:
        toml.write_text(said.replace("[images]\n", '[images]\nencoding = "linear"\n'))
        return run(load(folder), Options(jobs=1))
    finally:
        toml.write_text(said)


def errors_and_sigmas(folder: Path, result: Result) -> tuple[np.ndarray, np.ndarray]:
    """Return errors of theta_r and their sigmas at all nodes that have both [rad]."""
    truth, found = read_trough_truth(folder), result.slope_map
    columns, rows = (
        np.abs(here[:, None] - there).argmin(axis=1) for here, there in ((found.x_m, truth.x_m), (found.y_m, truth.y_m))
    )
    error = result.angles.theta_r_rad - truth.theta_r_rad[np.ix_(rows, columns)]
    known = found.valid & np.isfinite(error)
    return error[known], (found.sigma_slope()[0] / (1 + found.design_slope_x**2))[known]


@pytest.mark.slow
def test_slopes_from_tilts_are_within_the_published_accuracy(folder: Path, measured: Result) -> None:
    error, sigma = errors_and_sigmas(folder, measured)
    # About 1 mrad is published (STAGE-STE D12.6, 3.5.2.2), for a mirror of some 3 mrad RMS.
    assert np.sqrt(np.mean(error**2)) < 0.5e-3
    assert np.mean((error / sigma) ** 2) < 2
    assert np.abs(error).max() < 3e-3
    # So few photos measure little of the mirror, and say so: edges without the tube's other one are not believed.
    assert error.size > 0.1 * measured.slope_map.valid.size
    assert "mirror_measured_sparsely" in {one.code for one in measured.doubts}


@pytest.mark.slow
def test_far_photos_whose_encoding_stays_open_are_measured_between_both_and_say_so(folder: Path) -> None:
    # Taken for sRGB the slopes of these photos erred by 0.56 mrad RMS and 1.5 sigma, as linear by 0.30 and 0.8.
    result = run(load(folder), Options(jobs=1))
    [doubt] = [one for one in result.doubts if one.code == "encoding_unclear"]
    # Half of what both encodings are apart, a tenth of a pixel of 0.1 mrad.
    assert 2e-6 < doubt.numbers["edges_outward_rad"] < 10e-6
    error, sigma = errors_and_sigmas(folder, result)
    assert np.mean((error / sigma) ** 2) < 1.5
    assert np.sqrt(np.mean(error**2)) < 0.5e-3


@pytest.mark.slow
def test_tables_that_do_not_belong_to_the_photos_are_named(folder: Path, tmp_path: Path) -> None:
    toml, table = folder / "measurement.toml", folder / "tilts.csv"
    said, lines = toml.read_text(), table.read_text().splitlines()
    try:
        toml.write_text(said.replace("[tilts]\n", "[tilts]\nleft_handed = true\n"))
        with pytest.raises(EstimationError, match="turns the other way; set left_handed = false"):
            run(load(folder), Options(jobs=1))
        toml.write_text(said)
        shuffled = [f"photo_{(5 * k) % 14 + 1:03d}.png,{line.split(',')[1]}" for k, line in enumerate(lines[1:])]
        table.write_text("\n".join([lines[0], *shuffled]) + "\n")
        with pytest.raises(EstimationError, match="tilts:"):
            run(load(folder), Options(jobs=1))
    finally:
        toml.write_text(said)
        table.write_text("\n".join(lines) + "\n")


def stated(folder: Path, table: str, keys: str = "", photos: int = 5) -> ObserverMeasurement:
    """Write a folder whose photos are never opened, with a table of tilts."""
    folder.mkdir(exist_ok=True)
    for k in range(photos):
        (folder / f"p{k}.jpg").write_bytes(b"\xff\xd8" + exif(f"2023:01:15 18:{10 * k:02d}:00"))
    (folder / "tilts.csv").write_text(table)
    (folder / "measurement.toml").write_text(
        f"""kind = "observer"
name = "far"
[collector]
aperture_width_m = 5.0
length_m = 7.89
focal_length_m = 1.49
absorber_diameter_mm = 70.0
orientation_deg = 90.0
[images]
photos = "p*.jpg"
[corners]
[tilts]
sigma_mrad = 0.2
distance_m = 150.0
{keys}
"""
    )
    return load_observer(folder)


def by_name(*rows: str) -> str:
    return "\n".join(["image,tilt_deg", *rows]) + "\n"


def test_readings_by_name_and_what_is_wrong_with_them(tmp_path: Path) -> None:
    rows = [f"p{k}.jpg,{88 + k}" for k in range(5)]
    found = read_tilts(stated(tmp_path / "a", by_name(*rows, "p9.jpg,93")))
    assert found is not None
    assert found.of(["p3.jpg"]).tilt_rad == pytest.approx(np.radians(91))
    assert found.camera.camera.facing_rad == pytest.approx(np.radians(90))
    assert [one.code for one in found.doubts] == ["tilts_without_photo"]
    with pytest.raises(InputError, match=r"line 7: p0\.jpg is given twice"):
        read_tilts(stated(tmp_path / "b", by_name(*rows, "p0.jpg,88")))
    with pytest.raises(InputError, match="2 of 5 photos have a reading, 4 are needed"):
        read_tilts(stated(tmp_path / "c", by_name(*rows[:2])))
    with pytest.raises(InputError, match="is not a number; is the decimal sign a point"):
        read_tilts(stated(tmp_path / "d", by_name(*rows[:4], "p4.jpg,9o")))
    with pytest.raises(InputError, match=r"collector\.orientation_deg = 0"):
        folder = tmp_path / "e"
        one = stated(folder, by_name(*rows))
        said = (folder / "measurement.toml").read_text().replace("orientation_deg = 90.0", "")
        (folder / "measurement.toml").write_text(said)
        assert one.model.tilts is not None
        read_tilts(load_observer(folder))


# Times in EXIF are cut off: half a second is added to them.
TIMES = 'time_column = "time"\ncolumn = ["west", "east"]\ntime_offset_s = 0.5\n'


def test_readings_by_time_are_those_of_the_photos(tmp_path: Path) -> None:
    table = (
        "time,west,east\n2023-01-15 18:00:00,43.0,43.2\n2023-01-15 18:30:00,40.0,40.2\n2023-01-15 19:00:00,22,22.2\n"
    )
    found = read_tilts(stated(tmp_path / "a", table, TIMES))
    assert found is not None
    rows = found.of([f"p{k}.jpg" for k in range(5)])
    np.testing.assert_allclose(np.degrees(rows.tilt_rad), [43.1, 42.1, 41.1, 40.1, 34.1], atol=1e-9)
    # Between two readings the collector may be anywhere: evenly between 40.1 and 22.1 deg.
    assert rows.sigma_rad[4] == pytest.approx(np.radians(18) / np.sqrt(12), rel=1e-3)
    late = read_tilts(stated(tmp_path / "b", table, TIMES.replace("0.5", "-1799.5")))
    assert late is not None
    assert [one.code for one in late.doubts] == ["photos_outside_tilts"]
    with pytest.raises(InputError, match="no photo was taken between its first and its last reading"):
        read_tilts(stated(tmp_path / "c", table, TIMES.replace("0.5", "7200")))
    with pytest.raises(InputError, match="'noon' is not a time like"):
        read_tilts(stated(tmp_path / "d", table.replace("2023-01-15 18:30:00", "noon"), TIMES))


def test_a_table_of_two_sensors_on_a_real_row_is_read(shared_data: Path, tmp_path: Path) -> None:
    """Tilts of both ends of a row of Nevada Solar One, half-hourly; the column of times has no name."""
    table = (shared_data / "csp" / "trough_tilt" / "example_field_data.csv").read_text()
    found = read_tilts(
        stated(tmp_path / "a", table, 'time_column = ""\ntime_offset_s = 0.5\ncolumn = ["R4_SO_Tilt", "R4_DO_Tilt"]\n')
    )
    assert found is not None
    rows = found.of([f"p{k}.jpg" for k in range(5)])
    # At 18:00 both sensors as the table has them; at 18:40 a third of the way from 18:30 to 19:00.
    first, third, last = (43.03984 + 43.11102) / 2, (42.47918 + 42.61678) / 2, (20.99967 + 21.0913) / 2
    np.testing.assert_allclose(np.degrees(rows.tilt_rad[[0, 3, 4]]), [first, third, (2 * third + last) / 3], atol=1e-4)
    assert np.degrees(rows.sigma_rad[4]) > 5
