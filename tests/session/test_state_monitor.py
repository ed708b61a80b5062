"""State and reason without a camera, as transcripts: conditions in, log lines out; and the time without the ball."""

import re
from types import SimpleNamespace

import pytest

from spheremouse.session.state_monitor import State, StateMonitor, derive_state, log_line
from spheremouse.session.timing import Arrivals
from spheremouse.session.tracker_adapter import LogMessages
from spheremouse.tracker import Status


class Run:
    def __init__(self):
        self.said, self.told, self.news = [], [], LogMessages()
        self.adapter = SimpleNamespace(waiting="", reason="", status=Status.TRACKING, take_messages=self.take_messages)
        self.worker = SimpleNamespace(adapter=self.adapter, trouble="", seen=1)
        self.capture = SimpleNamespace(trouble="", attempts=1, opening=False)
        self.outputs = SimpleNamespace(failed="")
        self.arrivals = Arrivals()
        self.judgement = StateMonitor(
            self.worker, self.capture, self.arrivals, self.outputs, log=self.said.append, notify=self.told.append
        )
        self.judgement.starting = ""
        self.begun = self.now = self.judgement.since

    def take_messages(self):
        news, self.news = self.news, LogMessages()
        return news

    def after(self, seconds, frames=True):
        self.now += seconds
        if frames:
            self.arrivals.add(self.now)
        return self.judgement.update(self.now)


@pytest.fixture
def run():
    return Run()


def test_the_time_in_which_nobody_saw_the_ball_is_that_between_having_seen_it(run):
    """Not before it was seen for the first time, nor where it is seen and moves nothing."""
    run.adapter.status = Status.SEARCHING
    run.after(1.0)
    run.after(1.0)
    assert (run.judgement.state, run.judgement.unseen) == (State.LOST, 0.0)
    run.adapter.status = Status.TRACKING
    run.after(1.0)
    run.outputs.failed = "gone"
    run.after(1.0)
    run.after(1.0)
    assert (run.judgement.state, run.judgement.unseen) == (State.FAILED_OUTPUT, 0.0)
    run.adapter.status = Status.LOST
    run.after(1.0)
    run.after(2.0)
    run.capture.trouble = "unplugged"
    run.after(3.0)
    run.capture.trouble, run.adapter.status = "", Status.TRACKING
    run.after(4.0)
    run.after(5.0)
    assert run.judgement.unseen == pytest.approx(2.0 + 3.0 + 4.0)


def test_that_no_frames_come_is_news_once_and_said_once(run):
    assert not run.after(0.1)
    since = run.judgement.since
    assert not run.after(2.5, frames=False)  # it may be a long exposure
    assert run.judgement.since == since
    assert run.after(1.0, frames=False)
    assert run.judgement.since == run.now
    assert not run.after(1.0, frames=False)
    assert run.said == ["tracking: the ball is followed", "no-camera: the camera has given no frame for 4 s"]
    assert run.judgement.reason == "the camera has given no frame for 4 s"
    assert not run.after(1.0)
    assert run.judgement.state is State.TRACKING


def test_systemd_hears_of_changes_and_now_and_then(run):
    for _ in range(100):
        run.after(0.25)
    assert [line.partition(";")[0] for line in run.told] == 2 * ["tracking: the ball is followed"]
    run.judgement.paused = "asked"
    run.after(0.25)
    assert run.told[2:] == ["paused: asked; 4 frames/s"]


def test_what_the_tracker_has_to_say_is_said(run):
    run.after(0.1)
    run.news = LogMessages("the ball turns", ("the map is saved",))
    run.after(0.1)
    run.after(0.1)
    assert run.said[1:] == ["the ball turns", "the map is saved"]


def test_a_camera_that_was_never_open_is_not_missing_yet(run):
    run.capture.opening, run.worker.seen, run.capture.trouble = True, 0, "the camera is being opened"
    run.after(0.1, frames=False)
    assert (run.judgement.state, run.judgement.reason) == (State.STARTING, "the camera is being opened")
    run.capture.attempts = 2
    run.after(0.1, frames=False)
    assert run.judgement.state is State.NO_CAMERA


# ---- transcripts: conditions in, the line that is logged out ----

TRANSCRIPTS = {
    "an ordinary start": """
        starting=loading                               | starting: loading
        camera=opened targets=looked for               | no-camera: opened
        targets=looked for                             | searching-targets: looked for
        targets=looked for                             |
        targets=2 of 4 found                           | searching-targets: 2 of 4 found
        targets=1 of 4 found                           |
        tracker=searching                                | lost: the ball is not found yet
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
        tracker=tracking camera=gone paused=asked targets=none output=busy starting=x | starting: x
        tracker=tracking camera=gone paused=asked targets=none output=busy | no-camera: gone
        tracker=tracking paused=asked targets=none output=busy | paused: asked
        tracker=tracking targets=none output=busy        | searching-targets: none
        tracker=lost output=busy                         | lost: the ball is not recognised
        tracker=tracking output=busy                     | failed-output: busy
        tracker=tracking output=still busy               | failed-output: still busy
        tracker=tracking paused=asked output=busy        | paused: asked
        tracker=tracking                                 | tracking: the ball is followed
    """,
}
KEYS = re.compile(r"\b(starting|camera|paused|targets|ball|output|tracker|event)=")


def conditions(line):
    """`key=words of text key=...` as conditions, and the event."""
    parts = KEYS.split(line)[1:]
    found = {k: v.strip() for k, v in zip(parts[::2], parts[1::2], strict=True)}
    event = found.pop("event", "")
    return {**found, "tracker": Status(found.get("tracker", "searching"))}, event


@pytest.mark.parametrize("name", TRANSCRIPTS)
def test_a_transcript(name):
    lines = [line.strip() for line in TRANSCRIPTS[name].strip().splitlines()]
    made, before = [], (State.STARTING, "")
    for line in lines:
        given = line.partition("|")[0].rstrip()
        found, event = conditions(given)
        now = derive_state(**found)
        made.append((given, log_line(before, now, event)))
        before = now
    expected = [tuple(part.strip() for part in line.split("|")) for line in lines]
    assert made == expected
