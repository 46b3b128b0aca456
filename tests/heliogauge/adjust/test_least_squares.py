"""Adjustment: closed forms, stopping, rank by name, priors, datum, poses."""

import numpy as np
import pytest

from heliogauge.adjust.least_squares import (
    POSE,
    POSE_NAMES,
    VECTOR,
    Chart,
    Constraint,
    CovarianceScale,
    Huber,
    Options,
    Prior,
    Problem,
    solve,
    whitened,
)
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform, rotation_from_vector, skew
from tests.derivatives import central_differences, check_jacobian


def linear(matrix, observed, sigma=1.0, **keywords):
    """Build the problem ``matrix @ x = observed``."""
    names = tuple(f"x{i}" for i in range(matrix.shape[1]))
    return Problem(names, lambda x: ((matrix @ x - observed) / sigma, matrix / sigma), VECTOR, **keywords)


class TestClosedForms:
    def test_weighted_mean(self):
        values, sigmas = np.array([1.0, 2.0, 4.0]), np.array([0.1, 0.2, 0.4])
        solution = solve(linear(np.ones((3, 1)) / sigmas[:, None], values / sigmas), np.array([9.0]))
        weights = sigmas**-2
        assert solution.parameters[0] == pytest.approx(values @ weights / weights.sum(), rel=1e-14)
        assert solution.sigmas[0] == pytest.approx(weights.sum() ** -0.5, rel=1e-14)
        assert solution.converged
        assert solution.redundancy == 2
        np.testing.assert_allclose(solution.redundancy_numbers, 1 - weights / weights.sum(), rtol=1e-12)

    def test_line(self):
        x = np.arange(10.0)
        y = 2.0 + 0.5 * x + np.array([1, -1, 2, 0, -2, 1, 1, -1, 0, -1]) * 0.01
        solution = solve(
            linear(np.stack([np.ones(10), x], 1), y), np.zeros(2), covariance_scale=CovarianceScale.POSTERIOR
        )
        slope = ((x - x.mean()) @ y) / ((x - x.mean()) @ x)
        rest = y - y.mean() - slope * (x - x.mean())
        variance = rest @ rest / 8
        assert solution.value("x1") == pytest.approx(slope, rel=1e-12)
        assert solution.variance_factor == pytest.approx(variance, rel=1e-10)
        assert solution.sigma("x1") == pytest.approx(np.sqrt(variance / ((x - x.mean()) @ x)), rel=1e-10)
        assert solution.correlation[0, 1] == pytest.approx(-np.sqrt(12 * 4.5**2 / (12 * 4.5**2 + 99)), rel=1e-12)
        assert solution.redundancy_numbers.sum() == pytest.approx(8, rel=1e-12)

    def test_many_rows_are_factorised_in_blocks(self):
        rng = np.random.default_rng(1)
        matrix, truth = rng.normal(size=(20_000, 3)), np.array([1.0, 2.0, 3.0])
        observed = matrix @ truth + rng.normal(size=20_000)
        solution = solve(linear(matrix, observed), np.zeros(3))
        np.testing.assert_allclose(solution.parameters, np.linalg.lstsq(matrix, observed)[0], rtol=1e-12)
        np.testing.assert_allclose(solution.covariance, np.linalg.inv(matrix.T @ matrix), rtol=1e-10, atol=1e-18)

    def test_ill_conditioned_columns_keep_their_digits(self):
        # Condition 1e9: normal equations would lose everything, the orthogonal factorisation keeps seven digits.
        x = np.linspace(0, 1, 30)
        matrix = np.stack([np.ones(30), x, x + 1e-9 * x**2], 1)
        solution = solve(linear(matrix, matrix @ [1.0, 2.0, 3.0]), np.zeros(3))
        np.testing.assert_allclose(solution.parameters, [1, 2, 3], rtol=2e-6)

    def test_whitening_with_blocks(self):
        rng = np.random.default_rng(2)
        blocks = np.array([[[2.0, 0.5], [0.5, 1.0]], [[1.0, -0.3], [-0.3, 3.0]]])
        residuals, jacobian = rng.normal(size=4), rng.normal(size=(4, 2))
        white, white_jacobian = whitened(residuals, jacobian, blocks)
        full = np.zeros((4, 4))
        full[:2, :2], full[2:, 2:] = blocks
        np.testing.assert_allclose(white @ white, residuals @ np.linalg.inv(full) @ residuals)
        np.testing.assert_allclose(white_jacobian.T @ white, jacobian.T @ np.linalg.inv(full) @ residuals)
        with pytest.raises(InputError, match="positive definite"):
            whitened(residuals, jacobian, -blocks)


