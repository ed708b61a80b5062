"""Rotations, pairs, and statistics."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.testing import assert_allclose
from scipy import stats
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from spheremouse.geometry.matching import assign, mutual_nearest, suppress
from spheremouse.geometry.rotation import (
    align,
    euler_rate_matrix,
    exp,
    from_euler,
    hat,
    left_jacobian,
    log,
    tangent_basis,
    to_euler,
)
from spheremouse.geometry.statistics import gate, is_nonzero, mad_sigma, poisson_tail, ratio_gate


def vectors(limit):
    """Vectors of length up to `limit` rad, short ones among them."""
    length = st.one_of(st.floats(0.0, limit), st.floats(0.0, 1e-5))
    angle = st.floats(-np.pi, np.pi)
    return st.builds(
        lambda s, a, z: s * np.array([np.sqrt(1 - z * z) * np.cos(a), np.sqrt(1 - z * z) * np.sin(a), z]),
        length,
        angle,
        st.floats(-1.0, 1.0),
    )


angles = st.tuples(*[st.floats(-3.2, 3.2)] * 3).map(np.array)


def random_units(n):
    v = np.random.default_rng(1).normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


@given(vectors(10.0), vectors(10.0))
def test_hat_is_the_cross_product(a, b):
    assert_allclose(hat(a) @ b, np.cross(a, b), atol=1e-13)
    assert_allclose(hat(a).T, -hat(a))


@given(vectors(10.0))
def test_exp_is_scipys_rotation_vector(v):
    assert_allclose(exp(v), Rotation.from_rotvec(v).as_matrix(), atol=1e-14)


@given(vectors(np.pi - 1e-6))
def test_log_inverts_exp(v):
    assert_allclose(log(exp(v)), v, atol=1e-14, rtol=1e-9)


@pytest.mark.parametrize("short_of_pi", [1e-2, 1e-5, 1e-8, 1e-11, 0.0])
def test_log_keeps_its_precision_near_pi(short_of_pi):
    axis = np.concatenate([random_units(200), np.eye(3), -np.eye(3)])
    R = exp((np.pi - short_of_pi) * axis)
    v = log(R)
    assert_allclose(exp(v), R, atol=5e-15)
    assert_allclose(np.linalg.norm(v, axis=1), np.pi - short_of_pi, atol=1e-14)
    assert_allclose(np.abs(np.sum(v * axis, axis=1)), np.pi - short_of_pi, atol=1e-14)  # at pi the sign is free


@pytest.mark.parametrize("length", [0.0, 1e-300, 1e-160, 1e-12, 1e-7, 0.99e-6, 1.01e-6, 1e-5])
def test_log_keeps_its_relative_precision_near_zero(length):
    v = length * random_units(50)
    assert_allclose(log(exp(v)), v, rtol=1e-9, atol=1e-17 if length else 0.0)


@given(vectors(6.0))
def test_left_jacobian_is_the_derivative_of_exp(v):
    h = 1e-6
    J = np.stack([log(exp(v + d) @ exp(v - d).T) / (2 * h) for d in h * np.eye(3)], axis=1)
    assert_allclose(left_jacobian(v), J, atol=1e-8)


@pytest.mark.parametrize("length", [1e-9, 0.99e-4, 1.01e-4, 1e-3])
def test_left_jacobian_is_its_series_for_small_vectors(length):
    for v in length * random_units(20):
        k = hat(v)
        k2 = k @ k
        series = np.eye(3) + k / 2 + k2 / 6 + k2 @ k / 24 + k2 @ k2 / 120
        assert_allclose(left_jacobian(v), series, rtol=0, atol=1e-15)


@given(angles)
def test_euler_angles_are_scipys_intrinsic_xyz_and_come_back(a):
    R = from_euler(a)
    assert_allclose(R, Rotation.from_euler("XYZ", a).as_matrix(), atol=1e-14)
    b = to_euler(R)
    assert abs(b[1]) <= np.pi / 2
    assert_allclose(from_euler(b), R, atol=3e-9)  # near phi = 90 deg kappa is set to 0 within 1e-9
    if abs(abs(b[1]) - np.pi / 2) > 1e-3:
        turn = b - Rotation.from_matrix(R).as_euler("XYZ")
        assert_allclose(turn - 2 * np.pi * np.round(turn / (2 * np.pi)), 0.0, atol=1e-11)  # pi is -pi


@pytest.mark.parametrize("phi", [np.pi / 2, -np.pi / 2])
def test_euler_angles_at_the_singularity_still_give_the_rotation(phi):
    R = from_euler(np.array([0.7, phi, 0.4]))
    b = to_euler(R)
    assert b[2] == 0.0
    assert_allclose(from_euler(b), R, atol=1e-14)


@given(angles, st.tuples(*[st.floats(-5.0, 5.0)] * 3).map(np.array))
def test_euler_rate_matrix_gives_the_angular_velocity_in_obj(a, a_dot):
    h = 1e-6
    w = log(from_euler(a + h * a_dot) @ from_euler(a - h * a_dot).T) / (2 * h)
    assert_allclose(euler_rate_matrix(a) @ a_dot, w, atol=1e-8)


def test_tangent_basis_is_orthonormal_everywhere():
    u = np.concatenate([random_units(500), np.eye(3), -np.eye(3), [[1.0, 0.0, -0.0], [1e-9, 0.0, -1.0]]])
    B = tangent_basis(u)
    full = np.concatenate([B, u[:, :, None]], axis=2)
    assert_allclose(full.transpose(0, 2, 1) @ full, np.broadcast_to(np.eye(3), full.shape), atol=1e-14)
    assert_allclose(np.linalg.det(full), 1.0)


@given(vectors(np.pi), st.integers(0, 10_000))
def test_align_is_scipys_align_vectors(v, seed):
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(8, 3))
    b = a @ exp(v).T + 0.05 * rng.normal(size=(8, 3))
    w = rng.uniform(0.1, 2.0, 8)
    assert_allclose(align(a, b), Rotation.align_vectors(b, a)[0].as_matrix(), atol=1e-9)
    assert_allclose(align(a, b, w), Rotation.align_vectors(b, a, weights=w)[0].as_matrix(), atol=1e-9)


costs = hnp.array_shapes(min_dims=2, max_dims=2, min_side=0, max_side=5).flatmap(
    lambda shape: hnp.arrays(float, shape, elements=st.floats(0.0, 10.0) | st.sampled_from([np.inf, np.nan]))
)


@given(costs, st.floats(0.5, 8.0))
def test_assignment_minimises_the_cost_if_each_row_may_stay_alone_for_the_gate(cost, gate):
    rows, columns = assign(cost, gate)
    assert len(set(rows)) == len(rows) == len(columns) == len(set(columns))
    assert np.all(cost[rows, columns] < gate)
    least = np.minimum(np.nan_to_num(cost, nan=np.inf), gate)
    total = cost[rows, columns].sum() + (min(cost.shape) - len(rows)) * gate
    assert_allclose(total, least[linear_sum_assignment(least)].sum(), atol=1e-9)


def test_mutual_nearest_pairs_are_each_other_s_nearest():
    distance = np.random.default_rng(0).random((7, 9))
    distance[2] = np.inf
    columns = mutual_nearest(distance)
    for i, j in np.ndindex(distance.shape):
        assert (columns[i] == j) == (i != 2 and distance[i, j] == distance[i].min() == distance[:, j].min())
    assert np.count_nonzero(columns >= 0) > 2
    assert len(mutual_nearest(distance[:0])) == 0
    assert np.all(mutual_nearest(distance[:, :0]) == -1)


@pytest.mark.parametrize("norm", [2.0, np.inf])
def test_suppression_keeps_the_first_of_each_neighbourhood(norm):
    points = np.random.default_rng(0).random((60, 2))
    radius = np.linspace(0.05, 0.2, 60)
    kept = suppress(points, radius, norm).tolist()
    assert 10 < len(kept) < 60
    for i in range(60):
        hidden = any(np.linalg.norm(points[i] - points[k], norm) <= radius[k] for k in kept if k < i)
        assert (i in kept) != hidden
    assert len(suppress(points[:0], radius[:0])) == 0


def test_the_sigma_is_that_of_the_errors_however_gross_some_are():
    errors = np.random.default_rng(2).normal(size=(100000, 2)) * [0.5, 3.0]
    assert mad_sigma(errors) == pytest.approx([0.5, 3.0], rel=0.02)
    errors[::50] *= 1e6
    assert mad_sigma(errors) == pytest.approx([0.5, 3.0], rel=0.05)
    assert mad_sigma(errors[:, 0]) == mad_sigma(errors)[0]


@pytest.mark.parametrize("mean", [0.0, 0.3, 2.0, 30.0])
def test_the_tail_of_a_poisson_variable_is_that_of_scipy(mean):
    k = np.arange(-1, 60)
    assert_allclose([poisson_tail(int(i), mean) for i in k], stats.poisson.sf(k, mean), atol=1e-14)


def test_gates_are_quantiles():
    for p, dof in ((0.999, 1.0), (0.999, 2.0), (0.5, 7.0), (1.0 - 1e-9, 40.0)):
        assert_allclose(gate(p, dof), stats.chi2.ppf(p, dof), rtol=1e-7)
        assert_allclose(ratio_gate(p, dof, 12.0), stats.f.ppf(p, dof, 12.0), rtol=1e-6)


def test_one_zero_vector_in_ten_thousand_counts_as_nonzero():
    """In any direction: its squared Mahalanobis distance is a chi-square with 3 degrees of freedom."""
    root = np.random.default_rng(0).normal(size=(3, 3))
    for direction in np.vstack([np.eye(3), np.full(3, 3**-0.5)]):
        for p, nonzero in ((0.99989, False), (0.99991, True)):
            vector = np.sqrt(gate(p, 3.0)) * root @ direction
            assert is_nonzero(vector, root @ root.T) == nonzero
