"""The first turn told from two discs: a ball keeps their angle, a shift of the picture their offset."""

import numpy as np
import pytest

from spheremouse.ball.build import begin, build
from spheremouse.ball.detect.detections import Detections
from spheremouse.ball.events import Turned
from spheremouse.ball.rig import Ball, Rig, Targets
from spheremouse.ball.settings import Settings
from spheremouse.ball.track import advance
from spheremouse.geometry.camera import InteriorOrientation, Pose, project
from spheremouse.geometry.rotation import exp

CAMERA = InteriorOrientation(640, 480, 640.0, 640.0, 320.0, 240.0)
POSE = Pose(np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]), np.array([0.0, 0.0, 2.35]))
RIG = Rig(CAMERA, Ball(0.6), Targets((), (), np.zeros((0, 3)), np.zeros((0, 0)), np.zeros(3)), 0.02)
SIGMA = 0.05  # px
TWO = np.array([[0.35, 0.2, 0.0], [-0.3, -0.35, 0.0]])
TWO[:, 2] = np.sqrt(1.0 - np.sum(TWO**2, axis=1))


def events_of(places, seed):
    """Events of 40 frames whose points are at `places(t)`, (n, 2) px."""
    rng = np.random.default_rng(seed)
    tracker = build(RIG, POSE, Settings())
    state, events = begin(tracker, 0.0), []
    for k in range(40):
        uv = places(k / 30.0)
        uv = uv + SIGMA * rng.normal(size=uv.shape)
        seen = Detections(uv, np.tile(SIGMA**2 * np.eye(2), (len(uv), 1, 1)), np.full(len(uv), 50.0))
        state, _, more = advance(state, k / 30.0, seen, tracker)
        events += more
    return events, state


def pixels(directions):
    return project(POSE.to_cam(RIG.ball.radius * directions), CAMERA)[0]


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
