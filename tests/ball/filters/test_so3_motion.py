"""The prediction of the motion and of its modes, against its equations in NumPy."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad

from spheremouse.ball.filters.so3_motion import KINEMATIC_DIM, integrals
from spheremouse.geometry.rotation import exp, left_jacobian
from spheremouse.native import kernels

I3 = np.eye(3)


def faded(t, tau):
    return (t, 0.5 * t * t, 1.0) if tau == np.inf else (*integrals(t, tau), np.exp(-t / tau))


@pytest.mark.parametrize("tau", [0.2, np.inf])
@pytest.mark.parametrize("rate", [0.0, 1e-9, 3.0])
def test_the_prediction_is_its_linear_model(rate, tau):
    rng = np.random.default_rng(1)
    attitude, w, a = exp(rng.normal(size=3)), rate * rng.normal(size=3), 5.0 * rng.normal(size=3)
    A, dt, q = rng.normal(size=(20, 20)), 0.04, 7.0
    P = A @ A.T
    gain, reach, fade = faded(dt, tau)
    turn = w * dt + a * reach
    F = np.eye(20)
    J = left_jacobian(turn)
    F[:9, :9] = np.block([[exp(turn), J * dt, J * reach], [0 * I3, I3, gain * I3], [0 * I3, 0 * I3, fade * I3]])

    def noise(s):
        gain, reach, fade = faded(s, tau)
        G = np.vstack([left_jacobian(turn * s / dt) * reach, gain * I3, fade * I3])
        return q * G @ G.T

    Q = np.zeros((20, 20))
    Q[:9, :9] = [[quad(lambda s, i=i, j=j: noise(s)[i, j], 0.0, dt)[0] for j in range(9)] for i in range(9)]
    R, new_w, new_a, joint, process, transition = kernels.predict(attitude, w, a, P, dt, tau, q)
    assert_allclose(R, exp(turn) @ attitude, atol=1e-14)
    assert_allclose(new_w, w + gain * a, atol=1e-12)
    assert_allclose(new_a, fade * a, atol=1e-12)
    assert_allclose(transition, F[:9, :9], atol=1e-12)
    scale = np.sqrt(np.outer(np.diag(Q[:9, :9]), np.diag(Q[:9, :9])))
    assert_allclose(process / scale, Q[:9, :9] / scale, atol=2e-3)  # three nodes
    whole = F @ P @ F.T
    whole[:9, :9] += process
    assert_allclose(joint, whole, rtol=1e-11, atol=1e-11)


def test_modes_move_with_the_transition_and_their_levels_by_the_chain():
    rng = np.random.default_rng(2)
    F, Q = rng.normal(size=(2, KINEMATIC_DIM, KINEMATIC_DIM))
    means, covariances, weights = rng.normal(size=(3, 6)), rng.normal(size=(3, 6, 6)), rng.dirichlet(np.ones(6))
    weights, drift, usual = weights.reshape(3, 2), np.array([0.1, 4.0]), np.array([0.7, 0.3])
    m, C, w = kernels.predict_modes((means, covariances, weights), F, Q, drift, 0.9, usual)
    A = F[3:, 3:]
    scale = 1.0 + weights @ drift / weights.sum(axis=1)
    assert_allclose(m, means @ A.T, atol=1e-12)
    assert_allclose(C, A @ covariances @ A.T + scale[:, None, None] * Q[3:, 3:], atol=1e-12)
    assert_allclose(w, 0.9 * weights + 0.1 * weights.sum(axis=1, keepdims=True) * usual, atol=1e-12)
