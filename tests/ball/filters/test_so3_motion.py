"""Steps of the acceleration: the moments of the mixture against plain conditioning, hypothesis by hypothesis."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

from spheremouse.ball.filters import so3_motion

DT = 1.0 / 30.0
VARIANCES = np.array([0.1, 2.0, 30.0]) ** 2
EVENTS = {0.25: 0.5 * 0.25**2, 0.75: 0.5 * 0.75**2, 1.25: 0.75}  # intervals before the frame: effect on the turn


def conditioned(H, S, z, acceleration, interval, between, weights):
    """Mean and covariance of what steps add, probabilities of the levels and likelihood, hypothesis by hypothesis."""
    quiet = np.exp(-1.5 * interval / between)
    terms = [(0, weights[0], np.zeros(9), np.zeros((9, 9)))]
    for level in range(1, len(VARIANCES)):
        terms.append((level, quiet * weights[level], np.zeros(9), np.zeros((9, 9))))
        for before, turn in EVENTS.items():
            G = np.kron(np.array([[turn * interval**2], [before * interval], [1.0]]), np.eye(3))
            share = (1.0 - quiet) / len(EVENTS) * weights[level]
            terms.append((level, share, -G @ acceleration, VARIANCES[level] * G @ G.T))
    p, means, covariances = np.empty(len(terms)), [], []
    for k, (_, share, m, D) in enumerate(terms):
        T = S + H @ D @ H.T
        K = D @ H.T @ np.linalg.inv(T)
        p[k] = share * multivariate_normal.pdf(z - H @ m, cov=T)
        means.append(m + K @ (z - H @ m))
        covariances.append(D - K @ H @ D)
    likelihood, p, means = p.sum(), p / p.sum(), np.array(means)
    mean = p @ means
    covariance = np.einsum("k,kij->ij", p, covariances) + (means - mean).T @ (p[:, None] * (means - mean))
    levels = np.array([sum(q for q, t in zip(p, terms, strict=True) if t[0] == level) for level in range(3)])
    return mean, covariance, levels, likelihood


@pytest.mark.parametrize("delayed", [False, True])
def test_the_moments_are_those_of_conditioning_each_hypothesis(delayed):
    rng = np.random.default_rng(1)
    for _ in range(20):
        H = rng.normal(size=(8, 9)) * np.repeat([1.0, 0.005 * delayed, 1e-5 * delayed], 3)
        S = 1e-8 * (np.eye(8) + 0.3 * np.ones((8, 8)))
        acceleration, weights = 5.0 * rng.normal(size=3), rng.dirichlet(np.ones(3))
        z = 1e-4 * rng.normal(size=8) + H[:, :3] @ (2e-3 * rng.normal(size=3))
        mean, covariance, levels, likelihood = conditioned(H, S, z, acceleration, DT, 0.2, weights)
        Si = np.linalg.inv(S)
        found = so3_motion.posterior(H.T @ Si @ H, H.T @ Si @ z, acceleration, (DT, 0.2, VARIANCES), weights)
        scale = np.sqrt(np.diag(covariance))
        assert_allclose(found[0] / scale, mean / scale, atol=1e-4)
        assert_allclose(found[1] / np.outer(scale, scale), covariance / np.outer(scale, scale), atol=1e-4)
        assert_allclose(weights, levels, atol=1e-9)
        log_no_step = -0.5 * (z @ Si @ z + np.linalg.slogdet(2.0 * np.pi * S)[1])
        assert_allclose(found[4] + log_no_step, np.log(likelihood), atol=1e-4)


def test_without_an_interval_there_is_no_step():
    weights = np.array([0.5, 0.3, 0.2])
    mean, covariance, *_ = so3_motion.posterior(np.eye(9), np.ones(9), np.ones(3), (0.0, 0.2, VARIANCES), weights)
    assert not np.any(np.abs(mean) > 1e-12)
    assert not np.any(np.abs(covariance) > 1e-12)
    assert_allclose(weights, [0.5, 0.3, 0.2])
