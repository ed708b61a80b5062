"""The ball's angular velocity for its player, and the release of a stick."""

import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from reporting import rolling
from seats import LOOKS

from spheremouse.output.counts import MotionSettings
from spheremouse.output.deflection import Watchdog, pointer_rate
from spheremouse.tracker import Status

RATES = arrays(float, 3, elements=st.floats(-20.0, 20.0))
UP = np.array([0.0, 1.0, 0.0])


@given(st.sampled_from(sorted(LOOKS)), RATES)
def test_the_rate_is_that_of_the_balls_top_for_its_player(player, w):
    made = pointer_rate(rolling(w, MotionSettings(player=player)))
    assert made is not None
    look, top = np.array(LOOKS[player]), np.cross(w, UP)
    assert np.allclose(made, [top @ np.cross(look, UP), -top @ look, w[1]], atol=1e-9)


@given(RATES, st.floats(0.01, 100.0), st.booleans(), st.booleans())
def test_the_scale_of_the_pointer_changes_no_deflection_and_its_inversion_does(w, scale, invert_x, invert_z):
    plain = pointer_rate(rolling(w))
    made = pointer_rate(rolling(w, MotionSettings(counts_per_mm=scale, invert_x=invert_x, invert_z=invert_z)))
    assert plain is not None
    assert made is not None
    assert np.allclose(made, np.array(plain) * np.where([invert_x, False, invert_z], -1.0, 1.0), rtol=1e-9, atol=1e-12)


def test_a_ball_that_is_lost_has_no_rate_and_one_that_is_hidden_keeps_its_own():
    assert pointer_rate(rolling([1.0, 0.0, 0.0], confirmed=False)) is None
    for report in (rolling([1.0, 0.0, 0.0], status=Status.LOST), rolling([1.0, 0.0, 0.0])._replace(samples=())):
        assert pointer_rate(report) == pytest.approx([0.0, 0.0, 0.0], abs=0.0)


def test_a_watchdog_releases_once_after_the_last_feed():
    released = threading.Semaphore(0)
    watchdog = Watchdog(released.release, timeout=0.01)
    for _ in range(3):
        watchdog.feed()
        assert released.acquire(timeout=10)
        assert not released.acquire(timeout=0.05)
    watchdog.close()


def test_a_watchdog_that_is_fed_or_closed_releases_nothing():
    released = []
    watchdog = Watchdog(lambda: released.append(1), timeout=60.0)
    watchdog.feed()
    watchdog.close()
    Watchdog(lambda: released.append(1), timeout=0.0).close()
    assert not released
