"""Association of points with known discs: one to one near a prediction, and identification without one.

`assign` is the global nearest neighbour within a gate. `identify` finds the attitude from nothing but the map, with the
probability that it is wrong (`constellation`); `common_rotation` that between two sights, before there is a map.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spheremouse.ball.constellation.identify import attitude, shared_rotation
from spheremouse.geometry.matching import assign
from spheremouse.geometry.rotation import Array, align


@dataclass(frozen=True, slots=True)
class Identification:
    """Attitude identified from a constellation of discs."""

    rotation: Array  # (3, 3), directions ~ map_directions @ rotation.T
    pairs: NDArray[np.intp]  # (k, 2) of (index into directions, index into the map)
    false_alarm: float  # probability that it is wrong: another attitude of the map, or chance


def identify(
    directions: ArrayLike,
    map_directions: ArrayLike,
    *,
    sigma: float,
    view_axis: ArrayLike,
    horizon: float = 0.0,
    risk: float = 0.1,
    min_sigma: float | None = None,
) -> Identification | None:
    """Find the rotation between directions seen, (n, 3) unit vectors, and a map, (m, 3) unit vectors in `ball`.

    `sigma` rad is the standard deviation of a direction per axis, correct within a factor of 1.5. If it is less
    certain, give the greatest possible one, and the least one as `min_sigma`. `view_axis` (3,) is the unit vector from
    the ball to the camera in the frame of `directions`. Map directions with a cosine to it below `horizon` are rarely
    visible. A row of nan is a miss.

    Returns None if fewer than three directions match the map, or if the result is wrong with a probability above
    `risk`. The causes are too few or too coarse directions, a layout similar to itself in another attitude, or another
    ball. With coarse directions, a larger `risk` gives more results and more wrong ones. At a tenth of a degree it
    hardly matters. Raises ValueError for directions that are not unit vectors, and for an invalid sigma, horizon or
    risk.
    """
    if not 0.0 < sigma < np.inf:
        raise ValueError(f"sigma {sigma} is no standard deviation: give rad, above 0")
    if min_sigma is not None and not 0.0 < min_sigma <= sigma:
        raise ValueError(f"min_sigma {min_sigma} is no standard deviation up to {sigma}: give rad, above 0")
    if not -1.0 < horizon < 1.0:
        raise ValueError(f"horizon {horizon} is no cosine of a limb: give a number between -1 and 1")
    if not 0.0 < risk < 1.0:
        raise ValueError(f"risk {risk} is no probability: give a number between 0 and 1")
    seen, rows = _units(directions, "directions")
    known, columns = _units(map_directions, "map_directions")
    towards, _ = _units(np.atleast_2d(np.asarray(view_axis, dtype=float)), "view_axis")
    if len(towards) != 1:
        raise ValueError("view_axis must be one unit vector, (3,)")
    if len(seen) < 3 or len(known) < 3:
        return None
    found = attitude(seen, known, float(sigma), towards[0], float(horizon), min_sigma=min_sigma)
    if found is None or not found.error_probability <= risk:
        return None
    pairs = np.stack([rows[found.pairs[:, 0]], columns[found.pairs[:, 1]]], axis=1)
    return Identification(found.rotation, pairs, found.error_probability)


def _units(directions: ArrayLike, name: str) -> tuple[Array, NDArray[np.intp]]:
    """Return the finite rows of unit vectors, (k, 3), and their indices, (k,). Raises ValueError for other vectors."""
    v = np.asarray(directions, dtype=float)
    if v.size == 0:
        v = v.reshape(0, 3)
    if v.ndim != 2 or v.shape[1] != 3:
        raise ValueError(f"{name} must be unit vectors in rows, (n, 3), has shape {v.shape}")
    rows = np.flatnonzero(np.isfinite(v).all(axis=1))
    v = v[rows]
    length = np.sqrt(np.sum(v * v, axis=1, keepdims=True))
    if not np.all(np.abs(length - 1.0) < 1e-2):
        raise ValueError(f"{name} must be of unit length")
    return v / length, rows


def common_rotation(before: Array, after: Array, sigma: float) -> tuple[Array, NDArray[np.intp]] | None:
    """Return the rotation, (3, 3), with most pairs of two sets of directions, and the pairs, (k, 2) indices.

    A pair holds indices into `before` (n, 3) and `after` (m, 3), which contain the same discs among other points. Use
    this function for the first motion, without a map. At least three pairs must agree. Among rotations with equally
    many pairs, the smallest wins. Returns None if no rotation has three pairs.
    """
    if len(before) < 3 or len(after) < 3:
        return None
    rotation, number = shared_rotation(np.ascontiguousarray(before), np.ascontiguousarray(after), sigma)
    if number < 3:
        return None
    distance = np.arccos(np.clip(after @ rotation @ before.T, -1.0, 1.0))
    rows, columns = assign(distance, 5.25 * sigma)
    if len(rows) < 3:
        return None
    return align(before[columns], after[rows]), np.stack([columns, rows], axis=1)
