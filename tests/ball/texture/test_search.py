"""Search for the attitude at which a frame shows what the picture shows: steps, a lost ball, another ball."""

import numpy as np
import pytest

from spheremouse.ball.settings import Settings
from spheremouse.ball.texture.picture import Alignment, align, shows_all_axes
from spheremouse.ball.texture.search import (
    PARTS_OF_COMPARISON,
    Shutter,
    compared_with_itself,
    exposed,
    fits,
    is_ambiguous,
    near,
    search,
    texture_detector,
)
from spheremouse.errors import ConfigurationError
from spheremouse.geometry.rotation import exp, log
from tests.ball.texture.painted import DETECTOR, NOISE, POSE, RIG, contrast_at, plain, rings, state_at, waves

PARTS = 64  # frames that a search of all attitudes takes
RIGHT = np.radians(0.3)


def random_turn(rng, degrees=None):
    """Return a rotation about a random axis; without an angle, a random rotation."""
    if degrees is None:
        q = rng.normal(size=4)
        q /= np.linalg.norm(q)
        return exp(2.0 * np.arccos(abs(q[0])) * q[1:] * np.copysign(1.0, q[0]) / np.linalg.norm(q[1:]))
    axis = rng.normal(size=3)
    return exp(np.radians(degrees) * axis / np.linalg.norm(axis))


def is_right(found, R):
    return np.linalg.norm(log(found.attitude @ R.T)) < RIGHT


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({}, True),
        ({"correlation": 0.3}, False),  # of strong noise, however many pixels
        ({"correlation": float("nan")}, False),
        ({"used": 40}, False),  # five details correlate by chance, however well
        ({"used": 0, "correlation": 1.0}, False),
        ({"converged": False}, False),
    ],
)
def test_a_fit_needs_correlation_and_details_and_an_end(change, expected):
    blank = np.zeros((20, 3, 3))
    found = Alignment(np.eye(3), 1.0, 0.9, 6000, True, blank, blank[:, 0], blank[:, 0, 0], np.eye(3), 0.0)
    assert fits(found._replace(**change)) == expected


@pytest.mark.parametrize("degrees", [0.0, 1.0])
def test_a_frame_near_the_prediction_fits_there(degrees):
    rng = np.random.default_rng(1)
    for seed in range(5):
        R = random_turn(rng)
        found, turns = near(DETECTOR, state_at(waves(seed % 2), R, rng), random_turn(rng, degrees) @ R)
        assert turns
        assert is_right(found, R)


@pytest.mark.parametrize("degrees", [3.0, 11.0, 20.0, 40.0, 46.0])
def test_a_step_is_found_in_the_frame_that_follows_it(degrees):
    rng = np.random.default_rng(2)
    for seed in range(10):
        before = random_turn(rng)
        R = random_turn(rng, degrees) @ before
        found, _ = search(DETECTOR, state_at(waves(seed % 2), R, rng), before, lost=False)
        assert found is not None
        assert is_right(found, R)


def test_a_ball_that_stops_while_rows_are_exposed_is_found_by_the_rate_that_leads_there():
    """It turns at 400 °/s and stops within a frame of 30 Hz. In 15 ms it would turn by 6°."""
    rng, dt, readout = np.random.default_rng(12), 1.0 / 30.0, 0.015
    for seed in range(6):
        before = random_turn(rng)
        rate = np.radians(400.0) * log(random_turn(rng, 1.0)) / np.radians(1.0)
        R = exp(0.5 * dt * rate) @ before  # the rate falls evenly to zero
        now, expected = state_at(waves(seed % 2), R, rng), exp(dt * rate) @ before
        shutter = Shutter(readout, before, rate, dt)
        assert np.allclose(shutter.skew(R), 0.0, atol=1e-12)
        assert np.allclose(shutter.skew(expected), readout * rate)
        now = exposed(DETECTOR, now, readout * rate)
        found, at_frame = search(DETECTOR, now, expected, lost=False, shutter=shutter)
        assert found is not None
        assert is_right(found, R)
        assert np.linalg.norm(at_frame.fine.seen.skew) < np.radians(0.5)


def test_a_lost_ball_is_found_at_any_attitude_within_two_seconds():
    rng = np.random.default_rng(3)
    for seed in range(8):
        last, R, found = random_turn(rng), random_turn(rng), None
        for turn in range(PARTS):
            found, _ = search(DETECTOR, state_at(waves(seed % 2), R, rng, turn=turn), last, lost=True)
            if found is not None:
                break
        assert found is not None
        assert is_right(found, R)


