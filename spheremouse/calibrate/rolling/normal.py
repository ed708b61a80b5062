"""Normal equations of a rolling ball, their minimum, and the cofactors there."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy import sparse

from spheremouse.calibrate.rolling.problem import GLOBAL, READOUT, Equations, Rolling, Sightings, equations_of
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.geometry.least_squares.adjust import Normal, huber, huber_cost, levenberg_marquardt
from spheremouse.geometry.rotation import Array, exp, hat, tangent_basis

_MIN_READOUT_SIGMA = 1e-7  # s, for a readout that is known exactly


class Eliminated:
    """Cofactors of the shared unknowns at the minimum, without the attitudes.

    Inner constraints remove the rotation of the ball's axes, which no observation fixes.
    """

    def __init__(self, at: Rolling, s: Sightings, equations: Equations, readout: tuple[float, float]) -> None:
        """`readout` is the expected one and its standard deviation, s."""
        weight = np.ones(len(s))
        normal = _normal(at, s, equations, weight, readout)
        own = normal.own + 1e-9 * np.trace(normal.own, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        self.equations, self.frame, self.free = equations, s.frame, _free(at)
        self._inverse = np.linalg.inv(own)
        self._gain = self._inverse @ normal.cross
        N = normal.shared - np.einsum("fik,fil->kl", normal.cross, self._gain)
        scale = 1.0 / np.sqrt(np.diag(N))
        Q = np.linalg.inv(N * np.outer(scale, scale)) * np.outer(scale, scale)
        # remove the weight that held the rotation of the axes
        P = np.eye(len(Q)) - self.free @ self.free.T
        Q = P @ Q @ P
        self.cofactors = 0.5 * (Q + Q.T)  # of the shared unknowns, (4 + 2m, 4 + 2m)

    def reduced(self) -> Array:
        """Return the Jacobian by the shared unknowns with the attitudes eliminated, (n, 2, 4 + 2m)."""
        turn = self.equations.turn
        return self.equations.shared.toarray().reshape(len(turn), 2, -1) - turn @ self._gain[self.frame]

    def residual_cofactors(self) -> Array:
        """Return I - A Q A' of each sighting, (n, 2, 2)."""
        J, turn = self.reduced(), self.equations.turn
        own = turn @ self._inverse[self.frame] @ turn.transpose(0, 2, 1)
        return np.eye(2) - own - (J.reshape(-1, J.shape[2]) @ self.cofactors).reshape(J.shape) @ J.transpose(0, 2, 1)


def minimise(
    at: Rolling, s: Sightings, camera: InteriorOrientation, readout: tuple[float, float], knee: float | None
) -> tuple[Rolling, Eliminated]:
    """Minimise the sum of squares, or of Huber's function with its `knee`.

    `readout` is the expected one and its standard deviation, s. Raises CalibrationError if there is no minimum.
    """

    def linear(at: Rolling) -> tuple[float, Callable[[], Normal]]:
        equations = equations_of(at, s, camera)
        length = np.linalg.norm(equations.residual, axis=1)
        cost = (
            _cost(length, knee, at.readout, readout) if at.ratio > 1.0 else np.inf
        )  # else the camera is within the ball
        return cost, lambda: _normal(at, s, equations, huber(length, knee), readout)

    at = levenberg_marquardt(
        at, linear, lambda at, move: apply_step(at, move.shared, move.own), "roll the ball longer, and about more axes"
    )
    return at, Eliminated(at, s, equations_of(at, s, camera), readout)


def _normal(at: Rolling, s: Sightings, equations: Equations, root: Array, readout: tuple[float, float]) -> Normal:
    """Normal equations of sightings times `root` (n,); an attitude is local to its frame.

    A weight on the mean disc holds the rotation of the ball's axes.
    """
    turn, f = equations.turn * root[:, None, None], len(at.attitude)
    shared = sparse.csr_array(sparse.diags_array(np.repeat(root, 2)) @ equations.shared)
    r = equations.residual * root[:, None]
    rows = np.arange(2 * len(s)).reshape(-1, 2, 1)
    columns = 3 * s.frame[:, None, None] + np.arange(3)
    where = np.broadcast_to(rows, turn.shape).ravel(), np.broadcast_to(columns, turn.shape).ravel()
    at_frame = sparse.csr_array((turn.ravel(), where), shape=(2 * len(s), 3 * f))
    own = np.zeros((f, 3, 3))
    np.add.at(own, s.frame, turn.transpose(0, 2, 1) @ turn)
    N, b = (shared.T @ shared).toarray(), np.asarray(shared.T @ r.ravel())
    expected, sigma = readout
    hold = 1.0 / max(sigma, _MIN_READOUT_SIGMA) ** 2
    N[READOUT, READOUT] += hold
    b[READOUT] += hold * (expected - at.readout)
    free = _free(at)
    N += float(np.median(np.diag(N)[GLOBAL:])) * free @ free.T
    cross = (at_frame.T @ shared).toarray().reshape(f, 3, -1)
    return Normal(N, b, own, cross, (at_frame.T @ r.ravel()).reshape(f, 3))


def _cost(length: Array, knee: float | None, readout: float, expected: tuple[float, float]) -> float:
    """Cost of the residuals, and of the readout's prior."""
    return huber_cost(length, knee) + ((readout - expected[0]) / max(expected[1], _MIN_READOUT_SIGMA)) ** 2


def _free(at: Rolling) -> Array:
    """Orthonormal basis, (4 + 2m, 3), of the rotations of the ball's axes: a disc moves by e x d."""
    free = np.zeros((GLOBAL + 2 * len(at.discs), 3))
    free[GLOBAL:] = -(tangent_basis(at.discs).transpose(0, 2, 1) @ hat(at.discs)).reshape(-1, 3)
    return np.linalg.qr(free)[0]


def apply_step(at: Rolling, dx: Array, de: Array) -> Rolling:
    """Apply a step of the shared unknowns, (4 + 2m,), and of the attitudes, (f, 3)."""
    c = at.direction + tangent_basis(at.direction) @ dx[:2]
    d = at.discs + np.einsum("mij,mj->mi", tangent_basis(at.discs), dx[GLOBAL:].reshape(-1, 2))
    return replace(
        at,
        direction=c / np.linalg.norm(c),
        ratio=at.ratio * float(np.exp(np.clip(dx[2], -0.5, 0.5))),
        readout=at.readout + float(dx[READOUT]),
        discs=d / np.linalg.norm(d, axis=1, keepdims=True),
        attitude=exp(de) @ at.attitude,
    )
