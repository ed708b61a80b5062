"""Adjustment of an attitude to directions, its log evidence, and the probability that it is wrong.

`seen` (n, 3) and `known` (m, 3) are unit vectors, `variance` (n,) rad² that of each seen one per axis. A rotation maps
`known` to `seen`.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spheremouse.ball.constellation.hypotheses import MAX_STEPS, Law
from spheremouse.geometry.matching import match
from spheremouse.geometry.rotation import Array, exp_into


@njit(cache=True)
def _solve(A: Array, g: Array) -> tuple[Array, float]:
    """Return the solution v, (3,), of a symmetric A v = g, and the determinant; zero for a singular A."""
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
def _visibility(R: Array, known: Array, law: Law) -> tuple[Array, Array]:
    """Return the rotated known directions, (m, 3), and their probabilities to be visible without occlusion, (m,)."""
    m = len(known)
    p, visible = np.empty((m, 3)), np.empty(m)
    for j in range(m):
        cosine = 0.0
        for r in range(3):
            p[j, r] = R[r, 0] * known[j, 0] + R[r, 1] * known[j, 1] + R[r, 2] * known[j, 2]
            cosine += p[j, r] * law.view_axis[r]
        visible[j] = 1.0 / (1.0 + math.exp(min(50.0, (law.half_cosine - cosine) / law.limb_width)))
    return p, visible


@njit(cache=True)
def max_log_likelihood_ratio(variance: float, law: Law) -> float:
    """Return the log likelihood ratio of an exact match with a visible disc, against one more false direction."""
    false = 2.0 * law.false_mean / (1.0 + law.false_mean) / law.area
    odds = law.detection_probability / (1.0 - law.detection_probability)
    return math.log(odds) - math.log(2.0 * np.pi * variance * false)


@njit(cache=True)
def _match_ratios(p: Array, visible: Array, seen: Array, variance: Array, widening: float, law: Law) -> Array:
    """Return log likelihood ratios, (n, m), of a match of two directions against a false and an unseen one."""
    n, m = len(seen), len(p)
    ratio = np.full((n, m), -1.0)
    cost, gate = np.empty(n), np.empty(n)
    for i in range(n):
        exact_match = max_log_likelihood_ratio(variance[i], law)
        cost[i] = math.log(law.detection_probability / (1.0 - law.detection_probability)) - exact_match
        gate[i] = 1.0 - widening * variance[i] * exact_match
    for j in range(m):
        if visible[j] < 1e-4:
            continue
        log_odds = np.nan
        for i in range(n):
            d = p[j, 0] * seen[i, 0] + p[j, 1] * seen[i, 1] + p[j, 2] * seen[i, 2]
            if d > gate[i]:
                if math.isnan(log_odds):
                    seen_probability = law.detection_probability * visible[j]
                    log_odds = math.log(seen_probability / (1.0 - seen_probability))
                ratio[i, j] = log_odds - cost[i] - (1.0 - d) / (variance[i] * widening)
    return ratio


@njit(cache=True)
def _normal_equations(p: Array, column: NDArray[np.intp], seen: Array, variance: Array, A: Array, g: Array) -> None:
    """Write information (3, 3) and gradient (3,) of a small rotation of the known directions p, (m, 3), to A and g."""
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
def refine_attitude(
    R: Array, seen: Array, known: Array, variance: Array, law: Law, first: float
) -> tuple[Array, NDArray[np.intp], Array, float]:
    """Alternate one-to-one matches and Gauss-Newton steps of Wahba's problem, from attitude R, (3, 3).

    The first matches use the variance times `first`. Return the attitude, the index of the known direction or -1 for
    each seen one, (n,), the information of the attitude, (3, 3) 1/rad², and its determinant, 0 for a singular one.
    """
    column = np.full(len(seen), -1)
    A, g, det, turn = np.zeros((3, 3)), np.zeros(3), 0.0, np.empty((3, 3))
    for step in range(MAX_STEPS):
        p, visible = _visibility(R, known, law)
        now = match(_match_ratios(p, visible, seen, variance, first if step == 0 else 1.0, law))
        same = step > 1 and np.all(now == column)
        column = now
        _normal_equations(p, column, seen, variance, A, g)
        v, det = _solve(A, g)
        exp_into(v, turn)
        R = turn @ R
        if det == 0.0 or (same and g @ v < 1e-8):  # 1e-4 standard deviations; the rest is far smaller after this step
            break
    return R, column, A, det


@njit(cache=True)
def log_sum_exp(terms: Array) -> float:
    """Return log(sum(exp(terms))) without overflow."""
    top = terms.max()
    return top if math.isinf(top) else top + math.log(np.exp(terms - top).sum())


@njit(cache=True)
def false_log_density(k: int, mean: float, area: float) -> float:
    """Return the log density of k false directions, uniform over `area` sr, with a geometric number of that mean."""
    rate = mean / (1.0 + mean)
    return math.log(1.0 - rate) + k * math.log(rate / area) + math.lgamma(k + 1.0)


@njit(cache=True)
def log_evidence(
    R: Array, column: NDArray[np.intp], det: float, seen: Array, known: Array, variance: Array, law: Law
) -> float:
    """Return the log density of all seen and unseen directions, integrated over attitudes about R (Laplace 1774).

    The prior over attitudes is uniform. `column` (n,) and `det` are those of `refine_attitude`. `seen` (n, 3) obj and
    `known` (m, 3) ball are unit vectors, `variance` (n,) rad² that of a seen one per axis.
    """
    if det <= 0.0:
        return -np.inf
    p, visible = _visibility(R, known, law)
    matched = np.zeros(len(known), dtype=np.bool_)
    k, square, logs = 0, 0.0, 0.0
    for i in range(len(seen)):
        if column[i] >= 0:
            k += 1
            matched[column[i]] = True
            for r in range(3):
                square += (seen[i, r] - p[column[i], r]) ** 2 / variance[i]
            logs += math.log(2.0 * np.pi * variance[i])
    # as a fraction of all attitudes
    width = 1.5 * math.log(2.0 * np.pi) - 0.5 * math.log(det) - math.log(8.0 * np.pi**2)
    noise = np.empty(len(law.sigma_scales))
    for s, scale in enumerate(law.sigma_scales):
        noise[s] = min(0.0, width + 3.0 * math.log(scale)) - 2.0 * k * math.log(scale) - 0.5 * square / scale**2
    log_visibility = np.zeros(len(law.miss_probabilities))
    for j in range(len(known)):
        if visible[j] > 1e-4:
            for q, hidden in enumerate(law.miss_probabilities):
                chance = (1.0 - hidden) * visible[j]
                log_visibility[q] += math.log(chance if matched[j] else 1.0 - chance)
    mean = math.log(len(law.sigma_scales) * len(law.miss_probabilities))
    false = false_log_density(len(seen) - k, law.false_mean, law.area)
    return log_sum_exp(noise) - logs + log_sum_exp(log_visibility) - mean + false


@njit(cache=True)
def refine_attitudes(
    starts: Array, seen: Array, known: Array, variance: Array, law: Law, first: float
) -> tuple[Array, NDArray[np.intp], Array, Array]:
    """Refine each start, (h, 3, 3); return rotations, columns (h, n), information (h, 3, 3) and log evidence (h,).

    The evidence is -inf for a start that ends with the matches of an earlier one. The directions are those of
    `log_evidence`.
    """
    h, n = len(starts), len(seen)
    R, columns, A, value = np.empty((h, 3, 3)), np.empty((h, n), dtype=np.intp), np.empty((h, 3, 3)), np.empty(h)
    for s in range(h):
        R[s], columns[s], A[s], det = refine_attitude(starts[s], seen, known, variance, law, first)
        value[s] = log_evidence(R[s], columns[s], det, seen, known, variance, law)
        for t in range(s):
            if np.all(columns[t] == columns[s]):
                value[s] = -np.inf
                break
    return R, columns, A, value


@njit(cache=True)
def two_match_log_evidence(
    R: Array, origin: NDArray[np.intp], seen: Array, known: Array, variance: Array, law: Law, sample_size: int
) -> float:
    """Return the log evidence that only the two directions of a hypothesis match, summed over all hypotheses.

    It is estimated from a sample of `sample_size` hypotheses. R (h, 3, 3) and `origin` (h, 4) are those of
    `attitude_hypotheses`, the directions those of `log_evidence`.
    """
    if len(R) == 0:
        return -np.inf
    step = max(1, len(R) // sample_size)
    terms = np.empty((len(R) + step - 1) // step)
    A, g = np.empty((3, 3)), np.empty(3)
    for t in range(len(terms)):
        h = t * step
        column = np.full(len(seen), -1)
        column[origin[h, 0]], column[origin[h, 1]] = origin[h, 2], origin[h, 3]
        p, _ = _visibility(R[h], known, law)
        _normal_equations(p, column, seen, variance, A, g)
        _, det = _solve(A, g)
        terms[t] = log_evidence(R[h], column, det, seen, known, variance, law)
    return log_sum_exp(terms) + math.log(len(R) / len(terms))


@njit(cache=True)
def posterior_error(R: Array, A: Array, value: Array, null: float, gate: float) -> tuple[int, float]:
    """Return the index of the best attitude and the probability that it is wrong.

    R and A (h, 3, 3) are attitudes and their information, `value` (h,) their log evidence, and `null` that of no
    attitude. Attitudes within `gate` squared standard deviations of the best one count as the same.
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
        if h == best or (cosine > 0.0 and v @ A[best] @ v < gate):
            own += math.exp(value[h] - top)
        else:
            others += math.exp(value[h] - top)
    return best, others / (own + others)
