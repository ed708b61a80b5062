"""Six axes of a hand-held ball: x, y, z in metres, yaw, pitch and roll, each with its standard deviation.

The angles are omega, phi, kappa of `R_cam_ball` (docs/conventions), relative to an upright ball with azimuth 0 towards
the camera: pitch = omega - 90°, roll = phi, yaw = -90° - kappa. They are singular if the pole points along the camera's
x axis, and regular for an upright ball and one that points at the camera or away from it.
"""

from dataclasses import dataclass

import numpy as np

from spheremouse.geometry.rotation import Array, euler_rate_matrix, from_euler, to_euler
from spheremouse.tracker import Estimate

_QUARTER_TURN_RAD = 0.5 * np.pi
_MIN_COS_PHI = 1e-6  # below, the angles are undefined
UPRIGHT = from_euler(np.array([_QUARTER_TURN_RAD, 0.0, -_QUARTER_TURN_RAD]))  # R_cam_ball with yaw, pitch and roll 0


@dataclass(frozen=True, slots=True)
class Axes:
    """Position and angles of a ball."""

    position: Array  # (3,) m, cam: right, down, away
    angles: Array  # (3,) rad: yaw about the pole, pitch towards the camera, roll to the right in the picture
    position_sigma: Array  # (3,) m
    angles_sigma: Array  # (3,) rad, at most pi, which is that of an unknown angle


def axes_of(position: Array, rotation: Array, covariance: Array) -> Axes:
    """Return the axes of a pose, (3,) m in cam and R_cam_ball (3, 3), with covariance (6, 6) m, rad of `WandPose`."""
    omega, phi, kappa = to_euler(rotation)
    angles = wrap(np.array([-_QUARTER_TURN_RAD - kappa, omega - _QUARTER_TURN_RAD, phi]))
    if np.cos(phi) > _MIN_COS_PHI:
        J = np.linalg.inv(euler_rate_matrix(np.array([omega, phi, kappa])))
        variance = np.diag(J @ covariance[3:, 3:] @ J.T)[[2, 0, 1]]
        sigma = np.minimum(np.sqrt(np.maximum(variance, 0.0)), np.pi)
    else:
        sigma = np.full(3, np.pi)
    return Axes(position, angles, np.sqrt(np.maximum(np.diag(covariance)[:3], 0.0)), sigma)


def estimated_axes(estimate: Estimate) -> Axes:
    covariance = np.roll(estimate.covariance[:6, :6], (3, 3), axis=(0, 1))  # the rotation first in an estimate
    return axes_of(estimate.position, estimate.rotation, covariance)


def attitude(angles: Array) -> Array:
    """Return R_cam_ball, (3, 3), from yaw, pitch and roll, (3,) rad."""
    yaw, pitch, roll = angles
    return from_euler(np.array([pitch + _QUARTER_TURN_RAD, roll, -_QUARTER_TURN_RAD - yaw]))


def wrap(angles: Array) -> Array:
    """Wrap angles to (-pi, pi], rad."""
    return np.pi - (np.pi - angles) % (2.0 * np.pi)
