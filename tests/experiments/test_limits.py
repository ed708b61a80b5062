"""Limits of tracking: what is seen without pictures against pictures, laws of the trials."""

import numpy as np
import pytest
from experiments import covers, limits
from experiments.covers import COVERS
from experiments.kit import world as world_module
from experiments.kit.world import SpedUp, world
from experiments.limits import ACCELERATIONS, FASTEST, Trial

from spheremouse.geometry.matching import assign
from spheremouse.geometry.rotation import log
from spheremouse.simulate.ball.render import Renderer, RenderOptions


@pytest.fixture(scope="module")
def there():
    return world(world_module.DISCS, 0)


@pytest.fixture(scope="module")
def trial(there):
    tracker = world_module.tracker_for("ekf2", there)
    return Trial(tracker, there, world_module.after_rest("ekf2", tracker, there), world_module.random_axis(0), 30.0, 0)


# ---- what is seen ----


def test_the_same_discs_are_seen_as_in_pictures_and_as_well(there):
    renderer, rng = Renderer(there.scene, RenderOptions(noise=world_module.NOISE)), np.random.default_rng(0)
    detector = world_module.tracker_for("so3", there).detector_data
    motion = SpedUp(world_module.random_axis(1), 1.0, 1.0)
    matched, seen, found, claims = 0, 0, 0, []
    for t in np.arange(1.0, 13.0):
        here = there.see(motion.attitude(np.array([t]))[0], rng)
        pictured = detector.detect(renderer.frame(motion, float(t), 0, rng).frame.image)
        i, j = assign(np.linalg.norm(here.centre[:, None] - pictured.centre[None], axis=2), 1.0)
        matched, seen, found = matched + len(i), seen + len(here), found + len(pictured)
        claims.append(here.covariance[i, 0, 0] / pictured.covariance[j, 0, 0])
    assert matched > 60
    assert matched > 0.95 * seen  # none that a picture does not show
    assert matched > 0.85 * found  # and most of those that it shows: slivers are left out
    assert 0.5 < np.sqrt(np.median(np.concatenate(claims))) < 1.5


def test_centres_are_off_by_what_they_claim(there):
    rng, errors = np.random.default_rng(0), []
    for _ in range(60):
        here = there.see(np.eye(3), rng)
        errors.append((here.centre - there.see(np.eye(3), _Exact()).centre) / np.sqrt(here.covariance[:, :1, 0]))
    assert np.mean(np.concatenate(errors) ** 2) == pytest.approx(1.0, abs=0.15)


class _Exact:
    def standard_normal(self, shape):
        return np.zeros(shape)


def test_a_cover_grows_over_the_whole_ball_from_its_side(there):
    visible = np.count_nonzero(there.ball)
    for kind in COVERS:
        order = covers.growing(there, kind)
        half = order < 0.5
        assert np.count_nonzero(half) == pytest.approx(0.5 * visible, abs=1.0)
        assert np.array_equal(order < 1.0, there.ball)
    # the far camera is turned: obj's up is where the image's columns go, or come from
    place = there.scene.pose.to_cam(np.array([[0.0, 0.3, 0.5], [0.0, -0.3, 0.5]]))
    top, bottom = ((there.scene.camera.fx * p[:2] / p[2] + (320, 240)).astype(int) for p in place)
    above = covers.growing(there, "from above")
    assert above[top[1], top[0]] < 0.5 < above[bottom[1], bottom[0]]


# ---- trials ----


def test_attitude_is_the_integral_of_rate():
    motion, h = SpedUp(np.array([0.6, 0.0, 0.8]), 5.0, 2.0), 1e-5
    for t in (0.1, 0.3, 0.7, 2.0):
        R = motion.attitude(np.array([t - h, t + h]))
        assert log(R[1] @ R[0].T) / (2.0 * h) == pytest.approx(motion.rate(np.array([t]))[0], abs=1e-4)
    assert np.linalg.norm(motion.rate(np.array([0.2]))) == pytest.approx(1.0)


def test_bisection_finds_where_it_ends():
    for limit in (0.3, 2.0, 11.0):
        found = limits.bisected(lambda x, limit=limit: x <= limit, 0.1, 25.0)
        assert limit / limits.FINE < found <= limit
    assert limits.bisected(lambda x: True, 0.1, 25.0) == 25.0
    assert limits.bisected(lambda x: False, 0.1, 25.0) == 0.0


def test_what_is_reached_is_followed_and_more_is_not(trial):
    """The rate found is that of a course of its own, from rest."""
    rate = trial.fastest(ACCELERATIONS[0])
    assert 0.5 < rate < FASTEST

    def followed(most):
        t = trial.times(most / ACCELERATIONS[0] + world_module.HOLD)
        motion = SpedUp(trial.axis, ACCELERATIONS[0], most)
        return len(trial.course(world_module.course_begun(trial.start), motion, t)) == len(t)

    assert followed(0.7 * rate)
    assert not followed(1.5 * rate)


def test_a_course_ends_where_what_was_turned_is_wrong_or_the_ball_is_lost(trial):
    begun = world_module.course_begun(trial.start)
    small, large = (SpedUp(trial.axis, 1e9, a).attitude(np.array([1.0]))[0] for a in np.radians((2.0, 4.0)))
    assert begun.then(trial.start, small.T) is not None
    assert begun.then(trial.start, large.T) is None


def test_the_wait_is_counted_from_when_the_cover_goes():
    t = np.arange(1.0, 56.0) / 10.0
    off = [(np.eye(3), 0.0 if s < 2.0 or s > 3.35 else 1.0, True) for s in t]
    found = covers.waited(t, off, 3.0)
    assert found["rate"] == {"frames": 5, "ms": pytest.approx(400.0)}
    assert found["attitude"] == {"frames": 1, "ms": pytest.approx(0.0)}
    assert covers.waited(t, [(np.eye(3), 1.0, True)] * len(t), 3.0) == {"error": "lost before the cover came"}
