"""Steps of the acceleration between frames, and their posterior from the innovations.

A hand takes hold of the ball, pushes it, lets it go and stops it. The acceleration jumps at each of these events and is
nearly constant between them. The events are a Poisson process. Each event draws a new acceleration about zero,
independent of the last one (compound Poisson jumps). The second moments are those of Singer (1970).

The instant of a step between two frames, its level and its size are unknown. Each pair (instant, level) is a
hypothesis, and its likelihood is its weight. A step shortly before a frame hardly shows in that frame. So the
hypotheses about the last interval stay apart for one more frame as the modes of the state: no step, or a step at one of
the levels. The next frame weighs each mode together with each hypothesis about the new interval. Then all with the same
new level become one mode (generalised pseudo-Bayesian of order 2: Bar-Shalom, Li, Kirubarajan 2001, section 11.6.5).
"""

import numpy as np
from numba import njit

INSTANTS = (np.arange(6) + 0.5) / 6.0  # of a step, frame intervals before the frame
PAST = 6  # errors of rate and acceleration before the step, whitened
STEP = slice(6, 15)  # what the step adds to rotation, rate and acceleration
_NEGLIGIBLE = 1e-5  # probability of a mode or step
_MINOR = 1e-3  # share of a mode below which a hypothesis is left out
_SINGULAR = 1e-14  # share of a variance below which rounding errors determine it


@njit(cache=True, error_model="numpy")
def lower(C, out):
    """Write the lower triangle L with L L' = C, (n, n), into `out`; a direction without variance gets a zero column."""
    for j in range(len(C)):
        pivot = C[j, j]
        for m in range(j):
            pivot -= out[j, m] * out[j, m]
        root = np.sqrt(pivot) if pivot > _SINGULAR * C[j, j] else 0.0
        out[:j, j] = 0.0
        out[j, j] = root
        for i in range(j + 1, len(C)):
            value = C[i, j]
            for m in range(j):
                value -= out[i, m] * out[j, m]
            out[i, j] = value / root if root > 0.0 else 0.0


@njit(cache=True, error_model="numpy")
def solve_lower(L, B):
    """Replace B, (n, m), by L^-1 B; a direction without variance gets zeros."""
    for i in range(len(L)):
        for k in range(i):
            f = L[i, k]
            for j in range(B.shape[1]):
                B[i, j] -= f * B[k, j]
        f = 1.0 / L[i, i] if L[i, i] > 0.0 else 0.0
        for j in range(B.shape[1]):
            B[i, j] *= f


