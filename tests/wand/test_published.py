"""The published filter."""

from dataclasses import replace

import numpy as np
import pytest

from spheremouse.simulate.wand.film import WandOptions, prepare_wand, simulate_wand
from spheremouse.wand.ball import grzonka_ball
from spheremouse.wand.build import build
from spheremouse.wand.settings import WandSettings
from spheremouse.wand.track import begin, step


@pytest.fixture(scope="module")
def film():
    made = prepare_wand(WandOptions(motion="hand", seed=2, seconds=0.6, size=(640, 480), focal=1000.0, distance=1.6))
    return made.scene.camera, list(simulate_wand(made))


@pytest.mark.parametrize("likelihood", ["product", "rims"])
def test_published_filter_keeps_a_ball_at_rest(film, likelihood):
    camera, shots = film
    tracker = build(camera, (grzonka_ball(),), WandSettings(particles=2000, method=likelihood))
    p, R = shots[0].position[0], shots[0].rotation[0]
    state = begin(tracker, 1, 0.0, {0: (p, R)})
    for k in range(8):
        state = step(state, replace(shots[0].frame, stamp=k / 15.0, sequence=k), tracker).state
        (pose,) = state.poses
        assert np.linalg.norm((pose.position - p)[:2]) < 0.05
