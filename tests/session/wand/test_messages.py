"""What is said of the wand, as a transcript: poses in, lines out."""

from dataclasses import replace

import numpy as np

from spheremouse.session.wand.messages import WandMessages, problem, sentence
from spheremouse.tracker import Status
from spheremouse.wand.events import BallHidden, BallLost, ColourEverywhere, ColourNowhere, NotInView, SecondBall
from spheremouse.wand.state import WandPose

SEARCHING = WandPose("ball", None, None, None, Status.SEARCHING, NotInView("ball"))
TRACKING = WandPose("ball", np.zeros(3), np.eye(3), np.eye(6), Status.TRACKING, None, seen=True)
HIDDEN = replace(TRACKING, seen=False, event=BallHidden("ball"))
LOST = WandPose("ball", None, None, None, Status.LOST, BallLost("ball"))
COLOUR = np.tile(np.array([30, 90, 200], np.uint8), (40, 40, 1))


def transcript(*steps, image=COLOUR):
    """Lines of steps: a pose or several are a frame, 0.1 s after the one before; None: no frames come."""
    told, lines = WandMessages(0, "ball"), []
    for k, step in enumerate(steps):
        if step is None:
            told.interrupted()
        else:
            change, more = frame(told, 0.1 * k, step if isinstance(step, tuple) else (step,), image)
            lines += filter(None, (change, *more))
    return lines


def frame(told, stamp, poses, image=COLOUR):
    told.add(stamp, poses, image)
    return told.take()


def test_each_change_is_said_once():
    assert transcript(SEARCHING, SEARCHING, TRACKING, TRACKING, HIDDEN, TRACKING, HIDDEN, LOST, LOST, TRACKING) == [
        "searching: ball is looked for",
        "tracking: ball is followed",
        "lost: ball is lost: hold it into the picture",
        "tracking: ball is followed",
    ]


def test_what_is_there_is_said_anew_when_frames_come_again():
    assert transcript(TRACKING, TRACKING, None, None, TRACKING, TRACKING) == 2 * ["tracking: ball is followed"]


def test_events_are_said_when_they_are_new():
    second = replace(TRACKING, event=SecondBall("ball"))
    share = [replace(TRACKING, event=ColourEverywhere("red", n)) for n in (0.3, 0.31, 0.32)]
    assert transcript(TRACKING, second, second, TRACKING, second, *share) == [
        "tracking: ball is followed",
        "a second ball like ball is in view: declare it too, or take it away",
        "the bounds of red match 30 % of the picture: narrow them with `spheremouse wand colours`",
    ]


def test_a_ball_that_is_not_found_for_long_is_told_once_with_what_to_do():
    lines = transcript(*[SEARCHING] * 200)
    assert lines == ["searching: ball is looked for", f"not found for 5 s: {problem(SEARCHING)}"]
    assert transcript(*[SEARCHING] * 40) == lines[:1]
    grey = transcript(*[SEARCHING] * 60, image=np.full((40, 40, 3), 120, np.uint8))
    assert grey[1] == f"not found for 5 s: {problem(SEARCHING)} (the frames are grey, or dark)"
    assert transcript(*[SEARCHING] * 60, image=np.full((40, 40), 120, np.uint8))[1] == lines[1]  # a grey camera's own


def test_several_balls_are_told_apart():
    other = replace(LOST, name="other", phase=Status.SEARCHING)
    told = WandMessages(0, "ball")
    assert told.reason == "ball is looked for"
    assert frame(told, 0.0, (TRACKING, other), COLOUR) == ("tracking: ball is followed", ("other is looked for",))
    assert told.found == {0}
    assert (told.why, told.reason) == ("", "ball is followed")
    assert frame(told, 0.1, (LOST, replace(TRACKING, name="other")), COLOUR) == (
        f"lost: {problem(LOST)}", ("other is followed",),
    )  # fmt: skip
    assert told.found == {0, 1}
    assert (told.why, told.reason) == (problem(LOST), problem(LOST))


def test_a_ball_that_was_never_seen_is_told_at_the_end():
    other = replace(SEARCHING, name="other")
    told = WandMessages(0, "ball")
    assert told.never_found() == ()
    frame(told, 0.0, (SEARCHING, other), COLOUR)
    assert told.never_found() == tuple(f"{p.name} was never found: {problem(p)}" for p in (SEARCHING, other))
    assert told.never_found(but=0) == (f"other was never found: {problem(other)}",)
    frame(told, 0.1, (TRACKING, replace(other, event=ColourNowhere("red"))), COLOUR)
    frame(told, 0.2, (LOST, replace(other, event=ColourNowhere("red"))), COLOUR)  # it was found once
    assert told.never_found() == (f"other was never found: {sentence(ColourNowhere('red'))}",)
