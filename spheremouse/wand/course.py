"""Pose and velocity of a ball together, from one peak of the likelihood to the next: a Kalman filter.

The pose that is reported is the particles'. What this filter knows of the pose only tells how far a difference between
two pictures is motion, and how far the noise of both. The acceleration is constant from one frame to the next, then
another: discrete white noise (Bar-Shalom, Li, Kirubarajan 2001, section 6.3.2).
"""

from dataclasses import dataclass, replace

import numpy as np

from spheremouse.rotation import Array, exp, left_jacobian, log

_LASTS = 0.2  # s, that a hand's acceleration lasts: to and fro once a second, it is over half its height for a third
_PART = 0.5  # of the greatest acceleration: the standard deviation, half to all of it (ibid.)
# m/s, rad/s: of a ball at first sight, along each axis; a hand that goes to and fro at up to 0.4 m/s and 180 °/s has as
_SPEED = np.repeat([0.2, 1.0], 3)  # much in the mean
_REACHED = 36.0  # d² of six standard deviations: farther off is another ball, or another side of it


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
    """The course later; `acceleration`, (6,) m/s² and rad/s²: the greatest there is."""
    dt = stamp - course.stamp
    way = course.velocity * dt
    turn = exp(way[3:])
    F = np.eye(12)
    F[3:6, 3:6] = turn
    F[range(3), range(6, 9)] = dt
    F[3:6, 9:] = dt * left_jacobian(way[3:])
    P = F @ course.covariance @ F.T
    gained, k = _gained(dt, acceleration), np.arange(6)
    P[k, k] += 0.25 * dt**2 * gained
    P[k, k + 6] += 0.5 * dt * gained
    P[k + 6, k] += 0.5 * dt * gained
    P[k + 6, k + 6] += gained
    return Course(stamp, course.position + way[:3], turn @ course.rotation, course.velocity, P)


def speed_covariance(course: Course, stamp: float, acceleration: Array) -> Array:
    """Covariance of the velocity at a later time, (6, 6)."""
    return course.covariance[6:, 6:] + np.diag(_gained(stamp - course.stamp, acceleration))


def measured(course: Course, position: Array, rotation: Array, covariance: Array) -> Course:
    """A course as predicted, after a pose has been seen, with its covariance, (6, 6): anew from one too far off."""
    P = course.covariance
    d = np.concatenate([position - course.position, log(rotation @ course.rotation.T)])
    solved = np.linalg.solve(P[:6, :6] + covariance, np.column_stack([P[:6], d]))
    if d @ solved[:, 12] > _REACHED:
        return begun(course.stamp, position, rotation, covariance)
    x = P[:, :6] @ solved[:, 12]
    P = P - P[:, :6] @ solved[:, :12]
    return Course(
        course.stamp, course.position + x[:3], exp(x[3:6]) @ course.rotation, course.velocity + x[6:], 0.5 * (P + P.T)
    )


def _gained(dt: float, acceleration: Array) -> Array:
    """Variance of the velocity that comes with a frame, (6,)."""
    return np.asarray((_PART * acceleration * min(dt, _LASTS)) ** 2)
