"""Balls and discs of any colour, from simulated films: found by themselves, kept, and black on white as it was."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from spheremouse.ball.build import begin, build
from spheremouse.ball.detect.discs import LENS_BLUR, DiscSettings
from spheremouse.ball.detect.projection import CANDIDATES, GREY, NEGATIVE, normalise
from spheremouse.ball.events import DiscColours
from spheremouse.ball.phases.method import SO3
from spheremouse.ball.settings import Settings
from spheremouse.ball.state import Tracking
from spheremouse.ball.track import step, wants_colour, with_pose, with_settings
from spheremouse.evaluation.metrics import attitude_error
from spheremouse.geometry.rotation import log
from spheremouse.simulate.ball.film import SimulationOptions, prepare, simulate
from spheremouse.tracker import Frame, Status

WHITE, RED, BLUE, DARK, BLACK = (230, 230, 230), (30, 30, 200), (180, 40, 40), (40, 40, 40), (20, 20, 20)
PAIRS = {"white-black": (None, None), "dark-white": (DARK, WHITE), "red-black": (RED, BLACK), "red-blue": (RED, BLUE),
         "red-white": (RED, WHITE)}  # fmt: skip
COLOURED = ("red-black", "red-blue", "red-white")


@cache
def film(pair, seconds=0.5, turns=0.2):
    """A simulation of a ball that turns from the first frame on, and its frames."""
    ball, disc = PAIRS[pair]
    options = {"motion": "roll", "turns": turns, "noise": 4.0, "seconds": seconds, "seed": 3}
    sim = prepare(SimulationOptions(ball_colour=ball, disc_colour=disc, **options))
    return sim, list(simulate(sim))


def run(sim, frames, settings=None, known=None):
    """States and events; frames come grey unless colour is wanted, and which did not."""
    tracker = build(sim.scene.rig(), sim.scene.pose, settings or Settings())
    state, states, events, coloured = begin(tracker, 0.0, known=known), [], [], []
    for made in frames:
        coloured.append(wants_colour(state, made.frame.stamp))
        image = made.frame.image if coloured[-1] else cv2.cvtColor(made.frame.image, cv2.COLOR_BGR2GRAY)
        state, _, happened = step(state, replace(made.frame, image=image), tracker)
        states.append(state)
        events += happened
    return states, events, coloured, tracker


@cache
def tracked(pair, seconds=0.5):
    return run(*film(pair, seconds))


def worst(states, frames):
    """rad, largest error of the attitude once the ball is tracked."""
    found = [k for k, s in enumerate(states) if s.status is Status.TRACKING]
    assert len(found) >= len(frames) - 1
    error = attitude_error(
        np.array([states[k].filter.attitude for k in found]), np.array([frames[k].attitude for k in found])
    )
    return np.linalg.norm(error, axis=1).max()


@pytest.mark.parametrize(
    "pair", [pytest.param(p, marks=[] if p in ("white-black", "red-blue") else pytest.mark.slow) for p in PAIRS]
)
def test_a_ball_of_any_colours_is_tracked_from_its_first_frame_on(pair):
    states, events, coloured, _ = tracked(pair)
    assert worst(states, film(pair)[1]) < np.radians(0.1)
    told = [e for e in events if isinstance(e, DiscColours)]
    if pair == "white-black":
        assert told == []
        assert {s.colours.projection for s in states} == {GREY}
    else:
        assert told
        assert told[-1].weights == states[-1].colours.projection.weights
    assert all(coloured) == (pair in COLOURED)
    if pair not in COLOURED:
        assert coloured.index(True) == 0
        assert sum(coloured) <= 2  # the targets may ask for one, too


@pytest.mark.parametrize(
    "pair", [pytest.param(p, marks=pytest.mark.slow) for p in ("dark-white", "red-white")] + ["red-blue"]
)
def test_hands_at_first_do_not_decide(pair):
    """A blank sheet with spots of skin hides the ball for half a second; the colours are found when it is gone."""
    sim, frames = film(pair, seconds=2.0, turns=0.1)
    rng = np.random.default_rng(2)
    hand = np.full_like(frames[0].frame.image, (140, 160, 200))
    for x, y in rng.uniform((200, 120), (440, 360), (12, 2)):
        cv2.circle(hand, (int(x), int(y)), 6, (90, 110, 150), -1, cv2.LINE_AA)
    hidden = [replace(m, frame=replace(m.frame, image=hand)) if k < 15 else m for k, m in enumerate(frames)]
    states, *_ = run(sim, hidden)
    assert states[-1].status is Status.TRACKING
    assert len(states[-1].filter.used) >= 3
    after = [s.filter.attitude for s in states[45:]]
    true = [m.attitude for m in frames[45:]]
    turned = [a @ after[0].T @ (t @ true[0].T).T for a, t in zip(after, true, strict=True)]
    assert max(np.arccos(np.clip((np.trace(R) - 1.0) / 2.0, -1.0, 1.0)) for R in turned) < np.radians(0.3)


def test_a_cover_of_other_colours_turns_no_ball_that_rests():
    """A dark sheet with white spots slides before black discs. Its colours are found, and later the discs again."""
    sim, (first, *_) = film("white-black", seconds=0.1)
    spots, frames = np.random.default_rng(4).uniform((180, 120), (440, 360), (20, 2)), []
    for k in range(90):
        image = first.frame.image.copy()
        if 8 <= k < 60:
            cv2.circle(image, (320, 240), 185, DARK, -1)
            for x, y in spots + 30.0 * np.sin(0.1 * k):
                cv2.circle(image, (int(x), int(y)), 6, WHITE, -1, cv2.LINE_AA)
        frames.append(replace(first, frame=replace(first.frame, image=image, stamp=k / 30.0, sequence=k)))
    states, events, *_ = run(sim, frames)
    assert [e.weights for e in events if isinstance(e, DiscColours)] == [NEGATIVE.weights, GREY.weights]
    assert max(np.linalg.norm(log(s.reported_attitude)) for s in states) < np.radians(0.1)
    assert states[-1].status is Status.TRACKING
    assert len(states[-1].filter.used) >= 3


def test_a_trial_tries_one_projection_in_a_frame_of_a_tracked_ball():
    sim, (first, *_) = film("white-black", seconds=0.1)
    frames = [replace(first, frame=replace(first.frame, stamp=k / 60.0)) for k in range(90)]
    states, *_ = run(sim, frames)
    assert all(s.status is Status.TRACKING for s in states)
    counts = [len(s.colours.tried_now) for s in states]
    begin = counts.index(1)
    assert counts[begin : begin + len(CANDIDATES) + 1] == [*range(1, len(CANDIDATES) + 1), 0]
    assert states[-1].colours.projection == GREY
    assert states[-1].colours.wait > states[0].colours.wait


def test_once_the_ball_has_turned_the_colours_are_fisher_s_and_stay():
    states, events, *_ = tracked("red-blue", 2.0)
    refined = [s for s in states if s.colours.refined]
    assert refined
    assert all(isinstance(s.phase, Tracking) for s in refined)
    assert len({s.colours.projection for s in refined}) == 1
    assert len([e for e in events if isinstance(e, DiscColours)]) <= 2


@pytest.mark.parametrize("pair", [pytest.param("dark-white", marks=pytest.mark.slow), "red-blue"])
def test_the_map_keeps_the_colours_and_another_ball_finds_its_own(pair):
    states, *_ = tracked(pair, 2.0)
    known = SO3.to_map(states[-1])
    assert known is not None
    assert known.projection == states[-1].colours.projection
    sim, frames = film(pair, 2.0)
    again, events, *_ = run(sim, frames[30:], known=known)
    assert again[0].absolute
    assert not any(isinstance(e, DiscColours) for e in events)
    states, events, *_ = run(*film("white-black"), known=known)
    assert states[-1].colours.projection == GREY
    assert sum(isinstance(e, DiscColours) for e in events) == 1


def test_settings_fix_the_colours_and_a_change_of_them_is_followed():
    sim, frames = film("red-blue")
    fixed = Settings(discs=DiscSettings(weights=(-0.5, 0.0, 0.5)))
    states, events, *_ = run(sim, frames, fixed)
    assert {s.colours.projection for s in states} == {normalise(np.array([-0.5, 0.0, 0.5]))}
    assert not any(isinstance(e, DiscColours) for e in events)
    assert worst(states, frames) < np.radians(0.1)
    tracker = build(sim.scene.rig(), sim.scene.pose, fixed)
    light, _ = with_settings(states[-1], tracker, Settings(discs=DiscSettings(polarity="light")))
    assert light.colours.projection == NEGATIVE
    auto, _ = with_settings(states[-1], tracker, Settings())
    assert auto.colours.projection == states[-1].colours.projection  # until there is a reason for others
    assert not auto.colours.fixed


def test_a_camera_that_was_moved_sees_the_same_colours():
    (sim, frames), (states, _, _, tracker) = film("red-blue"), tracked("red-blue")
    pose = replace(sim.scene.pose, position=sim.scene.pose.position + 0.01)
    made = frames[-1].frame
    after = with_pose(states[-1], Frame(made.image, made.stamp + 1 / 30, made.sequence + 1), tracker, pose).state
    assert after.colours.projection == states[-1].colours.projection


@pytest.mark.parametrize("polarity", ["auto", "dark"])
def test_the_blur_of_the_lens_is_measured_when_a_picture_shows_edges_and_again_later(polarity):
    """The first frames are dark, then the lens is out of focus by 2 px, and after a second it is focused."""
    sim, frames = film("white-black", 3.0)
    seen = [replace(f, frame=replace(f.frame, image=through_lens(f.frame))) for f in frames]
    states, *_ = run(sim, seen, Settings(discs=DiscSettings(polarity=polarity)))
    blur = [s.colours.lens_blur for s in states]
    assert blur[2] is None
    assert blur[25] == pytest.approx(2.0, rel=0.15)
    assert blur[-1] == LENS_BLUR


def through_lens(frame):
    if frame.sequence < 3:
        return np.zeros_like(frame.image)
    return cv2.GaussianBlur(frame.image, (0, 0), 2.0) if frame.stamp < 1.0 else frame.image
