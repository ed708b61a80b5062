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
