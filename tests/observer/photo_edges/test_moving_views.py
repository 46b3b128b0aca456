"""A camera that moves while it reads its rows: image point and line of sight are each other's inverse."""

import pickle

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from heliogauge.camera.distortion import BrownDistortion
from heliogauge.camera.model import Camera
from observer.photo_edges.moved_edges import edges_in_poses
from observer.photo_edges.reflection_edges import ReflectionEdges
from observer.photo_edges.views import MovingView, View
from observer.planning.planned_flight import Pass
from observer.slopes.pose_modes import Photos
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import ls2
from observer.trough.expectation import Expectation

CAMERA = Camera(480, 640, 1030.0, 1030.0, 241.0, 318.0, distortion=BrownDistortion(k1=-0.06, k2=0.03))
POSES = Pass(12.0, 2.9, 5).poses()

motions = st.tuples(*[st.floats(-0.3, 0.3)] * 3).map(np.array)
points = st.tuples(st.floats(-2.4, 2.4), st.floats(-1.5, 1.5), st.floats(0.0, 1.5)).map(np.array)


@given(st.integers(0, 4), motions, points)
@settings(max_examples=60, deadline=None)
def test_a_point_lies_on_the_line_of_sight_of_its_image_from_the_place_at_its_row(number, motion, point):
    view = MovingView(CAMERA, POSES[number], motion)
    pixel = view.project(point)
    eye = view.eyes_at(pixel)
    # In the middle row the camera is at its pose, a height of rows later one motion further.
    after = (pixel[1] - (CAMERA.height_px - 1) / 2) / CAMERA.height_px
    np.testing.assert_allclose(eye, view.eye_m + after * motion, atol=1e-12)
    ray = view.cam_from_frame.inverse().rotate(CAMERA.cast_rays(pixel))
    assert np.linalg.norm(np.cross(point - eye, ray)) < 1e-7


@given(st.integers(0, 4), points)
@settings(max_examples=20, deadline=None)
def test_without_motion_it_is_the_camera_at_rest(number, point):
    rest, still = View(CAMERA, POSES[number]), MovingView(CAMERA, POSES[number], np.zeros(3))
    np.testing.assert_allclose(still.project(point), rest.project(point), atol=1e-12)
    np.testing.assert_array_equal(still.eyes_at(rest.project(point)), rest.eyes_at(rest.project(point)))


def test_copies_for_other_processes_move_as_the_original():
    view = MovingView(CAMERA, POSES[1], np.array([0.04, 0.001, -0.002]))
    copy = pickle.loads(pickle.dumps(view))
    point = np.array([1.9, -1.0, 0.6])
    np.testing.assert_array_equal(copy.project(point), view.project(point))
    moved = view.posed(POSES[2])
    np.testing.assert_array_equal(moved.motion_m, view.motion_m)
    camera, pose = moved
    assert camera is CAMERA
    assert pose is POSES[2]


def test_edges_found_with_a_camera_at_rest_go_to_where_the_moving_one_saw_them():
    rng = np.random.default_rng(3)
    collector = ls2()
    expected = Expectation(collector, AbsorberPath.designed(collector), np.linspace(-1.5, 1.5, 301))
    motion = np.array([0.06, 0.01, -0.005])
    moving = [MovingView(CAMERA, pose, motion) for pose in POSES]
    resting = [View(CAMERA, pose) for pose in POSES]
    photo = np.repeat(np.arange(5), 40)
    x, y = rng.uniform(-2.0, 2.0, photo.size), rng.uniform(-1.4, 1.4, photo.size)
    true = np.stack([x, y, x**2 / (4 * collector.focal_length_m)], axis=1)
    pixels = np.concatenate([view.project(true[photo == k]) for k, view in enumerate(moving)])
    # What one would take for the places with all rows at once: some centimetres off at the top and bottom of a photo.
    seen = np.empty_like(true)
    for k, view in enumerate(resting):
        ray = view.cam_from_frame.inverse().rotate(CAMERA.cast_rays(pixels[photo == k]))
        eye, z = view.eye_m, true[photo == k, 2]
        for _ in range(40):
            place = eye + ((z - eye[2]) / ray[:, 2])[:, None] * ray
            z = place[:, 0] ** 2 / (4 * collector.focal_length_m)
        seen[photo == k] = place
    assert np.abs(seen - true).max() > 0.01
    none = np.zeros(photo.size)
    edges = ReflectionEdges(photo, none.astype(np.intp), none, seen, none + 1e-3, none, none, none > 0)
    found = edges_in_poses(edges, resting, moving, expected)
    assert found.points_m.shape == true.shape
    np.testing.assert_allclose(found.points_m, true, atol=1e-6)
    photos = Photos(tuple(POSES), np.eye(30), moving=tuple(moving))
    eyes = photos.eyes_of(found.points_m, found.photo)
    after = (pixels[:, 1] - (CAMERA.height_px - 1) / 2) / CAMERA.height_px
    np.testing.assert_allclose(eyes, photos.eyes_m[photo] + after[:, None] * motion, atol=1e-6)
