"""Published filter, and its likelihood from edges: greatest at the truth, independent of colours and region."""

from dataclasses import replace

import numpy as np
import pytest

from spheremouse.geometry.rotation import exp
from spheremouse.simulate.wand.film import WandOptions, prepare_wand, simulate_wand
from spheremouse.wand.ball import grzonka_ball
from spheremouse.wand.build import build
from spheremouse.wand.model import ball_model
from spheremouse.wand.published.track import edge_distances, log_edges
from spheremouse.wand.settings import WandSettings
from spheremouse.wand.track import begin, step


@pytest.fixture(scope="module")
def film():
    made = prepare_wand(WandOptions(motion="hand", seed=2, seconds=0.6, size=(640, 480), focal=1000.0, distance=1.6))
    return made.scene.camera, list(simulate_wand(made))


def test_true_pose_has_the_greatest_likelihood(film):
    camera, shots = film
    m = ball_model(grzonka_ball(), camera)
    p, R = shots[0].position[0], shots[0].rotation[0]
    away, place = edge_distances(shots[0].frame.image, None, 1)
    at, part = log_edges(p[None], R[None], m, away, place)
    assert part[0] > 0.6
    steps = np.concatenate([np.eye(3), -np.eye(3)]) * [0.006, 0.006, 0.12]
    beside, _ = log_edges(p + steps, np.repeat(R[None], 6, 0), m, away, place)
    assert np.all(beside < at[0] - 3.0)
    turned, _ = log_edges(
        np.repeat(p[None], 6, 0), exp(np.concatenate([np.eye(3), -np.eye(3)]) * 0.2) @ R, m, away, place
    )
    assert np.all(turned < at[0] - 3.0)


def test_likelihood_is_independent_of_colours(film):
    camera, shots = film
    m = ball_model(grzonka_ball(), camera)
    image = shots[0].frame.image
    p, R = shots[0].position, shots[0].rotation
    one, _ = log_edges(p, R, m, *edge_distances(image, None, 1))
    other, _ = log_edges(p, R, m, *edge_distances(255 - image, None, 1))
    assert one[0] == pytest.approx(other[0], abs=0.5)


def test_likelihood_in_a_region_equals_that_in_the_whole_picture(film):
    camera, shots = film
    m = ball_model(grzonka_ball(), camera)
    image, p, R = shots[0].frame.image, shots[0].position, shots[0].rotation
    u, v = (camera.fx * p[0][:2] / p[0][2] + [camera.cx, camera.cy]).astype(int)
    whole, _ = log_edges(p, R, m, *edge_distances(image, None, 1))
    part, _ = log_edges(p, R, m, *edge_distances(image, (u - 80, v - 80, u + 80, v + 80), 1))
    assert part[0] == pytest.approx(whole[0], abs=0.3)


def test_likelihood_is_constant_without_edges(film):
    camera, shots = film
    m = ball_model(grzonka_ball(), camera)
    away, place = edge_distances(np.full((480, 640, 3), 90, dtype=np.uint8), None, 1)
    value, part = log_edges(shots[0].position, shots[0].rotation, m, away, place)
    assert part[0] == 0.0
    assert value[0] == pytest.approx(20.0 * np.log(0.1))


@pytest.mark.parametrize("likelihood", ["product", "edges", "rims"])
def test_published_filter_keeps_a_ball_at_rest(film, likelihood):
    camera, shots = film
    tracker = build(camera, (grzonka_ball(),), WandSettings(particles=2000, method=likelihood))
    p, R = shots[0].position[0], shots[0].rotation[0]
    state = begin(tracker, 1, 0.0, {0: (p, R)})
    for k in range(8):
        state = step(state, replace(shots[0].frame, stamp=k / 15.0, sequence=k), tracker).state
        (pose,) = state.poses
        assert np.linalg.norm((pose.position - p)[:2]) < 0.05
