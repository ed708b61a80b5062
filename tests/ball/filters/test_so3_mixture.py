"""Several attitudes at once: what a frame of few discs leaves possible, weighed and carried on."""

from copy import deepcopy
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from ball_world import DT, POSE, RIG, photo
from conftest import directions, seeds
from so3_world import FILTER

from spheremouse.ball.build import begin, build
from spheremouse.ball.filters.so3 import Pairing
from spheremouse.ball.filters.so3_mixture import Hypothesis, update_hypotheses
from spheremouse.ball.filters.so3_settings import PERSISTENCE_S, usual_acceleration
from spheremouse.ball.points import intersect
from spheremouse.ball.settings import Settings
from spheremouse.ball.track import advance, with_settings
from spheremouse.geometry.rotation import exp, log
from spheremouse.simulate.ball.profile import play
from spheremouse.tracker import Status


@cache
def _known_ball(number, seed):
    rng, discs = np.random.default_rng(seed), directions(number, seed)
    tracker = build(RIG, POSE, Settings())
    state = begin(tracker, 0.0)
    for k in range(241):
        turn = exp(np.array([2.0 * np.pi, 0.0, 0.0]) * min(k / 120.0, 1.0))
        R = exp(np.array([0.0, 2.0 * np.pi, 0.0]) * max(k / 120.0 - 1.0, 0.0)) @ turn
        state = advance(state, k * DT, photo(R, rng, discs), tracker).state
    return tracker, state, discs, rng


def known_ball(number, seed):
    """The filter, its state after each disc was seen from many sides, the discs, and a generator of random numbers."""
    return *_known_ball(number, seed)[:3], deepcopy(_known_ball(number, seed)[3])


def at_rest(tracker, state, discs, rng):
    """The state after a second of rest."""
    start = state.filter.stamp
    for k in range(30):
        state = advance(state, start + (k + 1) * DT, photo(np.eye(3), rng, discs), tracker).state
    return state


def doubtful(state, axis, sigma, stamp):
    """A state whose attitude is uncertain by `sigma` rad about `axis`."""
    joint = state.joint.copy()
    joint[:3] = joint[:, :3] = 0.0
    joint[:3, :3] = 1e-6 * np.eye(3) + sigma**2 * np.outer(axis, axis)
    return state._replace(joint=joint, stamp=stamp)


@pytest.mark.parametrize("seed", seeds(2, 6))
def test_probabilities_sum_to_one_and_the_most_probable_comes_first(seed):
    tracker, state, discs, rng = known_ball(26, seed)
    prior = doubtful(state.filter, np.array([0.0, 0.0, 1.0]), 0.5, state.filter.stamp)
    points = intersect(photo(exp(np.array([0.0, 0.0, 0.4])), rng, discs).take(np.array([0])), RIG, POSE)
    made = update_hypotheses(tracker.filter, (Hypothesis(prior, 0.0),), points, np.zeros(1, dtype=bool))
    logs = np.array([h.log_probability for h in made])
    assert np.exp(logs).sum() == pytest.approx(1.0, abs=1e-9)
    assert np.all(np.diff(logs) <= 0.0)
    assert len(made) > 1  # one disc of 26, half a radian of doubt: no single answer


@pytest.mark.parametrize("seed", seeds(2, 6))
def test_a_doubt_about_one_axis_ends_when_three_discs_are_seen(seed):
    tracker, state, discs, rng = known_ball(12, seed)
    true = exp(np.array([0.0, 0.0, 0.6]))
    seen = photo(true, rng, discs)
    if len(seen) < 3:
        pytest.skip("this ball shows fewer than three discs here")
    prior = doubtful(state.filter, np.array([0.0, 0.0, 1.0]), 0.5, state.filter.stamp)
    points = intersect(seen, RIG, POSE)
    made = update_hypotheses(tracker.filter, (Hypothesis(prior, 0.0),), points, np.zeros(len(points), dtype=bool))
    assert made[0].log_probability > np.log(0.99)
    assert np.linalg.norm(log(made[0].state.attitude @ true.T)) < 0.03


