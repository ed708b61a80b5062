"""The six axes of a hand-held ball as people read them: x, y, z in metres, yaw, pitch and roll, each with its sigma.

The angles are omega, phi, kappa of `R_cam_ball` (docs/conventions), counted from a ball that stands upright, azimuth 0
towards the camera: pitch = omega - 90°, roll = phi, yaw = -90° - kappa. They are singular where the pole lies along
the camera's x axis; upright, and pointed at the camera or away from it, they are not.
"""

from dataclasses import dataclass

import numpy as np

from spheremouse.geometry.rotation import Array, euler_rate_matrix, from_euler, to_euler

_QUARTER = 0.5 * np.pi
_SINGULAR = 1e-6  # cosine of phi below which the angles say nothing
UPRIGHT = from_euler(np.array([_QUARTER, 0.0, -_QUARTER]))  # R_cam_ball with yaw, pitch and roll 0


@dataclass(frozen=True, slots=True)
class Axes:
    """Position and angles of a ball."""

    position: Array  # (3,) m, cam: right, down, away
    angles: Array  # (3,) rad: yaw about the pole, pitch towards the camera, roll to the right in the picture
    position_sigma: Array  # (3,) m
    angles_sigma: Array  # (3,) rad, no more than pi: then the angle is unknown


def axes_of(position: Array, rotation: Array, covariance: Array) -> Axes:
    """Axes of a pose T_cam_ball with its covariance, (6, 6), as `wand.track` gives it."""
    omega, phi, kappa = to_euler(rotation)
    angles = wrapped(np.array([-_QUARTER - kappa, omega - _QUARTER, phi]))
    if np.cos(phi) > _SINGULAR:
        J = np.linalg.inv(euler_rate_matrix(np.array([omega, phi, kappa])))
        variance = np.diag(J @ covariance[3:, 3:] @ J.T)[[2, 0, 1]]
        sigma = np.minimum(np.sqrt(np.maximum(variance, 0.0)), np.pi)
    else:
        sigma = np.full(3, np.pi)
    return Axes(position, angles, np.sqrt(np.maximum(np.diag(covariance)[:3], 0.0)), sigma)


def attitude(angles: Array) -> Array:
    """R_cam_ball, (3, 3), of yaw, pitch and roll, rad: the way back."""
    yaw, pitch, roll = angles
    return from_euler(np.array([pitch + _QUARTER, roll, -_QUARTER - yaw]))


def wrapped(angles: Array) -> Array:
    """Angles in (-pi, pi], rad."""
    return np.pi - (np.pi - angles) % (2.0 * np.pi)
