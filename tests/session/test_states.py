"""States, as transcripts: a line of facts in, the line that is logged out; nothing where nothing is to be said."""

import re

import pytest

from spheremouse.ball.state import Phase
from spheremouse.session.states import Facts, State, judge, news

TRANSCRIPTS = {
    "an ordinary start": """
        starting=compiling                             | starting: compiling
        camera=opened targets=looked for               | no-camera: opened
        targets=looked for                             | searching-targets: looked for
        targets=looked for                             |
        targets=2 of 4 found                           | searching-targets: 2 of 4 found
        targets=1 of 4 found                           |
        phase=searching                                | lost: no disc on the ball seen yet
        phase=tracking ball=7 discs event=7 discs      | tracking: 7 discs
        phase=tracking ball=7 discs                    |
        phase=tracking ball=turns event=the ball turns | the ball turns
    """,
    "the cable is pulled, and put in again": """
        phase=tracking                                 | tracking: the ball is followed
        phase=tracking camera=silent for 3 s           | no-camera: silent for 3 s
        phase=tracking camera=silent for 4 s           |
        phase=tracking camera=gone                     | no-camera: gone
        phase=lost ball=no frame event=lost: no frame  | lost: no frame
        phase=lost ball=no disc event=lost: no disc    | lost: no disc
        phase=tracking ball=again                      | tracking: again
    """,
    "what is wrong first along the way is told": """
        phase=lost camera=gone paused=asked targets=none output=busy starting=x | starting: x
        phase=lost camera=gone paused=asked targets=none output=busy | no-camera: gone
        phase=lost paused=asked targets=none output=busy | paused: asked
        phase=lost targets=none output=busy            | searching-targets: none
        phase=lost output=busy                         | lost: the ball is not recognised
        phase=tracking output=busy                     | failed-output: busy
        phase=tracking output=still busy               | failed-output: still busy
        phase=tracking paused=asked output=busy        | paused: asked
        phase=tracking                                 | tracking: the ball is followed
    """,
}
KEYS = re.compile(r"\b(starting|camera|paused|targets|ball|output|phase|event)=")


def facts(line):
    """`key=words of text key=...` as facts, and the event."""
    parts = KEYS.split(line)[1:]
    found = {k: v.strip() for k, v in zip(parts[::2], parts[1::2], strict=True)}
    event = found.pop("event", "")
    return Facts(**{**found, "phase": Phase(found.get("phase", "searching"))}), event


@pytest.mark.parametrize("name", TRANSCRIPTS)
def test_a_transcript(name):
    lines = [line.strip() for line in TRANSCRIPTS[name].strip().splitlines()]
    made, before = [], (State.STARTING, "")
    for line in lines:
        given = line.partition("|")[0].rstrip()
        f, event = facts(given)
        now = judge(f)
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
        assert judge(Facts(**{trouble: "x"}, phase=Phase.TRACKING))[0] is not State.TRACKING
    for phase in (Phase.SEARCHING, Phase.LOST):
        assert judge(Facts(phase=phase))[0] is State.LOST
    assert judge(Facts(phase=Phase.TRACKING))[0] is State.TRACKING