@njit(cache=True, error_model="numpy")
def posterior(gram, moved, acceleration, steps, modes):
    """Return the posterior of the errors of the predicted motion, and the modes of the next frame.

    The errors of rate and acceleration before the step are `root` x and the part that all modes share. The step adds d,
    (9,), to rotation, rate and acceleration. `gram` (16, 16) is G' R^-1 G. The columns of G are those of x, d, and the
    innovations z, whose covariance is R if x and d are known. `moved` holds the lower triangle `root` (6, 6), then
    the effect of x and d on the errors after the correction, (6, 15), and the shared part's covariance then, (6, 6).
    `acceleration` (3,), rad/s², is the predicted one. `steps` holds three values:
    - the interval since the last frame, s (0: no step),
    - the mean time between two events, s,
    - the variances of the levels, (l,), (rad/s²)² per axis; the first level is a ball left to roll, without steps.

    `modes` holds for each mode the mean of its errors (l, 6), their covariance (l, 6, 6), and its probability jointly
    with each level (l, l).

    Returns:
    - the mean of x and d, (15,), their covariance, (15, 15), and its mean within the hypotheses, (15, 15),
    - the modes of the next frame, relative to the new mean,
    - the rms level of the steps, relative to the first level (1 without a step),
    - the log likelihood ratio of z to no error,
    - the mean normalised square of z, less z' R^-1 z.
    """
    root, interval, between, variances = moved[0], *steps
    means, covariances, weights = modes
    n, instants, levels = len(means), len(INSTANTS), len(variances) - 1
    quiet = np.exp(-interval / between)
    g, x, C, Cd = np.empty((instants, 3)), np.zeros((n, 6)), np.zeros((n, 6, 6)), np.zeros((n, 6, 9))
    for s in range(instants):
        before = INSTANTS[s] * interval
        g[s, 0], g[s, 1], g[s, 2] = 0.5 * before * before, before, 1.0
    B, y = np.empty((n, instants, 3, 3)), np.empty((n, instants, 3))  # information on the step
    none, p = np.zeros(n), np.zeros((n, instants, levels))  # prior times likelihood, but for exp(-square / 2)
    square, squares = np.full(n, np.inf), np.full((n, instants, levels), np.inf)
    A, v, still = np.empty((9, 9)), np.empty(9), np.zeros(1 + levels)
    for j in range(n):
        if np.sum(weights[j]) < _NEGLIGIBLE:
            continue
        volume, square[j] = _one_mode(gram, root, means[j], covariances[j], x[j], C[j], Cd[j], A, v)
        none[j] = (weights[j, 0] + quiet * np.sum(weights[j, 1:])) * volume
        for s in range(instants):
            constant = square[j] + _seen(A, v, g[s], acceleration + means[j, 3:], B[j, s], y[j, s])
            for k in range(levels):
                prior = (1.0 - quiet) / instants * weights[j, 1 + k]
                if prior > _NEGLIGIBLE:
                    determinant, gained = _likelihood(B[j, s], y[j, s], variances[1 + k])
                    squares[j, s, k] = constant - gained
                    p[j, s, k] = prior * volume / np.sqrt(determinant)
    least = np.min(square)
    for one in squares.ravel():
        least = min(least, one)
    none *= np.exp(-0.5 * (square - least))
    for j in range(n):
        for s in range(instants):
            for k in range(levels):
                if p[j, s, k] > 0.0:
                    p[j, s, k] *= np.exp(-0.5 * (squares[j, s, k] - least))
    _drop_minor(none, p)
    total = np.sum(none) + np.sum(p)
    excess, mean_square = 0.0, np.sum(none) / total
    for j in range(n):
        none[j] /= total
        if none[j] > 0.0:
            kept = none[j] / (weights[j, 0] + quiet * np.sum(weights[j, 1:]))
            still[0] += kept * weights[j, 0]
            still[1:] += kept * quiet * weights[j, 1:]
            excess += none[j] * square[j]
        for s in range(instants):
            for k in range(levels):
                if p[j, s, k] > 0.0:
                    p[j, s, k] /= total
                    mean_square += p[j, s, k] * variances[1 + k] / variances[0]
                    excess += p[j, s, k] * squares[j, s, k]
    mean, covariance, within, new = _merged(
        moved, g, acceleration, (none, p), (x, C, Cd), (means, B, y, variances), still
    )
    return mean, covariance, within, new, np.sqrt(mean_square), np.log(total) - 0.5 * least, excess


@njit(cache=True, error_model="numpy")
def _drop_minor(none, p):
    """Set to zero what adds little to each mode: `none` (j,) to the one without a step, `p` (j, i, l) to the others."""
    total = np.sum(none) + np.sum(p)
    for k in range(p.shape[2]):
        least = max(_MINOR * np.sum(p[:, :, k]), 1e-3 * _NEGLIGIBLE * total)
        for j in range(len(none)):
            for s in range(p.shape[1]):
                if p[j, s, k] < least:
                    p[j, s, k] = 0.0


