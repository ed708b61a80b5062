"""Spheres: through four points, and what points with covariances tell about each other and about the ball's shape."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spheremouse.geometry.least_squares.sphere import algebraic_sphere, off_sphere, out_of_round

CENTRE, RADIUS = np.array([0.3, 0.6, -0.56]), 0.6


def cap(rng, n):
    """Points of the front of a ball, and a covariance that is larger in depth and correlated between points."""
    z = rng.uniform(np.cos(1.0), 1.0, n)
    a = rng.uniform(0.0, 2.0 * np.pi, n)
    u = np.stack([np.sqrt(1 - z**2) * np.cos(a), np.sqrt(1 - z**2) * np.sin(a), z], 1)
    common = 3e-4 * np.tile([0.2, 0.1, 1.0], n)
    own = np.diag(np.tile([2e-4, 2e-4, 5e-4], n) ** 2)
    return CENTRE + RADIUS * u, own + np.outer(common, common)


def sampled(rng, points, C):
    return points + (np.linalg.cholesky(C) @ rng.standard_normal(points.size)).reshape(points.shape)


def test_a_shape_scatters_by_its_own_share_alone():
    """A round ball seems out of round once in a hundred times."""
    rng = np.random.default_rng(4)
    rough, fine = [], []
    for _ in range(100):
        points, C = cap(rng, 25)
        bumps = points + 3e-3 * rng.standard_normal((25, 1)) * (points - CENTRE) / RADIUS
        for found, true in ((rough, bumps), (fine, points)):
            observed = sampled(rng, true, C)
            found.append(out_of_round(observed, C, *algebraic_sphere(observed)))
    assert np.sqrt(np.mean(np.square(rough))) == pytest.approx(3e-3, rel=0.1)
    assert np.count_nonzero(fine) <= 5


def test_bolt_beside_the_ball_is_off_it():
    rng = np.random.default_rng(5)
    points, C = cap(rng, 25)
    points[4] *= 1.02
    observed = sampled(rng, points, C)
    blocks = np.stack([C[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] for i in range(25)])
    assert np.flatnonzero(off_sphere(observed, blocks, *algebraic_sphere(observed))).tolist() == [4]


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
