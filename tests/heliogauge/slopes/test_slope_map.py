"""SlopeMap and its operations: shares of uncertainty, resampling, differences, curl and curvature."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliogauge.errors import InputError
from heliogauge.flags import SampleFlag
from heliogauge.geometry.surfaces import paraboloid
from heliogauge.slopes.grid import curl, curl_rms, curvature, difference, resample
from heliogauge.slopes.map import CommonModes, SlopeMap, monomials, no_common_modes


def make_map(error_x=0.0, error_y=0.0, *, design=None, sigma=1e-5, common=None, nx=21, ny=17, correlation=1.0):
    x, y = np.linspace(-0.6, 0.6, nx), np.linspace(-0.4, 0.4, ny)
    grid_x, grid_y = np.meshgrid(x, y)
    height, slope_x, slope_y = (design or paraboloid(10.0)).height_and_gradient(grid_x, grid_y)
    full = np.ones(grid_x.shape)
    return SlopeMap(
        x_m=x,
        y_m=y,
        slope_x=slope_x + error_x,
        slope_y=slope_y + error_y,
        design_slope_x=slope_x,
        design_slope_y=slope_y,
        sigma_random_x=sigma * full,
        sigma_random_y=2 * sigma * full,
        noise_correlation=correlation,
        common=common or no_common_modes(),
        height_m=height,
        flags=0 * full,
        aperture=full > 0,
        design="paraboloid of focal length 10 m",
        frame="facet",
        removed="nothing",
    )


def modes(seed, k=3, degree=2):
    rng = np.random.default_rng(seed)
    terms = (degree + 1) * (degree + 2) // 2
    names = tuple(f"source {i}" for i in range(k))
    return CommonModes(names, rng.normal(0, 1e-5, (k, 2, terms)), rng.uniform(-0.1, 0.1, 2), 0.7)


def without(slope_map, rows, columns, flag=SampleFlag.OFF_SCREEN):
    slope_x, flags = slope_map.slope_x.copy(), slope_map.flags.copy()
    slope_x[rows, columns], flags[rows, columns] = np.nan, flag
    return replace(slope_map, slope_x=slope_x, flags=flags)


def test_monomials_are_ordered_by_degree_then_by_power_of_v():
    np.testing.assert_array_equal(monomials(np.array(2.0), np.array(5.0), 2), [1, 2, 5, 4, 10, 25])
    assert CommonModes((), np.zeros((0, 2, 10)), np.zeros(2), 1.0).degree == 3


def test_variance_on_a_grid_is_that_of_the_modes():
    rng = np.random.default_rng(5)
    modes = CommonModes(("a", "b", "c"), rng.normal(0, 1e-5, (3, 2, 15)), np.array([0.1, -0.2]), 0.7)
    modes = replace(modes, coefficients=modes.coefficients * np.array([[[1.0], [1.0]], [[1.0], [0.0]], [[0.0], [1.0]]]))
    x, y = np.linspace(-1, 1, 7), np.linspace(-0.5, 0.6, 5)
    expected = np.square(modes.evaluate(*np.meshgrid(x, y))).sum(axis=0)
    np.testing.assert_allclose(modes.variance_on_grid(x, y), expected, rtol=1e-12)
    assert no_common_modes().variance_on_grid(x, y).max() == 0.0


def test_valid_and_share_count_the_aperture_only():
    slope_map = make_map()
    aperture = np.ones(slope_map.shape, dtype=bool)
    aperture[0] = False
    holed = without(replace(slope_map, aperture=aperture), slice(1, 3), slice(None))
    assert holed.measured_share == pytest.approx(14 / 16)
    smoothed = replace(slope_map, flags=np.full(slope_map.shape, SampleFlag.SMOOTHED_GAP))
    assert smoothed.valid.all()


def test_whole_sigma_is_random_and_common_in_squares():
    common = modes(1)
    slope_map = make_map(common=common)
    sigma_x, sigma_y = slope_map.sigma_slope()
    values = common.evaluate(*np.meshgrid(slope_map.x_m, slope_map.y_m))
    np.testing.assert_allclose(sigma_x**2, 1e-10 + (values[:, 0] ** 2).sum(0), rtol=1e-12)
    np.testing.assert_allclose(sigma_y**2, 4e-10 + (values[:, 1] ** 2).sum(0), rtol=1e-12)


def test_maps_are_read_only_and_of_one_shape():
    slope_map = make_map()
    with pytest.raises(ValueError, match="read-only"):
        slope_map.slope_x[0, 0] = 0
    with pytest.raises(InputError, match="slope_y"):
        replace(slope_map, slope_y=np.zeros((2, 2)))


# --- resampling


def test_resampling_onto_its_own_grid_changes_nothing():
    rng = np.random.default_rng(3)
    slope_map = without(make_map(rng.normal(0, 1e-3, (17, 21)), rng.normal(0, 1e-3, (17, 21))), 4, 7)
    again = resample(slope_map, slope_map.x_m, slope_map.y_m)
    for name in ("slope_x", "slope_y", "design_slope_x", "sigma_random_x", "height_m"):
        expected = np.where(slope_map.valid, getattr(slope_map, name), np.nan)
        np.testing.assert_allclose(np.where(again.valid, getattr(again, name), np.nan), expected, rtol=1e-12)
    np.testing.assert_array_equal(again.flags, slope_map.flags)
    assert again.measured_share == slope_map.measured_share


@given(st.integers(0, 10**6))
def test_resampling_is_exact_for_linear_slopes(seed):
    rng = np.random.default_rng(seed)
    x, y = np.sort(rng.uniform(-0.6, 0.6, 9)), np.sort(rng.uniform(-0.4, 0.4, 8))
    fine = resample(make_map(), x, y)
    slope_x, slope_y = paraboloid(10.0).gradient(*np.meshgrid(x, y))
    np.testing.assert_allclose(fine.slope_x, slope_x, rtol=0, atol=1e-15)
    np.testing.assert_allclose(fine.slope_y, slope_y, rtol=0, atol=1e-15)
    assert (fine.sigma_random_x <= 1e-5 * (1 + 1e-12)).all()
    assert (fine.sigma_random_x >= 0.5e-5 * (1 - 1e-12)).all()  # four equal weights at best


def test_resampling_bridges_no_gap_and_reaches_nowhere_beyond():
    holed = without(make_map(), 8, 10)  # the node at x = 0, y = 0
    new = resample(holed, [-1.0, 0.03, 0.3], [0.0, 0.1])
    assert np.isnan(new.slope_x[0, 1])
    assert new.flags[0, 1] == SampleFlag.OFF_SCREEN
    assert new.aperture.tolist() == [[False, True, True], [False, True, True]]
    assert np.isfinite(new.slope_x[:, 2]).all()
    rejected = replace(holed, slope_x=make_map().slope_x)  # a number is there, but the flag says not to trust it
    assert np.isnan(resample(rejected, [0.03, 0.3], [0.0]).slope_x).tolist() == [[True, False]]
    with pytest.raises(InputError, match="ascends"):
        resample(holed, [0.1, 0.0], [0.0])


@pytest.mark.slow
def test_the_mean_over_the_mirror_keeps_its_sigma_on_a_finer_grid():
    rng = np.random.default_rng(8)
    fine_x, fine_y = np.linspace(-0.59, 0.59, 119), np.linspace(-0.39, 0.39, 79)
    maps = [resample(make_map(rng.normal(0, 1e-5, (17, 21))), fine_x, fine_y) for _ in range(300)]
    scatter = np.std([m.slope_error_x.mean() for m in maps])
    predicted = np.sqrt(maps[0].noise_correlation * (maps[0].sigma_random_x ** 2).sum()) / fine_x.size / fine_y.size
    assert predicted == pytest.approx(scatter, rel=0.15)
    assert resample(make_map(), make_map().x_m[::4], make_map().y_m[::4]).noise_correlation == 1.0


# --- differences


def test_difference_subtracts_slopes_and_adds_sigmas_in_squares():
    first, second = make_map(2e-3, 1e-3, common=modes(1)), make_map(0.5e-3, -1e-3, common=modes(2, k=2, degree=3))
    change = difference(first, second)
    np.testing.assert_allclose(change.slope_error_x, 1.5e-3, rtol=0, atol=1e-15)
    np.testing.assert_allclose(change.slope_error_y, 2e-3, rtol=0, atol=1e-15)
    variances = [np.square(m.sigma_slope()) for m in (first, second, change)]
    np.testing.assert_allclose(variances[2], variances[0] + variances[1], rtol=1e-9)
    assert change.common.sources == first.common.sources + second.common.sources


def test_difference_refuses_another_grid_and_says_what_to_do():
    with pytest.raises(InputError, match="resample"):
        difference(make_map(), make_map(nx=20))


# --- derivatives


def test_curl_of_a_surface_is_zero_and_of_a_twist_is_not():
    x, y = np.meshgrid(np.linspace(-0.6, 0.6, 21), np.linspace(-0.4, 0.4, 17))
    saddle = make_map(3e-3 * y, 3e-3 * x)
    inner = np.s_[1:-1, 1:-1]
    np.testing.assert_allclose(curl(saddle).value_per_m[inner], 0, rtol=0, atol=1e-15)
    rotation = make_map(3e-3 * y, -3e-3 * x)
    np.testing.assert_allclose(curl(rotation).value_per_m[inner], 6e-3, rtol=1e-10)
    assert np.isnan(curl(rotation).value_per_m[0]).all()


@pytest.mark.parametrize("correlation", [1.0, 5.0])
def test_waves_that_run_aslant_have_no_curl(correlation):
    """The circulation is right to the fourth order of Simpson's rule; differences through the middle are not."""
    grid_x, grid_y = np.linspace(-0.6, 0.6, 41), np.linspace(-0.4, 0.4, 41)
    x, y = np.meshgrid(grid_x, grid_y)
    fifth = curl(make_map(4 * x**3 * y, x**4, nx=41, ny=41, correlation=correlation)).value_per_m
    assert np.nanmax(np.abs(fifth)) < 1e-12
    k = 2 * np.pi / 0.36 * np.array([0.9, np.sqrt(1 - 0.9**2)])
    wave = 10e-3 / (k[0] * k[1]) * np.cos(k[0] * x + k[1] * y)
    turned = curl(make_map(k[0] * wave, k[1] * wave, nx=41, ny=41, correlation=correlation)).value_per_m
    reach = int(np.ceil(np.sqrt(correlation)))
    step = 0.03 * reach
    assert np.nanmax(np.abs(turned)) < 10e-3 * (np.linalg.norm(k) * step) ** 4 / 180
    inner = slice(reach, -reach)
    middle = k[0] * (wave[2 * reach :, inner] - wave[: -2 * reach, inner]) / (2 * 0.02 * reach)
    middle -= k[1] * (wave[inner, 2 * reach :] - wave[inner, : -2 * reach]) / (2 * step)
    assert np.abs(middle).max() > 5 * np.nanmax(np.abs(turned))


