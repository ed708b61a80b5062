"""The correction step of the default filter, compiled.

The errors have this order:
- rotation (3, rad, obj), rate (3, rad/s), acceleration (3, rad/s²),
- the considered parameters: pose of the camera (6), ball's centre and radius (4),
- the rolling shutter's time (s),
- two for each disc in its own tangent axes (rad),
- the reference, from whose attitude the next increment counts (3, rad, obj).
"""

import numpy as np
from numba import njit

from spheremouse.ball.filters import so3_motion
from spheremouse.ball.filters.so3_motion import CLONE_DIM, KINEMATIC_DIM, MAP_OFFSET, READOUT
from spheremouse.geometry.rotation import exp_into, left_jacobian_into


@njit(cache=True, error_model="numpy")
def correct(prior, H, HP, z, S, rate, acceleration, steps, weights):
    """Return covariance (n, n), level weights (l,), correction (n,), log likelihood, normalised square and rms level.

    `prior` is the covariance before. H (2k, n), H P (2k, n), z (2k,) and S (2k, 2k) are those of
    `so3_match.innovation`; `rate` (3,) rad/s, `acceleration` (3,) rad/s²; `steps` as in `so3_motion.posterior`. No
    argument changes. Raises LinAlgError if S is not positive definite.

    A mixture over the steps is replaced by the normal distribution of its mean and covariance once the innovations are
    taken in (generalised pseudo-Bayesian of order 1: Bar-Shalom, Li, Kirubarajan 2001, section 11.6.4). Considered
    parameters get no gain (Schmidt 1966), nor does the reference, since its increment was sent. The readout time gets
    one only while the rate is significant. The covariance is Joseph's form multiplied out, which holds for any gain:
    P - K H P - (K H P)' + K S K' (Bierman 1977, section V).
    """
    P, weights, k, n = prior.copy(), weights.copy(), len(z), len(prior)
    learn = _rate_is_significant(rate, P)
    L = np.linalg.cholesky(S)
    W = _whitened(L, HP, H, z)
    onto, white = W[:, n : n + KINEMATIC_DIM].copy(), W[:, n + KINEMATIC_DIM].copy()
    K = W[:, :n].copy()  # becomes S^-1 H P: transposed gain
    KH = K.T @ onto
    for i in range(k - 1, -1, -1):
        for m in range(i + 1, k):
            f = L[m, i]
            for j in range(n):
                K[i, j] -= f * K[m, j]
        f = 1.0 / L[i, i]
        for j in range(n):
            K[i, j] *= f
    left = -KH  # of a step in the errors after the correction
    held = np.zeros((n, KINEMATIC_DIM))  # gains that are not taken
    for j in range(n):
        if KINEMATIC_DIM <= j < (READOUT if learn else MAP_OFFSET) or j >= n - CLONE_DIM:
            held[j] = KH[j]
            left[j] = 0.0
            for i in range(k):
                K[i, j] = 0.0
        if j < KINEMATIC_DIM:
            left[j, j] += 1.0
    KU = K.T @ (HP - 0.5 * (S @ K))
    mean, covariance, gain, level, ratio, nis = so3_motion.posterior(
        onto.T @ onto, onto.T @ white, acceleration, steps, weights
    )
    KU += (held @ gain - 0.5 * (left @ covariance)) @ left.T
    for i in range(n):
        for j in range(i + 1):
            value = P[i, j] - KU[i, j] - KU[j, i]
            P[i, j] = value
            P[j, i] = value
    dx = K.T @ z + left @ mean
    nis += white @ white
    log_likelihood = ratio - 0.5 * (white @ white + k * np.log(2.0 * np.pi))
    for i in range(k):
        log_likelihood -= np.log(L[i, i])
    return P, weights, dx, log_likelihood, nis, level


@njit(cache=True, error_model="numpy")
def _whitened(L, HP, H, z):
    """Return L^-1 [H P, H, z], (2k, n + 10), with L L' = S."""
    k, n = len(z), HP.shape[1]
    W = np.empty((k, n + KINEMATIC_DIM + 1))
    for i in range(k):
        for j in range(n):
            W[i, j] = HP[i, j]
        for j in range(KINEMATIC_DIM):
            W[i, n + j] = H[i, j]
        W[i, n + KINEMATIC_DIM] = z[i]
        for m in range(i):
            f = L[i, m]
            for j in range(n + KINEMATIC_DIM + 1):
                W[i, j] -= f * W[m, j]
        f = 1.0 / L[i, i]
        for j in range(n + KINEMATIC_DIM + 1):
            W[i, j] *= f
    return W


