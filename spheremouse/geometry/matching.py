"""Matching of points and numbers: distances, assignment, nearest neighbours, suppression, membership."""

import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array
from spheremouse.native import kernels


def distances(a: Array, b: Array) -> Array:
    """Return the distances, (n, m), of points in a plane, (n, 2) and (m, 2)."""
    return np.hypot(a[:, :1] - b[:, 0], a[:, 1:] - b[:, 1])


def assign(cost: Array, gate: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return one-to-one pairs (rows, columns) of a cost matrix, (n, m), all below `gate`.

    They minimise the sum of costs, where an unpaired row costs `gate`.
    """
    column = kernels.match(np.subtract(gate, cost, order="C", dtype=float))
    rows = np.flatnonzero(column >= 0)
    return rows, column[rows]


def mutual_nearest(distance: Array) -> NDArray[np.intp]:
    """Return for each row of a distance matrix, (n, m), the column if each is the other's nearest, else -1.

    The distance `inf` is no pair.
    """
    return kernels.mutual_nearest(np.ascontiguousarray(distance, dtype=float))


def suppress(points: Array, radius: Array, norm: float = 2.0) -> NDArray[np.intp]:
    """Return the indices of points, (n, d), that no earlier kept point has within its radius, of (n,).

    Non-maximum suppression (Neubeck, Van Gool 2006) of points in the order of their worth. The norm is 2 or inf.
    """
    return kernels.suppress(np.ascontiguousarray(points, dtype=float), radius, norm)


def are_among(numbers: NDArray[np.intp], others: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return which of a few numbers, (n,), are among a few others, (m,). NumPy's `isin` takes five times as long."""
    return (numbers[:, None] == others).any(axis=1)
