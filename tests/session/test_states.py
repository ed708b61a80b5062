"""States, as transcripts: a line of facts in, the line that is logged out; nothing where nothing is to be said."""

import re

import pytest

from spheremouse.session.states import Conditions, State, derive_state, news
from spheremouse.tracker import Status

TRANSCRIPTS = {
    "an ordinary start": """
        starting=compiling                             | starting: compiling
        camera=opened targets=looked for               | no-camera: opened
        targets=looked for                             | searching-targets: looked for
        targets=looked for                             |
        targets=2 of 4 found                           | searching-targets: 2 of 4 found
        targets=1 of 4 found                           |
        tracker=searching                                | lost: no disc on the ball seen yet
        tracker=tracking ball=7 discs event=7 discs      | tracking: 7 discs
        tracker=tracking ball=7 discs                    |
        tracker=tracking ball=turns event=the ball turns | the ball turns
    """,
    "the cable is pulled, and put in again": """
        tracker=tracking                                 | tracking: the ball is followed
        tracker=tracking camera=silent for 3 s           | no-camera: silent for 3 s
        tracker=tracking camera=silent for 4 s           |
        tracker=tracking camera=gone                     | no-camera: gone
        tracker=lost ball=no frame event=lost: no frame  | lost: no frame
        tracker=lost ball=no disc event=lost: no disc    | lost: no disc
        tracker=tracking ball=again                      | tracking: again
    """,
    "what is wrong first along the way is told": """
        tracker=lost camera=gone paused=asked targets=none output=busy starting=x | starting: x
        tracker=lost camera=gone paused=asked targets=none output=busy | no-camera: gone
        tracker=lost paused=asked targets=none output=busy | paused: asked
        tracker=lost targets=none output=busy            | searching-targets: none
        tracker=lost output=busy                         | lost: the ball is not recognised
        tracker=tracking output=busy                     | failed-output: busy
        tracker=tracking output=still busy               | failed-output: still busy
        tracker=tracking paused=asked output=busy        | paused: asked
        tracker=tracking                                 | tracking: the ball is followed
    """,
}
KEYS = re.compile(r"\b(starting|camera|paused|targets|ball|output|tracker|event)=")


def facts(line):
    """`key=words of text key=...` as facts, and the event."""
    parts = KEYS.split(line)[1:]
    found = {k: v.strip() for k, v in zip(parts[::2], parts[1::2], strict=True)}
    event = found.pop("event", "")
    return Conditions(**{**found, "tracker": Status(found.get("tracker", "searching"))}), event


@pytest.mark.parametrize("name", TRANSCRIPTS)
def test_a_transcript(name):
    lines = [line.strip() for line in TRANSCRIPTS[name].strip().splitlines()]
    made, before = [], (State.STARTING, "")
    for line in lines:
        given = line.partition("|")[0].rstrip()
        f, event = facts(given)
        now = derive_state(f)
        made.append((given, news(before, now, event)))
        before = now
    expected = [tuple(part.strip() for part in line.split("|")) for line in lines]
    assert made == expected


def test_every_state_is_reached():
    said = [line.rpartition("|")[2].strip() for text in TRANSCRIPTS.values() for line in text.strip().splitlines()]
    assert {line.partition(":")[0] for line in said} >= {str(s) for s in State}


def test_nothing_but_tracking_says_that_the_ball_moves_the_pointer():
    """With any trouble at all, or a ball that is not tracked, the state is another one."""
    for trouble in ("starting", "camera", "paused", "targets", "output"):
        assert derive_state(Conditions(**{trouble: "x"}, tracker=Status.TRACKING))[0] is not State.TRACKING
    for status in (Status.SEARCHING, Status.LOST):
        assert derive_state(Conditions(tracker=status))[0] is State.LOST
    assert derive_state(Conditions(tracker=Status.TRACKING))[0] is State.TRACKING
