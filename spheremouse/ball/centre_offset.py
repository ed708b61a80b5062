"""Estimate the offset of the ball's centre from the points of one frame and the known discs.

If the ball is lifted off its bearings, or out of round, no rotation explains the places of its discs. A shift of its
centre may explain them. Least squares estimate rotation and shift together.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from spheremouse.ball.points import SpherePoints
from spheremouse.geometry.matching import mutual_nearest
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
    chi2_rotation: float  # chi-square of the directions with a rotation alone, per degree of freedom
    chi2_with_offset: float  # the same with the shift

    @property
    def distance(self) -> float:
        """Length of `shift`, m."""
        return float(np.sqrt(self.shift @ self.shift))


class KnownDiscs(NamedTuple):
    """Discs of the map, and the ball's motion."""

    directions: Array  # (m, 3) unit vectors, ball
    variance: Array  # (m,) rad² per axis
    attitude: Array  # (3, 3) R_obj_ball
    rate: Array  # (3,) rad/s, w_obj


def shift_of(points: SpherePoints, delay: Array, discs: KnownDiscs, radius: float, reach: float) -> CentreOffset | None:
    """Return the shift of the centre that makes known discs appear at `points`.

    `delay` (n,) s is that of the points. A point and a disc belong together if each is the other's nearest, within
    `reach` rad. Returns None if fewer than four discs are seen, since any shift fits three, or all in one place.
    """
    if len(points) < 4 or len(discs.directions) < 4:
        return None
    try:
        fields = _shift(points.direction, points.image_covariance, points.dposition_dball, delay, discs, radius, reach)
    except np.linalg.LinAlgError:  # discs found in one place alone: no direction of a shift can be told from a turn
        return None
    offset = CentreOffset(*fields)
    return offset if np.isfinite(offset.mahalanobis) else None


def is_off(found: CentreOffset, radius: float, lifted: float, out_of_round: bool = False) -> bool:
    """Return True if the centre is off its place and the shift explains the residuals.

    `lifted` is the least offset in radii. A ball out of round has a centre that goes round, so it needs three times
    that.
    """
    least = (_ROUND if out_of_round else 1.0) * lifted * radius
    far = found.distance > least and found.mahalanobis > _MIN_MAHALANOBIS
    return far and found.chi2_with_offset < _EXPLAINED * found.chi2_rotation


def fits(found: CentreOffset, radius: float, lifted: float) -> bool:
    """Return True if the discs fit a rotation about the centre of a ball of `radius` m; `lifted` as in `is_off`."""
    far = found.distance > 0.5 * lifted * radius and found.mahalanobis > 0.5 * _MIN_MAHALANOBIS
    return not far and found.chi2_rotation < _MOST


def averaged(mean: float, found: CentreOffset, dt: float) -> float:
    """Return the running mean of the chi-square per degree of freedom after a frame that is `dt` s later."""
    keep = np.exp(-max(dt, 0.0) / _MEAN_TIME_S)
    return float(keep * mean + (1.0 - keep) * min(found.chi2_rotation, _MOST))


@njit(cache=True, error_model="numpy")
def _shift(seen, noise, by_ball, delay, discs, radius, reach) -> tuple[Any, ...]:
    """Return the fields of CentreOffset; nan with fewer than four pairs.

    `seen` (n, 3) are the points' directions, `noise` (n, 3, 3) m² their covariances. `by_ball` (n, 3, 4) are the
    Jacobians of the points by the ball's centre and radius. For the others see `shift_of`. Raises LinAlgError if
    the equations are singular, as with discs in one place.
    """
    expected = discs.directions @ discs.attitude.T
    cosine = seen @ expected.T
    pair = mutual_nearest(np.where(cosine > np.cos(reach), 1.0 - cosine, np.inf))
    if np.count_nonzero(pair >= 0) < 4:
        return 0, np.zeros(3), np.nan, np.nan, np.nan, np.nan
    rate = discs.rate
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
            C[a, a] += discs.variance[pair[i]] + _PRINT**2
        W = np.linalg.inv(C)
        for a in range(3):
            for b in range(3):
                total += z[a] * W[a, b] * z[b]
                for k in range(6):
                    right[k] += A[a, k] * W[a, b] * z[b]
                    for j in range(6):
                        N[k, j] += A[a, k] * W[a, b] * A[b, j]
    for a in range(3):
        N[a, a] += 1e-9
        N[3 + a, 3 + a] += 1.0 / _FARTHEST**2
    turn = np.linalg.solve(N[:3, :3].copy(), right[:3].copy())
    Q = np.linalg.inv(N)
    x = Q @ right
    shift = x[3:].copy()
    mahalanobis = np.sqrt(max(shift @ np.linalg.solve(Q[3:, 3:].copy(), shift), 0.0))
    sigma = radius * np.sqrt(np.linalg.eigvalsh(Q[3:, 3:].copy())[2])
    chi2_rotation = max(total - right[:3] @ turn, 0.0) / (2 * pairs - 3)
    chi2_with_offset = max(total - right @ x, 0.0) / (2 * pairs - 6)
    return pairs, radius * shift, sigma, mahalanobis, chi2_rotation, chi2_with_offset
