"""Sunlight on a slope map: sun shapes, closed-form spots, orientation, intercept, what the result must state."""

from dataclasses import replace

import numpy as np
import pytest

from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rays import reflect
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import facet_on_optic, paraboloid, plane, sphere, trough
from heliogauge.slopes.map import SlopeMap, no_common_modes
from heliogauge.sunlight.beam import (
    Illumination,
    TargetPlane,
    direction_to_sun_for,
    facing_target,
    reflected_rays,
    trace,
)
from heliogauge.sunlight.sun_shapes import BuieSun, GaussianSun, PillboxSun, TabulatedSun

POINT_SUN = PillboxSun(1e-8)


def generator(seed=0):
    return np.random.Generator(np.random.SFC64(seed))


def make_map(design, error=(0.0, 0.0), *, width=1.2, height=0.8, shape=(40, 60)):
    x = (np.arange(shape[1]) + 0.5) / shape[1] * width - width / 2
    y = (np.arange(shape[0]) + 0.5) / shape[0] * height - height / 2
    grid_x, grid_y = np.meshgrid(x, y)
    z, p, q = design.height_and_gradient(grid_x, grid_y)
    zero = np.zeros(grid_x.shape)
    return SlopeMap(
        x_m=x,
        y_m=y,
        slope_x=p + error[0],
        slope_y=q + error[1],
        design_slope_x=p,
        design_slope_y=q,
        sigma_random_x=zero,
        sigma_random_y=zero,
        noise_correlation=1.0,
        common=no_common_modes(),
        height_m=z,
        flags=zero,
        aperture=zero == 0,
        design=design.describe(),
        frame="facet",
        removed="nothing",
    )


def spot(slope_map, light, target, rays=200_000, seed=0):
    return trace(slope_map, slope_map.height_m, light, target=target, rays=rays, rng=generator(seed))


# --- sun shapes

SUNS = {
    "pillbox": PillboxSun(),
    "Gaussian": GaussianSun(2.73e-3),
    "Buie": BuieSun(0.1),
    "Buie without aureole": BuieSun(0.0),
    "table": TabulatedSun([0.0, 2e-3, 4e-3, 5e-3, 9e-3], [5.0, 4.5, 3.0, 0.1, 0.0]),
}
every_sun = pytest.mark.parametrize("sun", SUNS.values(), ids=SUNS.keys())


@every_sun
def test_drawn_angles_follow_radiance_times_solid_angle(sun):
    offsets = sun.sample(generator(), 200_000)
    theta = np.arctan(np.hypot(*offsets.T))
    # an independent integration: 64 Gauss-Legendre points in each of 200 bins of the radiance itself
    edges = np.linspace(0, sun.limit_rad, 201)
    nodes, weights = np.polynomial.legendre.leggauss(64)
    angles = edges[:-1, None] + np.diff(edges)[:, None] * (nodes + 1) / 2
    power = np.diff(edges) / 2 * ((sun.radiance(angles) * np.sin(angles)) @ weights)
    expected = np.append(0, np.cumsum(power)) / power.sum()
    measured = np.searchsorted(np.sort(theta), edges) / theta.size
    assert np.abs(measured - expected).max() < 1.95 / np.sqrt(theta.size)  # Kolmogorov, 0.1 %
    np.testing.assert_allclose(sun.share_within(edges), expected, atol=2e-4)
    # no direction is preferred
    turn = np.exp(1j * np.arctan2(*offsets.T))
    assert abs(turn.mean()) < 4 / np.sqrt(turn.size)
    assert abs((turn**2).mean()) < 4 / np.sqrt(turn.size)


def test_gaussian_sun_has_its_sigma_in_each_direction():
    offsets = GaussianSun(2.73e-3).sample(generator(), 400_000)
    np.testing.assert_allclose(offsets.std(axis=0), 2.73e-3, rtol=5e-3)