def test_curvature_of_a_paraboloid_is_one_over_twice_its_focal_length():
    in_x, in_y = curvature(make_map())
    np.testing.assert_allclose(in_x.value_per_m[:, 1:-1], 0.05, rtol=1e-12)
    np.testing.assert_allclose(in_y.value_per_m[1:-1], 0.05, rtol=1e-12)


def test_derivatives_do_not_use_a_missing_neighbour():
    holed = without(make_map(), 8, 10)
    assert np.isnan(curl(holed).value_per_m[7:10, 10]).tolist() == [True, False, True]
    assert np.isnan(curvature(holed)[0].value_per_m[8, 9:12]).tolist() == [True, False, True]


@pytest.mark.parametrize("correlation", [1.0, 5.0])
def test_rms_of_the_curl_is_that_of_its_map(correlation):
    rng = np.random.default_rng(11)
    errors = rng.normal(0, 1e-4, (2, 17, 21))
    holed = without(make_map(*errors, common=modes(3, degree=3), correlation=correlation), [5, 8, 9], [4, 10, 10])
    uneven = replace(holed, x_m=holed.x_m + 0.1 * holed.x_m**2, y_m=holed.y_m + 0.1 * holed.y_m**3)
    turn = curl(uneven)
    seen = uneven.valid & np.isfinite(turn.value_per_m)
    expected = [np.sqrt(np.mean(one[seen] ** 2)) for one in (turn.value_per_m, turn.sigma_per_m)]
    np.testing.assert_allclose(curl_rms(uneven), expected, rtol=1e-12)


