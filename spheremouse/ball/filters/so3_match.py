"""Pairs of points and discs: predicted places, innovations, and the agreement of pairs with one another.

Most functions take these arguments, inside as the tuples `body` and `seen`, since calls with tuples are slow:
- `body`: attitude, (3, 3), rate, (3,), and acceleration, (3,), then the discs, (m, 3), and their axes, (m, 3, 2),
- `seen`: of n points the directions, (n, 3), image noise, (n, 3, 3) rad², delays, (n,) s, and rows, (n,); the Jacobians
  of their places by pose, (n, 3, 6), and by ball, (n, 3, 4); and the radius of the ball, m.

`P` is the joint covariance; `so3_motion` gives its order. `added` (9, 9) is process noise that P does not include yet.
"""

import numpy as np
from numba import njit

from spheremouse.ball.filters.so3_motion import CONSIDERED_DIM, KINEMATIC_DIM, MAP_OFFSET, READOUT
from spheremouse.geometry.matching import match
from spheremouse.geometry.rotation import exp_into, left_jacobian_into

_NEAR = 0.99  # cosine of 8 degrees, the largest distance of a pair with all considered errors
_NEARBY = 0.9  # cosine of 26 degrees, the largest distance of a pair with any readout delay
_WIDE = 0.1  # rad: an attitude known worse than that is not linear in any sense; the allowance for it grows no more


@njit(cache=True, error_model="numpy")
def _place_and_axes(body, delay, k, R, p, E):
    """Write place p, (3,), and axes E, (3, 2), in obj of disc `k` as the camera sees it `delay` after the stamp."""
    attitude, rate, acceleration, discs, axes = body
    disc, basis = discs[k], axes[k]
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
def _turning_jacobian(E, p, H):
    """Write H = d z / d rotation error, (2, 3): a turn e moves p by e x p."""
    for a in range(2):
        H[a, 0] = E[2, a] * p[1] - E[1, a] * p[2]
        H[a, 1] = E[0, a] * p[2] - E[2, a] * p[0]
        H[a, 2] = E[1, a] * p[0] - E[0, a] * p[1]


@njit(cache=True, error_model="numpy")
def place_sigma(attitude, rate, acceleration, discs, basis, P, which, added):
    """Return the standard deviation, (k,) rad, of the predicted place of each disc of `which`, on the worse axis."""
    body = (attitude, rate, acceleration, discs, basis)
    H, R, p, E = np.empty((2, 3)), np.empty((3, 3)), np.empty(3), np.empty((3, 2))
    sigma = np.empty(len(which))
    for i in range(len(which)):
        _place_and_axes(body, 0.0, which[i], R, p, E)
        _turning_jacobian(E, p, H)
        S = _disc_covariance(P, H, MAP_OFFSET + 2 * which[i], added)
        mean, half = 0.5 * (S[0, 0] + S[1, 1]), np.hypot(0.5 * (S[0, 0] - S[1, 1]), S[0, 1])
        sigma[i] = np.sqrt(max(mean + half, 0.0))
    return sigma


@njit(cache=True, error_model="numpy")
def _disc_covariance(P, H, at, added):
    """(2, 2) of a disc's predicted place without image noise; `added` counts for the rotation."""
    S = np.empty((2, 2))
    for a in range(2):
        for b in range(2):
            value = P[at + a, at + b]
            for i in range(3):
                value += H[a, i] * P[i, at + b] + H[b, i] * P[i, at + a]
                for j in range(3):
                    value += H[a, i] * (P[i, j] + added[i, j]) * H[b, j]
            S[a, b] = value
    return S


@njit(cache=True, error_model="numpy")
def _jacobian(body, seen, i, E, H, J):
    """Write d z / d (core, considered, readout) of point i into J, (2, 20); H, (2, 3), is `_turning_jacobian`."""
    _, rate, acceleration, _, _ = body
    _, _, delay, row, by_pose, by_ball, radius = seen
    t = delay[i]
    J[:, :3], J[:, 3:KINEMATIC_DIM] = H, 0.0
    if t != 0.0:
        turn, R, later = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
        for c in range(3):
            turn[c] = rate[c] * t + 0.5 * acceleration[c] * t * t
        exp_into(turn, R)
        left_jacobian_into(turn, later)
        J[:, :3], J[:, 3:6] = H @ R, (H @ later) * t
        J[:, 6:KINEMATIC_DIM] = 0.5 * t * J[:, 3:6]
    for a in range(2):
        for c in range(CONSIDERED_DIM):
            value = E[c - 6, a] if 6 <= c < 9 else 0.0  # the direction counts from the centre
            for d in range(3):
                value -= E[d, a] * (by_pose[i, d, c] if c < 6 else by_ball[i, d, c - 6])
            J[a, KINEMATIC_DIM + c] = value / radius
        J[a, READOUT] = (H[a, 0] * rate[0] + H[a, 1] * rate[1] + H[a, 2] * rate[2]) * row[i]