def test_buie_disc_edge_and_aureole_are_the_published_equations():
    sun = BuieSun(0.1)
    kappa, gamma = 0.9 * np.log(1.35) * 0.1**-0.3, 2.2 * np.log(0.052) * 0.1**0.43 - 0.1
    np.testing.assert_allclose(
        sun.radiance([0.0, 3e-3, 10e-3, 44e-3]),
        [1.0, np.cos(0.978) / np.cos(0.924), np.exp(kappa) * 10**gamma, 0.0],
        rtol=1e-12,
    )
    # the fit's real share is near its chi, and chi can be chosen so that the share is exact
    assert sun.circumsolar_share == pytest.approx(0.1, abs=0.005)
    for share in (0.0, 0.02, 0.05, 0.2, 0.4):
        assert BuieSun.of_share(share).circumsolar_share == pytest.approx(share, abs=1e-6)
    # 0.0552: an independent polynomial for chi(0.05) in use elsewhere (Tonatiuh++)
    assert BuieSun.of_share(0.05).circumsolar_ratio == pytest.approx(0.0552, abs=2e-4)


def test_soltrace_sun_files(shared_data):
    folder = shared_data / "csp" / "soltrace"
    for name, share in (("CSR10.sun", 0.10), ("CSR40.sun", 0.40), ("CSR0.sun", 0.0)):
        mrad, radiance = np.loadtxt(folder / name).T
        sun = TabulatedSun(1e-3 * mrad, radiance, name)
        assert 1 - sun.share_within(4.65e-3) == pytest.approx(share, abs=0.03)
    mrad, radiance = np.loadtxt(folder / "Pillbox465.sun").T
    offsets = TabulatedSun(1e-3 * mrad, radiance).sample(generator(), 100_000)
    assert offsets.std(axis=0).mean() == pytest.approx(4.655e-3 / 2, rel=5e-3)


def test_solar_disc_profile_file(shared_data):
    mrad, radiance = np.loadtxt(shared_data / "opencsp" / "sun" / "solar_disc_profile.csv", delimiter=",", skiprows=1).T
    sun = TabulatedSun(1e-3 * mrad, radiance)
    np.testing.assert_allclose(sun.share_within([2.325e-3, 4.651e-3]), [0.25, 1.0], atol=2e-4)


# --- closed forms


def test_point_sun_on_a_paraboloid_meets_in_its_focus():
    for focal in (1.0, 10.0, 100.0):
        result = spot(make_map(paraboloid(focal)), Illumination(POINT_SUN), facing_target(focal, 0.1))
        assert result.radius_of_share(1.0) < 2e-4  # the first ring
        assert np.hypot(result.sd_x_m, result.sd_y_m) < 4e-7 * focal  # float32 angles
        np.testing.assert_allclose(result.centroid_m, 0, atol=4e-7 * focal)


def test_point_sun_on_a_flat_is_its_outline():
    result = spot(make_map(plane()), Illumination(POINT_SUN), facing_target(50.0, 2.0, 1.6), rays=400_000)
    assert (result.sd_x_m, result.sd_y_m) == pytest.approx((1.2 / np.sqrt(12), 0.8 / np.sqrt(12)), rel=1e-3)
    inside = (np.abs(result.x_m) < 0.59) & (np.abs(result.y_m[:, None]) < 0.39)
    assert result.flux_per_m2[inside].mean() == pytest.approx(1 / (1.2 * 0.8), rel=2e-3)
    outside = (np.abs(result.x_m) > 0.61) | (np.abs(result.y_m[:, None]) > 0.41)
    assert not result.flux_per_m2[outside].any()


def test_pillbox_sun_on_a_long_focus_is_a_disc_of_the_suns_size():
    distance = 200.0
    result = spot(make_map(paraboloid(distance)), Illumination(PillboxSun()), facing_target(distance, 2.2), 500_000)
    radius = distance * np.tan(4.65e-3)
    assert result.radius_of_share(0.9999) == pytest.approx(radius, rel=3e-3)
    assert result.radius_of_share(0.25) == pytest.approx(radius / 2, rel=5e-3)
    assert result.sd_x_m == pytest.approx(radius / 2, rel=5e-3)
    core = np.hypot(result.x_m, result.y_m[:, None]) < 0.97 * radius
    assert result.flux_per_m2[core].mean() == pytest.approx(1 / (np.pi * radius**2), rel=5e-3)
    deviation = (result.flux_per_m2[core] - 1 / (np.pi * radius**2)) / result.sigma_flux_per_m2[core].mean()
    assert deviation.std() == pytest.approx(1, abs=0.05)  # the noise of the image is what it says


