"""Hidden discs: probabilities that match how often discs are detected, and repeated misses that count once."""

import numpy as np
import pytest

from spheremouse.ball.filters.so3_sightings import HIDDEN_SHARE, carry_hidden, detection_probability, update_hidden
from spheremouse.geometry.rotation import exp

TOWARDS, HORIZON, DISC_ANGLE = np.array([0.0, 0.0, 1.0]), 0.25, 0.035
CERTAIN = np.zeros((3, 3))
FACING, STILL, NONE = np.array([[0.0, 0.0, 1.0]]), np.zeros(3), np.zeros(0, dtype=np.intp)
DT = 1.0 / 30.0


def probabilities(hidden):
    return detection_probability(np.eye(3), CERTAIN, FACING, hidden, TOWARDS, HORIZON)


def detected(hidden):
    return probabilities(hidden)[0]


def missed(hidden, rate=STILL):
    hidden = update_hidden(hidden, probabilities(hidden), NONE)
    return carry_hidden(np.eye(3), rate, FACING, hidden, DT, DISC_ANGLE)


def test_the_camera_sees_no_disc_beyond_the_limb():
    cosine = np.linspace(-1.0, 1.0, 201)
    discs = np.stack([np.sqrt(1.0 - cosine**2), np.zeros(201), cosine], axis=1)
    probability = detection_probability(np.eye(3), CERTAIN, discs, np.zeros(201), TOWARDS, HORIZON)
    assert np.all(np.diff(probability) >= 0.0)
    assert np.all(probability[cosine < HORIZON] < 0.05)
    assert np.all(probability[cosine > HORIZON + 0.25] > 0.9)


@pytest.mark.parametrize("sigma", [0.02, 0.1, 0.3])
def test_detection_at_a_doubtful_attitude_is_the_mean_over_attitudes(sigma):
    cosine = np.linspace(0.0, 0.8, 9)
    discs = np.stack([np.sqrt(1.0 - cosine**2), np.zeros(9), cosine], axis=1)
    P = sigma**2 * np.diag([1.0, 0.5, 0.2])
    turns = exp(np.random.default_rng(0).normal(size=(2000, 3)) * np.sqrt(np.diag(P)))
    mean = np.mean([detection_probability(R, CERTAIN, discs, np.zeros(9), TOWARDS, HORIZON) for R in turns], axis=0)
    probability = detection_probability(np.eye(3), P, discs, np.zeros(9), TOWARDS, HORIZON)
    np.testing.assert_allclose(probability, mean, atol=0.05)  # a twentieth: to first order


def test_a_disc_hidden_from_a_resting_ball_counts_once():
    """However long it is missed, it costs no more nats than a few surprises."""
    hidden, cost = np.zeros(1), []
    for _ in range(300):
        cost.append(-np.log1p(-detected(hidden)))
        hidden = missed(hidden)
    assert sum(cost[:5]) > 3.0
    assert sum(cost[5:35]) < 1.0  # a second


def test_a_disc_that_travels_may_reappear():
    hidden = np.ones(1)
    for _ in range(10):
        hidden = missed(hidden, np.array([1.0, 0.0, 0.0]))
    turning = detected(hidden)
    hidden = np.ones(1)
    for _ in range(10):
        hidden = missed(hidden)
    assert turning > 5.0 * detected(hidden)


def test_without_observation_the_share_of_all_hidden_discs_remains():
    hidden = carry_hidden(np.eye(3), STILL, np.repeat(FACING, 2, axis=0), np.array([0.0, 1.0]), 100.0, DISC_ANGLE)
    np.testing.assert_allclose(hidden, HIDDEN_SHARE, atol=1e-6)


@pytest.mark.parametrize("speed", [0.0, 0.5])
def test_the_probability_is_how_often_a_disc_is_detected(speed):
    """The chain sampled: of the frames that promise a detection with some probability, that share has one."""
    rng, rate = np.random.default_rng(5), np.array([speed, 0.0, 0.0])
    visible_detected = detected(np.zeros(1))
    leave = 1.0 - carry_hidden(np.eye(3), rate, FACING, np.ones(1), DT, DISC_ANGLE)[0]
    enter = carry_hidden(np.eye(3), rate, FACING, np.zeros(1), DT, DISC_ANGLE)[0]
    promised, happened = [], []
    lies_behind, hidden = False, np.full(1, HIDDEN_SHARE)
    for _ in range(40_000):
        lies_behind = rng.random() > leave if lies_behind else rng.random() < enter
        hidden = carry_hidden(np.eye(3), rate, FACING, hidden, DT, DISC_ANGLE)
        promised.append(detected(hidden))
        happened.append(not lies_behind and rng.random() < visible_detected)
        seen = np.zeros(1, dtype=np.intp) if happened[-1] else NONE
        hidden = update_hidden(hidden, probabilities(hidden), seen)
    promised, happened = np.array(promised), np.array(happened)
    for low, high in ((0.0, 0.2), (0.2, 0.6), (0.6, 0.9), (0.9, 1.0)):
        there = (promised >= low) & (promised < high)
        if np.count_nonzero(there) > 200:
            sigma = np.sqrt(np.mean(promised[there] * (1.0 - promised[there])) / np.count_nonzero(there))
            assert abs(np.mean(happened[there]) - np.mean(promised[there])) < 4.0 * sigma + 1e-3