@njit(cache=True, error_model="numpy")
def _one_mode(gram, root, mean, covariance, x, C, Cd, A, v):
    """Write the posterior of x given one mode and no step: its mean `x`, (6,), and covariance C, (6, 6).

    A step d moves the mean of x by -Cd d, with Cd (6, 9). `A`, (9, 9), and `v`, (9,), become the information on d.
    Returns the factor of the likelihood by the determinant, and the normalised square of z less z' R^-1 z.
    """
    m, Q, NQ, M, Y = np.empty((6, 1)), np.zeros((6, 6)), np.zeros((6, 6)), np.zeros((6, 6)), np.zeros((6, 6))
    XY, r = np.zeros((9, 6)), np.empty(6)
    lower(covariance, M)
    Q[:] = M
    solve_lower(root, Q)
    m[:, 0] = mean
    solve_lower(root, m)
    for a in range(6):
        for i in range(6):
            f = gram[a, i]
            for b in range(i + 1):
                NQ[a, b] += f * Q[i, b]
    for a in range(6):
        for b in range(a + 1):
            M[a, b] = 1.0 if a == b else 0.0
            for i in range(a, 6):
                M[a, b] += Q[i, a] * NQ[i, b]
            Y[b, a] = Q[a, b]
    lower(M, NQ)
    solve_lower(NQ, Y)  # C = Y' Y
    volume, square = 1.0, 0.0
    for a in range(6):
        volume /= NQ[a, a]
        r[a] = gram[a, 15]
        for i in range(6):
            r[a] -= gram[a, i] * m[i, 0]
        square -= m[a, 0] * (gram[a, 15] + r[a])
    for a in range(6):
        for b in range(6):
            for i in range(6):
                C[a, b] += Y[i, a] * Y[i, b]
    for a in range(6):
        x[a] = m[a, 0]
        for b in range(6):
            x[a] += C[a, b] * r[b]
        square -= r[a] * (x[a] - m[a, 0])
    for a in range(9):
        v[a] = gram[6 + a, 15]
        for i in range(6):
            v[a] -= gram[6 + a, i] * x[i]
            for b in range(6):
                XY[a, b] += gram[6 + a, i] * Y[b, i]
    for a in range(9):
        for b in range(a + 1):
            A[a, b] = gram[6 + a, 6 + b]
            for i in range(6):
                A[a, b] -= XY[a, i] * XY[b, i]
            A[b, a] = A[a, b]
        for i in range(6):
            for b in range(6):
                Cd[b, a] += Y[i, b] * XY[a, i]
    return volume, square


@njit(cache=True, error_model="numpy")
def _seen(A, v, g, acceleration, B, y):
    """Write the information on the new acceleration at one instant: B, (3, 3), and y, (3,), with B^-1 y its estimate.

    `A`, (9, 9), and `v`, (9,), are the information on what a step adds to rotation, rate and acceleration. `g`, (3,),
    is the effect of a unit step on them. `acceleration` (3,), rad/s², is that before the step. Returns the normalised
    square of z if the new acceleration is zero, less that without a step.
    """
    for a in range(3):
        for b in range(a + 1):
            value = 0.0
            for i in range(3):
                for j in range(3):
                    value += g[i] * g[j] * A[3 * i + a, 3 * j + b]
            B[a, b] = value
            B[b, a] = value
    square = 0.0
    for a in range(3):
        c = g[0] * v[a] + g[1] * v[3 + a] + g[2] * v[6 + a]
        y[a] = c
        for b in range(3):
            y[a] += B[a, b] * acceleration[b]
        square += acceleration[a] * (c + y[a])
    return square


