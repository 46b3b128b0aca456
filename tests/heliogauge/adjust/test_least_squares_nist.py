"""NIST's certified nonlinear regression problems: an answer by an independent route, to 11 digits."""

import numpy as np
import pytest

from heliogauge.adjust.least_squares import VECTOR, CovarianceScale, Options, Problem, Solution, solve
from tests.heliogauge.nist_strd import MODELS, certified_digits, read_problem


@pytest.fixture
def problem_of(shared_data):
    folder = shared_data / "photogrammetry" / "nist_strd"
    return lambda name: read_problem(folder / f"{name}.dat")


def fit(problem, start) -> Solution:
    names = tuple(f"b{i + 1}" for i in range(start.size))
    with np.errstate(all="ignore"):
        return solve(
            Problem(names, problem.evaluate, VECTOR),
            start,
            covariance_scale=CovarianceScale.POSTERIOR,
            options=Options(max_iterations=1000),
        )


# NIST computed the sigmas of Lanczos1 from residuals of 1e-13, which double precision does not resolve.
SIGMA_DIGITS = {"Lanczos1": 2.5}


@pytest.mark.parametrize("name", sorted(MODELS))
def test_certified_digits_from_start_2(problem_of, name):
    problem = problem_of(name)
    solution = fit(problem, problem.start_2)
    assert solution.converged, solution.reason
    assert certified_digits(solution.parameters, problem.certified) >= 7
    assert certified_digits(solution.sigmas, problem.certified_sigma) >= SIGMA_DIGITS.get(name, 6)


# Not MGH10 (needs more than 1000 steps) and not MGH17 (runs to a plateau at infinity): both say so, see below.
@pytest.mark.parametrize("name", sorted(set(MODELS) - {"MGH10", "MGH17"}))
def test_certified_digits_from_the_far_start(problem_of, name):
    problem = problem_of(name)
    solution = fit(problem, problem.start_1)
    assert solution.converged, solution.reason
    assert certified_digits(solution.parameters, problem.certified) >= 7


def test_a_lost_descent_is_not_sold_as_an_answer(problem_of):
    plateau, slow = problem_of("MGH17"), problem_of("MGH10")
    assert fit(plateau, plateau.start_1).undetermined
    assert not fit(slow, slow.start_1).converged


def test_residual_squares(problem_of):
    problem = problem_of("Thurber")
    solution = fit(problem, problem.start_2)
    assert solution.residuals @ solution.residuals == pytest.approx(problem.certified_squares, rel=1e-10)
