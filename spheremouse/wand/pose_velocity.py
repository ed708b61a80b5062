"""Kalman filter of a ball's pose and velocity, with the likelihood's peaks as measurements.

The acceleration is constant between two frames, then takes another value: discrete white noise (Bar-Shalom, Li,
Kirubarajan 2001, section 6.3.2). The tracker reports the pose of the particles. This filter separates motion from
measurement noise in the difference between two frames.
"""

from dataclasses import dataclass, replace

import numpy as np

from spheremouse.geometry.rotation import Array, exp, left_jacobian, log

# s, correlation time of a hand's acceleration: in a movement to and fro at 1 Hz it exceeds half its peak for a third
_ACCELERATION_TIME = 0.2
_MAX_STEPS = 10  # of that length: after 2 s a velocity carries no information
_SIGMA_OF_MAX = 0.5  # standard deviation over the greatest acceleration: half to all of it (ibid.)
# m/s, rad/s for each axis, of a new ball: the mean of a hand that moves to and fro at 0.4 m/s and 180 °/s
_INITIAL_VELOCITY_SIGMA = np.repeat([0.2, 1.0], 3)
MAX_HAND_VELOCITY = np.repeat([3.0, 20.0], 3)  # m/s, rad/s: no hand is faster
GATE = 36.0  # d² of six standard deviations: beyond it lies a sudden start, another ball, or another side of the ball


@dataclass(frozen=True, slots=True)
class PoseVelocityState:
    """Pose and velocity of a ball in `cam`, with their covariance."""

    stamp: float  # s
    position: Array  # (3,) m
    rotation: Array  # (3, 3) R_cam_ball
    velocity: Array  # (6,) m/s, rad/s
    covariance: Array  # (12, 12) m, rad, m/s, rad/s: position + d, exp(theta) @ rotation, velocity


def initialise(stamp: float, position: Array, rotation: Array, covariance: Array) -> PoseVelocityState:
    """Return the state after one pose: at rest, with the velocity of a hand as uncertainty.

    The pose at `stamp` (s) is (3,) m in cam and R_cam_ball (3, 3), with covariance (6, 6) m, rad.
    """
    P = np.zeros((12, 12))
    P[:6, :6], P[6:, 6:] = covariance, np.diag(_INITIAL_VELOCITY_SIGMA**2)
    return PoseVelocityState(stamp, position, rotation, np.zeros(6), P)


def predict(state: PoseVelocityState, stamp: float, acceleration: Array) -> PoseVelocityState:
    """Predict the state at `stamp`. `acceleration` (6,) m/s², rad/s² is the greatest one of a hand."""
    number = _step_count(stamp - state.stamp)
    dt = (stamp - state.stamp) / number
    variance = _velocity_variance(dt, acceleration)
    for _ in range(number):
        state = _predict_step(state, dt, variance)
    return replace(state, stamp=stamp)


def predicted_velocity_covariance(state: PoseVelocityState, stamp: float, acceleration: Array) -> Array:
    """Return the covariance of the velocity at `stamp`, (6, 6)."""
    number = _step_count(stamp - state.stamp)
    return state.covariance[6:, 6:] + number * np.diag(_velocity_variance((stamp - state.stamp) / number, acceleration))


def update(
    state: PoseVelocityState, stamp: float, position: Array, rotation: Array, covariance: Array, acceleration: Array
) -> PoseVelocityState:
    """Return the state after a measured pose, as in `initialise`; `acceleration` (6,) as in `predict`.

    A pose more than six standard deviations off restarts the filter with the velocity that leads to the pose. If no
    hand is that fast, it restarts at rest.
    """
    before, dt = state, stamp - state.stamp
    if dt > _MAX_STEPS * _ACCELERATION_TIME:
        return initialise(stamp, position, rotation, covariance)
    state = predict(state, stamp, acceleration)
    P, d = state.covariance, pose_difference(state.position, state.rotation, position, rotation)
    solved = np.linalg.solve(P[:6, :6] + covariance, np.column_stack([P[:6], d]))
    if d @ solved[:, 12] > GATE:
        new = initialise(stamp, position, rotation, covariance)
        motion = pose_difference(before.position, before.rotation, position, rotation)
        if np.any(np.abs(motion) > MAX_HAND_VELOCITY * dt):
            return new
        P = np.kron([[1.0, 1.0 / dt], [1.0 / dt, 1.0 / dt**2]], covariance)
        P[6:, 6:] += before.covariance[:6, :6] / dt**2 + np.diag(_velocity_variance(dt, acceleration))
        return replace(new, velocity=motion / dt, covariance=P)
    x = P[:, :6] @ solved[:, 12]
    P = P - P[:, :6] @ solved[:, :12]
    return PoseVelocityState(
        stamp, state.position + x[:3], exp(x[3:6]) @ state.rotation, state.velocity + x[6:], 0.5 * (P + P.T)
    )


def pose_difference(position: Array, rotation: Array, to_position: Array, to_rotation: Array) -> Array:
    """Return the difference of two poses, (6,) m and rad in `cam`: position + d, exp(theta) @ rotation.

    Positions are (3,) m, rotations R_cam_ball (3, 3).
    """
    return np.concatenate([to_position - position, log(to_rotation @ rotation.T)])


def _predict_step(state: PoseVelocityState, dt: float, variance: Array) -> PoseVelocityState:
    motion = state.velocity * dt
    R = exp(motion[3:])
    F = np.eye(12)
    F[3:6, 3:6] = R
    F[range(3), range(6, 9)] = dt
    F[3:6, 9:] = dt * left_jacobian(motion[3:])
    P = F @ state.covariance @ F.T
    k = np.arange(6)
    P[k, k] += 0.25 * dt**2 * variance
    P[k, k + 6] += 0.5 * dt * variance
    P[k + 6, k] += 0.5 * dt * variance
    P[k + 6, k + 6] += variance
    return PoseVelocityState(state.stamp, state.position + motion[:3], R @ state.rotation, state.velocity, P)


def _step_count(dt: float) -> int:
    return min(max(int(np.ceil(dt / _ACCELERATION_TIME - 1e-9)), 1), _MAX_STEPS)


def _velocity_variance(dt: float, acceleration: Array) -> Array:
    """Return the variance that one step adds to the velocity, (6,)."""
    return np.asarray((_SIGMA_OF_MAX * acceleration * min(dt, _ACCELERATION_TIME)) ** 2)
