"""What is said of the wand, as a transcript: poses in, lines out."""

from dataclasses import replace

import numpy as np

from spheremouse.session.wand.messages import Told
from spheremouse.wand.state import WandPhase, WandPose

SEARCHING = WandPose("ball", None, None, None, WandPhase.SEARCHING, "no ball like ball in view: hold it up")
TRACKING = WandPose("ball", np.zeros(3), np.eye(3), np.eye(6), WandPhase.TRACKING, "", seen=True)
HIDDEN = replace(TRACKING, seen=False, event="ball is hidden: its pose is predicted")
LOST = WandPose("ball", None, None, None, WandPhase.LOST, "ball is lost: hold it up")
COLOUR = np.tile(np.array([30, 90, 200], np.uint8), (40, 40, 1))


def transcript(*steps, image=COLOUR):
    """Lines of steps: a text is trouble with the camera, a pose or several are a frame, 0.1 s after the one before."""
    told, lines = Told(), []
    for k, step in enumerate(steps):
        if isinstance(step, str):
            lines += told.camera(step)
            continue
        told.camera("")
        lines += told.frame(0.1 * k, step if isinstance(step, tuple) else (step,), image, 0)
    return lines


def test_each_change_is_said_once():
    assert transcript(SEARCHING, SEARCHING, TRACKING, TRACKING, HIDDEN, TRACKING, HIDDEN, LOST, LOST, TRACKING) == [
        "searching: ball is looked for",
        "tracking: ball is followed",
        "lost: ball is lost: hold it up",
        "tracking: ball is followed",
    ]


def test_a_camera_that_goes_is_said_once_and_what_is_there_when_it_is_back():
    gone = "no frame for 3 s"
    assert transcript(TRACKING, gone, "no frame for 4 s", "", TRACKING, TRACKING, gone) == [
        "tracking: ball is followed",
        "no-camera: no frame for 3 s",
        "tracking: ball is followed",
        "no-camera: no frame for 3 s",
    ]


def test_events_are_said_when_they_are_new():
    second = replace(TRACKING, event="a second ball like ball is in view: declare it too")
    share = [replace(TRACKING, event=f"the bounds of red match {n} % of the picture") for n in (30, 31, 32)]
    assert transcript(TRACKING, second, second, TRACKING, second, *share) == [
        "tracking: ball is followed",
        second.event,
        share[0].event,
    ]


def test_a_ball_that_is_not_found_for_long_is_told_once_with_what_to_do():
    lines = transcript(*[SEARCHING] * 200)
    assert lines == ["searching: ball is looked for", f"searching: for 5 s: {SEARCHING.event}"]
    assert transcript(*[SEARCHING] * 40) == lines[:1]
    grey = transcript(*[SEARCHING] * 60, image=np.full((40, 40, 3), 120, np.uint8))
    assert grey[1] == f"searching: for 5 s: {SEARCHING.event} (the frames are grey, or dark)"
    assert transcript(*[SEARCHING] * 60, image=np.full((40, 40), 120, np.uint8))[1] == lines[1]  # a grey camera's own


def test_several_balls_are_told_apart():
    other = replace(LOST, name="other", phase=WandPhase.SEARCHING)
    told = Told()
    assert told.frame(0.0, (TRACKING, other), COLOUR, 0) == [
        "tracking: ball is followed",
        "searching: other is looked for",
    ]
    assert told.found == {0}
    assert told.why == ""
    told.frame(0.1, (LOST, replace(TRACKING, name="other")), COLOUR, 0)
    assert told.found == {0, 1}
    assert told.why == LOST.event


def test_a_ball_that_was_never_seen_is_told_at_the_end():
    other = replace(SEARCHING, name="other")
    told = Told()
    assert told.never_found() == []
    told.frame(0.0, (SEARCHING, other), COLOUR, 0)
    assert told.never_found() == [f"{p.name} was never found: {p.event}" for p in (SEARCHING, other)]
    assert told.never_found(but=0) == [f"other was never found: {other.event}"]
    told.frame(0.1, (TRACKING, replace(other, event="bounds that match nothing")), COLOUR, 0)
    told.frame(0.2, (LOST, replace(other, event="bounds that match nothing")), COLOUR, 0)  # it was found once
    assert told.never_found() == ["other was never found: bounds that match nothing"]
