"""Attitude hypotheses from pairs of directions, and their ranking, in compiled loops (Mortari et al. 2004).

`seen` (n, 3) and `known` (m, 3) are unit vectors. A rotation maps `known` to `seen`. Nothing is random. The first of
equals wins. `identify.IdentificationPrior` has the numbers and their reasons.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array

_BINS = 256  # of the cosine between two known directions
_MIN_SQUARED_SINE = 1e-6  # of half an angle: a smaller one, or that of the opposite direction, fixes no attitude
MAX_STEPS = 12  # of pairing and adjustment; most end after four


class Law(NamedTuple):
    """Observation model of a ball at a known attitude."""

    view_axis: Array  # (3,) unit vector from the ball to the camera
    half_cosine: float  # cosine with `view_axis` at which a disc is seen half as often as one in the middle
    limb_width: float  # cosine over which that changes
    detection_probability: float  # of a disc in the middle
    miss_probabilities: Array  # (a,) equally likely probabilities that a disc in the middle is not seen
    sigma_scales: Array  # (b,) equally likely ratios of the true standard deviation to the given one
    false_mean: float  # expected number of false directions
    area: float  # sr in which they are uniform


@njit(cache=True)
def select_pairs(seen: Array, groups: int) -> NDArray[np.intp]:
    """Return pairs, (p, 2) indices into `seen`: all pairs within each of `groups` groups of distant directions.

    Any `groups` + 1 directions contain a pair, so every attitude with that many matches is found. No smaller set of
    pairs has this property (Turan 1941).
    """
    n = len(seen)
    parallel = np.abs(seen @ seen.T)
    member = np.empty(n, dtype=np.intp)
    start = np.empty(groups + 1, dtype=np.intp)
    free = np.ones(n, dtype=np.bool_)
    filled = 0
    for g in range(groups):
        start[g] = filled
        for _ in range(n // groups + (g < n % groups)):
            choice, lowest = -1, np.inf
            for i in range(n):
                if free[i]:
                    nearest_member = 0.0
                    for q in range(start[g], filled):
                        nearest_member = max(nearest_member, parallel[i, member[q]])
                    if nearest_member < lowest:
                        choice, lowest = i, nearest_member
            member[filled] = choice
            free[choice] = False
            filled += 1
    start[groups] = n
    pairs = np.empty((n * n, 2), dtype=np.intp)
    count = 0
    for step in range(1, n // groups + 1):
        for g in range(groups):
            for q in range(start[g], start[g + 1] - step):
                pairs[count, 0], pairs[count, 1] = member[q], member[q + step]
                count += 1
    return pairs[:count]


@njit(cache=True)
def _triad(u: Array, v: Array, out: Array) -> None:
    """Write a symmetric triad of two directions to `out` (3, 3): columns along u + v, u - v and their normal."""
    s = d = 0.0
    for k in range(3):
        out[k, 0] = u[k] + v[k]
        out[k, 1] = u[k] - v[k]
        s += out[k, 0] ** 2
        d += out[k, 1] ** 2
    s, d = 1.0 / np.sqrt(s), 1.0 / np.sqrt(d)
    for k in range(3):
        out[k, 0] *= s
        out[k, 1] *= d
    out[0, 2] = out[1, 0] * out[2, 1] - out[2, 0] * out[1, 1]
    out[1, 2] = out[2, 0] * out[0, 1] - out[0, 0] * out[2, 1]
    out[2, 2] = out[0, 0] * out[1, 1] - out[1, 0] * out[0, 1]


@njit(cache=True)
def _bin_pairs(known: Array) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Sort pairs of known directions into bins of their cosine.

    Return the first pair of each bin, (bins + 1,), the pairs, (p, 2), and their cosines, (p,).
    """
    m = len(known)
    cosine = known @ known.T
    first = np.zeros(_BINS + 1, dtype=np.intp)
    for a in range(m):
        for b in range(a + 1, m):
            first[_bin(cosine[a, b]) + 1] += 1
    first = np.cumsum(first)
    place = first.copy()
    pair, value = np.empty((m * (m - 1) // 2, 2), dtype=np.intp), np.empty(m * (m - 1) // 2)
    for a in range(m):
        for b in range(a + 1, m):
            k = _bin(cosine[a, b])
            pair[place[k], 0], pair[place[k], 1] = a, b
            value[place[k]] = cosine[a, b]
            place[k] += 1
    return first, pair, value


@njit(cache=True)
def _bin(cosine: float) -> int:
    return min(_BINS - 1, max(0, int((cosine + 1.0) * (_BINS / 2))))


@njit(cache=True)
def attitude_hypotheses(
    seen: Array, known: Array, pairs: NDArray[np.intp], tolerance: float, max_count: int
) -> tuple[Array, Array, NDArray[np.intp]]:
    """Return rotations, (h, 3, 3), that map two known directions to a pair of seen ones, with inflation and origin.

    The angles of the two pairs may differ by `tolerance` rad. The inflation, (h,), is the factor by which the error of
    the rotation increases the variance of another direction along the worst axis. The origin, (h, 4), has the indices
    of the seen and of the known pair. The function stops after `max_count` rotations.
    """
    first, pair, cosine = _bin_pairs(known)
    R, inflation, origin = np.empty((max_count, 3, 3)), np.empty(max_count), np.empty((max_count, 4), dtype=np.intp)
    S, K = np.empty((3, 3)), np.empty((3, 3))
    count = 0
    for i, j in pairs:
        c = min(1.0, max(-1.0, seen[i, 0] * seen[j, 0] + seen[i, 1] * seen[j, 1] + seen[i, 2] * seen[j, 2]))
        half = min(1.0 + c, 1.0 - c) / 2.0  # smaller one of squared sine and squared cosine of half the angle
        if half < _MIN_SQUARED_SINE:
            continue
        angle = np.arccos(c)
        low, high = np.cos(min(np.pi, angle + tolerance)), np.cos(max(0.0, angle - tolerance))
        _triad(seen[i], seen[j], S)
        for p in range(first[_bin(low)], first[_bin(high) + 1]):
            c = cosine[p]
            if not low <= c <= high or 1.0 - abs(c) < 2.0 * _MIN_SQUARED_SINE:
                continue
            _triad(known[pair[p, 0]], known[pair[p, 1]], K)
            for side in (1.0, -1.0):  # both orders of the known pair
                if count == max_count:
                    return R, inflation, origin
                for r in range(3):
                    for k in range(3):
                        R[count, r, k] = S[r, 0] * K[k, 0] + side * (S[r, 1] * K[k, 1] + S[r, 2] * K[k, 2])
                inflation[count] = 1.0 + 0.5 / half
                origin[count, 0], origin[count, 1] = i, j
                origin[count, 2 if side > 0.0 else 3], origin[count, 3 if side > 0.0 else 2] = pair[p]
                count += 1
    return R[:count], inflation[:count], origin[:count]


@njit(cache=True, fastmath=True)
def _nearest(x: float, y: float, z: float, known: Array) -> float:
    """Return the cosine between a direction and the nearest of `known` (3, m). This loop takes most of the time."""
    best = -1.0
    for j in range(known.shape[1]):
        best = max(best, x * known[0, j] + y * known[1, j] + z * known[2, j])
    return best


@njit(cache=True)
def best_hypotheses(
    R: Array, inflation: Array, seen: Array, known: Array, sigma: float, gain: float, margin: float, max_count: int
) -> Array:
    """Return the rotations, out of (h, 3, 3), with the best scores, (k, 3, 3), best first, one within 3 sigma.

    A direction near a known one scores `gain` nats minus half its squared distance in standard deviations. The result
    has at most `max_count` rotations, none worse than the best one by more than `margin` nats. `inflation` (h,) is that
    of `attitude_hypotheses`. `seen` (n, 3) and `known` (m, 3) are unit vectors, with `sigma` rad.
    """
    n = len(seen)
    columns = np.ascontiguousarray(known.T)
    kept = np.empty((max_count, 3, 3))
    score = np.full(max_count, -np.inf)
    count = 0
    best = 2.0 * gain + margin  # two directions define the hypothesis: others must match
    alike = 1.0 + 2.0 * np.cos(min(3.0 * sigma, np.pi))
    for h in range(len(R)):
        needed = best - margin
        if count == max_count:
            needed = max(needed, score.min())
        weight = 1.0 / (sigma * sigma * inflation[h])
        Q = R[h]
        total, left = 0.0, n
        for i in range(n):
            a, b, c = seen[i]
            x = Q[0, 0] * a + Q[1, 0] * b + Q[2, 0] * c
            y = Q[0, 1] * a + Q[1, 1] * b + Q[2, 1] * c
            z = Q[0, 2] * a + Q[1, 2] * b + Q[2, 2] * c
            total += max(0.0, gain - (1.0 - _nearest(x, y, z, columns)) * weight)
            left -= 1
            if total + left * gain <= needed:
                break
        if total + left * gain > needed:
            count = _insert(Q, total, kept, score, count, alike)
            best = max(best, total)
    order = np.argsort(-score[:count], kind="mergesort")
    return kept[order[score[order] > best - margin]]


@njit(cache=True)
def _insert(Q: Array, total: float, kept: Array, score: Array, count: int, alike: float) -> int:
    """Insert a rotation, in place of a similar one or of the worst. Return the new number."""
    place = -1
    for h in range(count):
        trace = 0.0
        for r in range(3):
            for k in range(3):
                trace += Q[r, k] * kept[h, r, k]
        if trace > alike:
            place = h
            break
    if place < 0:
        if count < len(score):
            place = count
            count += 1
        else:
            place = int(np.argmin(score))
    if total > score[place]:
        score[place] = total
        kept[place] = Q
    return count


@njit(cache=True)
def most_common_rotation(R: Array, seen: Array, known: Array, min_cosine: float) -> tuple[Array, int]:
    """Return the rotation, out of (h, 3, 3), with the most matches at a cosine above `min_cosine`, and their number.

    The number is that of matched `seen` or of matched `known`, whichever is smaller. Among equal numbers the smallest
    rotation wins. Without hypotheses the result is the identity and 0.
    """
    n, m = len(seen), len(known)
    best, number, trace = np.eye(3), 0, -np.inf
    met = np.empty(m, dtype=np.bool_)
    for h in range(len(R)):
        Q = R[h]
        met[:] = False
        rows = 0
        for i in range(n):
            a, b, c = seen[i]
            x = Q[0, 0] * a + Q[1, 0] * b + Q[2, 0] * c
            y = Q[0, 1] * a + Q[1, 1] * b + Q[2, 1] * c
            z = Q[0, 2] * a + Q[1, 2] * b + Q[2, 2] * c
            row = False
            for j in range(m):
                if x * known[j, 0] + y * known[j, 1] + z * known[j, 2] > min_cosine:
                    row = met[j] = True
            rows += row
            if rows + n - 1 - i < number:
                break
        agreed = min(rows, met.sum())
        small = Q[0, 0] + Q[1, 1] + Q[2, 2]
        if agreed > number or (agreed == number and small > trace):
            best, number, trace = Q.copy(), agreed, small
    return best, number
