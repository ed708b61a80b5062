"""Spheres through points: an algebraic fit, and tests of points and of the shape by the points' covariances."""

import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array
from spheremouse.geometry.statistics import gate, mad_sigma

MIN_POINTS = 5  # four define a sphere, the fifth checks it (Wittich 2017, section 3.7)
_MAX_CHI2 = 25.0  # five standard deviations, because they are uncertain themselves
_ROUNDNESS_LEVEL = 0.99  # of the test that rejects a round ball
_ITERATIONS = 20


def algebraic_sphere(points: Array) -> tuple[Array, float]:
    """Return centre (3,) and radius of the algebraic best fit to points (n, 3); nan if they define no sphere."""
    A = np.concatenate([2.0 * points, np.ones((len(points), 1))], axis=1)
    solution, _, rank, _ = np.linalg.lstsq(A, np.sum(points**2, axis=1), rcond=1e-10)
    square = solution[3] + solution[:3] @ solution[:3]
    if rank < 4 or not square > 0.0:
        return np.full(3, np.nan), np.nan
    return solution[:3], float(np.sqrt(square))


def off_sphere(points: Array, covariance: Array, centre: Array, radius: float) -> NDArray[np.bool_]:
    """Return a mask (n,) of points, (n, 3) with covariances (n, 3, 3), that are significantly off the sphere.

    On a ball that is out of round all points are off. So a point must be further off than most.
    """
    offset = points - centre
    distance = np.linalg.norm(offset, axis=1)
    normal = offset / distance[:, None]
    residual = distance - radius
    variance = np.einsum("ni,nij,nj->n", normal, covariance, normal)
    spread = float(mad_sigma(residual))
    extra = max(spread**2 - float(np.median(variance)), 0.0)
    return residual**2 > _MAX_CHI2 * (variance + extra)


def out_of_round(points: Array, covariance: Array, centre: Array, radius: float) -> float:
    """Return the standard deviation, m, of a shape about its sphere beside the covariance of its points; usually 0.

    `points` (n, 3) m have the joint `covariance` (3n, 3n). Centre and radius are those of a fit. The variance along the
    normals is that for which the weighted sum of squares has its expected size (Paule, Mandel 1982).
    """
    n, offset = len(points), points - centre
    distance = np.linalg.norm(offset, axis=1)
    normal = offset / distance[:, None]
    A, w = np.column_stack([normal, np.ones(n)]), distance - radius
    W = np.einsum("ni,nimj,mj->nm", normal, covariance.reshape(n, 3, n, 3), normal)
    extra, freedom = 0.0, n - 4
    for _ in range(_ITERATIONS):
        P = np.linalg.inv(W + extra * np.eye(n))
        M = P - P @ A @ np.linalg.solve(A.T @ P @ A, A.T @ P)
        squares = float(w @ M @ w)
        if extra == 0.0 and squares <= gate(_ROUNDNESS_LEVEL, freedom):
            break
        extra = max(extra + (squares - freedom) / float(np.trace(M)), 0.0)
    return float(np.sqrt(extra))
