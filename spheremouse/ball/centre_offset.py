"""Estimate the offset of the ball's centre from the points of one frame and the known discs.

If the ball moves in its bearings, is lifted off them, or is out of round, no rotation explains the places of its discs.
A shift of its centre may explain them. Least squares estimate rotation and shift together.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from spheremouse.ball.points import SpherePoints
from spheremouse.geometry.rotation import Array
from spheremouse.native import kernels

MISFIT = 10.0  # chi-square per degree of freedom of discs that fit a rotation; at 1 they are as exact as they say
_MAX_INSIGNIFICANT_SIGMAS = 3.0  # standard deviations of an offset that is none


@dataclass(frozen=True, slots=True)
class CentreOffset:
    """Fit of a rotation and a shift to the discs of one frame."""

    pairs: int
    shift: Array  # (3,) m, obj, of the ball's centre from its assumed place
    covariance: Array  # (3, 3) m², with a prior of 0.1 radii
    mahalanobis: float  # of `shift` from zero, with `covariance`
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

    `delay` (n,) s, from stamp to exposure with the estimated readout, replaces that of `points`. A point and a disc
    pair if each is the other's nearest, within `reach` rad. Returns None with fewer than four pairs, since any shift
    fits three, or with all in one place.
    """
    found = kernels.shift_of(points.measurement(radius), delay, discs, reach)
    return None if found is None else CentreOffset(*found)


def fits(found: CentreOffset, radius: float, lifted: float) -> bool:
    """Return False if a significant shift exceeds half of `lifted` radii (`radius`, m), or a rotation fits badly."""
    far = found.distance > 0.5 * lifted * radius and found.mahalanobis > _MAX_INSIGNIFICANT_SIGMAS
    return not far and found.chi2_rotation < MISFIT
