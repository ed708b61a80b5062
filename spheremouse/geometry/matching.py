"""Matching of points: one-to-one assignment, mutual nearest neighbours, non-maximum suppression."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array
from spheremouse.native import kernels


def assign(cost: Array, gate: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return one-to-one pairs (rows, columns) of a cost matrix, (n, m), all below `gate`.

    They minimise the sum of costs, where an unpaired row costs `gate`.
    """
    column = kernels.match(np.subtract(gate, cost, order="C", dtype=float))
    rows = np.flatnonzero(column >= 0)
    return rows, column[rows]


@njit(cache=True)
def mutual_nearest(distance: Array) -> NDArray[np.intp]:
    """Return for each row of a distance matrix, (n, m), the column if each is the other's nearest, else -1.

    The distance `inf` is no pair.
    """
    column = np.full(len(distance), -1)
    for i in range(len(distance) if distance.shape[1] else 0):
        j = int(np.argmin(distance[i]))
        if distance[i, j] < np.inf and np.argmin(distance[:, j]) == i:
            column[i] = j
    return column


def suppress(points: Array, radius: Array, norm: float = 2.0) -> NDArray[np.intp]:
    """Return the indices of points, (n, d), that no earlier kept point has within its radius, of (n,).

    Non-maximum suppression (Neubeck, Van Gool 2006) of points in the order of their worth. The norm is 2 or inf.
    """
    return kernels.suppress(np.ascontiguousarray(points, dtype=float), radius, norm)


@njit(cache=True)
def match(worth: Array) -> NDArray[np.intp]:
    """Return for each row of `worth`, (n, m), its column in the one-to-one pairs of greatest total worth, or -1.

    An unpaired row is worth 0. If the best columns of all rows differ, they are the solution.
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
    """Return the result of `match` by shortest augmenting paths (Kuhn 1955, Munkres 1957).

    Candidates are the columns `wanted`, and one spare column for each row. Rows and columns count from 1; column 0
    holds the row that is being assigned.
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
