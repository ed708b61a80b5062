"""Assignment of one to one."""

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.constellation import hypotheses as kernel
from spheremouse.geometry.rotation import Array


def assign(cost: Array, gate: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pairs (rows, columns) of a cost matrix, (n, m), one-to-one, all below `gate`.

    Minimises the sum of costs where leaving a row alone costs `gate`: as many pairs as are worth it.
    """
    if cost.size == 0:
        return np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp)
    worth = gate - cost
    column = kernel.match(np.where(worth > 0.0, worth, -1.0))  # nan: no pair
    rows = np.flatnonzero(column >= 0)
    return rows, column[rows]
