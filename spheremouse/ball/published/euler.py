"""The two classic filters: extended Kalman filters on Euler angles and their rates, as published.

SpherePoints of one frame in, attitude and angular velocity out (Wittich 2017, sections 2.3.2 and 3.9.1-3.9.3). `ekf1`
(ConstantDiscsFilter) stores observed discs as constants. `ekf2` (StateDiscsFilter) estimates them with the attitude.
The code follows the publication, including its weaknesses, so that they are a baseline for the default filter:

- At phi = +-90 deg the angles are singular. Near it omega and kappa change fast, against the model of constant rates.
  The filters lose points, and the attitude jumps by degrees. They raise no error and continue.
- The filters delete a stored disc if one frame does not show it. They do not recognise the ball after a full turn.
- The covariances are optimistic. The initial one is far too small for a ball that already turns (eq. 123). A new point
  is stored as if the attitude were exact (eq. 170-171). Pose and ball errors count as new in every frame.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.points import SpherePoints
from spheremouse.ball.settings import EulerSettings
from spheremouse.geometry.rotation import (
    Array,
    euler_rate_matrix,
    exp,
    from_euler,
    hat,
    left_jacobian,
    to_euler,
)

_ROUNDING_RAD = 1e-12  # rad: what an attitude loses on its way to angles and back


class EulerState(NamedTuple):
    """State of either filter; `state_covariance` ends with the rates for ekf1 and goes on with the points for ekf2."""

    stamp: float  # s
    angles: Array  # (3,) rad, omega, phi, kappa; not wrapped
    angle_rates: Array  # (3,) rad/s
    points: Array  # (m, 3) m, ball: stored discs
    state_covariance: Array  # (6, 6) or (6 + 3m, 6 + 3m): angles, rates, points (eq. 121, 151)
    used: NDArray[np.intp]  # (k,) indices of the last update's points that were associated
    reference: Array = np.zeros((3, 3))  # (3, 3) rad², attitude that motion counts from

    @property
    def attitude(self) -> Array:
        """R_obj_ball, (3, 3)."""
        return from_euler(self.angles)

    @property
    def rate(self) -> Array:
        """w_obj, (3,) rad/s."""
        return angular_velocity(self.angles, self.angle_rates)[0]

    @property
    def covariance(self) -> Array:
        """(6, 6) of the rotation error vector (rad, obj, exp(e) @ attitude) and of w_obj (rad/s).

        An error da of the angles is the rotation e = E da, with E = euler_rate_matrix, and an error of w_obj besides.
        Singular at phi = +-90 deg, as E is.
        """
        J = np.zeros((6, 6))
        J[:3, :3] = euler_rate_matrix(self.angles)
        _, J[3:, :3], J[3:, 3:] = angular_velocity(self.angles, self.angle_rates)
        return J @ self.state_covariance[:6, :6] @ J.T

    @property
    def discs(self) -> Array:
        """(m, 3) unit vectors in `ball`."""
        return self.points / np.linalg.norm(self.points, axis=1, keepdims=True)

    @property
    def rig_error(self) -> Array:
        """(4,) of focal length and centre: none."""
        return np.zeros(4)

    seen_rig = rig_error

    @property
    def centre_noise(self) -> float:
        return 0.0

    @property
    def statistics(self) -> dict[str, float]:
        """Nothing: the publication has no test of the innovations."""
        return {}

    def clone_attitude(self) -> "EulerState":
        """Return the state with its current attitude as the reference of the next increment."""
        return self._replace(reference=self.covariance[:3, :3])

    def with_reference_of(self, other: "EulerState") -> "EulerState":
        """Return the state with the reference of `other`."""
        return self._replace(reference=other.reference)

    def with_cameras_of(self, other: "EulerState") -> "EulerState":
        """Return the same state: the publication has one camera."""
        return self

    def increment_covariance(self, turn: Array) -> Array:
        """Return the covariance, (6, 6), of the rotation vector `turn`, (3,) rad, since the reference, and of the rate.

        The publication gives no correlation between the errors of two attitudes, so they count as independent. A zero
        turn is the start of an increment and has no error.
        """
        if turn @ turn < _ROUNDING_RAD**2:
            P = self.covariance
            P[:3] = P[:, :3] = 0.0
            return P
        inverse = np.linalg.inv(left_jacobian(turn))
        G = np.eye(6)
        G[:3, :3] = inverse
        P = G @ self.covariance @ G.T
        inverse = inverse @ exp(turn)
        P[:3, :3] += inverse @ self.reference @ inverse.T
        return P


@dataclass(frozen=True, slots=True)
class _EulerFilter:
    """The parts that both filters share."""

    settings: EulerSettings = field(default_factory=EulerSettings)

    def initial(self, stamp: float, attitude: Array) -> EulerState:
        """Return a state at rest at `attitude` (3, 3), without a stored disc (eq. 122-123)."""
        P = self.settings.start_sigma**2 * np.eye(6)
        return EulerState(stamp, to_euler(attitude), np.zeros(3), np.zeros((0, 3)), P, np.zeros(0, dtype=np.intp))

    def predict(self, state: EulerState, stamp: float) -> EulerState:
        """Return the state at `stamp` (s) by constant Euler rates; discs stay where they are on the ball.

        Eq. 126-133, 152-156 and 61; Phi P Phi^T + G Sigma_ww G^T without the zeros of Phi and G.
        """
        dt = stamp - state.stamp
        P = state.state_covariance.copy()
        P[:3] += dt * P[3:6]
        P[:, :3] += dt * P[:, 3:6]
        g = np.array([0.5 * dt * dt, dt])
        P[:6, :6] += np.kron(self.settings.acceleration_sigma**2 * np.outer(g, g), np.eye(3))
        angles = state.angles + dt * state.angle_rates
        none = np.zeros(0, dtype=np.intp)
        return EulerState(stamp, angles, state.angle_rates, state.points, P, none, state.reference)

    def adopt(self, state: EulerState, before: "_EulerFilter") -> EulerState:
        """Return the same state, since it does not depend on the settings."""
        return state

    def gate_radius(self, state: EulerState, which: NDArray[np.intp], interval: float) -> Array:
        """Return the gate's length as an angle, (k,) rad."""
        return self.settings.gate / np.linalg.norm(state.points[which], axis=1)

    def is_significant(self, predicted: EulerState, used: int, points: int) -> bool:
        """Return False: as published, discs are gated by a length, so no probability is known."""
        return False


