"""Least squares: weighted residuals with their Jacobian in, adjusted unknowns with covariance and residual checks out.

Gauss-Markov model (Wittich 2017, section 2.3; Förstner, Wrobel 2016, chapter 4). SciPy minimises; what an adjustment
adds is here: cofactors, redundancy numbers, variance components, and the test that finds a false observation.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.optimize import least_squares
from scipy.sparse.linalg import splu

from spheremouse.errors import CalibrationError
from spheremouse.rotation import Array

Jacobian = sparse.csr_array
Evaluate = Callable[[Array], tuple[Array, Jacobian]]

_FIRM = 1e-12  # least pivot of the scaled normal matrix: below, an unknown hangs in the air
_PRIOR = 10.0  # redundancy that the assumed variance is worth beside the one found


@dataclass(frozen=True, slots=True)
class Adjusted:
    """Unknowns at the minimum. Residuals are divided by their standard deviations: weight 1."""

    x: Array  # (u,)
    residual: Array  # (n,) of unit variance
    jacobian: Jacobian  # (n, u) of them
    iterations: int

    @property
    def cost(self) -> float:
        """Sum of squares of the residuals."""
        return float(self.residual @ self.residual)


def adjust(evaluate: Evaluate, x0: Array, robust: float | None = None, most: int = 100) -> Adjusted:
    """Minimise the sum of squares of `evaluate(x)`, or Huber's function of them with its knee at `robust`.

    `evaluate` gives residuals (n,) over their standard deviations, and their Jacobian (n, u). Huber's by weights that
    are renewed until they settle. CalibrationError where it does not come to rest.
    """
    if robust is None:
        return _minimised(evaluate, x0, None, most)
    weight = _huber(evaluate(x0)[0], robust)
    found = _minimised(evaluate, x0, weight, most)
    for _ in range(20):
        before, weight = weight, _huber(found.residual, robust)
        if np.max(np.abs(weight - before)) < 1e-3:
            break
        found = _minimised(evaluate, found.x, weight, most)
    return found


def _huber(residual: Array, knee: float) -> Array:
    return np.sqrt(np.minimum(1.0, knee / np.maximum(np.abs(residual), 1e-12)))


def _minimised(evaluate: Evaluate, x0: Array, weight: Array | None, most: int) -> Adjusted:
    last: list[tuple[Array, tuple[Array, Jacobian]]] = []

    def at(x: Array) -> tuple[Array, Jacobian]:
        if not last or not np.array_equal(last[0][0], x):
            r, J = evaluate(x)
            last[:] = [(x.copy(), (r, J) if weight is None else (weight * r, J.multiply(weight[:, None]).tocsr()))]
        return last[0][1]

    def jacobian_at(x: Array) -> Any:
        # dense: 60 photos are 8 s, and SciPy's iterative solver for sparse ones does not come to rest on such systems
        return at(x)[1].toarray()

    found = least_squares(
        lambda x: at(x)[0],
        x0,
        jac=jacobian_at,  # pyright: ignore[reportArgumentType]  SciPy's stubs know the names of methods only
        tr_solver="exact",
        x_scale="jac",
        xtol=1e-10,
        ftol=1e-10,
        gtol=1e-9,
        max_nfev=most,
    )
    if not np.all(np.isfinite(found.x)) or found.status == 0:
        raise CalibrationError("the adjustment does not come to rest: some observation belongs to something else")
    residual, jacobian = evaluate(found.x)
    return Adjusted(found.x, residual, jacobian, int(found.nfev))


def cofactors(jacobian: Jacobian, columns: NDArray[np.intp] | None = None) -> Array:
    """Inverse of the normal matrix, (u, u), or of its block of some columns, (k, k): covariance at unit variance.

    LinAlgError where the observations leave an unknown open; its argument is the column.
    """
    u = int(jacobian.shape[1])  # pyright: ignore[reportOptionalSubscript]
    columns = np.arange(u) if columns is None else columns
    scale = np.sqrt(np.asarray(jacobian.power(2).sum(axis=0)).ravel())
    if np.any(scale == 0.0):
        raise np.linalg.LinAlgError(int(np.argmin(scale)))
    scaled = jacobian @ sparse.diags_array(1.0 / scale)
    normal = sparse.csc_array(scaled.T @ scaled)
    # the matrix is definite: no pivoting for size, so that a small pivot means what it says
    factor = splu(normal, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    pivot = np.abs(factor.U.diagonal())
    if pivot.min() < _FIRM:
        raise np.linalg.LinAlgError(int(np.argsort(factor.perm_c)[int(np.argmin(pivot))]))
    unit = np.zeros((u, len(columns)))
    unit[columns, np.arange(len(columns))] = 1.0
    Q = factor.solve(unit)[columns]
    return 0.5 * (Q + Q.T) / np.outer(scale[columns], scale[columns])


def redundancy(jacobian: Jacobian, Q: Array, size: int = 1) -> Array:
    """Cofactors of the residuals, (n / size, size, size): blocks on the diagonal of I - J Q J'.

    Of a single observation (size 1) it is the redundancy number: 0 nobody checks it, 1 it is fully checked.
    """
    blocks = (jacobian @ Q).reshape(-1, size, Q.shape[0])
    J = jacobian.toarray().reshape(-1, size, Q.shape[0])
    return np.eye(size) - blocks @ J.transpose(0, 2, 1)


def snooped(residual: Array, cofactor: Array) -> Array:
    """Square of the normalised residual of each of n groups, (n,): chi-square with its size of degrees of freedom.

    Data snooping (Baarda 1968) for points: `residual` (n, size), `cofactor` (n, size, size) of `redundancy`. What
    nothing checks gives 0.
    """
    value, vector = np.linalg.eigh(cofactor)
    along = np.einsum("nji,nj->ni", vector, residual)
    checked = value > 1e-6
    return np.sum(np.where(checked, along**2 / np.where(checked, value, 1.0), 0.0), axis=1)


def variance_factors(
    residual: Array, number: Array, groups: Sequence[NDArray[np.bool_]], factors: Array | None = None
) -> Array:
    """By how much the variance of each group of observations, (k,), differs from what was assumed at first.

    `residual` and redundancy `number` are of an adjustment in which the variances had these `factors` already (None:
    1). Sum of squares over sum of redundancy numbers (Förstner 1979), held near 1 where little redundancy tells it: the
    mean of the inverse gamma distribution that `_PRIOR` earlier observations of variance 1 and these leave, so that
    errors over the covariances that follow are 1 in the mean though the variance was estimated.
    """
    before = np.ones(len(groups)) if factors is None else factors
    squares = np.array([np.sum(residual[g] ** 2) for g in groups])
    freedom = np.array([np.sum(number[g]) for g in groups])
    return (before * squares + _PRIOR) / (freedom + _PRIOR - 2.0)
