"""Estimate the offset of the ball's centre from the points of one frame and the known discs.

If the ball moves in its bearings, is lifted off them, or is out of round, no rotation explains the places of its discs.
A shift of its centre may explain them. Least squares estimate rotation and shift together.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from spheremouse.ball.points import SpherePoints
from spheremouse.geometry.matching import mutual_nearest
from spheremouse.geometry.rotation import Array, hat

# radii, standard deviation of a shift before anything is seen: it keeps the equations solvable
_PRIOR_SIGMA_RADII = 0.1
_PLACE_SIGMA_RAD = 5e-4  # rad, standard deviation of a disc's place on the map and in the picture that no view removes
MISFIT = 10.0  # chi-square per degree of freedom of discs that fit a rotation; at 1 they are as exact as they say
_MAX_INSIGNIFICANT_SIGMAS = 3.0  # standard deviations of an offset that is none


@dataclass(frozen=True, slots=True)
class CentreOffset:
    """Fit of a rotation and a shift to the discs of one frame."""

    pairs: int
    shift: Array  # (3,) m, obj, of the ball's centre from where it is thought to be
    covariance: Array  # (3, 3) m²
    mahalanobis: float  # standard deviations
    chi2_rotation: float  # chi-square of the directions with a rotation alone, per degree of freedom
    chi2_with_offset: float  # the same with the shift

    @property
    def sigma(self) -> float:
        """Standard deviation of `shift` in the direction in which it is known least, m."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance)[2]))

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
    A = np.concatenate([-hat(p), -radius * points.ddirection_drig[rows, :, 1:]], axis=2)
    C = points.image_covariance[rows] / radius**2 + (discs.variance[columns] + _PLACE_SIGMA_RAD**2)[
        :, None, None
    ] * np.eye(3)
    W = np.linalg.inv(C)
    weighted = A.transpose(0, 2, 1) @ W
    N = (weighted @ A).sum(axis=0) + np.diag([1e-9] * 3 + [_PRIOR_SIGMA_RADII**-2] * 3)
    right, total = (weighted @ z).sum(axis=0)[:, 0], float((z.transpose(0, 2, 1) @ W @ z).sum())
    try:
        turn = np.linalg.solve(N[:3, :3], right[:3])
        Q = np.linalg.inv(N)
        x = Q @ right
        square = x[3:] @ np.linalg.solve(Q[3:, 3:], x[3:])
    except np.linalg.LinAlgError:  # discs found in one place alone: no direction of a shift can be told from a turn
        return None
    chi2 = max(total - right[:3] @ turn, 0.0) / (2 * k - 3), max(total - right @ x, 0.0) / (2 * k - 6)
    offset = CentreOffset(k, radius * x[3:], radius**2 * Q[3:, 3:], float(np.sqrt(max(square, 0.0))), *map(float, chi2))
    return offset if np.isfinite(offset.mahalanobis) else None


def fits(found: CentreOffset, radius: float, lifted: float) -> bool:
    """Return True if the discs fit a rotation of a ball of `radius` m about its centre; `lifted` in radii."""
    far = found.distance > 0.5 * lifted * radius and found.mahalanobis > _MAX_INSIGNIFICANT_SIGMAS
    return not far and found.chi2_rotation < MISFIT
