"""The capture thread: whatever a camera does, it is opened again, and every frame is accounted for."""

import threading
import time

import numpy as np
import pytest
from raw_picture import RawPicture
from reporting import until

from spheremouse.capture import Stream
from spheremouse.capture import fetch as module
from spheremouse.capture.fetch import Capture, Streamed
from spheremouse.capture.newest import LatestFrame
from spheremouse.errors import SourceError, TransferError
from spheremouse.tracker import Frame

PATIENCE = 20.0  # s, for what takes milliseconds
IMAGE = np.zeros((2, 2), np.uint8)


class Camera:
    """Plays lists: a number is a frame of that sequence, None no frame in time, an exception is raised, a callable
    called. After the list it says nothing more, until it is closed."""

    def __init__(self, script, world):
        self._script, self._world = iter(script), world

    def next(self, timeout):
        item = next(self._script, "silent")
        if item == "silent":
            self._world.silent.set()
            time.sleep(min(timeout, 0.005))
            return None
        if callable(item) and not isinstance(item, type):
            item = item()
        if isinstance(item, BaseException):
            raise item
        if item is None:
            return None
        raw = RawPicture(None, None, time.monotonic(), item)
        self._world.frames.append(raw)
        return raw

    def describe(self):
        return f"camera {self._world.opened}"

    def __enter__(self):
        return self

    def __exit__(self, kind, error, trace):
        self._world.closed += 1


class World:
    """Cameras, one script for each time that one is opened, or a function that opens it; the last one stays."""

    def __init__(self, *scripts):
        self.scripts, self.opened, self.closed, self.frames = list(scripts), 0, 0, []
        self.silent, self.said = threading.Event(), []
        self.latest = LatestFrame()

    def open(self):
        script = self.scripts[min(self.opened, len(self.scripts) - 1)]
        self.opened += 1
        if isinstance(script, BaseException):
            raise script
        return script() if callable(script) else Camera(script, self)

    def capture(self, patience=PATIENCE):
        return Capture(self.open, self.latest, self.said.append, patience)


@pytest.fixture
def start(monkeypatch):
    """Captures that end with the test; nothing waits for long."""
    monkeypatch.setattr(module, "BACK_OFF", (0.002, 0.004))
    started = []

    def begin(world, **kwargs):
        capture = world.capture(**kwargs)
        started.append(capture)
        capture.start()
        return capture

    yield begin
    for capture in started:
        capture.close()
        assert not capture.is_alive()


def test_frames_arrive_and_what_the_driver_lost_is_counted(start):
    world = World([5, 6, 9, 10, 3, 4])  # three lost, then a driver that begins anew
    capture = start(world)
    until(world.silent.is_set)
    assert capture.dropped == 2
    assert (capture.trouble, capture.opening, capture.description) == ("", False, "camera 1")
    arrival = world.latest.take(0.0)
    assert arrival is not None
    assert arrival.raw is world.frames[-1]
    assert arrival.taken == world.frames[-1].stamp
    assert world.latest.skipped == 5


def test_a_stamp_ahead_of_the_clock_is_not_believed(start):
    class Early(Camera):
        def next(self, timeout):
            raw = super().next(timeout)
            if raw is not None:
                raw.stamp += 1000.0
            return raw

    world = World(lambda: Early([1], world))
    start(world)
    arrival = world.latest.take(PATIENCE)
    assert arrival is not None
    assert arrival.taken <= time.monotonic()


def test_a_camera_that_is_missing_fails_or_goes_is_opened_again_and_says_why(start):
    gate = threading.Event()
    world = World(SourceError("not there"), [1, SourceError("unplugged")], [lambda: gate.wait(PATIENCE) and 7])
    capture = start(world)
    until(lambda: world.opened == 3)
    assert capture.trouble == "unplugged"  # until a frame comes again
    assert not capture.opening
    gate.set()
    until(lambda: capture.trouble == "")
    assert (capture.attempts, capture.restarts) == (3, 1)
    assert world.closed == 1
    assert world.said == []  # a device's failures are nothing for a programmer
    capture.close()
    assert world.closed == 2


def test_a_camera_that_answers_with_errors_is_reset_and_tried_at_once(start):
    """At the first such answer, and once a round of waits; a camera that is not there is not reset."""
    resets = []
    broken = TransferError("protocol error", lambda: resets.append(1) or "it was reset")
    world = World(SourceError("not there"), broken, [1, SourceError("gone")], broken, *[broken] * 6, [2])
    capture = start(world)
    until(lambda: capture.trouble == "" and capture.restarts == 1)
    assert len(resets) == 1 + 4  # of seven answers in a row; a round has two waits here
    assert world.said == ["it was reset"] * 5


def test_nothing_that_a_camera_raises_ends_the_thread(start):
    world = World(RuntimeError("what\nis this"), [1, ValueError()], [2])
    capture = start(world)
    until(lambda: capture.trouble == "" and world.opened == 3)
    assert len(world.said) == 2
    assert all("Traceback" in text for text in world.said)