class TestStop:
    def test_too_few_iterations_are_reported(self):
        problem = Problem(
            ("x",), lambda x: (np.array([x[0] ** 3 - 8, 0.1]), np.array([[3 * x[0] ** 2], [0.0]])), VECTOR
        )
        solution = solve(problem, np.array([50.0]), options=Options(max_iterations=3))
        assert not solution.converged
        assert "3 iterations" in solution.reason
        with pytest.raises(EstimationError, match="not converged"):
            solution.require("root")

    def test_wrong_derivatives_are_not_called_converged(self):
        observed = np.array([1.0, 2.0, 3.0])
        problem = Problem(("x",), lambda x: (x[0] - observed, -np.ones((3, 1))), VECTOR)
        solution = solve(problem, np.array([50.0]))
        assert not solution.converged
        assert "derivatives" in solution.reason

    def test_exact_data(self):
        matrix = np.random.default_rng(3).normal(size=(20, 4))
        solution = solve(linear(matrix, np.zeros(20)), np.ones(4))
        assert solution.converged
        np.testing.assert_allclose(solution.parameters, 0, atol=1e-14)

    def test_model_not_finite_at_start(self):
        problem = Problem(("x",), lambda x: (np.array([np.nan]), np.ones((1, 1))), VECTOR)
        with pytest.raises(EstimationError, match="not finite at the start"):
            solve(problem, np.zeros(1))

    def test_derivatives_not_finite(self):
        problem = Problem(("x",), lambda x: (np.zeros(2), np.array([[1.0], [np.nan]])), VECTOR)
        with pytest.raises(EstimationError, match="not finite at the start"):
            solve(problem, np.zeros(1))

    def test_nothing_but_priors(self):
        problem = Problem(("x",), lambda x: (np.zeros(0), np.zeros((0, 1))), VECTOR, extra=(Prior("x", 2.0, 0.5),))
        solution = solve(problem, np.zeros(1), loss=Huber()).require("prior")
        assert (solution.value("x"), solution.sigma("x")) == (2.0, 0.5)
        assert np.isnan(solution.variance_factor)

    def test_a_step_into_nan_is_taken_back(self):
        def evaluate(x):
            with np.errstate(invalid="ignore"):
                return np.log(x) - np.array([1.0, 1.1]), np.full((2, 1), 1 / x[0])

        solution = solve(Problem(("x",), evaluate, VECTOR), np.array([60.0]))
        assert solution.converged
        assert solution.parameters[0] == pytest.approx(np.exp(1.05))

    @pytest.mark.parametrize("options", [{"tolerance": 0.0}, {"max_iterations": 0}, {"initial_damping": -1.0}])
    def test_impossible_options(self, options):
        with pytest.raises(InputError):
            Options(**options)