@njit(cache=True, error_model="numpy")
def _full_covariance(P, J, JP, at, H, added):
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
                    value += H[a, i] * added[i, j] * H[b, j]
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
    attitude, rate, acceleration, discs, basis, P, which, added, curvature, gate, direction, noise, delay, row, by_pose,
    by_ball, radius,
):  # fmt: skip
    """Return squared Mahalanobis distances, (n, k), of points to the discs `which`, exact below `gate`.

    Errors of the considered parameters alone reject no disc. `curvature` is in rad². Also returns whether the pairs are
    unambiguous: no row and no column has two entries below `gate`.
    """
    body, seen = (attitude, rate, acceleration, discs, basis), (direction, noise, delay, row, by_pose, by_ball, radius)
    H, R, p, E = np.empty((2, 3)), np.empty((3, 3)), np.empty(3), np.empty((3, 2))
    plain = True
    any_considered = False
    for i in range(KINEMATIC_DIM, MAP_OFFSET):
        any_considered = any_considered or P[i, i] > 0.0
    J, JP = np.empty((2, MAP_OFFSET)), np.empty((2, MAP_OFFSET + 2))
    out, taken = np.empty((len(direction), len(which))), np.zeros(len(direction), dtype=np.bool_)
    for m in range(len(which)):
        k = which[m]
        hits = 0
        before = 0.0
        _place_and_axes(body, before, k, R, p, E)
        _turning_jacobian(E, p, H)
        S = _disc_covariance(P, H, MAP_OFFSET + 2 * k, added)
        for i in range(len(direction)):
            b = direction[i]
            cosine = p[0] * b[0] + p[1] * b[1] + p[2] * b[2]
            if delay[i] != before and cosine > _NEARBY:
                before = delay[i]
                _place_and_axes(body, before, k, R, p, E)
                _turning_jacobian(E, p, H)
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
                _jacobian(body, seen, i, E, H, J)
                T = _full_covariance(P, J, JP, MAP_OFFSET + 2 * k, H, added)
                value = _squared(z0, z1, T[0, 0] + curvature, T[0, 1], T[1, 1] + curvature, E, noise[i])
            out[i, m] = value
            if value < gate:
                hits += 1
                if taken[i]:
                    plain = False
                taken[i] = True
        if hits > 1:
            plain = False
    return out, plain


@njit(cache=True, error_model="numpy")
def innovation(
    attitude, rate, acceleration, discs, basis, P, rows, columns, curvature, direction, noise, delay, row, by_pose,
    by_ball, radius,
):  # fmt: skip
    """Return for k pairs H, (2k, 9), H P, (2k, n), the innovation z, (2k,) rad, and its covariance S, (2k, 2k).

    Points `rows` are paired with discs `columns`. H P includes the considered parameters and the readout.
    """
    body, seen = (attitude, rate, acceleration, discs, basis), (direction, noise, delay, row, by_pose, by_ball, radius)
    k = len(columns)
    R, p, E, H = np.empty((3, 3)), np.empty(3), np.empty((3, 2)), np.empty((2, 3))
    J, z, at = np.empty((2 * k, MAP_OFFSET)), np.empty(2 * k), np.empty(2 * k, dtype=np.intp)
    axes = np.empty((k, 3, 2))
    for i in range(k):
        seen_at = direction[rows[i]]
        _place_and_axes(body, delay[rows[i]], columns[i], R, p, E)
        _turning_jacobian(E, p, H)
        _jacobian(body, seen, rows[i], E, H, J[2 * i : 2 * i + 2])
        axes[i] = E
        for a in range(2):
            z[2 * i + a] = E[0, a] * seen_at[0] + E[1, a] * seen_at[1] + E[2, a] * seen_at[2]
            at[2 * i + a] = MAP_OFFSET + 2 * columns[i] + a
    HP, S = P[at], np.empty((2 * k, 2 * k))
    for i in range(2 * k):
        for c in range(MAP_OFFSET):
            if J[i, c] != 0.0 and P[c, c] > 0.0:  # most are zero: a product of matrices takes longer
                for j in range(len(P)):
                    HP[i, j] += J[i, c] * P[c, j]
        for j in range(2 * k):
            S[i, j] = HP[i, at[j]]
            for c in range(MAP_OFFSET):
                S[i, j] += HP[i, c] * J[j, c]
    for i in range(k):
        for a in range(2):
            S[2 * i + a, 2 * i + a] += curvature
            for b in range(2):
                for c in range(3):
                    for d in range(3):
                        S[2 * i + a, 2 * i + b] += axes[i, c, a] * noise[rows[i], c, d] * axes[i, d, b]
    for i in range(2 * k):
        for j in range(i):
            mean = 0.5 * (S[i, j] + S[j, i])
            S[i, j] = mean
            S[j, i] = mean
    return J[:, :KINEMATIC_DIM].copy(), HP, z, S


