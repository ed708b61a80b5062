"""Calibrations without photos: image points of a device with normal errors, and the truth, to test covariances by.

The device of Wittich 2017, tables 1 and 11 (targets at the corners of a frame, a ball of 0.6 m behind it) and six
cameras in front of it; camera file, tape and image points are off by what their covariances say.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.device import Axes, Device, Distance
from spheremouse.calibrate.device.adjust import DeviceCalibration, DiscViews, adjust_bundle, shift_to_ball
from spheremouse.calibrate.device.bundle import Block, ImagePoints, Problem, predicted
from spheremouse.calibrate.device.start import TargetViews
from spheremouse.geometry.camera import InteriorOrientation, Pose
from spheremouse.geometry.rotation import Array, exp, log
from spheremouse.simulate.ball.scene import spread_directions

_TARGETS = np.array(
    [[-0.3244, 0.1546, 0.5629], [-0.3244, -0.5954, 0.5629], [0.3256, -0.5954, 0.5629], [0.3256, 0.1546, 0.5629]]
)
_RADIUS, _DISCS, _DISC = 0.6, 50, 0.02
_CAMERA = InteriorOrientation(1920, 1080, 1404.0, 1404.0, 967.0, 540.0, np.array([-0.49, 0.3, -1e-4, -1e-4, -0.11]))
_INTERIOR_SIGMA = np.array([0.3, 0.3, 0.3, 0.3, 1e-3, 4e-3, 5e-5, 5e-5, 5e-3])  # as fifteen photos of a board leave it
_SIGMA, _TAPE = 0.05, 0.001  # px of an image point, m
_STATIONS = ((0, 5), (-40, 10), (40, 0), (-15, 35), (20, -10), (30, 30))  # degrees to the right and up, of cameras
_PAIRS = ((1, 2), (1, 4), (2, 3), (3, 4))  # of targets with a tape distance
_MIN_COSINE = 0.35  # cosine at which a disc is still seen


@dataclass(frozen=True, slots=True)
class SimulatedCalibration:
    """Observations, initial values and truth, in `obj`."""

    device: Device
    camera: InteriorOrientation  # as calibrated
    views: TargetViews
    discs: DiscViews
    start: Block
    poses: tuple[Pose, ...]
    targets: Array  # (4, 3) m
    radius: float  # m


def simulated_calibration(
    rng: np.random.Generator,
    scale_free: bool = False,
    interior: bool = True,
    *,
    stations: tuple[tuple[float, float], ...] = _STATIONS,
    pairs: tuple[tuple[int, int], ...] = _PAIRS,
    tape: float = _TAPE,
    bulge: float = 0.0,
) -> SimulatedCalibration:
    """One of them; without `interior` the camera file is exact and says so.

    Cameras stand at `stations`. Targets have distances in `pairs`, with a sigma of `tape` m; discs are `bulge` m off.
    """
    distances = tuple(
        Distance(a, b, float(np.linalg.norm(_TARGETS[a - 1] - _TARGETS[b - 1]) + tape * rng.standard_normal()), tape)
        for a, b in (() if scale_free else pairs)
    )
    radii = np.array([0.012, 0.024, 0.036])
    device = Device((1, 2, 3, 4), ("MCY", "CYM", "YMC", "CMY"), radii, _DISC, Axes(2, 1, 3), distances)
    directions = spread_directions(_DISCS, 3.0 * _DISC / _RADIUS, rng)
    poses = tuple(_looking(rng, *np.radians(station)) for station in stations)
    photo, point = _in_view(poses, directions)
    shift = -_TARGETS[1]  # from the ball's centre to the frame of the targets
    off = bulge * rng.standard_normal((_DISCS, 1)) if bulge else 0.0
    points = np.concatenate([_TARGETS, (_RADIUS + off) * directions]) + shift
    true = Block(_CAMERA, tuple(Pose(p.rotation, p.position + shift) for p in poses), points)
    covariance = np.tile(_SIGMA**2 * np.eye(2), (len(photo), 1, 1))
    image = ImagePoints(photo, point, np.zeros((len(photo), 2)), covariance)
    problem = Problem(device, _CAMERA, image, scale_free)
    exact, _, _, cam = predicted(true, image, problem)
    depth = cam[:, 2:] * (1.0, 0.02)
    centre = exact + _SIGMA * rng.standard_normal(exact.shape)
    camera = _camera_file(rng) if interior else _CAMERA
    is_target = point < 4
    seen, number = np.unique(point[~is_target], return_inverse=True)
    rough = points[seen] + 1e-3 * rng.standard_normal((len(seen), 3))
    start = tuple(
        Pose(exp(1e-3 * rng.standard_normal(3)) @ p.rotation, p.position + 2e-3 * rng.standard_normal(3))
        for p in true.poses
    )
    return SimulatedCalibration(
        device, camera,
        TargetViews(
            tuple(range(len(poses))),
            ImagePoints(photo[is_target], point[is_target], centre[is_target], covariance[is_target]), depth[is_target],
            ()
        ),
        DiscViews(ImagePoints(photo[~is_target], number, centre[~is_target], covariance[~is_target]), rough),
        Block(camera, start, points[:4].copy()), poses, _TARGETS, _RADIUS
    )  # fmt: skip


def calibrated(simulated: SimulatedCalibration) -> DeviceCalibration:
    s = simulated
    return shift_to_ball(adjust_bundle(s.views, s.discs, s.start, s.device, s.camera), s.views, s.device)


def normalised_errors(simulated: SimulatedCalibration, found: DeviceCalibration) -> dict[str, float]:
    """Squared errors over covariances, each over its degrees of freedom: `ball`, `targets`, `pose` (of all photos).

    Where the scale is free, the ball is its centre from the first target of the axes, in radii.
    """
    unit = simulated.radius if found.scale_free else 1.0
    off = (found.targets - simulated.targets / unit).ravel()
    # the origin's target has three coordinates, the axis' one more, the plane's two more, the fourth three: the others
    # are those of the origin again
    free = np.array([3, 4, 5, 1, 6, 7, 9, 10, 11])
    ball, error = [3, 4, 5], off[3:6]
    if not found.scale_free:
        ball = [*ball, found.block("radius").start]
        error = np.append(error, found.radius - simulated.radius)
    poses = [
        _nees(np.concatenate([p.position - t.position / unit, log(p.rotation @ t.rotation.T)]), p.covariance)
        for p, t in zip(found.poses, simulated.poses, strict=True)
    ]
    return {
        "ball": _nees(error, found.covariance[np.ix_(ball, ball)]),
        "targets": _nees(off[free], found.covariance[np.ix_(free, free)]),
        "poses": float(np.mean(poses)),
    }


def _nees(error: Array, covariance: Array) -> float:
    return float(error @ np.linalg.solve(covariance, error)) / len(error)


def _looking(rng: np.random.Generator, azimuth: float, height: float) -> Pose:
    """A camera that looks at the ball, about."""
    away = np.array([np.sin(azimuth) * np.cos(height), np.sin(height), np.cos(azimuth) * np.cos(height)])
    position = rng.uniform(2.0, 3.0) * away
    z = 0.05 * rng.standard_normal(3) - position
    z /= np.linalg.norm(z)
    x = np.cross(z, [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    return Pose(np.stack([x, np.cross(z, x), z], axis=1), position)


def _in_view(poses: tuple[Pose, ...], directions: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return which photo shows which point: all targets, and the discs that face the camera in two photos."""
    away = np.array([p.position for p in poses])[:, None] - _RADIUS * directions
    cosine = np.sum(away * directions, axis=2) / np.linalg.norm(away, axis=2)
    sees = cosine > _MIN_COSINE
    sees &= np.sum(sees, axis=0) >= 2
    photo, disc = np.nonzero(sees)
    n = len(poses)
    return (np.concatenate([np.repeat(np.arange(n), 4), photo]), np.concatenate([np.tile(np.arange(4), n), 4 + disc]))


def _camera_file(rng: np.random.Generator) -> InteriorOrientation:
    e = _INTERIOR_SIGMA * rng.standard_normal(9)
    c = _CAMERA
    return replace(
        c, fx=c.fx + e[0], fy=c.fy + e[1], cx=c.cx + e[2], cy=c.cy + e[3], distortion=c.distortion + e[4:],
        covariance=np.diag(_INTERIOR_SIGMA**2)
    )  # fmt: skip
