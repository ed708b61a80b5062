"""Least squares: weighted residuals with their Jacobian in, adjusted unknowns with covariance and residual checks out.

Gauss-Markov model (Wittich 2017, section 2.3; Förstner, Wrobel 2016, chapter 4): minimum, cofactors, redundancy
numbers, variance components, and the test that finds a false observation.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse.linalg import splu

from spheremouse.errors import CalibrationError
from spheremouse.geometry.rotation import Array

Jacobian = sparse.csr_array
Evaluate = Callable[[Array], tuple[Array, Jacobian]]

_LEVEL = 1e-10  # part by which the cost may still fall: digits beyond any measurement
_SHORT = 1e-5  # standard deviations of the residuals by which the last step moves them
_DAMPING = 1e-10  # least, of the scaled normal matrix: what photos hardly fix has pivots of 1e-6
_STUCK = 1e12  # damping at which no step is left
_FIRM = 1e-12  # least pivot of the scaled normal matrix: below, an unknown hangs in the air
PRIOR = 10.0  # redundancy that the assumed variance is worth beside the one found


@dataclass(frozen=True, slots=True)
class Adjusted:
    """Unknowns at the minimum. Residuals are divided by their standard deviations: weight 1."""

    x: Array  # (u,)
    residual: Array  # (n,) of unit variance
    jacobian: Jacobian  # (n, u) of them

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
    weight = huber(evaluate(x0)[0], robust)
    found = _minimised(evaluate, x0, weight, most)
    for _ in range(20):
        before, weight = weight, huber(found.residual, robust)
        if np.max(np.abs(weight - before)) < 1e-3:
            break
        found = _minimised(evaluate, found.x, weight, most)
    return found


def huber(residual: Array, knee: float) -> Array:
    """Factors on residuals and Jacobian that make squares Huber's function."""
    return np.sqrt(np.minimum(1.0, knee / np.maximum(np.abs(residual), 1e-12)))


def _minimised(evaluate: Evaluate, x0: Array, weight: Array | None, most: int) -> Adjusted:
    """Levenberg-Marquardt on the normal equations, damped by the gain (Nielsen 1999), columns of unit length.

    SciPy's decomposes the Jacobian itself, exactly: thirty times as long for thirty photos, for digits that a network
    with a datum does not need.
    """

    def at(x: Array) -> tuple[Array, Jacobian]:
        r, J = evaluate(x)
        return (r, J) if weight is None else (weight * r, J.multiply(weight[:, None]).tocsr())

    x, damping, growth = np.array(x0, dtype=float), _DAMPING, 2.0
    r, J = at(x)
    for _ in range(most):
        cost = float(r @ r)
        scale = np.sqrt(np.asarray(J.power(2).sum(axis=0)).ravel())
        scale[scale == 0.0] = 1.0
        scaled = J @ sparse.diags_array(1.0 / scale)
        normal, down = sparse.csr_array(scaled.T @ scaled).toarray(), -np.asarray(scaled.T @ r)
        if not np.isfinite(cost) or np.max(np.abs(down), initial=0.0) <= _LEVEL * np.sqrt(cost):
            break
        while True:
            step = cho_solve(cho_factor(normal + damping * np.eye(len(x))), down)
            new_r, new_J = at(x + step / scale)
            gain = (cost - float(new_r @ new_r)) / float(step @ (damping * step + down))
            if gain > 0.0:  # nan is not
                break
            damping, growth = damping * growth, 2.0 * growth
            if damping > _STUCK:
                return Adjusted(x, *evaluate(x))
        x, r, J = x + step / scale, new_r, new_J
        damping, growth = max(damping * max(0.1, 1.0 - (2.0 * gain - 1.0) ** 3), _DAMPING), 2.0
        if cost - float(r @ r) <= _LEVEL * cost or np.linalg.norm(step) <= _SHORT:
            break
    else:
        raise CalibrationError("the adjustment does not come to rest: some observation belongs to something else")
    if not np.isfinite(cost):
        raise CalibrationError("the adjustment has no beginning: some observation belongs to something else")
    return Adjusted(x, *((r, J) if weight is None else evaluate(x)))


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
    factor = _factored(normal)
    pivot = np.abs(factor.U.diagonal())
    if pivot.min() < _FIRM:
        raise np.linalg.LinAlgError(int(np.argsort(factor.perm_c)[int(np.argmin(pivot))]))
    unit = np.zeros((u, len(columns)))
    unit[columns, np.arange(len(columns))] = 1.0
    Q = factor.solve(unit)[columns]
    return 0.5 * (Q + Q.T) / np.outer(scale[columns], scale[columns])


def _factored(normal: Any) -> Any:
    """Its decomposition; of one that is singular to the last digit that of a neighbour, whose pivots tell it too."""
    options = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    try:
        return splu(normal, **options)
    except RuntimeError:
        return splu(sparse.csc_array(normal + 1e-2 * _FIRM * sparse.eye_array(normal.shape[0])), **options)
