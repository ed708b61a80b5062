"""Steps of the acceleration: the moments of the mixture against plain conditioning, hypothesis by hypothesis."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

from spheremouse.ball.filters import so3_steps

DT = 1.0 / 30.0
BETWEEN = 0.2
VARIANCES = np.array([0.1, 2.0, 30.0]) ** 2


def effect(before):
    """Effect of a unit step, `before` intervals before the frame, on rotation, rate and acceleration, (9, 3)."""
    t = before * DT
    return np.kron(np.array([[0.5 * t * t], [t], [1.0]]), np.eye(3))


def conditioned(H, N, R, z, acceleration, root, modes):
    """Moments of (x, d), new modes, and the likelihood of z, one hypothesis after the other."""
    quiet = np.exp(-DT / BETWEEN)
    inverse = np.linalg.inv(root)
    terms = []
    for mean, covariance, weights in zip(*modes, strict=True):
        m, C = inverse @ mean, inverse @ covariance @ inverse.T
        for level, weight in enumerate(weights):
            terms.append((0, level, weight * (quiet if level else 1.0), np.r_[m, np.zeros(9)], C, np.zeros((9, 9))))
            for before in so3_steps.INSTANTS if level else ():
                g, share = effect(before), (1.0 - quiet) / len(so3_steps.INSTANTS) * weight
                d = -g @ (acceleration + mean[3:])
                terms.append((level, level, share, np.r_[m, d], C, VARIANCES[level] * g @ g.T))
    G, p, means, covariances = np.hstack([N, H]), np.empty(len(terms)), [], []
    for i, (_, _, share, m, C, D) in enumerate(terms):
        P = np.block([[C, np.zeros((6, 9))], [np.zeros((9, 6)), D]])
        S = R + G @ P @ G.T
        K = P @ G.T @ np.linalg.inv(S)
        p[i] = share * multivariate_normal.pdf(z - G @ m, cov=S)
        means.append(m + K @ (z - G @ m))
        covariances.append(P - K @ G @ P)
    likelihood, p, means, covariances = p.sum(), p / p.sum(), np.array(means), np.array(covariances)
    to_motion = np.hstack([root, np.zeros((6, 3)), np.eye(6)])
    total, covariance = moments(p, means, covariances)
    new = []
    for mode in range(len(VARIANCES)):
        own = np.array([term[0] == mode for term in terms])
        y, Y = moments(p[own] / p[own].sum(), means[own], covariances[own])
        weights = [sum(p[i] for i in np.flatnonzero(own) if terms[i][1] == level) for level in range(len(VARIANCES))]
        new.append((to_motion @ (y - total), to_motion @ Y @ to_motion.T, weights))
    return total, covariance, new, likelihood


def moments(p, means, covariances):
    mean = p @ means
    return mean, np.einsum("k,kij->ij", p, covariances) + (means - mean).T @ (p[:, None] * (means - mean))


def drawn(rng, far):
    """A prediction with three modes, `far` standard deviations apart, and innovations."""
    H = rng.normal(size=(8, 9)) * np.repeat([1.0, 0.005, 1e-5], 3)
    sd = np.repeat([0.02, 0.5], 3)
    root = np.linalg.cholesky(np.diag(sd) @ (np.eye(6) + 0.3) @ np.diag(sd))
    covariances = np.array([share * root @ root.T for share in (0.05, 0.1, 0.2)])
    modes = (far * rng.normal(size=(3, 6)) @ root.T, covariances, rng.dirichlet(np.ones(9)).reshape(3, 3))
    N = H[:, :6] @ np.kron(np.array([[DT, 0.5 * DT * DT], [0.0, 0.0]]), np.eye(3)) @ root
    R = 1e-8 * (np.eye(8) + 0.3 * np.ones((8, 8)))
    return (
        H,
        N,
        R,
        1e-4 * rng.normal(size=8) + H[:, :3] @ (2e-3 * rng.normal(size=3)),
        5.0 * rng.normal(size=3),
        root,
        modes,
    )


@pytest.mark.parametrize("far", [0.0, 0.3, 1.0])
def test_the_moments_are_those_of_conditioning_each_hypothesis(far):
    """Within what the hypotheses below a thousandth of their mode add, which are left out."""
    rng = np.random.default_rng(1)
    for _ in range(10):
        H, N, R, z, acceleration, root, modes = drawn(rng, far)
        total, covariance, new, likelihood = conditioned(H, N, R, z, acceleration, root, modes)
        G = np.linalg.solve(np.linalg.cholesky(R), np.column_stack([N, H, z]))
        found = so3_steps.posterior(G.T @ G, root, acceleration, (DT, BETWEEN, VARIANCES), modes)
        scale = np.sqrt(np.diag(covariance))
        assert_allclose(found[0] / scale, total / scale, atol=1e-2)
        assert_allclose(found[1] / np.outer(scale, scale), covariance / np.outer(scale, scale), atol=0.1)
        log_none = -0.5 * (z @ np.linalg.inv(R) @ z + np.linalg.slogdet(2.0 * np.pi * R)[1])
        assert_allclose(found[4] + log_none, np.log(likelihood), atol=2e-2)
        for k, (mean, spread, weights) in enumerate(new):
            assert_allclose(found[2][2][k], weights, atol=5e-3)
            if sum(weights) > 1e-2:
                scale = np.sqrt(np.diag(spread))
                assert_allclose(found[2][0][k] / scale, mean / scale, atol=0.1)
                assert_allclose(found[2][1][k] / np.outer(scale, scale), spread / np.outer(scale, scale), atol=0.1)


def test_without_an_interval_there_is_no_step():
    modes = (np.zeros((1, 6)), np.eye(6)[None], np.array([[0.5, 0.3, 0.2]]))
    steps = (0.0, BETWEEN, VARIANCES)
    mean, covariance, new, level, *_ = so3_steps.posterior(np.eye(16), np.eye(6), np.ones(3), steps, modes)
    assert not np.any(np.abs(mean[so3_steps.STEP]) > 1e-12)
    assert not np.any(np.abs(covariance[so3_steps.STEP]) > 1e-12)
    assert_allclose(new[2].sum(axis=0), [0.5, 0.3, 0.2])
    assert level == 1.0
