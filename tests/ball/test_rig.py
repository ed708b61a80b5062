"""The rig: what another unit of length changes, and what it does not."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose

from spheremouse.ball.detect.detections import Detections
from spheremouse.ball.points import directions_at, intersect
from spheremouse.ball.pose import predict_targets
from spheremouse.ball.rig import Ball, Rig, Targets, considered_covariance, in_metres
from spheremouse.geometry.camera import InteriorOrientation, Pose

CAMERA = InteriorOrientation(640, 480, 640.0, 640.0, 320.0, 240.0)
UNIT = 0.55  # m


def covariance(n, seed):
    A = np.random.default_rng(seed).normal(size=(n, n))
    return 1e-6 * A @ A.T


def in_radii():
    """A rig in radii of its ball, with something in every field that has a length."""
    whole = covariance(10, 1)
    position = np.array([[-0.6, 0.3, 0.9], [-0.6, -1.0, 0.9], [0.6, -1.0, 0.9]])
    joint = covariance(13, 2)
    return Rig(
        CAMERA,
        Ball(1.0, np.array([0.01, 0.0, -0.01]), whole[6:, 6:]),
        Targets((1, 2, 3), ("CMY", "MYC", "YCM"), position, joint[:9, :9], np.array([0.02, 0.04, 0.06])),
        0.03,
        pose=Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.1, 0.2, 4.0]), whole[:6, :6], whole[:6, 6:]),
        cross_covariance=joint[:9, 9:],
        scale_free=True,
    )


def test_metres_change_what_is_seen_by_nothing_and_what_is_known_by_their_unit():
    free = in_radii()
    metric = in_metres(free, UNIT)
    assert not metric.scale_free
    assert_allclose(predict_targets(metric.pose, metric), predict_targets(free.pose, free), atol=1e-9)
    uv = np.array([[320.0, 240.0], [250.0, 300.0], [400.0, 200.0]])
    assert_allclose(directions_at(uv, metric, metric.pose)[0], directions_at(uv, free, free.pose)[0], atol=1e-12)
    seen = Detections(uv, np.tile(0.01 * np.eye(2), (3, 1, 1)), np.full(3, 50.0))
    a, b = (intersect(seen, r, r.pose) for r in (free, metric))
    assert_allclose(b.position, UNIT * a.position, atol=1e-12)
    assert_allclose(b.covariance, UNIT**2 * a.covariance, rtol=1e-9)
    joint, other = (np.block([[r.targets.covariance, r.cross_covariance]]) for r in (free, metric))
    assert_allclose(other, UNIT**2 * joint)
    assert_allclose(metric.disc_angle, free.disc_angle)
    assert in_metres(replace(free, disc_radius=None), UNIT).disc_radius is None


def test_what_is_considered_is_pose_and_ball_with_what_they_share():
    rig = in_radii()
    assert_allclose(considered_covariance(rig.pose, rig.ball), covariance(10, 1))
    alone = replace(rig.pose, ball_covariance=np.zeros((6, 4)))
    assert_allclose(considered_covariance(alone, rig.ball)[:6, 6:], 0.0)
