"""The arithmetic of the default filter, compiled: what is done for every disc and every entry of the covariance.

Errors are ordered: rotation (3, rad, obj), rate (3, rad/s), acceleration (3, rad/s²), then what is only considered
(pose of the camera 6, ball's centre and radius 4), the rolling shutter's time (s), two for each disc in its own tangent
axes (rad), and at last those of the reference, the attitude that the next motion counts from (3, rad, obj). Functions
with an upper-case P work on the joint covariance in place.
"""

import numpy as np
from numba import njit

from spheremouse.ball.filters import so3_steps
from spheremouse.ball.filters.so3_match import (
    considered_jacobian,
    consistent,
    distances,
    place_and_axes,
    turning_jacobian,
)
from spheremouse.ball.filters.so3_predict import CLONE_DIM, KINEMATIC_DIM, MAP_OFFSET, READOUT
from spheremouse.geometry.rotation import exp_into, left_jacobian_into


@njit(cache=True, error_model="numpy")
def innovation(
    attitude, rate, acceleration, discs, basis, P, columns, curvature, seen, noise, delay, row, by_pose, by_ball,
    radius, H, HP, z, S,
):  # fmt: skip
    """Compute for k pairs H, (2k, 9), H P, (2k, n), z, (2k,) rad, and its covariance S, (2k, 2k).

    `by_pose` (k, 3, 6) and `by_ball` (k, 3, 4) m are the Jacobians of the points on the ball: what is considered.
    """
    k, n = len(columns), len(P)
    R, p, E, turning = np.empty((3, 3)), np.empty(3), np.empty((3, 2)), np.empty((2, 3))
    axes = np.empty((k, 3, 2))
    turn, later = np.empty(3), np.empty((3, 3))
    considered = np.zeros((2 * k, MAP_OFFSET - KINEMATIC_DIM))
    any_considered = False
    for i in range(KINEMATIC_DIM, MAP_OFFSET):
        any_considered = any_considered or P[i, i] > 0.0
    for i in range(k):
        t = delay[i]
        place_and_axes(attitude, rate, acceleration, t, basis[columns[i]], discs[columns[i]], R, p, E)
        axes[i] = E
        turning_jacobian(E, p, turning)
        before, along = turning, turning
        if t != 0.0:
            for c in range(3):
                turn[c] = rate[c] * t + 0.5 * acceleration[c] * t * t
            exp_into(turn, R)
            left_jacobian_into(turn, later)
            before, along = turning @ R, turning @ later
        if any_considered:
            considered_jacobian(turning, E, rate, row[i], by_pose[i], by_ball[i], radius, considered[2 * i : 2 * i + 2])
        for a in range(2):
            at_z = 2 * i + a
            z[at_z] = E[0, a] * seen[i, 0] + E[1, a] * seen[i, 1] + E[2, a] * seen[i, 2]
            for c in range(3):
                H[at_z, c] = before[a, c]
                H[at_z, 3 + c] = along[a, c] * t
                H[at_z, 6 + c] = 0.5 * along[a, c] * t * t
            at = MAP_OFFSET + 2 * columns[i] + a
            for j in range(n):
                HP[at_z, j] = P[at, j] + H[at_z, 0] * P[0, j] + H[at_z, 1] * P[1, j] + H[at_z, 2] * P[2, j]
            if t != 0.0:
                for c in range(3, KINEMATIC_DIM):
                    for j in range(n):
                        HP[at_z, j] += H[at_z, c] * P[c, j]
            if any_considered:
                for c in range(MAP_OFFSET - KINEMATIC_DIM):
                    if P[KINEMATIC_DIM + c, KINEMATIC_DIM + c] > 0.0:
                        for j in range(n):
                            HP[at_z, j] += considered[at_z, c] * P[KINEMATIC_DIM + c, j]
    for i in range(2 * k):
        for m in range(k):
            for a in range(2):
                j = 2 * m + a
                value = HP[i, MAP_OFFSET + 2 * columns[m] + a]
                for c in range(KINEMATIC_DIM if delay[m] != 0.0 else 3):
                    value += HP[i, c] * H[j, c]
                if any_considered:
                    for c in range(MAP_OFFSET - KINEMATIC_DIM):
                        value += HP[i, KINEMATIC_DIM + c] * considered[j, c]
                S[i, j] = value
    for i in range(k):
        for a in range(2):
            for b in range(2):
                value = 0.0
                for c in range(3):
                    for d in range(3):
                        value += axes[i, c, a] * noise[i, c, d] * axes[i, d, b]
                S[2 * i + a, 2 * i + b] += value
            S[2 * i + a, 2 * i + a] += curvature
    for i in range(2 * k):
        for j in range(i):
            mean = 0.5 * (S[i, j] + S[j, i])
            S[i, j] = mean
            S[j, i] = mean


