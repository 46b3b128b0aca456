"""The tube's axis from profiles drawn by another hand, and what glass does to light from data_synth."""

from dataclasses import replace
from math import cos, sin

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d, uniform_filter1d

from data_synth.troughs.mirror import Rays
from data_synth.troughs.receiver import Receiver, ReceiverTable
from heliogauge.camera.model import Camera
from heliogauge.geometry.surfaces import quadric
from observer.photo_edges import tube_profile
from observer.photo_edges.rectify import PixelSamples, pixel_samples
from observer.photo_edges.tube_profile import Sighting, TubeByProfile, find_axis, through_glass
from observer.photo_edges.views import View
from observer.trough import ls2
from photogrammetry.centers import EdgeShape
from tests.observer.drawn_tube import looking

DESIGN = ls2()
PIXEL_M, DISTANCE_M, ROWS = 8e-3, 13.5, 160
#: Profiles are drawn this finely [m].
FINE_M = 0.1e-3
#: As `observer.photo_edges.tube_bearings` has it.
SHARED_PX = 0.02
#: Where photos at the sides of a pass see the tube from.
ANGLE_RAD = 0.2
HEIGHT_M = DISTANCE_M * cos(ANGLE_RAD)
SIGHTING = Sighting(
    -DISTANCE_M * sin(ANGLE_RAD),
    HEIGHT_M,
    DISTANCE_M,
    PIXEL_M,
    (0.0, DESIGN.focal_length_m),
    DESIGN.focal_length_m + HEIGHT_M,
)


def rays_at(beside: np.ndarray) -> Rays:
    """Return rays straight down that pass the focal line at distances."""
    n = beside.size
    return Rays(beside, np.zeros(n), np.full(n, 5.0), np.zeros(n), np.zeros(n), np.full(n, -1.0))


def profile(thrown: tuple[float, float], metal_slope: float) -> tuple[np.ndarray, np.ndarray]:
    """Return brightness across a tube in glass, by the light that data_synth lets pass; thrown back on either side."""
    beside = np.arange(-0.3, 0.3, FINE_M)
    table = ReceiverTable(Receiver(DESIGN), np.float64)
    with np.errstate(all="ignore"):
        passage = table.approach(rays_at(beside))
        inside = table.enter(passage)
    light = np.ones(beside.size)
    light[passage.which] = np.where(np.abs(passage.impact) > 0.0545, 0.8, inside.passed)
    within = (np.abs(beside) > 0.035) & (np.abs(beside) < 0.0545)
    light += within * np.where(beside < 0, *thrown)
    metal = np.abs(beside) < 0.035
    light[metal] = 0.2 + metal_slope * beside[metal] / 0.035
    return beside, light


def drawn(
    rng: np.random.Generator,
    middle_m: np.ndarray,
    *,
    thrown: tuple[float, float] = (0.05, 0.05),
    metal_slope: float = 0.0,
    blur_px: float = 0.5,
    noise: float = 0.02,
) -> PixelSamples:
    """Draw rows of pixels of a tube whose axis is beside where it is expected; two lines each, places of their own."""
    return sampled(rng, middle_m, profile(thrown, metal_slope)[1], blur_px, noise)


def sampled(
    rng: np.random.Generator, middle_m: np.ndarray, light: np.ndarray, blur_px: float, noise: float = 0.02
) -> PixelSamples:
    """Show brightness across a tube, from -0.3 m on in steps of FINE_M, as a lens and pixels do."""
    beside = -0.3 + FINE_M * np.arange(light.size)
    light = uniform_filter1d(gaussian_filter1d(light, blur_px * PIXEL_M / FINE_M), round(PIXEL_M / FINE_M))
    place = PIXEL_M * (np.arange(-14, 15) + rng.uniform(-0.5, 0.5, (middle_m.size, 2, 1)))
    values = np.interp(place - middle_m[:, None, None], beside, light) + noise * rng.normal(size=place.shape)
    angle = ANGLE_RAD + np.arcsin(place / DISTANCE_M)
    x = SIGHTING.eye_x_m + HEIGHT_M * np.tan(angle)
    return PixelSamples((150 * values).astype(np.float32), x.astype(np.float32))


def found(samples: PixelSamples, start_px: float = 0.2, *, edges: EdgeShape | None = None) -> TubeByProfile:
    rows = np.arange(ROWS)
    start = np.full(ROWS, ANGLE_RAD + start_px * PIXEL_M / DISTANCE_M)
    return find_axis(samples, rows, 0.02 * rows, start, SIGHTING._replace(edges=edges), DESIGN)


