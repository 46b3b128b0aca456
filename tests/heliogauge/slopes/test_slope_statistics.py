"""Statistics of slope maps: known answers, what removal does, and sigma that is the scatter."""

from dataclasses import replace

import numpy as np
import pytest

from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.surfaces import facet_on_optic, paraboloid, paraboloid_xy, plane, quadric, sphere, trough
from heliogauge.slopes.map import CommonModes, SlopeMap, no_common_modes
from heliogauge.slopes.removal import Removal, remove
from heliogauge.slopes.statistics import canting, fit_quadratic, statistics

X, Y = np.linspace(-0.6, 0.6, 24), np.linspace(-0.4, 0.4, 16)
GRID_X, GRID_Y = np.meshgrid(X, Y)


def make_map(
    measured, design=None, *, error=(0.0, 0.0), sigma=(1e-5, 2e-5), common=None, aperture=None, correlation=1.0
):
    design = measured if design is None else design
    height, slope_x, slope_y = measured.height_and_gradient(GRID_X, GRID_Y)
    design_x, design_y = design.gradient(GRID_X, GRID_Y)
    full = np.ones(GRID_X.shape)
    return SlopeMap(
        x_m=X,
        y_m=Y,
        slope_x=slope_x + error[0],
        slope_y=slope_y + error[1],
        design_slope_x=design_x,
        design_slope_y=design_y,
        sigma_random_x=sigma[0] * full,
        sigma_random_y=sigma[1] * full,
        noise_correlation=correlation,
        common=common or no_common_modes(),
        height_m=height,
        flags=0 * full,
        aperture=full > 0 if aperture is None else aperture,
        design=design.describe(),
        frame="facet",
        removed="nothing",
    )


def random_modes(seed, k=3, scale=3e-5):
    rng = np.random.default_rng(seed)
    return CommonModes(tuple("abc"[:k]), rng.normal(0, scale, (k, 2, 6)), [0.05, -0.02], 0.6)


def smooth_error(seed=0, scale=1e-3):
    rng = np.random.default_rng(seed)
    waves = np.stack([np.sin(7 * GRID_X + 3 * GRID_Y), np.cos(5 * GRID_Y - 2 * GRID_X), GRID_X * GRID_Y])
    return scale * np.tensordot(rng.normal(size=(2, 3)), waves, axes=1)


def test_checkerboard_of_known_amplitude():
    board = np.where((np.indices(GRID_X.shape).sum(0) % 2) == 0, 1.0, -1.0)
    result = statistics(make_map(plane(), error=(2e-3 * board, 1e-3 * board)))
    whole = np.arctan(np.sqrt(5) * 1e-3)
    expected = np.array([2 / np.sqrt(5), 1 / np.sqrt(5), 1]) * whole
    assert (result.sdx_rad, result.sdy_rad, result.sd_rad) == pytest.approx(expected, rel=1e-12)
    assert result.focus_deviation_m(50.0) == pytest.approx(100 * expected, rel=1e-12)
    assert (result.removed, result.reference, result.measured_share) == ("nothing", "design: plane", 1.0)
    assert (result.noise_rms_x_rad, result.noise_rms_y_rad) == pytest.approx((1e-5, 2e-5), rel=1e-5)


def test_angle_between_normals_is_right_on_a_steep_mirror_and_below_the_reach_of_arccos():
    # at 45 degrees a slope change of dp turns the normal by dp / (1 + p^2) = dp / 2
    steep = quadric([0, 0, 1.0, 0, 0, 0])
    result = statistics(make_map(steep, error=(1e-10, 0.0)))
    assert result.sd_rad == pytest.approx(0.5e-10, rel=1e-6)


