"""The sparse adjustment gives what the dense one gives."""

import time

import numpy as np
import pytest
from scipy import sparse

from heliogauge.errors import EstimationError, InputError
from heliogauge.least_squares import VECTOR, CovarianceScale, Huber, Prior, Problem, Squares, solve
from heliogauge.sparse_least_squares import SparseProblem, solve_sparse


def network(n_points, n_links, seed=0):
    """Levelling network: height differences between random pairs, in units of their sigma."""
    rng = np.random.default_rng(seed)
    # A chain joins all points, the rest is random.
    start = np.concatenate([np.arange(n_points - 1), rng.integers(0, n_points, n_links)])
    end = np.concatenate(
        [np.arange(1, n_points), (start[n_points - 1 :] + rng.integers(1, n_points, n_links)) % n_points]
    )
    rows = np.arange(start.size)
    values = np.concatenate([-np.ones(start.size), np.ones(start.size)])
    matrix = sparse.csr_array((values, (np.tile(rows, 2), np.concatenate([start, end]))), shape=(start.size, n_points))
    heights = rng.normal(size=n_points)
    return matrix, matrix @ (heights - heights.mean()) + rng.normal(size=start.size)


def curved(matrix, observed, extra=0):
    """Make it nonlinear: differences of ``x + 0.01 x^2``; extra rows stay linear."""
    bend = np.full(observed.size, 0.01)
    bend[observed.size - extra :] = 0

    def evaluate(x):
        straight, square = matrix @ x, matrix @ x**2
        derivative = matrix + sparse.diags_array(2 * bend) @ matrix @ sparse.diags_array(x)
        return straight + bend * square - observed, sparse.csr_array(derivative)

    return evaluate


def pair(n, evaluate, **keywords):
    names = tuple(f"h{i}" for i in range(n))

    def dense(x):
        residuals, jacobian = evaluate(x)
        return residuals, jacobian.toarray()

    return Problem(names, dense, VECTOR, **keywords), SparseProblem(names, evaluate, VECTOR, **keywords)


def agree(one, other, **tolerance):
    tolerance = {"rtol": 1e-6, "atol": 1e-9} | tolerance
    for part in ("parameters", "covariance", "residuals", "weights", "redundancy_numbers", "variance_factor"):
        np.testing.assert_allclose(getattr(one, part), getattr(other, part), err_msg=part, **tolerance)
    assert (one.rank, one.redundancy, one.converged) == (other.rank, other.redundancy, other.converged)


@pytest.mark.parametrize("scale", list(CovarianceScale), ids=lambda scale: scale.name)
@pytest.mark.parametrize("loss", [Squares(), Huber()], ids=lambda loss: type(loss).__name__)
def test_inner_constraints(loss, scale):
    matrix, observed = network(30, 60)
    dense, thin = pair(30, curved(matrix, observed), datum=lambda _: np.ones((30, 1)))
    keywords = {"loss": loss, "covariance_scale": scale}
    agree(solve_sparse(thin, np.zeros(30), **keywords).require("heights"), solve(dense, np.zeros(30), **keywords))


@pytest.mark.parametrize("loss", [Squares(), Huber()], ids=lambda loss: type(loss).__name__)
def test_held_parameter(loss):
    matrix, observed = network(30, 60)
    dense, thin = pair(30, curved(matrix, observed), held=("h3",))
    agree(solve_sparse(thin, np.zeros(30), loss=loss), solve(dense, np.zeros(30), loss=loss))


@pytest.mark.parametrize("scale", list(CovarianceScale), ids=lambda scale: scale.name)
@pytest.mark.parametrize("loss", [Squares(), Huber()], ids=lambda loss: type(loss).__name__)
def test_prior(loss, scale):
    matrix, observed = network(30, 60)
    row = sparse.csr_array(([5.0], ([0], [2])), shape=(1, 30))
    stacked = curved(sparse.csr_array(sparse.vstack([matrix, row])), np.append(observed, 5.0), extra=1)
    names = tuple(f"h{i}" for i in range(30))
    plain, _ = pair(30, curved(matrix, observed))
    dense = Problem(names, plain.evaluate, VECTOR, extra=(Prior("h2", 1.0, 0.2),))
    keywords = {"loss": loss, "covariance_scale": scale}
    agree(
        solve_sparse(SparseProblem(names, stacked, VECTOR, n_extra=1), np.zeros(30), **keywords),
        solve(dense, np.zeros(30), **keywords),
    )


@pytest.mark.parametrize("n", [12, 300])
def test_lost_datum_is_named(n):
    matrix, observed = network(n, 3 * n)
    # One more point that nobody sees.
    wide = sparse.csr_array(sparse.hstack([matrix, sparse.csr_array((matrix.shape[0], 1))]))
    names = tuple(f"h{i}" for i in range(n + 1))
    problem = SparseProblem(names, lambda x: (wide @ x - observed, wide), VECTOR)
    solution = solve_sparse(problem, np.zeros(n + 1))
    assert solution.rank == n - 1
    assert len(solution.undetermined) == n + 1
    np.testing.assert_allclose(wide @ solution.null_space, 0, atol=1e-8)
    with pytest.raises(EstimationError, match=f"2 of {n + 1} degrees of freedom"):
        solution.require("heights")


@pytest.mark.parametrize("n", [12, 300])
def test_one_lost_point_leaves_the_others(n):
    matrix, observed = network(n, 3 * n)
    wide = sparse.csr_array(sparse.hstack([matrix, sparse.csr_array((matrix.shape[0], 1))]))
    names = tuple(f"h{i}" for i in range(n + 1))
    problem = SparseProblem(names, lambda x: (wide @ x - observed, wide), VECTOR, held=("h0",))
    solution = solve_sparse(problem, np.zeros(n + 1))
    assert solution.undetermined == (f"h{n}",)
    exact = np.linalg.inv((matrix.T @ matrix).toarray()[1:, 1:])
    np.testing.assert_allclose(solution.covariance[1:n, 1:n], exact, rtol=1e-7, atol=1e-12)


@pytest.mark.slow
def test_large_network_is_quick():
    matrix, observed = network(3000, 3000)
    _, thin = pair(3000, curved(matrix, observed), datum=lambda _: np.ones((3000, 1)))
    began = time.process_time()
    solution = solve_sparse(thin, np.zeros(3000)).require("heights")
    assert solution.redundancy_numbers.sum() == pytest.approx(solution.redundancy, rel=1e-6)
    assert time.process_time() - began < 30


def test_impossible_input():
    with pytest.raises(InputError, match="no such parameter"):
        SparseProblem(("a",), lambda x: (x, sparse.csr_array(np.eye(1))), VECTOR, held=("b",))
    with pytest.raises(InputError, match="do not fit"):
        solve_sparse(SparseProblem(("a",), lambda x: (x, sparse.csr_array(np.ones((1, 2)))), VECTOR), np.zeros(1))
