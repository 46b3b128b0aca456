"""Photos of a trough: edges against closed forms, light against brute force, poses, rolling shutter."""

from dataclasses import replace

import numpy as np
import pytest

from data_synth.optics.pinhole import PinholeCamera
from data_synth.optics.surface_errors import Polynomial, SurfaceErrors
from data_synth.troughs.mirror import PanelErrors, Rays, TroughMirror
from data_synth.troughs.paths import look_at_trough, mast_pass, several_passes, straight_pass, turning_collector
from data_synth.troughs.photo import Photographer
from data_synth.troughs.presets import TroughChoice, ls2_panelled, trough_scene
from data_synth.troughs.receiver import Receiver, TubeAxis
from data_synth.troughs.scene import Optics, RollingShutter, TroughScene, TroughView, world_of
from data_synth.troughs.surroundings import Ground, Sky, Surroundings
from data_synth.troughs.trace import Finish, Tracer, TroughWorld, _reflected
from heliogauge.errors import InputError
from heliogauge.validate import FloatArray
from observer.trough import ls2

FOCAL = 1.49
BARE = replace(ls2(), glass=None)
#: The same light from all over the sky, so that what is dark is a measure of area.
EVEN = Sky(zenith=0.6, horizon=0.6, aureole=0.0)
#: 6 mm a pixel from 15 m, as in the acceptance photos, on a strip across the aperture.
STRIP = PinholeCamera(24, 1000, 2381.0, 2381.0, 11.5, 499.5)


def strip_scene(blur_px: float, x_m: float, world: TroughWorld | None = None) -> TroughScene:
    pose = look_at_trough(np.array([x_m, 0.4, 15.0]), np.array([0.0, 0.3, 0.6]), 0.02)
    around = Surroundings(EVEN)
    seen = world_of(TroughMirror(BARE), surroundings=around, finish=Finish(absorber=0.0)) if world is None else world
    return TroughScene("strip", seen, (TroughView("strip", STRIP, pose),), (), (), Optics(blur_px))


def edges_m(x_camera: float, z_camera: float) -> FloatArray:
    """Solve Phi(X) = -/+ asin(r / d) for a perfect trough: X of both edges of the reflection."""
    x = np.linspace(-2.5, 2.5, 500001)
    z = x * x / (4 * FOCAL)
    phi, half = np.arctan2(x_camera - x, z_camera - z), np.arcsin(0.035 / np.hypot(x, FOCAL - z))
    return np.array([np.interp(0, -(phi + side * half), x) for side in (-1, 1)])


def true_edges_px(view: TroughView) -> FloatArray:
    """Return the row of both edges in each column, shape (2, width)."""
    y = np.linspace(-0.5, 1.2, 200)
    rows = []
    for x in edges_m(view.position_m[0], view.position_m[2]):
        pixels = view.project(np.stack([np.full_like(y, x), y, np.full_like(y, x * x / (4 * FOCAL))], axis=1))
        rows.append(np.interp(np.arange(STRIP.width_px), pixels[:, 0], pixels[:, 1]))
    return np.sort(rows, axis=0)


def seen_edges_px(light: np.ndarray, edges: FloatArray) -> FloatArray:
    """Measure both edges by the dark area between the tube's middle and 20 px outside."""
    background = 0.6 * 0.93
    found = np.empty_like(edges)
    for column in range(edges.shape[1]):
        middle = round(float(edges[:, column].mean()))
        for side, edge in enumerate(edges[:, column]):
            far = round(float(edge)) + (-20, 20)[side]
            low, high = sorted((middle, far))
            dark = np.sum(1 - light[low:high, column].astype(np.float64) / background)
            found[side, column] = (high - 0.5 - dark) if side == 0 else (low - 0.5 + dark)
    return found


@pytest.mark.parametrize(("blur_px", "x_m"), [(0.0, 1.3), (0.6, 1.3), (0.6, -2.1), (0.8, 2.0)])
def test_edges_of_the_reflection_are_where_the_closed_form_has_them(blur_px: float, x_m: float) -> None:
    scene = strip_scene(blur_px, x_m)
    view = scene.views[0]
    light = Photographer(scene).light(view, np.random.default_rng(3))
    true = true_edges_px(view)
    error = seen_edges_px(light, true) - true
    assert np.sqrt(np.mean(error**2)) < 0.02
    assert np.abs(error.mean(axis=1)).max() < 0.006


