"""A ball that turns about another point than its centre."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from so3_world import DT, FILTER, RADIUS, SIGMA, points_at, seen

from spheremouse.ball.filters.so3_eccentric import ECCENTRIC_SIGMA, as_eccentric
from spheremouse.ball.filters.so3_state import ECCENTRICITY, RIG
from spheremouse.geometry.rotation import exp, log

FRAMES = 150
E = 2e-3 * np.array([0.6, -0.5, 0.7])  # m


def rolls():
    """Return the attitudes of a ball that turns about changing axes."""
    R = np.eye(3)
    for k in range(FRAMES):
        yield R
        R = exp(DT * np.array([1.5 * np.cos(0.02 * k), 1.0, 1.5 * np.sin(0.03 * k)])) @ R


def frames_of(eccentricity, seed):
    """Yield attitude and points of each frame, for parallel rays along z, which show x and y of a point."""
    rng, along = np.random.default_rng(seed), np.array([0.0, 0.0, 1.0])
    for R in rolls():
        xy = (seen(R) + R @ eccentricity / RADIUS)[:, :2]
        direction = np.column_stack([xy, np.sqrt(1.0 - np.sum(xy**2, axis=1))])
        points = points_at(direction, rng=rng)
        slide = np.eye(3) - along[:, None] * points.direction[:, None] / points.direction[:, 2, None, None]
        focal = np.zeros((len(xy), 3, 1))
        yield R, replace(points, ddirection_drig=np.concatenate([focal, -slide / RADIUS], axis=2))


def tracked(start, frames, adopt=-1):
    """Return the states after each frame; frame `adopt` is the first that may show an eccentric ball."""
    state, states = start, []
    for k, (_, points) in enumerate(frames):
        state = FILTER.update(FILTER.predict(state, k * DT), points)
        if 0 <= adopt <= k:
            state = as_eccentric(state, RADIUS) or state
        states.append(state)
    return states


def attitude_error(state, R):
    return np.linalg.norm(log(state.attitude @ R.T))


def eccentric_from_the_start():
    state = FILTER.initial(0.0, np.eye(3))
    joint = state.joint.copy()
    joint[ECCENTRICITY, ECCENTRICITY] = (ECCENTRIC_SIGMA * RADIUS) ** 2 * np.eye(3)
    return state._replace(joint=joint)


@pytest.mark.parametrize("adopt", [60, 120])
def test_a_late_discovery_ends_where_an_early_one_does(adopt):
    """The state at the end is that of a filter that had the prior of an eccentric ball from the first frame on.

    The eccentricity is so small that each disc stays in its gate.
    """
    frames = list(frames_of(0.3 * E, 1))
    late, early = tracked(FILTER.initial(0.0, np.eye(3)), frames, adopt), tracked(eccentric_from_the_start(), frames)
    assert np.linalg.norm(late[adopt - 1].eccentricity) < 0.05 * np.linalg.norm(E)
    sd = np.sqrt(np.diag(early[-1].joint))[:6]
    assert_allclose(log(late[-1].attitude @ early[-1].attitude.T) / sd[:3], 0.0, atol=0.3)
    of_e = np.sqrt(np.diag(early[-1].joint[ECCENTRICITY, ECCENTRICITY]))
    assert_allclose((late[-1].eccentricity - early[-1].eccentricity) / of_e, 0.0, atol=0.3)
    assert_allclose(np.sqrt(np.diag(late[-1].joint))[:6] / sd, 1.0, atol=0.1)


def test_the_eccentricity_is_found_and_the_attitude_is_right():
    frames = list(frames_of(E, 2))
    with_it = tracked(FILTER.initial(0.0, np.eye(3)), frames, 0)[-1]
    without = tracked(FILTER.initial(0.0, np.eye(3)), frames)[-1]
    sigma = np.sqrt(np.diag(with_it.joint[ECCENTRICITY, ECCENTRICITY]))
    assert np.abs(with_it.eccentricity - E).max() < 4.0 * sigma.max() < 5e-4
    R = frames[-1][0]
    assert attitude_error(with_it, R) < min(0.3 * attitude_error(without, R), 2.0 * SIGMA)


@pytest.mark.parametrize("seed", range(8))
def test_a_round_ball_stays_round(seed):
    states = tracked(FILTER.initial(0.0, np.eye(3)), frames_of(np.zeros(3), seed), 0)
    assert np.trace(states[-1].joint[ECCENTRICITY, ECCENTRICITY]) < 4.0 * (1e-5 * RADIUS) ** 2


def test_an_update_holds_what_the_prior_of_the_rig_holds():
    """The place that the bearings hold keeps its estimate and its covariance."""
    state = tracked(FILTER.initial(0.0, np.eye(3)), frames_of(E, 3))[-1]
    assert state.holds_rig
    eccentric = as_eccentric(state, RADIUS)
    assert_allclose(eccentric.rig_error, state.rig_error, atol=1e-12)
    assert_allclose(eccentric.joint[RIG, RIG], state.joint[RIG, RIG], rtol=1e-6, atol=1e-20)
    assert np.linalg.eigvalsh(eccentric.joint).min() > -1e-12
    assert as_eccentric(eccentric, RADIUS) is None