class TestRank:
    def test_undetermined_parameters_are_named_and_the_others_keep_their_sigma(self):
        # Only the sum of the first two counts; the third stands alone.
        matrix = np.array([[1.0, 1.0, 0.0], [2.0, 2.0, 1.0], [0.0, 0.0, 1.0], [1.0, 1.0, 3.0]])
        solution = solve(linear(matrix, np.array([1.0, 2.0, 0.1, 1.0])), np.zeros(3))
        reduced = np.linalg.inv(matrix[:, 1:].T @ matrix[:, 1:])
        assert solution.rank == 2
        assert set(solution.undetermined) == {"x0", "x1"}
        assert np.isnan(solution.sigmas[:2]).all()
        assert solution.sigma("x2") == pytest.approx(np.sqrt(reduced[1, 1]))
        np.testing.assert_allclose(matrix @ solution.null_space, 0, atol=1e-12)
        with pytest.raises(EstimationError, match=r"1 of 3 degrees of freedom.*x0, x1"):
            solution.require("sums")

    def test_a_parameter_nobody_sees(self):
        matrix = np.array([[1.0, 0.0], [1.0, 0.0]])
        solution = solve(linear(matrix, np.array([1.0, 2.0])), np.array([0.0, 7.0]))
        assert solution.undetermined == ("x1",)
        assert solution.value("x1") == 7.0
        assert solution.value("x0") == pytest.approx(1.5)

    def test_units_do_not_change_the_rank(self):
        matrix = np.random.default_rng(4).normal(size=(20, 3)) * np.array([1e-12, 1.0, 1e12])
        assert solve(linear(matrix, np.ones(20)), np.zeros(3)).rank == 3

    def test_a_prior_holds_what_the_observations_do_not(self):
        matrix = np.array([[1.0, 1.0], [1.0, 1.0]])
        solution = solve(linear(matrix, np.array([3.0, 3.2]), extra=(Prior("x1", 1.0, 0.1),)), np.zeros(2))
        assert solution.rank == 2
        assert solution.value("x1") == pytest.approx(1.0)
        assert solution.sigma("x1") == pytest.approx(0.1)
        # Nothing controls the prior: its redundancy number is zero and its test says so.
        assert solution.redundancy_numbers[2] == pytest.approx(0, abs=1e-12)
        assert np.isnan(solution.baarda()[2])

    def test_held_parameters(self):
        matrix = np.array([[1.0, 1.0], [1.0, 1.0]])
        solution = solve(linear(matrix, np.array([3.0, 3.2]), held=("x1",)), np.array([0.0, 1.0]))
        np.testing.assert_allclose(solution.parameters, [2.1, 1.0])
        np.testing.assert_allclose(solution.covariance, [[0.5, 0], [0, 0]])
        assert np.isnan(solution.correlation[0, 1])

    def test_inner_constraints_give_the_pseudo_inverse(self):
        # Levelling: only differences are observed, the datum is the mean height.
        matrix = np.array([[1.0, -1.0, 0.0], [0.0, 1.0, -1.0], [1.0, 0.0, -1.0]])
        observed = np.array([1.0, 2.0, 3.3])
        inner = solve(linear(matrix, observed, datum=lambda _: np.ones((3, 1))), np.zeros(3)).require("heights")
        minimal = solve(linear(matrix, observed, datum=lambda _: np.eye(3)[:, :1]), np.zeros(3)).require("heights")
        np.testing.assert_allclose(inner.covariance, np.linalg.pinv(matrix.T @ matrix), atol=1e-14)
        assert inner.parameters.sum() == pytest.approx(0, abs=1e-12)
        assert minimal.sigmas[0] == pytest.approx(0, abs=1e-14)
        assert minimal.redundancy == inner.redundancy == 1
        # What does not depend on the datum agrees.
        np.testing.assert_allclose(matrix @ inner.covariance @ matrix.T, matrix @ minimal.covariance @ matrix.T)
        np.testing.assert_allclose(inner.residuals, minimal.residuals, atol=1e-12)

    def test_strong_correlations_are_listed(self):
        x = np.linspace(10, 11, 20)
        solution = solve(linear(np.stack([np.ones(20), x], 1), x), np.zeros(2))
        ((first, second, value),) = solution.largest_correlations(0.99)
        assert (first, second) == ("x0", "x1")
        assert value < -0.99


class TestPriorsAndConstraints:
    def test_prior_is_one_more_observation(self):
        rng = np.random.default_rng(5)
        matrix, observed = rng.normal(size=(6, 2)), rng.normal(size=6)
        prior = solve(linear(matrix, observed, extra=(Prior("x0", 0.3, 0.2),)), np.zeros(2))
        rows, values = np.vstack([matrix, [5.0, 0.0]]), np.append(observed, 1.5)
        stacked = solve(linear(rows, values), np.zeros(2))
        np.testing.assert_allclose(prior.parameters, stacked.parameters, rtol=1e-10)
        np.testing.assert_allclose(prior.covariance, stacked.covariance, rtol=1e-10)
        np.testing.assert_allclose(prior.redundancy_numbers, stacked.redundancy_numbers, rtol=1e-10)
        assert prior.variance_factor == pytest.approx(stacked.variance_factor)

    def test_constraint_is_not_weakened_by_the_loss(self):
        def distance(x):
            return np.array([x.sum() - 1.0]), np.ones((1, 2))

        matrix, observed = np.eye(2), np.array([0.0, 100.0])
        problem = linear(matrix, observed, extra=(Constraint("sum", distance, 1e-3),))
        solution = solve(problem, np.zeros(2), loss=Huber())
        assert solution.parameters.sum() == pytest.approx(1.0, abs=1e-3)
        assert solution.weights[2] == 1.0
        assert solution.weights[1] < 0.05

    @pytest.mark.parametrize("keywords", [{"held": ("y",)}, {"extra": (Prior("y", 0.0, 1.0),)}], ids=["held", "prior"])
    def test_unknown_names(self, keywords):
        with pytest.raises(InputError, match="no such parameter; there are x0, x1"):
            linear(np.eye(2), np.zeros(2), **keywords)

    def test_impossible_input(self):
        with pytest.raises(InputError, match="positive"):
            Prior("x0", 0.0, 0.0)
        with pytest.raises(InputError, match="do not fit 2 parameters"):
            solve(Problem(("a", "b"), lambda x: (np.zeros(3), np.zeros((3, 1))), VECTOR), np.zeros(2))
        with pytest.raises(InputError, match="a name of its own"):
            Problem(("a", "a"), lambda x: (np.zeros(3), np.zeros((3, 1))), VECTOR)


