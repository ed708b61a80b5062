"""Two cameras of one ball: one attitude from the frames of both, and each goes on without the other."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from ball_world import DISCS, DT, POSE, RIG, detected
from numpy.testing import assert_allclose, assert_array_equal

from spheremouse.ball.build import begin, build
from spheremouse.ball.camera_state import facing
from spheremouse.ball.cameras import with_camera
from spheremouse.ball.detect.appearance import seen_at
from spheremouse.ball.detect.detections import no_detections
from spheremouse.ball.points import intersect
from spheremouse.ball.pose import predict_targets
from spheremouse.ball.rig import in_axes
from spheremouse.ball.settings import Settings
from spheremouse.ball.track import advance
from spheremouse.errors import ConfigurationError
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import exp, log
from spheremouse.session.offline import merged
from spheremouse.simulate.ball.scene import default_scene
from spheremouse.tracker import Frame, Status

ASIDE = exp(np.array([0.0, 0.5 * np.pi, 0.0]))  # from the camera in front to the one at the side
POSES = POSE, Pose(ASIDE @ POSE.rotation, ASIDE @ POSE.position)
SHORT, LONG = 2.0, 5.0  # s, in which a camera is covered
TRACKERS = tuple(build(RIG, pose, Settings()) for pose in POSES)


def attitude(t):
    """R_obj_ball of a ball that rests, turns, rests from 2.3 s on, and turns about another axis from 3 s on."""

    def path(since, until):  # s, of a unit rate that a hand gives and takes within 0.1 s
        taken = [min(max(t - at, 0.0), 0.1) ** 2 / 0.2 + max(t - at - 0.1, 0.0) for at in (since, until)]
        return taken[0] - taken[1]

    return exp(np.array([-0.5, -1.5, 0.4]) * path(3.0, 4.8)) @ exp(np.array([1.0, 0.6, 0.3]) * path(0.3, 2.3))


def tracked(cameras, until=6.0, hidden=lambda camera, t: False, rng=None, extra=None, late=0.5, spots=None, jitter=1.0):
    """State, error of a confirmed attitude (rad) and camera, frame by frame, of a run with cameras in turn.

    The second camera is `late` by a part of the interval. `hidden`: what covers a camera, and None if it gives no
    frame. For each camera, `extra` (n, 2) px lie on what covers it, with a `jitter` (px), and `spots` (n, 2) px stay in
    the picture of the ball.
    """
    rng = np.random.default_rng(7) if rng is None else rng
    state = begin(TRACKERS[cameras[0]], 0.0)
    if len(cameras) > 1:
        state = with_camera(state, TRACKERS[1], TRACKERS[:1], 1)
    for k in range(int(until / DT) * len(cameras)):
        camera, t = cameras[k % len(cameras)], (k // len(cameras) + late * (k % len(cameras))) * DT
        tracker, R = TRACKERS[camera], attitude(t)
        place = DISCS @ R.T
        place = place[place @ tracker.filter.station.towards > 0.4]
        covered = hidden(camera, t)
        if covered is None:
            continue
        found = detected(seen_at(place, RIG, POSES[camera]), rng)
        if covered:
            found = no_detections()
            if extra is not None and camera in extra:
                found = detected(extra[camera] + jitter * rng.normal(size=extra[camera].shape), rng)
        elif spots is not None and camera in spots:
            found = found.joined(detected(spots[camera], rng))
        state = facing(state, camera if len(cameras) > 1 else 0)
        state, estimate, _ = advance(state, t, found, tracker)
        yield state, np.linalg.norm(log(estimate.rotation @ R.T)) if estimate.confirmed else 0.0, camera


def covers(camera):
    """A hand before a camera while the ball turns back."""
    return lambda which, t: which == camera and SHORT < t < LONG


SLEEVE = np.array([[300.0, 200.0], [350.0, 260.0], [310.0, 290.0]])  # px, of spots on it
SHEET = np.concatenate([SLEEVE, SLEEVE + np.array([15.0, -70.0])])


@pytest.mark.parametrize("extra", [None, pytest.param(SLEEVE, marks=pytest.mark.slow)])
@pytest.mark.parametrize("camera", [0, 1])
def test_no_hand_before_one_camera_loses_the_ball(camera, extra):
    if extra is None:
        alone = tracked((camera,), hidden=covers(camera))
        assert any(state.status is Status.LOST for state, _, _ in alone)
    both = list(tracked((0, 1), hidden=covers(camera), extra=None if extra is None else {camera: extra}))
    assert all(state.status is Status.TRACKING for state, _, _ in both)
    assert np.degrees(max(error for _, error, _ in both[30:])) < 0.15
    assert both[-1][0].confirmed


def test_a_camera_that_dies_and_comes_back_is_no_event_of_the_ball():
    both = list(tracked((0, 1), hidden=lambda camera, t: None if camera == 0 and 1.0 < t < 5.0 else False))
    assert all(state.status is Status.TRACKING for state, _, _ in both)
    assert np.degrees(max(error for _, error, _ in both)) < 0.15
    assert len(both[-1][0].filter.used) > 2
    assert [camera for _, _, camera in both[-4:]] == [0, 1, 0, 1]


def test_two_cameras_see_the_ball_better_than_one():
    """Both show discs beside the first attitude. With those of one camera alone, its errors would stay in the map."""
    squares = []
    for cameras in ((0,), (1,), (0, 1)):
        runs = [tracked(cameras, until=3.0, rng=np.random.default_rng(seed), late=0.0) for seed in range(4)]
        squares.append(np.mean([error**2 for run in runs for state, error, _ in run if state.filter.stamp > 1.0]))
    assert 1.5 * squares[2] < np.mean(squares[:2])


@pytest.mark.parametrize("camera", [0, 1])
def test_spots_that_stay_before_one_camera_are_no_discs_of_the_other(camera):
    both = list(tracked((0, 1), until=3.0, spots={camera: SLEEVE}, late=0.0))
    assert all(state.status is Status.TRACKING for state, _, _ in both)
    assert np.degrees(max(error for state, error, _ in both if state.filter.stamp > 1.0)) < 0.1
    assert len(both[-1][0].filter.discs) <= len(DISCS)


def test_a_frame_of_the_other_camera_proves_no_new_map():
    """A sheet of spots hides the ball from one camera, and the other sees nothing."""
    both = list(tracked((0, 1), until=9.0, hidden=lambda _, t: t > SHORT, extra={0: SHEET}, jitter=0.0))
    since = next(k for k, (state, _, _) in enumerate(both) if state.status is Status.LOST)
    assert all(state.status is Status.LOST for state, _, _ in both[since:])


def test_the_parts_of_a_camera_stay_its_own():
    states = [state for state, _, _ in tracked((0, 1), until=0.7)]
    for before, after in pairwise(states):
        assert after.camera != before.camera
        assert after.others[0].detections is before.detections
        assert facing(after, before.camera).shown_at == before.shown_at < after.shown_at
    numbers = [facing(states[-1], k).lookalikes.next_number for k in range(2)]
    assert abs(numbers[0] - numbers[1]) > 1e9  # never the same
    assert_array_equal(facing(facing(states[-1], 0), 1).filter.joint, states[-1].filter.joint)


def test_other_axes_change_no_picture():
    """The same targets and discs in the picture, with the same errors, from a rig in the axes of another camera."""
    scene = default_scene()
    joint = np.cov(np.random.default_rng(3).normal(size=(10, 30))) * 1e-8
    ball = replace(scene.rig().ball, covariance=joint[6:, 6:])
    rig = replace(scene.rig(), ball=ball)
    pose = replace(scene.pose, covariance=joint[:6, :6], ball_covariance=joint[:6, 6:])
    other = in_axes(rig, pose, ASIDE)
    assert_allclose(predict_targets(other[1], other[0]), predict_targets(pose, rig), atol=1e-9)
    places = DISCS[DISCS[:, 2] > 0.5]
    uv = seen_at(places, rig, pose)
    assert_allclose(seen_at(places @ ASIDE.T, *other), uv, atol=1e-9)
    here, there = (intersect(detected(uv, None), *each) for each in ((rig, pose), other))
    assert_allclose(there.covariance, ASIDE @ here.covariance @ ASIDE.T, atol=1e-12)


def test_frames_of_two_cameras_come_in_the_order_of_their_stamps():
    image = np.zeros((2, 2), np.uint8)
    frames = [[Frame(image, t, k) for k, t in enumerate(stamps)] for stamps in ((0.0, 0.1, 0.5), (0.05, 0.2, 0.3))]
    assert [(f.camera, f.sequence) for f in merged(frames)] == [(0, 0), (1, 0), (0, 1), (1, 1), (1, 2), (0, 2)]


def test_a_published_tracker_takes_one_camera():
    other = build(RIG, POSES[1], replace(Settings(), tracker="ekf1"))
    with pytest.raises(ConfigurationError, match="more than one camera"):
        with_camera(begin(TRACKERS[0], 0.0), other, TRACKERS[:1], 1)
