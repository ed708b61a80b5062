"""The map of discs that outlasts a run: out of the filter's state, back into another, and what that is worth."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from conftest import directions
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2
from so3_world import DT, FILTER, OWN, SETTINGS, draw, follow, points_at, squared
from so3_world import seen as directions_seen

from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.filters.so3 import CandidatePoints, Pairing, relocate
from spheremouse.ball.filters.so3_map import augment, keep_candidates, to_map, with_candidates, with_map
from spheremouse.ball.filters.so3_motion import CLONE_DIM, MAP_OFFSET
from spheremouse.ball.filters.so3_settings import ESTABLISHED_HITS
from spheremouse.ball.filters.so3_state import RIG, inject
from spheremouse.geometry.rotation import exp, log, tangent_basis
from spheremouse.native import kernels
from tests.ball.filters.twins import drawn, linear

DISCS = directions(24, 7, 0.35)
SPIN = np.array([2.0, -0.3, 0.2])


def seen(R, rng):
    return points_at(directions_seen(R, DISCS), rng=rng)


def play(state, rate, n, rng, R, before=None):
    """State and attitude after n frames from attitude R; over the first ten the rate goes from `before` to `rate`."""
    attitudes, before = [], np.asarray(rate if before is None else before)
    for k in range(1, n + 1):
        part = min(k / 10.0, 1.0)
        R = exp((part * np.asarray(rate) + (1.0 - part) * before) * DT) @ R
        attitudes.append(R)
    return follow(FILTER, state, attitudes, state.stamp + np.arange(1, n + 1) * DT, rng, DISCS)[-1], R


@cache
def learnt():
    """A state that has seen all of the ball, and the attitude."""
    rng = np.random.default_rng(0)
    state = FILTER.update(FILTER.initial(0.0, np.eye(3)), seen(np.eye(3), rng))
    state, R = play(state, [0.2, 2.0, 0.3], 110, rng, np.eye(3))
    return play(state, SPIN, 110, rng, R, [0.2, 2.0, 0.3])


def test_the_map_holds_the_discs_seen_often_enough():
    state, _ = learnt()
    assert len(state.discs) == 24
    hits = state.hits.copy()
    hits[[2, 5]] = 2
    known = to_map(state._replace(hits=hits), 3)
    assert known is not None
    keep = np.delete(np.arange(24), [2, 5])
    assert_array_equal(known.directions, state.discs[keep])
    assert_array_equal(known.sightings, hits[keep])
    two = np.flatnonzero(np.repeat(np.isin(np.arange(24), keep), 2))
    assert_allclose(known.covariance, to_map(state, 1).covariance[np.ix_(two, two)], rtol=1e-12)
    assert to_map(state._replace(hits=np.where(np.arange(24) < 3, 9, 0)), 3) is None  # too few to know a ball by
    some = to_map(state._replace(hits=np.where(np.arange(24) < 4, 9, 0)), 3)
    assert some is not None
    assert len(some) == 4


def test_covariance_of_the_map_is_in_the_axes_of_its_directions():
    """Sampled: states moved by drawn errors, their discs against those of the map, along tangent_basis."""
    state, _ = learnt()
    turned = state.basis.copy()  # other axes, as a long run leaves them: the covariance with them
    angle = np.linspace(0.3, 6.0, 24)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]).transpose(2, 0, 1)
    turned = turned @ turn
    T = np.eye(len(state.joint))
    for i in range(24):
        at = MAP_OFFSET + 2 * i
        T[at : at + 2, at : at + 2] = turn[i].T
    state = state._replace(basis=turned, joint=T @ state.joint @ T.T)
    known = to_map(state, 1)
    assert known is not None
    axes = tangent_basis(known.directions)
    rng = np.random.default_rng(1)
    errors = draw(state.joint, rng, 4000)
    samples = [np.einsum("mij,mi->mj", axes, inject(state, e).discs - state.discs).ravel() for e in errors]
    scatter = np.cov(np.array(samples).T)
    sd = np.sqrt(np.diag(known.covariance))
    assert_allclose(scatter / np.outer(sd, sd), known.covariance / np.outer(sd, sd), atol=0.1)
    own = state.joint[MAP_OFFSET:-CLONE_DIM, MAP_OFFSET:-CLONE_DIM] / np.outer(sd, sd)
    assert np.abs(own - known.covariance / np.outer(sd, sd)).max() > 0.3  # in the state's axes it is another matrix


def test_with_map_and_to_map_are_inverses():
    state, _ = learnt()
    known = to_map(state, 1)
    assert known is not None
    fresh = FILTER.initial(5.0, np.eye(3))
    back = to_map(with_map(fresh, known, 1000), 1)
    assert back is not None
    assert_allclose(back.directions, known.directions, atol=1e-15)
    assert_allclose(back.covariance, known.covariance, atol=1e-9 * np.abs(known.covariance).max())
    assert_array_equal(back.sightings, known.sightings)
    assert known.eccentricity_sigma == 0.0  # not significant
    eccentric = replace(known, eccentricity=np.array([1e-3, 0.0, -2e-3]), eccentricity_sigma=1e-4)
    back = to_map(with_map(fresh, eccentric, 1000), 1)
    assert_allclose(back.eccentricity, eccentric.eccentricity)
    assert back.eccentricity_sigma == pytest.approx(1e-4)
    capped = with_map(fresh, known, 50)
    assert capped.hits.max() == 50  # a disc that fell off is dropped in the end
    assert_array_equal(capped.joint[:MAP_OFFSET], np.pad(fresh.joint, [(0, 0), (0, 48)])[:MAP_OFFSET])


@pytest.mark.parametrize("axes", [3, 1])
def test_an_error_that_attitude_and_discs_share_is_never_measured(axes):
    """Pushed again and again while no disc is in view, each time with a large correction: NEES, and the variance."""
    rng, sigma, squares, sigmas = np.random.default_rng(8), 0.08, [], []
    shared = np.diag([0.0, 0.0, 1.0]) if axes == 1 else np.eye(3)
    for _ in range(20):
        R, rate, names = np.eye(3), rng.normal(size=3), []
        state = FILTER.initial(0.0, exp(sigma * shared @ rng.normal(size=3)))
        joint = state.joint.copy()
        joint[:3, :3] = sigma**2 * shared
        state = state._replace(joint=joint)
        for k in range(26):
            interval = (0.2 if k % 5 == 0 else DT) if k else 0.0
            rate = rate + 0.7 * rng.normal(size=3) if k % 5 == 0 else rate
            R = exp(interval * rate) @ R
            which = np.flatnonzero((DISCS @ R.T)[:, 2] > FILTER.station.horizon + 0.1)
            points = points_at(DISCS[which] @ R.T, rng=rng)
            known = np.isin(which, names)
            pairs = Pairing(np.flatnonzero(known), np.array([names.index(i) for i in which[known]], dtype=np.intp))
            state, _ = FILTER.correct(FILTER.predict(state, state.stamp + interval), points, pairs)
            state = augment(state, points, np.flatnonzero(~known), FILTER.station.radius)
            names += which[~known].tolist()
        sigmas.append(np.sqrt(np.trace(state.joint[:3, :3]) / axes))
        squares.append(squared(log(state.attitude @ R.T), state.joint[:3, :3]))
    assert_allclose(np.median(sigmas), sigma, rtol=0.02)
    assert np.sum(squares) < chi2(3 * len(squares)).ppf(0.999)


def test_a_point_in_the_wide_gate_of_a_disc_makes_no_certain_frame():
    """Two discs in their places, and one that may be anywhere along an arc, with a point 3 degrees aside on it."""
    rng, which = np.random.default_rng(3), np.argsort(-DISCS[:, 2])[:3]
    state = FILTER.update(FILTER.initial(0.0, np.eye(3)), points_at(DISCS[which], rng=rng))
    state = FILTER.predict(FILTER.update(state, points_at(DISCS[which], rng=rng)), 1e-3)
    points, free = points_at(DISCS[which], rng=rng), np.zeros(3, dtype=np.bool_)
    assert FILTER.update_if_certain(state, points, free) is not None
    joint, at = state.joint.copy(), state.map_row + 2 * 2
    joint[at, at] += 0.15**2
    wide, aside = state._replace(joint=joint), DISCS[which].copy()
    aside[2] = aside[2] + 0.05 * state.basis[2, :, 0]
    assert FILTER.update_if_certain(wide, points_at(aside, rng=rng), free) is None


def test_a_candidate_measures_the_turn_since_its_first_sighting():
    """40 balls: one known disc, a turn about it while a candidate is in view, and the proof two frames later."""
    rng, squares, twist, known = np.random.default_rng(9), [], [], DISCS[[0]]
    for _ in range(40):
        R = exp(np.cross(DISCS[0], [0.0, 0.0, 1.0])) @ exp(0.1 * rng.normal(size=3))
        state, rate = FILTER.initial(0.0, R), 0.5 * rng.normal(size=3)
        joint = state.joint.copy()
        joint[3:6, 3:6] = 0.5**2 * np.eye(3)
        state = state._replace(joint=joint)
        state = augment(state, points_at(known @ R.T, rng=rng), np.array([0]), FILTER.station.radius)
        aside = exp(0.3 * rng.normal(size=3)) @ np.cross(DISCS[0], rng.normal(size=3))
        other = (known[0] + 0.5 * aside / np.linalg.norm(aside))[None]
        both = np.concatenate([known, other / np.linalg.norm(other)])
        before = state
        for k in range(3):
            points = points_at(both @ R.T, rng=rng)
            state, _ = FILTER.correct(state, points, Pairing(np.array([0]), np.array([0])))
            seen_now = CandidatePoints(np.array([1]), np.array([7]), np.array([k == 2]))
            before, state = state, FILTER.follow_candidates(state, points, seen_now)
            if k < 2:
                assert len(state.discs) == 1
                R = exp(DT * rate) @ R
                state = FILTER.predict(state, state.stamp + DT)
        assert len(state.discs) == 2
        axis = R @ DISCS[0]
        twist.append([np.sqrt(axis @ s.joint[:3, :3] @ axis) for s in (before, state)])
        squares.append(squared(log(state.attitude @ R.T), state.joint[:3, :3]))
    without, with_candidate = np.mean(twist, axis=0)
    assert with_candidate < 0.1 * without
    assert np.sum(squares) < chi2(3 * len(squares)).ppf(0.999)


@pytest.mark.parametrize("centre_moves", [False, True])
def test_the_innovation_of_a_point_that_was_taken_up_is_its_image_noise(centre_moves):
    """It depends on no other error, and so another view measures the motion since."""
    body, points = drawn(4)
    which = np.array([2, 0, 5])
    places, basis, joint = kernels.take_up(body, points, which, centre_moves)
    discs, axes = np.concatenate([body[3], places]), np.concatenate([body[4], basis])
    after = *body[:3], discs, axes, joint, *body[6:8], len(discs), *body[9:]
    old = np.delete(np.arange(len(joint)), MAP_OFFSET + 24 + np.arange(6))
    assert_allclose(joint[np.ix_(old, old)], body[5], rtol=0, atol=0)
    assert_allclose(joint, joint.T, rtol=0, atol=0)
    assert_allclose(basis.transpose(0, 2, 1) @ places[:, :, None], 0.0, atol=1e-15)
    for k, i in enumerate(which):
        z, H, noise = linear(after, points, i, 12 + k)
        rig_covariance = H[:, RIG] @ joint[RIG, RIG] @ H[:, RIG].T
        noise += 0.0 if centre_moves else np.trace(rig_covariance) ** 2 * np.eye(2)
        assert_allclose(z, 0.0, atol=1e-15)
        assert_allclose(H @ joint @ H.T, noise, rtol=1e-9, atol=1e-18)
        assert_allclose(H @ joint[:, old], 0.0, atol=1e-12 * np.sqrt(joint.max()))


def test_a_candidate_moves_nothing_and_leaves_no_trace():
    """Two films, one with a candidate in view that is never proven: the same attitude, map and covariance."""
    (plain, R), rng = learnt(), np.random.default_rng(3)
    place = points_at(np.array([[0.1, 0.2, 0.97]]), rng=rng)
    followed = with_candidates(plain, place, np.array([0]), np.array([3]), FILTER.station.radius)
    plain, followed = (play(s, SPIN, 20, np.random.default_rng(4), R)[0] for s in (plain, followed))
    assert len(followed.candidates) == 1
    followed = keep_candidates(followed, np.zeros(0, dtype=int))
    for name in ("attitude", "rate", "discs", "joint", "hits", "missed"):
        assert_allclose(getattr(followed, name), getattr(plain, name), rtol=1e-9, atol=1e-12, err_msg=name)


@pytest.mark.parametrize("rate", [None, SPIN])
def test_a_filter_started_from_a_map_goes_on_as_well_as_before(rate):
    """Another run, another attitude, found to 3 mrad: as near to the truth, and as certain of it, as had it gone on."""
    before, R = learnt()
    known = to_map(before, ESTABLISHED_HITS)
    assert known is not None
    rng = np.random.default_rng(3)
    found = exp(3e-3 * rng.normal(size=3)) @ R
    state = with_map(FILTER.initial(50.0, np.eye(3)), known, 1000)
    state = relocate(state, found, 9e-6 * np.eye(3), SETTINGS, 50.0, rate)
    after, R_after = play(state, SPIN, 45, np.random.default_rng(4), R)
    went, R_went = play(before, SPIN, 45, np.random.default_rng(4), R)
    assert_allclose(R_after, R_went, atol=1e-12)
    assert len(after.discs) == len(went.discs) == 24
    error = [np.linalg.norm(log(s.attitude @ R_went.T)) for s in (after, went)]
    assert error[0] < error[1] + 2e-4
    sd = [np.sqrt(np.diag(s.joint)[:6]) for s in (after, went)]
    assert_allclose(sd[0], sd[1], rtol=0.15)
    assert_allclose(after.rate, went.rate, atol=0.01)


def test_attitudes_from_a_saved_map_are_as_certain_as_they_say():
    """90 maps drawn from one covariance, each found at another attitude: chi-square of the attitude, 95 % band."""
    known = to_map(learnt()[0], 1)
    assert known is not None
    rng = np.random.default_rng(5)
    axes = tangent_basis(DISCS)
    covariance = known.covariance[:48, :48] + 1e-7 * np.eye(48)
    runs, squares = 90, []
    for _ in range(runs):
        wrong = DISCS + np.einsum("mij,mj->mi", axes, draw(covariance, rng, 1).reshape(24, 2))
        wrong /= np.linalg.norm(wrong, axis=1, keepdims=True)
        saved = DiscMap(wrong, covariance, np.full(24, 100))
        R = exp(rng.normal(size=3))
        state = with_map(OWN.initial(0.0, np.eye(3)), saved, 1000)
        state = relocate(state, exp(3e-3 * rng.normal(size=3)) @ R, 9e-6 * np.eye(3), OWN.settings, 0.0, np.zeros(3))
        for k in range(12):
            state = OWN.update(OWN.predict(state, k * DT), seen(R, rng))
        e = log(R @ state.attitude.T)
        squares.append(squared(e, state.joint[:3, :3]))
    low, high = chi2.ppf([0.025, 0.975], 3 * runs) / runs
    assert low < np.mean(squares) < high


def test_an_attitude_that_the_discs_share_weakens_no_sighting():
    """Discs founded at an attitude that is off by an unknown turn: the next frames show the rate as exactly."""
    outcomes, discs = [], DISCS[np.argsort(-DISCS[:, 2])[:3]]
    for sigma in (1e-4, 0.15):
        rng, start = np.random.default_rng(3), FILTER.initial(0.0, np.eye(3))
        joint = start.joint.copy()
        joint[:3, :3] = sigma**2 * np.eye(3)
        points = points_at(discs, rng=rng)
        state, total = augment(start._replace(joint=joint), points, np.arange(3), FILTER.station.radius), 0.0
        for k in range(1, 9):
            points = points_at(discs @ exp(SPIN * k * DT).T, rng=rng)
            state = FILTER.predict(state, k * DT)
            state, value = FILTER.correct(state, points, Pairing(np.arange(3), np.arange(3)))
            total += value if k > 4 else 0.0  # before, the rate is unknown
        outcomes.append((total, np.sqrt(np.trace(state.joint[3:6, 3:6])), *(state.rate - SPIN)))
    assert_allclose(outcomes[1][0], outcomes[0][0], atol=1.0)
    assert_allclose(outcomes[1][1], outcomes[0][1], rtol=0.1)
    assert_allclose(outcomes[1][2:], outcomes[0][2:], atol=0.02)