def test_a_map_without_four_neighbours_has_no_curl():
    assert np.isnan(curl_rms(make_map(nx=2))).all()
    assert np.isnan(curl_rms(without(make_map(nx=3), slice(None), 1))).all()


@pytest.mark.parametrize("quantity", [curl, lambda m: curvature(m)[0], lambda m: curvature(m)[1]])
def test_sigma_of_derivatives_is_their_scatter(quantity):
    rng = np.random.default_rng(7)
    common = modes(4, k=2)
    truth = make_map(common=common)
    shapes = common.evaluate(*np.meshgrid(truth.x_m, truth.y_m))
    values = []
    for _ in range(600):
        shared = np.tensordot(rng.normal(size=2), shapes, axes=1)
        noisy = make_map(
            shared[0] + rng.normal(0, 1e-5, truth.shape), shared[1] + rng.normal(0, 2e-5, truth.shape), common=common
        )
        values.append(quantity(noisy).value_per_m[5, 5:8])
    np.testing.assert_allclose(np.std(values, axis=0), quantity(truth).sigma_per_m[5, 5:8], rtol=0.12)


def test_differences_reach_beyond_shared_pixels():
    """Nodes that share pixels (noise correlation 6.2: half-pixel grid) are differenced 3 nodes to each side."""
    shared = replace(make_map(), noise_correlation=6.2)
    value = curvature(shared)[0].value_per_m
    finite = np.flatnonzero(np.isfinite(value[value.shape[0] // 2]))
    assert finite[0] == 3
    own = curvature(make_map())[0]
    middle = tuple(size // 2 for size in value.shape)
    assert value[middle] == pytest.approx(own.value_per_m[middle], rel=1e-9)
    assert curvature(shared)[0].sigma_per_m[middle] < own.sigma_per_m[middle]


def test_modes_of_a_sum_are_the_sums_of_the_modes() -> None:
    rng = np.random.default_rng(3)
    modes = CommonModes(("pose", "camera"), rng.standard_normal((2, 2, 10)), np.array([0.3, -0.2]), 1.7)
    x, y, weights = rng.standard_normal((3, 40))
    np.testing.assert_allclose(modes.of_sum(x, y, weights), modes.evaluate(x, y) @ weights, rtol=1e-12)
