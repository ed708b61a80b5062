"""The resampled pointer: what it is measured by against independent truth."""

from itertools import pairwise

import numpy as np
import pytest
from experiments import pointer
from experiments.pointer import Path, latency

from spheremouse.geometry.rotation import log
from spheremouse.output.counts import MotionSettings, Remainder, to_counts
from spheremouse.simulate.ball.profile import play

MATRIX = MotionSettings().matrix(0.6)


@pytest.fixture(scope="module")
def motion():
    return play(9.0, np.random.default_rng(3))


def exact(motion, stamps):
    R, remainder, counts = motion.attitude(stamps), Remainder(), [(0, 0, 0)]
    for a, b in pairwise(R):
        moved, remainder = to_counts(log(b @ a.T), MATRIX, remainder)
        counts.append(moved)
    return pointer.Told(stamps, np.array(counts), motion.rate(stamps) @ MATRIX.T, np.ones(len(stamps), dtype=bool))


@pytest.fixture(scope="module")
def told(motion):
    return exact(motion, np.arange(1.0, 270.0) / 30.0)


@pytest.fixture(scope="module")
def true(motion):
    return pointer.ball(motion, 8.9, MATRIX)


def shifted(true, seconds):
    return np.stack([np.interp(true.t - seconds, true.t, true.place[:, k]) for k in range(3)], axis=1)


def test_the_path_is_that_of_the_counts(motion, told, true):
    sums = np.cumsum(told.counts, axis=0)
    at = np.stack([np.interp(told.stamp, true.t, true.place[:, k]) for k in range(3)], axis=1)
    kept = told.stamp < true.t[-1]
    turned = np.array([[0.5, 0.5, 0.5]])  # half a count of rounding, and turns that do not commute
    assert np.all(np.abs(sums - at)[kept] < turned + 0.01 * np.abs(at).max())


@pytest.mark.parametrize("late", [0.0, 0.0137, 0.08])
def test_a_delay_is_found_to_a_millisecond(true, late):
    assert pointer.delay(shifted(true, late), true) == pytest.approx(1e3 * late, abs=1.0)


def test_without_resampling_counts_come_as_frames_arrive(told, true):
    shown = pointer.pointer(told, 30.0, None, true.t)
    k = 100
    arrival = told.stamp[k] + latency(30.0)
    after = int(np.searchsorted(true.t, arrival + 1e-6))
    assert np.array_equal(shown[after], told.counts[: k + 1].sum(axis=0))
    assert np.array_equal(shown[after - 1], told.counts[:k].sum(axis=0))


def test_without_resampling_the_pointer_is_late_by_latency_and_half_a_frame(told, true):
    shown = pointer.pointer(told, 30.0, None, true.t)
    expected = 1e3 * (latency(30.0) + 0.5 / 30.0)
    assert pointer.measured(shown, true, 1.2)["delay"] == pytest.approx(expected, abs=2.0)


def test_distance_and_roughness_are_what_they_say():
    t = 0.004 * np.arange(200.0)
    true = Path(t, np.zeros((200, 3)))
    shown = np.zeros((200, 3))
    shown[:, 0] = np.where(np.arange(200) % 2, 1.0, -1.0)
    found = pointer.measured(shown, true, 0.1)
    assert found["off"] == pytest.approx(1.0)
    assert found["rough"] == pytest.approx(4.0 / np.sqrt(3.0))
