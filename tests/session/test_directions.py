"""A ball's motion in its player's words, judged by where a point of the ball goes."""

import numpy as np
import pytest
from seats import LOOKS

from spheremouse.output.counts import MotionSettings
from spheremouse.output.wand_mapping import PointingSettings
from spheremouse.session.directions import of_ball, of_hand
from spheremouse.tracker import unknown

UP = np.array([0.0, 1.0, 0.0])


def at(turn=(0.0, 0.0, 0.0), shift=(0.0, 0.0, 0.0)):
    return unknown(1.0)._replace(rate=np.array([*turn, *shift]), confirmed=True)


@pytest.mark.parametrize("player", LOOKS)
def test_the_top_of_the_ball_goes_where_it_is_said_to_go(player):
    said = of_ball(MotionSettings(player=player, invert_x=True, invert_y=True, scale_x=5.0)).motion
    ahead = np.array(LOOKS[player], dtype=float)
    right = np.cross(ahead, UP)
    for hand, words in ((right, "right"), (-right, "left"), (ahead, "away from you"), (-ahead, "towards you")):
        turn = np.radians(30.0) * np.cross(UP, hand)
        assert said(at(turn)).words == f"{words} 30 °/s"
    spin = said(at(np.radians(-12.4) * UP))
    assert (spin.rate, spin.unit) == (pytest.approx([0.0, 0.0, -12.4]), "°/s")
    assert spin.words == "clockwise 12 °/s"


def test_small_parts_are_not_worth_a_word_and_nothing_is_rest():
    said = of_ball(MotionSettings()).motion
    assert said(at(np.radians([-2.0, 0.5, 40.0]))).words == "right 40 °/s"
    assert said(at(np.radians([-6.0, 0.5, 40.0]))).words == "right 40 °/s, towards you 6 °/s"
    assert said(at(np.radians([0.4, 0.5, -0.9]))).words == "at rest"


@pytest.mark.parametrize("facing", [True, False])
def test_a_hand_goes_where_it_is_said_to_go(facing):
    """Who holds it looks along -z of the camera, or along z; up is -y."""
    look = np.array([0.0, 0.0, -1.0 if facing else 1.0])
    down = np.array([0.0, 1.0, 0.0])  # cam
    right = np.cross(down, look)
    shifted = of_hand(PointingSettings(by="shift", facing=facing)).motion
    for way, words in (
        (right, "right"),
        (-right, "left"),
        (down, "down"),
        (-down, "up"),
        (look, "ahead"),
        (-look, "back"),
    ):
        assert shifted(at(shift=0.25 * way)).words == f"{words} 0.25 m/s"
    turned = of_hand(PointingSettings(facing=facing)).motion
    for point, words in ((right, "right"), (-right, "left"), (down, "down"), (-down, "up")):
        turn = np.radians(50.0) * np.cross(look, point)  # what points ahead goes that way
        assert turned(at(turn)).words == f"{words} 50 °/s"
    clockwise = np.cross(-down, right)  # what points up goes right
    assert turned(at(np.radians(50.0) * clockwise)).words == "clockwise 50 °/s"