@pytest.mark.parametrize("specularity", [0.0, 1.5e-3])
def test_random_slopes_widen_the_beam_by_twice_their_sigma(specularity):
    rng = np.random.default_rng(1)
    shape, distance = (300, 300), 150.0
    error = rng.normal(0, 1, (2, *shape)) * np.array([2e-3, 1e-3])[:, None, None]
    slope_map = make_map(paraboloid(distance), error, shape=shape)
    light = Illumination(GaussianSun(2.5e-3), specularity_sigma_rad=specularity)
    result = spot(slope_map, light, facing_target(distance, 8.0), 500_000)
    for measured, slope in ((result.sd_x_m, 2e-3), (result.sd_y_m, 1e-3)):
        expected = distance * np.sqrt(2.5e-3**2 + specularity**2 + (2 * slope) ** 2)
        assert measured == pytest.approx(expected, rel=5e-3)
    assert (result.slope.sdx_rad, result.slope.sdy_rad) == pytest.approx((2e-3, 1e-3), rel=1e-2)
    assert result.focus_deviation_m[:2] == pytest.approx((0.6, 0.3), rel=1e-2)


def test_defocus_is_the_miss_of_the_rim():
    # f = 10 m instead of 10.5 m target distance: a ray from x lands at -x (10.5 - 10) / 10
    result = spot(make_map(paraboloid(10.0)), Illumination(POINT_SUN), facing_target(10.5, 0.2))
    assert result.sd_x_m == pytest.approx(1.2 / np.sqrt(12) * 0.05, rel=1e-2)


# --- orientation


@pytest.mark.parametrize("axis", [0, 1])
def test_one_milliradian_of_slope_moves_the_spot_the_other_way_by_twice_the_distance(axis):
    # slope dz/dx = +1 mrad: the normal leans to -x, the beam goes to -x by 2 d 1e-3
    error = [0.0, 0.0]
    error[axis] = 1e-3
    result = spot(make_map(paraboloid(100.0), error), Illumination(PillboxSun()), facing_target(100.0, 2.0))
    expected = np.zeros(2)
    expected[axis] = -100 * np.tan(2 * np.arctan(1e-3))
    np.testing.assert_allclose(result.center_m, expected, atol=1e-5)
    np.testing.assert_allclose(result.centroid_m, expected, atol=2e-3)
    weighted = [(result.flux_per_m2.sum(0) @ result.x_m), (result.flux_per_m2.sum(1) @ result.y_m)]
    np.testing.assert_allclose(np.array(weighted) / result.flux_per_m2.sum(), expected, atol=2e-3)


def test_the_sun_moves_the_spot_like_a_mirror_and_the_target_frame_turns_the_image():
    sun = np.array([2e-3, 0.0, 1.0])
    light = Illumination(POINT_SUN, sun)
    straight = spot(make_map(paraboloid(100.0)), light, facing_target(100.0, 2.0))
    np.testing.assert_allclose(straight.centroid_m, [-0.2, 0.0], atol=1e-3)
    turned = TargetPlane(RigidTransform.from_rotation_vector([0, 0, np.pi / 2], [0, 0, 100.0]), 2.0, 2.0)
    np.testing.assert_allclose(spot(make_map(paraboloid(100.0)), light, turned).centroid_m, [0.0, 0.2], atol=1e-3)
    row, column = np.unravel_index(straight.flux_per_m2.argmax(), straight.flux_per_m2.shape)
    assert straight.x_m[column] == pytest.approx(-0.2, abs=0.01)
    assert straight.y_m[row] == pytest.approx(0.0, abs=0.01)


