"""Rendered fringes: orientation, geometry, contrast and edges against closed forms and brute force."""

from dataclasses import replace
from math import pi

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from data_synth.fringes.faults import Fault
from data_synth.fringes.presets import facet_scene, plane_scene, preset_scene, rectangle, small_scene
from data_synth.fringes.scene import FringeScene, Lighting, expected_light, render_fringes, trace_truth
from data_synth.optics.mirror import Design, SyntheticFacet
from data_synth.optics.pinhole import PinholeCamera
from data_synth.optics.surface_errors import Polynomial, SurfaceErrors
from deflectometry.setup import Axis, make_pattern
from heliogauge.errors import InputError

CAMERA = PinholeCamera(101, 77, 343.0, 343.0, 50.0, 38.0)
#: Light that makes the bright frame the coverage of each pixel by the mirror.
BARE = Lighting(black=0.0, falloff=0.0, ambient=0.0, indirect=0.0, reflectivity=1.0, soiling=0.0)


def _plane(tilt_x: float = 0.0, tilt_y: float = 0.0, **changes) -> FringeScene:
    errors = SurfaceErrors((Polynomial([(1, 0, tilt_x), (0, 1, tilt_y)]),))
    facet = SyntheticFacet("flat", rectangle(1.2, 1.2), Design("plane"), errors)
    pattern = make_pattern([0.9, 7.9], [0.9, 5.9])
    return replace(facet_scene("flat", (facet,), camera=CAMERA), pattern=pattern, **changes)


def _phase(light: np.ndarray, frames: slice) -> np.ndarray:
    """Phase of four steps of 90 deg, by the textbook formula."""
    i0, i1, i2, i3 = light[frames].astype(float)
    return np.arctan2(i1 - i3, i0 - i2)


def _interior(truth) -> np.ndarray:
    inside = truth.facet_index >= 0
    for _ in range(4):
        inside[1:-1, 1:-1] &= inside[:-2, 1:-1] & inside[2:, 1:-1] & inside[1:-1, :-2] & inside[1:-1, 2:]
    return inside


def test_a_plane_mirror_shows_the_screen_of_the_mirrored_camera():
    scene = _plane()
    _, truth = expected_light(scene, np.random.default_rng(0))
    inside = truth.facet_index >= 0
    rows, columns = np.nonzero(inside)
    # Mirror the camera in the plane, then intersect the straight line with the flat wall: no reflection law involved.
    mirror, wall = scene.bench.cam_from_mirror, scene.bench.cam_from_wall
    normal, point = mirror.rotation[:, 2], mirror.translation_m
    rays = np.column_stack([(columns - 50.0) / 343, (rows - 38.0) / 343, np.ones(rows.size)])
    image_of_camera = 2 * (point @ normal) * normal
    mirrored = rays - 2 * (rays @ normal)[:, None] * normal
    wall_normal = wall.rotation[:, 2]
    path = ((wall.translation_m - image_of_camera) @ wall_normal) / (mirrored @ wall_normal)
    seen = wall.inverse().apply(image_of_camera + path[:, None] * mirrored)
    assert_allclose(truth.u[inside], seen[:, 0] / 8.727 + 0.5, atol=1e-13)
    assert_allclose(truth.v[inside], 0.5 - seen[:, 1] / 3.476, atol=1e-13)


def test_orientation_of_the_display_in_the_mirror():
    _, truth = expected_light(_plane(), np.random.default_rng(0))
    # A mirror swaps left and right for one who looks from the screen; the top of the screen is seen at the top.
    assert truth.u[38, 40] > truth.u[38, 60]
    assert truth.v[30, 50] < truth.v[46, 50]
    # The facet's x runs to the right in the image, its y upwards.
    assert truth.x_m[38, 60] > truth.x_m[38, 40]
    assert truth.y_m[30, 50] > truth.y_m[46, 50]


@pytest.mark.parametrize(("tilt_x", "tilt_y"), [(1e-3, 0.0), (0.0, 1e-3)])
def test_a_tilt_moves_the_seen_point_by_twice_the_angle(tilt_x, tilt_y):
    straight = expected_light(_plane(), np.random.default_rng(0))[1]
    scene = _plane()
    facet = replace(scene.facets[0], errors=SurfaceErrors((Polynomial([(1, 0, tilt_x), (0, 1, tilt_y)]),)))
    tilted = expected_light(replace(scene, facets=(facet,)), np.random.default_rng(0))[1]
    distance = np.linalg.norm(scene.bench.cam_from_wall.translation_m - scene.bench.cam_from_mirror.translation_m)
    shift_x = (tilted.u - straight.u)[38, 50] * 8.727
    shift_y = (tilted.v - straight.v)[38, 50] * 3.476
    # The surface rises to the facet's +x: the beam goes to its -x, which is the camera's -x and the screen's +u.
    # Oblique incidence (13 deg) and the wall's angle change the lever by a few per cent and mix the axes a little.
    wanted = 2 * distance * np.array([tilt_x, tilt_y])
    assert_allclose([shift_x, shift_y], wanted, atol=0.08 * 2e-3 * distance)


