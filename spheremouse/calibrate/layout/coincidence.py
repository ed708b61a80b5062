"""The other attitude that a view of the ball is most like, and how many discs tell the two apart.

Directions of discs and views in, the least contradictions per view out. Another attitude is a turn of the discs in
`ball` that brings many of them onto discs again; a layout has some thousand such turns, so the search is compiled.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array


@dataclass(frozen=True, slots=True)
class Doubles:
    """For each view of a ball, the other attitude that is most like it."""

    contradictions: Array  # (v,) discs, in parts too, that tell the two apart; `inf` where nothing is alike
    turns: Array  # (v, 3, 3) the other attitude, as a turn of the discs in `ball`; the identity where there is none


def nearest_doubles(directions: Array, pairs: NDArray[np.int32], views: Array, cosine: float, alike: float) -> Doubles:
    """For each view, the turn that the discs in view contradict least, among those that carry a pair onto a pair.

    `directions` (n, 3) unit vectors; `pairs` (h, 4) discs (i, j, a, b): a turn carries i onto a and j onto b as well as
    can be, and is then fitted once to all that it brings together. `views` (v, 3) are directions to the camera, and
    discs whose cosine with one is above `cosine` are in view. A disc counts from 0 where it meets a disc to 1 where it
    is `alike` rad or more from all, with the square. Contradictions are the discs in view that meet none after the
    turn, and those in view after the turn that none has come to meet.
    """
    d = np.ascontiguousarray(directions, dtype=float)
    shown = np.ascontiguousarray((d @ views.T > cosine).T)
    turns, met = _turns(d, np.ascontiguousarray(pairs, dtype=np.int32), _scale(alike))
    small = np.trace(turns, axis1=1, axis2=2) > 1.0 + 2.0 * np.cos(2.0 * alike)  # an inaccuracy, not another attitude
    met[small] = 0.0
    order = np.argsort(-met, kind="stable")  # the likeliest first, so that most of the rest need no second look
    views = np.ascontiguousarray(views, dtype=float)
    found, best = _contradicted(d, turns, met, order[: np.sum(~small)], views, shown, cosine, _scale(alike))
    return Doubles(found, np.concatenate([turns, np.eye(3)[None]])[best])


def turns_of_all(directions: Array, pairs: NDArray[np.int32], alike: float) -> tuple[Array, Array]:
    """The turns that `pairs` stand for, (h, 3, 3), and the share of all discs that each brings onto discs, (h,)."""
    d = np.ascontiguousarray(directions, dtype=float)
    turns, met = _turns(d, np.ascontiguousarray(pairs, dtype=np.int32), _scale(alike))
    return turns, met / len(d)


def weights(directions: Array, turn: Array, alike: float) -> tuple[Array, Array, NDArray[np.int64]]:
    """Weights of the discs before and after a turn, (n,) each, and the disc each one meets, (n,), -1 for none."""
    n = len(directions)
    before, after, partner = np.empty(n), np.empty(n), np.empty(n, np.int64)
    d, Q = np.ascontiguousarray(directions, dtype=float), np.ascontiguousarray(turn, dtype=float)
    _weigh(d, Q, _scale(alike), before, after, partner)
    return before, after, partner


def _scale(alike: float) -> float:
    return 1.0 / (2.0 - 2.0 * np.cos(alike))


@njit(cache=True)
def _turns(d: Array, pairs: NDArray[np.int32], scale: float) -> tuple[Array, Array]:  # pragma: no cover
    """The fitted turns, (h, 3, 3), and how many discs each brings onto others, (h,)."""
    n, h = len(d), len(pairs)
    turns, met = np.zeros((h, 3, 3)), np.empty(h)
    before, after, partner = np.empty(n), np.empty(n), np.empty(n, np.int64)
    for k in range(h):
        _turn(d, pairs[k], turns[k])
        _weigh(d, turns[k], scale, before, after, partner)
        _fit(d, turns[k], before, partner)
        met[k] = _weigh(d, turns[k], scale, before, after, partner)
    return turns, met


@njit(cache=True)
def _contradicted(  # pragma: no cover
    d: Array,
    turns: Array,
    met: Array,
    order: NDArray[np.int64],
    views: Array,
    shown: NDArray[np.bool_],
    cosine: float,
    scale: float,
) -> tuple[Array, NDArray[np.int64]]:
    """Per view the least contradictions, (v,), and the index of the turn that has them, (v,), -1 for none."""
    n, m = len(d), len(views)
    count = np.empty(m)
    for v in range(m):
        count[v] = np.sum(shown[v])
    least = np.min(count)
    found, best = np.full(m, np.inf), np.full(m, -1, np.int64)
    before, after, partner = np.empty(n), np.empty(n), np.empty(n, np.int64)
    for k in order:
        Q = turns[k]
        worth = False  # whatever meets, so many of both views are left
        for v in range(m):
            if count[v] + least - 2.0 * met[k] < found[v]:
                worth = True
                break
        if not worth:
            continue
        _weigh(d, Q, scale, before, after, partner)
        for v in range(m):
            if count[v] + least - 2.0 * met[k] >= found[v]:
                continue
            total = 0.0
            for i in range(n):
                if shown[v, i]:
                    total += before[i]
            if total >= found[v]:
                continue
            x = Q[0, 0] * views[v, 0] + Q[0, 1] * views[v, 1] + Q[0, 2] * views[v, 2]
            y = Q[1, 0] * views[v, 0] + Q[1, 1] * views[v, 1] + Q[1, 2] * views[v, 2]
            z = Q[2, 0] * views[v, 0] + Q[2, 1] * views[v, 1] + Q[2, 2] * views[v, 2]
            for j in range(n):
                if x * d[j, 0] + y * d[j, 1] + z * d[j, 2] > cosine:
                    total += after[j]
            if total < found[v]:
                found[v], best[v] = total, k
    return found, best


@njit(cache=True)
def _turn(d: Array, pair: NDArray[np.int32], Q: Array) -> None:  # pragma: no cover
    """The turn of one pair of directions onto another: middle onto middle, side onto side."""
    one, two = np.empty((3, 3)), np.empty((3, 3))
    for f, i, j in ((one, pair[0], pair[1]), (two, pair[2], pair[3])):
        for c in range(3):
            f[0, c], f[1, c] = d[i, c] + d[j, c], d[i, c] - d[j, c]
        for r in range(2):
            length = np.sqrt(f[r, 0] ** 2 + f[r, 1] ** 2 + f[r, 2] ** 2)
            for c in range(3):
                f[r, c] /= max(length, 1e-12)
        f[2, 0] = f[0, 1] * f[1, 2] - f[0, 2] * f[1, 1]
        f[2, 1] = f[0, 2] * f[1, 0] - f[0, 0] * f[1, 2]
        f[2, 2] = f[0, 0] * f[1, 1] - f[0, 1] * f[1, 0]
    for r in range(3):
        for c in range(3):
            Q[r, c] = two[0, r] * one[0, c] + two[1, r] * one[1, c] + two[2, r] * one[2, c]


@njit(cache=True)
def _weigh(  # pragma: no cover
    d: Array, Q: Array, scale: float, before: Array, after: Array, partner: NDArray[np.int64]
) -> float:
    """Weights of the discs before and after the turn, each one's partner, and the sum of what has met."""
    n = len(d)
    for j in range(n):
        after[j] = 1.0
    met = 0.0
    for i in range(n):
        x = Q[0, 0] * d[i, 0] + Q[0, 1] * d[i, 1] + Q[0, 2] * d[i, 2]
        y = Q[1, 0] * d[i, 0] + Q[1, 1] * d[i, 1] + Q[1, 2] * d[i, 2]
        z = Q[2, 0] * d[i, 0] + Q[2, 1] * d[i, 1] + Q[2, 2] * d[i, 2]
        before[i], partner[i] = 1.0, -1
        for j in range(n):
            off = (2.0 - 2.0 * (x * d[j, 0] + y * d[j, 1] + z * d[j, 2])) * scale
            if off < before[i]:
                before[i], partner[i] = max(off, 0.0), j
            if off < after[j]:
                after[j] = max(off, 0.0)
        met += 1.0 - before[i]
    return met


