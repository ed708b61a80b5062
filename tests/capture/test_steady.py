"""Steady stamps: cameras whose exposures are known, and stamps that a computer makes late."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spheremouse.capture.steady import Rhythm, SteadyStamps, steady_stamp

FPS = 30.0
PACKETS = 0.004  # s, of 32 packets of USB


def exposures(fps=FPS, n=900):
    return 10.0 + np.arange(n) / fps


def by_usb(t, rng):
    """Stamps of frames whose packets are handled 32 at once, and up to 0.2 ms after the last of them."""
    return np.ceil(t / PACKETS) * PACKETS + rng.uniform(0.0, 2e-4, len(t))


def steadied(raw, interval=1.0 / FPS, counts=None):
    steady = SteadyStamps(interval)
    return np.array([steady.next(r, np.inf, n) for r, n in zip(raw, counts or [1] * len(raw), strict=True)])


def scatter(stamps, t):
    """Standard deviation of the time from frame to frame, s."""
    return np.std(np.diff(stamps) - np.diff(t))


@pytest.mark.parametrize(("fps", "nominal"), [(15.0, 30.0), (29.97, 30.0), (50.0, 60.0), (60.01, 60.0), (120.0, 120.0)])
def test_delays_of_usb_are_averaged(fps, nominal):
    """Also if the camera has another interval than it names, as in the dark."""
    t = exposures(fps)
    raw = by_usb(t, np.random.default_rng(1))
    stamps = steadied(raw, 1.0 / nominal)
    assert scatter(raw[60:], t[60:]) > 1e-3
    assert scatter(stamps[60:], t[60:]) < 1e-4
    assert np.abs(stamps - t).max() < PACKETS + 1e-3


@pytest.mark.parametrize("counted", [True, False])
def test_exact_stamps_stay_also_if_frames_are_missing(counted):
    t = exposures()[np.random.default_rng(2).random(900) > 0.05]
    counts = [1, *np.rint(np.diff(t) * FPS).astype(int).tolist()]
    np.testing.assert_allclose(steadied(t, counts=counts if counted else None), t, rtol=0, atol=1e-9)


def test_the_stated_variance_is_that_of_the_error():
    rng, squares = np.random.default_rng(3), []
    for _ in range(300):
        t, rhythm = exposures(n=80), Rhythm(1.0 / FPS)
        for raw in t + rng.normal(0.0, 1e-3, len(t)):
            rhythm = steady_stamp(rhythm, raw)
        squares.append((rhythm.stamp - t[-1]) ** 2 / rhythm.stamp_variance)
    assert 0.75 < np.mean(squares) < 1.35


def test_a_late_frame_gets_its_expected_time():
    t = exposures(n=200)
    raw = t.copy()
    raw[[50, 120]] += 0.02
    np.testing.assert_allclose(steadied(raw), t, rtol=0, atol=1e-9)


@pytest.mark.parametrize("gap", [0.1, 0.517, 10.007])
def test_a_pause_of_the_camera_costs_less_than_an_interval(gap):
    """The driver does not count the frames of the pause, and the camera may begin with another phase."""
    t = exposures(n=200)
    t[100:] += gap
    for raw in (t, by_usb(t, np.random.default_rng(4))):
        errors = steadied(raw) - t
        assert np.abs(errors).max() < 1.0 / FPS
        assert np.abs(errors[102:]).max() < PACKETS + 1e-3


def test_a_counter_that_jumps_leaves_the_interval():
    t = exposures(n=200)
    counts = [1] * 200
    counts[100] = 1000
    np.testing.assert_allclose(steadied(t, counts=counts), t, rtol=0, atol=1e-9)


@pytest.mark.parametrize("fps", [7.5, 15.0, 20.0, 25.0, 60.0])
def test_a_camera_that_changes_its_interval_is_followed_from_the_second_frame(fps):
    t = np.concatenate([exposures(n=100), exposures(n=100)[-1] + np.arange(1, 100) / fps])
    stamps = steadied(t)
    np.testing.assert_allclose(np.delete(stamps, 100), np.delete(t, 100), rtol=0, atol=1e-9)


@given(st.lists(st.tuples(st.floats(9.0, 11.0), st.floats(0.0, 0.2), st.integers(1, 1000)), min_size=1, max_size=60))
def test_stamps_increase_and_are_never_ahead_of_the_clock(frames):
    steady, clock, last = SteadyStamps(1.0 / FPS), 10.0, -np.inf
    for raw, step, n in frames:
        clock += step + 1e-6
        stamp = steady.next(raw, clock, n)
        assert last < stamp <= clock
        last = stamp
