"""Gestures: told apart by rests, whatever the frame rate and the jitter; and whose directions they are."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from spheremouse.geometry.rotation import exp
from spheremouse.output.counts import MotionSettings
from spheremouse.output.gestures import GestureDetector, match_directions
from spheremouse.simulate.ball.profile import Gesture as Turn
from spheremouse.simulate.ball.profile import Gestures as Turns

SEATS = ("far-side", "camera-side", "left", "right")


def told(turns, hz, *, sigma=0.0, unit=1.0, seed=0):
    """Gestures in a motion that frames see at `hz`, their places off by `sigma` rad each."""
    times = np.arange(0.0, turns.seconds, 1.0 / hz)
    places = sum((np.outer(g.turned(times)[0], g.axis) for g in turns.gestures), np.zeros((len(times), 3)))
    places = unit * (places + sigma * np.random.default_rng(seed).normal(size=places.shape))
    detector, found = GestureDetector(unit), []
    for stamp, way in zip(times[1:], np.diff(places, axis=0), strict=True):
        if (gesture := detector.add(stamp, way)) is not None:
            found.append(gesture)
    if (gesture := detector.finish()) is not None:
        found.append(gesture)
    return found


def three(angle=1.0, length=1.5):
    axes = ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    return Turns(
        tuple(Turn(1.0 + (length + 1.5) * k, length, axis, angle) for k, axis in enumerate(axes)), 10.0 + 3 * length
    )


@pytest.mark.parametrize("hz", [5.0, 15.0, 30.0, 240.0])
@pytest.mark.parametrize(("angle", "length"), [(0.5, 1.0), (1.0, 1.5), (6.0, 4.0)])
@pytest.mark.parametrize("unit", [1.0, 0.4])
def test_three_motions_between_rests_are_three_gestures(hz, angle, length, unit):
    found = told(three(angle, length), hz, unit=unit)
    assert [g.straight for g in found] == [True] * 3
    for gesture, axis in zip(found, np.eye(3)[[2, 0, 1]], strict=True):
        assert_allclose(gesture.displacement, unit * angle * axis, atol=0.05 * unit * angle)


@pytest.mark.parametrize("seed", range(5))
def test_jitter_at_rest_is_no_gesture_and_hides_none(seed):
    """Half a degree a frame, as of a ball in a hand that is far away."""
    sigma = np.radians(0.5)
    assert told(Turns((), 20.0), 30.0, sigma=sigma, seed=seed) == []
    assert [g.straight for g in told(three(), 30.0, sigma=sigma, seed=seed)] == [True] * 3


def test_to_and_fro_is_no_direction():
    there = Turn(1.0, 1.0, (1.0, 0.0, 0.0), 1.0)
    (gesture,) = told(Turns((there, Turn(2.1, 1.0, (-1.0, 0.0, 0.0), 0.7)), 6.0), 30.0)
    assert not gesture.straight


def test_a_hand_that_slows_down_goes_on_with_its_gesture():
    detector, speeds = GestureDetector(), np.repeat([1.0, 0.2, 1.0, 0.0], [30, 60, 30, 60])  # rad/s
    found = [detector.add(k / 30.0, np.array([speed / 30.0, 0.0, 0.0])) for k, speed in enumerate(speeds)]
    (gesture,) = filter(None, found)
    assert_allclose(gesture.displacement, [2.4, 0.0, 0.0], atol=0.1)


def test_a_twitch_and_a_creeping_ball_are_no_gestures():
    assert told(Turns((Turn(1.0, 0.5, (1.0, 0.0, 0.0), 0.2),), 4.0), 30.0) == []
    assert told(Turns((Turn(1.0, 30.0, (1.0, 0.0, 0.0), 1.0),), 40.0), 30.0) == []  # 2 °/s


def asked(player):
    """Right, away, counter-clockwise: two of them about the settings' own axes, one against."""
    return MotionSettings(player=player).directions() * np.array([[1.0], [-1.0], [1.0]])


@pytest.mark.parametrize("player", SEATS)
@given(st.floats(-40.0, 40.0), st.floats(-20.0, 20.0))
def test_a_player_is_understood_who_stands_askew_and_whose_ball_stands_askew(player, turned, tilted):
    """Gestures made by hand: the top goes right, away; then a spin."""
    look = {"far-side": (0, 0, 1), "camera-side": (0, 0, -1), "left": (1, 0, 0), "right": (-1, 0, 0)}[player]
    up, ahead = np.array([0.0, 1.0, 0.0]), np.array(look, dtype=float)
    made = [np.cross(up, np.cross(ahead, up)), np.cross(up, ahead), up]
    askew = exp(np.radians(turned) * up) @ exp(np.radians(tilted) * np.array([1.0, 0.0, 0.0]))
    found = match_directions([2.0 * askew @ way for way in made], [asked(p) for p in SEATS])
    assert SEATS[found.candidate] == player
    assert found.fits
    if not tilted:
        assert_allclose(np.degrees(found.errors), [abs(turned), abs(turned), 0.0], atol=1e-4)


@pytest.mark.parametrize("player", SEATS)
def test_a_mirror_image_is_nobodys(player):
    """The underside of the ball pushed, or the rig upside down: no seat has such directions."""
    right, away, spin = asked(player)
    assert not match_directions([right, -away, spin], [asked(p) for p in SEATS]).fits
    assert not match_directions([right, away, -spin], [asked(p) for p in SEATS]).fits