def test_single_precision_moves_no_edge() -> None:
    # How far rays by way of the mirror pass the absorber's axis; a pixel of 6 mm changes it by some 0.7 mm.
    scene = strip_scene(0.6, 1.3)
    columns, rows = np.meshgrid(np.arange(24.0), np.arange(150.0, 850.0))
    directions = STRIP.rays(columns.ravel(), rows.ravel()) @ scene.views[0].cam_from_trough.rotation
    passed = []
    for dtype in (np.float32, np.float64):
        tracer = Tracer(scene.world, dtype)
        start = np.broadcast_to(scene.views[0].position_m, directions.shape)
        rays = Rays(*np.ascontiguousarray(np.concatenate([start, directions], axis=1).T.astype(dtype)))
        length = tracer.mirror.meet(rays)
        panel = tracer.mirror.panel(rays.x + length * rays.dx, rays.y + length * rays.dy)
        reflected = _reflected(tracer.mirror, rays, length, panel)
        passage = tracer.receiver.approach(reflected)
        impact = np.full(len(directions), np.nan)
        impact[passage.which] = passage.impact
        passed.append(impact)
    error_px = (passed[0] - passed[1]) / 0.7e-3
    assert np.isfinite(error_px).sum() > 1000
    assert np.sqrt(np.nanmean(error_px**2)) < 3e-3
    assert np.nanmax(np.abs(error_px)) < 0.012


