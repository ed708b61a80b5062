"""Pose and velocity of a ball together, from one peak of the likelihood to the next: a Kalman filter.

The pose that is reported is the particles'. What this filter knows of the pose only tells how far a difference between
two pictures is motion, and how far the noise of both. The acceleration is constant from one frame to the next, then
another: discrete white noise (Bar-Shalom, Li, Kirubarajan 2001, section 6.3.2).
"""

from dataclasses import dataclass, replace

import numpy as np

from spheremouse.geometry.rotation import Array, exp, left_jacobian, log

_LASTS = 0.2  # s, that a hand's acceleration lasts: to and fro once a second, it is over half its height for a third
_STEPS = 10  # of so long at most: after two seconds nothing is known of a velocity any more
_PART = 0.5  # of the greatest acceleration: the standard deviation, half to all of it (ibid.)
# m/s, rad/s: of a ball at first sight, along each axis; a hand that goes to and fro at up to 0.4 m/s and 180 °/s has as
_SPEED = np.repeat([0.2, 1.0], 3)  # much in the mean
_FASTEST = np.repeat([3.0, 20.0], 3)  # m/s, rad/s: no hand moves faster
_REACHED = 36.0  # d² of six standard deviations: farther off is a sudden start, another ball, or another side of it


@dataclass(frozen=True, slots=True)
class Course:
    """Where a ball is and how it moves, in cam."""

    stamp: float  # s
    position: Array  # (3,) m
    rotation: Array  # (3, 3) R_cam_ball
    velocity: Array  # (6,) m/s, rad/s
    covariance: Array  # (12, 12) m, rad, m/s, rad/s: position + d, exp(theta) @ rotation, velocity


def begun(stamp: float, position: Array, rotation: Array, covariance: Array) -> Course:
    """The course of a ball of which only a pose is known, with its covariance, (6, 6)."""
    P = np.zeros((12, 12))
    P[:6, :6], P[6:, 6:] = covariance, np.diag(_SPEED**2)
    return Course(stamp, position, rotation, np.zeros(6), P)


def told(course: Course, velocity: Array, covariance: Array) -> Course:
    """The course of a ball whose velocity somebody knows, (6,), with its covariance, (6, 6)."""
    P = np.zeros((12, 12))
    P[:6, :6], P[6:, 6:] = course.covariance[:6, :6], covariance
    return replace(course, velocity=velocity, covariance=P)


def predicted(course: Course, stamp: float, acceleration: Array) -> Course:
    """The course later; `acceleration`, (6,) m/s² and rad/s²: the greatest there is, another in every 0.2 s."""
    number = _steps(stamp - course.stamp)
    dt = (stamp - course.stamp) / number
    gained = _gained(dt, acceleration)
    for _ in range(number):
        course = _moved(course, dt, gained)
    return replace(course, stamp=stamp)


def speed_covariance(course: Course, stamp: float, acceleration: Array) -> Array:
    """Covariance of the velocity at a later time, (6, 6)."""
    number = _steps(stamp - course.stamp)
    return course.covariance[6:, 6:] + number * np.diag(_gained((stamp - course.stamp) / number, acceleration))


def measured(
    course: Course, stamp: float, position: Array, rotation: Array, covariance: Array, acceleration: Array
) -> Course:
    """The course after a pose has been seen, with its covariance, (6, 6).

    From one that is too far off it begins anew: with the velocity that leads there, or, where no hand is as fast, rest.
    """
    before, dt = course, stamp - course.stamp
    if dt > _STEPS * _LASTS:
        return begun(stamp, position, rotation, covariance)
    course = predicted(course, stamp, acceleration)
    P, d = course.covariance, between(course.position, course.rotation, position, rotation)
    solved = np.linalg.solve(P[:6, :6] + covariance, np.column_stack([P[:6], d]))
    if d @ solved[:, 12] > _REACHED:
        new = begun(stamp, position, rotation, covariance)
        way = between(before.position, before.rotation, position, rotation)
        if np.any(np.abs(way) > _FASTEST * dt):
            return new
        P = np.kron([[1.0, 1.0 / dt], [1.0 / dt, 1.0 / dt**2]], covariance)
        P[6:, 6:] += before.covariance[:6, :6] / dt**2 + np.diag(_gained(dt, acceleration))
        return replace(new, velocity=way / dt, covariance=P)
    x = P[:, :6] @ solved[:, 12]
    P = P - P[:, :6] @ solved[:, :12]
    return Course(
        stamp, course.position + x[:3], exp(x[3:6]) @ course.rotation, course.velocity + x[6:], 0.5 * (P + P.T)
    )


def between(position: Array, rotation: Array, to_position: Array, to_rotation: Array) -> Array:
    """The way from one pose to another, (6,) m, rad: position + d, exp(theta) @ rotation, in cam."""
    return np.concatenate([to_position - position, log(to_rotation @ rotation.T)])


def _moved(course: Course, dt: float, gained: Array) -> Course:
    """The course after a step in which the acceleration stays as it is."""
    way = course.velocity * dt
    turn = exp(way[3:])
    F = np.eye(12)
    F[3:6, 3:6] = turn
    F[range(3), range(6, 9)] = dt
    F[3:6, 9:] = dt * left_jacobian(way[3:])
    P = F @ course.covariance @ F.T
    k = np.arange(6)
    P[k, k] += 0.25 * dt**2 * gained
    P[k, k + 6] += 0.5 * dt * gained
    P[k + 6, k] += 0.5 * dt * gained
    P[k + 6, k + 6] += gained
    return Course(course.stamp, course.position + way[:3], turn @ course.rotation, course.velocity, P)


def _steps(dt: float) -> int:
    return min(max(int(np.ceil(dt / _LASTS - 1e-9)), 1), _STEPS)


def _gained(dt: float, acceleration: Array) -> Array:
    """Variance of the velocity that comes with a step, (6,)."""
    return np.asarray((_PART * acceleration * min(dt, _LASTS)) ** 2)