@dataclass(frozen=True, slots=True)
class ConstantDiscsFilter(_EulerFilter):
    """ekf1: stored discs are constants with the precision of their first sighting (Wittich 2017, 3.9.1-3.9.2)."""

    def update(
        self, state: EulerState, points: SpherePoints, may_start_landmark: NDArray[np.bool_] | None = None
    ) -> EulerState:
        """Correct angles and rates with the associated points, store new points, and delete unseen discs.

        `may_start_landmark` is a mask (n,) of the points that may be stored; None: all.
        """
        noise = _noise(points, self.settings)
        expected, dexpected_dangles = turned(state.angles, state.points)
        i, j = _associate(expected, points.position, self.settings.gate)
        H = np.zeros((3 * len(i), 6))
        H[:, :3] = dexpected_dangles[j].reshape(-1, 3)
        x = np.concatenate([state.angles, state.angle_rates])
        x, P = _correct(x, state.state_covariance, (points.position[i] - expected[j]).ravel(), H, noise[i])

        new = _new_disc_points(len(points), i, may_start_landmark)
        stored = np.concatenate([state.points[np.sort(j)], points.position[new] @ from_euler(x[:3])])
        return EulerState(state.stamp, x[:3], x[3:6], stored, P, np.sort(i), state.reference)


@dataclass(frozen=True, slots=True)
class StateDiscsFilter(_EulerFilter):
    """ekf2: stored discs are part of the state and improve with every sighting (Wittich 2017, section 3.9.3)."""

    def update(
        self, state: EulerState, points: SpherePoints, may_start_landmark: NDArray[np.bool_] | None = None
    ) -> EulerState:
        """Correct angles, rates and discs with the associated points, store new points, and delete unseen discs.

        A new point enters without correlation and without the attitude's variance, as published (eq. 170-171).
        """
        noise = _noise(points, self.settings)
        expected, dexpected_dangles = turned(state.angles, state.points)
        i, j = _associate(expected, points.position, self.settings.gate)
        n, m = len(i), len(expected)
        dexpected_dpoints = np.zeros((n, 3, m, 3))  # eq. 157-169
        dexpected_dpoints[np.arange(n), :, j] = from_euler(state.angles)
        H = np.zeros((n, 3, 6 + 3 * m))
        H[:, :, :3] = dexpected_dangles[j]
        H[:, :, 6:] = dexpected_dpoints.reshape(n, 3, 3 * m)
        x = np.concatenate([state.angles, state.angle_rates, state.points.ravel()])
        innovation = (points.position[i] - expected[j]).ravel()
        x, P = _correct(x, state.state_covariance, innovation, H.reshape(3 * n, 6 + 3 * m), noise[i])

        kept = np.sort(j)
        new = _new_disc_points(len(points), i, may_start_landmark)
        rows = np.concatenate([np.arange(6), (6 + 3 * kept[:, None] + np.arange(3)).ravel()])
        R = from_euler(x[:3])
        stored = np.concatenate([x[6:].reshape(-1, 3)[kept], points.position[new] @ R])
        P = _append_blocks(P[np.ix_(rows, rows)], R.T @ noise[new] @ R)
        return EulerState(state.stamp, x[:3], x[3:6], stored, P, np.sort(i), state.reference)