@pytest.mark.slow
def test_light_is_the_integral_over_each_pixel() -> None:
    # Everything at once: glass, support, panel gaps, slope errors, ground; against 16 x 16 rays for each pixel.
    design = ls2_panelled()
    rng = np.random.default_rng(0)
    panels = PanelErrors(rng.normal(0, 2e-3, 20), rng.normal(0, 2e-3, 20), np.full(20, FOCAL))
    mirror = TroughMirror(design, errors=SurfaceErrors((Polynomial([(2, 1, 1e-3)]),)), panels=panels)
    camera = PinholeCamera(120, 250, 600.0, 600.0, 59.5, 124.5)
    scene = strip_scene(0.0, 1.3, world_of(mirror, surroundings=Surroundings(Sky(), Ground(contrast=0.2))))
    view = replace(scene.views[0], camera=camera)
    light = Photographer(replace(scene, views=(view,))).light(view, np.random.default_rng(1))
    tracer = Tracer(scene.world)

    def brute(n: int) -> FloatArray:
        step = (np.arange(n) + 0.5) / n - 0.5
        columns = (np.arange(camera.width_px)[:, None] + step).ravel()
        rows = (np.arange(camera.height_px)[:, None] + step).ravel()
        directions = (camera.rays(*np.meshgrid(columns, rows)) @ view.cam_from_trough.rotation).reshape(-1, 3)
        seen = []
        for part in np.array_split(directions.astype(np.float32), len(directions) // 20000 + 1):
            start = np.broadcast_to(view.position_m.astype(np.float32), part.shape)
            seen.append(tracer.look(Rays(*np.ascontiguousarray(np.concatenate([start, part], axis=1).T))).light)
        cells = np.concatenate(seen).astype(np.float64)
        return np.asarray(cells.reshape(camera.height_px, n, camera.width_px, n).mean(axis=(1, 3)))

    true = brute(16)
    error = light - true
    assert abs(error.mean()) < 2e-4
    assert np.sqrt(np.mean(error**2)) < 3e-3
    # Negative control: one ray a pixel is far worse.
    assert np.sqrt(np.mean((brute(1) - true) ** 2)) > 4 * np.sqrt(np.mean(error**2))


@pytest.mark.parametrize("offset", [(0.035, 0.0), (0.0, 0.035), (0.0, -0.035)])
def test_the_window_of_a_displaced_absorber_keeps_its_width(offset: tuple[float, float]) -> None:
    # Owkes 2012, sec. 5.3 (V8): with the absorber 3.5 cm off, the camera 13 m above a mirror point crosses the window
    # in which that point shows it within at most 1.5 cm of the usual length.
    x = np.linspace(-2.4, 2.4, 25)
    receiver = Receiver(BARE, TubeAxis.straight(*offset), has_arms=False)
    widths = []
    for tracer in (
        Tracer(world_of(TroughMirror(BARE), one, finish=Finish(absorber=0.0)), np.float64)
        for one in (receiver, Receiver(BARE))
    ):
        phi = np.linspace(-0.06, 0.06, 12001)
        table = tracer.receiver
        dark = []
        for place in x:
            point = np.array([place, 0.0, place**2 / (4 * FOCAL)])
            # Reflected at the perfect mirror: beta = -2 alpha - Phi, alpha = atan(x / 2 f).
            beta = -2 * np.arctan(place / (2 * FOCAL)) - phi
            start = np.broadcast_to(point[:, None], (3, phi.size))
            passage = table.approach(Rays(*start.copy(), np.sin(beta), np.zeros_like(beta), np.cos(beta)))
            dark.append(np.ptp(phi[passage.which]))
        widths.append(13.0 * np.array(dark))
    assert np.abs(widths[0] - widths[1]).max() < 0.0155
    assert np.abs(widths[0] - widths[1]).max() > 0.005


def test_a_rolling_shutter_shows_each_row_from_its_own_place() -> None:
    scene = strip_scene(0.6, 1.3)
    shutter = RollingShutter(0.02, np.array([6.0, 3.0, -1.0]), np.array([0.3, -0.2, 0.5]))
    view = replace(scene.views[0], shutter=shutter)
    rolled = Photographer(replace(scene, views=(view,))).light(view, np.random.default_rng(3))
    still = Photographer(scene)
    true = true_edges_px(scene.views[0])
    for edge in true.mean(axis=1):
        row = round(float(edge))
        frozen = replace(scene.views[0], cam_from_trough=view.pose_at(row))
        light = still.light(frozen, np.random.default_rng(3))
        window = slice(row - 3, row + 4)
        np.testing.assert_allclose(rolled[window], light[window], atol=0.03)
        assert np.abs(still.light(scene.views[0], np.random.default_rng(3))[window] - light[window]).max() > 0.1


def test_points_of_a_rolling_shutter_are_taken_in_their_own_rows() -> None:
    camera = PinholeCamera(800, 1000, 1000.0, 1000.0, 399.5, 499.5, -0.05)
    shutter = RollingShutter(0.03, np.array([5.0, 0.0, 0.0]))
    view = TroughView("one", camera, look_at_trough(np.array([0.5, 0.0, 10.0]), np.zeros(3)), shutter=shutter)
    points = np.array([[-2.0, 1.0, 0.5], [2.4, -1.0, 1.0]])
    for pixel, point in zip(view.project(points), points, strict=True):
        np.testing.assert_allclose(view.at_row(pixel[1]).project(point), pixel, atol=1e-9)
    np.testing.assert_allclose(view.pose_at(499.5).inverse().translation_m, [0.5, 0.0, 10.0], atol=1e-12)
    moved = view.pose_at(999.5).inverse().translation_m - view.pose_at(-0.5).inverse().translation_m
    np.testing.assert_allclose(moved, [0.15, 0, 0], atol=1e-12)


def test_targets_appear_where_the_truth_says() -> None:
    scene = trough_scene("small", TroughChoice(seed=2, n_photos=2)).with_rolling_shutter(0.02)
    view = scene.views[0]
    photographer = Photographer(scene)
    photo = photographer.take(view, np.random.default_rng(0)).astype(np.float64)
    points = photographer.points(view)
    assert len(points.names) == 12
    for x, y in points.pixels_px:
        column, row = round(x), round(y)
        patch = photo[row - 5 : row + 6, column - 5 : column + 6]
        dark = np.clip((170 - patch) / 150, 0, 1)
        rows, columns = np.mgrid[row - 5 : row + 6, column - 5 : column + 6]
        assert np.sum(columns * dark) / dark.sum() == pytest.approx(x, abs=0.2)
        assert np.sum(rows * dark) / dark.sum() == pytest.approx(y, abs=0.2)


def test_what_the_collector_hides() -> None:
    tracer = Tracer(world_of(TroughMirror(BARE)))
    points = np.array([[0.5, 0.0, 0.9], [3.0, 0.0, 1.0], [0.5, 0.0, -2.0], [0.0, 1.0, -1.0], [0.05, 1.0, 1.0]])
    from_below = tracer.hides(np.array([0.5, 0.0, -5.0]), points)
    np.testing.assert_array_equal(from_below, [True, False, False, False, True])
    # Of the last two one is below the mirror, the other behind the tube.
    from_above = tracer.hides(np.array([-0.05, 1.0, 2.0]), points)
    np.testing.assert_array_equal(from_above, [False, False, True, True, True])


def test_a_target_behind_the_collector_is_not_drawn() -> None:
    scene = trough_scene("small")
    below = look_at_trough(np.array([6.0, 0.1, -1.0]), np.array([0.0, 0.0, 1.0]))
    view = replace(scene.views[0], cam_from_trough=below)
    seen = Photographer(scene).points(view)
    assert len(seen.names) < 12


def test_a_collector_that_turns_towards_plus_x_sees_a_fixed_camera_move_to_minus_x() -> None:
    camera = PinholeCamera(100, 100, 100.0, 100.0, 49.5, 49.5)
    views = turning_collector(camera, np.array([0.0, 0.0, 20.0]), np.array([-5.0, 0.0, 5.0]), pivot_z_m=0.3)
    places = np.array([view.position_m for view in views])
    np.testing.assert_allclose(np.linalg.norm(places - [0, 0, 0.3], axis=1), 19.7)
    np.testing.assert_allclose(np.degrees(np.arctan2(places[:, 0], places[:, 2] - 0.3)), [5, 0, -5], atol=1e-9)
    # What is up in the world: towards -x of a collector turned by +90 deg.
    np.testing.assert_allclose(Surroundings().turned(90.0).up, [-1, 0, 0], atol=1e-12)


def test_paths_are_flown_where_asked() -> None:
    camera = PinholeCamera(100, 100, 100.0, 100.0, 49.5, 49.5)
    views = several_passes(camera, (-2.5, 2.5), n_photos=7, height_m=12.0)
    np.testing.assert_allclose([view.position_m[1] for view in views], [-2.5] * 4 + [2.5] * 3)
    assert [view.name for view in views] == [f"photo_{k:03d}" for k in range(1, 8)]
    straight = straight_pass(camera, n_photos=3, reach_m=3.0)
    np.testing.assert_allclose([view.position_m[0] for view in straight], [-3, 0, 3], atol=1e-12)
    # The image's x axis is along +y, its y axis towards +x.
    np.testing.assert_allclose(straight[1].cam_from_trough.rotation, [[0, 1, 0], [1, 0, 0], [0, 0, -1]], atol=1e-12)
    mast = mast_pass(camera, np.random.default_rng(0), n_photos=40)
    off = np.array([view.position_m for view in mast]) - [[x, 0, 12] for x in np.linspace(-2.9, 2.9, 40)]
    assert np.std(off[:10]) > 2 * np.std(off[-10:])
    with pytest.raises(InputError, match="along the trough"):
        look_at_trough(np.array([0.0, -9.0, 1.0]), np.array([0.0, 0.0, 1.0]))


def test_ground_lies_below_and_has_the_collectors_shadow() -> None:
    sun_above = Surroundings(Sky(sun_elevation_deg=90.0), Ground(below_m=3.0, contrast=0.0))
    tracer = Tracer(world_of(TroughMirror(BARE), Receiver(BARE), sun_above))
    x = np.linspace(-4, 4, 81).astype(np.float32)
    start = np.stack([x, np.full_like(x, 1.0), np.full_like(x, -1.0)])
    down = np.stack([np.zeros_like(x), np.zeros_like(x), -np.ones_like(x)])
    light, label = tracer.look(Rays(*start, *down))
    np.testing.assert_array_equal(label == 2, np.abs(x) < 2.5)
    np.testing.assert_allclose(light, np.where(np.abs(x) < 2.5, 0.2, 0.5), atol=1e-6)