@njit(cache=True, error_model="numpy")
def consistent(z, S, limit):
    """Return a mask, (k,), of the pairs that agree with one another; each alone may pass the gate.

    Data snooping (Baarda 1968, for pairs of coordinates) removes the pair that contradicts the others and the
    prediction most, and repeats until all agree. Such a pair is a look-alike beside the place of a hidden disc, above
    all after a gap.
    """
    keep = np.ones(len(z) // 2, dtype=np.bool_)
    while np.count_nonzero(keep) > 1:
        at = np.flatnonzero(np.repeat(keep, 2))
        inverse = np.linalg.inv(S[at][:, at])
        v = inverse @ z[at]
        worst, most = -1, limit
        for i in range(0, len(at), 2):
            a, b, c = inverse[i, i], inverse[i, i + 1], inverse[i + 1, i + 1]
            contradiction = (c * v[i] * v[i] - 2.0 * b * v[i] * v[i + 1] + a * v[i + 1] * v[i + 1]) / (a * c - b * b)
            if contradiction >= most:
                worst, most = at[i] // 2, contradiction
        if worst < 0:
            break
        keep[worst] = False
    return keep


@njit(cache=True, error_model="numpy")
def curvature(P, added):
    """Return the variance, rad², of the terms that the linear model omits.

    A turn e moves p by e x p + e (e . p) / 2 + ... At the start, with the rate unknown, the omitted terms exceed the
    image noise many times. In tracking they are negligible.
    """
    spread = (P[0, 0] + P[1, 1] + P[2, 2] + added[0, 0] + added[1, 1] + added[2, 2]) / 3.0
    return min(spread, _WIDE * _WIDE) ** 2


@njit(cache=True, error_model="numpy")
def pair(
    attitude, rate, acceleration, discs, basis, P, towards, horizon, added, gate, direction, noise, delay, row, by_pose,
    by_ball, radius,
):  # fmt: skip
    """Return the one-to-one pairs of least total distance of points and visible discs, as rows and columns.

    Pairs that contradict the others are left out. Also returns the greatest possible number of pairs, whether no other
    pair was possible, whether all pairs lie in their places, whether they agree with one another, and the innovation of
    all. `towards`, (3,) obj, points to the camera. The camera sees points with a cosine to `towards` above `horizon`.
    """
    which = np.flatnonzero(discs @ (towards @ attitude) > horizon)
    body, seen = (attitude, rate, acceleration, discs, basis), (direction, noise, delay, row, by_pose, by_ball, radius)
    allowance = curvature(P, added)
    distance, plain = distances(*body, P, which, added, allowance, gate, *seen)
    worth = gate - distance
    column = match(np.where(worth > 0.0, worth, -1.0)) if len(which) else np.full(len(direction), -1)
    rows = np.flatnonzero(column >= 0)
    columns, total = which[column[rows]], 0.0
    for i in rows:
        total += distance[i, column[i]]
    fits = total < 4.0 * max(len(rows), 1) + 10.0
    H, HP, z, S = innovation(*body, P, rows, columns, allowance, *seen)
    keep = np.ones(len(rows), dtype=np.bool_)
    if len(rows) > 1:
        keep = consistent(z, S + H @ added @ H.T, 1.5 * gate)
    agree, possible = bool(keep.all()), min(len(direction), len(which))
    return rows[keep], columns[keep], possible, plain, fits and agree, agree, (H, HP, z, S)


@njit(cache=True, error_model="numpy")
def leaves_a_pair(
    attitude, rate, acceleration, discs, basis, P, which, added, gate, rows, columns, direction, noise, delay, row,
    by_pose, by_ball, radius,
):  # fmt: skip
    """Return whether a point and a disc that are in no pair of `rows` and `columns` lie within the gate."""
    body, seen = (attitude, rate, acceleration, discs, basis), (direction, noise, delay, row, by_pose, by_ball, radius)
    distance, _ = distances(*body, P, which, added, 0.0, gate, *seen)
    for i in range(len(distance)):
        if not np.any(rows == i):
            for j in range(len(which)):
                if distance[i, j] < gate and not np.any(columns == which[j]):
                    return True
    return False
