"""Is the uncertainty true: sample, solve again, compare; and the distributions behind the tests."""

import numpy as np
import pytest
from scipy import stats

from heliogauge.adjust.chi_square import chi_square_cdf, chi_square_quantile
from heliogauge.adjust.least_squares import (
    VECTOR,
    Cauchy,
    CovarianceScale,
    Huber,
    Prior,
    Problem,
    Squares,
    Tukey,
    solve,
)
from heliogauge.adjust.robust_loss import normal_moments
from heliogauge.errors import InputError

LOSSES = [Squares(), Huber(), Cauchy(), Tukey()]
X = np.linspace(-1, 1, 40)
MATRIX = np.stack([np.ones(40), X, X**2], 1)
TRUTH = np.array([1.0, -2.0, 0.5])


def parabola(observed, **keywords):
    return Problem(("a", "b", "c"), lambda x: (MATRIX @ x - observed, MATRIX), VECTOR, **keywords)


def scatter(draw, trials, *, prior_sigma=0.0, **keywords):
    """Mean squared error in units of the covariance (expected: 3 * trials) and mean variance factor."""
    rng = np.random.default_rng(11)
    squares, factors = 0.0, []
    for _ in range(trials):
        extra = (Prior("b", TRUTH[1] + rng.normal(0, prior_sigma), prior_sigma),) if prior_sigma else ()
        solution = solve(parabola(MATRIX @ TRUTH + draw(rng), extra=extra), TRUTH, **keywords).require("parabola")
        error = solution.parameters - TRUTH
        squares += error @ np.linalg.solve(solution.covariance, error)
        factors.append(solution.variance_factor)
    return squares, float(np.mean(factors))


def chi_square_band(freedom):
    return stats.chi2.ppf([0.005, 0.995], freedom)


@pytest.mark.slow
@pytest.mark.parametrize("loss", LOSSES, ids=lambda loss: type(loss).__name__)
def test_scatter_is_the_reported_sigma(loss):
    squares, factor = scatter(lambda rng: rng.normal(size=40), 500, loss=loss)
    low, high = chi_square_band(1500)
    # The robust covariance takes the larger of two estimates: it may be too large by a few percent, never too small.
    assert (low if isinstance(loss, Squares) else 0.93 * low) < squares < high
    assert factor == pytest.approx(1, abs=0.04)


@pytest.mark.parametrize("prior_sigma", [0.05, 0.3])
def test_scatter_with_a_prior(prior_sigma):
    squares, factor = scatter(lambda rng: rng.normal(size=40), 500, prior_sigma=prior_sigma)
    low, high = chi_square_band(1500)
    assert low < squares < high
    assert factor == pytest.approx(1, abs=0.04)


def test_posterior_scale_repairs_wrong_sigmas_and_prior_scale_does_not():
    repaired, _ = scatter(lambda rng: rng.normal(0, 3, 40), 300, covariance_scale=CovarianceScale.POSTERIOR)
    believed, factor = scatter(lambda rng: rng.normal(0, 3, 40), 300)
    # With 37 degrees of freedom in the factor the squares follow 3 F(3, 37), whose mean is 37 / 35 of chi-square's.
    assert 0.9 < repaired / 900 / (37 / 35) < 1.1
    assert believed / 900 == pytest.approx(9, rel=0.1)
    assert factor == pytest.approx(9, rel=0.03)


def contaminated(rng, share=0.1, size=10.0):
    return np.where(rng.random(40) < share, rng.normal(0, size, 40), rng.normal(size=40))


@pytest.mark.slow
@pytest.mark.parametrize("scale", list(CovarianceScale), ids=lambda scale: scale.name)
@pytest.mark.parametrize("loss", LOSSES[1:], ids=lambda loss: type(loss).__name__)
def test_robust_covariance_is_honest_with_ten_percent_of_gross_errors(loss, scale):
    squares, _ = scatter(contaminated, 500, loss=loss, covariance_scale=scale)
    assert 0.85 < squares / 1500 < 1.2


def test_plain_least_squares_is_not():
    """The negative control: the same data, the sigmas believed."""
    squares, _ = scatter(contaminated, 200)
    assert squares / 600 > 5


@pytest.mark.parametrize("loss", LOSSES[1:], ids=lambda loss: type(loss).__name__)
def test_outliers_do_not_move_the_estimate(loss):
    rng = np.random.default_rng(3)
    noise = rng.normal(size=40)
    clean = solve(parabola(MATRIX @ TRUTH + noise), TRUTH)
    wrong = noise.copy()
    wrong[[3, 17, 30]] += 1000.0
    dirty = solve(parabola(MATRIX @ TRUTH + wrong), clean.parameters, loss=loss)
    plain = solve(parabola(MATRIX @ TRUTH + wrong), TRUTH)
    assert (np.abs(dirty.parameters - clean.parameters) < 1.5 * clean.sigmas).all()
    assert (np.abs(plain.parameters - clean.parameters) > 20 * clean.sigmas).any()
    assert dirty.weights[[3, 17, 30]].max() < 0.01
    assert dirty.outliers()[[3, 17, 30]].all()


