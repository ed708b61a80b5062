"""Least squares in the Gauss-Markov model: adjusted unknowns, their cofactors, redundancy, outliers, variance factors.

Sources: Wittich 2017, section 2.3; Förstner, Wrobel 2016, chapter 4.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse.linalg import splu

from spheremouse.errors import CalibrationError
from spheremouse.geometry.rotation import Array

Jacobian = sparse.csr_array
Evaluate = Callable[[Array], tuple[Array, Jacobian]]
T = TypeVar("T")

_COST_TOLERANCE = 1e-10  # relative decrease of the cost at convergence, below any measurement's precision
_STEP_TOLERANCE = 1e-5  # standard deviations of the residuals by which the last step changes them
_MIN_DAMPING = 1e-10  # of the scaled normal matrix; weakly determined unknowns of photos have pivots of 1e-6
_MAX_DAMPING = 1e12  # at which the step is 0
_MIN_PIVOT = 1e-12  # of the scaled normal matrix; below it an unknown is undetermined
_MAX_REWEIGHTINGS = 21
_FALSE_OBSERVATION = "some observation belongs to something else"
_PRIOR_REDUNDANCY = 10.0  # weight of the assumed variance beside the estimated one


@dataclass(frozen=True, slots=True)
class Adjusted:
    """Unknowns at the minimum. Residuals are divided by their standard deviations."""

    x: Array  # (u,)
    residual: Array  # (n,) of unit variance
    jacobian: Jacobian  # (n, u) of the residuals

    @property
    def cost(self) -> float:
        """Sum of squares of the residuals."""
        return float(self.residual @ self.residual)


class Move(NamedTuple):
    """A step of all unknowns."""

    shared: Array  # (s,)
    own: Array  # (v, k)
    promised: float  # decrease of the sum of squares in the linear model
    length: float  # largest change of the residuals, standard deviations


@dataclass(frozen=True, slots=True)
class Normal:
    """Normal equations of `s` shared unknowns and of `k` local ones in each of `v` groups of residuals.

    The local unknowns, of a view or a frame, are eliminated by the Schur complement (Förstner, Wrobel 2016, section
    15.2). So a hundred groups cost little more than ten.
    """

    shared: Array  # (s, s) J'J
    right: Array  # (s,) -J'r, of residuals r computed minus measured
    own: Array  # (v, k, k)
    cross: Array  # (v, k, s)
    own_right: Array  # (v, k)

    def step(self, damping: float) -> Move | None:
        """Return the step to the minimum with a diagonal increased by the fraction `damping`, or None."""
        scale, own_scale = _unit(np.diag(self.shared)), _unit(np.einsum("vii->vi", self.own))
        N = self.shared * np.outer(scale, scale) + damping * np.eye(len(scale))
        own = self.own * own_scale[:, :, None] * own_scale[:, None, :] + damping * np.eye(self.own.shape[1])
        cross = self.cross * own_scale[:, :, None] * scale
        down, own_down = scale * self.right, own_scale * self.own_right
        try:
            gain = np.linalg.solve(own, np.concatenate([cross, own_down[:, :, None]], axis=2))
            reduced = cho_factor(N - np.einsum("vij,vik->jk", cross, gain[:, :, :-1]))
        except np.linalg.LinAlgError:
            return None
        x = cho_solve(reduced, down - np.einsum("vij,vi->j", cross, gain[:, :, -1]))
        y = gain[:, :, -1] - gain[:, :, :-1] @ x
        squares = float(x @ x + np.sum(y**2))
        promised = float(x @ down + np.sum(y * own_down)) + damping * squares
        return Move(scale * x, own_scale * y, promised, float(np.sqrt(squares)))


def no_groups(shared: int) -> tuple[Array, Array, Array]:
    """Return `own`, `cross` and `own_right` of a `Normal` with `shared` unknowns and no local ones, all empty."""
    return np.zeros((0, 0, 0)), np.zeros((0, 0, shared)), np.zeros((0, 0))


def _unit(diagonal: Array) -> Array:
    """Return the factors that scale a diagonal to 1; 1 for an unknown without effect."""
    return 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))


def levenberg_marquardt(
    at: T,
    linearise: Callable[[T], tuple[float, Callable[[], Normal]]],
    retract: Callable[[T, Move], T],
    failure_hint: str,
    max_iterations: int = 100,
) -> T:
    """Return the point of least cost, starting at `at`, by Levenberg-Marquardt with damping by gain (Nielsen 1999).

    `linearise` returns the cost at a point, and a function for its normal equations. A cost that is not finite counts
    as the worst. `retract` applies a step. If the start is invalid or the iteration does not converge, CalibrationError
    is raised, with `failure_hint`.
    """
    cost, normal = linearise(at)
    if not np.isfinite(cost):
        raise CalibrationError(f"the adjustment has no beginning: {failure_hint}")
    damping = _MIN_DAMPING
    for _ in range(max_iterations):
        equations, growth = normal(), 2.0
        while True:
            move = equations.step(damping)
            if move is not None:
                if move.promised <= _COST_TOLERANCE**2 * cost:
                    return at
                candidate = retract(at, move)
                lower, normal = linearise(candidate)
                gain = (cost - lower) / move.promised
                if gain > 0.0:  # nan is not
                    break
            damping, growth = damping * growth, 2.0 * growth
            if damping > _MAX_DAMPING:
                return at
        damping = max(damping * max(0.1, 1.0 - (2.0 * gain - 1.0) ** 3), _MIN_DAMPING)
        at, cost, fallen = candidate, lower, cost - lower
        if fallen <= _COST_TOLERANCE * cost or move.length <= _STEP_TOLERANCE:
            return at
    raise CalibrationError(f"the adjustment does not come to rest: {failure_hint}")


def adjust(evaluate: Evaluate, x0: Array, robust: float | None = None) -> Adjusted:
    """Minimise the sum of squares of the residuals, or Huber's function of them with its knee at `robust`.

    `evaluate` returns residuals (n,) over their standard deviations, and their Jacobian (n, u). Huber's function is
    minimised by iterative reweighting. Raises CalibrationError if the iteration does not converge. SciPy's solver
    decomposes the Jacobian and takes thirty times as long for thirty photos; a network with a datum does not need it.
    """
    x = np.array(x0, dtype=float)
    if robust is None:
        x = _solve_weighted(evaluate, x, weight=None)
        return Adjusted(x, *evaluate(x))
    found, weight = Adjusted(x, *evaluate(x)), np.zeros(0)
    for _ in range(_MAX_REWEIGHTINGS):
        before, weight = weight, huber(found.residual, robust)
        if len(before) and np.max(np.abs(weight - before)) < 1e-3:
            break
        x = _solve_weighted(evaluate, found.x, weight)
        found = Adjusted(x, *evaluate(x))
    return found


def _solve_weighted(evaluate: Evaluate, x: Array, weight: Array | None) -> Array:
    """Return the minimum of the squared residuals times `weight`, (n,)."""

    def linearise(x: Array) -> tuple[float, Callable[[], Normal]]:
        r, J = evaluate(x)
        if weight is not None:
            r, J = weight * r, J.multiply(weight[:, None]).tocsr()

        def normal() -> Normal:
            return Normal(sparse.csr_array(J.T @ J).toarray(), -np.asarray(J.T @ r), *no_groups(len(x)))

        return float(r @ r), normal

    return levenberg_marquardt(x, linearise, lambda x, move: x + move.shared, _FALSE_OBSERVATION)


def huber(residual: Array, knee: float | None) -> Array:
    """Return the factors on residuals and Jacobian that turn squares into Huber's function; 1 without a knee.

    They have the shape of `residual`, which can be any. Residual and knee are in standard deviations.
    """
    size = np.maximum(np.abs(residual), 1e-12)
    return np.ones_like(residual) if knee is None else np.sqrt(np.minimum(1.0, knee / size))


def huber_cost(residual: Array, knee: float | None) -> float:
    """Return twice Huber's function, summed over residuals of any shape; without a knee the sum of squares."""
    size = np.abs(residual)
    return float(np.sum(size**2 if knee is None else np.where(size < knee, size**2, knee * (2.0 * size - knee))))


