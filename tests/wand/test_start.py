"""Start without a pose: no ball in noise and rooms, a ball in glare, a search over several pictures."""

from dataclasses import replace

import numpy as np
import pytest
from experiments.kit.balls import contrast_ball

from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.geometry.rotation import exp, log
from spheremouse.native import kernels
from spheremouse.simulate.wand.film import WandOptions, prepare_wand, simulate_wand
from spheremouse.simulate.wand.render import WandRenderer
from spheremouse.tracker import Frame, Status
from spheremouse.wand.ball import grzonka_ball
from spheremouse.wand.build import build
from spheremouse.wand.colour import DEFAULT_COLOURS, colour_fields
from spheremouse.wand.events import NotInView
from spheremouse.wand.model import ball_model
from spheremouse.wand.settings import WandSettings
from spheremouse.wand.start import evidence_without_prior, find_spots, pose_hypotheses
from spheremouse.wand.track import begin, step
from tests.wand import twins

BALL = grzonka_ball()
CAMERA = InteriorOrientation(640, 480, 500.0, 500.0, 320.0, 240.0)
PICTURES = 50


def squares(seed, coloured):
    """Return noise about grey with a red and a blue square of 40 px at random places."""
    rng = np.random.default_rng([seed, 7])
    noise = (
        rng.normal(128.0, 2.0, (480, 640, 3)) if coloured else np.repeat(rng.normal(128.0, 40.0, (480, 640, 1)), 3, 2)
    )
    image = np.clip(noise, 0, 255).astype(np.uint8)
    for colour in ((30, 30, 200), (200, 60, 30)):
        x, y = rng.integers(20, 580), rng.integers(20, 420)
        image[y : y + 40, x : x + 40] = colour
    return image


@pytest.mark.parametrize("coloured", [True, False])
def test_no_ball_in_noise_with_squares(coloured):
    """None in 50: a rate below 6 % with 95 % confidence."""
    tracker = build(CAMERA, (BALL,))
    for k in range(PICTURES):
        (pose,) = step(begin(tracker), Frame(squares(k, coloured), 0.0, 0), tracker).state.poses
        assert (pose.phase, pose.event) == (Status.SEARCHING, NotInView("grzonka"))


@pytest.mark.parametrize("seed", [3, 4, 10])
def test_no_ball_in_a_room_of_red_and_blue_things(seed):
    film = prepare_wand(WandOptions(motion="hand", size=(640, 480), seed=seed, seconds=0.1))
    rng = np.random.default_rng(seed)
    tracker = build(film.scene.camera, (BALL,))
    state, renderer = begin(tracker), WandRenderer(replace(film.scene, balls=()))
    for k in range(3):
        state = step(state, Frame(renderer.picture(k / 30.0, rng), k / 30.0, k), tracker).state
        (pose,) = state.poses
        assert pose.phase == Status.SEARCHING


@pytest.mark.parametrize(("seed", "begins"), [(6, 0.0), pytest.param(8, 90.0, marks=pytest.mark.slow)])
def test_ball_in_glare_is_found_in_the_first_frame(seed, begins):
    """The sun's image leaves a crescent of the largest disc."""
    film = prepare_wand(WandOptions(light="outdoor", seed=seed, begin=begins, seconds=1.3))
    (shot,) = simulate_wand(film)
    tracker = build(film.scene.camera, (BALL,))
    (pose,) = step(begin(tracker), shot.frame, tracker).state.poses
    assert pose.phase == Status.TRACKING
    assert np.linalg.norm(log(pose.rotation @ shot.rotation[0].T)) < np.deg2rad(8)
    assert np.linalg.norm((pose.position - shot.position[0])[:2]) < 0.01


def test_evidence_without_prior_needs_discs_and_a_bare_ball():
    film = prepare_wand(WandOptions(motion="hand", seed=2, seconds=0.1, size=(640, 480)))
    (shot,) = simulate_wand(film)
    camera, image, p, R = film.scene.camera, shot.frame.image, shot.position[0], shot.rotation[0]

    def evidence(image, position):
        seen = colour_fields(image, DEFAULT_COLOURS, BALL.colours)
        return evidence_without_prior(image, position, R, BALL, ball_model(BALL, camera), camera, seen)

    discs, bare = evidence(image, p)
    assert discs >= 3
    assert bare > 0.8
    assert evidence(image, p + np.array([0.2, 0.0, 0.0]))[0] < 3
    # a red picture shows all red discs, but no bare ball
    assert evidence(np.full_like(image, (30, 30, 200)), p)[1] == 0.0


def test_a_search_over_several_pictures_equals_a_complete_one():
    film = prepare_wand(WandOptions(motion="hand", seed=3, seconds=0.1, size=(640, 480), focal=700.0), contrast_ball())
    (shot,) = simulate_wand(film)
    ball, camera = contrast_ball(), film.scene.camera
    seen = find_spots(colour_fields(shot.frame.image, DEFAULT_COLOURS, ball.colours))
    whole = pose_hypotheses(seen, ball, camera, ball.colours, WandSettings(), max_assignments=10**12)
    assert whole.next_spot == 0
    best, turns, first = 0.0, 0, 0
    while turns < 100:
        part = pose_hypotheses(
            seen, ball, camera, ball.colours, WandSettings(), first_spot=first, max_assignments=100_000
        )
        best, turns, first = max(best, float(part.score[0]) if len(part.score) else 0.0), turns + 1, part.next_spot
        if first == 0 or turns * 100_000 > 60 * 28 * 17**3:
            break
    assert turns > 3
    assert best == pytest.approx(float(whole.score[0]), rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("glares", [0, 2])
def test_assignment_of_spots_equals_its_twin(glares):
    """Spots of a ball, with errors, and one of another thing."""
    rng = np.random.default_rng(4)
    discs = np.array([[*d.direction, d.angle, BALL.colours.index(d.colour)] for d in BALL.discs])
    R, c = exp(0.4 * rng.normal(size=3)) @ np.diag([1.0, -1.0, -1.0]), np.array([0.1, -0.05, 1.0])
    n = discs[:, :3] @ R.T
    x = c + BALL.radius * n
    seen = -np.sum(n * x, axis=1) / np.linalg.norm(x, axis=1) > 0.2
    area = np.pi * (discs[:, 3] * BALL.radius) ** 2 * -n[:, 2] * rng.uniform(0.7, 1.1, len(n))
    spots = np.column_stack([x[:, :2] / x[:, 2:] + rng.normal(size=(len(n), 2)) * 1e-3, area, discs[:, 4]])[seen]
    spots = np.vstack([spots, [0.15, 0.0, 1e-4, 0.0]])
    glare = np.column_stack([spots[:glares, :2], np.full(glares, 0.003)])
    limits = np.array([0.02, 0.12, 0.0015])
    score, position, rotation, following = kernels.assign_spots(spots, discs, glare, limits, 0.3, 0, 10**6, 10**4)
    expected = twins.assign_spots(spots, discs, glare, limits, 0.3)
    best = np.argsort(-score, kind="stable")
    assert following == 0
    assert len(expected) > 5
    got = np.column_stack([score, position, rotation.reshape(-1, 9)])[best]
    np.testing.assert_allclose(got[:, 0], expected[:, 0], rtol=1e-7)
    order = [np.lexsort(np.round(rows.T, 5)) for rows in (got, expected)]  # poses of equal scores
    np.testing.assert_allclose(got[order[0]], expected[order[1]], atol=1e-6)