@njit(cache=True, error_model="numpy")
def whitened(L, HP, H, z):
    """L^-1 [H P, H, z], (2k, n + 10), with L L' = S."""
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
def correct(P, H, HP, S, z, acceleration, steps, weights, learn, dx):
    """P and the correction dx, (n,), after innovations z; `weights` (l,) of the levels become those after them.

    `steps` as in `so3_steps.posterior`. A mixture over the steps is replaced by the normal distribution of its mean and
    covariance once the innovations are taken in (generalised pseudo-Bayesian of order 1: Bar-Shalom, Li, Kirubarajan
    2001, section 11.6.4). Returns the log likelihood of z, its normalised square, and the rms level of the steps.

    Considered parameters get no gain (Schmidt 1966), nor does the reference, since its increment was sent. The
    covariance is Joseph's form multiplied out, which holds for any gain: P - K H P - (K H P)' + K S K' (Bierman 1977,
    section V).
    """
    k, n = len(z), len(P)
    L = np.linalg.cholesky(S)
    W = whitened(L, HP, H, z)
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
    left, held = (
        -KH,
        np.zeros((n, KINEMATIC_DIM)),
    )  # of a step in the errors after the correction; gains that are not taken
    for j in range(n):
        if KINEMATIC_DIM <= j < (READOUT if learn else MAP_OFFSET) or j >= n - CLONE_DIM:
            held[j] = KH[j]
            left[j] = 0.0
            for i in range(k):
                K[i, j] = 0.0
        if j < KINEMATIC_DIM:
            left[j, j] += 1.0
    KU = K.T @ (HP - 0.5 * (S @ K))
    mean, covariance, gain, level, ratio, nis = so3_steps.posterior(
        onto.T @ onto, onto.T @ white, acceleration, steps, weights
    )
    KU += (held @ gain - 0.5 * (left @ covariance)) @ left.T
    for i in range(n):
        for j in range(i + 1):
            value = P[i, j] - KU[i, j] - KU[j, i]
            P[i, j] = value
            P[j, i] = value
    dx[:] = K.T @ z + left @ mean
    nis += white @ white
    log_likelihood = ratio - 0.5 * (white @ white + k * np.log(2.0 * np.pi))
    for i in range(k):
        log_likelihood -= np.log(L[i, i])
    return log_likelihood, nis, level


@njit(cache=True, error_model="numpy")
def rate_is_significant(rate, P):
    """Return whether the rate is five standard deviations from zero. Noise must not determine a readout."""
    if P[READOUT, READOUT] == 0.0:
        return False
    return rate @ np.linalg.solve(P[3:6, 3:6].copy(), rate) > 25.0