def test_a_stream_that_freezes_is_opened_again(start):
    world = World([1, 2], [3])
    capture = start(world, patience=0.02)
    until(lambda: world.opened >= 2)
    until(lambda: len(world.frames) == 3)
    assert capture.restarts >= 1
    until(lambda: "no frame for 0.02 s" in capture.trouble)  # the second one freezes as well


def test_who_gives_a_frame_and_fails_is_asked_less_and_less_often(monkeypatch):
    """And who has worked for a while is asked at once: a camera unplugged now and then for months."""
    waits = []

    class Bell(threading.Event):
        def wait(self, timeout=None):
            waits.append(timeout)
            return super().wait(0.0)

    clock = [0.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: clock[0])
    long = [lambda: clock.__setitem__(0, clock[0] + 10.0) or 2, SourceError("gone")]
    world = World(*[[1, SourceError("gone")]] * 8, *[[1, *long]] * 3, [])
    event = threading.Event()
    with monkeypatch.context() as made:
        made.setattr(module.threading, "Event", Bell)
        capture = world.capture()
    thread = threading.Thread(target=capture.run)
    thread.start()
    while len(waits) < 11:
        event.wait(0.001)
    capture.close()
    thread.join(PATIENCE)
    assert waits[:8] == [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 5.0, 5.0]
    assert waits[8:11] == [0.1, 0.1, 0.1]


def test_the_camera_is_exchanged_even_while_the_next_attempt_is_waited_for(monkeypatch):
    monkeypatch.setattr(module, "BACK_OFF", (PATIENCE * 10,))
    world, other = World(SourceError("not there")), World([1])
    capture = world.capture()
    capture.start()
    until(lambda: capture.trouble == "not there")
    capture.reopen_with(other.open)
    until(lambda: other.opened == 1 and capture.trouble == "")
    capture.reopen()
    until(lambda: other.opened == 2)
    assert other.closed == 1
    capture.close()
    assert not capture.is_alive()


def test_a_buffer_does_not_outlive_its_camera(start):
    world = World([1, SourceError("gone")], [])
    start(world)
    until(lambda: world.opened == 2)
    assert [s.released for s in world.frames] == [1]
    assert world.latest.skipped == 1
    assert world.latest.take(0.0) is None


def test_a_driver_that_hangs_is_left_behind(monkeypatch):
    gate = threading.Event()
    world = World([lambda: gate.wait(PATIENCE) and None])
    capture = world.capture()
    monkeypatch.setattr(capture, "join", lambda timeout: None)  # it would wait 2 s
    capture.start()
    until(lambda: world.opened == 1)
    attempts = capture.attempts
    capture.close()
    assert capture.is_alive()
    assert capture.attempts == attempts  # no sign of life: the watchdog is not fed
    gate.set()
    threading.Thread.join(capture, PATIENCE)
    assert not capture.is_alive()


def frames(n, error=None):
    for k in range(n):
        yield Frame(IMAGE, 100.0 + k, k)
    if error is not None:
        raise error


@pytest.mark.parametrize("error", [None, SourceError("broken file")])
def test_a_recording_ends_once_with_its_last_frame_taken(start, error):
    world, before = World(lambda: Streamed(Stream(frames(3, error)), "film")), time.monotonic()
    capture = start(world)
    until(lambda: capture.finished)
    arrival = world.latest.take(0.0)
    assert arrival is not None
    assert arrival.raw.sequence == 2
    assert before <= arrival.taken <= time.monotonic()  # its own stamps are of another clock
    assert world.latest.skipped == 2
    assert capture.failure is error
    assert world.opened == 1


def test_a_live_source_never_ends(start):
    """OpenCV's cameras come as plain sources."""
    world = World(lambda: Streamed(Stream(frames(2), live=True), "opencv:0"))
    capture = start(world)
    until(lambda: world.opened > 1)
    assert not capture.finished
    assert "delivers no more frames" in capture.trouble or capture.trouble == ""


@pytest.mark.parametrize("stamp", [float("nan"), float("inf"), float("-inf")])
def test_a_frame_of_a_live_source_without_a_finite_stamp_is_rejected_and_the_next_is_taken(start, stamp):
    ended = threading.Event()

    def frames():
        yield Frame(IMAGE, stamp, 7)
        yield Frame(IMAGE, stamp, 8)
        yield Frame(IMAGE, time.monotonic(), 9)
        ended.wait(PATIENCE)

    world = World(lambda: Streamed(Stream(frames(), live=True, fps=60.0), "lamp"))
    capture = start(world)
    arrival = world.latest.take(PATIENCE)
    ended.set()
    assert arrival is not None
    assert arrival.raw.sequence == 9
    rejected = f"lamp, 60 frames/s: frame 7 is rejected: its stamp must be a finite number of seconds, is {stamp}"
    assert world.said[:1] == [rejected]
    assert not [line for line in world.said if "frame 8" in line]
    assert capture.dropped == 0