def test_off_axis_facet_brings_the_sun_to_the_focus_of_its_optic():
    optic = paraboloid(10.0)
    optic_from_facet = facet_on_optic(optic, [2.0, 1.0], "normal")
    facet_from_optic = optic_from_facet.inverse()
    design = optic.transformed(facet_from_optic)
    target = TargetPlane(facet_from_optic @ RigidTransform(np.eye(3), [0, 0, 10.0]), 0.2, 0.2)
    sun = facet_from_optic.rotate([0.0, 0.0, 1.0])
    np.testing.assert_allclose(direction_to_sun_for(target, [0, 0, 1]), sun, atol=1e-14)
    result = spot(make_map(design, width=0.6, height=0.6), Illumination(POINT_SUN, sun), target)
    # cells of 10 to 15 mm follow the design's slope linearly: 3 um at the focus
    assert np.hypot(result.sd_x_m, result.sd_y_m) < 1e-5
    np.testing.assert_allclose(result.centroid_m, 0, atol=1e-5)


def test_every_ray_obeys_the_law_of_reflection_under_an_oblique_sun():
    design = sphere(15.0)
    slope_map = make_map(design, shape=(200, 300))
    light = Illumination(POINT_SUN, [0.5, -0.3, 0.8])
    for block in reflected_rays(slope_map, slope_map.height_m, light, rays=40_000, rng=generator()):
        x, y, z = block.origins_m.astype(np.float64)
        expected = reflect(-light.direction_to_sun, design.normal(x, y))
        np.testing.assert_allclose(block.directions.T, expected, atol=5e-7)
        np.testing.assert_allclose(z, design.height(x, y), atol=1e-6)


def test_rays_are_spread_by_the_sunlight_that_each_part_catches():
    # a sphere cap under a low sun: the side that faces it catches n.s more
    slope_map = make_map(sphere(1.5), shape=(16, 24))
    light = Illumination(POINT_SUN, [1.0, 0.0, 1.0])
    blocks = reflected_rays(slope_map, slope_map.height_m, light, rays=100_000, rng=generator())
    x = np.concatenate([block.origins_m[0].copy() for block in blocks])
    assert x.size == 100_000
    weight = np.maximum(1 - slope_map.slope_x, 0).sum(axis=0)
    counts = np.histogram(x, bins=np.linspace(-0.6, 0.6, 25))[0]
    np.testing.assert_allclose(counts, 100_000 * weight / weight.sum(), atol=17)  # less than one a node, 16 nodes


# --- trough: intercept factor against SolTrace


@pytest.mark.parametrize(("slope_mrad", "soltrace"), [(2, 0.9979), (3, 0.9828), (4, 0.9443), (6, 0.8228)])
def test_intercept_of_a_trough_agrees_with_soltrace(slope_mrad, soltrace):
    # f = 1.71 m, W = 5.774 m, tube 70 mm, Gaussian sun 2.73 mrad; 1e5 hits of SolTrace give +-0.001
    rng = np.random.default_rng(slope_mrad)
    design = trough(1.71)
    slope_map = make_map(design, width=5.774, height=6.0, shape=(200, 600))
    turn = rng.normal(0, 1e-3 * slope_mrad, (2, *slope_map.shape))
    across = np.tan(np.arctan(slope_map.slope_x) + turn[0])
    along = np.tan(turn[1]) * np.sqrt(1 + across**2)
    slope_map = replace(slope_map, slope_x=across, slope_y=along)
    light = Illumination(GaussianSun(2.73e-3))
    caught = total = 0
    for block in reflected_rays(slope_map, slope_map.height_m, light, rays=300_000, rng=generator()):
        (x, _, z), (ray_x, _, ray_z) = block.origins_m, block.directions
        miss = np.abs(x * ray_z + (1.71 - z) * ray_x) / np.hypot(ray_x, ray_z)
        caught += np.count_nonzero(miss <= 0.035)
        total += x.size
    assert caught / total == pytest.approx(soltrace, abs=0.0025)


# --- what the result must state


def test_unmeasured_nodes_emit_nothing_and_the_share_is_stated():
    gap = np.zeros((40, 60))
    gap[:, 30:] = np.nan  # x > 0
    slope_map = replace(make_map(plane(), (gap, gap)), removed="tilt of 1 mrad in x")
    result = spot(slope_map, Illumination(POINT_SUN), facing_target(50.0, 2.0))
    assert result.measured_share == 0.5
    assert not result.flux_per_m2[:, result.x_m > 0.01].any()
    assert result.share_in_window == 1.0
    assert (result.design, result.removed) == ("plane", "tilt of 1 mrad in x")
    for words in ("design: plane", "removed: tilt of 1 mrad in x", "50.0 % of the mirror measured", "pillbox sun"):
        assert words in result.describe()


