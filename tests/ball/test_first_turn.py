"""The first turn told from two discs: a ball keeps their angle, a shift of the picture their offset."""

import numpy as np
import pytest
from ball_world import DT, POSE, RIG, detected, pixels

from spheremouse.ball.build import begin, build
from spheremouse.ball.events import Turned
from spheremouse.ball.settings import Settings
from spheremouse.ball.track import advance
from spheremouse.geometry.rotation import exp

TWO = np.array([[0.35, 0.2, 0.0], [-0.3, -0.35, 0.0]])
TWO[:, 2] = np.sqrt(1.0 - np.sum(TWO**2, axis=1))


def events_of(places, seed):
    """Events of 40 frames whose points are at `places(t)`, (n, 2) px."""
    rng = np.random.default_rng(seed)
    tracker = build(RIG, POSE, Settings())
    state, events = begin(tracker, 0.0), []
    for k in range(40):
        state, _, more = advance(state, k * DT, detected(places(k * DT), rng), tracker)
        events += more
    return events, state


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.3, 0.8, 0.2), (0.0, 0.2, 1.0)])
def test_two_discs_tell_the_first_turn_and_mask_what_stays(axis, seed):
    w = 0.5 * np.array(axis) / np.linalg.norm(axis)
    bolt = np.array([[300.0, 150.0]])
    events, state = events_of(lambda t: np.concatenate([pixels(TWO @ exp(w * t).T), bolt]), seed)
    assert any(isinstance(e, Turned) for e in events)
    assert len(state.lookalikes.masks) == 1


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("way", [(40.0, 5.0), (-10.0, 40.0)])
def test_two_spots_that_are_carried_past_the_ball_turn_nothing(way, seed):
    start = pixels(TWO)
    events, _ = events_of(lambda t: start + t * np.array(way), seed)
    assert not any(isinstance(e, Turned) for e in events)
