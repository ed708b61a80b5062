"""The motion of the so3 filter between two frames, and the posterior of its acceleration steps from the innovations.

A hand takes hold of the ball, pushes it, lets it go and stops it. The acceleration jumps at each of these events and is
nearly constant between them. The events are a Poisson process. Each event draws a new acceleration about zero,
independent of the last one (compound Poisson jumps). The second moments are those of Singer (1970). The instant of a
step between two frames and its size are unknown. Each pair (instant, level) is a hypothesis, and its likelihood is its
weight.
"""

import numpy as np
from numba import njit

from spheremouse.geometry.rotation import exp_into, left_jacobian_into

KINEMATIC_DIM = 9  # rotation, rate, acceleration
CONSIDERED_DIM = 10  # pose and ball
READOUT = KINEMATIC_DIM + CONSIDERED_DIM  # of the rolling shutter
MAP_OFFSET = READOUT + 1  # of the discs' errors
CLONE_DIM = 3  # at the end: of the attitude that the next motion counts from
_EVENTS = (0.25, 0.75, 1.25)  # frame intervals before the frame: the middles of the last three half intervals
_WINDOW = 1.5  # frame intervals they cover: the last frame did not yet show an event shortly before it


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
    """Return attitude, rate, acceleration and joint covariance after dt, and the process noise in that, (9, 9)."""
    F, Q = np.empty((KINEMATIC_DIM, KINEMATIC_DIM)), np.empty((KINEMATIC_DIM, KINEMATIC_DIM))
    turn, P = np.empty(3), joint.copy()
    _transition(rate, acceleration, dt, tau, q, F, Q, turn)
    _propagate(P, F, Q)
    now = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                now[i, j] += F[i, k] * attitude[k, j]
    return now, rate + F[3, 6] * acceleration, F[6, 6] * acceleration, P, Q


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
def posterior(A, v, acceleration, steps, weights):
    """Return the posterior moments of the change that steps make to rotation, rate and acceleration.

    `A` = H' S^-1 H, (9, 9), and `v` = H' S^-1 z, (9,), are the information without a step, for innovations z with
    covariance S. `acceleration` (3,), rad/s², is the predicted one. `steps` holds three values:
    - the interval since the last frame, s (0: no step),
    - the mean time between two events, s,
    - the variances of the levels, (l,), (rad/s²)² per axis; the first level is a ball left to roll, without steps.

    `weights` (l,) are the probabilities of the levels; the call replaces them by the posterior ones.

    Returns six values:
    - the mean, (9,),
    - the covariance, (9, 9),
    - the mean G of the hypotheses' covariances, (9, 9), so that G H' S^-1 is their mean gain,
    - the rms level of the steps, relative to the first level (1 without a step),
    - the log likelihood ratio of z to no step,
    - the mean normalised square of z, less z' S^-1 z.
    """
    interval, between, variances = steps
    instants, levels = len(_EVENTS), len(variances) - 1
    g, quiet = np.empty((instants, 3)), np.exp(-_WINDOW * interval / between)
    mean, covariance = np.empty((instants, levels, 3)), np.empty((instants, levels, 3, 3))
    square, log = np.empty((instants, levels)), np.empty((instants, levels))
    B, c = np.empty((3, 3)), np.empty(3)
    for s in range(instants):
        _effect(_EVENTS[s] * interval, interval, g[s])
        _seen(A, v, g[s], B, c)
        for k in range(levels):
            square[s, k], log[s, k] = _one_step(B, c, acceleration, variances[1 + k], mean[s, k], covariance[s, k])
            log[s, k] += np.log(max((1.0 - quiet) / instants * weights[1 + k], 1e-300))
    mean_square, ratio = _normalise(log, quiet, weights)
    excess = 0.0
    for k in range(levels):
        mean_square += np.sum(log[:, k]) * variances[1 + k] / variances[0]
        excess += np.sum(log[:, k] * square[:, k])
    total, spread, gain = _merged(g, log, mean, covariance)
    return total, spread, gain, np.sqrt(mean_square), ratio, excess


@njit(cache=True, error_model="numpy")
def _effect(before, interval, g):
    """Write the effect of a unit step, `before` s before a frame, on rotation, rate and acceleration into g, (3,).

    `interval` s is the time since the last frame. If the step precedes that frame, the state already includes the
    rotation until then.
    """
    g[0] = 0.5 * before * before if before < interval else interval * (before - 0.5 * interval)
    g[1], g[2] = before, 1.0