def told(blur_px: float) -> EdgeShape:
    """Return a blur that targets tell to 0.01 px."""
    return EdgeShape(blur_px, 0.0, 2 * blur_px * 0.01)


def off_px(samples: PixelSamples) -> float:
    return float(np.mean(found(samples).angle_rad - ANGLE_RAD)) * DISTANCE_M / PIXEL_M


@pytest.mark.parametrize("blur_px", [0.35, 0.6, 0.9])
@pytest.mark.parametrize(
    ("thrown", "metal_slope"), [((0.05, 0.05), 0.0), ((0.0, 0.12), 0.0), ((0.12, 0.0), 0.05), ((0.02, 0.02), -0.06)]
)
def test_light_on_the_glass_does_not_move_the_axis(
    thrown: tuple[float, float], metal_slope: float, blur_px: float
) -> None:
    rng = np.random.default_rng(1)
    samples = drawn(rng, np.zeros(ROWS), thrown=thrown, metal_slope=metal_slope, blur_px=blur_px)
    # Within twice the error that all rows of a photo are taken to share; edges would be off by up to 0.1 px.
    assert abs(off_px(samples)) < 2 * SHARED_PX


@pytest.mark.parametrize("wrong_px", [-0.1, 0.0, 0.1])
@pytest.mark.parametrize("blur_px", [0.35, 0.6, 0.9])
@pytest.mark.parametrize(
    ("thrown", "metal_slope"), [((0.05, 0.05), 0.0), ((0.0, 0.12), 0.0), ((0.12, 0.0), 0.05), ((0.02, 0.02), -0.06)]
)
def test_a_blur_that_targets_tell_moves_the_axis_within_its_sigma(
    thrown: tuple[float, float], metal_slope: float, blur_px: float, wrong_px: float
) -> None:
    """A lens that blurs the tube by a tenth of a pixel more or less than the targets; held, it is 0.036 px."""
    samples = drawn(np.random.default_rng(1), np.zeros(ROWS), thrown=thrown, metal_slope=metal_slope, blur_px=blur_px)
    one = found(samples, edges=told(blur_px + wrong_px))
    bias = float(np.mean(one.angle_rad - ANGLE_RAD))
    own = float(np.median(one.sigma_rad)) / np.sqrt(ROWS / tube_profile.ROWS_TOGETHER)
    assert abs(bias) < 2 * np.hypot(own, one.shared_rad)
    assert abs(bias) * DISTANCE_M / PIXEL_M < 2 * SHARED_PX


@pytest.mark.parametrize("mixed", [-0.2, 0.0, 0.2])
def test_a_blur_told_by_targets_is_as_sure_as_they_are_alike_and_the_tube_is_near(mixed: float) -> None:
    one = EdgeShape(0.5, mixed, 0.0)
    # One standard deviation more widens edges by 0.05 px.
    wider = one._replace(blur_px=0.5 + tube_profile._told_sigma_px(one))
    assert wider.width_px - one.width_px == pytest.approx(0.05, abs=0.006)
    scattered = tube_profile._told_sigma_px(one._replace(scatter_px2=0.2))
    assert (0.5 + scattered) ** 2 - 0.25 > 0.2


@pytest.mark.parametrize("blur_px", [0.35, 0.6, 0.9])
@pytest.mark.parametrize(("left", "right"), [(0.0, 0.0), (0.15, 0.15), (0.0, -0.12), (0.1, -0.1)])
def test_what_changes_behind_a_bare_tube_does_not_move_its_axis(left: float, right: float, blur_px: float) -> None:
    """left, right: By what share the background becomes brighter towards +x over 20 mm, on either side."""
    beside = np.arange(-0.3, 0.3, FINE_M)
    light = 1 + np.clip(np.where(beside < 0, left, right) * beside / 0.02, -0.6, 0.6)
    light[np.abs(beside) < 0.035] = 0.1
    samples = sampled(np.random.default_rng(1), np.zeros(ROWS), light, blur_px)
    rows, start = np.arange(ROWS), np.full(ROWS, ANGLE_RAD + 0.2 * PIXEL_M / DISTANCE_M)
    one = find_axis(samples, rows, 0.02 * rows, start, SIGHTING, replace(DESIGN, glass=None))
    # A relative change s per pixel puts the steepest places s (blur^2 + 1/12 + 1.2^2) aside: 0.10 to 0.14 px for 0.15.
    assert abs(float(np.mean(one.angle_rad - ANGLE_RAD))) * DISTANCE_M / PIXEL_M < 2 * SHARED_PX


