"""A recording like R1: the motion is one, and the agreement with a trackball finds what was put in."""

import numpy as np
import pytest
from experiments.kit.r1 import LAG, SCALE, TRACKBALL, Slowed, agreement, of_truth
from experiments.kit.trackball import simulate_log
from numpy.testing import assert_allclose

from spheremouse.ball.truth import Truth
from spheremouse.files.mouse_log import MouseLog
from spheremouse.geometry.rotation import log
from spheremouse.simulate.ball.profile import play


def motion(pace=0.5):
    return Slowed(play(8.0, np.random.default_rng(3)), pace)


def test_slow_motion_turns_as_its_rate_says_and_ends_at_the_same_place():
    slow, h = motion(), 1e-5
    t = np.linspace(0.1, 15.9, 40)
    turned = log(slow.attitude(t + h) @ slow.attitude(t - h).transpose(0, 2, 1)) / (2.0 * h)
    assert_allclose(turned, slow.rate(t), atol=1e-6)
    assert slow.seconds == pytest.approx(16.0)
    assert_allclose(slow.attitude(np.array([16.0])), slow.profile.attitude(np.array([8.0])))


def test_the_agreement_finds_lag_scale_and_offset_of_a_log_made_from_the_speeds():
    t = np.arange(0.0, 10.0, 1.0 / 30.0)

    def path(at):  # mm
        return np.stack([40.0 * np.sin(1.7 * at), 25.0 * np.cos(2.3 * at)], axis=1)

    fine = np.arange(-2.0, 12.0, 0.002)
    counts = np.diff(3.0 * path(fine) + 7.0 * fine[:, None], axis=0, prepend=0.0)
    counts[0] = 0.0
    late = fine + 0.15
    mouse = MouseLog(late, counts)
    found = agreement(t[:-1], t[1:], np.diff(path(t), axis=0), mouse)
    assert found is not None
    assert found.lag == pytest.approx(0.15, abs=0.0026)
    assert found.scale == pytest.approx(3.0, rel=1e-3)
    assert found.offset == pytest.approx(7.0, abs=0.05)
    assert found.r > 0.9999


def test_the_true_motion_agrees_with_the_trackball_but_for_its_faults():
    slow = motion()
    t = np.arange(0.0, 16.0, 1.0 / 30.0)
    mouse = simulate_log(slow.rate, 0.0, 16.0, TRACKBALL)
    found = of_truth(Truth(t, slow.attitude(t), slow.rate(t)), mouse, 0.6)
    assert found is not None
    assert 0.9 < found.r < 0.9999  # uneven reports, noise of the stamps, some lost
    assert found.scale == pytest.approx(SCALE / 600.0, rel=0.05)
    assert LAG - 0.01 < found.lag < LAG + 0.03  # a report comes after what it counts
