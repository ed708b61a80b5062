"""Begin and begin again: pictures before the ball is seen, a ball that is gone for long, and another pose."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from spheremouse.ball.build import begin, build
from spheremouse.ball.events import BallLost, Found, NewMap, Recognised, Turned
from spheremouse.ball.settings import Settings
from spheremouse.ball.track import step, with_pose
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import log
from spheremouse.simulate.ball.film import SimulationOptions, prepare, simulate
from spheremouse.tracker import Frame, Status
from tests.ball.texture.test_method import events

DT = 1.0 / 30.0
ELSEWHERE = -25  # a picture of the film about 25° before the last one


@pytest.fixture
def film(speckle):
    return speckle[:2]


@pytest.fixture
def tracked(speckle):
    return speckle[2]


def follow(images, tracker, steps=(), interval=DT):
    """Return the steps of a tracker over pictures, one in each interval, after others."""
    steps = list(steps)
    state, stamp = (steps[-1].state, steps[-1].estimate.stamp) if steps else (begin(tracker, 0.0), -interval)
    for image in images:
        stamp += interval
        made = step(state, Frame(image, stamp, len(steps)), tracker)
        state = made.state
        steps.append(made)
    return steps


def hidden(film, tracked, seconds, spots=0.0):
    """Return the steps while a sheet is before the camera, after others; it has spots of so many grey values."""
    made, tracker = film
    pattern = cv2.GaussianBlur(np.random.default_rng(1).normal(size=made[0].frame.image.shape[:2]), (0, 0), 2.0)
    light = 120.0 + spots * np.sign(pattern)[..., None]
    sheet = np.broadcast_to(light, made[0].frame.image.shape).astype(np.uint8)
    steps = follow(15 * [sheet], tracker, tracked)
    return follow([sheet], tracker, steps, interval=seconds - 15.0 * DT)


def error(step_, truth, at, there):
    """Return the angle, °, of a step's attitude from the truth; both count from the step `at`, of the truth `there`."""
    turned = truth @ there.T
    return np.degrees(np.linalg.norm(log(step_.estimate.rotation @ (turned @ at.estimate.rotation).T)))


@pytest.mark.slow
@pytest.mark.parametrize(("level", "frames"), [(0, 1), (0, 30), (120, 300), (255, 3)])
def test_pictures_before_the_ball_is_seen_do_not_keep_it_from_being_tracked(film, level, frames):
    """Cameras give black frames first, and the program may start while a cap is on."""
    made, tracker = film
    images = [m.frame.image for m in made]
    steps = follow(frames * [np.full_like(images[0], level)] + images, tracker)
    assert events(steps) == [Found, Turned]
    assert not any(s.estimate.confirmed for s in steps[: frames + 1])
    k = next(k for k, s in enumerate(steps) if s.state.status is Status.TRACKING)
    assert error(steps[-1], made[-1].attitude, steps[k], made[k - frames].attitude) < 0.3


def test_a_ball_that_comes_back_after_a_new_map_began_is_tracked(film, tracked):
    made, tracker = film
    steps = hidden(film, tracked, 6.0, spots=40.0)
    assert events(steps[len(tracked) :])[-2:] == [BallLost, NewMap]
    back = follow([m.frame.image for m in made], tracker, steps)[len(steps) :]
    assert events(back) == [Found, Turned]
    assert sum(s.state.status is Status.TRACKING for s in back) > 20


@pytest.mark.parametrize("seconds", [3.0, 6.0])
def test_a_hidden_ball_is_lost_without_a_motion_and_then_recognised_where_it_is(film, tracked, seconds):
    made, tracker = film
    steps = hidden(film, tracked, seconds)
    lost = steps[len(tracked) :]
    assert events(lost).count(BallLost) == 1
    assert not any(s.estimate.increment.any() for s in lost)
    back = follow(10 * [made[ELSEWHERE].frame.image], tracker, steps)[len(steps) :]
    assert events(back) == [Recognised]
    assert error(back[-1], made[ELSEWHERE].attitude, tracked[-1], made[-1].attitude) < 0.3


def test_after_the_camera_was_moved_the_ball_is_still_recognised(film, tracked):
    made, tracker = film
    pose = Pose(tracker.pose.rotation, tracker.pose.position + np.array([1e-5, 0.0, 0.0]))
    frame = Frame(made[-1].frame.image, len(tracked) * DT, len(tracked))
    moved = [*tracked, with_pose(tracked[-1].state, frame, tracker, pose)]
    steps = hidden(film, moved, 1.0)
    back = follow(10 * [made[ELSEWHERE].frame.image], tracker, steps)[len(steps) :]
    assert Recognised in events(back)


