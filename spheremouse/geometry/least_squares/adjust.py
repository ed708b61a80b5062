"""Least squares: weighted residuals with their Jacobian in, adjusted unknowns with covariance and residual checks out.

Gauss-Markov model (Wittich 2017, section 2.3; Förstner, Wrobel 2016, chapter 4): minimum, cofactors, redundancy
numbers, variance components, and the test that finds a false observation.
"""

from collections.abc import Callable
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

_LEVEL = 1e-10  # part by which the cost may still fall: digits beyond any measurement
_SHORT = 1e-5  # standard deviations of the residuals by which the last step moves them
_DAMPING = 1e-10  # least, of the scaled normal matrix: what photos hardly fix has pivots of 1e-6
_STUCK = 1e12  # damping at which no step is left
_FIRM = 1e-12  # least pivot of the scaled normal matrix: below, an unknown hangs in the air
_RENEWED = 21  # times, at most
_FALSE = "some observation belongs to something else"
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


class Move(NamedTuple):
    """A step of all unknowns."""

    shared: Array  # (s,)
    own: Array  # (v, k)
    promised: float  # by how much the sum of squares falls, were the residuals linear
    length: float  # standard deviations of the residuals by which it moves them, at most


@dataclass(frozen=True, slots=True)
class Normal:
    """Normal equations of `s` unknowns that all residuals share, and of `k` local ones in each of `v` groups of them.

    The local ones, of a view or a frame, are eliminated (Schur complement; Förstner, Wrobel 2016, section 15.2): a
    hundred groups cost little more than ten.
    """

    shared: Array  # (s, s) J'J
    right: Array  # (s,) -J'r, of residuals r computed minus seen
    own: Array  # (v, k, k)
    cross: Array  # (v, k, s)
    own_right: Array  # (v, k)

    def step(self, damping: float) -> Move | None:
        """The step to the least sum of squares, with the diagonal enlarged by the part `damping`; None: no minimum."""
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


def _no_groups(shared: int) -> tuple[Array, Array, Array]:
    """The part of local unknowns where there are none."""
    return np.zeros((0, 0, 0)), np.zeros((0, 0, shared)), np.zeros((0, 0))


def _unit(diagonal: Array) -> Array:
    """Factors that make a diagonal 1; what nothing depends on stays."""
    return 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))


def levenberg_marquardt(
    at: T,
    linear: Callable[[T], tuple[float, Callable[[], Normal]]],
    moved: Callable[[T, Move], T],
    restless: str,
    most: int = 100,
) -> T:
    """The place of the least cost, from `at` on: Levenberg-Marquardt, damped by the gain (Nielsen 1999).

    `linear` gives the cost at a place, and its normal equations when they are asked for; a cost that is not finite is
    worse than any. CalibrationError, which ends with `restless`, where there is no beginning or no rest.
    """
    cost, normal = linear(at)
    if not np.isfinite(cost):
        raise CalibrationError(f"the adjustment has no beginning: {restless}")
    damping = _DAMPING
    for _ in range(most):
        equations, growth = normal(), 2.0
        while True:
            move = equations.step(damping)
            if move is not None:
                if move.promised <= _LEVEL**2 * cost:
                    return at
                there = moved(at, move)
                lower, normal = linear(there)
                gain = (cost - lower) / move.promised
                if gain > 0.0:  # nan is not
                    break
            damping, growth = damping * growth, 2.0 * growth
            if damping > _STUCK:
                return at
        damping = max(damping * max(0.1, 1.0 - (2.0 * gain - 1.0) ** 3), _DAMPING)
        at, cost, fallen = there, lower, cost - lower
        if fallen <= _LEVEL * cost or move.length <= _SHORT:
            return at
    raise CalibrationError(f"the adjustment does not come to rest: {restless}")


def adjust(evaluate: Evaluate, x0: Array, robust: float | None = None) -> Adjusted:
    """Minimise the sum of squares of `evaluate(x)`, or Huber's function of them with its knee at `robust`.

    `evaluate` gives residuals (n,) over their standard deviations, and their Jacobian (n, u). Huber's by weights that
    are renewed until they settle. CalibrationError where it does not come to rest. SciPy's decomposes the Jacobian
    itself, exactly: thirty times as long for thirty photos, for digits that a network with a datum does not need.
    """
    x = np.array(x0, dtype=float)
    if robust is None:
        x = _weighted(evaluate, x, None)
        return Adjusted(x, *evaluate(x))
    found, weight = Adjusted(x, *evaluate(x)), np.zeros(0)
    for _ in range(_RENEWED):
        before, weight = weight, huber(found.residual, robust)
        if len(before) and np.max(np.abs(weight - before)) < 1e-3:
            break
        x = _weighted(evaluate, found.x, weight)
        found = Adjusted(x, *evaluate(x))
    return found


def _weighted(evaluate: Evaluate, x: Array, weight: Array | None) -> Array:
    """The minimum of squares of residuals times `weight`, (n,)."""

    def linear(x: Array) -> tuple[float, Callable[[], Normal]]:
        r, J = evaluate(x)
        if weight is not None:
            r, J = weight * r, J.multiply(weight[:, None]).tocsr()

        def normal() -> Normal:
            return Normal(sparse.csr_array(J.T @ J).toarray(), -np.asarray(J.T @ r), *_no_groups(len(x)))

        return float(r @ r), normal

    return levenberg_marquardt(x, linear, lambda x, move: x + move.shared, _FALSE)


def huber(residual: Array, knee: float | None) -> Array:
    """Factors on residuals and Jacobian that make squares Huber's function; 1 without a knee."""
    size = np.maximum(np.abs(residual), 1e-12)
    return np.ones_like(residual) if knee is None else np.sqrt(np.minimum(1.0, knee / size))


def huber_cost(residual: Array, knee: float | None) -> float:
    """Twice Huber's function of residuals, their squares up to the knee; the sum of all squares without one."""
    size = np.abs(residual)
    return float(np.sum(size**2 if knee is None else np.where(size < knee, size**2, knee * (2.0 * size - knee))))


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