@njit(cache=True, error_model="numpy")
def _likelihood(B, y, variance):
    """Return the determinant of I + variance B, and by how much an acceleration of that variance reduces the square.

    With the matrix inversion lemma no matrix is larger than 3x3 (Willsky and Jones 1976, "A generalized likelihood
    ratio approach to the detection and estimation of jumps in linear systems").
    """
    a, b, c = 1.0 + variance * B[0, 0], 1.0 + variance * B[1, 1], 1.0 + variance * B[2, 2]
    d, e, f = variance * B[1, 0], variance * B[2, 0], variance * B[2, 1]
    ca, cb, cc, cd, ce, cf = b * c - f * f, a * c - e * e, a * b - d * d, e * f - d * c, d * f - b * e, d * e - a * f
    determinant = a * ca + d * cd + e * ce
    value = ca * y[0] * y[0] + cb * y[1] * y[1] + cc * y[2] * y[2]
    value += 2.0 * (cd * y[0] * y[1] + ce * y[0] * y[2] + cf * y[1] * y[2])
    return determinant, variance * value / determinant


@njit(cache=True, error_model="numpy")
def _estimate(B, y, variance, acceleration, mean, covariance):
    """Write mean (3,) and covariance (3, 3) of a step from `acceleration` (3,), rad/s², at a level of this variance."""
    a, b, c = 1.0 + variance * B[0, 0], 1.0 + variance * B[1, 1], 1.0 + variance * B[2, 2]
    d, e, f = variance * B[1, 0], variance * B[2, 0], variance * B[2, 1]
    covariance[0, 0], covariance[1, 1], covariance[2, 2] = b * c - f * f, a * c - e * e, a * b - d * d
    covariance[1, 0], covariance[2, 0], covariance[2, 1] = e * f - d * c, d * f - b * e, d * e - a * f
    scale = variance / (a * covariance[0, 0] + d * covariance[1, 0] + e * covariance[2, 0])
    for i in range(3):
        for j in range(i + 1):
            covariance[i, j] *= scale
            covariance[j, i] = covariance[i, j]
    for i in range(3):
        mean[i] = -acceleration[i]
        for j in range(3):
            mean[i] += covariance[i, j] * y[j]


@njit(cache=True, error_model="numpy")
def _merged(moved, g, acceleration, probabilities, past, seen, still):
    """Return mean (15,), covariance and mean covariance within the hypotheses, (15, 15), of x and d, and the modes.

    Hypotheses with the same new level become one mode. `still` (l,) is the probability of no step, jointly with the
    level. The other arguments are those of `posterior`.
    """
    none, p = probabilities
    _, T, rest = moved
    x, C, Cd = past
    means, B, y, variances = seen
    levels, Tx, Td = p.shape[2], T[:, :6].copy(), T[:, 6:].copy()
    share, first, second = np.zeros(1 + levels), np.zeros((1 + levels, 6)), np.zeros((1 + levels, 6, 6))
    mean, square, within = np.zeros(15), np.zeros((15, 15)), np.zeros((15, 15))
    d, dd, inner, all_dd = np.empty((levels, 9)), np.empty((levels, 9, 9)), np.empty((9, 9)), np.empty((9, 9))
    base, spread, M, all_d = np.empty(6), np.empty((6, 6)), np.empty((6, 9)), np.empty(9)
    half, narrow, to, back = np.empty((6, 9)), np.empty((6, 6)), np.empty(6), np.empty(6)
    for j in range(len(none)):
        q = none[j] + np.sum(p[j])
        if q == 0.0:
            continue
        _step_moments(p[j], g, B[j], y[j], variances, acceleration + means[j, 3:], (d, dd, inner))
        spread[:] = 0.0
        _add_product(Tx, C[j], narrow, spread)
        _apply(Tx, x[j], base)
        for a in range(6):
            for b in range(9):
                M[a, b] = Td[a, b]
                for i in range(6):
                    M[a, b] -= Tx[a, i] * Cd[j, i, b]
        all_d[:] = 0.0
        all_dd[:] = 0.0
        for k in range(1 + levels):
            of_level = none[j] if k == 0 else np.sum(p[j, :, k - 1])
            if of_level == 0.0:
                continue
            to[:] = 0.0
            if k > 0:
                all_d += d[k - 1]
                all_dd += dd[k - 1]
                _apply(M, d[k - 1], to)
                _add_product(M, dd[k - 1], half, second[k])
            share[k] += of_level
            for a in range(6):
                first[k, a] += of_level * base[a] + to[a]
                for b in range(6):
                    second[k, a, b] += of_level * (spread[a, b] + base[a] * base[b]) + base[a] * to[b] + to[a] * base[b]
        _apply(Cd[j], all_d, back)
        _add_product(Cd[j], all_dd, half, square)
        square[6:, 6:] += all_dd
        for a in range(6):
            mean[a] += q * x[j, a] - back[a]
            for b in range(6):
                square[a, b] += q * (C[j, a, b] + x[j, a] * x[j, b]) - x[j, a] * back[b] - back[a] * x[j, b]
                within[a, b] += q * C[j, a, b]
            for b in range(9):
                square[a, 6 + b] += x[j, a] * all_d[b] - half[a, b]
        mean[6:] += all_d
        _add_product(Cd[j], inner, half, within)
        within[:6, 6:] -= half
        within[6:, 6:] += inner
    square[6:, :6] = square[:6, 6:].T
    within[6:, :6] = within[:6, 6:].T
    square -= np.outer(mean, mean)
    weights = np.zeros((1 + levels, 1 + levels))
    weights[0] = still
    for k in range(1 + levels):
        if k > 0:
            weights[k, k] = share[k]
        if share[k] > 0.0:
            first[k] /= share[k]
            second[k] = second[k] / share[k] + rest - np.outer(first[k], first[k])
            first[k] -= T @ mean
    return mean, square, within, (first, second, weights)


