"""State and reason from turn to turn, without a camera: what is said, and the time in which nobody saw the ball."""

from types import SimpleNamespace

import pytest

from spheremouse.session.arrivals import Arrivals
from spheremouse.session.follower import LogMessages
from spheremouse.session.state_monitor import StateMonitor
from spheremouse.session.states import State
from spheremouse.tracker import Status


class Run:
    """A judgement, and all that it is about, as attributes."""

    def __init__(self):
        self.said, self.told, self.news = [], [], LogMessages()
        self.follower = SimpleNamespace(waiting="", reason="", status=Status.TRACKING, take_news=self.take_news)
        self.worker = SimpleNamespace(follower=self.follower, trouble="", seen=1)
        self.capture = SimpleNamespace(trouble="", attempts=1, opening=False)
        self.pointer = SimpleNamespace(failed=None)
        self.arrivals = Arrivals()
        self.judgement = StateMonitor(
            self.worker,
            self.capture,
            self.arrivals,
            SimpleNamespace(pointer=self.pointer),
            say=self.said.append,
            tell=self.told.append,
        )
        self.judgement.starting = ""
        self.begun = self.now = self.judgement.since

    def take_news(self):
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
    run.follower.status = Status.SEARCHING
    run.after(1.0)
    run.after(1.0)
    assert (run.judgement.state, run.judgement.unseen) == (State.LOST, 0.0)
    run.follower.status = Status.TRACKING
    run.after(1.0)
    run.pointer.failed = "gone"
    run.after(1.0)
    run.after(1.0)
    assert (run.judgement.state, run.judgement.unseen) == (State.FAILED_OUTPUT, 0.0)
    run.follower.status = Status.LOST
    run.after(1.0)
    run.after(2.0)
    run.capture.trouble = "unplugged"
    run.after(3.0)
    run.capture.trouble, run.follower.status = "", Status.TRACKING
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