def test_design_and_best_fit_focal_length_are_two_references():
    # 10.2 m built for 10 m: the normal leans by atan(r / 20) - atan(r / 20.4); a fitted focal length leaves nothing
    slope_map = make_map(paraboloid(10.2), paraboloid(10.0))
    against_design = statistics(slope_map)
    radius = np.hypot(GRID_X, GRID_Y)
    across = (np.arctan(radius / 20) - np.arctan(radius / 20.4)) * GRID_X / radius
    assert against_design.sdx_rad == pytest.approx(np.sqrt(np.mean(across**2)), rel=1e-9)
    best_fit = statistics(slope_map, removed=Removal.FOCUS)
    assert best_fit.sdx_rad < 1e-15
    assert "focus: 1/f is 0.980392 times the design's" in best_fit.removed
    convex = statistics(make_map(paraboloid(-20.0), paraboloid(10.0)), removed=Removal.FOCUS)
    assert "focus: 1/f is -0.5 times the design's, of the opposite sign" in convex.removed
    assert best_fit.reference.startswith("best-fit focal length of the design shape (paraboloid of focal length 10 m")
    assert against_design.reference == "design: paraboloid of focal length 10 m"


def test_focus_of_a_trough_and_of_a_flat():
    across = statistics(make_map(trough(1.75), trough(1.71), error=(0.0, 1e-3 * GRID_Y)), removed=Removal.FOCUS)
    assert across.sdx_rad < 1e-15
    along = np.arctan(1e-3 * GRID_Y / np.hypot(1, GRID_X / 3.42))  # a trough has no focus along itself
    assert across.sdy_rad == pytest.approx(np.sqrt(np.mean(along**2)), rel=1e-9)
    sagging = statistics(make_map(paraboloid(500.0), plane()), removed=Removal.FOCUS)
    assert sagging.sd_rad < 1e-15
    assert "focus: 1/f = 0.002 1/m" in sagging.removed


def test_off_axis_facet_focus_is_scaled_with_the_design():
    def seen_by_facet(focal_m):
        optic_from_facet = facet_on_optic(paraboloid(10.0), [0.5, 0.0], "normal")
        return paraboloid(focal_m).transformed(optic_from_facet.inverse())

    slope_map = make_map(seen_by_facet(10.05), seen_by_facet(10.0))
    before, after = statistics(slope_map, removed=Removal.TILT), statistics(slope_map, removed=Removal.FOCUS)
    assert before.sd_rad > 5e-5
    assert after.sd_rad < 2e-7


@pytest.mark.parametrize("removal", list(Removal))
def test_the_removed_map_has_the_statistics_and_says_what_was_removed(removal):
    slope_map = make_map(paraboloid(10.2), paraboloid(10.0), error=smooth_error(), common=random_modes(1))
    done = statistics(slope_map, removed=removal)
    again = statistics(remove(slope_map, removal))
    for name in ("sdx_rad", "sdy_rad", "sd_rad"):
        assert getattr(again, name) == pytest.approx(getattr(done, name), rel=1e-9)
    assert again.removed == done.removed
    # common errors are projected with the map (only the random part sees the projection a second time)
    assert again.sigma_sd_rad == pytest.approx(done.sigma_sd_rad, rel=2e-2)


def test_removal_takes_out_the_common_errors_of_the_same_shape():
    coefficients = np.zeros((2, 2, 3))
    coefficients[0, 0, 0], coefficients[1, :, 1:] = 1e-3, np.eye(2) * 1e-3  # a tilt, and a change of focal length
    tilt_and_focus = CommonModes(("mirror pose", "camera"), coefficients, [0.0, 0.0], 1.0)
    slope_map = make_map(paraboloid(10.0), error=smooth_error(), common=tilt_and_focus)
    clean = replace(slope_map, common=no_common_modes())
    with_modes, without_modes = (statistics(m, removed=Removal.FOCUS) for m in (slope_map, clean))
    assert with_modes.sigma_sd_rad == pytest.approx(without_modes.sigma_sd_rad, rel=1e-9)
    assert statistics(slope_map).sigma_sd_rad > 10 * statistics(clean).sigma_sd_rad
    np.testing.assert_allclose(remove(slope_map, Removal.FOCUS).common_variance(), 0, atol=1e-28)


