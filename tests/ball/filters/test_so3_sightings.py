"""Hidden discs: probabilities that match how often discs are detected, and repeated misses that count once."""

import numpy as np
import pytest

from spheremouse.ball.filters.so3_settings import ESTABLISHED_HITS, HIDDEN_SHARE
from spheremouse.ball.filters.so3_state import PLACED
from spheremouse.geometry.rotation import exp
from spheremouse.native.kernels import carry_hidden, count_sightings, detection_probability

HORIZON, DISC_ANGLE = 0.25, 0.035
TOWARDS = np.array([0.0, 0.0, 1.0])
VIEWER = TOWARDS, HORIZON, np.zeros((3, 3))  # of a certain attitude
FACING, STILL, NONE = np.array([[0.0, 0.0, 1.0]]), np.zeros(3), np.zeros(0, dtype=np.intp)
DT = 1.0 / 30.0


def probabilities(hidden):
    return detection_probability(np.eye(3), FACING, hidden, VIEWER)


def update_hidden(hidden, seen):
    counts = np.zeros(len(hidden), dtype=np.intp), np.zeros(len(hidden), dtype=np.intp), hidden
    return count_sightings(np.eye(3), FACING, counts, VIEWER, seen, True, DISC_ANGLE)[0][2]


def detected(hidden):
    return probabilities(hidden)[0]


def missed(hidden, rate=STILL):
    hidden = update_hidden(hidden, NONE)
    return carry_hidden(np.eye(3), rate, FACING, hidden, DT, DISC_ANGLE)


def test_the_camera_sees_no_disc_beyond_the_limb():
    cosine = np.linspace(-1.0, 1.0, 201)
    discs = np.stack([np.sqrt(1.0 - cosine**2), np.zeros(201), cosine], axis=1)
    probability = detection_probability(np.eye(3), discs, np.zeros(201), VIEWER)
    assert np.all(np.diff(probability) >= 0.0)
    assert np.all(probability[cosine < HORIZON] < 0.05)
    assert np.all(probability[cosine > HORIZON + 0.25] > 0.9)


@pytest.mark.parametrize("sigma", [0.02, 0.1, 0.3])
def test_detection_at_a_doubtful_attitude_is_the_mean_over_attitudes(sigma):
    cosine = np.linspace(0.0, 0.8, 9)
    discs = np.stack([np.sqrt(1.0 - cosine**2), np.zeros(9), cosine], axis=1)
    P = sigma**2 * np.diag([1.0, 0.5, 0.2])
    turns = exp(np.random.default_rng(0).normal(size=(2000, 3)) * np.sqrt(np.diag(P)))
    mean = np.mean([detection_probability(R, discs, np.zeros(9), VIEWER) for R in turns], axis=0)
    probability = detection_probability(np.eye(3), discs, np.zeros(9), (TOWARDS, HORIZON, P))
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
        hidden = update_hidden(hidden, seen)
    promised, happened = np.array(promised), np.array(happened)
    for low, high in ((0.0, 0.2), (0.2, 0.6), (0.6, 0.9), (0.9, 1.0)):
        there = (promised >= low) & (promised < high)
        if np.count_nonzero(there) > 200:
            sigma = np.sqrt(np.mean(promised[there] * (1.0 - promised[there])) / np.count_nonzero(there))
            assert abs(np.mean(happened[there]) - np.mean(promised[there])) < 4.0 * sigma + 1e-3


def drawn():
    rng = np.random.default_rng(7)
    discs = rng.normal(size=(60, 3))
    counts = rng.integers(0, 6, 60), rng.integers(0, 30, 60), rng.uniform(size=60)
    return exp(rng.normal(size=3)), discs / np.linalg.norm(discs, axis=1, keepdims=True), counts


