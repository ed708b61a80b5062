"""Least squares in the Gauss-Markov model: adjusted unknowns, their cofactors, redundancy, outliers, variance factors.

Sources: Wittich 2017, section 2.3; Förstner, Wrobel 2016, chapter 4.
"""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from spheremouse.errors import CalibrationError
from spheremouse.geometry.rotation import Array

Jacobian = sparse.csr_array
T = TypeVar("T")

_COST_TOLERANCE = 1e-10  # relative decrease of the cost at convergence, below any measurement's precision
_STEP_TOLERANCE = 1e-5  # standard deviations of the residuals by which the last step changes them
_MIN_DAMPING = 1e-10  # of the scaled normal matrix; weakly determined unknowns of photos have pivots of 1e-6
_MAX_DAMPING = 1e12  # at which the step is 0
_MIN_PIVOT = 1e-12  # of the scaled normal matrix; below it an unknown is undetermined
_MAX_ITERATIONS = 100
_PRIOR_REDUNDANCY = 10.0  # weight of the assumed variance beside the estimated one


def adjust(
    evaluate: Callable[[T], tuple[Array, Jacobian]],
    at: T,
    retract: Callable[[T, Array], T],
    hint: str,
    knee: float = np.inf,
) -> T:
    """Minimise the sum of squares of the residuals, or Huber's function of them with its `knee`, from a start `at`.

    Levenberg-Marquardt with damping by gain (Nielsen 1999). `evaluate` returns residuals (n,) over their standard
    deviations, and their Jacobian (n, u). Observed unknowns (priors) are among them, and `knee` holds for them, too.
    `retract` applies a step (u,). A cost that is not finite counts as the worst. Raises CalibrationError with the
    `hint` if the start is invalid, or if squares do not converge. Huber's function only gives a start for squares, and
    outliers can make its convergence slow, so its last point is good enough.

    SciPy's solver decomposes the Jacobian and takes thirty times as long for thirty photos; a network with a datum
    does not need it.
    """
    residual, J = evaluate(at)
    cost, damping = huber_cost(residual, knee), _MIN_DAMPING
    if not np.isfinite(cost):
        raise CalibrationError(f"the adjustment has no beginning: {hint}")
    for _ in range(_MAX_ITERATIONS):
        weight, growth = huber(residual, knee), 2.0
        N, scale = _scaled_normal(sparse.csr_array(sparse.diags_array(weight) @ J))
        right = -scale * (J.T @ (weight**2 * residual))
        while True:
            step = _factor(sparse.csc_array(N + damping * sparse.eye_array(len(scale)))).solve(right)
            promised = float(step @ right) + damping * float(step @ step)  # decrease of the cost in the linear model
            if promised <= _COST_TOLERANCE**2 * cost:
                return at
            candidate = retract(at, scale * step)
            residual, J = evaluate(candidate)
            gain = (cost - huber_cost(residual, knee)) / promised
            if gain > 0.0:  # nan is not
                break
            damping, growth = damping * growth, 2.0 * growth
            if damping > _MAX_DAMPING:
                return at
        damping = max(damping * max(0.1, 1.0 - (2.0 * gain - 1.0) ** 3), _MIN_DAMPING)
        at, cost = candidate, cost - gain * promised
        if gain * promised <= _COST_TOLERANCE * cost or np.linalg.norm(step) <= _STEP_TOLERANCE:
            return at
    if knee < np.inf:
        return at
    raise CalibrationError(f"the adjustment does not come to rest: {hint}")


def _scaled_normal(J: Jacobian) -> tuple[sparse.csc_array, Array]:
    """Return J'J, (u, u), scaled to a diagonal of 1, and the scale, (u,); an unknown without effect has scale 1."""
    size = np.sqrt(np.asarray(J.power(2).sum(axis=0)).ravel())
    scale = 1.0 / np.where(size > 0.0, size, 1.0)
    scaled = J @ sparse.diags_array(scale)
    return sparse.csc_array(scaled.T @ scaled), scale