@njit(cache=True)
def _fit(d: Array, Q: Array, before: Array, partner: NDArray[np.int64]) -> None:  # pragma: no cover
    """One Gauss-Newton step of Q towards the discs it brings together, weighted by how near they are."""
    N, r = np.zeros((3, 3)), np.zeros(3)
    for i in range(len(d)):
        j = partner[i]
        if j < 0:
            continue
        w = 1.0 - before[i]
        x = Q @ d[i]
        y = d[j]
        for a in range(3):
            N[a, a] += w
            for b in range(3):
                N[a, b] -= w * x[a] * x[b]
        r[0] += w * (x[1] * y[2] - x[2] * y[1])
        r[1] += w * (x[2] * y[0] - x[0] * y[2])
        r[2] += w * (x[0] * y[1] - x[1] * y[0])
    for a in range(3):
        N[a, a] += 1e-9
    t = np.linalg.solve(N, r)
    angle = np.sqrt(t[0] ** 2 + t[1] ** 2 + t[2] ** 2)
    if angle < 1e-12:
        return
    K = np.array([[0.0, -t[2], t[1]], [t[2], 0.0, -t[0]], [-t[1], t[0], 0.0]])
    step = np.eye(3) + np.sin(angle) / angle * K + (1.0 - np.cos(angle)) / angle**2 * (K @ K)
    Q[:, :] = step @ Q
