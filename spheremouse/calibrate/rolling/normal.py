"""Normal equations of a rolling ball, and their minimum."""

from dataclasses import replace

import numpy as np
from scipy import sparse

from spheremouse.calibrate.rolling.problem import (
    GLOBAL,
    READOUT,
    Equations,
    Rolling,
    Sightings,
    equations_of,
)
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.geometry.rotation import Array, exp, hat, tangent_basis

_MOST = 40  # iterations
_STILL = 1e-9  # rad: a step so short is the last
_FIRM = 1e-7  # s: a readout known for sure is held so firmly


class Normal:
    """Normal equations with the attitudes eliminated; the turn of the ball's axes, which nothing fixes, is held."""

    def __init__(
        self, at: Rolling, s: Sightings, equations: Equations, weight: Array, readout: tuple[float, float]
    ) -> None:
        """`weight` (n,) of the sightings; `readout` the expected one and its standard deviation, s."""
        f = len(at.attitude)
        root = np.sqrt(weight)
        self.equations, self.frame = equations, s.frame
        self.turn = equations.turn * root[:, None, None]
        self.shared = sparse.csr_array(sparse.diags_array(np.repeat(root, 2)) @ equations.shared)
        r = equations.residual * root[:, None]
        rows = np.arange(2 * len(s)).reshape(-1, 2, 1)
        columns = 3 * s.frame[:, None, None] + np.arange(3)
        at_frame = sparse.csr_array(
            (
                self.turn.ravel(),
                (np.broadcast_to(rows, self.turn.shape).ravel(), np.broadcast_to(columns, self.turn.shape).ravel()),
            ),
            shape=(2 * len(s), 3 * f),
        )
        own = np.zeros((f, 3, 3))
        np.add.at(own, s.frame, self.turn.transpose(0, 2, 1) @ self.turn)
        self.inverse = np.linalg.inv(own + 1e-9 * np.trace(own, axis1=1, axis2=2)[:, None, None] * np.eye(3))
        self.cross = (at_frame.T @ self.shared).toarray().reshape(f, 3, -1)
        self.by_frame = (at_frame.T @ r.ravel()).reshape(f, 3)
        gain = self.inverse @ self.cross
        N = (self.shared.T @ self.shared).toarray() - np.einsum("fik,fil->kl", self.cross, gain)
        b = self.shared.T @ r.ravel() - np.einsum("fik,fi->k", gain, self.by_frame)
        expected, sigma = readout
        hold = 1.0 / max(sigma, _FIRM) ** 2
        N[READOUT, READOUT] += hold
        b[READOUT] += hold * (expected - at.readout)
        scale = 1.0 / np.sqrt(np.diag(N))
        # the ball's axes may turn by any e, R follows: a disc moves by e x d. Held where its discs are on the mean
        free = np.zeros((len(b), 3))
        free[GLOBAL:] = -(tangent_basis(at.discs).transpose(0, 2, 1) @ hat(at.discs)).reshape(-1, 3)
        self.free = np.linalg.qr(free)[0]
        size = float(np.median(np.diag(N)[GLOBAL:]))
        self.N, self.b, self.scale, self.held = N, b, scale, size * self.free @ self.free.T

    def step(self, damping: float) -> tuple[Array, Array]:
        """Corrections of the shared unknowns, (4 + 2m,), and of the attitudes, (f, 3)."""
        M = (self.N + self.held) * np.outer(self.scale, self.scale)
        M[np.diag_indices_from(M)] *= 1.0 + damping
        dx = self.scale * np.linalg.solve(M, self.scale * self.b)
        de = np.einsum("fij,fj->fi", self.inverse, self.by_frame - self.cross @ dx)
        return dx, de

    def cofactors(self) -> Array:
        """Of the shared unknowns, (4 + 2m, 4 + 2m)."""
        M = (self.N + self.held) * np.outer(self.scale, self.scale)
        Q = np.linalg.inv(M) * np.outer(self.scale, self.scale)
        # inner constraints: what the held turn itself added is taken off again
        P = np.eye(len(Q)) - self.free @ self.free.T
        Q = P @ Q @ P
        return 0.5 * (Q + Q.T)

    def reduced(self) -> Array:
        """Jacobian by the shared unknowns with the attitudes eliminated, (n, 2, 4 + 2m)."""
        n = len(self.turn)
        return self.shared.toarray().reshape(n, 2, -1) - self.turn @ (self.inverse @ self.cross)[self.frame]

    def residual_cofactors(self) -> Array:
        """I - A Q A' of each sighting, (n, 2, 2)."""
        J = self.reduced()
        Q = self.cofactors()
        own = self.turn @ self.inverse[self.frame] @ self.turn.transpose(0, 2, 1)
        return np.eye(2) - own - (J.reshape(-1, J.shape[2]) @ Q).reshape(J.shape) @ J.transpose(0, 2, 1)


def minimised(
    at: Rolling, s: Sightings, camera: InteriorOrientation, readout: tuple[float, float], knee: float
) -> tuple[Rolling, Normal]:
    """Levenberg and Marquardt's way to the least sum of squares, or of Huber's function with its knee."""
    damping, dx = 1e-6, np.full(GLOBAL, np.inf)
    equations = equations_of(at, s, camera)
    for _ in range(_MOST):
        length = np.linalg.norm(equations.residual, axis=1)
        weight = np.minimum(1.0, knee / np.maximum(length, 1e-12))
        cost = _cost(length, knee, at.readout, readout)
        normal = Normal(at, s, equations, weight, readout)
        dx, de = normal.step(damping)
        tried = _moved(at, dx, de)
        there = equations_of(tried, s, camera) if tried.ratio > 1.0 else None
        better = there is not None and (
            _cost(np.linalg.norm(there.residual, axis=1), knee, tried.readout, readout) <= cost * (1.0 + 1e-12)
        )
        if better and there is not None:
            at, equations, damping = tried, there, max(0.1 * damping, 1e-9)
        else:
            damping = max(10.0 * damping, 1e-4)
        if np.abs(np.delete(dx, READOUT)).max() < _STILL or damping > 1e6:
            break
    else:
        if np.abs(dx[:3]).max() > 1e-6:
            raise CalibrationError("the adjustment does not come to rest: roll the ball longer, and about more axes")
    return at, Normal(at, s, equations, np.ones(len(s)), readout)


def _cost(length: Array, knee: float, readout: float, expected: tuple[float, float]) -> float:
    """Cost that a step makes less: the residuals' part, and that of what was known of the readout before."""
    before = ((readout - expected[0]) / max(expected[1], _FIRM)) ** 2
    if not np.isfinite(knee):
        return float(length @ length) + before
    return float(np.sum(np.where(length < knee, length**2, 2.0 * knee * length - knee**2))) + before


def _moved(at: Rolling, dx: Array, de: Array) -> Rolling:
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
