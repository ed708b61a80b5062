"""Compiled loops of the constellation search: pairs of directions to attitudes, attitudes to one-to-one pairs.

Plain arrays in and out; the statistics, and the reasons for their numbers, are in `constellation`. `seen` (n, 3) and
`known` (m, 3) are unit vectors, rotations turn `known` towards `seen`. Nothing is random; the first of equals wins.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array

_BINS = 256  # of the cosine between two known directions
_SMALL = 1e-6  # squared sine of half an angle: such a pair, or its opposite, fixes no attitude
_STEPS = 12  # of pairing and adjustment; most end after four


class Law(NamedTuple):
    """What is seen of a ball at a known attitude, as `constellation.Model` explains."""

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


@njit(cache=True)
def match(worth: Array) -> NDArray[np.intp]:
    """One-to-one pairs of greatest total worth: for each row of `worth`, (n, m), its column, or -1.

    A row may stay alone for 0. Where the best columns of all rows differ, that is it.
    """
    n, m = worth.shape
    column = np.full(n, -1)
    taken = np.zeros(m, dtype=np.bool_)
    for i in range(n):
        j = int(np.argmax(worth[i]))
        if worth[i, j] <= 0.0:
            continue
        if taken[j]:
            wanted = np.array([c for c in range(m) if worth[:, c].max() > 0.0])
            return _augment(worth, wanted)
        taken[j] = True
        column[i] = j
    return column


@njit(cache=True)
def _augment(worth: Array, wanted: NDArray[np.intp]) -> NDArray[np.intp]:
    """`match` by shortest augmenting paths (Kuhn 1955, Munkres 1957), among the columns `wanted` and one spare a row.

    Rows and columns count from 1 here; column 0 holds the row that is being placed.
    """
    n, k = len(worth), len(wanted)
    width = k + n + 1
    u, v = np.zeros(n + 1), np.zeros(width)
    owner, before = np.zeros(width, dtype=np.intp), np.zeros(width, dtype=np.intp)
    least, used = np.empty(width), np.empty(width, dtype=np.bool_)
    for row in range(1, n + 1):
        owner[0] = row
        here = 0
        least[:] = np.inf
        used[:] = False
        while owner[here] != 0 or here == 0:
            used[here] = True
            i = owner[here]
            step, following = np.inf, 0
            for j in range(1, width):
                if used[j]:
                    continue
                cost = -max(0.0, worth[i - 1, wanted[j - 1]]) if j <= k else 0.0
                reduced = cost - u[i] - v[j]
                if reduced < least[j]:
                    least[j], before[j] = reduced, here
                if least[j] < step:
                    step, following = least[j], j
            for j in range(width):
                if used[j]:
                    u[owner[j]] += step
                    v[j] -= step
                else:
                    least[j] -= step
            here = following
        while here != 0:
            owner[here] = owner[before[here]]
            here = before[here]
    column = np.full(n, -1)
    for j in range(1, k + 1):
        if owner[j] > 0 and worth[owner[j] - 1, wanted[j - 1]] > 0.0:
            column[owner[j] - 1] = wanted[j - 1]
    return column


@njit(cache=True)
def _turned(R: Array, v: Array) -> Array:
    """exp(v) R, (3, 3), for a rotation vector v, (3,), by the unit quaternion."""
    angle = math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    s = 0.5 if angle < 1e-8 else math.sin(angle / 2.0) / angle
    w, x, y, z = math.cos(angle / 2.0), s * v[0], s * v[1], s * v[2]
    out = np.empty((3, 3))
    for k in range(3):
        a, b, c = R[0, k], R[1, k], R[2, k]
        out[0, k] = a - 2.0 * (y * y + z * z) * a + 2.0 * (x * y - w * z) * b + 2.0 * (x * z + w * y) * c
        out[1, k] = b - 2.0 * (x * x + z * z) * b + 2.0 * (x * y + w * z) * a + 2.0 * (y * z - w * x) * c
        out[2, k] = c - 2.0 * (x * x + y * y) * c + 2.0 * (x * z - w * y) * a + 2.0 * (y * z + w * x) * b
    return out


@njit(cache=True)
def _solved(A: Array, g: Array) -> tuple[Array, float]:
    """Solution, (3,), of a symmetric A v = g, and the determinant; no solution, zero, where that is zero."""
    c0, c1 = A[1, 1] * A[2, 2] - A[1, 2] ** 2, A[0, 2] * A[1, 2] - A[0, 1] * A[2, 2]
    c2 = A[0, 1] * A[1, 2] - A[0, 2] * A[1, 1]
    det = A[0, 0] * c0 + A[0, 1] * c1 + A[0, 2] * c2
    v = np.zeros(3)
    if det <= 1e-9 * (A[0, 0] + A[1, 1] + A[2, 2]) ** 3:
        return v, 0.0
    d1, d2 = A[0, 0] * A[2, 2] - A[0, 2] ** 2, A[0, 1] * A[0, 2] - A[0, 0] * A[1, 2]
    v[0] = (c0 * g[0] + c1 * g[1] + c2 * g[2]) / det
    v[1] = (c1 * g[0] + d1 * g[1] + d2 * g[2]) / det
    v[2] = (c2 * g[0] + d2 * g[1] + (A[0, 0] * A[1, 1] - A[0, 1] ** 2) * g[2]) / det
    return v, det


@njit(cache=True)
def _sight(R: Array, known: Array, law: Law) -> tuple[Array, Array]:
    """Known directions turned, (m, 3), and how likely each is seen, were none hidden, (m,)."""
    m = len(known)
    p, visible = np.empty((m, 3)), np.empty(m)
    for j in range(m):
        cosine = 0.0
        for r in range(3):
            p[j, r] = R[r, 0] * known[j, 0] + R[r, 1] * known[j, 1] + R[r, 2] * known[j, 2]
            cosine += p[j, r] * law.towards[r]
        visible[j] = 1.0 / (1.0 + math.exp(min(50.0, (law.edge - cosine) / law.blur)))
    return p, visible


@njit(cache=True)
def most_worth(variance: float, law: Law) -> float:
    """Log likelihood ratio of a direction that meets a disc in plain sight exactly, over one false direction more."""
    false = 2.0 * law.false_mean / (1.0 + law.false_mean) / law.area
    return math.log(law.detected / (1.0 - law.detected)) - math.log(2.0 * np.pi * variance * false)


@njit(cache=True)
def _worth(p: Array, visible: Array, seen: Array, variance: Array, wide: float, law: Law) -> Array:
    """Log likelihood ratio, (n, m), of each direction being each known one, over being false and that one unseen."""
    n, m = len(seen), len(p)
    worth = np.full((n, m), -1.0)
    cost, gate = np.empty(n), np.empty(n)
    for i in range(n):
        most = most_worth(variance[i], law)
        cost[i] = math.log(law.detected / (1.0 - law.detected)) - most
        gate[i] = 1.0 - wide * variance[i] * most
    for j in range(m):
        if visible[j] < 1e-4:
            continue
        odds = np.nan
        for i in range(n):
            d = p[j, 0] * seen[i, 0] + p[j, 1] * seen[i, 1] + p[j, 2] * seen[i, 2]
            if d > gate[i]:
                if math.isnan(odds):
                    odds = math.log(law.detected * visible[j] / (1.0 - law.detected * visible[j]))
                worth[i, j] = odds - cost[i] - (1.0 - d) / (variance[i] * wide)
    return worth


@njit(cache=True)
def _normal_equations(p: Array, column: NDArray[np.intp], seen: Array, variance: Array, A: Array, g: Array) -> None:
    """Information (3, 3) and gradient (3,) of a small turn of the known directions p, (m, 3), into A and g."""
    A[:] = 0.0
    g[:] = 0.0
    for i in range(len(seen)):
        if column[i] < 0:
            continue
        w = 1.0 / variance[i]
        q, s = p[column[i]], seen[i]
        for r in range(3):
            a, b = (r + 1) % 3, (r + 2) % 3
            g[r] += w * (q[a] * s[b] - q[b] * s[a])
            A[r, r] += w
            for k in range(3):
                A[r, k] -= w * q[r] * q[k]


@njit(cache=True)
def refine(
    R: Array, seen: Array, known: Array, variance: Array, law: Law, first: float
) -> tuple[Array, NDArray[np.intp], Array, float]:
    """Alternate one-to-one pairs and Gauss-Newton steps of Wahba's problem, from attitude R, (3, 3).

    `variance` (n,) rad² of each direction, times `first` for the first pairs. Gives the attitude, for each direction
    its known one or -1, (n,), the attitude's information, (3, 3) 1/rad², and its determinant, 0 where it is not fixed.
    """
    column = np.full(len(seen), -1)
    A, g, det = np.zeros((3, 3)), np.zeros(3), 0.0
    for step in range(_STEPS):
        p, visible = _sight(R, known, law)
        now = match(_worth(p, visible, seen, variance, first if step == 0 else 1.0, law))
        same = step > 1 and np.all(now == column)
        column = now
        _normal_equations(p, column, seen, variance, A, g)
        v, det = _solved(A, g)
        R = _turned(R, v)
        if det == 0.0 or (same and g @ v < 1e-8):  # 1e-4 standard deviations; what this step leaves is far less
            break
    return R, column, A, det


@njit(cache=True)
def log_sum(terms: Array) -> float:
    """log(sum(exp(terms))) without overflow."""
    top = terms.max()
    return top if math.isinf(top) else top + math.log(np.exp(terms - top).sum())


@njit(cache=True)
def false_count(k: int, mean: float, area: float) -> float:
    """Log density of k false directions: uniform over `area` sr, their number geometric with that mean."""
    rate = mean / (1.0 + mean)
    return math.log(1.0 - rate) + k * math.log(rate / area) + math.lgamma(k + 1.0)


@njit(cache=True)
def evidence(
    R: Array, column: NDArray[np.intp], det: float, seen: Array, known: Array, variance: Array, law: Law
) -> float:
    """Log density of all that is and is not seen, over attitudes about R, all equally likely before (Laplace 1774).

    `column` and `det` as `refine` gives them.
    """
    if det <= 0.0:
        return -np.inf
    p, visible = _sight(R, known, law)
    met = np.zeros(len(known), dtype=np.bool_)
    k, square, logs = 0, 0.0, 0.0
    for i in range(len(seen)):
        if column[i] >= 0:
            k += 1
            met[column[i]] = True
            for r in range(3):
                square += (seen[i, r] - p[column[i], r]) ** 2 / variance[i]
            logs += math.log(2.0 * np.pi * variance[i])
    width = 1.5 * math.log(2.0 * np.pi) - 0.5 * math.log(det) - math.log(8.0 * np.pi**2)  # of all attitudes
    noise = np.empty(len(law.scales))
    for s, scale in enumerate(law.scales):
        noise[s] = min(0.0, width + 3.0 * math.log(scale)) - 2.0 * k * math.log(scale) - 0.5 * square / scale**2
    sight = np.zeros(len(law.hidden))
    for j in range(len(known)):
        if visible[j] > 1e-4:
            for q, hidden in enumerate(law.hidden):
                chance = (1.0 - hidden) * visible[j]
                sight[q] += math.log(chance if met[j] else 1.0 - chance)
    mean = math.log(len(law.scales) * len(law.hidden))
    return log_sum(noise) - logs + log_sum(sight) - mean + false_count(len(seen) - k, law.false_mean, law.area)


@njit(cache=True)
def attitudes(
    starts: Array, seen: Array, known: Array, variance: Array, law: Law, first: float
) -> tuple[Array, NDArray[np.intp], Array, Array]:
    """`refine` and `evidence` of each start, (h, 3, 3): rotations, columns (h, n), information (h, 3, 3), log evidence.

    A start that ends at the pairs of an earlier one has no evidence of its own.
    """
    h, n = len(starts), len(seen)
    R, columns, A, value = np.empty((h, 3, 3)), np.empty((h, n), dtype=np.intp), np.empty((h, 3, 3)), np.empty(h)
    for s in range(h):
        R[s], columns[s], A[s], det = refine(starts[s], seen, known, variance, law, first)
        value[s] = evidence(R[s], columns[s], det, seen, known, variance, law)
        for t in range(s):
            if np.all(columns[t] == columns[s]):
                value[s] = -np.inf
                break
    return R, columns, A, value


@njit(cache=True)
def only_two(
    R: Array, origin: NDArray[np.intp], seen: Array, known: Array, variance: Array, law: Law, most: int
) -> float:
    """Log evidence that nothing but the two directions that made it meets: of all hypotheses together, from a sample.

    Arguments as `hypotheses` gives them; `most` is the size of the sample.
    """
    if len(R) == 0:
        return -np.inf
    step = max(1, len(R) // most)
    terms = np.empty((len(R) + step - 1) // step)
    A, g = np.empty((3, 3)), np.empty(3)
    for t in range(len(terms)):
        h = t * step
        column = np.full(len(seen), -1)
        column[origin[h, 0]], column[origin[h, 1]] = origin[h, 2], origin[h, 3]
        p, _ = _sight(R[h], known, law)
        _normal_equations(p, column, seen, variance, A, g)
        _, det = _solved(A, g)
        terms[t] = evidence(R[h], column, det, seen, known, variance, law)
    return log_sum(terms) + math.log(len(R) / len(terms))


@njit(cache=True)
def share(R: Array, A: Array, value: Array, null: float, within: float) -> tuple[int, float]:
    """Best of the attitudes, and the probability that it, or one as good as the same, is not the true one.

    `value` (h,) log evidence, `null` that of none of them; the same are those `within` squared standard deviations.
    """
    best = int(np.argmax(value))
    top = max(value[best], null)
    others = math.exp(null - top)
    own = 0.0
    for h in range(len(value)):
        D = R[h] @ R[best].T
        cosine = min(1.0, max(-1.0, (D[0, 0] + D[1, 1] + D[2, 2] - 1.0) / 2.0))
        v = np.array([D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1]]) / math.sqrt(
            2.0 + 2.0 * max(0.0, cosine)
        )
        if h == best or (cosine > 0.0 and v @ A[best] @ v < within):
            own += math.exp(value[h] - top)
        else:
            others += math.exp(value[h] - top)
    return best, others / (own + others)