def huber(residual: Array, knee: float) -> Array:
    """Return the factors (n,) on residuals and Jacobian that turn squares into Huber's function.

    Residuals (n,) and `knee` are in standard deviations.
    """
    return np.sqrt(np.minimum(1.0, knee / np.maximum(np.abs(residual), 1e-12)))


def huber_cost(residual: Array, knee: float) -> float:
    """Return twice Huber's function, summed over residuals (n,)."""
    size = np.abs(residual)
    part = np.minimum(size, knee)
    return float(np.sum(part * (2.0 * size - part)))


def cofactors(jacobian: Jacobian) -> Array:
    """Return the covariance at unit variance: the inverse of the normal matrix, (u, u).

    Raises LinAlgError with the column of an undetermined unknown.
    """
    normal, scale = _scaled_normal(jacobian)
    if not np.all(normal.diagonal() > 0.0):
        raise np.linalg.LinAlgError(int(np.argmin(normal.diagonal())))
    # The matrix is definite, so it needs no pivoting for size, and a small pivot shows an undetermined unknown.
    factor = _factor(normal)
    pivot = np.abs(factor.U.diagonal())
    if pivot.min() < _MIN_PIVOT:
        raise np.linalg.LinAlgError(int(np.argsort(factor.perm_c)[int(np.argmin(pivot))]))
    Q = factor.solve(np.eye(len(scale)))
    return 0.5 * (Q + Q.T) * np.outer(scale, scale)


def _factor(normal: Any) -> Any:
    """Return the LU decomposition; of an exactly singular matrix that of a slightly regularised one."""
    options = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    try:
        return splu(normal, **options)
    except RuntimeError:
        return splu(sparse.csc_array(normal + 1e-2 * _MIN_PIVOT * sparse.eye_array(normal.shape[0])), **options)


# ---- reliability ----


def redundancy(jacobian: Jacobian, Q: Array, size: int = 1) -> Array:
    """Return the cofactors of the residuals, (n / size, size, size): diagonal blocks of I - J Q J'.

    For a single observation (size 1) it is the redundancy number: 0 for an unchecked one, 1 for a fully checked one.
    """
    blocks = (jacobian @ Q).reshape(-1, size, Q.shape[0])
    J = jacobian.toarray().reshape(-1, size, Q.shape[0])
    return np.eye(size) - blocks @ J.transpose(0, 2, 1)


def outlier_statistic(residual: Array, cofactor: Array) -> Array:
    """Return the squared normalised residual of n groups, (n,): chi-square with `size` degrees of freedom.

    Data snooping (Baarda 1968) for points: `residual` (n, size), `cofactor` (n, size, size) of `redundancy`. An
    unchecked group gives 0.
    """
    value, vector = np.linalg.eigh(cofactor)
    along = np.einsum("nji,nj->ni", vector, residual)
    checked = value > 1e-6
    return np.sum(np.where(checked, along**2 / np.where(checked, value, 1.0), 0.0), axis=1)


def variance_factors(
    residual: Array, number: Array, groups: Sequence[NDArray[np.bool_]], factors: Array | None = None
) -> Array:
    """Return the estimated variance of each group of observations over its first assumption, (k,).

    `residual` and redundancy `number` are of an adjustment with these `factors` on the variances (None: 1). The
    estimate is the sum of squares over the sum of redundancy numbers (Förstner 1979), shrunk to 1 by a prior. It is the
    mean of the inverse gamma distribution after `_PRIOR_REDUNDANCY` observations of variance 1 and these ones. So
    errors over the resulting covariances are 1 in the mean.
    """
    before = np.ones(len(groups)) if factors is None else factors
    squares = np.array([np.sum(residual[g] ** 2) for g in groups])
    freedom = np.array([np.sum(number[g]) for g in groups])
    return (before * squares + _PRIOR_REDUNDANCY) / (freedom + _PRIOR_REDUNDANCY - 2.0)
