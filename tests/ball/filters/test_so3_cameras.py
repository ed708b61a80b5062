"""Several cameras of one ball: each has errors of its own, and one filter has all of them."""

from dataclasses import replace

import numpy as np
import pytest
from ball_world import CAMERA, detected, image_of, other
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import block_diag
from scipy.stats import chi2
from so3_world import DISCS, DT, FILTER, OWN, RADIUS, draw, own_motion, points_at, seen, settled, squared, with_errors

from spheremouse.ball.filters.so3 import So3Filter
from spheremouse.ball.filters.so3_map import to_map, with_map
from spheremouse.ball.filters.so3_motion import CAMERA_DIM, READOUT, RIG_ROW
from spheremouse.ball.filters.so3_rig import Station
from spheremouse.ball.filters.so3_state import COMMON
from spheremouse.ball.points import intersect
from spheremouse.ball.rig import NO_TARGETS, Ball, Rig
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import exp, log

PIXEL = 0.07  # px, noise of a centre
ASIDE = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # a quarter of a turn about Y
POSE_SIGMA = np.array([5e-4, 5e-4, 1e-3, 5e-4, 5e-4, 5e-4])  # m, rad
BALL_SIGMA = np.array([5e-4, 5e-4, 5e-4, 2e-4])  # m


def station(aside):
    """Rig, pose and filter of a camera in front of the ball, or at its side."""
    front = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.9]), np.diag(POSE_SIGMA**2))
    turn = ASIDE if aside else np.eye(3)
    pose = replace(front, rotation=turn @ front.rotation, position=turn @ front.position)
    rig = Rig(CAMERA, Ball(RADIUS, np.zeros(3), np.diag(BALL_SIGMA**2)), NO_TARGETS, 0.02)
    towards, horizon = pose.position / 1.9, RADIUS / 1.9
    considered = block_diag(pose.covariance, rig.ball.covariance)
    return rig, pose, So3Filter(OWN.settings, Station(towards, horizon, RADIUS, considered), 0.02 / RADIUS)


STATIONS = station(aside=False), station(aside=True)


def frame(which, R, errors, rng):
    """Points of a frame, as the rig of a camera sees them that is off by errors, (10,), of pose and ball."""
    rig, pose, filter_ = STATIONS[which]
    place = DISCS @ R.T
    place = place[place @ filter_.station.towards > filter_.station.horizon + 0.2]
    return intersect(detected(image_of(place, *other(rig, pose, errors)), rng, PIXEL), rig, pose)


def both():
    """The state of the camera in front, before the first frame, with the one at the side."""
    return STATIONS[0][2].initial(0.0, np.eye(3)).with_camera(prior(*(filter_ for _, _, filter_ in STATIONS)))


def prior(front, side):
    """(16, 16), of the errors of both cameras before any frame."""
    shared = front.station.shared_covariance(side.station)
    return np.block([[front.station.covariance(), shared], [shared.T, side.station.covariance()]])


def play(cameras, errors, rng, frames=60):
    """Squared deviations, (n,), of the attitude, and traces of its covariance, of a run with frames in turn."""
    state = both() if len(cameras) > 1 else STATIONS[cameras[0]][2].initial(0.0, np.eye(3))
    squares, traces, at = [], [], 0
    for k, (R, _, _) in enumerate(own_motion(rng, frames)):
        which = cameras[k % len(cameras)]
        state, at = (state if which == at or len(cameras) == 1 else state.facing(0)), which
        filter_ = STATIONS[which][2]
        state = filter_.update(filter_.predict(state, k * DT), frame(which, R, errors[which], rng))
        if k >= 20:
            squares.append(squared(log(R @ state.attitude.T), state.covariance[:3, :3]))
            traces.append(np.trace(state.covariance[:3, :3]))
    return np.mean(squares), np.mean(traces)


@pytest.mark.slow
def test_the_errors_of_two_cameras_are_in_the_covariance():
    """60 drawn poses of each camera, and one ball: chi-square of the attitude, 95 % band of the runs' mean."""
    rng = np.random.default_rng(51)
    poses, balls = draw(np.diag(np.tile(POSE_SIGMA, 2) ** 2), rng, 60), draw(np.diag(BALL_SIGMA**2), rng, 60)
    errors = [(np.r_[pose[:6], ball], np.r_[pose[6:], ball]) for pose, ball in zip(poses, balls, strict=True)]
    ours = np.array([play((0, 1), each, rng) for each in errors])
    low, high = chi2.ppf([0.025, 0.975], 3 * 60) / 60
    assert low < ours[:, 0].mean() < high
    alone = np.array([play((0,), each, rng) for each in errors[:10]])
    assert ours[:, 1].mean() < alone[:, 1].mean() / 1.4


