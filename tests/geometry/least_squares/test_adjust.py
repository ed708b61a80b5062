"""Least squares: against the closed form of a linear problem, against sampling, and against itself."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.stats import chi2

from spheremouse.geometry.least_squares.adjust import adjust, cofactors
from spheremouse.geometry.least_squares.reliability import redundancy, snooped, variance_factors


def linear(rng, n=40, u=5, sigma=0.1):
    A, x = rng.standard_normal((n, u)), rng.standard_normal(u)
    b = A @ x + sigma * rng.standard_normal(n)
    return A / sigma, x, b / sigma


def problem(A, b):
    return lambda x: (A @ x - b, sparse.csr_array(A))


@given(seed=st.integers(0, 10**6), u=st.integers(1, 8))
@settings(max_examples=20)
def test_linear_problem_has_its_closed_form(seed, u):
    A, _, b = linear(np.random.default_rng(seed), u=u)
    found = adjust(problem(A, b), np.zeros(u))
    np.testing.assert_allclose(found.x, np.linalg.lstsq(A, b, rcond=None)[0], atol=1e-7)
    Q = cofactors(found.jacobian)
    np.testing.assert_allclose(Q, np.linalg.inv(A.T @ A), rtol=1e-8)
    columns = np.array([0, u - 1])
    np.testing.assert_allclose(cofactors(found.jacobian, columns), Q[np.ix_(columns, columns)], rtol=1e-8)
    assert redundancy(found.jacobian, Q).sum() == pytest.approx(len(b) - u)


def test_nonlinear_problem_reaches_the_truth():
    t = np.linspace(0.0, 2.0, 30)

    def evaluate(x):
        e = np.exp(-x[1] * t)
        return (x[0] * e - 3.0 * np.exp(-0.7 * t)) / 0.01, sparse.csr_array(np.stack([e, -x[0] * t * e], 1) / 0.01)

    np.testing.assert_allclose(adjust(evaluate, np.array([1.0, 0.1])).x, [3.0, 0.7], atol=1e-8)


def test_robust_adjustment_bears_one_observation_in_ten_that_is_false():
    rng = np.random.default_rng(2)
    A, x, b = linear(rng, 60, 4)
    b[::10] += 500.0
    plain, robust = adjust(problem(A, b), np.zeros(4)).x, adjust(problem(A, b), np.zeros(4), robust=2.0).x
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


@pytest.mark.parametrize("u", [2, 3, 5])
def test_singular_to_the_last_digit_is_named_all_the_same(u):
    A = np.tile(np.arange(1.0, 5.0)[:, None], (1, u))
    with pytest.raises(np.linalg.LinAlgError):
        cofactors(sparse.csr_array(A))


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
        values.append(snooped(v.reshape(-1, 2), cofactor))
    share = np.mean(np.array(values) > chi2.ppf(0.95, 2))
    assert 0.04 < share < 0.06  # 4800 values: 0.003 of standard deviation


def test_false_observation_has_the_largest_normalised_residual():
    rng = np.random.default_rng(5)
    A, _, b = linear(rng, 24, 5)
    b[7] += 12.0
    found = adjust(problem(A, b), np.zeros(5))
    test = snooped(found.residual.reshape(-1, 2), redundancy(found.jacobian, cofactors(found.jacobian), 2))
    assert np.argmax(test) == 3


def test_variance_factors_find_what_each_group_is_off():
    rng = np.random.default_rng(6)
    A, x, _ = linear(rng, 2000, 4, 1.0)
    sigma = np.where(np.arange(2000) < 1000, 3.0, 0.5)
    b = A @ x + sigma * rng.standard_normal(2000)
    groups = [np.arange(2000) < 1000, np.arange(2000) >= 1000]
    factors = np.ones(2)
    for _ in range(5):
        w = np.where(groups[0], factors[0], factors[1]) ** -0.5
        found = adjust(problem(A * w[:, None], b * w), np.zeros(4))
        number = redundancy(found.jacobian, cofactors(found.jacobian))[:, 0, 0]
        factors = variance_factors(found.residual, number, groups, factors)
    np.testing.assert_allclose(factors, [9.0, 0.25], rtol=0.15)


def test_variance_factor_of_few_observations_stays_near_one():
    assert variance_factors(np.array([5.0]), np.array([1.0]), [np.array([True])])[0] == pytest.approx(35.0 / 9.0)