@njit(cache=True, error_model="numpy")
def _seen(A, v, g, B, c):
    """Write the information on a step with effect g, (3,), into B, (3, 3), and c, (3,).

    `A`, (9, 9), and `v`, (9,), are the information on the state.
    """
    for a in range(3):
        c[a] = g[0] * v[a] + g[1] * v[3 + a] + g[2] * v[6 + a]
        for b in range(3):
            B[a, b] = 0.0
            for i in range(3):
                for j in range(3):
                    B[a, b] += g[i] * g[j] * A[3 * i + a, 3 * j + b]


@njit(cache=True, error_model="numpy")
def _one_step(B, c, acceleration, variance, mean, covariance):
    """Write the mean, (3,), and covariance, (3, 3), of a step from `acceleration` (3,), rad/s².

    The new acceleration has mean zero and `variance`, (rad/s²)² per axis. `B`, (3, 3), and `c`, (3,), are the
    information on the step. Returns z' S^-1 z with the step less that without it, and the log likelihood ratio of the
    two. With the matrix inversion lemma no matrix is larger than 3x3 (Willsky and Jones 1976, "A generalized likelihood
    ratio approach to the detection and estimation of jumps in linear systems").
    """
    M, y = np.empty((3, 3)), np.empty(3)
    square = 0.0
    for a in range(3):
        y[a] = c[a]
        for b in range(3):
            M[a, b] = variance * B[a, b] + (1.0 if a == b else 0.0)
            y[a] += B[a, b] * acceleration[b]
        square += acceleration[a] * (c[a] + y[a])
    determinant = _inverse(M, covariance)
    for a in range(3):
        mean[a] = -acceleration[a]
        for b in range(3):
            covariance[a, b] *= variance
            mean[a] += covariance[a, b] * y[b]
        square -= y[a] * (mean[a] + acceleration[a])
    return square, -0.5 * (square + np.log(determinant))


@njit(cache=True, error_model="numpy")
def _inverse(M, out):
    """Write the inverse of M, (3, 3), symmetric and positive definite, into `out`; return the determinant."""
    for i in range(3):
        a, b = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            c, d = (j + 1) % 3, (j + 2) % 3
            out[j, i] = M[a, c] * M[b, d] - M[a, d] * M[b, c]
    determinant = M[0, 0] * out[0, 0] + M[0, 1] * out[1, 0] + M[0, 2] * out[2, 0]
    for i in range(3):
        for j in range(3):
            out[i, j] /= determinant
    return determinant


@njit(cache=True, error_model="numpy")
def _normalise(log, quiet, weights):
    """Replace `log` (i, l - 1) by probabilities of the hypotheses, and `weights` (l,) by those of the levels.

    `log` holds the log of prior times likelihood ratio. `quiet` is the probability that a level with steps has none in
    the window. Returns the probability of no step, and the log likelihood ratio of all hypotheses to no step.
    """
    none = weights[0] + quiet * (1.0 - weights[0])
    most = np.log(max(none, 1e-300))
    for s in range(len(log)):
        for k in range(log.shape[1]):
            most = max(most, log[s, k])
    total = none * np.exp(-most)
    for s in range(len(log)):
        for k in range(log.shape[1]):
            log[s, k] = np.exp(log[s, k] - most)
            total += log[s, k]
    left = np.exp(-most) / total
    weights[0] *= left
    for k in range(log.shape[1]):
        weights[1 + k] *= quiet * left
        for s in range(len(log)):
            log[s, k] /= total
            weights[1 + k] += log[s, k]
    return none * left, most + np.log(total)


@njit(cache=True, error_model="numpy")
def _merged(g, p, mean, covariance):
    """Return the mean, (9,), covariance, (9, 9), and mean covariance, (9, 9), of the mixture of hypotheses.

    `g`, (i, 3), are the effects of a unit step at each instant, and `p`, (i, l - 1), the probabilities. `mean`,
    (i, l - 1, 3), and `covariance`, (i, l - 1, 3, 3), are those of each step.
    """
    total, spread, gain = np.zeros(9), np.zeros((9, 9)), np.zeros((9, 9))
    for s in range(len(p)):
        first, within, outer = np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3))
        for level in range(p.shape[1]):
            for a in range(3):
                first[a] += p[s, level] * mean[s, level, a]
                for b in range(3):
                    within[a, b] += p[s, level] * covariance[s, level, a, b]
                    outer[a, b] += p[s, level] * mean[s, level, a] * mean[s, level, b]
        for i in range(3):
            for a in range(3):
                total[3 * i + a] += g[s, i] * first[a]
                for j in range(3):
                    for b in range(3):
                        gain[3 * i + a, 3 * j + b] += g[s, i] * g[s, j] * within[a, b]
                        spread[3 * i + a, 3 * j + b] += g[s, i] * g[s, j] * outer[a, b]
    for i in range(9):
        for j in range(9):
            spread[i, j] += gain[i, j] - total[i] * total[j]
    return total, spread, gain
