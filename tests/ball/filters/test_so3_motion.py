"""The prediction of the motion and of its modes, against its equations in NumPy."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad

from spheremouse.ball.filters.so3_motion import integrals
from spheremouse.geometry.rotation import exp, left_jacobian
from spheremouse.native import kernels

I3, BETWEEN = np.eye(3), 0.2


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
    R, new_w, new_a, joint = kernels.predict_motion(attitude, w, a, P, dt, tau, q)
    assert_allclose(R, exp(turn) @ attitude, atol=1e-14)
    assert_allclose(new_w, w + gain * a, atol=1e-12)
    assert_allclose(new_a, fade * a, atol=1e-12)
    scale = np.sqrt(np.outer(np.diag(Q[:9, :9]), np.diag(Q[:9, :9])))
    whole = F @ P @ F.T
    assert_allclose((joint - whole)[:9, :9] / scale, Q[:9, :9] / scale, atol=2e-3)  # three nodes
    joint[:9, :9] = whole[:9, :9]
    assert_allclose(joint, whole, rtol=1e-11, atol=1e-11)


def drawn(rng):
    """Draw a ball of two discs, three modes, and a player of two levels."""
    A, discs = rng.normal(size=(27, 27)), np.eye(3)[:2]
    rates = rng.normal(size=(2, 3))
    motion = exp(rng.normal(size=3)), *rates
    body = *motion, discs, np.zeros((2, 3, 2)), A @ A.T, 0.0, np.zeros(4), 2, False, 0, np.zeros(3)
    means, covariances, weights = rng.normal(size=(3, 6)), rng.normal(size=(3, 6, 6)), rng.dirichlet(np.ones(6))
    weights = weights.reshape(3, 2)
    pending = np.zeros((9, 9)), 0.0, weights.sum(axis=0), (means, covariances, weights)
    variances = np.array([0.5, 20.0])
    return body, pending, (13.8, BETWEEN, 1.0, variances, np.array([0.1, 4.0]), np.array([0.7, 0.3]))


def test_modes_move_with_the_transition_and_their_levels_by_the_chain():
    body, pending, activity = drawn(np.random.default_rng(2))
    means, covariances, weights = pending[3]
    *_, process, interval, (m, C, w) = kernels.predict(body, pending, 0.05, activity)
    A = np.block([[I3, 0.05 * I3], [0.0 * I3, I3]])
    scale = 1.0 + weights @ activity[4] / weights.sum(axis=1)
    stay = np.exp(-0.05)
    assert interval == 0.05
    assert_allclose(m, means @ A.T, atol=1e-12)
    assert_allclose(C, A @ covariances @ A.T + scale[:, None, None] * process[3:, 3:], atol=1e-12)
    assert_allclose(w, stay * weights + (1.0 - stay) * weights.sum(axis=1, keepdims=True) * activity[5], atol=1e-12)


@pytest.mark.parametrize("dt", [0.0, 0.03, 0.1, 1.0])
def test_steps_fade_the_acceleration_until_the_last_part_of_a_gap(dt):
    body, pending, activity = drawn(np.random.default_rng(3))
    weights, last = pending[2], min(dt, 0.5 * BETWEEN)
    _, _, _, variances, drift, usual = activity
    density = 2.0 * variances[0] / BETWEEN
    motion = *body[:3], body[5]
    if dt > last:
        faded = density * weights @ variances / variances[0]
        motion = kernels.predict_motion(*motion, dt - last, BETWEEN, faded)
    motion = kernels.predict_motion(*motion, last, np.inf, density * (1.0 + weights @ drift))
    *got, at_level, process, interval, modes = kernels.predict(body, pending, dt, activity)
    for value, expected in zip(got, motion, strict=True):
        assert_allclose(value, expected, rtol=1e-12, atol=1e-12)
    rest = kernels.predict_motion(*body[:3], np.zeros((23, 23)), last, np.inf, density)[3]
    assert_allclose(process[3:, 3:], rest[3:9, 3:9], rtol=1e-12, atol=1e-15)  # of rate and acceleration
    assert_allclose(at_level, np.exp(-dt) * weights + (1.0 - np.exp(-dt)) * usual, rtol=1e-12)
    assert interval == last
    assert (modes is None) == (dt > last)
