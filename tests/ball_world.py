"""A ball with discs before a far camera, seen as points in its picture."""

from dataclasses import replace

import numpy as np
from conftest import directions

from spheremouse.ball.detect.detections import Detections
from spheremouse.ball.rig import NO_TARGETS, Ball, Rig
from spheremouse.geometry.camera import InteriorOrientation, Pose, project
from spheremouse.geometry.rotation import exp
from spheremouse.output.counts import MotionSettings

CAMERA = InteriorOrientation(640, 480, 640.0, 640.0, 320.0, 240.0)
POSE = Pose(np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]), np.array([0.0, 0.0, 2.35]))
RIG = Rig(CAMERA, Ball(0.6), NO_TARGETS, 0.02)
MATRIX = MotionSettings().matrix(RIG.radius_m)  # counts per radian
DISCS = directions(26, 0)
DT = 1.0 / 30.0
SIGMA = 0.05  # px


def other(rig, pose, error):
    """Rig and pose that differ by an error, (10,), of pose and ball."""
    ball = replace(rig.ball, centre=rig.ball.centre + error[6:9], radius=rig.ball.radius + error[9])
    moved = replace(pose, position=pose.position + error[:3], rotation=exp(error[3:6]) @ pose.rotation)
    return replace(rig, ball=ball), moved


def image_of(d, rig, pose):
    """Pixels, (n, 2), of directions d, (n, 3), in obj."""
    return project(pose.to_cam(rig.ball.centre + rig.ball.radius * d), rig.camera)[0]


def in_view(R, discs=DISCS):
    """Directions, (n, 3) in obj, of the discs well on the near side at attitude R."""
    p = discs @ R.T
    return p[p[:, 2] > 0.35]


def pixels(directions, shift=(0.0, 0.0, 0.0)):
    return project(POSE.to_cam(np.asarray(shift) + RIG.ball.radius * directions), CAMERA)[0]


def detected(uv, rng, sigma=SIGMA):
    """Detections of pixels (n, 2), with noise; without `rng` they are exact."""
    if rng is not None:
        uv = uv + sigma * rng.normal(size=uv.shape)
    return Detections(uv, np.tile(sigma**2 * np.eye(2), (len(uv), 1, 1)), np.full(len(uv), 50.0))


def photo(R, rng, discs=DISCS, extra=None):
    """Detections of the discs in view at attitude R, and of `extra` pixels, (n, 2)."""
    uv = pixels(in_view(R, discs))
    return detected(uv if extra is None else np.concatenate([uv, extra]), rng)
