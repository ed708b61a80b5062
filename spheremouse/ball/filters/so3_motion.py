"""The motion of the so3 filter between two frames, under an acceleration that lasts or fades."""

import numpy as np
from numba import njit

from spheremouse.geometry.rotation import exp_into, left_jacobian_into

KINEMATIC_DIM = 9  # rotation, rate, acceleration
CONSIDERED_DIM = 10  # pose and ball
READOUT = KINEMATIC_DIM + CONSIDERED_DIM  # of the rolling shutter
MAP_OFFSET = READOUT + 1  # of the discs' errors
CLONE_DIM = 3  # at the end: of the attitude that the next motion counts from


@njit(cache=True, error_model="numpy")
def _propagate(P, F, Q):
    """Compute P = F P F' + Q in place, where F and Q, (9, 9), concern the core alone."""
    n = len(P)
    top = np.zeros((KINEMATIC_DIM, n))
    for i in range(KINEMATIC_DIM):
        for k in range(KINEMATIC_DIM):
            f = F[i, k]
            if f != 0.0:
                for j in range(n):
                    top[i, j] += f * P[k, j]
    for i in range(KINEMATIC_DIM):
        for j in range(i + 1):
            value = Q[i, j]
            for k in range(KINEMATIC_DIM):
                value += top[i, k] * F[j, k]
            P[i, j] = value
            P[j, i] = value
        for j in range(KINEMATIC_DIM, n):
            P[i, j] = top[i, j]
            P[j, i] = top[i, j]


@njit(cache=True, error_model="numpy")
def predict(attitude, rate, acceleration, joint, dt, tau, q):
    """Return attitude, rate, acceleration, joint covariance, process noise in that (9, 9) and transition (9, 9)."""
    F, Q = np.empty((KINEMATIC_DIM, KINEMATIC_DIM)), np.empty((KINEMATIC_DIM, KINEMATIC_DIM))
    turn, P = np.empty(3), joint.copy()
    _transition(rate, acceleration, dt, tau, q, F, Q, turn)
    _propagate(P, F, Q)
    now = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                now[i, j] += F[i, k] * attitude[k, j]
    return now, rate + F[3, 6] * acceleration, F[6, 6] * acceleration, P, Q, F


@njit(cache=True, error_model="numpy")
def _transition(rate, acceleration, dt, tau, q, F, Q, turn):
    """Compute F and Q, (9, 9), and the turn, (3,) rad, of a step dt under an acceleration that fades with `tau`.

    Q is the process noise of white jerk of density q (three nodes of Gauss-Legendre). A unit of jerk s before the end
    leaves an acceleration g_a, a rate g_w, and a turn Jl(turn s/dt) g_t of the ball.
    """
    gain, reach = integrals(dt, tau)
    R, J = np.empty((3, 3)), np.empty((3, 3))
    part = np.empty(3)
    for i in range(3):
        turn[i] = rate[i] * dt + reach * acceleration[i]
    exp_into(turn, R)
    left_jacobian_into(turn, J)
    F[:] = 0.0
    Q[:] = 0.0
    for i in range(3):
        for j in range(3):
            F[i, j] = R[i, j]
            F[i, 3 + j] = J[i, j] * dt
            F[i, 6 + j] = J[i, j] * reach
        F[3 + i, 3 + i] = 1.0
        F[3 + i, 6 + i] = gain
        F[6 + i, 6 + i] = np.exp(-dt / tau)
    for node in range(3):
        at = 0.5 + np.sqrt(0.15) * (node - 1)
        weight = q * dt * (8.0 if node == 1 else 5.0) / 18.0
        g_a = np.exp(-at * dt / tau)
        g_w, g_t = integrals(at * dt, tau)
        for i in range(3):
            part[i] = at * turn[i]
        left_jacobian_into(part, J)
        for i in range(3):
            for j in range(3):
                tt = 0.0
                for k in range(3):
                    tt += J[i, k] * J[j, k]
                Q[i, j] += weight * g_t * g_t * tt
                Q[i, 3 + j] += weight * g_t * g_w * J[i, j]
                Q[i, 6 + j] += weight * g_t * g_a * J[i, j]
            Q[3 + i, 3 + i] += weight * g_w * g_w
            Q[3 + i, 6 + i] += weight * g_w * g_a
            Q[6 + i, 6 + i] += weight * g_a * g_a
    for i in range(KINEMATIC_DIM):
        for j in range(i):
            Q[i, j] = Q[j, i]


@njit(cache=True, error_model="numpy")
def integrals(t, tau):
    """Return the integrals over t of exp(-t/tau), first and second: rate and turn by a unit acceleration that fades."""
    if t < 1e-3 * tau:  # an acceleration that lasts
        return t * (1.0 - 0.5 * t / tau), 0.5 * t * t * (1.0 - t / (3.0 * tau))
    gain = -tau * np.expm1(-t / tau)
    return gain, tau * (t - gain)


@njit(cache=True, error_model="numpy")
def predict_modes(means, covariances, weights, F, Q, drift, stay, usual):
    """Return means (j, 6), covariances (j, 6, 6) and weights (j, l) of the modes after a prediction.

    `F` is its transition and `Q` its process noise at the first level, (9, 9). At level k the noise is 1 + `drift`[k]
    times as large. A level stays with the probability `stay`; else the levels have the probabilities `usual`, (l,).
    """
    gain, fade = F[3, 6], F[6, 6]
    m, C, w = means.copy(), covariances.copy(), weights.copy()
    for j in range(len(m)):
        likely, q = 1e-300, 0.0
        for k in range(len(usual)):
            likely += weights[j, k]
            q += weights[j, k] * drift[k]
        q = 1.0 + q / likely
        for k in range(len(usual)):
            w[j, k] = stay * weights[j, k] + (1.0 - stay) * likely * usual[k]
        for a in range(3):
            m[j, a] += gain * m[j, 3 + a]
            m[j, 3 + a] *= fade
            for b in range(6):  # F C
                C[j, a, b] += gain * C[j, 3 + a, b]
                C[j, 3 + a, b] *= fade
        for a in range(6):
            for b in range(3):  # F C F' + Q
                C[j, a, b] += gain * C[j, a, 3 + b] + q * Q[3 + a, 3 + b]
                C[j, a, 3 + b] = fade * C[j, a, 3 + b] + q * Q[3 + a, 6 + b]
    return m, C, w
