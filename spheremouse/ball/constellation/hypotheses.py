"""Compiled loops of the constellation search: pairs of directions to attitudes, attitudes to one-to-one pairs.

Plain arrays in and out; the statistics, and the reasons for their numbers, are in `constellation`. `seen` (n, 3) and
`known` (m, 3) are unit vectors, rotations turn `known` towards `seen`. Nothing is random; the first of equals wins.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array

_BINS = 256  # of the cosine between two known directions
_SMALL = 1e-6  # squared sine of half an angle: such a pair, or its opposite, fixes no attitude
STEPS = 12  # of pairing and adjustment; most end after four


class Law(NamedTuple):
    """What is seen of a ball at a known attitude, as `constellation.IdentificationPrior` explains."""

    towards: Array  # (3,) unit vector from the ball to the camera
    edge: float  # cosine with `towards` at which a disc is seen half as often as one in the middle
    blur: float  # cosine over which that changes
    detected: float  # probability that a disc in the middle is seen
    hidden: Array  # (a,) alternatives, equally likely, to the probability that it is not
    scales: Array  # (b,) alternatives, equally likely, of the true standard deviation over the one given
    false_mean: float  # false directions expected
    area: float  # sr in which they are uniform


@njit(cache=True)
def pairs_of(seen: Array, groups: int) -> NDArray[np.intp]:
    """Pairs, (p, 2) indices into `seen`: all within each of so many groups of far-apart directions, neighbours first.

    Of any `groups` + 1 directions two are in one group: an attitude that meets so many is found. No choice of pairs
    says that with fewer of them (Turan 1941).
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
            choice, least = -1, np.inf
            for i in range(n):
                if free[i]:
                    worst = 0.0
                    for q in range(start[g], filled):
                        worst = max(worst, parallel[i, member[q]])
                    if worst < least:
                        choice, least = i, worst
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
def _frame(u: Array, v: Array, out: Array) -> None:
    """Columns middle, across and their normal of two directions, into `out` (3, 3): a triad that favours neither."""
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
def _by_angle(known: Array) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Pairs of known directions in bins of their cosine: first of each bin, (bins + 1,), pairs (p, 2), cosines (p,)."""
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
def hypotheses(
    seen: Array, known: Array, pairs: NDArray[np.intp], reach: float, most: int
) -> tuple[Array, Array, NDArray[np.intp]]:
    """Rotations, (h, 3, 3), that carry two known directions to a pair of seen ones, their inflation, (h,), and origin.

    The angles between the two may differ by `reach` rad. The inflation is that of the variance of a further direction
    by the attitude's own error, for the axis worst known; the origin, (h, 4), is the pair seen and the pair known. No
    more than `most`: pairs that come late are left out.
    """
    first, pair, cosine = _by_angle(known)
    R, inflation, origin = np.empty((most, 3, 3)), np.empty(most), np.empty((most, 4), dtype=np.intp)
    S, K = np.empty((3, 3)), np.empty((3, 3))
    count = 0
    for i, j in pairs:
        c = min(1.0, max(-1.0, seen[i, 0] * seen[j, 0] + seen[i, 1] * seen[j, 1] + seen[i, 2] * seen[j, 2]))
        half = min(1.0 + c, 1.0 - c) / 2.0  # the lesser of the squared sine and cosine of half the angle
        if half < _SMALL:
            continue
        angle = np.arccos(c)
        low, high = np.cos(min(np.pi, angle + reach)), np.cos(max(0.0, angle - reach))
        _frame(seen[i], seen[j], S)
        for p in range(first[_bin(low)], first[_bin(high) + 1]):
            c = cosine[p]
            if not low <= c <= high or 1.0 - abs(c) < 2.0 * _SMALL:
                continue
            _frame(known[pair[p, 0]], known[pair[p, 1]], K)
            for side in (1.0, -1.0):  # which of the two is which
                if count == most:
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
    """Cosine between a direction and the nearest of `known` (3, m): the loop that takes the time."""
    best = -1.0
    for j in range(known.shape[1]):
        best = max(best, x * known[0, j] + y * known[1, j] + z * known[2, j])
    return best


@njit(cache=True)
def best_of(
    R: Array, inflation: Array, seen: Array, known: Array, sigma: float, gain: float, margin: float, most: int
) -> Array:
    """Those of the rotations, (h, 3, 3), that fit best, (k, 3, 3), best first; of those within 3 sigma only one.

    A direction that meets a known one is worth `gain` nats, less half its squared distance in standard deviations.
    Left out is what is worse than the best by more than `margin` nats, and all but the best `most`.
    """
    n = len(seen)
    columns = np.ascontiguousarray(known.T)
    kept = np.empty((most, 3, 3))
    score = np.full(most, -np.inf)
    count = 0
    best = 2.0 * gain + margin  # two directions make the hypothesis: more must meet
    alike = 1.0 + 2.0 * np.cos(min(3.0 * sigma, np.pi))
    for h in range(len(R)):
        needed = best - margin
        if count == most:
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
            count = _keep(Q, total, kept, score, count, alike)
            best = max(best, total)
    order = np.argsort(-score[:count], kind="mergesort")
    return kept[order[score[order] > best - margin]]


@njit(cache=True)
def _keep(Q: Array, total: float, kept: Array, score: Array, count: int, alike: float) -> int:
    """Put a rotation among those kept, in place of one like it or of the worst; the new number kept."""
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
def most_agreed(R: Array, seen: Array, known: Array, near: float) -> tuple[Array, int]:
    """Of rotations, (h, 3, 3), that by which most directions meet one at a cosine above `near`, and how many do.

    They are counted on that side where they are fewer. Of equal numbers the smallest rotation; the identity of none.
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
                if x * known[j, 0] + y * known[j, 1] + z * known[j, 2] > near:
                    row = met[j] = True
            rows += row
            if rows + n - 1 - i < number:
                break
        agreed = min(rows, met.sum())
        small = Q[0, 0] + Q[1, 1] + Q[2, 2]
        if agreed > number or (agreed == number and small > trace):
            best, number, trace = Q.copy(), agreed, small
    return best, number
