"""Fit a sphere to points with the covariance of an earlier adjustment, in the Gauss-Helmert model.

Wittich 2017, section 3.7, eq. 102-109, with the errata of docs/theses.md: the contradictions are w = f(l_j, x) +
B (l - l_j), and the last row of B contains the adjusted points too. All unknowns of the earlier adjustment are
observations here, so the sphere also improves targets and cameras.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import brentq

from spheremouse.errors import CalibrationError
from spheremouse.geometry.rotation import Array
from spheremouse.geometry.statistics import gate, mad_sigma

MIN_POINTS = 5  # four define a sphere, the fifth checks it (Wittich 2017, section 3.7)
_STEP_TOLERANCE = 1e-9  # m
_UNDETERMINED = "the discs do not fix a sphere: photograph more of the ball"
_MAX_ITERATIONS = 100  # a determined sphere takes five
_MAX_CHI2 = 25.0  # five standard deviations, because they are uncertain themselves
_ROUNDNESS_LEVEL = 0.99  # of the test that rejects a round ball


@dataclass(frozen=True, slots=True)
class Sphere:
    """An adjusted sphere, and the adjusted observations."""

    centre: Array  # (3,) m
    radius: float  # m
    covariance: Array  # (4, 4) m², centre and radius
    observations: Array  # (k,) adjusted
    observation_covariance: Array  # (k, k)
    cross_covariance: Array  # (k, 4) of adjusted observations with centre and radius
    distance: Array  # (n,) m, of the observed points from the sphere, positive outside
    out_of_round: float  # m, standard deviation of the shape beside the points' covariances; usually 0


def algebraic_sphere(points: Array) -> tuple[Array, float]:
    """Return centre (3,) and radius of the algebraic best fit to points (n, 3); nan if they define no sphere."""
    A = np.concatenate([2.0 * points, np.ones((len(points), 1))], axis=1)
    solution, _, rank, _ = np.linalg.lstsq(A, np.sum(points**2, axis=1), rcond=1e-10)
    square = solution[3] + solution[:3] @ solution[:3]
    if rank < 4 or not square > 0.0:
        return np.full(3, np.nan), np.nan
    return solution[:3], float(np.sqrt(square))


def fit_sphere(observations: Array, covariance: Array, where: NDArray[np.intp]) -> Sphere:
    """Adjust a sphere to n points that are among the observations (k,) with covariance (k, k).

    `where` (n, 3) has the indices of each point's coordinates. Raises CalibrationError for fewer than
    five points, or points that fix no sphere.
    """
    n = len(where)
    if n < MIN_POINTS:
        raise CalibrationError(
            f"{n} discs on the ball are known, a sphere takes at least {MIN_POINTS}: show more of them"
        )
    centre, radius = algebraic_sphere(observations[where])
    if not np.isfinite(radius):
        raise CalibrationError("the discs lie in a plane: photograph more of the ball")
    x = np.array([*centre, radius])
    C = covariance[np.ix_(where.ravel(), where.ravel())]
    first = _adjust(observations[where], C, x, 0.0)
    freedom = n - 4
    extra = 0.0
    if first.omega > gate(_ROUNDNESS_LEVEL, freedom):
        # The variance along the normals for which the contradictions have their expected size.
        def excess(log: float) -> float:
            return _adjust(observations[where], C, x, float(np.exp(log))).omega / freedom - 1.0

        low, high = np.log(1e-12 * radius**2), np.log(radius**2)
        extra = float(np.exp(np.asarray(brentq(excess, low, high, xtol=1e-3))))
    final = _adjust(observations[where], C, x, extra)
    A, B, W, Q = final.A, final.B, final.W, final.Q
    to_all = covariance[:, where.ravel()] @ B.T  # (k, n)
    N = cho_solve(W, A)
    k = -cho_solve(W, final.w + A @ final.step)
    cross = -to_all @ N @ Q
    H = cho_solve(W, np.eye(n)) - N @ Q @ N.T
    return Sphere(
        final.x[:3],
        float(final.x[3]),
        Q,
        observations + to_all @ k,
        covariance - to_all @ H @ to_all.T,
        cross,
        np.linalg.norm(observations[where] - final.x[:3], axis=1) - final.x[3],
        float(np.sqrt(extra)),
    )


def off_sphere(points: Array, covariance: Array, sphere: Sphere) -> NDArray[np.bool_]:
    """Return a mask (n,) of points, (n, 3) with covariances (n, 3, 3), that are significantly off the sphere.

    On a ball that is out of round all points are off. So a point must be further off than most.
    """
    offset = points - sphere.centre
    distance = np.linalg.norm(offset, axis=1)
    normal = offset / distance[:, None]
    residual = distance - sphere.radius
    variance = np.einsum("ni,nij,nj->n", normal, covariance, normal)
    spread = float(mad_sigma(residual))
    extra = max(spread**2 - float(np.median(variance)), 0.0)
    return residual**2 > _MAX_CHI2 * (variance + extra)


@dataclass(frozen=True, slots=True)
class _State:
    x: Array  # (4,) centre and radius, m
    step: Array  # (4,) of the last iteration
    w: Array  # (n,) contradictions
    A: Array  # (n, 4)
    B: Array  # (n, 3n)
    W: tuple[Array, bool]  # Cholesky factor of B C B'
    Q: Array  # (4, 4)
    omega: float  # w' W^-1 w


def _adjust(points: Array, C: Array, x: Array, extra: float) -> _State:
    """Iterate from the unknowns x, (4,) (Wittich 2017, eq. 41-50, corrected)."""
    n, adjusted = len(points), points
    columns = 3 * np.arange(n)[:, None] + np.arange(3)
    for _ in range(_MAX_ITERATIONS):
        offset = adjusted - x[:3]
        length = np.linalg.norm(offset, axis=1)
        normal = offset / length[:, None]
        A = np.concatenate([-normal, -np.ones((n, 1))], axis=1)
        B = np.zeros((n, 3 * n))
        B[np.arange(n)[:, None], columns] = normal
        w = length - x[3] + np.sum(normal * (points - adjusted), axis=1)
        try:
            W = cho_factor(B @ C @ B.T + extra * np.eye(n))
            Q = np.linalg.inv(A.T @ cho_solve(W, A))
        except np.linalg.LinAlgError:
            break
        step = -Q @ A.T @ cho_solve(W, w)
        if not np.max(np.abs(step)) < 100.0 * x[3]:
            break
        k = -cho_solve(W, w + A @ step)
        x, adjusted = x + step, points + (C @ (B.T @ k)).reshape(n, 3)
        if np.max(np.abs(step)) < _STEP_TOLERANCE * max(1.0, x[3]):
            return _State(x, step, w, A, B, W, Q, float((w + A @ step) @ -k))
    raise CalibrationError(_UNDETERMINED)
