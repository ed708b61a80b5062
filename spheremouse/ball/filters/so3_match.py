"""Predicted places of the discs, and the agreement of points with them."""

import numpy as np
from numba import njit

from spheremouse.ball.filters.so3_predict import CONSIDERED_DIM, KINEMATIC_DIM, MAP_OFFSET
from spheremouse.geometry.rotation import exp_into

_NEAR = 0.99  # cosine of 8 degrees, the largest distance of a pair with all considered errors
_NEARBY = 0.9  # cosine of 26 degrees, the largest distance of a pair with any readout delay


@njit(cache=True, error_model="numpy")
def place_and_axes(attitude, rate, acceleration, delay, basis, disc, R, p, E):
    """Place p, (3,), and axes E, (3, 2), in obj of a disc as the camera sees it `delay` after the stamp."""
    if delay != 0.0:
        turn, more = np.empty(3), np.empty((3, 3))
        for i in range(3):
            turn[i] = rate[i] * delay + 0.5 * acceleration[i] * delay * delay
        exp_into(turn, more)
        for i in range(3):
            for j in range(3):
                R[i, j] = more[i, 0] * attitude[0, j] + more[i, 1] * attitude[1, j] + more[i, 2] * attitude[2, j]
    else:
        R[:] = attitude
    for i in range(3):
        p[i] = R[i, 0] * disc[0] + R[i, 1] * disc[1] + R[i, 2] * disc[2]
        for a in range(2):
            E[i, a] = R[i, 0] * basis[0, a] + R[i, 1] * basis[1, a] + R[i, 2] * basis[2, a]


@njit(cache=True, error_model="numpy")
def turning_jacobian(E, p, H):
    """H, (2, 3) = d z / d rotation error: a turn e moves p by e x p."""
    for a in range(2):
        H[a, 0] = E[2, a] * p[1] - E[1, a] * p[2]
        H[a, 1] = E[0, a] * p[2] - E[2, a] * p[0]
        H[a, 2] = E[1, a] * p[0] - E[0, a] * p[1]


@njit(cache=True, error_model="numpy")
def places(attitude, discs, basis, P, which, added_process_noise, centre_sigma):
    """Root of the larger variance, rad, of where each disc of `which` is predicted, with process noise (3, 3) added."""
    H, R, p, E = np.empty((2, 3)), np.empty((3, 3)), np.empty(3), np.empty((3, 2))
    zero = np.zeros(3)
    for i in range(len(which)):
        m = which[i]
        place_and_axes(attitude, zero, zero, 0.0, basis[m], discs[m], R, p, E)
        turning_jacobian(E, p, H)
        S = _disc_covariance(P, H, MAP_OFFSET + 2 * m, added_process_noise)
        mean, half = 0.5 * (S[0, 0] + S[1, 1]), np.hypot(0.5 * (S[0, 0] - S[1, 1]), S[0, 1])
        centre_sigma[i] = np.sqrt(max(mean + half, 0.0))


@njit(cache=True, error_model="numpy")
def _disc_covariance(P, H, at, added_process_noise):
    """(2, 2) of a disc's predicted place without image noise; process noise (3, 3) is added to rotation."""
    S = np.empty((2, 2))
    for a in range(2):
        for b in range(2):
            value = P[at + a, at + b]
            for i in range(3):
                value += H[a, i] * P[i, at + b] + H[b, i] * P[i, at + a]
                for j in range(3):
                    value += H[a, i] * (P[i, j] + added_process_noise[i, j]) * H[b, j]
            S[a, b] = value
    return S


@njit(cache=True, error_model="numpy")
def _row(H, E, t, rate, row, by_pose, by_ball, radius, J):
    """Write d z / d (core, considered, readout) of one point into J, (2, 20), to first order in the delay t."""
    for a in range(2):
        for c in range(3):
            J[a, c] = H[a, c]
            J[a, 3 + c] = H[a, c] * t
            J[a, 6 + c] = 0.5 * H[a, c] * t * t
    considered_jacobian(H, E, rate, row, by_pose, by_ball, radius, J[:, KINEMATIC_DIM:])


@njit(cache=True, error_model="numpy")
def considered_jacobian(H, E, rate, row, by_pose, by_ball, radius, J):
    """Write d z / d (pose, ball, readout) of one point into J, (2, 11)."""
    for a in range(2):
        for c in range(CONSIDERED_DIM):
            value = E[c - 6, a] if 6 <= c < 9 else 0.0  # the direction counts from the centre
            for d in range(3):
                value -= E[d, a] * (by_pose[d, c] if c < 6 else by_ball[d, c - 6])
            J[a, c] = value / radius
        J[a, CONSIDERED_DIM] = (H[a, 0] * rate[0] + H[a, 1] * rate[1] + H[a, 2] * rate[2]) * row


@njit(cache=True, error_model="numpy")
def _full_covariance(P, J, JP, at, H, added_process_noise):
    """(2, 2) of a disc's predicted place, its errors at `at`, with all that J, (2, 20), depends on."""
    S = np.empty((2, 2))
    for a in range(2):
        for j in range(MAP_OFFSET + 2):
            to = j if j < MAP_OFFSET else at + j - MAP_OFFSET
            value = P[at + a, to]
            for c in range(MAP_OFFSET):
                value += J[a, c] * P[c, to]
            JP[a, j] = value
    for a in range(2):
        for b in range(2):
            value = JP[a, MAP_OFFSET + b]
            for j in range(MAP_OFFSET):
                value += JP[a, j] * J[b, j]
            for i in range(3):
                for j in range(3):
                    value += H[a, i] * added_process_noise[i, j] * H[b, j]
            S[a, b] = value
    return S


