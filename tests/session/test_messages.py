"""What is said of the ball: each event in words, as they have been since the first log."""

import numpy as np
import pytest

from spheremouse.ball import events
from spheremouse.ball.detect.diagnosis import Absence, Cause
from spheremouse.ball.detect.refused import Bound, Refused
from spheremouse.ball.events import BallLost, Doubt, Why
from spheremouse.session.messages import line, no_discs, reason, refusal, remedy, why_absent, withheld
from spheremouse.tracker import Event

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
    assert line([event]) == SENTENCES[event]


def test_every_event_has_a_sentence_of_its_own():
    shown = [*SENTENCES, *FIXED, *map(events.MotionWithheld, Doubt)]
    every = {e for e in vars(events).values() if isinstance(e, type) and issubclass(e, Event) and e is not Event}
    assert {type(event) for event in shown} == every
    assert {event.why for event in shown if isinstance(event, BallLost)} == set(Why)
    assert len({line([event]) for event in shown} - {""}) == len(shown)


def test_motion_withheld_now_is_told_with_its_time():
    assert withheld(0.42, Doubt.ONE_DISC) == (
        "motion withheld for 0.4 s: one known disc in view does not determine the rotation about it"
    )


def test_several_are_one_line_and_beside_the_state_it_is_not_said_again():
    happened = (BallLost(Why.UNSEEN, 0.3), events.TargetsHidden())
    hidden = "no disc in view for 0.3 s; the targets are out of sight: if the camera was moved, initialise again"
    assert line(happened) == f"lost: {hidden}"
    assert reason(happened) == hidden
    assert line((BallLost(Why.UNSEEN, 0.3, 3), events.Turned(0))).startswith("lost: 3 discs")
    assert reason((events.Turned(0), events.Found(5))) == "the ball turns; tracking: 5 discs in view"
    assert line(()) == reason(()) == ""


def test_every_cause_and_every_bound_has_words_and_a_remedy():
    for cause in Cause:
        assert all(why_absent(Absence(cause, 12.0, 4, 0.18, 9.0, 15.0)))
    for bound in Bound:
        assert refusal(Refused("CMY", np.zeros(2), 9.0, bound))
        assert remedy(bound)


def test_a_ball_without_discs_in_words():
    assert no_discs(0, 1.03, Absence(Cause.SIZE, 160.0, 4, 0.8, 9.2, 14.6)) == (
        "no disc found on the ball for 1 s: 4 spots are about 9 px across, and the rig's discs 15 px; if these are the "
        "discs, correct disc_radius in the rig, or give the rig of this ball"
    )
    assert no_discs(2, 2.0, Absence(Cause.DARK, 3.0)) == (
        "only 2 discs found on the ball for 2 s: it is nearly black (3 of 255); uncover the lens, light the ball, or "
        "expose longer (camera.exposure_s)"
    )