def test_blocks_are_weakened_together():
    """An image point off in y only loses its x as well."""
    rng = np.random.default_rng(4)
    observed = rng.normal(size=(30, 2))
    observed[5, 1] += 50
    matrix = np.tile(np.eye(2), (30, 1))
    problem = Problem(("x", "y"), lambda x: (matrix @ x - observed.ravel(), matrix), VECTOR)
    solution = solve(problem, np.zeros(2), loss=Huber(2.0), block_size=2)
    weights = solution.weights.reshape(30, 2)
    np.testing.assert_array_equal(weights[:, 0], weights[:, 1])
    assert weights[5, 0] < 0.1
    # Rotating the image axes changes nothing: a loss of each component by itself would not have this.
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    turned = Problem(
        ("x", "y"),
        lambda x: (((matrix @ x - observed.ravel()).reshape(30, 2) @ turn.T).ravel(), np.tile(turn, (30, 1))),
        VECTOR,
    )
    np.testing.assert_allclose(
        solve(turned, np.zeros(2), loss=Huber(2.0), block_size=2).parameters, solution.parameters, atol=1e-7
    )


@pytest.mark.parametrize("block_size", [1, 2])
@pytest.mark.parametrize("loss", LOSSES, ids=lambda loss: type(loss).__name__)
def test_losses_are_consistent(loss, block_size):
    s = np.linspace(0.01, 9, 500)
    influence = loss.weight(s) * s
    middle, step = 0.5 * (s[1:] + s[:-1]), s[1] - s[0]
    np.testing.assert_allclose(np.diff(loss.rho(s)) / step / 2, loss.weight(middle) * middle, atol=0.01)
    smooth = np.abs(middle - getattr(loss, "threshold", 99)) > 2 * step
    np.testing.assert_allclose((np.diff(influence) / step)[smooth], loss.slope(middle)[smooth], atol=0.01)
    moments = normal_moments(loss, block_size)
    sample = np.linalg.norm(np.random.default_rng(5).normal(size=(400_000, block_size)), axis=1)
    assert moments.influence * block_size == pytest.approx(np.mean((loss.weight(sample) * sample) ** 2), rel=0.01)


@pytest.mark.parametrize("loss", LOSSES[1:], ids=lambda loss: type(loss).__name__)
def test_default_thresholds_keep_95_percent(loss):
    moments = normal_moments(loss, 1)
    assert moments.slope**2 / moments.influence == pytest.approx(0.95, abs=0.002)


def test_variance_factor_test():
    rng = np.random.default_rng(6)
    solution = solve(parabola(MATRIX @ TRUTH + rng.normal(size=40)), TRUTH)
    low, high = solution.variance_factor_interval(0.99)
    np.testing.assert_allclose([low, high], stats.chi2.ppf([0.005, 0.995], 37) / 37, rtol=1e-9)
    assert low < solution.variance_factor < high
    wrong = solve(parabola(MATRIX @ TRUTH + rng.normal(0, 2, 40)), TRUTH)
    assert wrong.variance_factor_probability() < 1e-4
    assert solution.variance_factor_probability() > 0.01


def test_false_alarms_of_the_outlier_tests():
    rng = np.random.default_rng(7)
    marked = dict.fromkeys(CovarianceScale, 0)
    for _ in range(400):
        noise = rng.normal(size=40)
        for scale in CovarianceScale:
            size = 1.0 if scale is CovarianceScale.PRIOR else 5.0
            observed = MATRIX @ TRUTH + noise * size
            marked[scale] += solve(parabola(observed), TRUTH, covariance_scale=scale).outliers(0.01).sum()
    # 160 expected; tests on one fit are correlated a little, so a wide band.
    assert all(115 < count < 210 for count in marked.values())


@pytest.mark.parametrize("freedom", [1, 2, 7.5, 100, 2000, 1e5])
def test_chi_square(freedom):
    for probability in (1e-4, 0.025, 0.5, 0.975, 0.9999):
        value = stats.chi2.ppf(probability, freedom)
        assert chi_square_quantile(probability, freedom) == pytest.approx(value, rel=1e-8)
        assert chi_square_cdf(value, freedom) == pytest.approx(probability, rel=1e-8)


def test_chi_square_refuses():
    with pytest.raises(InputError):
        chi_square_quantile(1.0, 3)
    with pytest.raises(InputError):
        chi_square_quantile(0.5, 0)
