"""Losses and the test of significance, against samples with known distributions."""

import numpy as np
import pytest

from spheremouse.evaluation.tuning import CONFIDENCE, LIMIT, MIN_GAIN, compare, losses, scales

FPS = 30.0


def correlated(rng, n, memory=5):
    """Positive losses with the mean 2, of which `memory` adjacent ones share a part."""
    z = rng.normal(size=n + memory)
    smooth = np.convolve(z, np.ones(memory) / np.sqrt(memory), "same")[:n]
    return 2.0 * smooth**2


def test_equal_settings_are_rarely_called_better():
    rng, n, runs = np.random.default_rng(1), 600, 500
    wrong = sum(compare(correlated(rng, n), correlated(rng, n), FPS).significant for _ in range(runs))
    expected = (1.0 - CONFIDENCE) * runs
    assert wrong <= expected + 3.0 * np.sqrt(expected)


def test_a_gain_beyond_chance_is_found_and_a_trivial_one_is_not():
    rng = np.random.default_rng(2)
    present = correlated(rng, 600)
    better = compare(present, 0.7 * present, FPS)
    assert better.significant
    assert better.gain == pytest.approx(0.3)
    assert not compare(present, (1.0 - 0.9 * MIN_GAIN) * present, FPS).significant
    assert not compare(present, 1.3 * present, FPS).significant


def test_a_few_frames_decide_nothing():
    assert not compare(np.full(30, 2.0), np.full(30, 1.0), FPS).significant


def test_frames_without_an_estimate_have_the_limit():
    terms = np.array([[1.0, 3.0], [np.nan, np.nan], [1e9, 0.0], [3.0, 1.0]])
    made = losses(terms, scales(terms[[0, 3]]), missing=2)
    np.testing.assert_allclose(made, [LIMIT, LIMIT, 2.0, LIMIT, LIMIT, 2.0])


def test_without_a_tracked_frame_only_tracking_counts():
    scale = scales(np.full((5, 2), np.nan))
    np.testing.assert_array_equal(losses(np.array([[4.0, 9.0], [np.nan, np.nan]]), scale), [0.0, LIMIT])