@pytest.mark.parametrize("texture", [lambda seed: waves(100 + seed), lambda _: plain], ids=["another", "noise"])
def test_another_texture_or_noise_fits_nowhere(texture):
    rng = np.random.default_rng(4)
    for seed in range(6):
        now = state_at(texture(seed), random_turn(rng), rng, learnt=waves(seed % 2), turn=seed)
        before = random_turn(rng)
        assert near(DETECTOR, now, before) == (None, False)
        for lost in (False, True):
            assert search(DETECTOR, now, before, lost=lost)[0] is None


def test_a_texture_of_rings_tells_nothing_of_the_turn_about_their_axis():
    rng = np.random.default_rng(6)
    now = state_at(rings, np.eye(3), rng)
    found = align(DETECTOR.fine, now.fine.seen, now.fine.picture, np.eye(3), NOISE)
    assert not shows_all_axes(found)
    assert np.allclose(found.known, np.diag([1.0, 1.0, 0.0]), atol=0.1)
    now = state_at(waves(0), np.eye(3), rng)
    assert shows_all_axes(align(DETECTOR.fine, now.fine.seen, now.fine.picture, np.eye(3), NOISE))


def repeated(view, x):
    """A contrast that is the same after a turn of 20° about z."""
    longitude = np.arctan2(x[:, 1], x[:, 0])
    return 0.05 * np.sin(18.0 * longitude) * np.sqrt(1.0 - x[:, 2] ** 2) + 0.05 * np.sin(14.0 * x[:, 2])


def test_a_pattern_that_repeats_itself_is_found_nowhere_unless_by_its_prediction():
    rng = np.random.default_rng(9)
    now = state_at(repeated, np.eye(3), rng)._replace(usual=0.9)
    for turn in (0.0, 0.02):
        fit, turns = near(DETECTOR, now, exp(np.array([0.0, 0.0, turn])))
        assert turns
        assert fit is not None
        assert is_ambiguous(DETECTOR, now, fit)
    assert search(DETECTOR, now, exp(np.array([0.0, 0.0, 0.12])), lost=False)[0] is None
    once = state_at(waves(0), np.eye(3), rng)
    fit, _ = near(DETECTOR, once, np.eye(3))
    assert fit is not None
    assert not is_ambiguous(DETECTOR, once, fit)


@pytest.mark.slow
@pytest.mark.parametrize(("texture", "expected"), [(repeated, True), (waves(0), False)], ids=["repeated", "once"])
def test_a_ball_is_compared_with_itself_at_all_attitudes(texture, expected):
    rng = np.random.default_rng(10)
    now = state_at(texture, np.eye(3), rng)._replace(usual=0.9)
    fit, _ = near(DETECTOR, now, np.eye(3))
    assert fit is not None
    for part in range(0, PARTS_OF_COMPARISON, 16):
        now = compared_with_itself(DETECTOR, now._replace(compared=part), fit)
        assert now.repeats or now.compared == part + 1
    assert now.repeats == expected
    seen = state_at(texture, random_turn(rng, 100.0), rng)._replace(usual=0.9, repeats=now.repeats)
    found = [search(DETECTOR, seen._replace(frame_index=k), None, lost=True)[0] for k in range(PARTS)]
    assert any(found) != expected


@pytest.mark.parametrize(("part", "pattern"), [(0.5, plain), (0.6, waves(200))], ids=["hand", "sleeve"])
def test_a_ball_that_a_hand_or_a_sleeve_covers_in_part_is_aligned_by_the_rest(part, pattern):
    """A hand is smooth, and a sleeve has a pattern as strong as the ball's."""
    rng = np.random.default_rng(7)
    for seed in range(4):
        R = random_turn(rng)
        now = state_at(waves(seed % 2), R, rng)
        cover = contrast_at(DETECTOR.fine, pattern, np.eye(3), rng)
        view = DETECTOR.fine
        covered = view.at % view.chart.size < part * view.chart.size
        now.fine.seen.contrast[covered] = cover[covered]
        found, _ = near(DETECTOR, now, random_turn(rng, 0.5) @ R)
        assert found is not None
        assert is_right(found, R)


@pytest.mark.parametrize("rows", [0, 1, 3])
def test_masks_that_leave_a_margin_of_the_ball_are_refused_in_one_line(rows):
    """A contrast needs its neighbourhood."""
    shown = DETECTOR.resampling.window[0].stop - rows
    with pytest.raises(ConfigurationError, match="masks") as e:
        texture_detector(RIG, POSE, [(0, 0, RIG.camera.width, shown)])
    assert "\n" not in str(e.value)
    assert Settings().discs.masks == ()
