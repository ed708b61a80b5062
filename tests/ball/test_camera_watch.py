"""The watch on the targets: a camera that stands, one that was pushed, people in front; and the pose that follows."""

from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from spheremouse.ball import camera_watch as watching
from spheremouse.ball.build import build
from spheremouse.ball.camera_moved import apparent_turn
from spheremouse.ball.detect.appearance import seen_at
from spheremouse.ball.detect.rings import RingSettings
from spheremouse.ball.pose import predict_targets
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import exp, log
from spheremouse.simulate.ball.film import SimulationOptions, prepare, simulate

RINGS = RingSettings()
PUSH = (2.0, 1.0, -2.0, 0.1, -0.2, 0.1)  # mm and deg
FAR_PUSH = (12.0, -12.0, 10.0, 1.2, -1.2, 1.0)


@dataclass
class Film:
    rig: Rig
    before: Pose
    after: Pose
    still: list[np.ndarray]
    pushed: list[np.ndarray]

    @property
    def shift(self):
        """True shifts, (n, 2) px."""
        return predict_targets(self.after, self.rig) - predict_targets(self.before, self.rig)

    def watch(self, grey=False):
        watch = watching.begin(self.rig, self.before)
        image = cv2.cvtColor(self.still[0], cv2.COLOR_BGR2GRAY) if grey else self.still[0]
        return watching.remember_targets(watch, image, np.arange(len(watch)), self.rig, RINGS)


@cache
def _film(push):
    sim = prepare(SimulationOptions(motion="still", noise=3.0, seconds=0.2, bump=0.11, bump_by=push))
    images = [f.frame.image for f in simulate(sim)]
    return Film(sim.scene.rig(), sim.scene.pose, sim.changes[0].scene.pose, images[:4], images[4:])


@pytest.fixture
def near():
    return _film(PUSH)


@pytest.fixture(params=[PUSH, FAR_PUSH], ids=["near", "far"])
def film(request):
    return _film(request.param)


def test_a_camera_that_stands(near):
    watch = near.watch()
    assert watch.seen.all()
    for k, image in enumerate(near.still[1:] * 3):
        _, shift = watching.target_shifts(watch, image)
        assert np.abs(shift).max() < 0.05
        assert watching.most_have_moved(shift, watching.DISPLACED_PX) is False
        watch, odd = watching.check_next_target(watch, image, 0.3 * k, bump_suspected=k % 2 == 0)
        assert not odd


def test_every_target_is_looked_at_once_in_an_interval(near):
    watch, turns = near.watch(), []
    for k in range(61):
        after, _ = watching.check_next_target(watch, near.still[1], k / 30.0, bump_suspected=False)
        turns += [after.last_target] if after is not watch else []
        watch = after
    n = len(watch)
    assert turns[: 2 * n] == [(k + 1) % n for k in range(2 * n)]
    assert len(turns) <= 2 * n + 1


def test_two_targets_are_looked_at_in_each_frame_after_the_camera_was_displaced(near):
    watch, turns = replace(near.watch(), shaken=0.0), [0]
    for k in range(1, 60):
        watch, _ = watching.check_next_target(watch, near.still[1], k / 30.0, bump_suspected=False)
        turns.append(watch.last_target)
    steps = np.diff(turns) % len(watch)
    assert np.all(steps[:29] == 2)
    assert np.count_nonzero(steps[30:]) <= len(watch) + 1


def test_a_shift_of_the_image_appears_as_a_turn_of_the_ball_if_it_is_small(film):
    tracker = build(film.rig, film.before, Settings())
    shift = np.array([0.3, -0.2])
    turn = apparent_turn(np.vstack([np.tile(shift, (3, 1)), [np.nan, np.nan]]), tracker)
    middle = tracker.filter.station.towards
    before, after = seen_at(np.stack([middle, exp(turn) @ middle]), film.rig, film.before)
    assert_allclose(after - before, shift, rtol=0.3)
    assert np.linalg.norm(apparent_turn(np.tile(100.0 * shift, (3, 1)), tracker)) < 0.03