def test_an_estimate_in_doubt_has_the_covariance_of_all_hypotheses():
    """Drawn from the hypotheses, attitudes and rates scatter about the reported ones as its covariance says."""
    tracker, state, discs, rng = known_ball(12, 1)
    state = at_rest(tracker, state, discs, rng)
    turned = state.filter._replace(attitude=exp(np.array([0.0, 0.0, 0.2])) @ state.filter.attitude)
    state = state._replace(alternatives=(Hypothesis(turned, np.log(0.4)),))
    none = photo(np.eye(3), rng, discs).take(np.zeros(0, dtype=np.intp))
    done = advance(state, state.filter.stamp + DT, none, tracker)
    others = done.state.alternatives
    assert others
    states = [done.state.filter, *(h.state for h in others)]
    p = np.exp([h.log_probability for h in others])
    drawn = []
    for k in rng.choice(len(states), 20000, p=np.append(1.0 - p.sum(), p)):
        error = rng.multivariate_normal(np.zeros(6), states[k].covariance)
        attitude = exp(error[:3]) @ states[k].attitude
        drawn.append(np.append(log(attitude @ states[0].attitude.T), states[k].rate + error[3:] - states[0].rate))
    scatter, rows = np.mean([np.outer(d, d) for d in drawn], axis=0), np.r_[:3, 6:9]
    covariance = done.estimate.covariance[np.ix_(rows, rows)]
    sigma = np.sqrt(covariance.diagonal())
    assert np.abs((scatter - covariance) / np.outer(sigma, sigma)).max() < 0.05


def test_a_certain_frame_keeps_one_hypothesis():
    tracker, state, discs, rng = known_ball(26, 1)
    for k in range(30):
        R = exp(np.array([0.3, 0.2, 0.5]) * k * DT)
        state = advance(state, (241 + k) * DT, photo(R, rng, discs), tracker).state
        assert state.alternatives == ()


def test_a_ball_that_passes_through_an_attitude_is_none_that_rests_there():
    tracker, state, discs, rng = known_ball(12, 1)
    state = at_rest(tracker, state, discs, rng)
    rests = tracker.filter.predict(state.filter, state.filter.stamp + DT)
    predicted = [
        Hypothesis(rests._replace(rate=np.array([0.0, 0.0, rate])), np.log(probability))
        for rate, probability in ((8.0, 0.6), (0.0, 0.4))
    ]
    points = intersect(photo(np.eye(3), rng, discs).take(np.zeros(0, dtype=np.intp)), RIG, POSE)
    made = update_hypotheses(tracker.filter, tuple(predicted), points, np.zeros(0, dtype=bool))
    assert [round(h.state.rate[2]) for h in made] == [8, 0]


@pytest.mark.parametrize("seed", seeds(3, 8))
def test_a_ball_with_ten_discs_is_followed_by_what_is_in_view(seed):
    """Two discs and fewer for much of the time; the attitude stays the right one, and its covariance says how well."""
    rng = np.random.default_rng(seed)
    discs = directions(10, seed)
    tracker = build(RIG, POSE, Settings())
    state, errors, lost = begin(tracker, 0.0), [], 0
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    start = None
    for k in range(300):
        t = k * DT
        R = exp(axis * 1.2 * np.sin(0.9 * t)) @ exp(np.roll(axis, 1) * 0.6 * np.sin(0.5 * t))
        seen = photo(R, rng, discs)
        state = advance(state, t, seen, tracker).state
        if state.status is Status.TRACKING and start is None:
            start = state.filter.attitude.T @ R
        if start is not None:
            lost += state.status is not Status.TRACKING and len(seen) >= 2
            errors.append(log(state.filter.attitude @ start @ R.T))
    P = state.filter.covariance[:3, :3] + 1e-8 * np.eye(3)
    assert lost <= 3
    assert errors[-1] @ np.linalg.solve(P, errors[-1]) < 25.0


@pytest.mark.parametrize(
    ("levels", "kept"),
    [(Settings().so3.levels, True), ((1.0, 3.0, 9.0, 27.0, 81.0, 243.0), False), ((1.0, 8.0), False)],
)
def test_other_levels_start_at_their_prior_also_if_they_are_as_many(levels, kept):
    """Between two frames, while several attitudes are possible."""
    tracker, state, discs, rng = known_ball(12, 2)
    state = state._replace(alternatives=(Hypothesis(state.filter, np.log(0.3)),))
    settings = Settings(so3=replace(Settings().so3, levels=levels, gate=12.0))
    changed, tracker = with_settings(state, tracker, settings)
    for filtered in (changed.filter, changed.alternatives[0].state):
        assert (len(filtered.weights) > 0) == kept
    for k in range(3):
        changed = advance(changed, (241 + k) * DT, photo(np.eye(3), rng, discs), tracker).state
    assert changed.status is Status.TRACKING