def turned(angles: Array, points: Array) -> tuple[Array, Array]:
    """Return places R p in `obj`, (n, 3) m, of points (n, 3) m in `ball`, and dplace_dangles, (n, 3, 3) (eq. 134-148).

    Small increments da turn the ball by the rotation vector E da, and move the place by E da x R p.
    """
    place = points @ from_euler(angles).T
    return place, -hat(place) @ euler_rate_matrix(angles)


def angular_velocity(angles: Array, angle_rates: Array) -> tuple[Array, Array, Array]:
    """Return w_obj = E @ angle_rates, (3,) rad/s, dw_dangles, (3, 3) 1/s, and dw_drates = E, (3, 3).

    The angles are omega, phi, kappa, (3,) rad, of R_obj_ball = Rx Ry Rz, so w_obj is along the axes of `obj`.
    """
    so, sp, _ = np.sin(angles)
    co, cp, _ = np.cos(angles)
    _, phi_rate, kappa_rate = angle_rates
    dw_dangles = np.array(
        [
            [0.0, cp * kappa_rate, 0.0],
            [-so * phi_rate - co * cp * kappa_rate, so * sp * kappa_rate, 0.0],
            [co * phi_rate - so * cp * kappa_rate, -co * sp * kappa_rate, 0.0],
        ]
    )
    E = euler_rate_matrix(angles)
    return E @ angle_rates, dw_dangles, E


def _noise(points: SpherePoints, settings: EulerSettings) -> Array:
    """Return the covariances of the points, (n, 3, 3) m², with an added radial variance.

    Rationale: Sigma_BB (eq. 120) of an exactly known ball has rank 2. With its inverse, the smallest radial mismatch
    would outweigh all residuals along the surface. An example is the sagitta between a predicted and a measured place.
    """
    n = points.direction
    return points.covariance + settings.radial_sigma**2 * n[:, :, None] * n[:, None, :]


def _associate(expected: Array, observed: Array, gate: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return indices of observed points, (k,), and of their stored points, (k,), nearer than `gate` m (eq. 149).

    Rationale: eq. 149 alone lets one point belong to two discs and two points to one. So the association takes the
    nearest pair first, and each point and each disc once.
    """
    distance = np.linalg.norm(observed[:, None] - expected[None], axis=2)
    candidates = np.argwhere(distance < gate)
    candidates = candidates[np.argsort(distance[candidates[:, 0], candidates[:, 1]], kind="stable")]
    pairs: dict[int, int] = {}
    taken: set[int] = set()
    for i, j in candidates.tolist():
        if i not in pairs and j not in taken:
            pairs[i] = j
            taken.add(j)
    return np.array(list(pairs), dtype=np.intp), np.array(list(pairs.values()), dtype=np.intp)


def _new_disc_points(n: int, i: NDArray[np.intp], may_start_landmark: NDArray[np.bool_] | None) -> NDArray[np.intp]:
    """Return the indices of the unassociated points that `may_start_landmark` (n,) allows as new discs (None: all)."""
    new = np.ones(n, dtype=bool) if may_start_landmark is None else may_start_landmark.copy()
    new[i] = False
    return np.flatnonzero(new)


def _correct(x: Array, P: Array, innovation: Array, H: Array, noise: Array) -> tuple[Array, Array]:
    """Return mean (u,) and covariance (u, u) after observations with blocks of noise (n, 3, 3) (eq. 62-64, 138)."""
    n = len(noise)
    if n == 0:
        return x, P
    blocks = np.zeros((n, 3, n, 3))
    blocks[np.arange(n), :, np.arange(n)] = noise
    R = blocks.reshape(3 * n, 3 * n)
    HP = H @ P
    K = _solve(HP @ H.T + R, HP).T
    A = np.eye(len(x)) - K @ H  # Joseph form: equals eq. 64 for this gain, and stays symmetric and positive
    return x + K @ innovation, A @ P @ A.T + K @ R @ K.T


def _solve(S: Array, b: Array) -> Array:
    """Return S^-1 b for a covariance S. If S is singular, the pseudo-inverse ignores the singular directions."""
    try:
        np.linalg.cholesky(S)  # refuses a singular matrix, which rounding may hide from `solve`
        return np.asarray(np.linalg.solve(S, b), dtype=float)
    except np.linalg.LinAlgError:
        return np.linalg.pinv(S, hermitian=True) @ b


def _append_blocks(P: Array, blocks: Array) -> Array:
    """Return P, (u, u), with uncorrelated blocks (n, 3, 3) appended on the diagonal."""
    u, n = len(P), len(blocks)
    extended = np.zeros((u + 3 * n, u + 3 * n))
    extended[:u, :u] = P
    for k in range(n):
        at = slice(u + 3 * k, u + 3 * k + 3)
        extended[at, at] = blocks[k]
    return extended
