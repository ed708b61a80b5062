"""A rolled ball and the targets in the axes of `obj`, with their joint covariances."""

from dataclasses import replace

import numpy as np

from spheremouse.ball.device import Device
from spheremouse.ball.rig import Ball, Targets
from spheremouse.calibrate.rolling.axes import Axes
from spheremouse.calibrate.rolling.problem import RollingAdjustment
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array, hat


def with_direction(axes: Axes, rolled: RollingAdjustment) -> Axes:
    """Return the axes with the covariance of the direction added."""
    C = _joint(rolled, axes)
    distance_sigma = 0.0 if axes.distance is None else axes.distance * float(np.sqrt(C[3, 3]))
    return replace(axes, covariance=C[:3, :3], distance_sigma=distance_sigma)


def _joint(rolled: RollingAdjustment, axes: Axes) -> Array:
    """Covariance of axes, log distance, direction and ratio, (8, 8); all share the error of the lens."""
    C = np.zeros((8, 8))
    if axes.parts is None:
        C[:3, :3], C[4:, 4:] = axes.covariance, rolled.covariance
        return C
    by_place = np.eye(8, 4, -4)  # of direction and ratio
    by_place[:4, :3] = axes.parts.by_direction
    lens = by_place @ rolled.by_lens
    lens[:4] += axes.parts.by_lens
    C[:4, :4] = axes.parts.own
    return C + by_place @ (rolled.covariance - rolled.by_lens @ rolled.by_lens.T) @ by_place.T + lens @ lens.T


def place_camera(
    rolled: RollingAdjustment, axes: Axes, radius: float | None = None, radius_sigma: float = 0.0
) -> tuple[Pose, Ball]:
    """Return the camera in `obj` and the ball, with their joint covariance.

    `radius`, m, is a known one; without it, the axes' distance gives the radius, and the camera's place is independent
    of the ratio.
    """
    rolling = rolled.rolling
    R, c = axes.rotation, rolling.direction
    by_distance = radius is None
    if radius is None:
        assert axes.distance is not None
        radius = axes.distance / rolling.ratio
    P = -radius * rolling.ratio * (R @ c)
    by = np.zeros((7, 9))  # pose and radius, of: axes, log distance, direction and ratio, radius
    by[:3, :3], by[3:6, :3] = -hat(P), np.eye(3)
    by[:3, 4:7] = -radius * rolling.ratio * R
    if by_distance:
        by[:3, 3] = P
        by[6, 3], by[6, 7] = radius, -radius / rolling.ratio
    else:
        by[:3, 7] = P / rolling.ratio
        by[:3, 8], by[6, 8] = P / radius, 1.0
    C = np.zeros((9, 9))
    C[:8, :8], C[8, 8] = _joint(rolled, axes), radius_sigma**2
    C = by @ C @ by.T
    C = 0.5 * (C + C.T)
    with_ball = np.zeros((6, 4))
    with_ball[:, 3] = C[:6, 6]
    return Pose(R, P, C[:6, :6], with_ball), Ball(radius, covariance=np.diag([0.0, 0.0, 0.0, C[6, 6]]))


def target_ball_covariance(axes: Axes, radius: float) -> Array:
    """Return the covariance of known targets with the ball's centre and radius, (3n, 4) m²."""
    assert axes.parts is not None
    cross = np.zeros((len(axes.parts.with_targets), 4))
    cross[:, 3] = radius * axes.parts.with_targets[:, 3]
    return cross


def rescale_targets(targets: Targets, free: Ball, ball: Ball) -> tuple[Targets, Array]:
    """Convert targets of a free scale, in which the ball is `free`, to metres, with their covariance with the ball.

    The correlation of ratio and targets is neglected, so the covariance is a little too large.
    """
    unit = ball.radius / free.radius
    by_length, by_free = ball.covariance[3, 3] / ball.radius**2, free.covariance[3, 3] / free.radius**2
    X = unit * targets.position
    x = X.ravel()
    C = unit**2 * targets.covariance + (by_length + by_free) * np.outer(x, x)
    cross = np.zeros((len(x), 4))
    cross[:, 3] = by_length * ball.radius * x
    return replace(targets, position=X, covariance=C, radii=unit * targets.radii), cross


def place_targets(
    axes: Axes, device: Device, rolled: RollingAdjustment, radius: float, radius_sigma: float
) -> tuple[Targets, Array]:
    """Return targets measured in cam, in `obj`, and their covariance with the ball's centre and radius, (3n, 4)."""
    assert axes.targets_cam is not None
    assert axes.targets_cam_covariance is not None
    c, ratio, R = rolled.rolling.direction, rolled.rolling.ratio, axes.rotation
    X = (axes.targets_cam - radius * ratio * c) @ R.T
    n = len(X)
    by = np.zeros((3 * n, 3 * n + 3 + 5))
    for k in range(n):
        rows = slice(3 * k, 3 * k + 3)
        by[rows, rows] = R
        by[rows, 3 * n : 3 * n + 3] = -hat(X[k])
        by[rows, 3 * n + 3 : 3 * n + 6] = -radius * ratio * R
        by[rows, 3 * n + 6] = -radius * (R @ c)
        by[rows, 3 * n + 7] = -ratio * (R @ c)
    C = np.zeros((3 * n + 8, 3 * n + 8))
    C[: 3 * n + 3, : 3 * n + 3] = axes.targets_cam_covariance
    C[3 * n + 3 : 3 * n + 7, 3 * n + 3 : 3 * n + 7] = rolled.covariance
    if axes.targets_cam_by_lens is not None:
        alike = axes.targets_cam_by_lens @ rolled.by_lens.T
        C[: 3 * n + 3, 3 * n + 3 : 3 * n + 7], C[3 * n + 3 : 3 * n + 7, : 3 * n + 3] = alike, alike.T
    C[-1, -1] = radius_sigma**2
    cross = np.zeros((3 * n, 4))
    cross[:, 3] = by[:, -1] * radius_sigma**2
    number: dict[str, int] = dict(zip(device.codes, device.ids, strict=True))
    ids = tuple(number[code] for code in axes.codes)
    return Targets(ids, axes.codes, X, by @ C @ by.T, np.asarray(device.target_radii, dtype=float)), cross
