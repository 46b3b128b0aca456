"""Velocities from the places of neighbouring photos."""

import numpy as np
import pytest
from pydantic import ValidationError

from heliogauge.errors import InputError
from observer.keys import ObserverModel, RollingShutterSection
from observer.pipeline.rolling_shutter import Shutter, frame_motion_m, read_shutter
from observer.shutter.flight import flight_by_places, flight_by_times
from observer.shutter.readout import Known
from tests.observer.exif import exif


def test_a_straight_path_at_one_speed_is_exact():
    velocity = np.array([1.2, -0.5, 0.1])
    times = np.array([0.0, 0.3, 0.9, 1.0, 2.0])
    places = np.array([-2.0, 0.1, 12.0]) + times[:, None] * velocity
    by_times = flight_by_times(places, times)
    np.testing.assert_allclose(by_times.velocity, np.tile(velocity, (5, 1)), atol=1e-12)
    by_places = flight_by_places(places, 3.0)
    np.testing.assert_allclose(by_places.velocity, np.tile(3.0 * velocity / np.linalg.norm(velocity), (5, 1)))


def test_photos_at_even_times_on_a_bend_have_its_tangent():
    turns = np.linspace(0, 1, 21)
    places = 10 * np.stack([np.cos(turns), np.sin(turns), np.zeros(21)], axis=1)
    found = flight_by_times(places, turns).velocity[1:-1]
    tangent = 10 * np.stack([-np.sin(turns), np.cos(turns), np.zeros(21)], axis=1)[1:-1]
    # A chord is shorter than its arc by a sixth of the square of half of its angle.
    np.testing.assert_allclose(found, tangent, rtol=1e-3, atol=0.01)


def test_where_the_path_turns_back_the_direction_is_less_certain():
    out = np.column_stack([np.arange(6) * 0.3, np.zeros(6), np.full(6, 12.0)])
    back = np.column_stack([np.arange(6)[::-1] * 0.3, np.full(6, 2.0), np.full(6, 12.0)])
    found = flight_by_places(np.concatenate([out, back]))
    steady = found.doubt[[1, 2, 3, 8, 9, 10]]
    assert found.doubt[[5, 6]].min() > 5 * steady.max()
    assert steady == pytest.approx(np.full(6, steady[0]), rel=1e-6)


def test_a_readout_in_milliseconds_needs_a_speed_or_times(tmp_path):
    files = [tmp_path / f"photo_{k}.jpg" for k in range(3)]
    for file in files:
        file.write_bytes(b"\xff\xd8\xff\xd9")
    with pytest.raises(InputError, match="speed_m_s"):
        read_shutter(RollingShutterSection(readout_ms=20.0), files)
    stated = read_shutter(RollingShutterSection(readout_ms=-20.0, speed_m_s=2.0), files)
    assert stated is not None
    assert stated.in_seconds
    assert stated.known == Known(-0.02, 0.001)
    unknown = read_shutter(RollingShutterSection(), files)
    assert unknown is not None
    assert not unknown.in_seconds
    assert read_shutter(None, files) is None


def test_a_readout_of_no_time_is_refused():
    # Its sigma, 5 % of it, would be zero.
    with pytest.raises(ValidationError, match="leave the table out"):
        RollingShutterSection(readout_ms=0.0)


