"""Least squares: against the closed form of a linear problem, against sampling, and against itself."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.stats import chi2

from spheremouse.errors import CalibrationError
from spheremouse.geometry.least_squares.adjust import (
    Normal,
    adjust,
    cofactors,
    huber,
    huber_cost,
    levenberg_marquardt,
    no_groups,
    outlier_statistic,
    redundancy,
    variance_factors,
)


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
        found = adjust(problem(A * w[:, None], b * w), np.zeros(4))
        number = redundancy(found.jacobian, cofactors(found.jacobian))[:, 0, 0]
        factors = variance_factors(found.residual, number, groups, factors)
    np.testing.assert_allclose(factors, [9.0, 0.25], rtol=0.15)


@given(seed=st.integers(0, 10**6), groups=st.integers(0, 4), damping=st.sampled_from([0.0, 1e-3, 10.0]))
@settings(max_examples=30)
def test_eliminating_local_unknowns_gives_the_step_of_the_whole_system(seed, groups, damping):
    rng = np.random.default_rng(seed)
    s, k, n = 4, 3, 12
    J = rng.standard_normal((groups, n, k))
    A, r = rng.standard_normal((groups, n, s)), rng.standard_normal((groups, n))
    more, rest = rng.standard_normal((n, s)), rng.standard_normal(n)
    whole = np.zeros(((groups + 1) * n, s + groups * k))
    for v in range(groups):
        whole[v * n : (v + 1) * n, :s] = A[v]
        whole[v * n : (v + 1) * n, s + v * k : s + (v + 1) * k] = J[v]
    whole[groups * n :, :s] = more
    residual = np.concatenate([r.ravel(), rest])
    normal = Normal(
        np.einsum("vni,vnj->ij", A, A) + more.T @ more,
        -np.einsum("vni,vn->i", A, r) - more.T @ rest,
        np.einsum("vni,vnj->vij", J, J),
        np.einsum("vni,vnj->vij", J, A),
        -np.einsum("vni,vn->vi", J, r),
    )
    move = normal.step(damping)
    N = whole.T @ whole
    expected = np.linalg.solve(N + damping * np.diag(np.diag(N)), -whole.T @ residual)
    np.testing.assert_allclose(np.concatenate([move.shared, move.own.ravel()]), expected, rtol=1e-7, atol=1e-10)
    fallen = residual @ residual - np.sum((residual + whole @ expected) ** 2)
    assert move.promised == pytest.approx(fallen, rel=1e-7)


def test_normal_equations_without_a_minimum_give_no_step():
    normal = Normal(np.diag([1.0, -1.0]), np.ones(2), np.zeros((0, 0, 0)), np.zeros((0, 0, 2)), np.zeros((0, 0)))
    assert normal.step(1e-10) is None


def test_what_has_no_rest_and_no_beginning_is_said_with_what_to_do():
    def valley(x):  # Rosenbrock's
        J = np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])
        return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]]), sparse.csr_array(J)

    np.testing.assert_allclose(adjust(valley, np.array([-1.2, 1.0])).x, [1.0, 1.0], atol=1e-8)

    def linear(x):
        r, J = valley(x)
        return float(r @ r), lambda: Normal((J.T @ J).toarray(), -J.T @ r, *no_groups(2))

    with pytest.raises(CalibrationError, match="does not come to rest: try another valley"):
        levenberg_marquardt(
            np.array([-1.2, 1.0]), linear, lambda x, move: x + move.shared, "try another valley", max_iterations=3
        )
    with pytest.raises(CalibrationError, match="has no beginning: some observation"):
        adjust(lambda x: (np.array([np.nan]), sparse.csr_array(np.ones((1, 1)))), np.zeros(1))


def test_hubers_function_is_the_square_up_to_its_knee_and_a_line_beyond():
    assert huber_cost(np.array([-1.0, 3.0]), 2.0) == 1.0 + 2.0 * (2.0 * 3.0 - 2.0)
    assert huber_cost(np.array([-1.0, 3.0]), None) == 10.0
    r, h = np.array([0.5, 3.0, -7.0]), 1e-6
    slope = [(huber_cost(r + h * e, 2.0) - huber_cost(r - h * e, 2.0)) / (2.0 * h) for e in np.eye(3)]
    np.testing.assert_allclose(slope, 2.0 * huber(r, 2.0) ** 2 * r, rtol=1e-8)