def test_energy_is_conserved_between_image_rings_and_misses():
    light = Illumination(BuieSun(0.2), specularity_sigma_rad=1e-3)
    result = spot(make_map(paraboloid(100.0)), light, facing_target(100.0, 1.0), rays=100_003)
    pixel = np.diff(result.x_m)[0] * np.diff(result.y_m)[0]
    assert result.flux_per_m2.sum() * pixel == pytest.approx(result.share_in_window, rel=1e-12)
    assert 0.5 < result.share_in_window < 1
    assert (np.diff(result.encircled_share) >= 0).all()
    assert result.share_in_window <= result.encircled_share[-1] <= 1
    assert result.radius_of_share(1.0) == np.inf
    inscribed = np.interp(0.5, result.radius_m, result.encircled_share)
    assert inscribed < result.share_in_window


@pytest.mark.parametrize("rays", [1, 7, 16_384, 16_385, 50_000])
def test_exactly_the_rays_asked_for_are_traced_and_repeat_with_the_seed(rays):
    slope_map = make_map(paraboloid(50.0))
    first, again = (spot(slope_map, Illumination(PillboxSun()), facing_target(50.0, 4.0), rays, 3) for _ in range(2))
    assert first.flux_per_m2.sum() == pytest.approx(rays / rays / (4 / 256) ** 2)
    np.testing.assert_array_equal(first.flux_per_m2, again.flux_per_m2)
    if rays > 1:
        other = spot(slope_map, Illumination(PillboxSun()), facing_target(50.0, 4.0), rays, 4)
        assert (other.flux_per_m2 != first.flux_per_m2).any()


# --- refusals


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: PillboxSun(0.0), "half_angle_rad"),
        (lambda: GaussianSun(-1e-3), "sigma_rad"),
        (lambda: BuieSun(0.9), "circumsolar_ratio"),
        (lambda: BuieSun.of_share(0.9), "circumsolar_share"),
        (lambda: TabulatedSun([0, 4.65], [1, 0]), "is it in mrad"),
        (lambda: TabulatedSun([0, 1e-3, 1e-3], [1, 1, 0]), "ascending"),
        (lambda: TabulatedSun([0, 1e-3], [0, 1]), "radiance_table"),
        (lambda: Illumination(PillboxSun(), [0, 0, -1.0]), "behind the mirror"),
        (lambda: Illumination(PillboxSun(), specularity_sigma_rad=-1.0), "specularity"),
        (lambda: facing_target(-1.0, 1.0), "distance_m"),
        (lambda: TargetPlane(RigidTransform.identity(), 1.0, 0.0), "height_m"),
        (lambda: TargetPlane(RigidTransform.identity(), 1.0, 1.0, columns=0), "columns"),
    ],
)
def test_impossible_input_is_refused_by_name(call, words):
    with pytest.raises(InputError, match=words):
        call()


def test_a_map_that_cannot_be_traced_is_refused_with_the_reason():
    slope_map, light, target = make_map(plane()), Illumination(PillboxSun()), facing_target(10.0, 1.0)
    with pytest.raises(InputError, match="rays"):
        spot(slope_map, light, target, rays=0)
    with pytest.raises(InputError, match="have no height"):
        trace(slope_map, np.full(slope_map.shape, np.nan), light, target=target, rays=10, rng=generator())
    with pytest.raises(InputError, match="even grid"):
        spot(replace(slope_map, x_m=slope_map.x_m**3), light, target)
    behind = TargetPlane(RigidTransform(np.eye(3), [0, 0, -5.0]), 1.0, 1.0)
    with pytest.raises(EstimationError, match="sends no light"):
        spot(slope_map, light, behind)
    nothing = make_map(plane(), (np.full(slope_map.shape, np.nan), 0.0))
    with pytest.raises(EstimationError, match="node"):
        spot(nothing, light, target)