def test_a_metal_of_one_tone_would_be_put_aside(monkeypatch: pytest.MonkeyPatch) -> None:
    samples = drawn(np.random.default_rng(1), np.zeros(ROWS), thrown=(0.12, 0.0), metal_slope=0.05)
    monkeypatch.setattr(tube_profile, "_METAL_DEGREE", 0)
    assert abs(off_px(samples)) > 0.05


@pytest.mark.parametrize(
    "name",
    [
        "_METAL_SIGMA",
        "_SLOPE_SIGMA",
        "_BEND_SIGMA",
        "_THROWN_MEAN",
        "_THROWN_SIGMA",
        "_WALL_MEAN",
        "_WALL_SIGMA",
        "_DARK_MEAN",
        "_DARK_SIGMA",
        "_SLOPES_RAD",
        "_RING",
        "_GLASS_OFF_M",
        "_RADIUS_SIGMA_M",
        "_BLUR_SIGMA_PX",
        "_NOISE",
    ],
)
@pytest.mark.parametrize("times", [0.5, 2.0])
def test_what_is_assumed_of_brightness_hardly_matters(name: str, times: float, monkeypatch: pytest.MonkeyPatch) -> None:
    samples = drawn(np.random.default_rng(2), np.zeros(ROWS), thrown=(0.12, 0.02), metal_slope=0.04)
    before = off_px(samples)
    monkeypatch.setattr(tube_profile, name, times * getattr(tube_profile, name))
    assert abs(off_px(samples) - before) < 0.015


@pytest.mark.parametrize("noise", [0.02, 0.08])
def test_groups_scatter_as_stated(noise: float) -> None:
    rng = np.random.default_rng(3)
    over = []
    for _ in range(12):
        one = found(drawn(rng, np.zeros(ROWS), noise=noise))
        groups = one.angle_rad[:: tube_profile.ROWS_TOGETHER], one.sigma_rad[:: tube_profile.ROWS_TOGETHER]
        over.append((groups[0] - groups[0].mean()) / groups[1])
    # 120 groups, 12 means: a mean square of 0.9 is right within 13 %.
    assert 0.5 < float(np.mean(np.square(over))) < 1.4