@pytest.mark.parametrize(
    "targets",
    [
        {"targets": {"file": "targets.csv", "diameter_mm": 90.0, "uncoded_file": "uncoded.csv"}},
        {"targets": {"tracked_from": "marks.csv", "diameter_mm": 90.0}},
    ],
)
def test_targets_that_a_photo_alone_does_not_name_are_refused_with_a_shutter(targets):
    """Their photos are measured inside the adjustment: the shutter would be left out without a word."""
    content = {
        "kind": "observer",
        "name": "trough",
        "collector": {
            "aperture_width_m": 5.0,
            "length_m": 7.8,
            "focal_length_m": 1.49,
            "absorber_diameter_mm": 70.0,
        },
        "images": {"photos": "*.jpg"},
        "rolling_shutter": {},
        **targets,
    }
    with pytest.raises(ValidationError, match=r"rolling_shutter.*targets"):
        ObserverModel.model_validate(content)
    coded = {"targets": {"dictionary": "aicon-12", "diameter_mm": 90.0}}
    assert ObserverModel.model_validate(content | coded).rolling_shutter is not None
    del content["targets"]
    by_corners = {"corners": {"azimuth_deg": 8.0}, "positions": {"file": "positions.csv"}}
    assert ObserverModel.model_validate(content | by_corners).rolling_shutter is not None
    with pytest.raises(ValidationError, match="stands still"):
        ObserverModel.model_validate(
            content | {"corners": {}, "tilts": {"file": "a.csv", "distance_m": 149.0, "sigma_mrad": 0.2}}
        )


def test_times_of_the_photos_give_the_speed():
    places = np.column_stack([[0.0, 0.5, 1.5], np.zeros(3), np.full(3, 12.0)])
    shutter = Shutter(times_s={"a": 10.0, "b": 10.25, "c": 10.75})
    assert shutter.in_seconds
    np.testing.assert_allclose(shutter.flight(("a", "b", "c"), places).velocity, np.tile([2.0, 0, 0], (3, 1)))


def test_how_far_a_camera_flies_over_a_frame_follows_from_places_and_times(tmp_path):
    """Eight photos 0.9 m apart: 6.3 m in 9 s by whole seconds, or at most as fast as a drone can take them."""
    files = [tmp_path / f"p{k}.jpg" for k in range(8)]
    places = {file.name: np.array([0.9 * k, 100.0, 15.0]) for k, file in enumerate(files)}
    section = RollingShutterSection(readout_ms=-20.0)
    for file in files:
        file.write_bytes(b"\xff\xd8\xff\xd9")
    assert frame_motion_m(section, files, places) == pytest.approx(0.02 * 0.9 / 0.7)
    for k, file in enumerate(files):
        file.write_bytes(b"\xff\xd8" + exif(f"2023:01:15 18:10:{10 + 9 * k // 7:02d}"))
    assert frame_motion_m(section, files, places) == pytest.approx(0.02 * 6.3 / 9)
    # Without one of the places the way is no shorter; what is stated counts.
    del places["p3.jpg"]
    assert frame_motion_m(section, files, places) == pytest.approx(0.02 * 6.3 / 9)
    assert frame_motion_m(RollingShutterSection(readout_ms=20.0, speed_m_s=3.0), files, {}) == pytest.approx(0.06)
    # 17 to 74 ms.
    assert 0.017 < frame_motion_m(RollingShutterSection(speed_m_s=1.0), files, {}) < 0.074


@pytest.mark.parametrize(("between_s", "pause_s"), [(0.4, 3), (1.0, 3), (1.3, 1200), (2.5, 7)])
def test_a_pause_in_the_flight_makes_the_camera_no_slower(tmp_path, between_s, pause_s):
    """Sixteen photos at 2 m/s with a pause after the eighth; their times are cut off to whole seconds."""
    files = [tmp_path / f"p{k:02d}.jpg" for k in range(16)]
    for paused in (0, pause_s):
        for k, file in enumerate(files):
            minutes, seconds = divmod(int(between_s * k) + paused * (k > 7), 60)
            file.write_bytes(b"\xff\xd8" + exif(f"2023:01:15 18:{10 + minutes}:{seconds:02d}"))
        places = {file.name: np.array([2.0 * between_s * k, 100.0, 15.0]) for k, file in enumerate(files)}
        motion_m = frame_motion_m(RollingShutterSection(readout_ms=20.0), files, places)
        # The first and the last time of each pass are up to a second off.
        assert motion_m == pytest.approx(0.02 * 2.0, rel=2 / (14 * between_s))