@njit(cache=True, error_model="numpy")
def _rate_is_significant(rate, P):
    """Return whether the rate is five standard deviations from zero. Noise must not determine a readout."""
    if P[READOUT, READOUT] == 0.0:
        return False
    return rate @ np.linalg.solve(P[3:6, 3:6].copy(), rate) > 25.0


@njit(cache=True, error_model="numpy")
def clone_attitude(P):
    """Return the joint covariance, (n, n), with the rotation's errors copied to the reference."""
    now, r = P.copy(), len(P) - CLONE_DIM
    for i in range(3):
        for j in range(r):
            now[r + i, j] = P[i, j]
            now[j, r + i] = P[i, j]
        for j in range(3):
            now[r + i, r + j] = P[i, j]
    return now


@njit(cache=True, error_model="numpy")
def since_reference(P, turn):
    """Return the covariance, (6, 6), of the rotation vector `turn`, (3,) rad, since the reference, and of the rate.

    The turn is exp(e) R exp(-e_reference). Its error in obj is e - R e_reference, which is Jl times the error of its
    vector.
    """
    R, J = np.empty((3, 3)), np.empty((3, 3))
    exp_into(turn, R)
    left_jacobian_into(turn, J)
    now, before = np.linalg.inv(J), np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            before[i, j] = -(now[i, 0] * R[0, j] + now[i, 1] * R[1, j] + now[i, 2] * R[2, j])
    half, C, r = np.empty((3, len(P))), np.empty((6, 6)), len(P) - CLONE_DIM
    for i in range(3):  # of the turn with the core and the reference
        for j in range(len(P)):
            if j < 6 or j >= r:
                value = 0.0
                for k in range(3):
                    value += now[i, k] * P[k, j] + before[i, k] * P[r + k, j]
                half[i, j] = value
    for i in range(3):
        for j in range(3):
            value = 0.0
            for k in range(3):
                value += half[i, k] * now[j, k] + half[i, r + k] * before[j, k]
            C[i, j] = value
            C[i, 3 + j] = half[i, 3 + j]
            C[3 + j, i] = half[i, 3 + j]
            C[3 + i, 3 + j] = P[3 + i, 3 + j]
    return C


@njit(cache=True, error_model="numpy")
def move(attitude, discs, basis, dx, new_attitude, new_discs, new_basis):
    """Move attitude, discs and their axes by an error vector, (n,)."""
    R = np.empty((3, 3))
    exp_into(dx[:3], R)
    new_attitude[:] = R @ attitude
    for m in range(len(discs)):
        a, b = dx[MAP_OFFSET + 2 * m], dx[MAP_OFFSET + 2 * m + 1]
        length = 0.0
        for i in range(3):
            new_discs[m, i] = discs[m, i] + basis[m, i, 0] * a + basis[m, i, 1] * b
            length += new_discs[m, i] ** 2
        length = np.sqrt(length)
        along = 0.0
        for i in range(3):
            new_discs[m, i] /= length
            along += new_discs[m, i] * basis[m, i, 0]
        # carry the axes along: their part along the new direction goes, then they are made orthonormal again
        length = 0.0
        for i in range(3):
            new_basis[m, i, 0] = basis[m, i, 0] - along * new_discs[m, i]
            length += new_basis[m, i, 0] ** 2
        length = np.sqrt(length)
        for i in range(3):
            new_basis[m, i, 0] /= length
        d, e = new_discs[m], new_basis[m]
        x = d[1] * e[2, 0] - d[2] * e[1, 0]
        y = d[2] * e[0, 0] - d[0] * e[2, 0]
        w = d[0] * e[1, 0] - d[1] * e[0, 0]
        sign = 1.0 if x * basis[m, 0, 1] + y * basis[m, 1, 1] + w * basis[m, 2, 1] > 0.0 else -1.0
        new_basis[m, 0, 1], new_basis[m, 1, 1], new_basis[m, 2, 1] = sign * x, sign * y, sign * w