@pytest.mark.parametrize("wrong_px", [-0.1, 0.0, 0.1])
def test_groups_whose_light_differs_scatter_as_stated_with_a_blur_that_targets_tell(wrong_px: float) -> None:
    rng = np.random.default_rng(3)
    own = np.sqrt(tube_profile._OWN_SHARE)
    over = []
    for _ in range(8):
        parts = [
            drawn(
                rng,
                np.zeros(tube_profile.ROWS_TOGETHER),
                thrown=tuple(0.05 + own * tube_profile._REST_SIGMA * rng.normal(size=2)),
                metal_slope=own * tube_profile._METAL_SIGMA * rng.normal(),
            )
            for _ in range(ROWS // tube_profile.ROWS_TOGETHER)
        ]
        values, x_m = (np.concatenate([getattr(part, name) for part in parts]) for name in ("values_dn", "x_m"))
        one = found(PixelSamples(values, x_m), edges=told(0.5 + wrong_px))
        groups = one.angle_rad[:: tube_profile.ROWS_TOGETHER], one.sigma_rad[:: tube_profile.ROWS_TOGETHER]
        over.append((groups[0] - groups[0].mean()) / groups[1])
    assert 0.5 < float(np.mean(np.square(over))) < 1.4


def test_what_is_rounding_has_no_sigma_that_looks_sure() -> None:
    covariance = np.diag([4.0, -1e-3, 0.0, 9.0]) + 0.25
    own, shared = tube_profile._own_and_shared(np.array([0.25, 1.0, 2.0, 1e-12]), covariance)
    np.testing.assert_array_equal(own, [2.0, np.inf, np.inf, np.inf])
    assert shared == pytest.approx(0.5)
    assert tube_profile._own_and_shared(np.ones(2), np.full((2, 2), np.nan))[0].tolist() == [np.inf, np.inf]


@pytest.mark.parametrize(("low_m", "high_m", "factor"), [(0.05, 0.08, 0.2), (0.06, 0.3, 4.0), (0.06, 0.3, 0.3)])
def test_what_disturbs_some_rows_makes_all_less_sure(low_m: float, high_m: float, factor: float) -> None:
    """A cable beside the glass, a bright and a dark cloud: on the right alone, which no part of the model explains."""
    samples = drawn(np.random.default_rng(2), np.zeros(ROWS))
    beside = DISTANCE_M * np.sin(np.arctan2(samples.x_m - SIGHTING.eye_x_m, HEIGHT_M) - ANGLE_RAD)
    rows = np.arange(ROWS) // tube_profile.ROWS_TOGETHER == 4
    there = rows[:, None, None] & (beside > low_m) & (beside < high_m)
    values = np.where(there, factor * samples.values_dn, samples.values_dn)
    before = found(samples)
    after = found(PixelSamples(values.astype(np.float32), samples.x_m))
    off = np.abs(after.angle_rad - ANGLE_RAD)
    # What the model lacks in some rows it may lack in all: others are less sure, too.
    larger = after.sigma_rad / before.sigma_rad
    assert larger[~rows].min() > 0.99
    assert larger[rows].min() > 1.5
    assert (off < 8 * np.hypot(after.sigma_rad, SHARED_PX * PIXEL_M / DISTANCE_M)).all()


def test_rows_with_nothing_beyond_the_glass_have_no_axis_and_spoil_no_others() -> None:
    samples = drawn(np.random.default_rng(2), np.zeros(ROWS))
    beside = DISTANCE_M * np.sin(np.arctan2(samples.x_m - SIGHTING.eye_x_m, HEIGHT_M) - ANGLE_RAD)
    rows = np.arange(ROWS) // tube_profile.ROWS_TOGETHER == 4
    values = np.where(rows[:, None, None] & (np.abs(beside) > 0.055), np.nan, samples.values_dn)
    one = found(PixelSamples(values.astype(np.float32), samples.x_m))
    assert np.isnan(one.angle_rad[rows]).all()
    before = found(samples)
    np.testing.assert_allclose(one.angle_rad[~rows], before.angle_rad[~rows], atol=0.005 * PIXEL_M / DISTANCE_M)
    np.testing.assert_allclose(one.sigma_rad[~rows], before.sigma_rad[~rows], rtol=0.05)


def test_a_tube_that_leans_is_followed() -> None:
    lean = 4e-3 * 0.02 * (np.arange(ROWS) - ROWS / 2)
    samples = drawn(np.random.default_rng(4), lean)
    rng, rows = np.random.default_rng(5), np.arange(ROWS)
    start = ANGLE_RAD + lean / DISTANCE_M + rng.normal(0, 0.15, ROWS) * PIXEL_M / DISTANCE_M
    one = find_axis(samples, rows, 0.02 * rows, start, SIGHTING, DESIGN)
    assert np.abs(one.angle_rad - ANGLE_RAD - lean / DISTANCE_M).max() * DISTANCE_M / PIXEL_M < 0.15
    assert abs(float(np.mean(one.angle_rad - ANGLE_RAD - lean / DISTANCE_M))) * DISTANCE_M / PIXEL_M < 2 * SHARED_PX


def test_the_metal_is_as_thick_as_drawn() -> None:
    one = found(drawn(np.random.default_rng(6), np.zeros(ROWS)))
    assert float(np.mean(one.radius_m)) == pytest.approx(0.035, abs=0.25e-3)


def test_no_tube_is_not_found_far_away() -> None:
    even = drawn(np.random.default_rng(7), np.full(ROWS, 0.5))
    one = found(even)
    outside = ~np.isfinite(one.angle_rad) | (one.sigma_rad > 0.3 * PIXEL_M / DISTANCE_M)
    assert outside.all()


def test_nothing_of_no_rows() -> None:
    none = np.zeros(0)
    samples = drawn(np.random.default_rng(8), np.zeros(4))
    assert find_axis(samples, np.zeros(0, dtype=np.intp), none, none, SIGHTING, DESIGN).angle_rad.size == 0


def test_glass_lets_pass_and_turns_as_rays_do() -> None:
    assert DESIGN.glass is not None
    beside = np.linspace(-0.054, 0.054, 28)
    table = ReceiverTable(Receiver(DESIGN), np.float64)
    inside = table.enter(table.approach(rays_at(beside)))
    light = through_glass(DESIGN.glass, beside)
    past = np.abs(beside) > 0.035
    np.testing.assert_allclose(light.passed[past], inside.passed[past], rtol=1e-9)
    # Straight down, the rays have x to their left.
    np.testing.assert_allclose(np.abs(light.turned_rad[past]), np.abs(inside.turned[past]), atol=1e-9)
    assert light.passed[beside.size // 2] == pytest.approx((1 - (0.47 / 2.47) ** 2) ** 4, abs=1e-3)


def test_light_through_the_focal_line_leaves_the_mirror_along_the_axis() -> None:
    miss = tube_profile._miss_of_reflection(SIGHTING, DESIGN, np.zeros(1), np.zeros(1))
    # Through the focus at 0.2 rad: the mirror is met at x = 2 f tan(0.1).
    assert abs(float(miss[0])) == pytest.approx(2 * DESIGN.focal_length_m * np.tan(0.1), rel=1e-9)
    # Seen from the left, a line that is turned to the left by as much goes straight down and meets the axis again.
    down = tube_profile._miss_of_reflection(SIGHTING, DESIGN, np.array([-0.04]), np.array([-ANGLE_RAD]))
    # 40 mm to the left of the axis, where the mirror sends it back to the focus.
    assert abs(float(down[0])) < 1e-9
    away = tube_profile._miss_of_reflection(SIGHTING, DESIGN, np.array([0.04]), np.array([ANGLE_RAD]))
    assert abs(float(away[0])) > 0.5


@pytest.mark.parametrize("side", [-1, 1])
def test_the_prism_shows_the_reflection_on_the_cameras_side(side: int) -> None:
    # 20 mm and more beside the metal the glass turns lines by 0.1 rad and more, away from the axis.
    seen = Sighting(side * 2.0, 13.5, 13.6, PIXEL_M, (0.0, DESIGN.focal_length_m), DESIGN.focal_length_m + 13.5)
    parts = tube_profile._Parts.of_view(seen, DESIGN, 0.11)
    assert parts.far_m >= 0.11
    place = -parts.far_m + 0.25e-3 * np.arange(parts.table.shape[1])
    own = np.flatnonzero(parts.mean == tube_profile._DARK_MEAN)
    shown = -parts.table[own].sum(axis=0)
    assert shown.max() > 0.5
    assert (np.sign(place[shown > 0.5]) == side).all()
    assert 0.036 < np.abs(place[shown > 0.5]).min() < 0.0545


def test_pixels_are_seen_where_they_are() -> None:
    camera = Camera(200, 160, 900.0, 900.0, 99.5, 79.5)
    view = View(camera, looking(np.array([0.8, 0.1, 9.0]), np.array([0.0, 0.0, 1.5]), roll_rad=0.4))
    columns, rows = np.meshgrid(np.arange(200.0), np.arange(160.0))
    plane = quadric([0, 0, 0, 0, 0, 1.5], name="plane")
    x, y = np.linspace(-0.3, 0.3, 60), np.linspace(-0.4, 0.4, 40)
    found_column, found_row = (
        pixel_samples(image.astype(np.float32), view, plane, x, y, rows_each=2) for image in (columns, rows)
    )
    pixels = np.stack([found_column.values_dn, found_row.values_dn], axis=-1)
    assert np.isfinite(pixels).all()
    # Where a pixel's line of sight meets the plane.
    u, v = ((pixels[..., k].ravel() - middle) / 900 for k, middle in ((0, 99.5), (1, 79.5)))
    rays = np.stack([u, v, np.ones_like(u)], axis=1) @ view.cam_from_frame.rotation
    met = view.eye_m[0] + rays[:, 0] * (1.5 - view.eye_m[2]) / rays[:, 2]
    assert np.abs(found_column.x_m.ravel() - met).max() < 0.02 * 9 / 900
    beyond = pixel_samples(columns.astype(np.float32), view, plane, x + 3.0, y)
    assert np.isnan(beyond.values_dn).all()


def test_changes_of_a_profile_are_its_own_up_to_its_ends() -> None:
    """Of profiles beside each other in memory none sees the next; between its ends a change is that of differences."""
    rng = np.random.default_rng(0)
    profiles = 10.0 ** np.arange(3)[:, None] * rng.normal(size=(3, 40))
    place = np.stack([np.linspace(0.0, 38.9, 60)] * 3)
    together = tube_profile._changes(profiles, 1e-6, place)
    alone = [tube_profile._changes(one[None], 1e-6, place[:1]) for one in profiles]
    for k in (0, 1):
        np.testing.assert_array_equal(together[k], np.concatenate([one[k] for one in alone]))
    inner = (place[0] > 1) & (place[0] < 38)
    for own, found in zip(profiles, together[0], strict=True):
        slope = np.gradient(own, tube_profile._STEP_M)
        np.testing.assert_allclose(found[inner], -np.interp(place[0][inner], np.arange(40), slope), rtol=1e-9)
