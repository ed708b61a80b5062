"""The sphere: against another way to the same minimum, and its covariances against samples."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from spheremouse.errors import CalibrationError
from spheremouse.geometry.least_squares.sphere import algebraic_sphere, fit_sphere, off_sphere

CENTRE, RADIUS = np.array([0.3, 0.6, -0.56]), 0.6


def cap(rng, n):
    """Points of the front of a ball, and a covariance that is larger in depth and correlated between points."""
    z = rng.uniform(np.cos(1.0), 1.0, n)
    a = rng.uniform(0.0, 2.0 * np.pi, n)
    u = np.stack([np.sqrt(1 - z**2) * np.cos(a), np.sqrt(1 - z**2) * np.sin(a), z], 1)
    points = CENTRE + RADIUS * u
    root = 1e-4 * rng.standard_normal((3 * n, 3 * n)) / np.sqrt(3 * n)
    common = 3e-4 * np.tile([0.2, 0.1, 1.0], n)
    own = np.diag(np.tile([2e-4, 2e-4, 5e-4], n) ** 2)
    return points, own + np.outer(common, common) + root @ root.T


def sampled(rng, points, C):
    return points + (np.linalg.cholesky(C) @ rng.standard_normal(points.size)).reshape(points.shape)


def where(n, first=0):
    return first + np.arange(3 * n).reshape(n, 3)


@given(seed=st.integers(0, 10**6))
@settings(max_examples=10)
def test_agrees_with_the_same_minimum_found_another_way(seed):
    """Unknown points held on the sphere by two angles each, fitted to the observed ones by SciPy."""
    rng = np.random.default_rng(seed)
    points, C = cap(rng, 9)
    observed = sampled(rng, points, C)
    ours = fit_sphere(observed.ravel(), C, where(9))
    assume(ours.out_of_round == 0.0)  # one sample in a hundred looks out of round, and is adjusted otherwise
    W = np.linalg.inv(np.linalg.cholesky(C))

    def residual(x):
        v = x[4:].reshape(-1, 2)
        u = np.stack([v[:, 0], v[:, 1], np.sqrt(1.0 - np.sum(v**2, axis=1))], 1)
        return W @ (x[:3] + x[3] * u - observed).ravel()

    start = np.concatenate([CENTRE, [RADIUS], ((points - CENTRE) / RADIUS)[:, :2].ravel()])
    theirs = least_squares(residual, start, x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    sigma = np.sqrt(np.diag(ours.covariance))
    np.testing.assert_allclose((np.array([*ours.centre, ours.radius]) - theirs.x[:4]) / sigma, 0.0, atol=2e-3)
    Q = np.linalg.inv(theirs.jac.T @ theirs.jac)[:4, :4]
    np.testing.assert_allclose(ours.covariance, Q, rtol=0.02, atol=1e-3 * Q.max())


@pytest.mark.slow
def test_covariances_are_the_scatter_of_samples():
    """Of centre and radius, of the adjusted points, of a bystander correlated with them, and across."""
    rng = np.random.default_rng(1)
    n = 8
    points, C = cap(rng, n)
    mix = 0.3 * rng.standard_normal((2, 3 * n))  # two more observations that share errors with the points
    full = np.block([[C, C @ mix.T], [mix @ C, mix @ C @ mix.T + 1e-8 * np.eye(2)]])
    truth = np.concatenate([points.ravel(), [5.0, -2.0]])
    L = np.linalg.cholesky(full)
    found = [fit_sphere(truth + L @ rng.standard_normal(len(truth)), full, where(n)) for _ in range(1500)]
    found = [f for f in found if f.out_of_round == 0.0]
    errors = np.array([np.concatenate([f.observations - truth, f.centre - CENTRE, [f.radius - RADIUS]]) for f in found])
    f = fit_sphere(truth, full, where(n))
    said = np.block([[f.observation_covariance, f.cross_covariance], [f.cross_covariance.T, f.covariance]])
    assert len(found) > 1400
    d = np.sqrt(np.diag(said))
    np.testing.assert_allclose(errors.std(axis=0) / d, 1.0, atol=0.08)
    np.testing.assert_allclose(np.corrcoef(errors.T), said / np.outer(d, d), atol=0.12)
    assert f.covariance[2, 3] / (d[-2] * d[-1]) < -0.9  # a cap from the front, as in Wittich 2017, table 11


def test_ball_out_of_round_is_told_and_costs_accuracy():
    rng = np.random.default_rng(4)
    points, C = cap(rng, 25)
    normal = (points - CENTRE) / RADIUS
    bumps = points + 3e-3 * rng.standard_normal((25, 1)) * normal
    rough, fine = (fit_sphere(sampled(rng, p, C).ravel(), C, where(25)) for p in (bumps, points))
    assert fine.out_of_round == 0.0
    assert rough.out_of_round == pytest.approx(3e-3, rel=0.5)
    assert rough.covariance[3, 3] > 4.0 * fine.covariance[3, 3]


def test_bolt_beside_the_ball_is_off_it():
    rng = np.random.default_rng(5)
    points, C = cap(rng, 12)
    points[4] *= 1.02
    observed = sampled(rng, points, C)
    f = fit_sphere(observed.ravel(), C, where(12))
    blocks = np.stack([C[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] for i in range(12)])
    off = off_sphere(observed, blocks, f)
    assert off[4] or np.argmax(np.abs(f.distance)) == 4


@given(seed=st.integers(0, 10**6))
@settings(max_examples=30)
def test_four_points_fix_a_sphere(seed):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((4, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    if np.linalg.svd(u[1:] - u[0], compute_uv=False)[2] < 0.05:
        return
    centre, radius = algebraic_sphere(CENTRE + RADIUS * u)
    np.testing.assert_allclose([*centre, radius], [*CENTRE, RADIUS], atol=1e-9)


def test_points_in_a_plane_fix_none():
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    assert np.isnan(algebraic_sphere(flat)[1])


@pytest.mark.parametrize("n", [0, 4])
def test_too_few_points_are_refused(n):
    points, C = cap(np.random.default_rng(6), max(n, 1))
    with pytest.raises(CalibrationError, match=f"{n} discs"):
        fit_sphere(points[:n].ravel(), C[: 3 * n, : 3 * n], where(n))