def test_removed_heights_are_those_of_the_removed_slopes():
    slope_map = make_map(paraboloid(100.0), plane())
    for removal in (Removal.FOCUS, Removal.QUADRATIC):
        flat = remove(slope_map, removal)
        assert np.ptp(flat.height_m) < 1e-15
    tilted = remove(make_map(paraboloid(10.0), error=(1e-3, -2e-3)), Removal.TILT)
    expected = paraboloid(10.0).height(GRID_X, GRID_Y) - 1e-3 * GRID_X + 2e-3 * GRID_Y
    np.testing.assert_allclose(np.ptp(tilted.height_m - expected), 0, atol=1e-15)
    assert "tilt of 1.0000 mrad in x and -2.0000 mrad in y" in tilted.removed


@pytest.mark.slow
@pytest.mark.parametrize("removal", list(Removal))
def test_sigma_of_the_rms_is_its_scatter(removal):
    rng = np.random.default_rng(11)
    common = random_modes(2)
    error = smooth_error(3, scale=4e-4)  # large against the noise: sigma is first order
    shapes = common.evaluate(GRID_X, GRID_Y)
    results = []
    for _ in range(500):
        shared = np.tensordot(rng.normal(size=3), shapes, axes=1)
        noise = rng.normal(size=(2, *GRID_X.shape)) * np.array([4e-5, 8e-5])[:, None, None]
        one = make_map(paraboloid(10.0), error=error + shared + noise, sigma=(4e-5, 8e-5), common=common)
        results.append(statistics(one, removed=removal))
    for value, sigma in (("sdx_rad", "sigma_sdx_rad"), ("sdy_rad", "sigma_sdy_rad"), ("sd_rad", "sigma_sd_rad")):
        scatter = np.std([getattr(r, value) for r in results])
        assert np.median([getattr(r, sigma) for r in results]) == pytest.approx(scatter, rel=0.12)


def test_sigma_of_pure_noise_is_its_scatter():
    # nothing but noise: the RMS has sigma / sqrt(2 n), not sigma / sqrt(n)
    rng = np.random.default_rng(12)
    results = [
        statistics(make_map(plane(), error=rng.normal(0, 1e-5, (2, *GRID_X.shape)), sigma=(1e-5, 1e-5)))
        for _ in range(500)
    ]
    scatter = np.std([r.sdx_rad for r in results])
    assert scatter == pytest.approx(1e-5 / np.sqrt(2 * GRID_X.size), rel=0.12)
    assert np.median([r.sigma_sdx_rad for r in results]) == pytest.approx(scatter, rel=0.12)


@pytest.mark.slow
def test_sigma_knows_that_a_fitted_shape_shares_its_noise_between_x_and_y():
    # pure astigmatism is what a focus fit leaves: noise of that shape in x goes half into the fitted focal length
    rng = np.random.default_rng(15)
    results = []
    for _ in range(500):
        noise = rng.normal(0, 1e-4, (2, *GRID_X.shape))
        slope_map = make_map(sphere(20.0), error=(1e-3 * GRID_X, -2e-3 * GRID_Y) + noise, sigma=(1e-4, 1e-4))
        results.append(statistics(slope_map, removed=Removal.FOCUS))
    for value, sigma in (("sdx_rad", "sigma_sdx_rad"), ("sdy_rad", "sigma_sdy_rad"), ("sd_rad", "sigma_sd_rad")):
        scatter = np.std([getattr(r, value) for r in results])
        assert np.median([getattr(r, sigma) for r in results]) == pytest.approx(scatter, rel=0.12)


