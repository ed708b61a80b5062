"""What a person reads of a run."""

import math

import numpy as np
import pytest
from seats import LOOKS

from spheremouse.ball import events
from spheremouse.ball.detect.diagnosis import Absence, Cause
from spheremouse.ball.detect.refused import Bound, Refused
from spheremouse.ball.events import BallLost, Doubt, Why
from spheremouse.ball.phases.discs import Discs
from spheremouse.output.counts import MotionSettings
from spheremouse.output.wand_mapping import PointingSettings
from spheremouse.session.directions import of_ball, of_hand
from spheremouse.session.messages import absent, line, reason, refusal, remedy, why_absent, withheld
from spheremouse.session.screen import Tally
from spheremouse.session.timing import Arrivals
from spheremouse.tracker import Event, unknown

WORDS = Discs().words
SENTENCES = {
    events.Found(7): "tracking: 7 discs in view",
    events.Turned(1): "the ball turns; 1 look-alike masked",
    events.Turned(2): "the ball turns; 2 look-alikes masked",
    events.Recognised(6, saved=True): "tracking: recognised by 6 discs of the saved map",
    BallLost(Why.UNSEEN, 0.3, discs=4): "lost: 4 discs in view, none where it should be for 0.3 s",
    BallLost(Why.GAP, 1.25): "lost: no frame for 1.2 s",
    BallLost(Why.OFF_CENTRE, 0.03): (
        "lost: the ball does not turn about its centre, off by 30 mm: lifted, or out of round"
    ),
    BallLost(Why.OFF_CENTRE, 0.05, radii=True): (
        "lost: the ball does not turn about its centre, off by 5.0 % of its radius: lifted, or out of round"
    ),
    events.MotionReleased(0.23, 0.6): "motion goes on: the 34° of 0.2 s are made up for at a hand's pace",
    events.ReadoutKnown(0.0299): "rolling shutter: 29.9 ms for all rows (set readout_s: 0.0299 in the rig file)",
    events.WrongSize(-0.0164): (
        "the ball looks 1.6 % smaller than the rig has it: measure its radius and place again, or calibrate"
    ),
    events.AxisUnseen(): (
        "the pattern shows no turn about one axis, as stripes do, so motion about it is not measured: add spots of "
        "many sizes"
    ),
    events.AxisUnseen(ended=True): "the pattern shows turns about all axes again",
    events.PatternRepeats(): "the pattern repeats itself, so a lost ball gets a new map: add a few spots that differ",
    events.DiscColours((0.114, 0.587, 0.299)): "the discs are darker than the ball",
    events.DiscColours((-0.114, -0.587, -0.299)): "the discs are lighter than the ball",
    events.DiscColours((-0.5, 0.0, 0.5)): (
        "the discs differ from the ball in colour (weights of blue, green, red: [-0.50, 0.00, 0.50])"
    ),
    events.CameraMoved(0.0028, 0.0042): "the camera was moved: new pose (2.8 mm, 0.24°)",
    events.CameraMoved(0.0028, 0.0042, asked=True): "new pose (2.8 mm, 0.24°)",
}
FIXED = (events.NewMap(), events.NewMap(saved=True), events.OutOfRound(), events.TargetsHidden(), BallLost(Why.CAMERA))


@pytest.mark.parametrize("event", SENTENCES, ids=repr)
def test_the_figures_of_an_event_are_in_its_sentence(event):
    assert line([event], WORDS) == SENTENCES[event]


def test_every_event_has_a_sentence_of_its_own():
    shown = [*SENTENCES, *FIXED, *map(events.MotionWithheld, Doubt)]
    every = {e for e in vars(events).values() if isinstance(e, type) and issubclass(e, Event) and e is not Event}
    assert {type(event) for event in shown} == every
    assert {event.why for event in shown if isinstance(event, BallLost)} == set(Why)
    assert len({line([event], WORDS) for event in shown} - {""}) == len(shown)


def test_motion_withheld_now_is_told_with_its_time():
    assert withheld(0.42, Doubt.ONE_DISC, WORDS) == (
        "motion withheld for 0.4 s: one known disc in view does not determine the rotation about it"
    )


def test_several_are_one_line_and_beside_the_state_it_is_not_said_again():
    happened = (BallLost(Why.UNSEEN, 0.3), events.TargetsHidden())
    hidden = "no disc in view for 0.3 s; the targets are out of sight: if the camera was moved, initialise again"
    assert line(happened, WORDS) == f"lost: {hidden}"
    assert reason(happened, WORDS) == hidden
    assert line((BallLost(Why.UNSEEN, 0.3, 3), events.Turned(0)), WORDS).startswith("lost: 3 discs")
    assert reason((events.Turned(0), events.Found(5)), WORDS) == "the ball turns; tracking: 5 discs in view"
    assert line((), WORDS) == reason((), WORDS) == ""


def test_every_cause_and_every_bound_has_words_and_a_remedy():
    for cause in Cause:
        assert all(why_absent(Absence(cause, 12.0, 4, 0.18, 9.0, 15.0)))
    for bound in Bound:
        assert refusal(Refused("CMY", np.zeros(2), 9.0, bound))
        assert remedy(bound)


def test_a_ball_without_discs_in_words():
    assert absent(0, 1.03, Absence(Cause.SIZE, 160.0, 4, 0.8, 9.2, 14.6), WORDS) == (
        "no disc found on the ball for 1 s: 4 spots are about 9 px across, and the rig's discs 15 px; if these are the "
        "discs, correct disc_radius in the rig, or give the rig of this ball"
    )
    assert absent(2, 2.0, Absence(Cause.DARK, 3.0), WORDS) == (
        "only 2 discs found on the ball for 2 s: it is nearly black (3 of 255); uncover the lens, light the ball, or "
        "expose longer (camera.exposure_s)"
    )


def test_the_closing_line_has_what_was_sent_and_which_frames_were_left_out():
    tally = Tally()
    for _ in range(3):
        tally.add((10, -4, 1), 0.001)
    assert str(tally).startswith("3 frames; counts x +30, y -12, third +3; ")
    assert "not sent" not in str(tally)
    assert "left out" not in str(tally)
    tally.unsent = lambda: (5, 0, -1)
    tally.left_out = {"skipped": 2, "dropped": 0, "damaged": 1}
    assert tally.counts == (25, -12, 4)
    assert str(tally).startswith("3 frames; counts x +25, y -12, third +4; ")
    assert str(tally).endswith("; not sent: x +5, y +0, third -1; frames left out: 2 skipped, 1 damaged")


def test_a_run_without_a_tracked_frame_says_what_became_of_all():
    tally = Tally()
    assert str(tally) == "no frame tracked"
    tally.left_out = {"before anything could be tracked": 60}
    assert str(tally) == "no frame tracked; frames left out: 60 before anything could be tracked"


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


def test_the_time_left_is_that_until_the_next_frame_of_a_steady_camera():
    arrivals = Arrivals()
    assert math.isnan(arrivals.time_left(0.0))
    for k in range(60):
        arrivals.add(k / 50.0)
    assert arrivals.time_left(59 / 50.0 + 0.005) == pytest.approx(0.015)
    assert arrivals.time_left(59 / 50.0 + 0.030) == pytest.approx(-0.010)
