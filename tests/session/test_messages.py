"""What is said of the ball: each event in words, as they have been since the first log."""

import pytest

from spheremouse.ball import events
from spheremouse.ball.events import BallLost, Why
from spheremouse.session.messages import line, reason
from spheremouse.tracker import Event

SENTENCES = {
    events.Found(7): "tracking: 7 discs in view",
    events.Turned(0): "the ball turns",
    events.Turned(1): "the ball turns; 1 look-alike masked",
    events.Turned(2): "the ball turns; 2 look-alikes masked",
    events.Recognised(9): "tracking again: attitude kept, recognised by 9 discs",
    events.Recognised(6, saved=True): "tracking: recognised by 6 discs of the saved map",
    BallLost(Why.UNSEEN, 0.3): "lost: no disc in view for 0.3 s",
    BallLost(Why.UNSEEN, 0.3, discs=4): "lost: 4 discs in view, none where it should be for 0.3 s",
    BallLost(Why.GAP, 1.25): "lost: no frame for 1.2 s",
    BallLost(Why.OFF_CENTRE, 0.03): (
        "lost: the ball does not turn about its centre, off by 30 mm: lifted, or out of round"
    ),
    BallLost(Why.OFF_CENTRE, 0.05, radii=True): (
        "lost: the ball does not turn about its centre, off by 5.0 % of its radius: lifted, or out of round"
    ),
    BallLost(Why.CAMERA): (
        "lost: the camera was moved, and its pose is not found: uncover the targets, or initialise again"
    ),
    events.NewMap(): (
        "tracking again: attitude reset to the last one known, a new map begun; unseen motion not counted"
    ),
    events.NewMap(saved=True): (
        "the saved map does not fit: another ball, or its discs were moved; a new map is begun"
    ),
    events.OutOfRound(): (
        "the discs do not fit a ball that turns about its centre: it is out of round, the camera was moved, or the rig "
        "is wrong"
    ),
    events.ReadoutKnown(0.0299): "rolling shutter: 29.9 ms for all rows (say readout_s: 0.0299 in the rig file)",
    events.DiscColours((0.114, 0.587, 0.299)): "the discs are darker than the ball",
    events.DiscColours((-0.114, -0.587, -0.299)): "the discs are lighter than the ball",
    events.DiscColours((-0.5, 0.0, 0.5)): (
        "the discs differ from the ball in colour (discs.weights: [-0.50, 0.00, 0.50])"
    ),
    events.CameraMoved(0.0028, 0.0042): "the camera was moved: pose estimated anew (2.8 mm, 0.24°)",
    events.CameraMoved(0.0028, 0.0042, asked=True): "pose estimated anew (2.8 mm, 0.24°)",
    events.TargetsHidden(): "the targets are out of sight: if the camera was moved, initialise again",
}


@pytest.mark.parametrize("event", SENTENCES, ids=repr)
def test_an_event_in_words(event):
    assert line([event]) == SENTENCES[event]


def test_every_event_has_words_and_every_reason_to_be_lost():
    every = {e for e in vars(events).values() if isinstance(e, type) and issubclass(e, Event) and e is not Event}
    assert {type(event) for event in SENTENCES} == every
    assert {event.why for event in SENTENCES if isinstance(event, BallLost)} == set(Why)


def test_several_are_one_line_and_beside_the_state_it_is_not_said_again():
    happened = (BallLost(Why.UNSEEN, 0.3), events.TargetsHidden())
    hidden = "no disc in view for 0.3 s; the targets are out of sight: if the camera was moved, initialise again"
    assert line(happened) == f"lost: {hidden}"
    assert reason(happened) == hidden
    assert line((BallLost(Why.UNSEEN, 0.3, 3), events.Turned(0))).startswith("lost: 3 discs")
    assert reason((events.Turned(0), events.Found(5))) == "the ball turns; tracking: 5 discs in view"
    assert line(()) == reason(()) == ""