def test_hidden_discs_are_forgotten_as_they_travel_or_hands_move():
    attitude, discs, (_, _, hidden) = drawn()
    rate = np.array([0.5, -2.0, 1.0])
    speed = np.linalg.norm(np.cross(rate, discs @ attitude.T), axis=1)
    kept = np.exp(-DT * (speed / (2.0 * DISC_ANGLE) + 1.0))
    expected = HIDDEN_SHARE + (hidden - HIDDEN_SHARE) * kept
    np.testing.assert_allclose(carry_hidden(attitude, rate, discs, hidden, DT, DISC_ANGLE), expected, rtol=1e-12)


@pytest.mark.parametrize("may_miss", [True, False])
def test_sightings_are_counted_disc_by_disc(may_miss):
    """Misses count well above the horizon alone; a disc on trial may miss three frames, any other five a sighting."""
    attitude, discs, (hits, missed, hidden) = drawn()
    cosine = discs @ attitude.T @ TOWARDS
    seen = (np.arange(60) % 3 == 0) & (cosine > HORIZON)
    misses = may_miss & ~seen & (cosine > 0.5 + 0.5 * HORIZON)
    p = 0.95 / (1.0 + np.exp(np.minimum((HORIZON + 0.1 - cosine) / 0.03, 30.0))) * (1.0 - hidden)
    np.testing.assert_allclose(detection_probability(attitude, discs, hidden, VIEWER), p, rtol=1e-12)
    counts = hits, missed, hidden
    after, keep, known_seen, known_missed = count_sightings(
        attitude, discs, counts, VIEWER, np.flatnonzero(seen), may_miss, 0.0
    )
    new_hits, new_missed = hits + seen, np.where(seen, 0, missed + misses)
    np.testing.assert_array_equal(after[:2], [new_hits, new_missed])
    np.testing.assert_allclose(after[2], np.where(seen, 0.0, hidden / (1.0 - p)), rtol=1e-12)
    limit = np.where(new_hits < ESTABLISHED_HITS, 3, 5 * new_hits)
    np.testing.assert_array_equal(keep, new_missed < limit)
    known = hits >= ESTABLISHED_HITS
    assert known_seen == np.count_nonzero(seen & known)
    assert known_missed == pytest.approx(p[misses & known].sum(), rel=1e-12)


@pytest.mark.parametrize("sigma", [0.09, 0.11])
def test_a_doubtful_attitude_counts_no_miss(sigma):
    attitude, discs, (hits, missed, hidden) = drawn()
    viewer = TOWARDS, HORIZON, np.diag([0.01, sigma, 0.02]) ** 2
    (_, after, _), *_ = count_sightings(attitude, discs, (hits, missed, hidden), viewer, NONE, True, DISC_ANGLE)
    assert np.any(after > missed) == (sigma < PLACED)


def test_a_disc_on_another_one_leaves_the_map_unless_it_was_seen_more_often():
    attitude, discs, (hits, _, hidden) = drawn()
    discs[7] = exp(np.array([0.0, 0.9 * DISC_ANGLE, 0.0])) @ discs[3]
    counts = hits, np.zeros(len(hits), dtype=np.intp), hidden
    _, keep, *_ = count_sightings(attitude, discs, counts, VIEWER, NONE, False, DISC_ANGLE)
    order = np.argsort(-hits, kind="stable")
    kept = [k for n, k in enumerate(order) if not np.any(discs[order[:n]] @ discs[k] > np.cos(DISC_ANGLE))]
    assert len(kept) < len(discs)
    np.testing.assert_array_equal(np.flatnonzero(keep), np.sort(kept))


def test_a_wrong_argument_is_named():
    attitude, discs, counts = drawn()
    for at, name in enumerate(["hits", "missed", "hidden"]):
        wrong = (*counts[:at], counts[at][1:], *counts[at + 1 :])
        with pytest.raises(TypeError, match=name):
            count_sightings(attitude, discs, wrong, VIEWER, NONE, True, DISC_ANGLE)
    with pytest.raises(IndexError, match="columns"):
        count_sightings(attitude, discs, counts, VIEWER, np.array([60]), True, DISC_ANGLE)
