"""The wand's ball, and its published filter."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from experiments.kit.balls import contrast_ball, led_ball
from scipy.spatial.transform import Rotation

from spheremouse.simulate.wand.film import WandOptions, prepare_wand, simulate_wand
from spheremouse.wand.ball import grzonka_ball
from spheremouse.wand.build import build
from spheremouse.wand.settings import WandSettings
from spheremouse.wand.track import begin, step


def test_thesis_ball_has_the_printed_measures():
    ball = grzonka_ball()
    rims = sorted({round(2 * ball.radius * np.sin(d.angle), 6) for d in ball.discs})
    assert rims == [0.021, 0.035]
    assert sorted({round(ball.radius * d.points_angle, 6) for d in ball.discs}) == [0.005, 0.012]
    assert [d.colour for d in ball.discs].count("red") == 4
    azimuths = {round(np.rad2deg(np.arctan2(d.direction[1], d.direction[0]))) % 360 for d in ball.discs}
    assert azimuths == {0, 90, 180, 270}


@pytest.mark.parametrize("ball", [grzonka_ball(), contrast_ball(), led_ball()], ids=lambda b: b.name)
def test_no_rotation_maps_the_pattern_to_itself(ball):
    """Every rotation that maps two discs to two others of their kind maps some disc to a place without one."""
    n = np.array([d.direction for d in ball.discs])
    kind = [(d.colour, round(d.angle, 6)) for d in ball.discs]
    pairs = list(itertools.permutations(range(len(n)), 2))
    a, b = pairs[0]
    for c, d in pairs:
        if (a, b) == (c, d) or kind[a] != kind[c] or kind[b] != kind[d]:
            continue
        if abs(n[a] @ n[b] - n[c] @ n[d]) > 0.01:
            continue
        R, _ = Rotation.align_vectors(n[[c, d]], n[[a, b]])
        moved = R.apply(n)
        on = [any(kind[i] == kind[j] and moved[i] @ n[j] > np.cos(0.1) for j in range(len(n))) for i in range(len(n))]
        assert not all(on)


@pytest.mark.parametrize("ball", [grzonka_ball(), contrast_ball(), led_ball()], ids=lambda b: b.name)
def test_discs_do_not_touch(ball):
    for a, b in itertools.combinations(ball.discs, 2):
        assert np.arccos(a.direction @ b.direction) > a.angle + b.angle + np.deg2rad(5)


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