def test_sigma_of_the_normal_angle_on_a_steep_mirror():
    # at 45 degrees the normal turns by half the change of slope, and so does its sigma
    rng = np.random.default_rng(16)
    steep = quadric([0, 0, 1.0, 0, 0, 0])
    errors = 1e-3 + rng.normal(0, 1e-4, (500, *GRID_X.shape))
    results = [statistics(make_map(steep, error=(error, 0.0), sigma=(1e-4, 0.0))) for error in errors]
    scatter = np.std([r.sd_rad for r in results])
    assert np.median([r.sigma_sd_rad for r in results]) == pytest.approx(scatter, rel=0.12)
    assert scatter == pytest.approx(0.5 * np.std(np.sqrt(np.mean(errors**2, axis=(1, 2)))), rel=0.02)


@pytest.mark.slow
def test_correlated_noise_widens_the_sigma_of_means_and_fits():
    # every value repeated in blocks of 2 x 2: the sum of many nodes has 4 times the variance of independent ones
    rng = np.random.default_rng(14)
    error = smooth_error(3)
    results = []
    for _ in range(400):
        noise = np.kron(rng.normal(0, 4e-5, (2, 8, 12)), np.ones((1, 2, 2)))
        results.append(make_map(plane(), error=error + noise, sigma=(4e-5, 4e-5), correlation=4.0))
    done = [statistics(m, removed=Removal.TILT) for m in results]
    assert done[0].sigma_sdx_rad == pytest.approx(np.std([s.sdx_rad for s in done]), rel=0.12)
    tilts = [canting(m) for m in results]
    sigma = np.sqrt(np.diag(tilts[0].covariance_components_rad2))
    np.testing.assert_allclose(np.std([t.components_rad for t in tilts], axis=0), sigma, rtol=0.12)
    fits = [fit_quadratic(m) for m in results]
    sigma = np.sqrt(np.diag(fits[0].covariance))
    np.testing.assert_allclose(np.std([f.coefficients for f in fits], axis=0), sigma, rtol=0.15)


def test_measured_share_is_stated_and_gaps_count_nowhere():
    error = np.where(GRID_X > 0, 1e-3, np.nan)
    result = statistics(make_map(plane(), error=(error, error)))
    assert result.measured_share == pytest.approx(0.5)
    assert result.sdx_rad == pytest.approx(1e-3)


# --- quadratic fit


def test_quadratic_fit_finds_focal_lengths_tilt_and_twist():
    # z = A x^2 + B y^2 + C x + D y + E x y
    slope_map = make_map(paraboloid_xy(10.0, 12.0), error=(1e-3 + 4e-3 * GRID_Y, -2e-3 + 4e-3 * GRID_X))
    fit = fit_quadratic(slope_map)
    np.testing.assert_allclose(fit.coefficients, [1 / 40, 1 / 48, 1e-3, -2e-3, 4e-3], rtol=1e-10)
    assert (fit.focal_length_x_m, fit.focal_length_y_m) == pytest.approx((10.0, 12.0))
    assert fit.twist_per_m == pytest.approx(4e-3)
    assert fit.residual_slope_rms_x < 1e-15
    assert abs(fit_quadratic(make_map(plane())).focal_length_x_m) > 1e12


def test_quadratic_fit_far_from_the_origin_keeps_its_digits():
    slope_map = make_map(paraboloid(10.0))
    far = replace(slope_map, x_m=X + 1000.0)
    fit = fit_quadratic(far)
    np.testing.assert_allclose(fit.coefficients, [1 / 40, 1 / 40, -50, 0, 0], rtol=1e-9, atol=1e-11)