def test_a_camera_without_frames_changes_nothing():
    rng, errors = np.random.default_rng(52), np.zeros(10)
    alone, beside = STATIONS[0][2].initial(0.0, np.eye(3)), both()
    for k, (R, _, _) in enumerate(own_motion(rng, 20)):
        filter_, points = STATIONS[0][2], frame(0, R, errors, rng)
        alone, beside = (filter_.update(filter_.predict(s, k * DT), points) for s in (alone, beside))
    assert len(beside.used) > 3
    assert_allclose(beside.attitude, alone.attitude, atol=1e-12)
    rest = np.delete(np.arange(len(beside.joint)), READOUT + np.arange(CAMERA_DIM))
    assert_allclose(beside.joint[np.ix_(rest, rest)], alone.joint, rtol=1e-6, atol=1e-14)
    side = STATIONS[1][2].station.covariance()
    assert_array_equal(beside.facing(0).joint[COMMON, COMMON], side[:-1, :-1])


def test_a_camera_that_comes_later_has_the_errors_that_it_would_have():
    """The filter estimates none of them here, so frames of the other camera determine none."""
    front, side = (with_errors(filter_, considered=0.01 * filter_.station.considered) for _, _, filter_ in STATIONS)
    rng, alone = np.random.default_rng(53), front.initial(0.0, np.eye(3))
    beside = alone.with_camera(prior(front, side))
    for k, (R, _, _) in enumerate(own_motion(rng, 20)):
        points = frame(0, R, np.zeros(10), rng)
        alone, beside = (front.update(front.predict(s, k * DT), points) for s in (alone, beside))
    later = alone.with_camera(prior(front, side))
    assert np.abs(beside.joint[:3, READOUT + 1 : READOUT + 4]).max() > 1e-12
    assert_allclose(later.joint, beside.joint, rtol=1e-6, atol=1e-15)


def test_a_camera_that_comes_later_is_corrected_with_the_ball():
    """The first frames show the ball's centre better than the rig; it is that of both cameras."""
    ball = np.diag(np.r_[np.full(3, 2e-3), 0.0] ** 2)
    front, side = (
        with_errors(filter_, considered=block_diag(1e-4 * filter_.station.considered[:6, :6], ball))
        for _, _, filter_ in STATIONS
    )
    rng, state = np.random.default_rng(54), front.initial(0.0, np.eye(3))
    off = np.r_[np.zeros(6), 2e-3, -1e-3, 1e-3, 0.0]
    for k, (R, _, _) in enumerate(own_motion(rng, 90)):
        state = front.update(front.predict(state, k * DT), frame(0, R, off, rng))
    other = state.with_camera(prior(front, side)).facing(0)
    assert_allclose(other.centre, state.centre, atol=2e-5)
    assert np.linalg.norm(other.centre) > 1e-3
    assert np.linalg.eigvalsh(other.joint).min() > -1e-15


def test_a_state_that_faces_another_camera_and_back_is_the_same():
    state, _ = settled()
    joint = np.diag(np.r_[np.arange(21.0, 29.0), np.arange(1.0, 9.0), np.arange(11.0, 19.0)])
    joint[:16, 16:] = joint[16:, :16] = 0.1
    state = state.with_camera(joint[:16, :16]).with_camera(joint)
    for which in range(2):
        there = state.facing(which)
        assert_allclose(there.joint[RIG_ROW, RIG_ROW], (1.0, 11.0)[which], rtol=1e-3)
        assert_allclose(there.joint[there.map_row - 1, there.map_row - 1], (8.0, 18.0)[which], rtol=1e-3)
        back = there.facing(which)
        assert_array_equal(back.joint, state.joint)
        assert_array_equal(back.hidden, state.hidden)
        assert [o.hidden.tolist() for o in back.others] == [o.hidden.tolist() for o in state.others]


def test_maps_of_several_cameras_grow_and_shrink_together():
    """A disc that comes or goes does so for each camera, and a saved map has no part of a camera."""
    state, R = settled()
    two = state.with_camera(1e-8 * np.eye(16))
    turned = exp(np.array([0.0, 0.5, 0.0])) @ R
    later = FILTER.update(two._replace(attitude=turned), points_at(seen(turned)))
    assert len(later.discs) > len(two.discs)
    assert [len(other.hidden) for other in later.others] == [len(later.discs)]
    saved, alone = to_map(two, 1), to_map(state, 1)
    assert_array_equal(saved.directions, alone.directions)
    assert_array_equal(saved.covariance, alone.covariance)
    assert with_map(two, saved).joint.shape == two.joint.shape
    new = FILTER.initial(0.0, np.eye(3)).with_reference_of(two)
    assert len(new.others) == 1
    assert_array_equal(new.facing(0).joint[RIG_ROW : RIG_ROW + 6, RIG_ROW : RIG_ROW + 6], 1e-8 * np.eye(6))
