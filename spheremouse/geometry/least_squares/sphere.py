"""A sphere through points that another adjustment has left with covariances: the Gauss-Helmert model.

Wittich 2017, section 3.7, eq. 102-109, with the errata of docs/theses: the contradictions are w = f(l_j, x) +
B (l - l_j), and B has the adjusted points on its last row too. All unknowns of that adjustment take part as
observations, so that what the sphere tells of the discs reaches targets and cameras as well.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import brentq

from spheremouse.errors import CalibrationError
from spheremouse.geometry.rotation import Array
from spheremouse.geometry.statistics import gate, mad_sigma

FEWEST = 5  # points: four fix a sphere, the fifth checks it (Wittich 2017, section 3.7)
_STILL = 1e-9  # m
_LOOSE = "the discs do not fix a sphere: photograph more of the ball"
_MOST = 100  # iterations; a sphere that is fixed takes five
_FALSE = 25.0  # five standard deviations, of which one is itself uncertain
_ROUND = 0.99  # a ball is taken for round unless the points contradict it on this level


@dataclass(frozen=True, slots=True)
class Sphere:
    """A sphere adjusted, and what it makes of the observations."""

    centre: Array  # (3,) m
    radius: float  # m
    covariance: Array  # (4, 4) m², centre and radius
    observations: Array  # (k,) adjusted
    observation_covariance: Array  # (k, k)
    cross_covariance: Array  # (k, 4) of adjusted observations with centre and radius
    distance: Array  # (n,) m, of the points as observed from the sphere, outside positive
    out_of_round: float  # m, standard deviation that the points ask for beyond their covariances; mostly 0
    chi2_per_freedom: float  # of the contradictions, before `out_of_round`


def through_four(points: Array) -> tuple[Array, float]:
    """Centre (3,) and radius of the sphere nearest to points (n, 3) in the algebraic sense; nan where none is."""
    A = np.concatenate([2.0 * points, np.ones((len(points), 1))], axis=1)
    solution, _, rank, _ = np.linalg.lstsq(A, np.sum(points**2, axis=1), rcond=1e-10)
    square = solution[3] + solution[:3] @ solution[:3]
    if rank < 4 or not square > 0.0:
        return np.full(3, np.nan), np.nan
    return solution[:3], float(np.sqrt(square))


def fit_sphere(observations: Array, covariance: Array, where: NDArray[np.intp]) -> Sphere:
    """Adjust a sphere to n points that are among the observations (k,) with covariance (k, k).

    `where` (n, 3) says which observations are the coordinates of each point. Raises CalibrationError for fewer than
    five points, or points that fix no sphere.
    """
    n = len(where)
    if n < FEWEST:
        raise CalibrationError(f"{n} discs on the ball are known, a sphere takes at least {FEWEST}: show more of them")
    centre, radius = through_four(observations[where])
    if not np.isfinite(radius):
        raise CalibrationError("the discs lie in a plane: photograph more of the ball")
    x = np.array([*centre, radius])
    C = covariance[np.ix_(where.ravel(), where.ravel())]
    first = _adjust(observations[where], C, x, 0.0)
    freedom = n - 4
    extra = 0.0
    if first.omega > gate(_ROUND, freedom):
        # as much variance along the normals as brings the contradictions to what chance would leave
        def excess(log: float) -> float:
            return _adjust(observations[where], C, x, float(np.exp(log))).omega / freedom - 1.0

        low, high = np.log(1e-12 * radius**2), np.log(radius**2)
        extra = float(np.exp(np.asarray(brentq(excess, low, high, xtol=1e-3))))
    done = _adjust(observations[where], C, x, extra)
    A, B, W, Q = done.A, done.B, done.W, done.Q
    to_all = covariance[:, where.ravel()] @ B.T  # (k, n)
    N = cho_solve(W, A)
    k = -cho_solve(W, done.w + A @ done.step)
    cross = -to_all @ N @ Q
    H = cho_solve(W, np.eye(n)) - N @ Q @ N.T
    return Sphere(
        done.x[:3],
        float(done.x[3]),
        Q,
        observations + to_all @ k,
        covariance - to_all @ H @ to_all.T,
        cross,
        np.linalg.norm(observations[where] - done.x[:3], axis=1) - done.x[3],
        float(np.sqrt(extra)),
        first.omega / freedom if freedom else 1.0,
    )


def off_sphere(points: Array, covariance: Array, sphere: Sphere) -> NDArray[np.bool_]:
    """Which of n points, (n, 3) with their blocks (n, 3, 3), are too far off the sphere for chance, (n,).

    A ball that is out of round puts all points off it: what counts is being further off than most.
    """
    way = points - sphere.centre
    distance = np.linalg.norm(way, axis=1)
    normal = way / distance[:, None]
    off = distance - sphere.radius
    variance = np.einsum("ni,nij,nj->n", normal, covariance, normal)
    spread = float(mad_sigma(off))
    extra = max(spread**2 - float(np.median(variance)), 0.0)
    return off**2 > _FALSE * (variance + extra)


@dataclass(frozen=True, slots=True)
class _State:
    x: Array
    step: Array  # (4,) of the last iteration
    adjusted: Array  # (n, 3)
    w: Array  # (n,) contradictions
    A: Array  # (n, 4)
    B: Array  # (n, 3n)
    W: tuple[Array, bool]  # Cholesky factor of B C B'
    Q: Array  # (4, 4)
    omega: float  # w' W^-1 w


def _adjust(points: Array, C: Array, x: Array, extra: float) -> _State:
    adjusted = points
    for _ in range(_MOST):
        state = _iterated(points, adjusted, C, x, extra)
        x = state.x
        adjusted = state.adjusted
        if np.max(np.abs(state.step)) < _STILL * max(1.0, x[3]):
            return state
    raise CalibrationError(_LOOSE)


def _iterated(points: Array, adjusted: Array, C: Array, x: Array, extra: float) -> _State:
    """One iteration (Wittich 2017, eq. 41-50, corrected): linearised at the unknowns x and the adjusted points."""
    n = len(points)
    way = adjusted - x[:3]
    length = np.linalg.norm(way, axis=1)
    normal = way / length[:, None]
    A = np.concatenate([-normal, -np.ones((n, 1))], axis=1)
    B = np.zeros((n, 3 * n))
    B[np.arange(n)[:, None], 3 * np.arange(n)[:, None] + np.arange(3)] = normal
    w = length - x[3] + np.sum(normal * (points - adjusted), axis=1)
    try:
        W = cho_factor(B @ C @ B.T + extra * np.eye(n))
        Q = np.linalg.inv(A.T @ cho_solve(W, A))
    except np.linalg.LinAlgError:
        raise CalibrationError(_LOOSE) from None
    step = -Q @ A.T @ cho_solve(W, w)
    if not np.max(np.abs(step)) < 100.0 * x[3]:
        raise CalibrationError(_LOOSE)
    k = -cho_solve(W, w + A @ step)
    return _State(x + step, step, points + (C @ (B.T @ k)).reshape(n, 3), w, A, B, W, Q, float((w + A @ step) @ -k))