class TestPose:
    """Registration of points: a state that is not a vector, observed at 3.1 rad where rotation vectors flip sign."""

    points_m = np.random.default_rng(6).uniform(-1, 1, (8, 3))
    truth = RigidTransform.from_rotation_vector([0.0, 3.1, 0.3], [0.1, 0.2, 3.0])

    def evaluate(self, observed_m, sigma_m):
        def inner(pose):
            turned = self.points_m @ pose.rotation.T
            derivative = np.concatenate([-skew(turned), np.broadcast_to(np.eye(3), (8, 3, 3))], axis=2)
            return (turned + pose.translation_m - observed_m).ravel() / sigma_m, derivative.reshape(24, 6) / sigma_m

        return inner

    def test_derivatives(self):
        evaluate = self.evaluate(np.zeros((8, 3)), 1.0)
        differences = central_differences(lambda pose: evaluate(pose)[0], self.truth, POSE.retract, np.full(6, 1e-3))
        check_jacobian(evaluate(self.truth)[1], differences, relative=1e-10)

    def test_checker_finds_a_wrong_derivative(self):
        evaluate = self.evaluate(np.zeros((8, 3)), 1.0)
        differences = central_differences(lambda pose: evaluate(pose)[0], self.truth, POSE.retract, np.full(6, 1e-3))
        wrong = evaluate(self.truth)[1].copy()
        wrong[0, 1] *= 1.0001
        with pytest.raises(AssertionError, match="by differences"):
            check_jacobian(wrong, differences)

    def test_far_start_and_honest_steps(self):
        rng = np.random.default_rng(7)
        squares = 0.0
        for _ in range(200):
            observed = self.truth.apply(self.points_m) + rng.normal(0, 0.01, (8, 3))
            problem = Problem(POSE_NAMES, self.evaluate(observed, 0.01), POSE)
            start = RigidTransform.from_rotation_vector([0.5, 2.0, 0.0], [0.0, 0.0, 1.0])
            solution = solve(problem, start).require("registration")
            turn = RigidTransform(solution.state.rotation @ self.truth.rotation.T, [0, 0, 0]).rotation_vector_rad
            error = np.append(turn, solution.state.translation_m - self.truth.translation_m)
            squares += error @ np.linalg.solve(solution.covariance, error)
        # Chi-square with 1200 degrees of freedom: 99 % band.
        assert 1077 < squares < 1329

    def test_one_point_leaves_the_turn_about_it_open(self):
        def evaluate(pose):
            turned = pose.rotation @ np.array([0.0, 0.0, 1.0])
            return turned + pose.translation_m - 1.0, np.concatenate([-skew(turned), np.eye(3)], axis=1)

        solution = solve(Problem(POSE_NAMES, evaluate, POSE), RigidTransform.identity())
        assert solution.rank == 3
        assert solution.null_space.shape == (6, 3)
        with pytest.raises(EstimationError, match="rotation_"):
            solution.require("pose")

    def test_own_chart(self):
        # A direction on the circle, one parameter; the mean direction of three observed ones.
        observed = np.array([3.1, -3.1, 3.0])

        def evaluate(turn):
            angle = np.arctan2(turn[1, 0], turn[0, 0])
            return (angle - observed + np.pi) % (2 * np.pi) - np.pi, np.ones((3, 1))

        def retract(turn, step):
            return turn @ rotation_from_vector([0, 0, step[0]])

        chart = Chart(retract, lambda turn: np.array([np.arctan2(turn[1, 0], turn[0, 0])]))
        solution = solve(Problem(("angle_rad",), evaluate, chart), rotation_from_vector([0, 0, 3.0]))
        assert solution.value("angle_rad") == pytest.approx((3.1 + 3.0 + 2 * np.pi - 3.1) / 3)


@pytest.mark.parametrize("bend", [0.585, 0.592, 0.6, 0.65, 0.8, 1.5])
def test_steps_that_hop_across_the_minimum_are_shortened(bend: float) -> None:
    """Where residuals bend as much as they slope, an undamped step goes to the other side of the minimum.

    The minimum is at 0.3; undamped steps multiply the way to it by about -1. Steps that kept little of their promise
    were accepted without shortening the next, and none of these six was there after 90.
    """
    place = 0.3 + 2 * 0.3 * (bend + 0.09)

    def evaluate(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.array([x[0] - place, bend + x[0] ** 2]), np.array([[1.0], [2 * x[0]]])

    problem = Problem(("x",), evaluate, VECTOR)
    solution = solve(problem, np.array([0.4]), options=Options(max_iterations=90, tolerance=1e-6))
    assert solution.converged, solution.reason
    assert solution.parameters[0] == pytest.approx(0.3, abs=1e-5)