@njit(cache=True, error_model="numpy")
def clone_attitude(P):
    """The joint covariance, (n, n), with the rotation's errors now as those of the reference."""
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
    """(6, 6) of the rotation vector `turn`, (3,) rad, from the reference to now, and of the rate.

    The turn is exp(e) R exp(-e_reference), whose error is e - R e_reference in obj, and Jl of its vector's error.
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
    """Attitude, discs and their axes moved by an error vector, (n,)."""
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


@njit(cache=True, error_model="numpy")
def update(
    attitude, rate, acceleration, discs, basis, P, process, noise_scales, steps, weights, visible, gate,
    wide, seen, image_covariance, delay, row, by_pose, by_ball, radius,
):  # fmt: skip
    """The whole of an ordinary update in one call: pairs, levels, correction. P and `weights` (l,) are changed.

    Returns whether it was ordinary (all plain, complete, small), and rows, columns, the correction, the level of the
    steps and the normalised innovation squared. Where it was not, P may be spoilt, and it is done with more care.
    """
    nothing = np.zeros(0, dtype=np.intp)
    empty = np.zeros(0)
    n, m = len(seen), len(visible)
    if n == 0 or m == 0:
        return False, nothing, nothing, empty, 1.0, 0.0
    noise_scale = weights @ noise_scales
    added_process_noise = (noise_scale - 1.0) * process
    spread = (
        P[0, 0] + P[1, 1] + P[2, 2] + added_process_noise[0, 0] + added_process_noise[1, 1] + added_process_noise[2, 2]
    ) / 3.0
    curvature = min(spread, wide * wide) ** 2
    noise = image_covariance / (radius * radius)
    distance = np.empty((n, m))
    distance[0, 0] = gate
    if not distances(
        attitude, rate, acceleration, discs, basis, P, visible, added_process_noise[:3, :3], curvature, seen, noise,
        delay, row, by_pose, by_ball, radius, distance,
    ):  # fmt: skip
        return False, nothing, nothing, empty, 1.0, 0.0
    rows, columns = np.empty(n, dtype=np.intp), np.empty(n, dtype=np.intp)
    k, total = 0, 0.0
    for i in range(n):
        for j in range(m):
            if distance[i, j] < gate:
                rows[k], columns[k] = i, visible[j]
                total += distance[i, j]
                k += 1
    rows, columns = rows[:k], columns[:k]
    if k < 2 or total > 4.0 * k + 10.0 or 2 * k < min(n, m):
        return False, nothing, nothing, empty, 1.0, 0.0
    H, HP, z, S = np.empty((2 * k, KINEMATIC_DIM)), np.empty((2 * k, len(P))), np.empty(2 * k), np.empty((2 * k, 2 * k))
    innovation(
        attitude, rate, acceleration, discs, basis, P, columns, curvature, seen[rows], noise[rows], delay[rows],
        row[rows], by_pose[rows], by_ball[rows], radius, H, HP, z, S,
    )  # fmt: skip
    if not np.all(consistent(z, S + H @ added_process_noise @ H.T, 1.5 * gate)):
        return False, nothing, nothing, empty, 1.0, 0.0
    dx = np.empty(len(P))
    if k < min(n, m) and _pairs_when_livelier(
        attitude, rate, acceleration, discs, basis, P, visible, (noise_scales.max() - 1.0) * process, seen, noise,
        delay, row, by_pose, by_ball, radius, gate, rows, columns,
    ):  # fmt: skip
        return False, nothing, nothing, empty, 1.0, 0.0
    _, nis, level = correct(P, H, HP, S, z, acceleration, steps, weights, rate_is_significant(rate, P), dx)
    return True, rows, columns, dx, level, nis


@njit(cache=True, error_model="numpy")
def _pairs_when_livelier(
    attitude, rate, acceleration, discs, basis, P, visible, added_process_noise, seen, noise, delay, row, by_pose,
    by_ball, radius, gate, rows, columns,
):  # fmt: skip
    """Return whether a point and a disc that are in no pair of `rows` and `columns` are one at the liveliest level.

    Then the ball may have been pushed, and the discs that the push moved least are not the only ones to use.
    """
    distance = np.empty((len(seen), len(visible)))
    distance[0, 0] = gate
    distances(
        attitude, rate, acceleration, discs, basis, P, visible, added_process_noise[:3, :3], 0.0, seen, noise, delay,
        row, by_pose, by_ball, radius, distance,
    )  # fmt: skip
    for i in range(len(seen)):
        if not np.any(rows == i):
            for j in range(len(visible)):
                if distance[i, j] < gate and not np.any(columns == visible[j]):
                    return True
    return False


@njit(cache=True, error_model="numpy")
def keep_map(
    attitude, discs, towards, horizon, hits, missed, probability, columns, trial, misses, patience, seen,
    rows, may_start_landmark, apart, new_hits, new_missed, keep, found,
):  # fmt: skip
    """Sightings counted: into new_hits, new_missed, keep (m,), and into found (n,) the points that found a disc.

    Returns how many discs are dropped and how many found; and of those beyond their trial, how many were seen and how
    many missed, each of these by its `probability` (m,) of detection. See `So3Filter._keep_map`.
    """
    m, n = len(discs), len(seen)
    for k in range(m):
        new_hits[k], new_missed[k] = hits[k], missed[k]
    for i in range(len(columns)):
        new_hits[columns[i]] += 1
        new_missed[columns[i]] = -1
    dropped, known_seen, known_missed = 0, 0, 0.0
    p = np.empty((m, 3))
    # a frame that shows nothing says nothing of any one disc
    # a disc near the horizon is often too thin to be detected: only the well visible are missed
    well = horizon + 0.5 * (1.0 - horizon)
    for k in range(m):
        for i in range(3):
            p[k, i] = attitude[i, 0] * discs[k, 0] + attitude[i, 1] * discs[k, 1] + attitude[i, 2] * discs[k, 2]
        if new_missed[k] < 0:
            new_missed[k] = 0
            known_seen += hits[k] >= trial
        elif n > 0 and p[k, 0] * towards[0] + p[k, 1] * towards[1] + p[k, 2] * towards[2] > well:
            new_missed[k] += 1
            known_missed += probability[k] if hits[k] >= trial else 0.0
        limit = misses if new_hits[k] < trial else patience * new_hits[k]
        keep[k] = new_missed[k] < limit
        dropped += not keep[k]
    new = 0
    for i in range(n):
        free = may_start_landmark[i]
        for j in range(len(rows)):
            free = free and rows[j] != i
        if not free:
            continue
        b = seen[i]
        # two discs do not overlap: a point that close to a known one is that one, badly seen
        for k in range(m):
            free = free and p[k, 0] * b[0] + p[k, 1] * b[1] + p[k, 2] * b[2] < apart
        for j in range(new):  # nor do two new ones: the first counts
            c = seen[found[j]]
            free = free and c[0] * b[0] + c[1] * b[1] + c[2] * b[2] < apart
        if free:
            found[new] = i
            new += 1
    return dropped, new, known_seen, known_missed