@pytest.mark.parametrize("name", ["small", "off-axis", "trough-panel", "curved-screen"])
def test_phase_of_noiseless_images_is_the_truth(name):
    scene = preset_scene(name)
    # Light from the room changes with the display's mean where the periods are not whole: 1e-3 rad at 0.9 periods.
    scene = replace(scene, lighting=replace(scene.lighting, indirect=0.0))
    light, truth = expected_light(scene, np.random.default_rng(0))
    inside = _interior(truth)
    assert inside.sum() > 3000
    for axis, display in ((Axis.X, truth.u), (Axis.Y, truth.v)):
        for fringes, frames in scene.pattern.sets_of(axis):
            miss = _phase(light, frames) - 2 * pi * fringes.periods * display
            miss = np.angle(np.exp(1j * miss))[inside]
            # The pixel's area averages a curved phase: up to 0.02 rad of 2 pi 63.9 in the turned-down edge, 5e-5 of u.
            assert np.sqrt(np.mean(miss**2)) < 3e-3, (axis, fringes.periods)
            assert np.abs(miss).max() < 0.03


@pytest.mark.slow
def test_a_pixel_is_the_mean_over_its_area_and_blur():
    scene = small_scene()
    scene = replace(scene, lighting=replace(BARE, soiling=0.05, falloff=0.3, reflectivity=0.9), blur_sigma_px=0.5)
    light, _ = expected_light(scene, np.random.default_rng(0))
    rng = np.random.default_rng(1)
    row, column, n = 70, 95, 200_000
    x = column + rng.uniform(-0.5, 0.5, n) + 0.5 * rng.standard_normal(n)
    y = row + rng.uniform(-0.5, 0.5, n) + 0.5 * rng.standard_normal(n)
    seen = scene.bench.trace(scene.facets[0], x, y)
    size = 1.2
    stain = np.sin((5 * seen.points_m[:, 0] + 3 * seen.points_m[:, 1]) / size)
    stain *= np.cos((4 * seen.points_m[:, 1] - 2 * seen.points_m[:, 0]) / size)
    strength = 0.9 * (1 + 0.05 * stain) * (1 - 0.15 * ((2 * seen.u - 1) ** 2 + (2 * seen.v - 1) ** 2))
    for index, (display, periods, step) in {15: (seen.v, 63.9, 270), 29: (seen.u, 63.9, 90)}.items():
        samples = strength * (0.5 + 0.5 * np.cos(2 * pi * periods * display - np.radians(step)))
        assert light[index, row, column] == pytest.approx(samples.mean(), abs=5 * samples.std() / np.sqrt(n))


def test_coverage_along_an_edge_is_that_of_a_half_plane():
    scene = _plane(lighting=BARE, blur_sigma_px=0.4)
    light, _ = expected_light(scene, np.random.default_rng(3))
    bright = light[-1].astype(float)
    # Without lens distortion the edge of a plane mirror is a straight line through its two corners.
    height = np.zeros((2, 1))
    corners = scene.bench.camera.project(
        scene.bench.cam_from_mirror.apply(np.hstack([rectangle(1.2, 1.2)[1:3], height]))
    )
    middle, along = corners.mean(axis=0), np.diff(corners, axis=0)[0]
    along /= np.linalg.norm(along)
    rows = np.arange(round(middle[1]) - 12, round(middle[1]) + 13)
    # The light that a row loses beyond the edge: its sum over columns ends where the edge is, in the mean of the blur.
    start = 60
    seen_edge = start - 0.5 + bright[rows, start:].sum(axis=1)
    true_edge = middle[0] + (rows - middle[1]) * along[0] / along[1]
    assert_allclose(seen_edge, true_edge, atol=0.02)
    assert abs((seen_edge - true_edge).mean()) < 0.002
    assert_allclose(bright[38, 45:55], 1.0, atol=1e-6)
    assert bright[:5].max() == 0