@pytest.mark.slow
def test_covariance_of_the_quadratic_fit_is_its_scatter():
    rng = np.random.default_rng(13)
    common = random_modes(5)
    shapes = common.evaluate(GRID_X, GRID_Y)
    fits = []
    for _ in range(800):
        shared = np.tensordot(rng.normal(size=3), shapes, axes=1)
        noise = rng.normal(size=(2, *GRID_X.shape)) * np.array([1e-3, 2e-3])[:, None, None]
        fits.append(fit_quadratic(make_map(paraboloid(10), error=shared + noise, sigma=(1e-3, 2e-3), common=common)))
    covariance = fits[0].covariance
    difference = np.array([f.coefficients for f in fits]) - [1 / 40, 1 / 40, 0, 0, 0]
    squares = np.einsum("ni,ij,nj->n", difference, np.linalg.inv(covariance), difference)
    assert squares.sum() == pytest.approx(5 * 800, abs=3.3 * np.sqrt(2 * 5 * 800))
    scatter = np.std([f.focal_length_x_m for f in fits])
    assert np.median([f.sigma_focal_length_x_m for f in fits]) == pytest.approx(scatter, rel=0.12)


# --- canting


def test_canting_is_the_tilt_of_the_whole_facet_also_with_a_hole():
    aperture = GRID_X**2 + GRID_Y**2 < 1
    error = np.where((GRID_X < -0.2) & (GRID_Y < 0), np.nan, 1.0)
    result = canting(make_map(sphere(20.0), error=(3e-3 * error, -4e-3 * error), aperture=aperture))
    np.testing.assert_allclose(result.components_rad, [3e-3, -4e-3], rtol=1e-3)
    slope_x, slope_y = (g[aperture & np.isfinite(error)] for g in sphere(20.0).gradient(GRID_X, GRID_Y))
    means = []
    for x, y in ((slope_x, slope_y), (slope_x + 3e-3, slope_y - 4e-3)):
        normals = np.stack([-x, -y, np.ones(x.size)], axis=1)
        means.append((normals / np.linalg.norm(normals, axis=1, keepdims=True)).mean(axis=0))
    angle = np.arctan2(np.linalg.norm(np.cross(*means)), np.dot(*means))
    assert result.angle_rad == pytest.approx(angle, rel=1e-9)
    assert result.measured_share < 1
    assert result.sigma_angle_rad == pytest.approx(
        np.hypot(0.6e-5, 1.6e-5) / np.sqrt(np.isfinite(error).sum()), rel=2e-3
    )


def test_canting_carries_the_common_tilt_undiminished():
    coefficients = np.zeros((1, 2, 1))
    coefficients[0, 0, 0] = 2e-4
    pose = CommonModes(("mirror pose",), coefficients, [0.0, 0.0], 1.0)
    result = canting(make_map(plane(), error=(1e-3, 0.0), common=pose))
    assert result.sigma_angle_rad == pytest.approx(2e-4, rel=1e-3)


# --- refusals


def test_too_little_to_say_anything_is_refused_with_the_numbers():
    nothing = make_map(plane(), error=(np.full(GRID_X.shape, np.nan), 0.0))
    with pytest.raises(EstimationError, match="0 of 384 nodes"):
        statistics(nothing)
    line = make_map(plane(), error=(np.where(X[3] == GRID_X, 0.0, np.nan), 0.0))
    assert statistics(line, removed=Removal.TILT).sdx_rad == 0
    with pytest.raises(EstimationError, match="on a line"):
        fit_quadratic(line)
    with pytest.raises(EstimationError, match="on a line"):
        statistics(line, removed=Removal.QUADRATIC)
    with pytest.raises(InputError, match="distance_m"):
        statistics(make_map(plane())).focus_deviation_m(0.0)


@pytest.mark.filterwarnings("ignore:(invalid value|overflow) encountered")
def test_design_slopes_beyond_all_bounds_are_refused() -> None:
    """Files can hold them; their squares overflow, and eigenvalues then do not converge."""
    tilted = make_map(paraboloid(100.0), error=(1e-3, 0.0))
    beyond = replace(tilted, design_slope_x=np.where(GRID_X > 0, 1e200, 2e200))
    with pytest.raises(EstimationError, match="beyond the numbers"):
        statistics(beyond, removed=Removal.QUADRATIC)
