"""Least squares: against the closed form of a linear problem, against sampling, and against itself."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.stats import chi2

from spheremouse.errors import CalibrationError
from spheremouse.geometry.least_squares.adjust import (
    adjust,
    cofactors,
    huber,
    huber_cost,
    outlier_statistic,
    redundancy,
    variance_factors,
)


def linear(rng, n=40, u=5, sigma=0.1):
    A, x = rng.standard_normal((n, u)), rng.standard_normal(u)
    b = A @ x + sigma * rng.standard_normal(n)
    return A / sigma, x, b / sigma


def solved(A, b, knee=np.inf):
    J = sparse.csr_array(A)
    return adjust(lambda x: (A @ x - b, J), np.zeros(A.shape[1]), np.add, "", knee)


@given(seed=st.integers(0, 10**6), u=st.integers(1, 8))
@settings(max_examples=20)
def test_linear_problem_has_its_closed_form(seed, u):
    A, _, b = linear(np.random.default_rng(seed), u=u)
    np.testing.assert_allclose(solved(A, b), np.linalg.lstsq(A, b, rcond=None)[0], atol=1e-7)
    Q = cofactors(sparse.csr_array(A))
    np.testing.assert_allclose(Q, np.linalg.inv(A.T @ A), rtol=1e-8)
    assert redundancy(sparse.csr_array(A), Q).sum() == pytest.approx(len(b) - u)


def test_robust_adjustment_bears_one_observation_in_ten_that_is_false():
    rng = np.random.default_rng(2)
    A, x, b = linear(rng, 60, 4)
    b[::10] += 500.0
    plain, robust = solved(A, b), solved(A, b, knee=2.0)
    sigma = np.sqrt(np.diag(np.linalg.inv(A.T @ A)))
    assert np.max(np.abs(plain - x) / sigma) > 20.0
    assert np.max(np.abs(robust - x) / sigma) < 5.0


def test_unknown_that_hangs_in_the_air_is_named():
    A = np.random.default_rng(3).standard_normal((20, 4))
    A[:, 2] = 0.0
    with pytest.raises(np.linalg.LinAlgError) as e:
        cofactors(sparse.csr_array(A))
    assert e.value.args[0] == 2
    A[:, 2] = A[:, 1] - A[:, 3]
    with pytest.raises(np.linalg.LinAlgError) as e:
        cofactors(sparse.csr_array(A))
    assert e.value.args[0] in (1, 2, 3)


def test_normalised_residuals_of_points_are_chi_square():
    rng = np.random.default_rng(4)
    A, x, _ = linear(rng, 24, 5)
    Q = np.linalg.inv(A.T @ A)
    J = sparse.csr_array(A)
    cofactor = redundancy(J, Q, 2)
    values = []
    for _ in range(400):
        b = A @ x + rng.standard_normal(24)
        v = A @ (Q @ (A.T @ b)) - b
        values.append(outlier_statistic(v.reshape(-1, 2), cofactor))
    share = np.mean(np.array(values) > chi2.ppf(0.95, 2))
    assert 0.04 < share < 0.06  # 4800 values: 0.003 of standard deviation


def test_variance_factors_find_what_each_group_is_off():
    rng = np.random.default_rng(6)
    A, x, _ = linear(rng, 2000, 4, 1.0)
    sigma = np.where(np.arange(2000) < 1000, 3.0, 0.5)
    b = A @ x + sigma * rng.standard_normal(2000)
    groups = [np.arange(2000) < 1000, np.arange(2000) >= 1000]
    factors = np.ones(2)
    for _ in range(5):
        w = np.where(groups[0], factors[0], factors[1]) ** -0.5
        J = sparse.csr_array(A * w[:, None])
        number = redundancy(J, cofactors(J))[:, 0, 0]
        factors = variance_factors(J @ solved(A * w[:, None], b * w) - b * w, number, groups, factors)
    np.testing.assert_allclose(factors, [9.0, 0.25], rtol=0.15)


def test_a_curved_valley_has_its_minimum():
    def rosenbrock(x):
        J = np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])
        return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]]), sparse.csr_array(J)

    np.testing.assert_allclose(adjust(rosenbrock, np.array([-1.2, 1.0]), np.add, ""), [1.0, 1.0], atol=1e-8)


@pytest.mark.parametrize(
    ("residual", "words"),
    [(lambda x: 1000.0 - np.log(x), "does not come to rest: try it"), (np.log, "has no beginning: try it")],
)
def test_what_has_no_rest_or_no_beginning_is_said_with_what_to_do(residual, words):
    start = np.array([1.0 if residual is not np.log else np.nan])
    with pytest.raises(CalibrationError, match=words):
        adjust(lambda x: (residual(x), sparse.csr_array(-1.0 / x[:, None])), start, np.add, "try it")


def test_hubers_function_is_the_square_up_to_its_knee_and_a_line_beyond():
    assert huber_cost(np.array([-1.0, 3.0]), 2.0) == 1.0 + 2.0 * (2.0 * 3.0 - 2.0)
    assert huber_cost(np.array([-1.0, 3.0]), np.inf) == 10.0
    r, h = np.array([0.5, 3.0, -7.0]), 1e-6
    slope = [(huber_cost(r + h * e, 2.0) - huber_cost(r - h * e, 2.0)) / (2.0 * h) for e in np.eye(3)]
    np.testing.assert_allclose(slope, 2.0 * huber(r, 2.0) ** 2 * r, rtol=1e-8)