@njit(cache=True, error_model="numpy")
def _squared(z0, z1, a00, a01, a11, E, noise):
    """Squared Mahalanobis distance of z, with the covariance a (2, 2) and noise (3, 3) in the axes E."""
    for c in range(3):
        for d in range(3):
            a00 += E[c, 0] * noise[c, d] * E[d, 0]
            a01 += E[c, 0] * noise[c, d] * E[d, 1]
            a11 += E[c, 1] * noise[c, d] * E[d, 1]
    return (a11 * z0 * z0 - 2.0 * a01 * z0 * z1 + a00 * z1 * z1) / (a00 * a11 - a01 * a01)


@njit(cache=True, error_model="numpy")
def distances(
    attitude, rate, acceleration, discs, basis, P, which, added_process_noise, curvature, seen, noise, delay, row,
    by_pose, by_ball, radius, out,
):  # fmt: skip
    """Squared Mahalanobis distances of n seen directions to the discs `which`, into out (n, m).

    `noise` (n, 3, 3) rad² in obj, `row`, `by_pose` and `by_ball` as in `innovation`: no disc is turned away for an
    error of what is considered. Returns whether no row and no column has two entries below `out`'s limit given in
    out[0, 0] at the call: then the pairs are plain.
    """
    H, R, p, E = np.empty((2, 3)), np.empty((3, 3)), np.empty(3), np.empty((3, 2))
    gate = out[0, 0]
    plain = True
    any_considered = False
    for i in range(KINEMATIC_DIM, MAP_OFFSET):
        any_considered = any_considered or P[i, i] > 0.0
    J, JP = np.empty((2, MAP_OFFSET)), np.empty((2, MAP_OFFSET + 2))
    taken = np.zeros(len(seen), dtype=np.bool_)
    for m in range(len(which)):
        k = which[m]
        hits = 0
        before = 0.0
        place_and_axes(attitude, rate, acceleration, before, basis[k], discs[k], R, p, E)
        turning_jacobian(E, p, H)
        S = _disc_covariance(P, H, MAP_OFFSET + 2 * k, added_process_noise)
        for i in range(len(seen)):
            b = seen[i]
            cosine = p[0] * b[0] + p[1] * b[1] + p[2] * b[2]
            if delay[i] != before and cosine > _NEARBY:
                before = delay[i]
                place_and_axes(attitude, rate, acceleration, before, basis[k], discs[k], R, p, E)
                turning_jacobian(E, p, H)
                cosine = p[0] * b[0] + p[1] * b[1] + p[2] * b[2]
            if cosine < 0.0:
                out[i, m] = np.inf
                continue
            z0 = E[0, 0] * b[0] + E[1, 0] * b[1] + E[2, 0] * b[2]
            z1 = E[0, 1] * b[0] + E[1, 1] * b[1] + E[2, 1] * b[2]
            a00, a01, a11 = S[0, 0] + curvature, S[0, 1], S[1, 1] + curvature
            # cheap bound first: most pairs are far apart
            spread = a00 + a11 + noise[i, 0, 0] + noise[i, 1, 1] + noise[i, 2, 2]
            value = np.inf
            if z0 * z0 + z1 * z1 <= 4.0 * gate * spread:
                value = _squared(z0, z1, a00, a01, a11, E, noise[i])
            # most pairs are one without what is considered: then it need not be counted
            if value >= gate and cosine > _NEAR and (any_considered or before != 0.0):
                _row(H, E, before, rate, row[i], by_pose[i], by_ball[i], radius, J)
                T = _full_covariance(P, J, JP, MAP_OFFSET + 2 * k, H, added_process_noise)
                value = _squared(z0, z1, T[0, 0] + curvature, T[0, 1], T[1, 1] + curvature, E, noise[i])
            out[i, m] = value
            if value < gate:
                hits += 1
                if taken[i]:
                    plain = False
                taken[i] = True
        if hits > 1:
            plain = False
    return plain


@njit(cache=True, error_model="numpy")
def consistent(z, S, limit):
    """Return a mask, (k,), of the pairs that agree with one another: each may pass the gate alone.

    The pair that contradicts the others and the prediction most is left out until none does (data snooping, Baarda
    1968, for pairs of coordinates): a look-alike beside the place of a hidden disc, above all after a gap.
    """
    k = len(z) // 2
    keep = np.ones(k, dtype=np.bool_)
    left = k
    while left > 1:
        at = np.empty(2 * left, dtype=np.int64)
        count = 0
        for i in range(k):
            if keep[i]:
                at[count] = 2 * i
                at[count + 1] = 2 * i + 1
                count += 2
        sub, part = np.empty((count, count)), np.empty(count)
        for i in range(count):
            part[i] = z[at[i]]
            for j in range(count):
                sub[i, j] = S[at[i], at[j]]
        inverse = np.linalg.inv(sub)
        worst, most = -1, limit
        for i in range(left):
            v0, v1 = 0.0, 0.0
            for j in range(count):
                v0 += inverse[2 * i, j] * part[j]
                v1 += inverse[2 * i + 1, j] * part[j]
            a, b, c = inverse[2 * i, 2 * i], inverse[2 * i, 2 * i + 1], inverse[2 * i + 1, 2 * i + 1]
            contradiction = (c * v0 * v0 - 2.0 * b * v0 * v1 + a * v1 * v1) / (a * c - b * b)
            if contradiction >= most:
                worst, most = i, contradiction
        if worst < 0:
            break
        keep[at[2 * worst] // 2] = False
        left -= 1
    return keep