@pytest.mark.parametrize("light", [1.0, pytest.param(0.5, marks=pytest.mark.slow), 0.2])
def test_a_ball_at_rest_in_any_light_and_noise_sends_nothing(film, tracked, light):
    """The pointer moves by less than a fifth of a pixel of the ball in two seconds of noise."""
    made, tracker = film
    rng = np.random.default_rng(0)
    clear = made[-1].frame.image.astype(float)
    images = [
        np.clip(np.rint(light * clear + rng.normal(0.0, 4.0, clear.shape)), 0, 255).astype(np.uint8) for _ in range(60)
    ]
    rest = follow(images, tracker, tracked)[len(tracked) :]
    assert events(rest) == []
    assert all(s.estimate.confirmed for s in rest)
    sent = np.cumsum([s.estimate.increment[:3] for s in rest], axis=0)[5:]  # the ball stopped within a frame
    assert np.degrees(np.ptp(sent, axis=0)).max() < 0.15


def test_a_ball_that_never_turns_sends_nothing_whatever_the_noise(film):
    made, tracker = film
    rng = np.random.default_rng(1)
    clear = made[0].frame.image.astype(float)
    for noise in (0.0, 4.0, 12.0, 40.0):
        images = [
            np.clip(np.rint(clear + rng.normal(0.0, noise, clear.shape)), 0, 255).astype(np.uint8) for _ in range(25)
        ]
        steps = follow(images, tracker)
        assert events(steps) == []
        assert not any(np.any(s.estimate.increment) for s in steps)


@pytest.mark.parametrize("pattern", ["speckle", "none", pytest.param("dirt", marks=pytest.mark.slow)])
def test_a_spotted_sleeve_before_a_ball_at_rest_sends_nothing(film, pattern):
    """It covers a third of the ball, and moves by the radius. The noise of a plain ball is no pattern that turns."""
    made, tracker = film
    plain = prepare(SimulationOptions(pattern=pattern, motion="still", seconds=DT, size=(320, 240), seed=7))
    still = made[0].frame.image if pattern == "speckle" else next(simulate(plain)).frame.image
    height, width = still.shape[:2]
    rng = np.random.default_rng(2)
    sleeve = 110.0 + 60.0 * np.sign(cv2.GaussianBlur(rng.normal(size=(height, 3 * width)), (0, 0), 3.0))
    v, u = np.mgrid[:height, :width]
    covered = np.hypot(u - 0.5 * width, v - 0.5 * height) < 0.2 * height
    images = []
    for k in range(90):
        at = width + round(0.5 * max(k - 15, 0))
        noisy = still + rng.normal(0.0, 3.0, still.shape)
        noisy[covered] = sleeve[:, at : at + width][covered][:, None]
        images.append(np.clip(noisy, 0, 255).astype(np.uint8))
    steps = follow(images, tracker)
    assert not {Found, Turned} & set(events(steps))
    assert all(not s.estimate.increment.any() for s in steps)


def test_a_ball_half_outside_the_picture_is_followed_by_the_other_half(film):
    made, tracker = film
    width = made[0].frame.image.shape[1] // 2
    rig = replace(tracker.rig, camera=replace(tracker.rig.camera, width=width))
    steps = follow([np.ascontiguousarray(m.frame.image[:, :width]) for m in made], build(rig, tracker.pose, Settings()))
    which = [k for k, s in enumerate(steps) if s.estimate.confirmed and s.state.status is Status.TRACKING]
    assert len(which) > 20
    first = which[0]
    assert max(error(steps[k], made[k].attitude, steps[first], made[first].attitude) for k in which) < 0.6


def test_a_picture_in_grey_is_worth_one_in_colour(film):
    made, tracker = film
    steps = [follow([m.frame.image for m in made[:30]], tracker)]
    grey = [np.asarray(m.frame.image.mean(axis=2).round(), np.uint8) for m in made[:30]]
    steps.append(follow(grey, tracker))
    assert all(s[-1].state.status is Status.TRACKING for s in steps)
    turned = [s[-1].estimate.rotation for s in steps]
    assert np.degrees(np.linalg.norm(log(turned[0] @ turned[1].T))) < 0.2


def test_the_same_pictures_give_the_same_attitudes(film):
    """Nothing of the search is left to chance."""
    made, tracker = film
    images = [m.frame.image for m in made[:25]]
    a, b = follow(images, tracker), follow(images, replace(tracker))
    assert all(np.array_equal(x.estimate.rotation, y.estimate.rotation) for x, y in zip(a, b, strict=True))
