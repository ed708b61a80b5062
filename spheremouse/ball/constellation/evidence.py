"""How well an attitude explains the points, and with what probability by chance."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spheremouse.ball.constellation.hypotheses import STEPS, Law
from spheremouse.geometry.matching import match
from spheremouse.geometry.rotation import Array


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
def max_log_likelihood_ratio(variance: float, law: Law) -> float:
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
        most = max_log_likelihood_ratio(variance[i], law)
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
    for step in range(STEPS):
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
