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

from spheremouse.ball.filters import so3_steps
from spheremouse.ball.filters.so3_motion import CLONE_DIM, KINEMATIC_DIM, MAP_OFFSET, READOUT
from spheremouse.geometry.rotation import exp_into, left_jacobian_into


@njit(cache=True, error_model="numpy")
def correct(prior, H, HP, z, S, rate, acceleration, steps, modes):
    """Return covariance, modes, level weights, correction, log likelihood, normalised square and rms level.

    `prior` (n, n) is the covariance before. H (2k, n), H P (2k, n), z (2k,) and S (2k, 2k) are those of
    `so3_match.innovation`; `rate` (3,) rad/s, `acceleration` (3,) rad/s²; `steps` and `modes` as in
    `so3_steps.posterior`. No argument changes. Raises LinAlgError if S is not positive definite.

    Rate and acceleration are a mixture of modes. The other errors are a regression on them, and its residuals have one
    covariance for all modes. The new covariance is that of the whole mixture.

    Considered parameters keep their estimate and covariance (Schmidt 1966), and so does the readout time while the rate
    is not significant. They are independent of the modes, so rate and acceleration are taken given these parameters.
    Each hypothesis is then an ordinary update of Schmidt's filter, and their sum has a positive covariance. The
    reference keeps its estimate, since its increment was sent. Its covariance is the second moment about that estimate.
    """
    n, core, past, both = len(prior), KINEMATIC_DIM, so3_steps.PAST, so3_steps.PAST + KINEMATIC_DIM
    end = READOUT if _rate_is_significant(rate, prior) else MAP_OFFSET  # of the held parameters
    U, M, Lc = prior[core:end].copy(), HP[:, core:end].T.copy(), np.zeros((end - core, end - core))
    so3_steps.lower(prior[core:end, core:end], Lc)
    so3_steps.solve_lower(Lc, U)
    so3_steps.solve_lower(Lc, M)
    by_held = U[:, 3:core].T.copy()
    shared, V, N = by_held @ by_held.T, prior[3:core] - by_held @ U, HP[:, 3:core].T - by_held @ M
    V[:, core:end] = 0.0
    root = np.zeros((past, past))
    so3_steps.lower(V[:, 3:core], root)
    so3_steps.solve_lower(root, V)
    so3_steps.solve_lower(root, N)
    W = np.empty((len(z), n + both + 1))
    W[:, :n] = HP - N.T @ V  # of the residuals of the regression on rate and acceleration
    W[:, n : n + past] = N.T
    W[:, n + past : n + both] = H
    W[:, n + both] = z
    L = np.linalg.cholesky(S - N.T @ N)
    so3_steps.solve_lower(L, W)
    rest, seen = W[:, :n].copy(), W[:, n:].copy()
    T = -(rest.T @ seen[:, :both].copy())  # of past and step in the errors after the correction
    T[:, :past] += V.T
    for i in range(core):
        T[i, past + i] += 1.0
    moved = root, T[3:core].copy(), shared - rest[:, 3:core].T.copy() @ rest[:, 3:core].copy()
    mean, covariance, within, modes, level, ratio, nis = so3_steps.posterior(
        seen.T @ seen, moved, acceleration, steps, (modes[0], modes[1] - shared, modes[2])
    )
    white = seen[:, both].copy()
    dx = T @ mean + rest.T @ white
    dx[core:end] = 0.0
    gained = np.vstack((V, rest, -(T @ covariance).T)).T @ np.vstack((V, rest, T.T))
    gained[:, core:end] = np.vstack((rest, -(T @ within).T)).T @ np.vstack((rest, T.T))[:, core:end].copy()
    gained[core:end] = gained[:, core:end].T
    gained[core:end, core:end] = 0.0
    P = np.empty((n, n))
    for i in range(n):
        for j in range(i + 1):
            P[i, j] = prior[i, j] - 0.5 * (gained[i, j] + gained[j, i])
            if j >= n - CLONE_DIM:
                P[i, j] += dx[i] * dx[j]
            P[j, i] = P[i, j]
    dx[n - CLONE_DIM :] = 0.0
    log_likelihood = ratio - 0.5 * (white @ white + len(z) * np.log(2.0 * np.pi))
    for i in range(len(z)):
        log_likelihood -= np.log(L[i, i])
    return P, modes, modes[2].sum(axis=0), dx, log_likelihood, nis + white @ white, level


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