@pytest.mark.parametrize("seed", seeds(2, 4))
def test_a_slow_camera_leaves_no_doubt_about_a_resting_ball_that_shows_five_discs(seed):
    """At three frames/s the prediction is a guess. The constellation is none."""
    tracker, state, discs, rng = known_ball(26, seed)
    state, seen = at_rest(tracker, state, discs, rng), photo(np.eye(3), rng, discs)
    assert len(seen) >= 5
    predicted = tracker.filter.predict(state.filter, state.filter.stamp + 0.4)
    certain = tracker.filter.update_if_certain(predicted, intersect(seen, RIG, POSE), np.zeros(len(seen), dtype=bool))
    assert certain is not None
    assert np.linalg.norm(log(certain.attitude)) < 0.005


@pytest.mark.parametrize("seed", seeds(2, 4))
def test_a_ball_whose_one_disc_stands_still_is_at_rest(seed):
    """For seconds: a turn hardly ever goes about the one disc in view."""
    tracker, state, discs, rng = known_ball(12, seed)
    state = at_rest(tracker, state, discs, rng)
    stamp = state.filter.stamp
    for k in range(150):
        seen = photo(np.eye(3), rng, discs)
        seen = seen.take(np.arange(max(len(seen) - k // 10, 1)))  # the others go one by one
        state = advance(state, stamp + (k + 1) * DT, seen, tracker).state
    error, P = log(state.filter.attitude), state.filter.joint[:3, :3]
    assert state.filter.is_placed
    assert error @ np.linalg.solve(P, error) < 16.3  # chi-square, 99.9 % of three
    assert state.status is Status.TRACKING


@pytest.mark.parametrize("sigma", [0.0, 1.0])
def test_one_disc_leaves_a_known_twist_alone(sigma):
    """Also one that a push made uncertain, as long as its direction is known."""
    tracker, state, discs, rng = known_ball(12, 2)
    axis = state.filter.attitude @ discs[np.argmax(discs @ state.filter.attitude[2])]
    joint = state.filter.joint.copy()
    joint[3:6, 3:6] += sigma**2 * np.outer(axis, axis)
    turning = state.filter._replace(rate=2.0 * axis, joint=joint, modes=None)
    column = int(np.argmax(turning.discs @ (turning.attitude.T @ axis)))
    predicted = tracker.filter.predict(turning, turning.stamp + DT)
    points = intersect(photo(predicted.attitude, rng, discs), RIG, POSE)
    which = int(np.argmax(points.direction @ axis))
    corrected, _ = tracker.filter.correct(predicted, points, Pairing(np.array([which]), np.array([column])))
    assert abs(corrected.rate @ axis - 2.0) < 0.1


def _two_in_view(seed):
    """The filter, a state at rest whose map has two discs in view, their directions, and a random generator."""
    rng = np.random.default_rng(seed)
    towards = (POSE.position - RIG.ball.centre) / np.linalg.norm(POSE.position - RIG.ball.centre)
    discs = np.stack([towards, exp(np.array([0.5, 0.0, 0.0])) @ towards])  # the camera is above
    tracker = build(RIG, POSE, Settings())
    state = begin(tracker, 0.0)
    for k in range(60):
        state = advance(state, k * DT, photo(np.eye(3), rng, discs), tracker).state
    return tracker.filter, state.filter, discs, rng


@pytest.mark.parametrize("seed", range(3))
def test_a_push_from_rest_about_one_of_two_discs_remains_possible(seed):
    """The other disc is then far from where the ball at rest would show it, and no second disc beside it."""
    filter_, state, discs, rng = _two_in_view(seed)
    points = intersect(photo(exp(0.015 * discs[0]), rng, discs), RIG, POSE)  # 27 rad/s² for a thirtieth of a second
    predicted = filter_.predict(state, state.stamp + DT)
    made = update_hypotheses(filter_, (Hypothesis(predicted, 0.0),), points, np.zeros(2, dtype=bool))
    assert any(len(h.state.used) == 2 for h in made)


def test_a_pair_in_a_wide_gate_is_not_certain():
    """A false point near the uncertain place of a disc would turn the ball."""
    filter_, state, discs, rng = _two_in_view(0)
    none = np.zeros(2, dtype=bool)
    for sigma, certain in ((1e-3, True), (0.05, False)):
        doubt = state.joint.copy()
        doubt[:3, :3] += sigma**2 * np.outer(discs[0], discs[0])
        predicted = filter_.predict(state._replace(joint=doubt, modes=None), state.stamp + DT)
        points = intersect(photo(exp(sigma * discs[0]), rng, discs), RIG, POSE)
        assert (filter_.update_if_certain(predicted, points, none) is not None) == certain


@pytest.mark.parametrize(("number", "seed"), [(8, 2), (8, 35), (14, 23)])
def test_a_turn_about_the_one_disc_in_view_is_found_when_another_comes_into_view(number, seed):
    rng, discs = np.random.default_rng(100 * seed + number), directions(number, 100 * seed + number)
    motion, tracker, first = play(10.0, np.random.default_rng([seed, 2])), build(RIG, POSE, Settings()), None
    state, errors = begin(tracker, 0.0), []
    for t in np.arange(300) * DT:
        R = motion.attitude(np.array([t]))[0]
        state = advance(state, t, photo(R, rng, discs), tracker).state
        if first is None and state.status is Status.TRACKING:
            first = state.filter.attitude.T @ R  # the tracker's axes are those of this frame
        if first is not None and state.confirmed:
            error = np.linalg.norm(log(state.filter.attitude @ first @ R.T))
            errors.append((error, np.sqrt(np.trace(state.filter.joint[:3, :3]))))
    error, sigma = np.transpose(errors)
    assert len(errors) > 100
    assert np.mean((error > 4.0 * sigma) & (error > np.radians(2.0))) < 0.02


def test_a_turn_that_no_disc_has_shown_is_as_uncertain_as_a_random_walk_of_the_rate():
    rng, steps, duration = np.random.default_rng(0), 200, 0.2
    axis = np.array([0.6, 0.0, 0.8])
    state = FILTER.initial(0.0, np.eye(3))
    known = state._replace(joint=np.zeros_like(state.joint))
    density = 2.0 * PERSISTENCE_S * usual_acceleration(FILTER.settings) ** 2
    rate = np.cumsum(rng.normal(0.0, np.sqrt(density * duration / steps), (20000, steps)), axis=1)
    turn = rate.sum(axis=1) * duration / steps
    expected = np.cov(np.column_stack([turn, rate[:, -1]]).T)
    found = FILTER.with_unseen_turn(known, axis, duration).joint[:6, :6]
    lift = np.kron(np.eye(2), axis[:, None])
    assert lift.T @ found @ lift == pytest.approx(expected, rel=0.04)
    assert found == pytest.approx(lift @ (lift.T @ found @ lift) @ lift.T, abs=1e-12)


def test_an_update_takes_nothing_from_motion_about_an_axis_that_a_frame_did_not_show():
    axis = np.array([0.6, 0.0, 0.8])
    across, (tracker, state, discs, rng) = np.eye(3) - np.outer(axis, axis), known_ball(26, 1)
    f, before = tracker.filter, doubtful(state.filter, axis, 0.05, state.filter.stamp)
    predicted = f.predict(before._replace(rate=0.3 * axis), before.stamp + DT)
    updated = f.update(predicted, intersect(photo(exp(np.array([0.01, 0.02, 0.03])), rng, discs), RIG, POSE))
    assert axis @ updated.joint[:3, :3] @ axis < 0.1 * axis @ predicted.joint[:3, :3] @ axis
    kept = f.without_unseen_axes(updated, predicted, across)
    for part in (slice(0, 3), slice(3, 6)):
        assert axis @ kept.joint[part, part] @ axis >= axis @ predicted.joint[part, part] @ axis - 1e-12
        same = across @ (kept.joint[part, part] - updated.joint[part, part]) @ across
        assert same == pytest.approx(0.0, abs=1e-3 * np.trace(updated.joint[part, part]))
    assert np.linalg.eigvalsh(kept.joint).min() > -1e-12
    assert axis @ log(kept.attitude @ predicted.attitude.T) == pytest.approx(0.0, abs=1e-6)
    assert across @ log(kept.attitude @ updated.attitude.T) == pytest.approx(0.0, abs=2e-4)  # second order
    assert axis @ kept.rate == pytest.approx(np.exp(-DT) * axis @ predicted.rate)
    for _ in range(600):  # what nothing shows tends to what is known of any player
        predicted = f.predict(kept, kept.stamp + DT)
        kept = f.without_unseen_axes(predicted, predicted, across)
    sigma = f.settings.start_rate_sigma
    assert abs(axis @ kept.rate) < 1e-6
    assert axis @ kept.joint[3:6, 3:6] @ axis > sigma**2
    assert axis @ kept.joint[3:6, 3:6] @ axis < 4.0 * (sigma**2 + usual_acceleration(f.settings) ** 2)