def cofactors(jacobian: Jacobian, columns: NDArray[np.intp] | None = None) -> Array:
    """Return the covariance at unit variance: the inverse of the normal matrix, (u, u), or its block of some columns.

    Raises LinAlgError with the column of an undetermined unknown.
    """
    u = int(jacobian.shape[1])  # pyright: ignore[reportOptionalSubscript]
    columns = np.arange(u) if columns is None else columns
    scale = np.sqrt(np.asarray(jacobian.power(2).sum(axis=0)).ravel())
    if np.any(scale == 0.0):
        raise np.linalg.LinAlgError(int(np.argmin(scale)))
    scaled = jacobian @ sparse.diags_array(1.0 / scale)
    normal = sparse.csc_array(scaled.T @ scaled)
    # The matrix is definite, so it needs no pivoting for size, and a small pivot shows an undetermined unknown.
    factor = _factor(normal)
    pivot = np.abs(factor.U.diagonal())
    if pivot.min() < _MIN_PIVOT:
        raise np.linalg.LinAlgError(int(np.argsort(factor.perm_c)[int(np.argmin(pivot))]))
    unit = np.zeros((u, len(columns)))
    unit[columns, np.arange(len(columns))] = 1.0
    Q = factor.solve(unit)[columns]
    return 0.5 * (Q + Q.T) / np.outer(scale[columns], scale[columns])


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
