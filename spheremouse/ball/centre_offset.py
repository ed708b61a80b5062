"""Does the ball turn about its centre? The points of a frame and the discs known in, how far the centre is off out.

A ball that is lifted off its bearings, or out of round, shows its discs where no rotation takes them; a shift of its
centre on top may explain them. Least squares on rotation and shift together, from the directions of one frame's discs.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from spheremouse.ball.points import SpherePoints
from spheremouse.geometry.rotation import Array

_FARTHEST = 0.1  # radii, standard deviation of a shift before anything is seen: it keeps the equations solvable
_PRINT = 5e-4  # rad, standard deviation of a disc's place on the map and in the picture that no view removes
_EXPLAINED = 0.1  # of the chi-square is left with the shift, at most, where a shift is what is wrong
_ROUND = 3.0  # times as far the centre of a ball known to be out of round must be before it counts as lifted
_MOST = 10.0  # chi-square per degree of freedom that a frame counts for in the mean: one wrong pair is not a bad ball
OUT_OF_ROUND = 5.0  # mean chi-square per degree of freedom; at 1 the discs fit a rotation
_MIN_MAHALANOBIS = 6.0  # standard deviations that an offset must be
_MEAN_TIME_S = 1.0  # time constant of that mean; hands and struts spoil a disc for less


@dataclass(frozen=True, slots=True)
class CentreOffset:
    """Fit of a rotation and a shift to the discs of one frame."""

    pairs: int
    shift: Array  # (3,) m, obj, of the ball's centre from where it is thought to be
    sigma: float  # m, its standard deviation in the direction in which it is known least
    mahalanobis: float  # standard deviations
    before: float  # chi-square of the directions with a rotation alone, per degree of freedom
    after: float  # the same with the shift

    @property
    def distance(self) -> float:
        """m."""
        return float(np.sqrt(self.shift @ self.shift))


def shift_of(
    points: SpherePoints, delay: Array, discs: Array, variance: Array, attitude: Array, rate: Array, radius: float,
    reach: float,
) -> CentreOffset | None:  # fmt: skip
    """The shift of the centre that makes known discs appear at `points`; None where fewer than four are seen,
    or all in one place.

    `discs` (m, 3) unit vectors in ball with variances (m,) rad² per axis; `delay` (n,) s of the points, `attitude`
    R_obj_ball (3, 3), `rate` (3,) rad/s; a point and a disc that are nearest to each other within `reach` rad are one.
    With three discs any shift fits.
    """
    if len(points) < 4 or len(discs) < 4:
        return None
    shift = np.empty(3)
    try:
        pairs, sigma, mahalanobis, before, after = _shift(
            points.direction,
            points.image_covariance,
            points.dposition_dball,
            delay,
            discs,
            variance,
            attitude,
            rate,
            radius,
            np.cos(reach),
            shift,
        )
    except np.linalg.LinAlgError:  # discs found in one place alone: no direction of a shift can be told from a turn
        return None
    return (
        CentreOffset(pairs, shift, sigma, mahalanobis, before, after)
        if pairs >= 4 and np.isfinite(mahalanobis)
        else None
    )


def is_off(found: CentreOffset, radius: float, lifted: float, out_of_round: bool = False) -> bool:
    """Is the centre off its place, and is that all that is wrong? A ball out of round has a centre that goes round."""
    least = (_ROUND if out_of_round else 1.0) * lifted * radius
    far = found.distance > least and found.mahalanobis > _MIN_MAHALANOBIS
    return far and found.after < _EXPLAINED * found.before


def fits(found: CentreOffset, radius: float, lifted: float) -> bool:
    """Return whether the discs fit a rotation about the centre."""
    far = found.distance > 0.5 * lifted * radius and found.mahalanobis > 0.5 * _MIN_MAHALANOBIS
    return not far and found.before < _MOST


def averaged(mean: float, found: CentreOffset, dt: float) -> float:
    """The mean chi-square per degree of freedom, `dt` s later."""
    keep = np.exp(-max(dt, 0.0) / _MEAN_TIME_S)
    return float(keep * mean + (1.0 - keep) * min(found.before, _MOST))


@njit(cache=True, error_model="numpy")
def _paired(seen, expected, least):
    """For each of `seen` (n, 3) the one of `expected` (m, 3) that is nearest and whose nearest it is; -1: none."""
    n, m = len(seen), len(expected)
    pair = np.full(n, -1)
    for i in range(n):
        best, cosine = -1, least
        for j in range(m):
            c = seen[i, 0] * expected[j, 0] + seen[i, 1] * expected[j, 1] + seen[i, 2] * expected[j, 2]
            if c > cosine:
                best, cosine = j, c
        if best < 0:
            continue
        mutual = True
        for k in range(n):
            c = seen[k, 0] * expected[best, 0] + seen[k, 1] * expected[best, 1] + seen[k, 2] * expected[best, 2]
            mutual = mutual and (k == i or c <= cosine)
        if mutual:
            pair[i] = best
    return pair


@njit(cache=True, error_model="numpy")
def _shift(seen, noise, by_ball, delay, discs, variance, attitude, rate, radius, least, shift):
    """Pairs, sigma, certainty and chi-squares per degree of freedom; the shift, m, into `shift`. See `shift_of`."""
    expected = np.empty_like(discs)
    for j in range(len(discs)):
        for a in range(3):
            expected[j, a] = attitude[a, 0] * discs[j, 0] + attitude[a, 1] * discs[j, 1] + attitude[a, 2] * discs[j, 2]
    pair = _paired(seen, expected, least)
    N, right, total, pairs = np.zeros((6, 6)), np.zeros(6), 0.0, 0
    A, C, z = np.zeros((3, 6)), np.empty((3, 3)), np.empty(3)
    for i in range(len(seen)):
        if pair[i] < 0:
            continue
        pairs += 1
        p = expected[pair[i]]
        for a in range(3):  # carried on to when its row was exposed
            b, c = (a + 1) % 3, (a + 2) % 3
            z[a] = seen[i, a] - p[a] - delay[i] * (rate[b] * p[c] - rate[c] * p[b])
            A[a, b], A[a, c] = p[c], -p[b]
            for k in range(3):
                A[a, 3 + k] = (1.0 if a == k else 0.0) - by_ball[i, a, k]
                C[a, k] = noise[i, a, k] / radius**2
            C[a, a] += variance[pair[i]] + _PRINT**2
        W = np.linalg.inv(C)
        for a in range(3):
            for b in range(3):
                total += z[a] * W[a, b] * z[b]
                for k in range(6):
                    right[k] += A[a, k] * W[a, b] * z[b]
                    for j in range(6):
                        N[k, j] += A[a, k] * W[a, b] * A[b, j]
    if pairs < 4:
        return pairs, 0.0, 0.0, 0.0, 0.0
    for a in range(3):
        N[a, a] += 1e-9
        N[3 + a, 3 + a] += 1.0 / _FARTHEST**2
    turn = np.linalg.solve(N[:3, :3].copy(), right[:3].copy())
    Q = np.linalg.inv(N)
    x = np.zeros(6)
    for k in range(6):
        for j in range(6):
            x[k] += Q[k, j] * right[j]
    explained_before, explained_after = 0.0, 0.0
    for a in range(3):
        explained_before += right[a] * turn[a]
        shift[a] = radius * x[3 + a]
    for k in range(6):
        explained_after += right[k] * x[k]
    worth = np.linalg.solve(Q[3:, 3:].copy(), x[3:].copy())
    mahalanobis = np.sqrt(max(worth[0] * x[3] + worth[1] * x[4] + worth[2] * x[5], 0.0))
    before = max(total - explained_before, 0.0) / (2 * pairs - 3)
    sigma = radius * np.sqrt(np.linalg.eigvalsh(Q[3:, 3:].copy())[2])
    return pairs, sigma, mahalanobis, before, max(total - explained_after, 0.0) / (2 * pairs - 6)
