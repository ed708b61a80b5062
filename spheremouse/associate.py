"""Which seen disc is which known disc: one-to-one assignment in sight of a prediction, and identification without one.

`assign` is the global nearest neighbour within a gate. `identify` finds the attitude from nothing but the map: a star
tracker on a ball (pairs of angles as in Mortari et al. 2004's pyramid, verified by all that is and is not seen).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.stats import binom

from spheremouse.rotation import Array, align


def assign(cost: Array, gate: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pairs (rows, columns) of a cost matrix, (n, m), one-to-one, all below `gate`.

    Minimises the sum of costs where leaving a row alone costs `gate`: as many pairs as are worth it.
    """
    if cost.size == 0 or not np.any(cost < gate):
        return np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp)
    rows, columns = linear_sum_assignment(np.fmin(cost, gate))  # nan: no pair
    keep = cost[rows, columns] < gate
    return rows[keep], columns[keep]


@dataclass(frozen=True, slots=True)
class Identification:
    """The attitude a constellation tells."""

    rotation: Array  # (3, 3), directions ~ map_directions @ rotation.T
    pairs: NDArray[np.intp]  # (k, 2) of (index into directions, index into the map)
    false_alarm: float  # probability that chance alone makes as many pairs


def identify(
    directions: Array, map_directions: Array, *, sigma: float, view_axis: Array, horizon: float = 0.0
) -> Identification | None:
    """Find the rotation between directions seen, (n, 3) unit vectors, and a map, (m, 3) unit vectors in `ball`.

    `sigma` rad is the standard deviation of a direction per axis, `view_axis` (3,) points from the ball to the camera
    in the frame of `directions`; map directions whose cosine with it is below `horizon` cannot be seen. Every pair of
    seen directions votes for the map pairs with its angle; each vote's rotation is scored by how many seen directions
    meet a visible map direction, and by how many that should be seen are not. Returns None where fewer than three
    agree, where chance explains it (false alarm above 1e-3), or where another attitude does almost as well.
    """
    n, m = len(directions), len(map_directions)
    if n < 3 or m < 3:
        return None
    tolerance = 3.5 * sigma
    rotations = _hypotheses(directions, map_directions, tolerance * np.sqrt(2.0))
    if len(rotations) == 0:
        return None
    turned = np.einsum("hij,mj->hmi", rotations, map_directions)
    visible = turned @ view_axis > horizon
    close = np.einsum("ni,hmi->hnm", directions, turned) > np.cos(1.5 * tolerance)
    close &= visible[:, None, :]
    met = close.any(axis=2).sum(axis=1)
    # a direction that should be seen and is not: hidden by a strut or a hand, so weak evidence
    unseen = visible.sum(axis=1) - close.any(axis=1).sum(axis=1)
    score = met - 0.25 * unseen
    best = int(np.argmax(score))
    rotation, pairs = _refine(rotations[best], directions, map_directions, tolerance, view_axis, horizon)
    k = len(pairs)
    if k < 3:
        return None
    apart = np.einsum("hij,ij->h", rotations, rotation) < 1.0 + 2.0 * np.cos(10.0 * tolerance)
    if np.any(apart & (score > score[best] - 0.75)):
        return None
    chance = min(1.0, float(visible[best].sum()) * (1.0 - np.cos(1.5 * tolerance)))  # of one direction meeting any
    false_alarm = min(1.0, len(rotations) * float(binom.sf(k - 3, n - 2, chance)))
    if false_alarm > 1e-3:
        return None
    return Identification(rotation, pairs, false_alarm)


def _hypotheses(seen: Array, known: Array, tolerance: float) -> Array:
    """Rotations, (h, 3, 3), that carry a pair of known directions onto a pair of seen ones of equal angle."""
    i, j = np.triu_indices(len(seen), 1)
    a, b = np.nonzero(~np.eye(len(known), dtype=bool))
    angle_seen = np.arccos(np.clip(np.sum(seen[i] * seen[j], axis=1), -1.0, 1.0))
    angle_known = np.arccos(np.clip(np.sum(known[a] * known[b], axis=1), -1.0, 1.0))
    wide = np.argsort(-np.minimum(angle_seen, np.pi - angle_seen))[:15]  # wide pairs fix a rotation best
    p, q = np.nonzero(np.abs(angle_seen[wide, None] - angle_known[None]) < tolerance)
    p = wide[p]
    if len(p) == 0:
        return np.zeros((0, 3, 3))
    return _triad(seen[i[p]], seen[j[p]]) @ _triad(known[a[q]], known[b[q]]).transpose(0, 2, 1)


def _triad(u: Array, v: Array) -> Array:
    """Orthonormal frames, (h, 3, 3), from pairs of directions: middle, across, and their normal (columns)."""
    middle, across = u + v, u - v
    middle = middle / np.maximum(np.linalg.norm(middle, axis=1, keepdims=True), 1e-12)
    across = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    return np.stack([middle, across, np.cross(middle, across)], axis=2)


def _refine(  # noqa: PLR0917
    rotation: Array, seen: Array, known: Array, tolerance: float, view_axis: Array, horizon: float
) -> tuple[Array, NDArray[np.intp]]:
    pairs = np.zeros((0, 2), dtype=np.intp)
    for _ in range(3):
        turned = known @ rotation.T
        angle = np.arccos(np.clip(seen @ turned.T, -1.0, 1.0))
        angle[:, turned @ view_axis <= horizon] = np.pi
        rows, columns = assign(angle, 1.5 * tolerance)
        pairs = np.stack([rows, columns], axis=1)
        if len(pairs) < 3:
            break
        rotation = align(known[columns], seen[rows])
    return rotation, pairs


def common_rotation(before: Array, after: Array, sigma: float) -> tuple[Array, NDArray[np.intp]] | None:
    """Rotation, (3, 3), that most of two sets of directions share, and its pairs, (k, 2) indices (before, after).

    For the first motion seen, when nothing is known yet: `before` (n, 3) and `after` (m, 3) hold the same discs among
    others. At least three must agree; of equal agreements the smallest rotation is taken. None where there is none.
    """
    if len(before) < 3 or len(after) < 3:
        return None
    tolerance = 3.5 * sigma
    rotations = _hypotheses(after, before, tolerance * np.sqrt(2.0))
    if len(rotations) == 0:
        return None
    near = np.einsum("ni,hij,mj->hnm", after, rotations, before) > np.cos(1.5 * tolerance)
    agree = np.minimum(near.any(axis=1).sum(axis=1), near.any(axis=2).sum(axis=1))
    angle = np.arccos(np.clip((np.einsum("hii->h", rotations) - 1.0) / 2.0, -1.0, 1.0))
    best = int(np.lexsort((angle, -agree))[0])
    distance = np.arccos(np.clip(after @ rotations[best] @ before.T, -1.0, 1.0))
    rows, columns = assign(distance, 1.5 * tolerance)
    if len(rows) < 3:
        return None
    return align(before[columns], after[rows]), np.stack([columns, rows], axis=1)