def test_levels_and_gamma_of_the_display():
    lighting = Lighting(gamma=2.0, level_min=0.2, level_max=0.8, black=0.1)
    assert_allclose(
        lighting.light(np.array([0.0, 1.0], dtype=np.float32)), [0.1 + 0.9 * 0.04, 0.1 + 0.9 * 0.64], rtol=1e-6
    )
    coarse = Lighting(black=0.0, display_bits=8).light(np.array([0.5], dtype=np.float32))
    assert coarse[0] == pytest.approx(128 / 255)


def test_the_general_display_equals_the_linear_one_at_gamma_one():
    scene = _plane()
    linear, _ = expected_light(scene, np.random.default_rng(0))
    almost = replace(scene, lighting=replace(scene.lighting, gamma=1.0 + 1e-12))
    assert not almost.lighting.is_linear
    assert_allclose(expected_light(almost, np.random.default_rng(0))[0], linear, atol=2e-6)


def test_rays_beyond_the_display_see_the_dim_wall():
    scene = _plane()
    small_wall = replace(scene.bench.wall, width_m=1.0)
    scene = replace(scene, bench=replace(scene.bench, wall=small_wall), lighting=BARE)
    light, truth = expected_light(scene, np.random.default_rng(0))
    inside = _interior(truth)
    off, on = inside & ((truth.u < -0.1) | (truth.u > 1.1)), inside & (truth.u > 0.1) & (truth.u < 0.9)
    assert off.sum() > 100
    assert on.sum() > 100
    assert_allclose(light[-1][off], 0, atol=1e-6)
    assert_allclose(light[-1][on], 1, atol=1e-6)


def test_a_mirror_out_of_view_is_refused():
    scene = _plane()
    moved = replace(scene.bench, cam_from_mirror=scene.bench.cam_from_mirror.moved(np.array([0, 0, 0, 5.0, 0, 0])))
    with pytest.raises(InputError, match="not in view"):
        expected_light(replace(scene, bench=moved), np.random.default_rng(0))


def test_a_screen_too_small_is_refused_with_the_size_needed():
    facet = SyntheticFacet("flat", rectangle(1.2, 1.2), Design("plane"))
    with pytest.raises(InputError, match=r"screen of 2 m x 2 m.*needed"):
        facet_scene("flat", (facet,), wall=replace(plane_scene().bench.wall, width_m=2.0, height_m=2.0))


def test_the_truth_needs_no_images():
    scene = _plane()
    _, pixels = expected_light(scene, np.random.default_rng(0))
    assert_array_equal(trace_truth(scene).pixels.u, pixels.u)


def test_the_same_seed_gives_the_same_frames_and_another_seed_does_not():
    scene = _plane()
    first, again, other = (render_fringes(scene, np.random.default_rng(seed)) for seed in (5, 5, 6))
    assert_array_equal(first.frames, again.frames)
    assert_array_equal(first.bright, again.bright)
    assert (first.frames != other.frames).mean() > 0.3


def test_noise_of_the_frames_is_the_stated_one():
    scene = _plane()
    light, _ = expected_light(scene, np.random.default_rng(8))
    frames = render_fringes(scene, np.random.default_rng(8)).frames
    residual = frames - scene.sensor.expected_dn(light[:-2])
    assert residual.mean() == pytest.approx(0, abs=0.01)
    assert residual.var() == pytest.approx(1 + 1 / 12, rel=0.02)


@pytest.mark.parametrize("name", ["small", "off-axis", "off-axis-20", "trough-panel", "sphere", "plane"])
def test_presets_have_slope_errors_and_truth_that_agree(name):
    scene = preset_scene(name)
    truth = trace_truth(scene)
    pixels = truth.pixels
    inside = pixels.facet_index == 0
    assert inside.mean() > 0.12
    x, y = pixels.x_m[inside], pixels.y_m[inside]
    assert_allclose(truth.slopes(x, y), [pixels.slope_x[inside], pixels.slope_y[inside]], atol=1e-16)
    assert_allclose(truth.height(x, y), pixels.height_m[inside], atol=1e-9)
    design = scene.facets[0].design.evaluate(x, y)[1:]
    errors = np.array([pixels.slope_error_x[inside], pixels.slope_error_y[inside]])
    assert_allclose(np.array(truth.slopes(x, y)) - design, errors, atol=1e-15)
    assert 2e-4 < np.sqrt((errors**2).mean()) < 1e-3


def test_a_gamma_fault_bends_the_waves():
    scene = _plane(faults=(Fault.parse("gamma:2.2"),))
    light, truth = expected_light(scene, np.random.default_rng(0))
    inside = _interior(truth)
    bent = light[:4, inside].astype(float)
    # Four steps of a sinusoid: I0 + I2 = I1 + I3.
    assert np.abs(bent[0] + bent[2] - bent[1] - bent[3]).mean() > 0.05