@njit(cache=True, error_model="numpy")
def _apply(A, x, out):
    """Write A x, (6,), into `out`."""
    for a in range(6):
        out[a] = 0.0
        for i in range(len(x)):
            out[a] += A[a, i] * x[i]


@njit(cache=True, error_model="numpy")
def _add_product(A, S, half, out):
    """Write A S, (6, n), into `half`, and add A S A', (6, 6), to the first rows and columns of `out`."""
    for a in range(6):
        half[a] = 0.0
        for i in range(len(S)):
            for b in range(len(S)):
                half[a, b] += A[a, i] * S[i, b]
        for b in range(6):
            value = 0.0
            for i in range(len(S)):
                value += half[a, i] * A[b, i]
            out[a, b] += value


@njit(cache=True, error_model="numpy")
def _step_moments(p, g, B, y, variances, acceleration, out):
    """Write moments of d, from one mode, into `out`; p (i, l) is the probability of each instant and level.

    They are p times the mean for each level (l, 9), p times the second moment (l, 9, 9), and the sum over all levels of
    p times the covariance (9, 9). `acceleration` (3,) rad/s² is that before the step.
    """
    first, second, within = out
    first[:] = 0.0
    second[:] = 0.0
    within[:] = 0.0
    step, cu, mean_cu = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    for s in range(len(g)):
        mean_cu[:] = 0.0
        for k in range(p.shape[1]):
            if p[s, k] == 0.0:
                continue
            _estimate(B[s], y[s], variances[1 + k], acceleration, step, cu)
            for a in range(3):
                for i in range(3):
                    first[k, 3 * i + a] += p[s, k] * g[s, i] * step[a]
                for b in range(3):
                    mean_cu[a, b] += p[s, k] * cu[a, b]
                    cu[a, b] = p[s, k] * (cu[a, b] + step[a] * step[b])
            _add_effects(g[s], cu, second[k])
        _add_effects(g[s], mean_cu, within)


@njit(cache=True, error_model="numpy")
def _add_effects(g, square, out):
    """Add to `out`, (9, 9), the moments of a step's effects `g`, (3,), from those of its size, (3, 3)."""
    for i in range(3):
        for m in range(3):
            f = g[i] * g[m]
            for a in range(3):
                for b in range(3):
                    out[3 * i + a, 3 * m + b] += f * square[a, b]