@pytest.mark.parametrize("grey", [False, True])
def test_a_pushed_camera(film, grey):
    image = cv2.cvtColor(film.pushed[0], cv2.COLOR_BGR2GRAY) if grey else film.pushed[0]
    watch = film.watch(grey)
    _, odd = watching.check_next_target(watch, image, 0.1, bump_suspected=True)
    assert odd
    watch, shift = watching.target_shifts(watch, image)
    assert_allclose(shift, film.shift, atol=0.25)
    rings = watching.on_rings(watch, image, shift, film.rig, RINGS)
    if grey:
        assert np.isnan(rings).all()
    else:
        assert_allclose(rings, film.shift, atol=0.03)
    pose, added = watching.moved_pose(
        shift if grey else rings, film.rig, film.before, watching.MATCH_SIGMA_PX if grey else watching.RING_SIGMA_PX
    )
    error = np.concatenate([pose.position - film.after.position, log(pose.rotation @ film.after.rotation.T)])
    assert error @ np.linalg.solve(added, error) < 22.5  # 99.9 % of chi-square with 6 degrees
    if not grey:
        assert np.linalg.norm(error[:3]) < 1e-3


def test_people_in_front_say_nothing(near):
    image = near.pushed[0].copy()
    for x, y in near.watch().corner[:2]:
        cv2.rectangle(image, (int(x) - 20, int(y) - 20), (int(x) + 60, int(y) + 60), (70, 90, 140), -1)
    watch, shift = watching.target_shifts(near.watch(), image)
    assert np.isnan(shift[:2]).all()
    assert not watch.seen[:2].any()
    assert watching.most_have_moved(shift, watching.DISPLACED_PX) is None


def test_what_is_no_target_is_not_kept(near):
    wall = np.full_like(near.still[0], 128)
    watch = watching.begin(near.rig, near.before)
    watch = watching.remember_targets(watch, wall, np.arange(len(watch)), near.rig, RINGS)
    assert all(patch is None for patch in watch.patches)
    beside = np.roll(near.still[0], 14, axis=1)  # then the patch holds half of a target
    watch = watching.remember_targets(watch, beside, np.arange(len(watch)), near.rig, RINGS)
    assert not watch.seen.any()


def test_fewer_than_three_targets_are_no_watch(near):
    t = near.rig.targets
    two = replace(t, ids=t.ids[:2], codes=t.codes[:2], position=t.position[:2], covariance=t.covariance[:6, :6])
    assert watching.begin(replace(near.rig, targets=two), near.before) is None


@pytest.mark.parametrize("size", [1e-4, 1e-2])
def test_exact_shifts_give_the_exact_pose(near, size):
    rng = np.random.default_rng(1)
    for _ in range(20):
        d, theta = size * rng.normal(size=(2, 3))
        true = Pose(exp(theta) @ near.before.rotation, near.before.position + d)
        shift = predict_targets(true, near.rig) - predict_targets(near.before, near.rig)
        pose, _ = watching.moved_pose(shift, near.rig, near.before, 0.02)
        assert_allclose(pose.position, true.position, atol=1e-7)
        assert_allclose(pose.rotation, true.rotation, atol=1e-7)


def test_the_covariance_is_the_scatter(near):
    rng = np.random.default_rng(2)
    nees = []
    for _ in range(300):
        shift = near.shift + 0.02 * rng.normal(size=near.shift.shape)
        moved = watching.moved_pose(shift, near.rig, near.before, 0.02)
        if moved is None:
            continue
        pose, added = moved
        e = np.concatenate([pose.position - near.after.position, log(pose.rotation @ near.after.rotation.T)])
        nees.append(e @ np.linalg.solve(added, e))
    assert len(nees) > 290
    assert 5.2 < np.mean(nees) < 6.9  # 6 degrees of freedom, 300 samples: +- 4 sigma is 0.8


def test_a_target_that_moved_by_itself_is_left_out(near):
    shift = near.shift.copy()
    shift[0] += [3.0, -2.0]
    pose, _ = watching.moved_pose(shift, near.rig, near.before, 0.02)
    # any three of the four fit a pose: what is asked is that the error is not smeared over all
    residual = near.shift - (predict_targets(pose, near.rig) - predict_targets(near.before, near.rig))
    assert np.count_nonzero(np.hypot(*residual.T) < 0.01) >= 2


def test_a_camera_stands_still_if_three_targets_keep_their_place(near):
    a, hidden = near.shift, near.shift.copy()
    hidden[:2] = np.nan
    assert watching.is_still(a, a + 0.02)
    for other in (a + 1.0, np.zeros((0, 2)), hidden):
        assert not watching.is_still(a, other)
