"""Estimate the offset of the ball's centre from the points of one frame and the known discs.

If the ball is lifted off its bearings, or out of round, no rotation explains the places of its discs. A shift of its
centre may explain them. Least squares estimate rotation and shift together.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from spheremouse.ball.points import SpherePoints
from spheremouse.geometry.matching import mutual_nearest
from spheremouse.geometry.rotation import Array, hat

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
    expected = discs.directions @ discs.attitude.T
    cosine = points.direction @ expected.T
    pair = mutual_nearest(np.where(cosine > np.cos(reach), 1.0 - cosine, np.inf))
    rows = np.flatnonzero(pair >= 0)
    k, columns = len(rows), pair[rows]
    if k < 4:
        return None
    p = expected[columns]
    later = p + delay[rows, None] * (hat(discs.rate) @ p[:, :, None])[:, :, 0]  # when its row was exposed
    z = (points.direction[rows] - later)[:, :, None]
    A = np.concatenate([-hat(p), np.eye(3) - points.dposition_dball[rows, :, :3]], axis=2)
    C = points.image_covariance[rows] / radius**2 + (discs.variance[columns] + _PRINT**2)[:, None, None] * np.eye(3)
    W = np.linalg.inv(C)
    weighted = A.transpose(0, 2, 1) @ W
    N = (weighted @ A).sum(axis=0) + np.diag([1e-9] * 3 + [_FARTHEST**-2] * 3)
    right, total = (weighted @ z).sum(axis=0)[:, 0], float((z.transpose(0, 2, 1) @ W @ z).sum())
    try:
        turn = np.linalg.solve(N[:3, :3], right[:3])
        Q = np.linalg.inv(N)
        x = Q @ right
        square = x[3:] @ np.linalg.solve(Q[3:, 3:], x[3:])
    except np.linalg.LinAlgError:  # discs found in one place alone: no direction of a shift can be told from a turn
        return None
    sigma = radius * np.sqrt(np.linalg.eigvalsh(Q[3:, 3:])[2])
    chi2 = max(total - right[:3] @ turn, 0.0) / (2 * k - 3), max(total - right @ x, 0.0) / (2 * k - 6)
    offset = CentreOffset(k, radius * x[3:], float(sigma), float(np.sqrt(max(square, 0.0))), *map(float, chi2))
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
